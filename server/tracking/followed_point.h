// SPDX-License-Identifier: Apache-2.0
// How well it is known which point of a target's body a 2D tracker follows.
#ifndef GROUNDLOCK_SERVER_TRACKING_FOLLOWED_POINT_H_
#define GROUNDLOCK_SERVER_TRACKING_FOLLOWED_POINT_H_

#include <Eigen/Core>
#include <chrono>
#include <optional>

namespace groundlock::tracking {

// A tracker that learns goes from one point of a body to another as the body is
// seen from another side, and hardly where it is not. Where the body is that is
// told by that point is so known ever less; what sees the body itself, as its
// silhouette, tells it anew. The variance of a random walk (docs/method.md,
// "Its silhouette"). Not thread-safe.
class FollowedPoint {
 public:
  // A fit to points of the body told where it is: fits share most of their
  // points, and err alike. Returns for how much this one counts beside what was
  // known, all of it if it is the first one, or nothing links it to that.
  double TellByFit(std::chrono::nanoseconds time, bool is_linked);
  // The body is followed, and at that time seen from there.
  //   to_eye  a unit vector in axes that turn with the body.
  void Follow(const Eigen::Vector3d& to_eye, std::chrono::nanoseconds time);
  // What sees the body left so much of the variance.
  void Tell(double share) { variance_ *= share; }
  // Of the point's place in either direction of the image, in squared sides of
  // the body's outline.
  double variance() const { return variance_; }

 private:
  friend struct StateFields;

  // The point is 15 % of the outline's side from where it is taken to be, if
  // nothing told it.
  static constexpr double kAnyVariance = 0.15 * 0.15;

  // At first it is the middle of the box that was drawn. People leave more on
  // one side than on the other (UAV123's truck4: 4 and 10 % of its width).
  static constexpr double kDrawnVariance = 0.05 * 0.05;

  double variance_ = kDrawnVariance;
  std::optional<Eigen::Vector3d> to_eye_;  // when it last had turned
  std::chrono::nanoseconds time_{0};       // when it was last followed
  std::optional<std::chrono::nanoseconds> fit_time_;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_FOLLOWED_POINT_H_
