// SPDX-License-Identifier: Apache-2.0
// Control logic with the real 2D tracker on a small drawn scene and a known
// camera.
#include "server/tracking/tracking_session.h"

#include <gtest/gtest.h>

#include <limits>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "server/ground/box_fit.h"
#include "server/tracking/search_places.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::CameraModel;
using std::chrono::milliseconds;

// Looks along +y from 2 m over the ground, a little down.
class KnownCamera : public localization::Localizer {
 public:
  static geometry::Rigid3 Pose() {
    Eigen::Matrix3d level;
    level << Eigen::Vector3d::UnitX(), -Eigen::Vector3d::UnitZ(),
        Eigen::Vector3d::UnitY();
    return {Eigen::Quaterniond(level) *
                Eigen::AngleAxisd(-0.3, Eigen::Vector3d::UnitX()),
            {0.0, 0.0, 2.0}};
  }
  absl::StatusOr<localization::LocalizationResult> Localize(
      const localization::LocalizationRequest&) override {
    localization::LocalizationResult result;
    result.state = localization::CameraState::kTracked;
    result.world_from_camera = Pose();
    return result;
  }
  void Reset() override {}
};

CameraModel TestCamera() {
  const std::array<double, 3> params = {500.0, 320.0, 240.0};
  return *CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 640, 480, params);
}

Box2 TargetBox(double x_m) {
  const CameraModel camera = TestCamera();
  const ground::GroundView view{&camera, KnownCamera::Pose(), {}};
  return *ground::ProjectBodyHull(
      view,
      ground::UprightBox(
          {}, {x_m, 6.0, 0.0}, Eigen::Vector3d::UnitX(), {1.0, 0.6, 0.6}));
}

// Gray noise, a red and blue target, and a gray wall before it if asked for.
image::Frame Draw(std::uint64_t sequence, const Box2& target_px, bool hidden) {
  cv::Mat bgr(480, 640, CV_8UC3);
  cv::RNG rng(7);
  rng.fill(bgr, cv::RNG::UNIFORM, cv::Scalar::all(90), cv::Scalar::all(150));
  cv::GaussianBlur(bgr, bgr, {}, 1.5);
  const cv::Rect2d box(
      target_px.x(), target_px.y(), target_px.width(), target_px.height());
  if (!hidden) {
    cv::rectangle(bgr, box, {30, 30, 220}, cv::FILLED);
    cv::rectangle(
        bgr,
        cv::Rect2d(
            box.x + 0.3 * box.width, box.y, 0.3 * box.width, 0.6 * box.height),
        {230, 60, 20},
        cv::FILLED);
  }
  image::Frame frame = image::Frame::FromBgr(bgr);
  frame.sequence = sequence;
  frame.capture_time = milliseconds(40 * sequence);
  return frame;
}

std::unique_ptr<TrackingSession> MakeSession(bool with_camera,
                                             SessionOptions options = {}) {
  std::unique_ptr<localization::Localizer> localizer;
  if (with_camera) localizer = std::make_unique<KnownCamera>();
  return *TrackingSession::Create(
      std::move(localizer), geometry::Plane{}, TestCamera(), options);
}

