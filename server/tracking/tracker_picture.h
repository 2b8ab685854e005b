// SPDX-License-Identifier: Apache-2.0
// The part of a frame that a 2D tracker looks at, as it is shown to it.
#ifndef GROUNDLOCK_SERVER_TRACKING_TRACKER_PICTURE_H_
#define GROUNDLOCK_SERVER_TRACKING_TRACKER_PICTURE_H_

#include <Eigen/Core>
#include <chrono>
#include <opencv2/core/mat.hpp>

#include "map_store/geometry/box.h"
#include "server/image/frame.h"
#include "server/target/target_tracker.h"

namespace groundlock::tracking {

// How a target lies in the image, in comparison with how its tracker knows it.
struct PatchTurn {
  double angle_rad = 0.0;  // clockwise
  // Of the target's box where it is not turned, in that of the image.
  Eigen::Vector2d size_ratio = Eigen::Vector2d::Ones();
};

// As coarse as the tracker can do with, and turned back by as much as the
// target is turned. Not thread-safe.
class TrackerPicture {
 public:
  // The frame about `box_px`, where the tracker looks next. Trackers that want
  // all of an image get it as it is.
  void Show(const image::Frame& frame,
            const target::TargetTracker& tracker,
            const geometry::Box2& box_px,
            const PatchTurn& turn);

  // Boxes, places and covariances of the image in that picture, and back.
  geometry::Box2 ToTracker(const geometry::Box2& box_px) const;
  geometry::Box2 FromTracker(const geometry::Box2& box_px) const;
  Eigen::Vector2d ToTracker(const Eigen::Vector2d& p_px) const;
  Eigen::Matrix2d ToTracker(const Eigen::Matrix2d& covariance_px2) const;

  // Is `box_px` of the image in the picture that was last shown, and that of
  // `frame`? One that is turned shows but what is about the box it was drawn
  // for.
  bool Holds(const image::Frame& frame, const geometry::Box2& box_px) const;
  // The picture, whose pixels are there as far as `read_px` (of it) says, and
  // the frame, which is the one last shown, does.
  const cv::Mat& Within(const image::Frame& frame,
                        const geometry::Box2& read_px) const;

 private:
  friend struct StateFields;

  bool IsTurned() const { return turn_.angle_rad != 0.0; }
  // Draws the turned picture of a frame.
  void Draw(const image::Frame& frame);

  int halvings_ = 0;
  PatchTurn turn_;
  // If turned: the middle in the halved frame, that of the picture, and what
  // the picture's axes are in the frame.
  Eigen::Vector2d middle_px_ = Eigen::Vector2d::Zero();
  Eigen::Vector2d picture_middle_px_ = Eigen::Vector2d::Zero();
  Eigen::Matrix2d frame_from_picture_ = Eigen::Matrix2d::Identity();
  Eigen::Matrix2d picture_from_frame_ = Eigen::Matrix2d::Identity();
  double coarser_ = 1.0;  // its pixels than those of the halved frame
  cv::Mat picture_;
  std::chrono::nanoseconds drawn_{0};  // of which frame
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_TRACKER_PICTURE_H_
