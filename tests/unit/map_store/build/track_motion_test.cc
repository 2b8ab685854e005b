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
#include "map_store/build/internal/video_landmarks.h"

namespace groundlock::build::internal {
namespace {

constexpr int kWidth_px = 1'280;
constexpr int kHeight_px = 720;

struct Flight {
  geometry::CameraModel lens;
  std::vector<geometry::Rigid3> camera_from_world;
  FeatureTracks tracks;
  std::vector<ImageFeatures> features;  // per image
};

struct FlightOptions {
  int num_images = 24;
  double step_m = 1.5;         // forward, per image
  double turn_rad = 0.02;      // about the vertical, per image
  double share_moving = 0.25;  // of the points: they drive along
  double noise_px = 0.3;
  // No track leads from the images before it to those from it on; 0 = none is
  // cut.
  std::uint32_t cut_at = 0;
  std::uint64_t seed = 3;
};

// A drone 12 m up flies along a street between walls and looks ahead and down;
// a quarter of what it sees drives.
Flight Fly(const FlightOptions& options) {
  std::mt19937_64 generator(options.seed);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  std::normal_distribution<double> noise(0.0, options.noise_px);
  Flight flight;
  flight.lens = *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimpleRadial,
      kWidth_px,
      kHeight_px,
      std::vector<double>{905.0, 0.5 * kWidth_px, 0.5 * kHeight_px, -0.03});
  double heading = -0.2;
  Eigen::Vector3d center(0.0, 0.0, 12.0);
  for (int i = 0; i < options.num_images; ++i) {
    const Eigen::Vector3d ahead(std::cos(heading), std::sin(heading), 0.0);
    const Eigen::Vector3d z =
        (ahead - 0.4 * Eigen::Vector3d::UnitZ()).normalized();
    const Eigen::Vector3d x = ahead.cross(Eigen::Vector3d::UnitZ());
    Eigen::Matrix3d world_from_camera;
    world_from_camera << x, z.cross(x), z;
    flight.camera_from_world.push_back(
        geometry::Rigid3{Eigen::Quaterniond(world_from_camera), center}
            .Inverse());
    center += options.step_m * ahead;
    heading += options.turn_rad;
  }
  flight.tracks.width_px = kWidth_px;
  flight.tracks.height_px = kHeight_px;
  flight.tracks.num_images = static_cast<std::uint32_t>(options.num_images);
  flight.features.resize(flight.tracks.num_images);
  for (std::uint32_t k = 0; k < flight.tracks.num_images; ++k) {
    flight.features[k].name = "image" + std::to_string(k);
    flight.features[k].width_px = kWidth_px;
    flight.features[k].height_px = kHeight_px;
  }
  std::mt19937_64 looks(options.seed);
  for (int i = 0; i < 1'500; ++i) {
    Eigen::Vector3d p(
        60.0 + 60.0 * uniform(generator), 30.0 * uniform(generator), 0.0);
    if (i % 3 == 0) {
      p.y() = std::copysign(20.0, p.y());
      p.z() = 5.0 + 5.0 * uniform(generator);
    }
    const bool moves = uniform(generator) < 2.0 * options.share_moving - 1.0;
    map::Descriptor look;
    for (auto& value : look) value = static_cast<std::uint8_t>(looks() % 100);
    FeatureTrack track;
    for (std::uint32_t k = 0; k < flight.tracks.num_images; ++k) {
      Eigen::Vector3d now = p;
      if (moves) now.x() += 2.5 * k;
      const auto pixel =
          flight.lens.ImageFromCamera(flight.camera_from_world[k] * now);
      if (!pixel || !flight.lens.IsInsideImage(*pixel)) continue;
      track.push_back(
          {k,
           (*pixel + Eigen::Vector2d(noise(generator), noise(generator)))
               .cast<float>()});
      ImageFeatures& features = flight.features[k];
      features.keypoints_px.push_back(track.back().pixel_px);
      features.descriptors.push_back(look);
      features.rgb.push_back({128, 128, 128});
    }
    // Followed for a while only, and taken up at any time.
    std::erase_if(track, [&](const TrackSight& sight) {
      const auto start =
          static_cast<std::uint32_t>(i) % flight.tracks.num_images;
      return sight.image < start || sight.image >= start + 10 ||
             (start < options.cut_at && sight.image >= options.cut_at);
    });
    if (track.size() >= 2) flight.tracks.tracks.push_back(std::move(track));
  }
  return flight;
}

// How far rotations between images differ from the true ones, at most, rad.
double WorstTurn_rad(const Flight& flight, const TrackScene& scene) {
  double worst = 0.0;
  for (std::size_t i = 1; i < flight.camera_from_world.size(); ++i) {
    const Eigen::Quaterniond truth =
        flight.camera_from_world[i].rotation *
        flight.camera_from_world[0].rotation.conjugate();
    const Eigen::Quaterniond found =
        scene.camera_from_world[i]->rotation *
        scene.camera_from_world[0]->rotation.conjugate();
    worst = std::max(worst, geometry::AngleBetween_rad(truth, found));
  }
  return worst;
}

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

// The lens is 905 px, the prior believes 1088 +- 35 %.
struct Found {
  double off_px = 0.0;
  double sigma_px = 0.0;
};
Found FindLens(const FlightOptions& flight) {
  const auto motion = ReconstructMotion(Fly(flight).tracks, {});
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
// shifts make up for it.
TEST(ReconstructMotion, AStraightFlightDoesNotTellTheLensAndSaysSo) {
  for (const std::uint64_t seed : {3U, 5U}) {
    const Found found = FindLens({.turn_rad = 0.0, .seed = seed});
    EXPECT_LT(std::abs(found.off_px), 3.0 * found.sigma_px) << seed;
    EXPECT_GT(found.sigma_px, 0.04 * 905.0) << seed;
  }
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
  motion.camera_from_world = {
      flight.camera_from_world[0], std::nullopt, flight.camera_from_world[2]};
  ASSERT_TRUE(WriteMotion(motion, path_).ok());
  const auto back = ReadMotion(path_);
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(back->camera, motion.camera);
  EXPECT_EQ(back->focal_sigma_px, motion.focal_sigma_px);
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
