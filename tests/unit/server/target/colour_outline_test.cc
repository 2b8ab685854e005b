// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/colour_outline.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace groundlock::target::internal {
namespace {

using geometry::Box2;

constexpr int kSide = 192;
constexpr double kMiddle = kSide / 2.0;

// A box of `colour` of the given place and size in a patch of other colours.
PatchSampler Patch(const Box2& box, const cv::Scalar& colour) {
  cv::Mat image(kSide, kSide, CV_8UC3, cv::Scalar(200, 20, 20));
  cv::rectangle(
      image,
      cv::Point(cvRound(box.min_px.x()), cvRound(box.min_px.y())),
      cv::Point(cvRound(box.max_px.x()) - 1, cvRound(box.max_px.y()) - 1),
      colour,
      cv::FILLED);
  PatchSampler sampler(kSide);
  sampler.Sample(image, Box2::FromXywh(0, 0, kSide, kSide));
  return sampler;
}

const cv::Scalar kRed(20, 20, 220);

Box2 Centred(double width, double height) {
  return Box2::FromCenter({kMiddle, kMiddle}, {width, height});
}

// A target as it is marked: what is `shown` in the patch, and what is `drawn`
// about it.
struct Marked {
  Marked(const Box2& shown, const Box2& drawn, const cv::Scalar& colour)
      : colours(kSide) {
    const PatchSampler patch = Patch(shown, colour);
    colours.Learn(patch, drawn.size_px(), 1.0);
    colours.LookForBoxes(patch);
    outline.Start(colours, drawn);
  }

  // The tracker finds `found` where the target is `shown`, so many times.
  Box2 Follow(const Box2& shown, Box2 found, int frames) {
    const PatchSampler patch = Patch(shown, kRed);
    for (int i = 0; i < frames; ++i) {
      colours.LookForBoxes(patch);
      found = outline.Correct(colours, found);
      outline.Learn();
    }
    return found;
  }

  ColourHistogram colours;
  ColourOutline outline;
};

TEST(ColourOutline, GoesWhereTheColoursAre) {
  const Box2 box = Centred(40, 24);
  Marked marked(box, box, kRed);
  const Box2 moved = Box2::FromCenter({kMiddle + 3.0, kMiddle - 2.0}, {40, 24});
  const Box2 found = marked.Follow(moved, box, 40);
  EXPECT_NEAR(found.center_px().x(), kMiddle + 3.0, 1.0);
  EXPECT_NEAR(found.center_px().y(), kMiddle - 2.0, 1.0);
  EXPECT_NEAR(found.width(), 40.0, 2.0);
  EXPECT_NEAR(found.height(), 24.0, 2.0);
}

TEST(ColourOutline, FollowsSizeAndAspect) {
  const Box2 box = Centred(40, 24);
  Marked marked(box, box, kRed);
  const Box2 found = marked.Follow(Centred(44, 32), box, 100);
  EXPECT_NEAR(found.width(), 44.0, 3.0);
  EXPECT_NEAR(found.height(), 32.0, 3.0);
}

TEST(ColourOutline, KeepsWhatWasDrawnAboutTheColours) {
  // The box was drawn larger than what has the colours, and stays so.
  const Box2 shown = Centred(36, 20);
  const Box2 drawn = Centred(40, 24);
  Marked marked(shown, drawn, kRed);
  const Box2 found = marked.Follow(shown, drawn, 100);
  EXPECT_NEAR(found.width(), 40.0, 0.5);
  EXPECT_NEAR(found.height(), 24.0, 0.5);
}

TEST(ColourOutline, ChangesNothingWhereColoursDoNotTell) {
  const Box2 box = Centred(40, 24);
  Marked marked(box, box, cv::Scalar(200, 20, 20));
  const Box2 off = Box2::FromCenter({kMiddle + 3.0, kMiddle}, {44, 24});
  const Box2 found = marked.Follow(Centred(10, 60), off, 1);
  EXPECT_NEAR(found.center_px().x(), kMiddle + 3.0, 0.5);
  EXPECT_NEAR(found.width(), 44.0, 0.5);
}

}  // namespace
}  // namespace groundlock::target::internal
