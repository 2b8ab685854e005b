// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/track_motion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/build/internal/track_turn.h"
#include "map_store/build/internal/video_landmarks.h"
#include "tests/unit/map_store/build/synthetic_flight.h"

namespace groundlock::build::internal {
namespace {

TEST(ReconstructMotion, KeepsAGivenLens) {
  const Flight flight = Fly({.num_images = 12});
  MotionOptions options;
  options.camera = flight.lens;
  const auto motion = ReconstructMotion(flight.tracks, options);
  ASSERT_TRUE(motion.ok()) << motion.status();
  EXPECT_EQ(motion->camera, flight.lens);
  EXPECT_FALSE(motion->focal_sigma_px);
  EXPECT_EQ(motion->scene.CountPosed(), 12U);
  EXPECT_LT(WorstTurn_rad(flight, motion->scene),
            0.2 * std::numbers::pi / 180.0);
}

// Both held all keyframes of a flight over water: the first with a lens 7 %
// off, the second with the right one.
TEST(MotionTry, OfThoseThatHoldEnoughTheOneThatExplainsMoreIsKept) {
  const MotionTry wrong{37, 37, 1.43};
  const MotionTry right{36, 37, 0.66};
  EXPECT_TRUE(right.IsBetterThan(wrong));
  EXPECT_FALSE(wrong.IsBetterThan(right));
  // What hardly holds together is easily explained.
  const MotionTry few{9, 37, 0.05};
  EXPECT_TRUE(wrong.IsBetterThan(few));
  EXPECT_FALSE(few.IsBetterThan(wrong));
  EXPECT_TRUE((MotionTry{34, 37, 0.2}).IsGoodEnough());
  EXPECT_FALSE(wrong.IsGoodEnough());
  EXPECT_FALSE(few.IsGoodEnough());
}

// The lens is 905 px, the prior believes 1088 +- 35 %.
struct Found {
  double off_px = 0.0;
  double sigma_px = 0.0;
};
Found FindLens(const FlightOptions& options, double film_focal_mm = 0.0) {
  Flight flight = Fly(options);
  flight.tracks.film_focal_mm = film_focal_mm;
  const auto motion = ReconstructMotion(flight.tracks, {});
  EXPECT_TRUE(motion.ok()) << motion.status();
  if (!motion.ok() || !motion->focal_sigma_px) return {1e9, 0.0};
  return {motion->scene.lens.focal_px - 905.0, *motion->focal_sigma_px};
}

// A quarter of the tracks agree on a motion of their own: under a lens that is
// far off they seem to stand still, too.
TEST(ReconstructMotion, FindsTheLensAmongWhatMoves) {
  for (const std::uint64_t seed : {3U, 4U}) {
    const Found found = FindLens({.seed = seed});
    EXPECT_LT(std::abs(found.off_px), 0.03 * 905.0) << seed;
    EXPECT_LT(std::abs(found.off_px), 3.0 * found.sigma_px) << seed;
    EXPECT_LT(found.sigma_px, 0.03 * 905.0) << seed;
  }
}

// Whoever flies straight ahead sees nearly the same with any lens: depths and
// shifts make up for it. What moves along then pulls at the lens from its part
// of the picture all the time, which the stretches of time do not tell from
// the truth.
TEST(ReconstructMotion, AStraightFlightDoesNotTellTheLensAndSaysSo) {
  for (const FlightOptions& flight :
       {FlightOptions{.turn_rad = 0.0, .share_moving = 0.0},
        FlightOptions{.turn_rad = 0.0, .seed = 3},
        FlightOptions{.turn_rad = 0.0, .seed = 5}}) {
    const Found found = FindLens(flight);
    EXPECT_LT(std::abs(found.off_px), 2.5 * found.sigma_px) << flight.seed;
    EXPECT_GT(found.sigma_px, 0.1 * 905.0) << flight.seed;
  }
}

// Ten keyframes of a turn on the spot between two ways of ten. No track leads
// from a depth before it to one behind it: the turn holds the two together, and
// the camera's height over the ground tells how large the second one is.
class TurnOnTheSpot : public ::testing::TestWithParam<int> {};

TEST_P(TurnOnTheSpot, JoinsTheWaysBeforeAndBehindIt) {
  const double turn_rad = GetParam() * std::numbers::pi / 180.0;
  const Flight flight = Fly({.num_images = 30,
                             .turn_rad = 0.01,
                             .share_moving = 0.1,
                             .spin_from = 10,
                             .spin_to = 20,
                             .spin_rad = turn_rad / 10.0,
                             .is_all_around = true});
  const auto motion = ReconstructMotion(flight.tracks, {});
  ASSERT_TRUE(motion.ok()) << motion.status();
  ASSERT_EQ(motion->scene.CountPosed(), 30U);
  EXPECT_LT(std::abs(motion->scene.lens.focal_px - 905.0),
            2.0 * *motion->focal_sigma_px);
  EXPECT_LT(std::abs(motion->scene.lens.focal_px - 905.0), 0.03 * 905.0);
  EXPECT_LT(WorstTurn_rad(flight, motion->scene),
            1.0 * std::numbers::pi / 180.0);
  const auto step = [&](std::size_t i) {
    return (motion->scene.camera_from_world[i]->Inverse().translation -
            motion->scene.camera_from_world[i + 1]->Inverse().translation)
        .norm();
  };
  EXPECT_NEAR(step(25) / step(5), 1.0, 0.1);
  EXPECT_LT(step(15), 0.02 * step(5));
  EXPECT_THAT(
      motion->notes,
      ::testing::Contains(::testing::HasSubstr("by a turn on the spot alone")));
}

INSTANTIATE_TEST_SUITE_P(Degrees,
                         TurnOnTheSpot,
                         ::testing::Values(20, 46, 90, 180));

TEST(FindTurns, AWayIsNoTurnAndATurnTellsTheLens) {
  const Flight flight = Fly({.num_images = 30,
                             .turn_rad = 0.01,
                             .share_moving = 0.1,
                             .spin_from = 10,
                             .spin_to = 20,
                             .spin_rad = 0.08,
                             .is_all_around = true});
  TrackScene scene(flight.tracks, flight.lens);
  const std::vector<std::uint32_t> turn_of = FindTurns(scene);
  for (std::size_t i = 0; i + 1 < turn_of.size(); ++i) {
    EXPECT_EQ(turn_of[i] == turn_of[i + 1], i >= 10 && i < 20) << i;
  }
  const auto lens = LensOfTurns(TrackScene(flight.tracks, std::nullopt));
  ASSERT_TRUE(lens);
  EXPECT_LT(std::abs(std::log(lens->lens.focal_px / 905.0)),
            2.0 * lens->focal_log_sigma);
  EXPECT_FALSE(LensOfTurns(TrackScene(Fly({}).tracks, std::nullopt)));
}

// Points that are all turned about a camera place the next image where its
// tracks say it cannot be.
TEST(PlaceImage, APoseThatTheTracksContradictIsNone) {
  const Flight flight = Fly({.num_images = 12, .share_moving = 0.0});
  TrackScene scene(flight.tracks, flight.lens);
  for (std::uint32_t i = 0; i < 12; ++i) {
    if (i != 6) scene.camera_from_world[i] = flight.camera_from_world[i];
  }
  scene.Triangulate(std::nullopt, 3);
  TrackScene turned = scene;
  EXPECT_TRUE(PlaceImage(6, scene));
  const geometry::Rigid3 camera_from_world = flight.camera_from_world[5];
  const Eigen::AngleAxisd turn(0.2, Eigen::Vector3d::UnitY());
  for (TrackScene::Point& point : turned.points) {
    if (!point.p_world) continue;
    point.p_world =
        camera_from_world.Inverse() *
        Eigen::Vector3d(turn * (camera_from_world * *point.p_world));
  }
  EXPECT_FALSE(PlaceImage(6, turned));
  EXPECT_FALSE(turned.camera_from_world[6]);
}

// Behind a turn on the spot by 80 degrees hardly anything of the way before it
// is seen any more, and the rest may be missing; but what is held is not held
// by an absurd lens.
TEST(ReconstructMotion, AnAbsurdLensIsAFailedTry) {
  const Flight flight = Fly({.num_images = 30,
                             .turn_rad = 0.01,
                             .share_moving = 0.1,
                             .spin_from = 10,
                             .spin_to = 20,
                             .spin_rad = 0.14});
  const auto motion = ReconstructMotion(flight.tracks, {});
  if (!motion.ok()) {
    EXPECT_EQ(motion.status().code(), absl::StatusCode::kFailedPrecondition);
    return;
  }
  EXPECT_LT(std::abs(motion->scene.lens.k), 0.4);
  EXPECT_LT(std::abs(motion->scene.lens.focal_px - 905.0),
            3.0 * *motion->focal_sigma_px);
}

// What the camera wrote into the video decides where the flight does not; the
// video's crop may make it longer, by 1.2 here, which the sigma covers. Where
// the flight tells the lens, it does not matter that the camera is far off.
TEST(ReconstructMotion, TakesTheLensThatTheVideoTellsWhereTheFlightDoesNot) {
  const FlightOptions straight{.turn_rad = 0.0, .seed = 4};
  const Found without = FindLens(straight);
  for (const double told_px : {905.0, 905.0 / 1.2}) {
    const Found found = FindLens(
        straight,
        told_px / std::hypot(kWidth_px, kHeight_px) * std::hypot(36.0, 24.0));
    EXPECT_LT(found.sigma_px, without.sigma_px) << told_px;
    EXPECT_LT(std::abs(found.off_px), 2.0 * found.sigma_px) << told_px;
  }
  const Found turning = FindLens({}, 50.0);
  EXPECT_LT(std::abs(turning.off_px), 0.03 * 905.0);
}

// 26 mm on film are 882.5 px here; without it most cameras are believed in.
TEST(TrackScene, BelievesTheFocalLengthThatTheVideoTells) {
  FeatureTracks tracks;
  tracks.width_px = kWidth_px;
  tracks.height_px = kHeight_px;
  const TrackScene without(tracks, std::nullopt);
  EXPECT_NEAR(without.prior.focal_px, 0.85 * kWidth_px, 1e-9);
  tracks.film_focal_mm = 26.0;
  const TrackScene with(tracks, std::nullopt);
  EXPECT_NEAR(with.prior.focal_px, 882.5, 0.1);
  EXPECT_EQ(with.lens.focal_px, with.prior.focal_px);
  EXPECT_LT(with.prior.focal_log_sigma, without.prior.focal_log_sigma);
}

// Behind a cut no track goes on, but the place is the same.
TEST(PlaceLandmarks, WhatNoTrackLeadsToIsFoundByItsLooks) {
  const Flight flight = Fly({.num_images = 20, .cut_at = 10});
  VideoMotion motion;
  motion.camera = flight.lens;
  for (std::uint32_t k = 0; k < 20; ++k) {
    motion.camera_from_world.push_back(
        k < 10 ? std::optional(flight.camera_from_world[k]) : std::nullopt);
  }
  LandmarkOptions options;
  options.lens_is_known = true;
  const auto data =
      PlaceLandmarks(flight.tracks, flight.features, options, &motion);
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_EQ(data->views.size(), 20U);
  for (std::size_t k = 0; k < 20; ++k) {
    ASSERT_TRUE(motion.camera_from_world[k]) << k;
    EXPECT_LT(geometry::AngleBetween_rad(
                  motion.camera_from_world[k]->rotation *
                      motion.camera_from_world[0]->rotation.conjugate(),
                  flight.camera_from_world[k].rotation *
                      flight.camera_from_world[0].rotation.conjugate()),
              0.3 * std::numbers::pi / 180.0)
        << k;
  }
}

// What shows nothing of the place stays out.
TEST(PlaceLandmarks, AnotherPlaceBehindACutIsNotPutIntoTheMap) {
  Flight flight = Fly({.num_images = 12, .cut_at = 8});
  const Flight other = Fly({.num_images = 12, .seed = 9});
  VideoMotion motion;
  motion.camera = flight.lens;
  for (std::uint32_t k = 0; k < 12; ++k) {
    motion.camera_from_world.push_back(
        k < 8 ? std::optional(flight.camera_from_world[k]) : std::nullopt);
    if (k >= 8) flight.features[k] = other.features[k];
  }
  std::erase_if(flight.tracks.tracks, [](const FeatureTrack& track) {
    return track.back().image >= 8;
  });
  LandmarkOptions options;
  options.lens_is_known = true;
  const auto data =
      PlaceLandmarks(flight.tracks, flight.features, options, &motion);
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_EQ(data->views.size(), 8U);
}

class BuildFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    path_ = std::filesystem::temp_directory_path() /
            ("track_motion_test_" + std::to_string(::getpid()));
  }
  void TearDown() override { std::filesystem::remove(path_); }
  std::filesystem::path path_;
};

