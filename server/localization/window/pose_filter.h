// SPDX-License-Identifier: Apache-2.0
// How the camera moves, and what is known of where it is: a Kalman filter with
// constant velocity and white acceleration, whose tails are heavy, over the
// pose now and the poses in three earlier frames, to which later measurements
// refer.
//
// window/ holds the poses of the last frames and what ties them together:
//   pose_filter  the poses, velocity and systematic errors with one covariance
//                over all; what is followed, found in the map or measured by a
//                gyroscope, a receiver of satellites' signals or a compass is a
//                measurement of, or between, poses in it
//   gyroscope    samples integrated between two frames
// It knows nothing of how a measurement was come by.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_WINDOW_POSE_FILTER_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_WINDOW_POSE_FILTER_H_

#include <Eigen/Core>
#include <array>
#include <chrono>
#include <optional>

#include "server/localization/solvers/pose_estimate.h"
#include "server/localization/window/gyroscope.h"

namespace groundlock::localization {

struct PoseFilterOptions {
  // Standard deviation of the acceleration of a camera in the hand, on a drone
  // or a vehicle, unit of the map per s^2, and for how long it stays about the
  // same: sigma^2 times that time is the spectral density of the white noise
  // which stands for it, whatever the frame rate.
  double acceleration_s2 = 4.0;
  double angular_acceleration_rad_s2 = 25.0;
  double acceleration_lasts_s = 0.04;
  double initial_velocity_s = 1.0;
  double initial_angular_velocity_rad_s = 1.0;
  // A camera that is not seen keeps its velocity for the first, then loses it
  // with the second as time constant: a hand does not go on turning.
  double coast_s = 0.25;
  double coast_decay_s = 0.25;
  // The camera may be pushed, and a pose found in the map may rest on matches
  // that err more than others: its acceleration in a step, and that pose's
  // random error, are Student's t with so many degrees of freedom, a Gaussian
  // whose variance is itself drawn.
  double degrees_of_freedom = 4.0;
  // A pose found in the map contradicts what is known if that leaves it less
  // likely than what was expected by more than this natural logarithm: half the
  // chi-squared of 6 degrees of freedom that is exceeded once in a million.
  double max_map_surprise = 19.0;
  // Squared Mahalanobis distance up to which it confirms what is known:
  // chi-squared with 6 degrees of freedom exceeds 22.5 once in a thousand.
  double max_confirmed_mahalanobis_squared = 22.5;
  // Squared Mahalanobis distance beyond which a position or an attitude by
  // other sensors is wrong: chi-squared with 3 degrees of freedom exceeds 30.7
  // once in a million.
  double max_sensor_mahalanobis_squared = 30.7;
  // The state then has the gyroscope's errors, too.
  std::optional<ImuModel> imu = std::nullopt;
};

// A pose found in the map. What its matches have in common with those of the
// next one (errors of landmarks, of the lens) does not average out.
struct MapMeasurement {
  geometry::Rigid3 world_from_camera;
  // Both of (dp, dtheta), see rigid3.h.
  geometry::Matrix6d random = geometry::Matrix6d::Zero();
  geometry::Matrix6d systematic = geometry::Matrix6d::Zero();
  // Share of its systematic error that the previous measurement had as well,
  // in [0, 1].
  double shared = 0.0;
};

// A place by another sensor, which is fixed to the camera.
struct PositionMeasurement {
  Eigen::Vector3d p_world = Eigen::Vector3d::Zero();   // of the sensor
  double sigma = 0.0;                                  // per axis
  Eigen::Vector3d p_camera = Eigen::Vector3d::Zero();  // of the sensor
};

struct AttitudeMeasurement {
  Eigen::Quaterniond world_from_camera = Eigen::Quaterniond::Identity();
  double sigma_rad = 0.0;  // about each axis
};

// Not thread-safe. State (errors as rigid3.h says): the pose now, its velocity,
// the pose in each remembered frame, and the systematic error of the map
// measurements, in units of its standard deviation along the axes of its
// covariance, a first-order Gauss-Markov process; with a gyroscope, its bias, a
// random walk, and its scale, a constant; once other sensors have told a
// position or an attitude, what these err alike for long, in units of their
// standard deviation, a first-order Gauss-Markov process. So that error is
// learnt while the map tells where the camera is, and is known after.
// Source: Bar-Shalom, Li & Kirubarajan 2001, §6.2.2, §8.2 (coloured noise);
// Roumeliotis & Burdick 2002 (poses remembered); Agamennoni, Nieto & Nebot 2012
// (Student's t as a scale mixture in a filter).
class PoseFilter {
 public:
  // Frames whose pose is remembered.
  enum Frame { kKeyFrame = 0, kAnchorFrame = 1, kLastFrame = 2 };
  static constexpr int kNumFrames = 3;