TEST(TrackingSession, KeepsAHiddenTargetOnItsWayAndFindsItAgain) {
  SessionOptions options;
  options.target_lost_after = milliseconds(400);
  const auto session = MakeSession(true, options);
  ASSERT_TRUE(session->SetTarget("car", TargetBox(-1.5), {}).ok());
  TargetState last = TargetState::kLost;
  bool was_lost = false;
  for (std::uint64_t i = 0; i < 70; ++i) {
    const double x_m = -1.5 + 0.04 * static_cast<double>(i);
    const bool hidden = i >= 40 && i < 55;
    const auto result =
        session->ProcessFrame(Draw(i, TargetBox(x_m), hidden), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    ASSERT_EQ(result->targets.size(), 1U);
    const TargetResult& target = result->targets[0];
    ASSERT_TRUE(target.box_world);
    const Eigen::Vector3d p = target.box_world->BottomCenterWorld();
    // A flat drawing of a box 1 m long: within half its length.
    EXPECT_LT((p - Eigen::Vector3d(x_m, 6.0, 0.0)).norm(), 0.5) << i;
    if (hidden && i >= 41) {
      EXPECT_NE(target.state, TargetState::kTracked) << i;
    }
    was_lost = was_lost || target.state == TargetState::kLost;
    last = target.state;
  }
  EXPECT_TRUE(was_lost);  // hidden for 600 ms, lost after 400 ms
  EXPECT_EQ(last, TargetState::kTracked);
}

TEST(TrackingSession, WithoutACameraPoseTracksInTheImage) {
  const auto session = MakeSession(false);
  ASSERT_TRUE(session->SetTarget("a", TargetBox(-1.0), 2).ok());
  for (std::uint64_t i = 0; i < 10; ++i) {
    const Box2 box = TargetBox(-1.0 + 0.03 * static_cast<double>(i));
    const auto result = session->ProcessFrame(Draw(i, box, false), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    ASSERT_EQ(result->targets.size(), i < 2 ? 0U : 1U);
    if (i < 3) continue;
    EXPECT_FALSE(result->targets[0].box_world);
    EXPECT_EQ(result->targets[0].state, TargetState::kTracked);
  }
}

TEST(TrackingSession, BadInputIsToldAndTheSessionLivesOn) {
  SessionOptions options;
  options.max_targets = 1;
  const auto session = MakeSession(true, options);
  EXPECT_EQ(session->SetTarget("a", Box2::FromXywh(1, 1, 0, 5), {}).code(),
            absl::StatusCode::kInvalidArgument);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(session->SetTarget("a", Box2::FromXywh(nan, 1, 5, 5), {}).code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(session->MoveTarget("a", TargetBox(0)).code(),
            absl::StatusCode::kNotFound);
  EXPECT_EQ(session->DropTarget("a").code(), absl::StatusCode::kNotFound);
  ASSERT_TRUE(session->SetTarget("a", Box2::FromXywh(900, 0, 9, 9), {}).ok());
  EXPECT_EQ(session->SetTarget("b", TargetBox(0), {}).code(),
            absl::StatusCode::kResourceExhausted);
  std::vector<absl::Status> errors;
  ASSERT_TRUE(
      session->ProcessFrame(Draw(5, TargetBox(0), false), {}, &errors).ok());
  ASSERT_EQ(errors.size(), 1U);
  EXPECT_NE(errors[0].message().find("'a'"), absl::string_view::npos);
  EXPECT_TRUE(session->TargetIds().empty());
  // Backwards in time; wrong size; no pixels.
  EXPECT_FALSE(
      session->ProcessFrame(Draw(4, TargetBox(0), false), {}, nullptr).ok());
  image::Frame small = Draw(6, TargetBox(0), false);
  small.luma = small.luma(cv::Rect(0, 0, 64, 48)).clone();
  EXPECT_FALSE(session->ProcessFrame(small, {}, nullptr).ok());
  EXPECT_FALSE(session->ProcessFrame({}, {}, nullptr).ok());
  EXPECT_TRUE(
      session->ProcessFrame(Draw(7, TargetBox(0), false), {}, nullptr).ok());
  options.tracker.name = "crystal ball";
  EXPECT_FALSE(
      TrackingSession::Create(nullptr, geometry::Plane{}, TestCamera(), options)
          .ok());
}

TEST(SearchOffsets, CoverTheEllipseNearestFirstAndAreBounded) {
  Eigen::Matrix2d covariance;
  covariance << 900.0, 0.0, 0.0, 4.0;
  const auto offsets = SearchOffsets({40.0, 40.0}, covariance);
  ASSERT_FALSE(offsets.empty());
  EXPECT_NEAR(offsets[0].norm(), 20.0, 1e-9);
  for (const Eigen::Vector2d& offset : offsets) {
    EXPECT_LE(std::abs(offset.x()), 61.0);
    EXPECT_DOUBLE_EQ(offset.y(), 0.0);
  }
  EXPECT_LE(SearchOffsets({4.0, 4.0}, 1e12 * covariance).size(),
            static_cast<std::size_t>(kMaxSearchPlaces));
  EXPECT_TRUE(SearchOffsets({0.0, 0.0}, covariance).empty());
}

}  // namespace
}  // namespace groundlock::tracking