TEST_F(BuildFiles, TracksComeBackAndDamageIsNamed) {
  FeatureTracks tracks = Fly({.num_images = 5}).tracks;
  tracks.film_focal_mm = 24.5;
  ASSERT_TRUE(WriteTracks(tracks, path_).ok());
  const auto back = ReadTracks(path_);
  ASSERT_TRUE(back.ok()) << back.status();
  ASSERT_EQ(back->tracks.size(), tracks.tracks.size());
  EXPECT_EQ(back->num_images, 5U);
  EXPECT_EQ(back->film_focal_mm, 24.5);
  EXPECT_EQ(back->tracks.back().back().pixel_px,
            tracks.tracks.back().back().pixel_px);
  std::string bytes = *base::ReadFile(path_, 1 << 30);
  // Cut anywhere, and with a track that claims more than there is.
  for (const std::size_t size : {std::size_t{3}, bytes.size() / 2}) {
    ASSERT_TRUE(base::WriteFileAtomically(path_, bytes.substr(0, size)).ok());
    EXPECT_EQ(ReadTracks(path_).status().code(), absl::StatusCode::kDataLoss);
  }
  bytes.replace(24, 4, "\xff\xff\xff\x7f");
  ASSERT_TRUE(base::WriteFileAtomically(path_, bytes).ok());
  EXPECT_EQ(ReadTracks(path_).status().code(), absl::StatusCode::kDataLoss);
}

