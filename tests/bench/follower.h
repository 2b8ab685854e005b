// SPDX-License-Identifier: Apache-2.0
// What follows a target through a sequence, and what it has found and cost.
#ifndef GROUNDLOCK_TESTS_BENCH_FOLLOWER_H_
#define GROUNDLOCK_TESTS_BENCH_FOLLOWER_H_

#include <memory>
#include <opencv2/core/mat.hpp>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "map_store/geometry/box.h"
#include "server/target/target_tracker.h"

namespace groundlock::bench {

// Per frame, but for the costs.
struct Found {
  std::vector<geometry::Box2> boxes_px;
  std::vector<double> confidences;
  std::vector<bool> tracked;
  // The thread's processor time, of frames where there was something to look
  // at.
  std::vector<double> times_ms;
  double allocations = 0.0;  // per update, once it has warmed up
  double grown_bytes = 0.0;  // of the heap
};

// Follows one sequence's target.
class Follower {
 public:
  virtual ~Follower() = default;
  // The first image is that in which the target was marked.
  virtual absl::Status Follow(const cv::Mat& image) = 0;
  const Found& found() const { return found_; }

 protected:
  Found found_;
};

// By a tracker alone, which learns whenever its own gate lets it.
std::unique_ptr<Follower> FollowBare(
    std::unique_ptr<target::TargetTracker> tracker,
    const geometry::Box2& box_px);
// Through a tracking session without a map, as a server runs it.
std::unique_ptr<Follower> FollowInSession(const std::string& tracker,
                                          const geometry::Box2& box_px,
                                          double frames_per_second);

}  // namespace groundlock::bench

#endif  // GROUNDLOCK_TESTS_BENCH_FOLLOWER_H_