  explicit PoseFilter(const PoseFilterOptions& options);

  // Remembers nothing; the gyroscope's errors and what other sensors err stay
  // known as they are.
  //   velocity_s  roughly, as far as is known: (dp, dtheta) per second.
  void Start(std::chrono::nanoseconds time,
             const MapMeasurement& measured,
             const geometry::Vector6d& velocity_s = geometry::Vector6d::Zero());
  // Moves to `time`; no effect if that is in the past. Without a measurement
  // since, the velocity dies away. Many short steps are the same as a long one.
  void Propagate(std::chrono::nanoseconds time);

  void Remember(Frame frame);
  void Forget(Frame frame) { remembered_[frame] = false; }
  bool Remembers(Frame frame) const { return remembered_[frame]; }
  // The key frame is now the frame of the anchor, which is forgotten.
  void MakeAnchorFrameKeyFrame();

  PoseEstimate pose() const;
  PoseEstimate pose(Frame frame) const;
  std::chrono::nanoseconds time() const { return time_; }
  // Of the pose now, as (dp, dtheta) per second.
  geometry::Vector6d velocity_s() const;

  // The pose now, measured relative to a remembered frame: `measured` would be
  // it if that frame were at `reference`. How much the camera was accelerated
  // in the last step is what makes the measurement most likely. False, and no
  // change, if it is less likely than what was expected by more than
  // `max_surprise`, a natural logarithm.
  bool UpdateRelative(Frame frame,
                      const geometry::Rigid3& reference,
                      const PoseEstimate& measured,
                      double max_surprise);
  // What is known before that: of (dp, dtheta) of the pose now, were the
  // remembered frame's known.
  geometry::Matrix6d RelativeCovariance(Frame frame) const;
  // Only the rotation since a remembered frame, with the same standard
  // deviation about each axis.
  void UpdateRotation(Frame frame,
                      const Eigen::Quaterniond& frame_from_now,
                      double sigma_rad);
  // The turn since a remembered frame, which the gyroscope integrated under
  // gyroscope_errors(), and how fast it turns now. Options must have `imu`. In
  // the step since that frame, the turn then hides no jolt.
  void UpdateFromGyroscope(Frame frame, const GyroscopeTurn& turn);
  const GyroscopeErrors& gyroscope_errors() const { return gyro_errors_; }
  // The pose now, by other sensors. False, and no change, if it contradicts
  // what is known.
  bool UpdateFromPosition(const PositionMeasurement& measured);
  bool UpdateFromAttitude(const AttitudeMeasurement& measured);
  // The pose now has drifted: an error that no measurement shows. Covariance of
  // (dp, dtheta).
  void AddDrift(const geometry::Matrix6d& drift);
  // The pose now, or in a remembered frame, found in the map. False, and no
  // change, if it contradicts what is known.
  bool UpdateFromMap(const MapMeasurement& measured);
  bool UpdateFromMap(Frame frame, const MapMeasurement& measured);
  // Whether it lies where a remembered frame is known to be, so that it may
  // confirm it: tails are not heavy here, and what both may err alike is taken
  // for independent.
  bool Confirms(Frame frame, const MapMeasurement& measured) const;
  // `measured` holds whatever was known: the motion since the frame, and how
  // the other remembered frames lie to it, is put after it.
  void RestartFromMap(Frame frame, const MapMeasurement& measured);

