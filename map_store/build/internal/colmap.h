// SPDX-License-Identifier: Apache-2.0
// COLMAP's programs, as this build uses them.
// Source: COLMAP 3.8, "Command-line Interface"; Schoenberger & Frahm 2016.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_COLMAP_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_COLMAP_H_

#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>

#include "absl/status/status.h"
#include "map_store/build/internal/image_pairs.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::build::internal {

struct ColmapOptions {
  std::string program = "colmap";
  std::filesystem::path log;
  int threads = 0;  // 0 = all cores
  int niceness = 0;
  std::uint64_t memory_bytes = 0;  // of each program; 0 = the machine's
  // Fraction done and, if there is something to say, what; false cancels.
  std::function<bool(double fraction, const std::string& note)> progress;
};

// All errors say what to do; kNotFound that COLMAP is to be installed.
class Colmap {
 public:
  explicit Colmap(ColmapOptions options) : options_(std::move(options)) {}

  // COLMAP's SIFT on the CPU; one camera for all images.
  absl::Status ExtractFeatures(
      const std::filesystem::path& database,
      const std::filesystem::path& images,
      const std::optional<geometry::CameraModel>& camera,
      int max_features) const;
  // Verifies the pairs whose matches are in the database.
  absl::Status VerifyMatches(const std::filesystem::path& database,
                             const std::filesystem::path& pair_list) const;
  // Writes sub-models 0, 1, ... into `output`, which must exist.
  struct MapperOptions {
    bool fix_lens = false;
    // Starts from, and goes on with, less certain pairs: for walks in which
    // the usual demands find nothing.
    bool lenient = false;
    std::size_t num_images = 0;  // for progress
  };
  absl::Status RunMapper(const std::filesystem::path& database,
                         const std::filesystem::path& images,
                         const std::filesystem::path& output,
                         const MapperOptions& mapper) const;
  // Bundle adjustment of all of `input`, into `output`, which must exist.
  absl::Status Adjust(const std::filesystem::path& input,
                      const std::filesystem::path& output,
                      bool fix_lens) const;

 private:
  absl::Status Run(
      std::vector<std::string> arguments,
      const std::function<void(std::string_view, double*, std::string*)>&
          on_line) const;

  const ColmapOptions options_;
};

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_COLMAP_H_
