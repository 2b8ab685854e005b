// SPDX-License-Identifier: Apache-2.0
// A session looks for movers if it is asked to and can, and says why if not.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <chrono>
#include <cstdint>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <utility>

#include "server/tracking/tracking_session.h"

namespace groundlock::tracking {
namespace {

using localization::CameraState;
using movers::MoversState;

// A camera whose state somebody sets.
class SetCamera : public localization::Localizer {
 public:
  explicit SetCamera(const CameraState* state) : state_(state) {}
  absl::StatusOr<localization::LocalizationResult> Localize(
      const localization::LocalizationRequest&) override {
    localization::LocalizationResult result;
    result.state = *state_;
    result.world_from_camera = geometry::Rigid3{
        Eigen::Quaterniond(Eigen::AngleAxisd(-2.0, Eigen::Vector3d::UnitX())),
        {0.0, 0.0, 2.0}};
    return result;
  }
  void Reset() override {}

 private:
  const CameraState* state_;
};

geometry::CameraModel Camera() {
  const std::array<double, 3> params = {100.0, 80.0, 60.0};
  return *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 160, 120, params);
}

MoversState StateOfNextFrame(TrackingSession& session, std::uint64_t sequence) {
  image::Frame frame =
      image::Frame::FromBgr(cv::Mat(120, 160, CV_8UC3, cv::Scalar::all(90)));
  frame.sequence = sequence;
  frame.capture_time = std::chrono::milliseconds(40 * sequence);
  const auto result = session.ProcessFrame(frame, std::nullopt, nullptr);
  EXPECT_TRUE(result.ok()) << result.status();
  return result.ok() ? result->movers.state : MoversState::kNotAsked;
}

TEST(SessionMovers, AreLookedForOnlyIfAskedFor) {
  CameraState state = CameraState::kTracked;
  for (const bool asked : {false, true}) {
    SessionOptions options;
    options.report_movers = asked;
    const auto session =
        *TrackingSession::Create(std::make_unique<SetCamera>(&state),
                                 ground::MakePlaneSurface({}),
                                 Camera(),
                                 options);
    EXPECT_EQ(StateOfNextFrame(*session, 0),
              asked ? MoversState::kStarting : MoversState::kNotAsked);
  }
}

TEST(SessionMovers, SayThatThereIsNoMap) {
  SessionOptions options;
  options.report_movers = true;
  const auto session = *TrackingSession::Create(
      std::shared_ptr<const map::Map>(), Camera(), options);
  EXPECT_EQ(StateOfNextFrame(*session, 0), MoversState::kNoMap);
}

TEST(SessionMovers, SayThatTheCameraHasNoPoseOrIsUnderTheGround) {
  CameraState state = CameraState::kHeld;
  SessionOptions options;
  options.report_movers = true;
  const auto session =
      *TrackingSession::Create(std::make_unique<SetCamera>(&state),
                               ground::MakePlaneSurface({}),
                               Camera(),
                               options);
  EXPECT_EQ(StateOfNextFrame(*session, 0), MoversState::kNoPose);
  state = CameraState::kOdometry;
  EXPECT_EQ(StateOfNextFrame(*session, 1), MoversState::kStarting);
  // A ground 5 m up.
  const auto buried = *TrackingSession::Create(
      std::make_unique<SetCamera>(&state),
      ground::MakePlaneSurface({Eigen::Vector3d::UnitZ(), -5.0}),
      Camera(),
      options);
  EXPECT_EQ(StateOfNextFrame(*buried, 0), MoversState::kNoGround);
}

}  // namespace
}  // namespace groundlock::tracking
