// SPDX-License-Identifier: Apache-2.0
// VisualSFM's N-View Match file (NVM_V3) and its binary .sift files as they
// are. The parsers work on bytes, so that they can be fuzzed.
// Source: VisualSFM's documentation, "The Output File Format: NVM" and
// "Use your own feature detectors".
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_NVM_MODEL_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_NVM_MODEL_H_

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/formats/internal/radial_fit.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map_data.h"

namespace groundlock::formats::internal {

struct NvmCamera {
  std::string name;  // as in the file, decoded; may be a path
  double focal_px = 0.0;
  geometry::Rigid3 camera_from_world;
  double r = 0.0;  // measured -> undistorted; see CameraFromNvm
};

struct NvmMeasurement {
  std::uint32_t camera = 0;
  std::uint32_t feature = 0;  // index in the image's .sift file
  std::uint32_t point = 0;
  Eigen::Vector2f xy_px;  // relative to the principal point
};

struct NvmModel {
  std::vector<NvmCamera> cameras;
  std::vector<map::MapLandmarkData> points;
  std::vector<NvmMeasurement> measurements;
};

// The calibration that all cameras share, if VisualSFM was given one.
struct NvmCalibration {
  double fx_px = 0.0;
  double cx_px = 0.0;
  double fy_px = 0.0;
  double cy_px = 0.0;
};

struct NvmFile {
  std::optional<NvmCalibration> calibration;
  NvmModel model;      // the one with the most points
  int num_models = 0;  // that have points
};

// `file` names the text in messages; errors give the line.
absl::StatusOr<NvmFile> ParseNvm(std::string_view text, std::string_view file);

// A parsed .sift file; points into the bytes it was parsed from.
class SiftFile {
 public:
  static absl::StatusOr<SiftFile> Parse(std::string_view bytes,
                                        std::string_view file);
  std::size_t size() const { return size_; }
  // First pixel's centre (0.5, 0.5), as SiftGPU does.
  Eigen::Vector2f KeypointPx(std::size_t index) const;
  // VisualSFM's: L2-normalised, times 512.
  std::span<const std::uint8_t, 128> Descriptor(std::size_t index) const;

 private:
  std::size_t size_ = 0;
  std::string_view locations_;
  std::string_view descriptors_;
};

// NVM's distortion runs from the measured to the undistorted point: with m
// relative to the principal point, undistorted = (1 + r |m|^2 / f^2) m
// (Robinson 2014, §3.2, has it the other way round). There is no closed form
// for ours, so its coefficients are fitted within radius_px of the principal
// point: the first of SIMPLE_RADIAL, RADIAL and OPENCV_FISHEYE that stays below
// 0.05 px, else the best. If r < 0 the map folds back at |m| = f / sqrt(-3 r):
// no further out. kInvalidArgument names the field.
absl::StatusOr<FittedCamera> CameraFromNvm(
    double focal_px,
    double r,
    int width_px,
    int height_px,
    const Eigen::Vector2d& principal_point_px,
    double radius_px);

// The other way, for the exporter: f and r for a camera of ours, fitted over
// its image. kFailedPrecondition if an NVM camera cannot come nearer than 1 px.
struct FittedNvm {
  double focal_px = 0.0;
  double r = 0.0;
  double max_residual_px = 0.0;
};
absl::StatusOr<FittedNvm> NvmFromCamera(const geometry::CameraModel& camera);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_NVM_MODEL_H_
