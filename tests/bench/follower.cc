// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/follower.h"

#include <array>
#include <chrono>
#include <cstdint>
#include <ctime>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/geometry/camera_model.h"
#include "server/image/frame.h"
#include "server/tracking/tracking_session.h"
#include "tests/support/allocation_counter.h"

namespace groundlock::bench {
namespace {

using geometry::Box2;
using target::TargetTracker;

constexpr int kWarmUpFrames = 10;

double ThreadTime_ms() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) +
         1e-6 * static_cast<double>(now.tv_nsec);
}

class BareFollower : public Follower {
 public:
  BareFollower(std::unique_ptr<TargetTracker> tracker, const Box2& box_px)
      : tracker_(std::move(tracker)), box_px_(box_px) {}

  absl::Status Follow(const cv::Mat& image) override {
    found_.tracked.push_back(true);
    if (found_.boxes_px.empty()) {
      RETURN_IF_ERROR(tracker_->Initialize(image, box_px_));
      found_.boxes_px.push_back(box_px_);
      found_.confidences.push_back(1.0);
      return absl::OkStatus();
    }
    const std::uint64_t heap_before = test_support::HeapBytesInUse();
    const std::uint64_t allocations_before = test_support::AllocationCount();
    const double start_ms = ThreadTime_ms();
    ASSIGN_OR_RETURN(const target::TargetObservation seen,
                     tracker_->Detect(image, /*fixed_size=*/false));
    tracker_->Learn(image);
    const double end_ms = ThreadTime_ms();
    if (found_.boxes_px.size() >= kWarmUpFrames) {
      allocations_ += test_support::AllocationCount() - allocations_before;
      // A difference of unsigned numbers: a heap that shrank counts negative.
      grown_ += static_cast<std::int64_t>(test_support::HeapBytesInUse() -
                                          heap_before);
      ++counted_;
      found_.allocations = static_cast<double>(allocations_) / counted_;
      found_.grown_bytes = static_cast<double>(grown_);
    }
    if (seen.confidence > 0.0) found_.times_ms.push_back(end_ms - start_ms);
    found_.boxes_px.push_back(seen.box_px);
    found_.confidences.push_back(seen.confidence);
    return absl::OkStatus();
  }

 private:
  std::unique_ptr<TargetTracker> tracker_;
  Box2 box_px_;
  std::uint64_t allocations_ = 0;
  std::int64_t grown_ = 0;
  int counted_ = 0;
};

class SessionFollower : public Follower {
 public:
  SessionFollower(std::string tracker_name,
                  const Box2& box_px,
                  double frames_per_second)
      : tracker_name_(std::move(tracker_name)),
        box_px_(box_px),
        step_(std::chrono::duration_cast<std::chrono::nanoseconds>(
            std::chrono::duration<double>(1.0 / frames_per_second))) {}

  absl::Status Follow(const cv::Mat& image) override {
    image::Frame frame = image::Frame::FromBgr(image.clone());
    frame.sequence = found_.boxes_px.size();
    frame.capture_time = static_cast<int>(frame.sequence) * step_;
    if (session_ == nullptr) RETURN_IF_ERROR(Open(frame.size_px()));
    const double start_ms = ThreadTime_ms();
    ASSIGN_OR_RETURN(const tracking::FrameResult result,
                     session_->ProcessFrame(frame, std::nullopt, nullptr));
    found_.times_ms.push_back(ThreadTime_ms() - start_ms);
    if (result.targets.empty() || !result.targets[0].box_px) {
      return absl::InternalError(
          absl::StrCat("frame ", frame.sequence, " has no box"));
    }
    found_.boxes_px.push_back(*result.targets[0].box_px);
    found_.confidences.push_back(result.targets[0].confidence);
    found_.tracked.push_back(result.targets[0].state ==
                             tracking::TargetState::kTracked);
    return absl::OkStatus();
  }

 private:
  absl::Status Open(const cv::Size& size) {
    const std::array<double, 3> lens = {
        1000.0, 0.5 * size.width, 0.5 * size.height};
    ASSIGN_OR_RETURN(
        const geometry::CameraModel camera,
        geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                      size.width,
                                      size.height,
                                      lens));
    tracking::SessionOptions options;
    options.tracker.name = tracker_name_;
    ASSIGN_OR_RETURN(
        session_,
        tracking::TrackingSession::Create(
            nullptr, ground::MakePlaneSurface({}), camera, options));
    return session_->SetTarget("1", box_px_, {});
  }

  std::string tracker_name_;
  Box2 box_px_;
  std::chrono::nanoseconds step_;
  std::unique_ptr<tracking::TrackingSession> session_;
};

}  // namespace

std::unique_ptr<Follower> FollowBare(std::unique_ptr<TargetTracker> tracker,
                                     const Box2& box_px) {
  return std::make_unique<BareFollower>(std::move(tracker), box_px);
}

std::unique_ptr<Follower> FollowInSession(const std::string& tracker,
                                          const Box2& box_px,
                                          double frames_per_second) {
  return std::make_unique<SessionFollower>(tracker, box_px, frames_per_second);
}

}  // namespace groundlock::bench
