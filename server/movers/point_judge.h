// SPDX-License-Identifier: Apache-2.0
// Which points of the field rest, and which go over the ground: judged over a
// window of key views.
#ifndef GROUNDLOCK_SERVER_MOVERS_POINT_JUDGE_H_
#define GROUNDLOCK_SERVER_MOVERS_POINT_JUDGE_H_

#include <cstdint>
#include <deque>
#include <span>
#include <vector>

#include "server/movers/movers.h"
#include "server/movers/point_field.h"
#include "server/movers/point_motion.h"

namespace groundlock::movers {

// Not thread-safe.
class PointJudge {
 public:
  // Is a frame at that time the next key view, if one half a frame early is
  // nearer to the time that is meant than one half a frame late?
  bool IsDue(double time_s, double frame_step_s) const;
  // Notes the camera, and where it sees the points. Forgets those that are off
  // the lens.
  void TakeKeyView(const MoversFrame& frame, std::vector<FieldPoint>& points);
  // Tells each point's kind in the newest key view, and its motion.
  //   sigma_px  of a followed point in the image.
  // Returns kStarting, kWatching or kPoseContradicted.
  MoversState Judge(const MoversFrame& frame,
                    double sigma_px,
                    std::vector<FieldPoint>& points);

  // There is one from the first TakeKeyView on.
  bool empty() const { return keys_.empty(); }
  const KeyView& oldest() const { return keys_.front().view; }
  const KeyView& newest() const { return keys_.back().view; }

 private:
  struct Key {
    KeyView view;
    bool by_odometry = false;
  };
  // The poses' covariances as they count now.
  std::vector<KeyView> ViewsNow() const;
  // Makes it one that moves, if it goes over the ground.
  void TakeMotion(const MoversFrame& frame,
                  std::span<const Sighting> sightings,
                  std::span<const KeyView> views,
                  const PointNoise& noise,
                  FieldPoint& point) const;

  std::deque<Key> keys_;
  std::uint64_t first_key_ = 0;  // number of keys_.front()
  // The variances of sightings as they turn out to be, over those expected.
  double excess_ = 1.0;
};

}  // namespace groundlock::movers

#endif  // GROUNDLOCK_SERVER_MOVERS_POINT_JUDGE_H_
