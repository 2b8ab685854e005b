// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/given_lens.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "tests/unit/map_store/build/synthetic_flight.h"

namespace groundlock::build::internal {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

// Of the flight's 905 px.
MotionOptions Given(const Flight& flight, double times) {
  std::vector<double> params(flight.lens.params().begin(),
                             flight.lens.params().end());
  params[0] *= times;
  MotionOptions options;
  options.camera = *geometry::CameraModel::Create(
      flight.lens.id(), kWidth_px, kHeight_px, params);
  return options;
}

std::optional<OtherLens> Judge(const Flight& flight,
                               const MotionOptions& options) {
  const auto motion = ReconstructMotion(flight.tracks, options);
  const auto other = FindOtherLens(
      flight.tracks, motion.ok() ? &motion->scene : nullptr, options);
  EXPECT_TRUE(other.ok()) << other.status();
  return other.value_or(std::nullopt);
}

class WrongLens : public ::testing::TestWithParam<double> {};

TEST_P(WrongLens, IsToldWithBothFocalLengths) {
  const Flight flight = Fly({.num_images = 14});
  const auto other = Judge(flight, Given(flight, GetParam()));
  ASSERT_TRUE(other);
  EXPECT_NEAR(other->given_focal_px, GetParam() * 905.0, 1e-6);
  EXPECT_LT(std::abs(other->focal_px - 905.0), 0.03 * 905.0);
  EXPECT_LT(std::abs(other->focal_px - 905.0), 3.0 * other->focal_sigma_px);
}

INSTANTIATE_TEST_SUITE_P(Times,
                         WrongLens,
                         ::testing::Values(0.22, 0.8, 1.25, 3.3));

TEST(FindOtherLens, ALensThatIsAboutTheCamerasIsBelieved) {
  const Flight flight = Fly({.num_images = 14});
  for (const double times : {1.0, 1.02}) {
    EXPECT_FALSE(Judge(flight, Given(flight, times))) << times;
  }
}

// What a fisheye bends tells nothing of its focal length: taken for a lens with
// little distortion it would be another one.
TEST(FindOtherLens, DistortionThatIsGivenIsNoOtherLens) {
  Flight flight = Fly({.num_images = 14});
  const auto fisheye = *geometry::CameraModel::Create(
      geometry::CameraModelId::kOpenCvFisheye,
      kWidth_px,
      kHeight_px,
      std::vector<double>{905.0, 905.0, 660.0, 350.0, -0.35, 0.05, 0.0, 0.0});
  for (FeatureTrack& track : flight.tracks.tracks) {
    for (TrackSight& sight : track) {
      const auto xy =
          flight.lens.NormalizedFromImage(sight.pixel_px.cast<double>());
      ASSERT_TRUE(xy);
      const auto pixel = fisheye.ImageFromCamera(xy->homogeneous());
      ASSERT_TRUE(pixel);
      sight.pixel_px = pixel->cast<float>();
    }
  }
  MotionOptions options;
  options.camera = fisheye;
  EXPECT_FALSE(Judge(flight, options));
  const auto blind = ReconstructMotion(flight.tracks, {});
  EXPECT_TRUE(!blind.ok() ||
              std::abs(blind->scene.lens.focal_px - 905.0) > 0.1 * 905.0)
      << blind->scene.lens.focal_px;
}

// Whoever flies straight ahead sees nearly the same with any lens. A telephoto
// lens is rare, and yet nothing speaks against it.
TEST(FindOtherLens, WhereNothingTellsTheLensIsBelieved) {
  const Flight flight = Fly({.num_images = 14, .turn_rad = 0.0});
  for (const double times : {0.8, 1.25}) {
    EXPECT_FALSE(Judge(flight, Given(flight, times))) << times;
  }
}

TEST(FindOtherLens, TracksThatHoldNoMotionTellNothing) {
  Flight flight = Fly({.num_images = 14});
  flight.tracks.tracks.resize(4);
  EXPECT_FALSE(Judge(flight, Given(flight, 3.0)));
}

TEST(FindOtherLens, IsCancelled) {
  const Flight flight = Fly({.num_images = 14});
  MotionOptions options = Given(flight, 1.0);
  options.progress = [](double, const std::string&) { return false; };
  EXPECT_EQ(FindOtherLens(flight.tracks, nullptr, options).status().code(),
            absl::StatusCode::kCancelled);
}

TEST(OtherLens, SaysBothFocalLengthsAndWhatToDo) {
  EXPECT_THAT((OtherLens{200.2, 919.4, 20.4}).ToText(),
              AllOf(HasSubstr("is 200 px"),
                    HasSubstr("asks for 919 +- 20 px"),
                    HasSubstr("without --camera")));
}

}  // namespace
}  // namespace groundlock::build::internal
