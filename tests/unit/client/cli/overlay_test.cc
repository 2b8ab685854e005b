// SPDX-License-Identifier: Apache-2.0
#include "client/cli/overlay.h"

#include <gtest/gtest.h>

#include <numbers>
#include <vector>

namespace groundlock::cli {
namespace {

constexpr int kWidth = 640;
constexpr int kHeight = 480;

geometry::CameraModel MakeCamera(double k) {
  const std::vector<double> params = {500.0, 320.0, 240.0, k};
  return *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimpleRadial, kWidth, kHeight, params);
}

cv::Mat Grey() { return {kHeight, kWidth, CV_8UC3, cv::Scalar::all(100)}; }

// Whether a pixel of a picture that was Grey() has been painted with the
// colour. Lines are anti-aliased: one that runs between two rows of pixels
// gives either half of its colour, so 0.4 of it is enough, if the rest is the
// background.
bool IsColour(const cv::Mat& bgr, int x, int y, const cv::Scalar& colour) {
  const cv::Vec3b pixel = bgr.at<cv::Vec3b>(y, x);
  double along = 0.0, length = 0.0;
  for (int i = 0; i < 3; ++i) {
    along += (pixel[i] - 100.0) * (colour[i] - 100.0);
    length += (colour[i] - 100.0) * (colour[i] - 100.0);
  }
  const double alpha = length > 0.0 ? along / length : 1.0;
  for (int i = 0; i < 3; ++i) {
    const double expected = 100.0 + alpha * (colour[i] - 100.0);
    if (std::abs(pixel[i] - expected) > 25.0) return false;
  }
  return alpha > 0.4;
}

bool AnyNear(const cv::Mat& bgr, int x, int y, const cv::Scalar& colour) {
  for (int dy = -2; dy <= 2; ++dy) {
    for (int dx = -2; dx <= 2; ++dx) {
      if (IsColour(bgr, x + dx, y + dy, colour)) return true;
    }
  }
  return false;
}

int Count(const cv::Mat& bgr, const cv::Scalar& colour) {
  int count = 0;
  for (int y = 0; y < bgr.rows; ++y) {
    for (int x = 0; x < bgr.cols; ++x) count += IsColour(bgr, x, y, colour);
  }
  return count;
}

// A camera at the origin of a z-up world, looking along world x.
geometry::Rigid3 LookingAlongX() {
  Eigen::Matrix3d world_from_camera;
  world_from_camera.col(0) = -Eigen::Vector3d::UnitY();  // right
  world_from_camera.col(1) = -Eigen::Vector3d::UnitZ();  // down
  world_from_camera.col(2) = Eigen::Vector3d::UnitX();   // forward
  return {Eigen::Quaterniond(world_from_camera), Eigen::Vector3d::Zero()};
}

sdk::FrameResult FrameWith(const sdk::TargetResult& target) {
  sdk::FrameResult result;
  result.camera.state = sdk::CameraState::kTracked;
  result.camera.world_from_camera = LookingAlongX();
  result.targets.push_back(target);
  return result;
}

sdk::TargetResult TargetWithBox(sdk::TargetState state) {
  sdk::TargetResult target;
  target.id = "car";
  target.state = state;
  target.confidence = 0.5;
  target.box_px = geometry::Box2::FromXywh(200, 200, 100, 60);
  return target;
}

cv::Mat Draw(const geometry::CameraModel& camera,
             const sdk::FrameResult& result) {
  cv::Mat bgr = Grey();
  DrawOverlay(camera, result, GroundTrails(), OverlayColours{}, bgr);
  return bgr;
}

TEST(Overlay, DrawsMatchedFeaturesPurpleWhereTheyAre) {
  sdk::FrameResult result;
  // The centre of the pixel in column 400, row 300 is (400.5, 300.5).
  result.camera.match_xy_px = {{400.5F, 300.5F}};
  const cv::Mat bgr = Draw(MakeCamera(0.0), result);
  EXPECT_TRUE(IsColour(bgr, 400, 300, OverlayColours{}.match));
  EXPECT_TRUE(IsColour(bgr, 410, 300, cv::Scalar::all(100)));
}

TEST(Overlay, DrawsTheSeenBoxAndItsConfidence) {
  const OverlayColours colours;
  const cv::Mat bgr = Draw(
      MakeCamera(0.0), FrameWith(TargetWithBox(sdk::TargetState::kTracked)));
  EXPECT_TRUE(AnyNear(bgr, 200, 230, colours.seen_box));  // left edge
  EXPECT_TRUE(AnyNear(bgr, 300, 230, colours.seen_box));  // right edge
  EXPECT_TRUE(AnyNear(bgr, 250, 200, colours.seen_box));  // upper edge
  // Confidence 0.5: the bar covers the left half of the lower edge.
  EXPECT_TRUE(AnyNear(bgr, 225, 256, colours.confidence));
  EXPECT_FALSE(AnyNear(bgr, 275, 256, colours.confidence));
  EXPECT_EQ(Count(bgr, colours.predicted_box), 0);
}

TEST(Overlay, DashesThePredictedBox) {
  const OverlayColours colours;
  const cv::Mat seen = Draw(
      MakeCamera(0.0), FrameWith(TargetWithBox(sdk::TargetState::kTracked)));
  const cv::Mat bgr = Draw(
      MakeCamera(0.0), FrameWith(TargetWithBox(sdk::TargetState::kPredicted)));
  int on = 0;
  for (int y = 205; y < 250; ++y) {
    on += AnyNear(bgr, 200, y, colours.predicted_box);
  }
  EXPECT_GT(on, 10);
  EXPECT_LT(on, 45);
  EXPECT_TRUE(AnyNear(seen, 200, 230, colours.seen_box));
  EXPECT_FALSE(AnyNear(bgr, 200, 230, colours.seen_box));
}

TEST(Overlay, LeavesOutLostTargets) {
  const OverlayColours colours;
  const cv::Mat bgr =
      Draw(MakeCamera(0.0), FrameWith(TargetWithBox(sdk::TargetState::kLost)));
  EXPECT_FALSE(AnyNear(bgr, 200, 230, colours.predicted_box));
  EXPECT_FALSE(AnyNear(bgr, 200, 230, colours.seen_box));
}

// A box of 2 x 2 x 2 m whose near face stands 5 m ahead: with f = 500 px the
// face spans 200 px around the image's centre, the far face, at 7 m, 143 px.
sdk::TargetResult CubeAhead(double heading_rad) {
  sdk::TargetResult target;
  target.id = "car";
  target.state = sdk::TargetState::kTracked;
  target.box_world =
      geometry::Box3{{Eigen::Quaterniond(Eigen::AngleAxisd(
                          heading_rad, Eigen::Vector3d::UnitZ())),
                      {6.0, 0.0, 0.0}},
                     {2.0, 2.0, 2.0}};
  return target;
}

TEST(Overlay, PaintsTheFaceThatLooksAtTheCameraGreen) {
  const OverlayColours colours;
  // Whichever of its sides the box turns to the camera.
  for (const int quarter : {0, 1, 2, 3}) {
    const cv::Mat bgr =
        Draw(MakeCamera(0.0),
             FrameWith(CubeAhead(0.5 * std::numbers::pi * quarter)));
    for (const int x : {220, 420}) {
      EXPECT_TRUE(AnyNear(bgr, x, 260, colours.front_face)) << quarter;
    }
    for (const int x : {320 - 71, 320 + 71}) {
      EXPECT_TRUE(AnyNear(bgr, x, 260, colours.box_world)) << quarter;
    }
    EXPECT_TRUE(AnyNear(bgr, 320, 240, colours.center)) << quarter;
  }
}

TEST(Overlay, BendsEdgesAsTheLensDoes) {
  // The face's upper corners lie at normalised (+-0.2, -0.2), the middle of the
  // edge between at (0, -0.2): with k = -1 their radii shrink by 8 % and 4 %,
  // so the edge is at rows 240 - 100 * 0.92 = 148 and 240 - 100 * 0.96 = 144.
  const OverlayColours colours;
  const cv::Mat bgr = Draw(MakeCamera(-1.0), FrameWith(CubeAhead(0.0)));
  EXPECT_TRUE(IsColour(bgr, 320, 144, colours.front_face) ||
              IsColour(bgr, 320, 143, colours.front_face));
  EXPECT_FALSE(AnyNear(bgr, 320, 150, colours.front_face));
  EXPECT_TRUE(AnyNear(bgr, 228, 148, colours.front_face));
}

TEST(Overlay, SurvivesWhatLiesBehindTheCameraOrFarOutside) {
  sdk::TargetResult target = CubeAhead(0.0);
  target.box_world->world_from_object.translation = {-6.0, 0.0, 0.0};
  target.box_px = geometry::Box2::FromXywh(-1e12, 5, 1e13, 1e300);
  sdk::FrameResult result = FrameWith(target);
  result.targets.push_back(CubeAhead(0.3));
  result.targets[1].box_world->world_from_object.translation = {0.1, 0, 0};
  result.camera.match_xy_px = {{1e30F, 0.0F}, {NAN, 1.0F}};
  const cv::Mat bgr = Draw(MakeCamera(-0.2), result);
  EXPECT_EQ(Count(bgr, OverlayColours{}.match), 0);
}

TEST(Overlay, DrawsTheWayOnTheGround) {
  GroundTrails trails(2);
  sdk::TargetResult target;
  target.id = "car";
  target.state = sdk::TargetState::kTracked;
  sdk::FrameResult result = FrameWith(target);
  // One metre below the camera; the first point falls out of the trail.
  for (const double y : {-3.0, 1.0, -1.0}) {
    result.targets[0].ground_center_world = Eigen::Vector3d(5.0, y, -1.0);
    trails.Add(result);
  }
  cv::Mat bgr = Grey();
  DrawOverlay(MakeCamera(0.0), result, trails, OverlayColours{}, bgr);
  const OverlayColours colours;
  // World y = 1 .. -1 at 5 m is x = 220 .. 420, at row 240 + 100.
  EXPECT_TRUE(AnyNear(bgr, 250, 340, colours.trail));
  EXPECT_TRUE(AnyNear(bgr, 400, 340, colours.trail));
  EXPECT_FALSE(AnyNear(bgr, 500, 340, colours.trail));
}

TEST(Overlay, DarkensAFrameWithoutResult) {
  cv::Mat bgr = Grey();
  DrawNoResult("frame 3 dropped", bgr);
  EXPECT_TRUE(IsColour(bgr, 600, 400, cv::Scalar::all(50)));
}

}  // namespace
}  // namespace groundlock::cli