TEST_F(BuildFiles, MotionComesBackAndDamageIsNamed) {
  const Flight flight = Fly({.num_images = 3});
  VideoMotion motion;
  motion.camera = flight.lens;
  motion.focal_sigma_px = 4.5;
  motion.lens_doubt = "another lens";
  motion.camera_from_world = {
      flight.camera_from_world[0], std::nullopt, flight.camera_from_world[2]};
  ASSERT_TRUE(WriteMotion(motion, path_).ok());
  const auto back = ReadMotion(path_);
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(back->camera, motion.camera);
  EXPECT_EQ(back->focal_sigma_px, motion.focal_sigma_px);
  EXPECT_EQ(back->lens_doubt, motion.lens_doubt);
  ASSERT_EQ(back->camera_from_world.size(), 3U);
  EXPECT_FALSE(back->camera_from_world[1]);
  EXPECT_LT((back->camera_from_world[2]->translation -
             motion.camera_from_world[2]->translation)
                .norm(),
            1e-12);
  for (const char* text :
       {"", "[]", "{\"camera\":{},\"camera_from_world\":[[1,2]]}"}) {
    ASSERT_TRUE(base::WriteFileAtomically(path_, text).ok());
    EXPECT_FALSE(ReadMotion(path_).ok()) << text;
  }
}

}  // namespace
}  // namespace groundlock::build::internal
