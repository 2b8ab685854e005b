// SPDX-License-Identifier: Apache-2.0
// One target's control logic (Robinson 2014, §3.1, §3.7): predict on the
// ground, look there in the image, believe or not, lift back to the ground.
#ifndef GROUNDLOCK_SERVER_TRACKING_TARGET_TRACK_H_
#define GROUNDLOCK_SERVER_TRACKING_TARGET_TRACK_H_

#include <Eigen/Core>
#include <chrono>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "server/image/frame.h"
#include "server/target/target_tracker.h"
#include "server/tracking/ground_target.h"
#include "server/tracking/tracking_session.h"

namespace groundlock::tracking {

// Not thread-safe. `options` outlives it.
class TargetTrack {
 public:
  // Starts on the target in box_px of `frame`. Errors as
  // TargetTracker::Initialize.
  //   camera  null without a camera pose: the target gets its place on the
  //     ground in the first frame that has one and sees it.
  static absl::StatusOr<std::unique_ptr<TargetTrack>> Start(
      const std::string& id,
      const image::Frame& frame,
      const CameraView* camera,
      const geometry::Box2& box_px,
      const SessionOptions& options);

  const std::string& id() const { return id_; }
  // The frame in which it was started: nothing to look for.
  TargetResult StartResult(const CameraView* camera) const;
  // Where it will be at `time`, without changing anything: the place that
  // localisation leaves out.
  std::optional<geometry::Box2> ExpectedBox(
      const CameraView* camera, std::chrono::nanoseconds time) const;
  // Where to look in the next frame.
  void Move(const geometry::Box2& box_px);
  absl::StatusOr<TargetResult> Process(const image::Frame& frame,
                                       const CameraView* camera);

 private:
  struct Look {
    target::TargetObservation observation;
    std::optional<GroundSighting> sighting;
    bool believed = false;
  };

  TargetTrack(std::string id, const SessionOptions& options);

  // Where the ground model predicts the target.
  absl::StatusOr<Look> LookFromGround(const image::Frame& frame,
                                      const CameraView& camera);
  // Where it was last seen in the image, or moved to.
  absl::StatusOr<Look> LookInImage(const image::Frame& frame,
                                   const CameraView* camera);
  absl::StatusOr<Look> LookAt(const image::Frame& frame,
                              const CameraView& camera,
                              const geometry::Box2& box_px,
                              double min_confidence);
  // Other places within the prediction's covariance, some in each frame.
  absl::StatusOr<Look> Search(const image::Frame& frame,
                              const CameraView& camera,
                              const geometry::Box2& predicted_px);
  // The frame in colour, as far as the tracker looks at it from `box_px`.
  const cv::Mat& ImageAround(const image::Frame& frame,
                             const geometry::Box2& box_px) const;
  void Believe(const image::Frame& frame,
               const CameraView* camera,
               const Look& look);
  TargetResult MakeResult(const CameraView* camera, double confidence) const;

  std::string id_;
  const SessionOptions* options_;
  std::unique_ptr<target::TargetTracker> tracker_;
  std::optional<GroundTarget> ground_;
  bool ground_current_ = false;  // the ground model has the last sighting
  geometry::Box2 box_px_;        // last seen or placed
  bool moved_ = false;           // box_px_ was set from outside
  std::chrono::nanoseconds time_{0};
  std::chrono::nanoseconds last_seen_{0};
  int frames_seen_ = 0;  // in a row, up to the last frame
  std::size_t search_start_ = 0;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_TARGET_TRACK_H_
