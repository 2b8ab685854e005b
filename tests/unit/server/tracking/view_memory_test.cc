// SPDX-License-Identifier: Apache-2.0
// What a target looks like from each side, and what it is good for: a box with
// a texture of its own on each side, drawn from a camera that goes round it.
#include "server/tracking/view_memory.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "server/tracking/tracking_session.h"
#include "tests/support/drawn_scene.h"
#include "tests/support/perturbation.h"

namespace groundlock::tracking {
namespace {

using geometry::CameraModel;
using std::chrono::milliseconds;

constexpr double kDegree = EIGEN_PI / 180.0;

// Keeps the number it was told.
struct NumberedAppearance : target::Appearance {
  int number = 0;
};
class NumberedTracker : public target::TargetTracker {
 public:
  absl::Status Initialize(const cv::Mat&, const geometry::Box2&) override {
    return absl::OkStatus();
  }
  void Place(const geometry::Box2&) override {}
  absl::StatusOr<target::TargetObservation> Detect(const cv::Mat&,
                                                   bool) override {
    return target::TargetObservation{};
  }
  void Learn(const cv::Mat&) override {}
  void Keep(std::unique_ptr<target::Appearance>& kept) const override {
    if (kept == nullptr) kept = std::make_unique<NumberedAppearance>();
    dynamic_cast<NumberedAppearance&>(*kept).number = number;
  }
  int number = 0;
};

std::vector<int> Numbers(
    const std::vector<const target::Appearance*>& appearances) {
  std::vector<int> numbers;
  for (const auto* appearance : appearances) {
    numbers.push_back(
        dynamic_cast<const NumberedAppearance*>(appearance)->number);
  }
  return numbers;
}

TEST(ViewMemory, KeepsTheViewNearestToEachSectorsMiddle) {
  ViewMemory memory(8);
  NumberedTracker tracker;
  const auto at = [&](int degrees) {
    tracker.number = degrees;
    memory.Remember(degrees * kDegree, milliseconds(10 * degrees), tracker);
  };
  EXPECT_TRUE(memory.Recall(0.0, milliseconds(0)).empty());
  for (int degrees = -180; degrees <= 170; degrees += 4) at(degrees);
  // The middles are at multiples of 45 degrees.
  EXPECT_EQ(Numbers(memory.Recall(0.0, milliseconds(0)))[0], 0);
  EXPECT_EQ(Numbers(memory.Recall(50.0 * kDegree, milliseconds(0)))[0], 44);
  EXPECT_EQ(Numbers(memory.Recall(7.1, milliseconds(0)))[0], 44);
  // Back in a sector it is kept anew; a view that goes to and fro over an edge
  // does not change sectors.
  at(24);
  at(20);
  at(24);
  EXPECT_EQ(Numbers(memory.Recall(45.0 * kDegree, milliseconds(0)))[0], 24);
  EXPECT_EQ(Numbers(memory.Recall(0.0, milliseconds(0)))[0], 0);
}

TEST(ViewMemory, RecallsTheNearestAndTheOthersInTurn) {
  ViewMemory memory(4);
  NumberedTracker tracker;
  for (int i = 0; i < 4; ++i) {
    tracker.number = i;
    memory.Remember(90.0 * i * kDegree, milliseconds(i), tracker);
  }
  // It had no time to turn.
  EXPECT_EQ(Numbers(memory.Recall(10.0 * kDegree, milliseconds(0))),
            std::vector<int>{0});
  std::vector<int> seconds;
  for (int frame = 0; frame < 3; ++frame) {
    const auto numbers =
        Numbers(memory.Recall(10.0 * kDegree, milliseconds(60'000)));
    ASSERT_EQ(numbers.size(), 2U);
    EXPECT_EQ(numbers[0], 0);
    seconds.push_back(numbers[1]);
  }
  std::sort(seconds.begin(), seconds.end());
  EXPECT_EQ(seconds, (std::vector<int>{1, 2, 3}));
  EXPECT_EQ(memory.Recall(std::nullopt, milliseconds(0)).size(), 2U);
  ViewMemory none(0);
  none.Remember(0.0, milliseconds(0), tracker);
  EXPECT_TRUE(none.Recall(0.0, milliseconds(0)).empty());
  memory.Remember(std::nan(""), milliseconds(0), tracker);
}

// Goes round the origin, 4 m away and 1.6 m over the ground.
geometry::Rigid3 OrbitPose(double angle_rad) {
  const Eigen::Vector3d eye(
      4.0 * std::cos(angle_rad), 4.0 * std::sin(angle_rad), 1.6);
  const Eigen::Vector3d forward =
      (Eigen::Vector3d(0.0, 0.0, 0.3) - eye).normalized();
  const Eigen::Vector3d right =
      forward.cross(Eigen::Vector3d::UnitZ()).normalized();
  Eigen::Matrix3d R;
  R << right, forward.cross(right), forward;
  return {Eigen::Quaterniond(R), eye};
}

class OrbitCamera : public localization::Localizer {
 public:
  explicit OrbitCamera(const double* angle_rad) : angle_rad_(angle_rad) {}
  absl::StatusOr<localization::LocalizationResult> Localize(
      const localization::LocalizationRequest&) override {
    localization::LocalizationResult result;
    result.state = localization::CameraState::kTracked;
    result.world_from_camera = OrbitPose(*angle_rad_);
    return result;
  }
  void Reset() override {}

 private:
  const double* angle_rad_;
};

// 1 x 0.6 x 0.6 m at the origin, each side with a texture of its own.
class DrawnBox {
 public:
  explicit DrawnBox(const CameraModel& camera) : camera_(camera) {
    const std::vector<cv::Scalar> tints = {{0.3, 0.3, 1.0},
                                           {1.0, 0.4, 0.2},
                                           {0.2, 0.9, 0.3},
                                           {0.2, 0.9, 1.0},
                                           {0.6, 0.6, 0.6}};
    for (std::size_t i = 0; i < tints.size(); ++i) {
      sides_.push_back(
          test_support::Texture(kSide, kSide, 10 + i, 3.0).mul(tints[i]));
    }
  }

  image::Frame Draw(double angle_rad, bool hidden) const {
    cv::Mat bgr = background_.clone();
    for (std::size_t i = 0; i < sides_.size() && !hidden; ++i) {
      DrawSide(angle_rad, static_cast<int>(i), bgr);
    }
    return image::Frame::FromBgr(test_support::Perturbed(bgr));
  }
  // On the ground.
  Eigen::Vector3d place = Eigen::Vector3d::Zero();

  geometry::Box2 Outline(double angle_rad) const {
    geometry::Box2 outline;
    outline.min_px.setConstant(1e9);
    outline.max_px.setConstant(-1e9);
    for (int side = 0; side < 5; ++side) {
      for (const cv::Point2f& p : Corners(angle_rad, side)) {
        const Eigen::Vector2d corner_px(p.x, p.y);
        outline.min_px = outline.min_px.cwiseMin(corner_px);
        outline.max_px = outline.max_px.cwiseMax(corner_px);
      }
    }
    return outline;
  }

 private:
  static constexpr int kSide = 60;

  // Outwards; the fifth is the top.
  static Eigen::Vector3d Normal(int side) {
    if (side == 4) return Eigen::Vector3d::UnitZ();
    return {std::round(std::cos(90.0 * side * kDegree)),
            std::round(std::sin(90.0 * side * kDegree)),
            0.0};
  }
  std::vector<cv::Point2f> Corners(double angle_rad, int side) const {
    const Eigen::Vector3d out = Normal(side);
    const Eigen::Vector3d up =
        side == 4 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d right = up.cross(out);
    std::vector<cv::Point2f> corners;
    for (const auto& [r, u] : {std::pair(-1, 1), {1, 1}, {1, -1}, {-1, -1}}) {
      const Eigen::Vector3d corner =
          (out + r * right + u * up)
              .cwiseProduct(Eigen::Vector3d(0.5, 0.3, 0.3)) +
          Eigen::Vector3d(0.0, 0.0, 0.3) + place;
      const Eigen::Vector2d pixel =
          *camera_.ImageFromCamera(OrbitPose(angle_rad).Inverse() * corner);
      corners.emplace_back(pixel.x(), pixel.y());
    }
    return corners;
  }
  void DrawSide(double angle_rad, int side, cv::Mat& bgr) const {
    const Eigen::Vector3d middle =
        Normal(side).cwiseProduct(Eigen::Vector3d(0.5, 0.3, 0.3)) +
        Eigen::Vector3d(0.0, 0.0, 0.3) + place;
    if ((OrbitPose(angle_rad).translation - middle).dot(Normal(side)) <= 0.0) {
      return;
    }
    const std::vector<cv::Point2f> texture = {
        {0, 0}, {kSide, 0}, {kSide, kSide}, {0, kSide}};
    cv::warpPerspective(
        sides_[side],
        bgr,
        cv::getPerspectiveTransform(texture, Corners(angle_rad, side)),
        bgr.size(),
        cv::INTER_LINEAR,
        cv::BORDER_TRANSPARENT);
  }

  CameraModel camera_;
  std::vector<cv::Mat> sides_;
  cv::Mat background_ =
      test_support::Texture(camera_.width_px(), camera_.height_px(), 1, 3.0);
};

// The camera goes round the target and stays, so that what the other sides look
// like is forgotten; a minute later the target comes back beside where it was,
// seen from `last_degrees`. Frames until it is tracked, or how many there are.
int FramesUntilSeenAgain(int max_views, double last_degrees) {
  constexpr int kRound = 120;
  constexpr int kStay = 300;
  constexpr int kAway = 20;
  constexpr int kBack = 30;
  const std::array<double, 3> params = {250.0, 160.0, 120.0};
  const CameraModel camera = *CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 320, 240, params);
  DrawnBox box(camera);
  double angle_rad = 0.0;
  SessionOptions options;
  options.tracker.name = "dcf";
  options.max_views = max_views;
  // Of a target that rests its points tell more than its looks.
  options.follow_bodies = false;
  options.seed = test_support::PerturbedSeed(options.seed);
  const auto session =
      *TrackingSession::Create(std::make_unique<OrbitCamera>(&angle_rad),
                               ground::MakePlaneSurface({}),
                               camera,
                               options);
  milliseconds time{0};
  for (int i = 0; i < kRound + kStay + kAway + kBack; ++i) {
    const bool away = i >= kRound + kStay && i < kRound + kStay + kAway;
    const double degrees =
        i < kRound + kStay ? -100.0 + 200.0 * std::min(1.0, 1.0 * i / kRound)
                           : last_degrees;
    angle_rad = degrees * kDegree;
    time += away ? milliseconds(3'000) : milliseconds(40);
    // Moved while it was away, across the view.
    if (i == kRound + kStay + kAway) {
      box.place =
          0.7 * Eigen::Vector3d(-std::sin(angle_rad), std::cos(angle_rad), 0.0);
    }
    image::Frame frame = box.Draw(angle_rad, away);
    frame.sequence = static_cast<std::uint64_t>(i);
    frame.capture_time = time;
    if (i == 0) {
      EXPECT_TRUE(session->SetTarget("a", box.Outline(angle_rad), {}).ok());
    }
    const auto result = session->ProcessFrame(frame, {}, nullptr);
    if (!result.ok()) {
      ADD_FAILURE() << result.status();
      return kBack;
    }
    const TargetResult& target = result->targets.at(0);
    const bool tracked = target.state == TargetState::kTracked;
    if (i < kRound + kStay) {
      EXPECT_TRUE(tracked) << i;
    }
    if (i < kRound + kStay + kAway || !tracked) continue;
    const geometry::Box2 outline = box.Outline(angle_rad);
    EXPECT_LT((target.box_px->center_px() - outline.center_px()).norm(),
              0.3 * outline.width());
    return i - kRound - kStay - kAway;
  }
  return kBack;
}

TEST(TrackingSession, KnowsATargetAgainThatComesBackSeenFromAnotherSide) {
  for (const double degrees : {-90.0, -45.0}) {
    const int without = FramesUntilSeenAgain(0, degrees);
    const int with = FramesUntilSeenAgain(8, degrees);
    std::printf("seen again from %.0f degrees after %d frames, without %d\n",
                degrees,
                with,
                without);
    EXPECT_LE(with, 5);
    EXPECT_GT(without, 20);
  }
}

TEST(TrackingSession, MeasuresATargetAtRestThatTheCameraGoesRound) {
  constexpr int kFrames = 90;
  const std::array<double, 3> params = {500.0, 320.0, 240.0};
  const CameraModel camera = *CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 640, 480, params);
  const DrawnBox box(camera);
  double angle_rad = 0.0;
  SessionOptions options;
  options.tracker.name = "dcf";
  const auto session =
      *TrackingSession::Create(std::make_unique<OrbitCamera>(&angle_rad),
                               ground::MakePlaneSurface({}),
                               camera,
                               options);
  double worst_length = 0.0;
  double worst_width = 0.0;
  for (int i = 0; i < kFrames; ++i) {
    angle_rad = (-115.0 + i) * kDegree;
    image::Frame frame = box.Draw(angle_rad, /*hidden=*/false);
    frame.sequence = static_cast<std::uint64_t>(i);
    frame.capture_time = milliseconds(40 * i);
    if (i == 0) {
      ASSERT_TRUE(session->SetTarget("a", box.Outline(angle_rad), {}).ok());
    }
    const auto result = session->ProcessFrame(frame, {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    const TargetResult& target = result->targets.at(0);
    EXPECT_EQ(target.state, TargetState::kTracked) << i;
    if (i < 30) continue;
    // Passed by through 30 degrees and more.
    ASSERT_TRUE(target.box_world);
    const Eigen::Vector3d heading =
        target.box_world->world_from_object.rotation * Eigen::Vector3d::UnitX();
    EXPECT_LT(std::acos(std::min(1.0, std::abs(heading.x()))), 10.0 * kDegree)
        << i;
    const Eigen::Vector3d& size_m = target.box_world->size_m;
    worst_length = std::max(worst_length, std::abs(size_m.x() / 1.0 - 1.0));
    worst_width = std::max(worst_width, std::abs(size_m.y() / 0.6 - 1.0));
    EXPECT_LT(target.box_world->BottomCenterWorld().norm(), 0.05 * 4.3) << i;
  }
  std::printf(
      "length off by up to %.3f, width by %.3f\n", worst_length, worst_width);
  EXPECT_LT(worst_length, 0.12);
  // 15 % in four draws of noise out of five; in one it is up to 25 % too
  // narrow from a turn by 40 or 65 degrees on.
  EXPECT_LT(worst_width, test_support::Bound(0.15, 0.3));
}

}  // namespace
}  // namespace groundlock::tracking
