// SPDX-License-Identifier: Apache-2.0
// The stages of a build and what they hand to each other. They are defined in
// build.cc (what all share), build_features.cc (features, and of photos their
// matches), build_video.cc (from a video to the map) and build_model.cc (from
// the matches of photos to the map).
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_MAP_BUILD_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_MAP_BUILD_H_

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/build/build.h"
#include "map_store/build/internal/colmap.h"
#include "map_store/build/internal/image_features.h"
#include "map_store/build/internal/stage_log.h"
#include "map_store/build/report.h"

namespace groundlock::build::internal {

// Two images are no map; three is what a landmark must be seen in.
inline constexpr std::size_t kMinImages = 3;

// One build in its work folder. The stages run in order; each either finds its
// result there, under the same key, or makes it.
// `options` and `progress` must outlive it. Not thread-safe.
class MapBuild {
 public:
  MapBuild(const BuildOptions& options,
           const ProgressCallback& progress,
           StageLog log)
      : options_(options),
        progress_(progress),
        log_(std::move(log)),
        folder_(options.work_folder),
        database_(folder_ / "database.db") {}

  absl::StatusOr<BuildResult> Run();  // once

 private:
  using Work = std::function<absl::Status()>;

  // Runs `work` unless its result is there; extends the key for what follows.
  absl::Status Stage(const char* name,
                     const std::string& own_key,
                     const Work& work);
  bool Progress(double fraction, const std::string& note = {}) const {
    return !progress_ || progress_({stage_, fraction, note});
  }
  std::function<bool(std::size_t)> CountProgress(std::size_t total,
                                                 const char* what) const;
  Colmap MakeColmap() const;

  absl::Status CheckColmap() const;
  absl::Status HashInputs();
  // A video: its keyframes and the tracks through them, the motion, and the
  // landmarks. MapVideo tries again with keyframes closer together where too
  // few could be held, and keeps the better try.
  absl::Status MapVideo();
  absl::Status ExtractFrames(double finer, const std::string& suffix);
  absl::Status FindMotion(const std::string& suffix);
  absl::Status PlaceVideoLandmarks();
  absl::Status DescribeVideo();

  absl::Status FindFeatures();
  absl::StatusOr<std::vector<ImageFeatures>> ReadImageFeatures() const;
  absl::Status ReadFeatureFacts();
  absl::Status MatchImages();
  absl::Status RunMapper();
  absl::Status RefineModel();
  absl::Status FinishMap();
  absl::Status KeepUpReadings(const map::MapData& data) const;
  absl::StatusOr<int> CountPhotosWithGps() const;  // of the images in the map
  absl::Status WriteReportFiles();
  absl::Status TooFewRegistered(std::size_t num_registered) const;
  std::filesystem::path pairs_file() const { return folder_ / "pairs.txt"; }

  const BuildOptions& options_;
  const ProgressCallback& progress_;
  StageLog log_;
  const std::filesystem::path folder_;
  const std::filesystem::path database_;
  std::filesystem::path images_;       // where the images lie
  std::filesystem::path tracks_file_;  // of a video, as are the next two
  std::filesystem::path frames_file_;
  std::filesystem::path motion_file_;
  std::string key_;  // of the last stage
  const char* stage_ = "";
  std::size_t num_left_out_ = 0;           // of a video's keyframes
  std::vector<std::string> notes_;         // of the motion of a video
  std::vector<std::string> model_images_;  // of the sub-model that was chosen
  BuildReport report_;
};

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_MAP_BUILD_H_
