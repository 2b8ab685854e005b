// SPDX-License-Identifier: Apache-2.0
// What a localiser answers when a frame succeeds or fails: the state machine
// INITIALIZING -> TRACKED <-> HELD -> LOST -> TRACKED that all localisers
// share, and ODOMETRY beside TRACKED.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_CAMERA_STATE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_CAMERA_STATE_H_

#include <chrono>
#include <cstdint>
#include <optional>

#include "map_store/geometry/rigid3.h"
#include "server/localization/localizer.h"
#include "server/localization/solvers/pose_estimate.h"

namespace groundlock::localization {

// How fast a camera that is not seen may move: the standard deviation of a held
// pose grows by these rates (or by those last observed, if greater), in
// directions unknown. Distances are in scene depths, since a map may lack
// scale.
struct HoldModel {
  double speed_depths_per_s = 0.1;  // walking pace at 15 m
  double turn_rate_rad_per_s = 0.5;
};

// Not thread-safe. Time is the frames' capture time.
class CameraStateMachine {
 public:
  CameraStateMachine(std::chrono::nanoseconds lost_after, const HoldModel& hold)
      : lost_after_(lost_after), hold_(hold) {}

  // The frame at `time` was localised. Sets state, pose, covariance and the
  // count of resets, which it raises if the camera was not known or lost.
  //   depth  typical distance of the landmarks seen, unit of the map.
  //   by_map  else by odometry, from a pose that is known.
  void Succeed(std::chrono::nanoseconds time,
               const geometry::Rigid3& world_from_camera,
               const geometry::Matrix6d& covariance,
               double depth,
               LocalizationResult& result,
               bool by_map = true);
  // The frame at `time` was found to be localised when later ones had come:
  // what is held now comes from there. As Succeed, without an answer; no effect
  // if the last verified pose is newer.
  void Verify(std::chrono::nanoseconds time,
              const geometry::Rigid3& world_from_camera,
              const geometry::Matrix6d& covariance,
              double depth);
  // The frame at `time` was not. Sets state, pose and covariance.
  //   bridged  the pose by other means, reported while the state is HELD;
  //   unset:
  //            the last verified one, with the hold model's uncertainty.
  void Fail(std::chrono::nanoseconds time,
            const std::optional<PoseEstimate>& bridged,
            LocalizationResult& result) const;
  // The next pose does not continue from the one before.
  void NoteJump() { ++reset_count_; }
  // Back to INITIALIZING; the count of resets goes on.
  void Reset() { last_.reset(); }

  struct Success {
    std::chrono::nanoseconds time{0};
    geometry::Rigid3 world_from_camera;
    geometry::Matrix6d covariance = geometry::Matrix6d::Zero();
    double speed_per_s = 0.0;
    double turn_rate_rad_per_s = 0.0;
  };
  // The last verified pose, or that of odometry, however old; unset before the
  // first.
  const std::optional<Success>& last() const { return last_; }

 private:
  friend struct StateFields;

  void Note(std::chrono::nanoseconds time,
            const geometry::Rigid3& world_from_camera,
            const geometry::Matrix6d& covariance,
            double depth);

  std::chrono::nanoseconds lost_after_;
  HoldModel hold_;
  std::optional<Success> last_;
  std::uint64_t reset_count_ = 0;
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_CAMERA_STATE_H_
