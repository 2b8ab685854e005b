// SPDX-License-Identifier: Apache-2.0
// The recorded and rendered sequences that benchmarks measure on.
#ifndef GROUNDLOCK_TESTS_SUPPORT_RECORDED_DATA_H_
#define GROUNDLOCK_TESTS_SUPPORT_RECORDED_DATA_H_

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"

namespace groundlock::test_support {

// $GROUNDLOCK_DATA, or ../shared/data.
std::filesystem::path DataFolder();

// Imports a reconstruction as the server would; the map's file is gone, its
// content stays mapped.
//   align  align.json; empty: the ground is estimated, the scale unknown.
absl::StatusOr<std::shared_ptr<const map::Map>> ImportMap(
    const std::filesystem::path& reconstruction,
    const std::filesystem::path& align = {});
absl::StatusOr<std::shared_ptr<const map::Map>> WriteAndOpen(
    const map::MapData& data);
absl::StatusOr<map::MapData> ImportData(
    const std::filesystem::path& reconstruction,
    const std::filesystem::path& align = {});

absl::StatusOr<geometry::Similarity3> ReadAlignment(
    const std::filesystem::path& align_json);
absl::StatusOr<geometry::CameraModel> ReadCamera(
    const std::filesystem::path& camera_json);

// What a *_truth.csv or *_reference.csv says of a frame.
struct TrueFrame {
  geometry::Rigid3 world_from_camera;
  std::optional<geometry::Box2> target_px;  // its visible part
};
absl::StatusOr<std::map<int, TrueFrame>> ReadTrueFrames(
    const std::filesystem::path& csv);

// A place of which there are frames: a map, or a sequence in one.
struct Sequence {
  std::string name;
  std::filesystem::path video;
  std::filesystem::path camera;
  std::filesystem::path truth;  // CSV
  std::filesystem::path reconstruction;
  std::filesystem::path align;  // empty: truth is in the source's coordinates
  double frames_per_second = 24.0;
};
// "srun", "scale", "outofview", "occlusion" (rendered, metres) and "plaza"
// (real). kNotFound lists the names, or names a file that is not there.
absl::StatusOr<Sequence> FindSequence(const std::string& name);

// Every stride-th frame from the first, CV_8UC3 BGR, by frame number.
absl::StatusOr<std::map<int, cv::Mat>> ReadFrames(
    const std::filesystem::path& video, int stride, int max_frames = 1 << 30);
// As the command line sends frames, if no other quality is named; chroma at
// half resolution.
std::vector<std::uint8_t> EncodeJpeg(const cv::Mat& image, int quality = 75);

// A pose in a map's world, for a pose in the coordinates it was imported from.
geometry::Rigid3 WorldFromSourcePose(
    const map::Map& map, const geometry::Rigid3& source_from_camera);

// NaN without values; q in [0, 1].
double Quantile(std::vector<double> values, double q);
// "median 1.23  p95 2.34  p99 3.45  max 4.56"
std::string Quantiles(const std::vector<double>& values);

// Seconds of processor time of this thread.
double ThreadCpuSeconds();

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_RECORDED_DATA_H_