 private:
  friend struct StateFields;

  static constexpr int kVelocity = 6;
  static constexpr int kBias = 12 + 6 * kNumFrames;
  // If there is one: its bias (3) and scale, column by column (9).
  static constexpr int kGyroscope = kBias + 6;
  static constexpr int kGyroscopeErrors = 12;
  // Of a position (3) and an attitude (3), if there was one; the last ones.
  static constexpr int kSensorErrors = 6;
  // Sizes that the compiler does not know keep the build short, and cost
  // nothing that shows beside the products themselves.
  using Covariance = Eigen::MatrixXd;   // size_ x size_
  using Observation = Eigen::MatrixXd;  // rows x size_

  static int OffsetOf(Frame frame) { return 12 + 6 * frame; }
  int SensorOffset() const { return size_ - kSensorErrors; }
  // Makes room for what other sensors err.
  void ExpectSensors();
  // A measurement along three axes, of which `offset` is the sensor's error.
  bool UpdateFromSensor(const Eigen::Vector3d& innovation,
                        const Eigen::Matrix<double, 3, 6>& d_pose,
                        int offset,
                        double sigma);
  bool UpdateFromMapAt(int offset,
                       const geometry::Rigid3& known,
                       const MapMeasurement& measured);
  // False, and no change, beyond `max_mahalanobis_squared`.
  bool Update(const Eigen::VectorXd& innovation,
              const Observation& H,
              const Eigen::MatrixXd& R,
              double max_mahalanobis_squared);
  void Inject(const Eigen::VectorXd& correction);
  // How the state moves in a step, for one axis: the position gains `travel_s`
  // times the velocity, of which `kept` is left, and the noise of unit spectral
  // density adds the variances.
  struct Step {
    double travel_s = 0.0;
    double kept = 1.0;
    double position = 0.0;
    double cross = 0.0;
    double velocity = 0.0;
  };
  static Step AtConstantVelocity(double duration_s);
  static Step WhileDyingAway(double duration_s, double decay_s);
  // Parts of the time until `duration_s` from now: before the velocity begins
  // to die away, and after.
  struct Coasting {
    double steady_s = 0.0;
    double dying_s = 0.0;
  };
  Coasting CoastFor(double duration_s) const;
  void Move(const Step& step);
  // `variance`: of the accelerations, over what the options say.
  void AddNoise(const Step& step, double variance);
  // By how many times a variance was greater than was expected, and how much
  // less likely than what was expected that and the innovation are.
  struct HeavyTail {
    double variance = 1.0;
    double surprise = 0.0;
  };
  //   expected  covariance of the innovation,
  //   of_tail   the part of it whose variance is drawn.
  HeavyTail Explain(const geometry::Vector6d& innovation,
                    const geometry::Matrix6d& expected,
                    const geometry::Matrix6d& of_tail) const;
  // What the acceleration of the last step adds to the pose.
  geometry::Matrix6d AccelerationCovariance() const;
  void ResetBias();
  void ShareBias(double shared);

  PoseFilterOptions options_;
  std::chrono::nanoseconds time_{0};
  std::chrono::nanoseconds last_measured_{0};
  double last_step_s_ = 0.0;
  // In the last step, by the gyroscope.
  bool turn_is_measured_ = false;
  geometry::Rigid3 world_from_camera_;
  Eigen::Vector3d velocity_world_s_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_velocity_world_rad_s_ = Eigen::Vector3d::Zero();
  std::array<geometry::Rigid3, kNumFrames> frames_;
  std::array<bool, kNumFrames> remembered_{};
  geometry::Vector6d bias_ = geometry::Vector6d::Zero();
  GyroscopeErrors gyro_errors_;
  bool expects_sensors_ = false;
  geometry::Vector6d sensor_errors_ = geometry::Vector6d::Zero();
  int size_;
  Covariance covariance_;
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_WINDOW_POSE_FILTER_H_
