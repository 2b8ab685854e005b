// SPDX-License-Identifier: Apache-2.0
// Camera models under COLMAP's names, parameter orders and pixel convention:
// the centre of the top-left pixel is (0.5, 0.5).
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_CAMERA_MODEL_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_CAMERA_MODEL_H_

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace groundlock::geometry {

// Values are COLMAP's model ids. Parameters in order:
enum class CameraModelId {
  kSimplePinhole = 0,  // f, cx, cy
  kPinhole = 1,        // fx, fy, cx, cy
  kSimpleRadial = 2,   // f, cx, cy, k
  kRadial = 3,         // f, cx, cy, k1, k2
  kOpenCv = 4,         // fx, fy, cx, cy, k1, k2, p1, p2
  kOpenCvFisheye = 5,  // fx, fy, cx, cy, k1, k2, k3, k4
};

// COLMAP's name, e.g. "SIMPLE_RADIAL".
std::string_view CameraModelName(CameraModelId id);
// kInvalidArgument naming the unknown model and the known ones.
absl::StatusOr<CameraModelId> CameraModelIdFromName(std::string_view name);
int NumCameraModelParams(CameraModelId id);

// Intrinsics of one camera. Immutable, copyable, thread-safe.
//
// Distortion maps normalised, undistorted coordinates x (on z = 1) to x_d, e.g.
// SIMPLE_RADIAL x_d = (1 + k |x|^2) x; the pixel is f x_d + c. Points beyond
// the radius up to which the distortion is monotone have no pixel: a polynomial
// folds back there and would put them inside the image (Robinson 2014, §3.2,
// eq. 3.5-3.9 gives the model; the monotone limit is ours).
class CameraModel {
 public:
  static constexpr int kMaxParams = 8;
  static constexpr int kMaxSizePx = 65'535;

  // kInvalidArgument naming the field: size outside [1, kMaxSizePx], wrong
  // number of parameters, NaN or infinity, focal length outside [0.01, 1000]
  // times the larger image side, principal point farther than 10 sides from
  // the corner, a distortion coefficient beyond 1e4.
  static absl::StatusOr<CameraModel> Create(CameraModelId id,
                                            int width_px,
                                            int height_px,
                                            std::span<const double> params);
  // A 1x1 pinhole camera of unit focal length: valid but useless.
  CameraModel();

  CameraModelId id() const { return id_; }
  int width_px() const { return width_px_; }
  int height_px() const { return height_px_; }
  std::span<const double> params() const {
    return {params_.data(), static_cast<size_t>(NumCameraModelParams(id_))};
  }
  Eigen::Vector2d focal_px() const { return focal_px_; }
  Eigen::Vector2d principal_point_px() const { return principal_point_px_; }
  double mean_focal_px() const { return 0.5 * focal_px_.sum(); }
  // K without distortion.
  Eigen::Matrix3d CalibrationMatrix() const;
  // The same camera for an image resized to another size.
  CameraModel Rescaled(int width_px, int height_px) const;

  // Pixel of a point in the camera frame (x right, y down, z forward, any
  // unit); nullopt if it is not in front of the camera or beyond the monotone
  // radius. The pixel may lie outside the image.
  //   jacobian  if given, d pixel / d p_camera, exact.
  std::optional<Eigen::Vector2d> ImageFromCamera(
      const Eigen::Vector3d& p_camera,
      Eigen::Matrix<double, 2, 3>* jacobian = nullptr) const;

  // Undistorted coordinates on z = 1 of a pixel; inverse of ImageFromCamera to
  // 1e-9 where that is defined. nullopt if no undistorted point maps there (or,
  // for fisheye, if the ray is not in front of the camera).
  std::optional<Eigen::Vector2d> NormalizedFromImage(
      const Eigen::Vector2d& pixel_px) const;
  // Unit bearing of a pixel in the camera frame; nullopt as above.
  std::optional<Eigen::Vector3d> RayFromImage(
      const Eigen::Vector2d& pixel_px) const;

  bool IsInsideImage(const Eigen::Vector2d& pixel_px,
                     double margin_px = 0.0) const;

  friend bool operator==(const CameraModel&, const CameraModel&) = default;

 private:
  // Distorted normalised coordinates and, if given, d x_d / d x.
  Eigen::Vector2d Distort(const Eigen::Vector2d& x,
                          Eigen::Matrix2d* jacobian) const;
  std::array<double, 5> RadialPolynomial() const;
  std::optional<Eigen::Vector2d> UndistortRadial(
      const Eigen::Vector2d& x_d) const;
  std::optional<Eigen::Vector2d> UndistortTangential(
      const Eigen::Vector2d& x_d) const;
  void ComputeMaxRadius();

  CameraModelId id_ = CameraModelId::kSimplePinhole;
  int width_px_ = 1;
  int height_px_ = 1;
  std::array<double, kMaxParams> params_{};
  Eigen::Vector2d focal_px_ = Eigen::Vector2d::Ones();
  Eigen::Vector2d principal_point_px_ = Eigen::Vector2d::Constant(0.5);
  double max_radius_ = 0.0;  // |x| up to which distortion is monotone
};

// The lens for a picture of that size if it is the same picture scaled: the
// sides' ratio is the same but for rounding to whole pixels. Else nullopt.
std::optional<CameraModel> ScaledToFit(const CameraModel& camera,
                                       int width_px,
                                       int height_px);

// Reads and writes camera.json:
//   {"width":1280,"height":720,"model":"SIMPLE_RADIAL","params":[f,cx,cy,k]}
// Errors name the missing or wrong field.
absl::StatusOr<CameraModel> CameraModelFromJson(std::string_view json);
std::string CameraModelToJson(const CameraModel& camera);

}  // namespace groundlock::geometry

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_CAMERA_MODEL_H_
