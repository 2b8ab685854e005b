// SPDX-License-Identifier: Apache-2.0
// What moves against its background near a target.
#ifndef GROUNDLOCK_SERVER_TRACKING_MOTION_SALIENCY_H_
#define GROUNDLOCK_SERVER_TRACKING_MOTION_SALIENCY_H_

#include <Eigen/Core>
#include <chrono>
#include <deque>
#include <optional>
#include <vector>

#include "map_store/geometry/box.h"
#include "server/image/frame.h"
#include "server/tracking/background_motion.h"
#include "server/tracking/picture_difference.h"

namespace groundlock::tracking {

// Differences from two earlier pictures, each brought to where the background
// is now: what differs from both is there now and was not before (three-frame
// differencing: Lipton, Fujiyoshi, Patil 1998, "Moving target classification
// and tracking from real-time video"). How a target looks does not matter: it
// is told from a kerb, a palm or a lamp that it passes, which looks tell badly.
// Shares of the box's area that differ say how much of a target moves; they are
// compared with what the same target showed while it was seen.
//
// A slow target stands where it was, and its rim alone differs. Where the
// background's motion is known for seconds, a third picture, from before the
// target came, tells all of it.
//
// Pixels of the whole image, the first one's centre at (0.5, 0.5). Not
// thread-safe. Holds some 35 pictures of less than 0.1 MB.
class MotionSaliency {
 public:
  // What is marked: whether it moves, later pictures tell.
  void Restart(const image::Frame& frame, const geometry::Box2& box_px);
  // The next frame. `background`: its motion since the last one; nullopt:
  // nothing is known until there are new pictures. `background_is_known`: by
  // the camera's poses, not measured from frame to frame, so that it still
  // holds after seconds. `expected_px` and `last_px`: about where ShareAt will
  // be asked of.
  void Add(const image::Frame& frame,
           const std::optional<ImageAffinity>& background,
           bool background_is_known,
           const geometry::Box2& expected_px,
           const geometry::Box2& last_px);

  struct Spot {
    geometry::Box2 box_px;
    double share = 0.0;  // of its area that moves
    Eigen::Vector2d velocity_px_s = Eigen::Vector2d::Zero();  // on background
    bool is_whole = false;    // all of the target differs, not its rim alone
    bool has_gone_on = true;  // it is past where the target was
  };
  // Where what moved in the target's box has gone, followed by nothing but its
  // motion. nullopt: it has stopped, or the target is not known to move.
  std::optional<Spot> spot() const;
  // Which share of the box moves; nullopt: as is not known.
  std::optional<double> ShareAt(const geometry::Box2& box_px) const;
  // The target is taken to be there in the frame last added.
  void Mark(const geometry::Box2& box_px);
  // It is surely there: what moves there is the target.
  void Learn(const geometry::Box2& box_px);

 private:
  friend struct StateFields;

  // Does what was marked move? Told by what has come to where it was.
  void JudgeFirst(const Picture& now);
  // Where the target stood in it, as seen now, with a rim.
  static std::optional<geometry::Box2> TargetIn(const Picture& picture);
  // The earlier pictures that tell what moves now: one that is so old, that of
  // half its age, and, if there is such a one, one from before the target came
  // to where it is expected; then none of them tells of where it stood itself.
  // Empty: nothing is known yet.
  std::vector<OtherPicture> Choose(const geometry::Box2& target_px) const;
  // Is it past where the target was in two of those? What a slow target
  // uncovers, or one that vanishes, differs from both as well, and lies between
  // its places there.
  static bool HasGoneOn(const std::vector<OtherPicture>& others,
                        const geometry::Box2& box_px);
  // What moves like the target, no farther than `reach_px` from where its box
  // is expected.
  std::optional<Spot> FindNear(const geometry::Box2& expected_px,
                               double reach_px) const;
  void FollowTrace(const std::vector<OtherPicture>& others,
                   bool background_is_known,
                   const geometry::Box2& last_px);
  void Note(double share,
            const std::optional<Eigen::Vector2d>& middle_px,
            const geometry::Box2& box_px,
            double rate);

  struct Trace {
    Spot spot;
    std::chrono::nanoseconds found{0};  // when it was last found
  };

  std::deque<Picture> pictures_;  // the oldest first
  std::deque<Picture> long_ago_;  // older than those, and fewer
  std::optional<Picture> first_;
  geometry::Box2 first_box_px_;
  std::optional<Difference> now_;  // of the frame last added: not carried
  std::optional<Trace> trace_;
  std::chrono::nanoseconds time_{0};
  std::chrono::nanoseconds learnt_{0};
  // Of the target while it is seen.
  double share_ = 0.0;
  // From the middle of its box to that of what moves, in sides.
  Eigen::Vector2d offset_sides_ = Eigen::Vector2d::Zero();
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_MOTION_SALIENCY_H_
