// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/rotation_flow.h"

#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>
#include <vector>

#include "tests/support/rendered_plane_map.h"

namespace groundlock::localization {
namespace {

using geometry::Rigid3;
using test_support::LookAlongY;
using test_support::RenderedPlace;

Rigid3 Turned(double yaw_rad, double pitch_rad) {
  return LookAlongY({0.0, 0.0, 1.6}, yaw_rad, pitch_rad);
}

TEST(RotationFlow, FindsTheRotation) {
  const RenderedPlace place(1);
  const auto before = image::BuildPyramid(place.Render(Turned(0.0, 0.0)));
  for (const auto& [yaw, pitch] : std::vector<std::pair<double, double>>{
           {0.0, 0.0}, {0.03, 0.0}, {-0.02, 0.02}, {0.06, -0.03}}) {
    const Rigid3 now = Turned(yaw, pitch);
    const auto flow = EstimateRotation(*before,
                                       *image::BuildPyramid(place.Render(now)),
                                       place.camera(),
                                       {},
                                       Eigen::Quaterniond::Identity(),
                                       1);
    ASSERT_TRUE(flow) << yaw;
    const Eigen::Quaterniond truth =
        Turned(0.0, 0.0).rotation.conjugate() * now.rotation;
    // A twentieth of a pixel of 520.
    EXPECT_LT(truth.angularDistance(flow->before_from_now), 3e-4) << yaw;
    EXPECT_LT(flow->rms_error_rad, 2.0 / 520.0);
    EXPECT_GE(flow->num_inliers, 16);
  }
}

TEST(RotationFlow, LeavesOutWhatMovesAndWhatIsMasked) {
  const RenderedPlace place(1);
  const cv::Mat first = place.Render(Turned(0.0, 0.0));
  const cv::Mat second = place.Render(Turned(0.02, 0.0));
  // Something moves the other way: a third of the image.
  cv::Mat one = first.clone();
  cv::Mat two = second.clone();
  const cv::Rect box(200, 100, 200, 200);
  first(cv::Rect(20, 100, 200, 200)).copyTo(one(box));
  first(cv::Rect(20, 100, 200, 200)).copyTo(two(box + cv::Point(12, 0)));
  const std::vector<geometry::Box2> mask = {
      geometry::Box2::FromXywh(195.0, 95.0, 225.0, 210.0)};
  for (const bool masked : {false, true}) {
    const auto flow =
        EstimateRotation(*image::BuildPyramid(one),
                         *image::BuildPyramid(two),
                         place.camera(),
                         masked ? mask : std::vector<geometry::Box2>(),
                         Eigen::Quaterniond::Identity(),
                         1);
    ASSERT_TRUE(flow);
    const Eigen::Quaterniond truth =
        Turned(0.0, 0.0).rotation.conjugate() * Turned(0.02, 0.0).rotation;
    // Half a pixel.
    EXPECT_LT(truth.angularDistance(flow->before_from_now), 1e-3) << masked;
  }
}

TEST(RotationFlow, NothingInFlatOrUnrelatedFrames) {
  const RenderedPlace place(1);
  const RenderedPlace elsewhere(2);
  const auto frame = image::BuildPyramid(place.Render(Turned(0.0, 0.0)));
  const auto flat =
      image::BuildPyramid(cv::Mat(frame->size_px, CV_8UC1, cv::Scalar(90)));
  const auto other = image::BuildPyramid(elsewhere.Render(Turned(0.0, 0.0)));
  const auto small = image::BuildPyramid(cv::Mat(180, 320, CV_8UC1, 90.0));
  for (const auto& [before, now] : {std::pair(flat, frame),
                                    std::pair(frame, flat),
                                    std::pair(frame, other),
                                    std::pair(frame, small)}) {
    EXPECT_FALSE(EstimateRotation(
        *before, *now, place.camera(), {}, Eigen::Quaterniond::Identity(), 1));
  }
}

}  // namespace
}  // namespace groundlock::localization
