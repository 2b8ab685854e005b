// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/patch_sampler.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>

namespace groundlock::target::internal {
namespace {

using geometry::Box2;

// Value = 2 x + y + 10 at pixel centres, blue; half of that, green.
cv::Mat Ramp() {
  cv::Mat image(40, 60, CV_8UC3);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const int value = 2 * x + y + 10;
      image.at<cv::Vec3b>(y, x) = cv::Vec3b(
          static_cast<uchar>(value), static_cast<uchar>(value / 2), 7);
    }
  }
  return image;
}

// Cubic interpolation reproduces a linear function exactly as long as the
// kernel stays inside the image; widened by a fraction (the last box), to a
// percent of the ramp's slope.
TEST(PatchSampler, ReproducesARamp) {
  PatchSampler sampler(16);
  for (const Box2& box : {Box2::FromXywh(12.25, 12.5, 8.0, 8.0),
                          Box2::FromXywh(20.0, 10.0, 16.0, 16.0),
                          Box2::FromXywh(14.0, 10.0, 32.0, 20.0)}) {
    sampler.Sample(Ramp(), box);
    for (int y = 0; y < 16; ++y) {
      for (int x = 0; x < 16; ++x) {
        const double px = box.x() + (x + 0.5) * box.width() / 16 - 0.5;
        const double py = box.y() + (y + 0.5) * box.height() / 16 - 0.5;
        EXPECT_NEAR(sampler.plane(0)[y * 16 + x], 2 * px + py + 10, 0.01);
        EXPECT_NEAR(sampler.plane(2)[y * 16 + x], 7.0, 1e-4);
      }
    }
  }
}

// A patch of any coarseness keeps its place: a ramp in the image is one in the
// patch, to what rounding halved pixels and taking every second pair change.
TEST(PatchSampler, KeepsPlacesInHalvedImages) {
  cv::Mat image(300, 400, CV_8UC3);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const auto value = static_cast<uchar>(x / 4 + y / 2);
      image.at<cv::Vec3b>(y, x) = cv::Vec3b(value, 7, value);
    }
  }
  PatchSampler sampler(16);
  for (const int side : {40, 90, 170, 200}) {
    const Box2 box = Box2::FromXywh(70.5, 60.25, side, side);
    EXPECT_EQ(sampler.Halvings(box.size_px()),
              static_cast<int>(std::log2(side / 20.0)));
    sampler.Sample(image, box);
    for (int y = 0; y < 16; ++y) {
      for (int x = 0; x < 16; ++x) {
        const double px = box.x() + (x + 0.5) * side / 16 - 0.5;
        const double py = box.y() + (y + 0.5) * side / 16 - 0.5;
        // The image's values are rounded down, by half on average.
        EXPECT_NEAR(sampler.plane(0)[y * 16 + x], px / 4 + py / 2 - 0.6, 1.2);
        EXPECT_NEAR(sampler.plane(1)[y * 16 + x], 7.0, 1e-4);
      }
    }
  }
}

TEST(PatchSampler, ReplicatesTheEdge) {
  PatchSampler sampler(8);
  sampler.Sample(Ramp(), Box2::FromXywh(-500, -500, 12, 12));
  for (const float value : sampler.plane(0)) EXPECT_NEAR(value, 10.0, 1e-3);
  // Of the halved image the edge is the first four pixels' mean, 11.5.
  sampler.Sample(Ramp(), Box2::FromXywh(-500, -500, 20, 20));
  for (const float value : sampler.plane(0)) EXPECT_NEAR(value, 11.5, 0.6);
}

TEST(PatchSampler, GrayFillsAllPlanes) {
  PatchSampler sampler(8);
  cv::Mat gray(20, 20, CV_8UC1, cv::Scalar(90));
  sampler.Sample(gray, Box2::FromXywh(3, 3, 5, 5));
  for (int c = 0; c < 3; ++c) {
    for (const float value : sampler.plane(c)) EXPECT_NEAR(value, 90.0, 1e-3);
  }
}

// A checkerboard of single pixels seen from afar is gray, not a moire pattern.
TEST(PatchSampler, DoesNotAliasWhenMinifying) {
  cv::Mat board(256, 256, CV_8UC1);
  for (int y = 0; y < 256; ++y) {
    for (int x = 0; x < 256; ++x) {
      board.at<uchar>(y, x) = (x + y) % 2 == 0 ? 0 : 200;
    }
  }
  PatchSampler sampler(32);
  sampler.Sample(board, Box2::FromXywh(30.3, 31.7, 96, 96));
  // Three pixels a cell: the cubic kernel lets a few percent through.
  for (const float value : sampler.plane(0)) EXPECT_NEAR(value, 100.0, 5.0);
}

TEST(PatchSampler, SurvivesExtremeBoxes) {
  PatchSampler sampler(16);
  for (const Box2& box : {Box2::FromXywh(-1e6, -1e6, 2e6, 2e6),
                          Box2::FromXywh(5, 5, 1e-3, 1e-3),
                          Box2::FromXywh(9e5, 9e5, 1, 1e5)}) {
    sampler.Sample(Ramp(), box);
    for (const float value : sampler.plane(0)) {
      EXPECT_TRUE(value >= 0.0F && value <= 255.0F);
    }
  }
  sampler.Sample(cv::Mat(1, 1, CV_8UC3, cv::Scalar(1, 2, 3)),
                 Box2::FromXywh(0, 0, 1, 1));
  EXPECT_NEAR(sampler.plane(1)[100], 2.0, 1e-4);
}

}  // namespace
}  // namespace groundlock::target::internal
