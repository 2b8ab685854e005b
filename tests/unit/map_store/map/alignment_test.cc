// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/alignment.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "map_store/formats/formats.h"
#include "map_store/map/map_data.h"
#include "tests/unit/map_store/map/synthetic_map.h"

namespace groundlock::map {
namespace {

using testing_map::MakeMapData;
using testing_map::SceneOptions;

constexpr double kDegree = std::numbers::pi / 180.0;

geometry::Similarity3 Arbitrary() {
  return {0.37,
          Eigen::Quaterniond(0.4, -0.7, 0.2, 0.55).normalized(),
          {3.0, -20.0, 7.0}};
}

// The map as a reconstruction without scale and orientation would give it.
MapData Unaligned(const SceneOptions& options) {
  MapData data = MakeMapData(options);
  data.Transform(Arbitrary());
  data.world_from_source = {};
  data.metric = false;
  return data;
}

TEST(MapDataTest, TransformKeepsReprojectionAndGround) {
  MapData data = MakeMapData();
  const double before = ComputeReprojection(data).mean_error_px;
  data.Transform(Arbitrary());
  EXPECT_NEAR(ComputeReprojection(data).mean_error_px, before, 1e-9);
  EXPECT_TRUE(data.Validate().ok()) << data.Validate();
  // A point of the old ground lies on the new one.
  EXPECT_NEAR(
      data.ground.SignedDistance(Arbitrary() * Eigen::Vector3d(3.0, -2.0, 0.0)),
      0.0,
      1e-12);
  EXPECT_NEAR(
      data.ground.SignedDistance(Arbitrary() * Eigen::Vector3d(3.0, -2.0, 1.0)),
      0.37,
      1e-12);
  data.Transform(Arbitrary().Inverse());
  EXPECT_NEAR(data.world_from_source.scale, 1.0, 1e-12);
  EXPECT_LT(data.world_from_source.translation.norm(), 1e-9);
}

TEST(MapDataTest, ReprojectionCountsWhatIsBehind) {
  MapData data = MakeMapData();
  const std::size_t all = ComputeReprojection(data).num_observations;
  for (Eigen::Vector2f& pixel : data.views[0].keypoints_px) pixel.x() += 2.0F;
  const std::size_t moved = data.views[0].keypoints_px.size();
  // Exact observations but for float rounding (6e-5 px at 1280).
  EXPECT_NEAR(ComputeReprojection(data).mean_error_px,
              2.0 * static_cast<double>(moved) / static_cast<double>(all),
              1e-3);
  data.landmarks[data.views[0].landmarks[0]].p_world =
      data.views[0].camera_from_world.Inverse() * Eigen::Vector3d(0, 0, -1);
  EXPECT_GE(ComputeReprojection(data).num_behind_camera, 1U);
}

TEST(AlignToWorldTest, AppliesTheGivenTransform) {
  const MapData truth = MakeMapData();
  MapData data = Unaligned({});
  ASSERT_TRUE(AlignToWorld(Arbitrary().Inverse(), data).ok());
  EXPECT_TRUE(data.metric);
  for (std::size_t i = 0; i < data.landmarks.size(); ++i) {
    EXPECT_LT((data.landmarks[i].p_world - truth.landmarks[i].p_world).norm(),
              1e-9);
  }
  // The landmarks lie about z = 0 already: no reason for another ground.
  EXPECT_EQ(data.ground.normal, Eigen::Vector3d::UnitZ());
  EXPECT_EQ(data.ground.d, 0.0);
  // Aligned again, the new alignment replaces the old one.
  ASSERT_TRUE(AlignToWorld(Arbitrary().Inverse(), data).ok());
  EXPECT_LT((data.landmarks[0].p_world - truth.landmarks[0].p_world).norm(),
            1e-9);
}

TEST(AlignToWorldTest, FollowsAGroundNearZero) {
  const geometry::Similarity3 slightly_off{
      1.0,
      Eigen::Quaterniond(Eigen::AngleAxisd(
          1.5 * kDegree, Eigen::Vector3d(1, 1, 0).normalized())),
      {0.0, 0.0, 0.12}};
  MapData data = MakeMapData();
  data.world_from_source = {};
  ASSERT_TRUE(AlignToWorld(slightly_off, data).ok());
  // 300 landmarks of 5 mm noise over 12 m: 0.01 degrees and 1 mm; ten times
  // that, for what the walls' feet do to it.
  const Eigen::Vector3d normal =
      slightly_off.rotation * Eigen::Vector3d::UnitZ();
  EXPECT_LT(std::acos(std::min(1.0, data.ground.normal.dot(normal))),
            0.1 * kDegree);
  EXPECT_NEAR(data.ground.SignedDistance({0.0, 0.0, 0.12}), 0.0, 0.01);
}

TEST(AlignToWorldTest, DistrustsAGroundFarFromZero) {
  for (const geometry::Similarity3& off :
       {geometry::Similarity3{
            1.0, Eigen::Quaterniond::Identity(), {0.0, 0.0, 0.4}},
        geometry::Similarity3{1.0,
                              Eigen::Quaterniond(Eigen::AngleAxisd(
                                  4.0 * kDegree, Eigen::Vector3d::UnitX())),
                              {0.0, 0.0, 0.0}}}) {
    MapData data = MakeMapData();
    data.world_from_source = {};
    ASSERT_TRUE(AlignToWorld(off, data).ok());
    EXPECT_EQ(data.ground.normal, Eigen::Vector3d::UnitZ());
    EXPECT_EQ(data.ground.d, 0.0);
  }
}

TEST(AlignToWorldTest, RefusesWhatIsNoSimilarity) {
  MapData data = MakeMapData();
  EXPECT_EQ(AlignToWorld({-1.0, {}, {}}, data).code(),
            absl::StatusCode::kInvalidArgument);
  geometry::Similarity3 bad;
  bad.translation.x() = NAN;
  EXPECT_FALSE(AlignToWorld(bad, data).ok());
  bad = {};
  bad.rotation.coeffs().setZero();
  EXPECT_FALSE(AlignToWorld(bad, data).ok());
}

struct GroundCase {
  const char* name;
  SceneOptions options;
};
class EstimatedGroundTest : public testing::TestWithParam<GroundCase> {};

TEST_P(EstimatedGroundTest, BecomesZEqualsZero) {
  const SceneOptions& options = GetParam().options;
  const MapData truth = MakeMapData(options);
  MapData data = Unaligned(options);
  const auto estimate = AlignToEstimatedGround(7, data);
  ASSERT_TRUE(estimate.ok()) << estimate.status();
  EXPECT_FALSE(data.metric);
  EXPECT_NEAR(data.world_from_source.scale, 1.0, 1e-12);
  EXPECT_TRUE(data.Validate().ok()) << data.Validate();
  const double scale = Arbitrary().scale;
  // Landmarks have their true heights: the noise, and a tilt of 0.1 degrees at
  // 8 m, and what the walls' feet lift the plane by.
  for (std::size_t i = 0; i + 1 < data.landmarks.size(); ++i) {
    EXPECT_NEAR(data.landmarks[i].p_world.z() / scale,
                truth.landmarks[i].p_world.z(),
                0.03);
  }
  // The cameras stand over the origin, the first one's right is x.
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  for (const MapViewData& view : data.views) {
    center += view.camera_from_world.Inverse().translation;
  }
  center /= static_cast<double>(data.views.size());
  EXPECT_LT(center.head<2>().norm(), 1e-9);
  EXPECT_NEAR(center.z() / scale, options.height_m, 0.03);
  // What it promises of the height is kept, and is worth something.
  EXPECT_LT(std::abs(center.z() / scale - options.height_m),
            2.0 * estimate->height_sigma / scale);
  EXPECT_LT(estimate->height_sigma / scale, 0.1 * options.height_m);
  EXPECT_NEAR(data.ground_height_sigma * options.height_m,
              estimate->height_sigma / scale,
              0.01 * estimate->height_sigma / scale);
  EXPECT_GT(data.ground_height_sigma, 0.0);
  const Eigen::Vector3d right =
      data.views[0].camera_from_world.rotation.conjugate() *
      Eigen::Vector3d::UnitX();
  EXPECT_NEAR(right.x(), 1.0, 1e-4);
  // The same seed gives the same bits.
  MapData again = Unaligned(options);
  ASSERT_TRUE(AlignToEstimatedGround(7, again).ok());
  EXPECT_EQ(again.landmarks[0].p_world, data.landmarks[0].p_world);
}

INSTANTIATE_TEST_SUITE_P(
    Scenes,
    EstimatedGroundTest,
    testing::Values(
        GroundCase{"Walk", {}},
        GroundCase{"MostlyWalls", {.num_ground = 150, .num_wall = 600}},
        GroundCase{"DroneOblique",
                   {.pitch_rad = 0.9, .height_m = 10.0, .noise_m = 0.02}},
        GroundCase{"DroneNadir",
                   {.num_wall = 20,
                    .pitch_rad = 1.5707963267948966,
                    .height_m = 12.0,
                    .noise_m = 0.02}}),
    [](const auto& test) { return test.param.name; });

TEST(EstimatedGroundFailureTest, NeedsLandmarksAndAPlaneBelow) {
  MapData empty;
  EXPECT_EQ(AlignToEstimatedGround(0, empty).status().code(),
            absl::StatusCode::kFailedPrecondition);
  MapData few = MakeMapData({.num_ground = 10, .num_wall = 0});
  EXPECT_EQ(AlignToEstimatedGround(0, few).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

// A walk along a wall that fills the picture, or a flight over a ground: the
// landmarks and the cameras are the same.
MapData Facade() {
  MapData data = MakeMapData({.num_ground = 0, .num_wall = 600});
  std::erase_if(data.views, [](const MapViewData&) { return true; });
  for (int v = 0; v < 12; ++v) {
    MapViewData& view = data.views.emplace_back();
    view.name = std::to_string(v);
    // Looks along y at the wall y = 6.
    Eigen::Matrix3d world_from_camera;
    world_from_camera << 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0;
    view.camera_from_world =
        geometry::Rigid3{Eigen::Quaterniond(world_from_camera),
                         Eigen::Vector3d(0.4 * v - 2.0, 0.0, 1.6)}
            .Inverse();
    for (std::uint32_t i = 0; i < data.landmarks.size(); ++i) {
      const auto pixel = data.cameras[0].ImageFromCamera(
          view.camera_from_world * data.landmarks[i].p_world);
      if (!pixel || !data.cameras[0].IsInsideImage(*pixel)) continue;
      view.keypoints_px.emplace_back(pixel->cast<float>());
      view.landmarks.push_back(i);
      view.descriptors.emplace_back();
    }
  }
  data.in_world = false;
  data.metric = false;
  return data;
}

TEST(EstimatedGroundDoubtTest, AFacadeAloneIsNoGround) {
  MapData data = Facade();
  std::vector<std::string> warnings;
  ASSERT_TRUE(PutIntoWorld(std::nullopt, std::nullopt, 1, data, warnings).ok());
  EXPECT_EQ(data.ground_state, GroundState::kUnknown);
  ASSERT_EQ(warnings.size(), 1U);
  EXPECT_NE(warnings[0].find("the ground is unknown"), std::string::npos);
}

// What the photos' sensors say of up tells which of the two it is.
TEST(MeasuredUpTest, TellsAFacadeFromAGround) {
  MapData flight = Facade();
  // Away from the wall, which is then the ground below a camera that looks
  // straight down.
  flight.measured_up = MeasuredUp{
      Eigen::Vector3d(0.02, -1.0, 0.03).normalized(), 0.02, "photos"};
  std::vector<std::string> warnings;
  ASSERT_TRUE(
      PutIntoWorld(std::nullopt, std::nullopt, 1, flight, warnings).ok());
  EXPECT_EQ(flight.ground_state, GroundState::kEstimated);
  EXPECT_TRUE(warnings.empty()) << warnings.front();
  for (std::size_t i = 0; i + 1 < flight.landmarks.size(); i += 2) {
    EXPECT_NEAR(flight.landmarks[i].p_world.z(), 0.0, 0.03);
  }
  // The ground is level, up is measured to two degrees.
  EXPECT_GT(flight.measured_up->up_world.z(), std::cos(0.05));

  MapData walk = Facade();
  walk.measured_up = MeasuredUp{Eigen::Vector3d::UnitZ(), 0.02, "photos"};
  ASSERT_TRUE(PutIntoWorld(std::nullopt, std::nullopt, 1, walk, warnings).ok());
  EXPECT_EQ(walk.ground_state, GroundState::kUnknown);
  // Its world is upright all the same.
  EXPECT_GT(walk.measured_up->up_world.z(), 1.0 - 1e-9);
}

// A sure ground and another up: one of the two is wrong.
TEST(MeasuredUpTest, ThatContradictsASureGroundIsDoubted) {
  const Eigen::Vector3d up = Arbitrary().rotation * Eigen::Vector3d::UnitZ();
  MapData data = Unaligned({.num_views = 12, .pitch_rad = 0.5});
  const auto without = AlignToEstimatedGround(0, data);
  ASSERT_TRUE(without.ok()) << without.status();
  EXPECT_EQ(without->doubt, "");
  EXPECT_EQ(without->up_basis, "");

  data = Unaligned({.num_views = 12, .pitch_rad = 0.5});
  data.measured_up = MeasuredUp{up, 0.02, "the photos"};
  const auto with = AlignToEstimatedGround(0, data);
  ASSERT_TRUE(with.ok()) << with.status();
  EXPECT_EQ(with->doubt, "");
  EXPECT_EQ(with->up_basis, "the photos");
  EXPECT_GT(with->ground_source.normal.dot(up), std::cos(0.5 * kDegree));

  data = Unaligned({.num_views = 12, .pitch_rad = 0.5});
  data.measured_up = MeasuredUp{up.unitOrthogonal(), 0.02, "the photos"};
  const auto contradicted = AlignToEstimatedGround(0, data);
  ASSERT_TRUE(contradicted.ok()) << contradicted.status();
  EXPECT_NE(contradicted->doubt.find("the photos"), std::string::npos);
}

// Without the ground's landmarks nothing tells how high the walls' feet are.
TEST(EstimatedGroundDoubtTest, WallsAloneAreNoGround) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    MapData data = Unaligned({.num_ground = 0, .num_wall = 500, .seed = seed});
    const auto estimate = AlignToEstimatedGround(seed, data);
    EXPECT_TRUE(!estimate.ok() || !estimate->doubt.empty()) << seed;
  }
}

// Whatever part of a flight is left: right, or unknown.
TEST(EstimatedGroundDoubtTest, SubsetsAreNeverWrongAndSure) {
  std::mt19937_64 generator(9);
  int sure = 0;
  for (int round = 0; round < 20; ++round) {
    MapData data = Unaligned({.num_views = 12, .pitch_rad = 0.5});
    std::erase_if(data.views,
                  [&](const MapViewData&) { return generator() % 3 != 0; });
    if (data.views.empty()) continue;
    const Eigen::Vector3d up = Arbitrary().rotation * Eigen::Vector3d::UnitZ();
    const auto estimate = AlignToEstimatedGround(0, data);
    if (!estimate.ok() || !estimate->doubt.empty()) continue;
    ++sure;
    EXPECT_GT(estimate->ground_source.normal.dot(up), std::cos(2.0 * kDegree))
        << round;
  }
  EXPECT_GT(sure, 10);
}

// A ground that lies off z = 0 by little is measured where landmarks lie
// finely.
TEST(AlignToWorldTest, MeasuresATiltOfATenthOfADegree) {
  MapData data = MakeMapData({.num_ground = 1'500, .noise_m = 0.002});
  data.world_from_source = {};
  const geometry::Similarity3 off{1.0,
                                  Eigen::Quaterniond(Eigen::AngleAxisd(
                                      0.3 * kDegree, Eigen::Vector3d::UnitX())),
                                  {0.0, 0.0, 0.03}};
  ASSERT_TRUE(AlignToWorld(off, data).ok());
  EXPECT_EQ(data.ground_state, GroundState::kMeasured);
  const Eigen::Vector3d normal = off.rotation * Eigen::Vector3d::UnitZ();
  EXPECT_GT(data.ground.normal.dot(normal), std::cos(0.1 * kDegree));
  EXPECT_NEAR(data.ground.SignedDistance({0.0, 0.0, 0.03}), 0.0, 0.01);
}

// The rendered yard, whose alignment is surveyed.
class EstimatedGroundDataTest : public ::testing::Test {
 protected:
  void SetUp() override {
    const char* root = std::getenv("GROUNDLOCK_DATA");
    const std::filesystem::path model =
        std::filesystem::path(root != nullptr ? root : "../shared/data") /
        "sim/lot/map";
    if (!std::filesystem::exists(model)) {
      GTEST_SKIP() << model << " is not there; set GROUNDLOCK_DATA";
    }
    std::vector<std::string> warnings;
    auto data = formats::Import(model, {}, &warnings);
    ASSERT_TRUE(data.ok()) << data.status();
    data_ = *std::move(data);
  }

  double Tilt_rad(const GroundEstimate& estimate) const {
    const Eigen::Vector3d normal =
        truth_.rotation * estimate.ground_source.normal;
    return std::atan2(normal.head<2>().norm(), normal.z());
  }
  // Of the plane below the yard's middle.
  double Height_m(const GroundEstimate& estimate) const {
    const Eigen::Vector3d below = estimate.ground_source.Project(
        truth_.Inverse() * Eigen::Vector3d::Zero());
    return (truth_ * below).z();
  }

  MapData data_;
  const geometry::Similarity3 truth_{
      2.8666410673449625,
      Eigen::Quaterniond(-0.4927159890677561,
                         0.567844046910578,
                         -0.4923757433095199,
                         0.43857749589507905)
          .normalized(),
      {-0.331338762583078, -0.1069812536747318, 1.6643126667046804}};
};

TEST_F(EstimatedGroundDataTest, AgreesWithTheAlignmentOfTheRenderedYard) {
  const auto estimate = AlignToEstimatedGround(0, data_);
  ASSERT_TRUE(estimate.ok()) << estimate.status();
  EXPECT_EQ(estimate->doubt, "");
  // Measured over seeds 0-4: at most 0.05 degrees and 4 mm. A target's place
  // at 11 m from 1.6 m up needs 0.1 degrees for 13 cm.
  EXPECT_LT(Tilt_rad(*estimate), 0.1 * kDegree);
  EXPECT_NEAR(Height_m(*estimate), 0.0, 0.02);
}

// Random thirds and four fifths of the views: right, or unknown. Thirds hold
// the yard's ground by so little that planes up to 35 cm above it do as well.
TEST_F(EstimatedGroundDataTest, SubsetsOfTheRenderedYardAreNeverWrongAndSure) {
  int sure = 0;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    std::mt19937_64 generator(seed);
    const std::uint64_t kept = seed < 10 ? 5 : 12;  // of fifteen
    MapData data = data_;
    std::erase_if(data.views,
                  [&](const MapViewData&) { return generator() % 15 >= kept; });
    const auto estimate = AlignToEstimatedGround(seed, data);
    if (!estimate.ok() || !estimate->doubt.empty()) continue;
    ++sure;
    EXPECT_LT(Tilt_rad(*estimate), 2.0 * kDegree) << seed;
    EXPECT_NEAR(Height_m(*estimate), 0.0, 0.1) << seed;
  }
  EXPECT_GT(sure, 5);
}

// What stands in the yard is left, the ground is not: whatever is taken for it
// must not be believed, or be right.
TEST_F(EstimatedGroundDataTest, TheRenderedYardWithoutItsGroundIsUnknown) {
  for (const double up_to_m : {0.05, 0.15, 0.4}) {
    MapData data = data_;
    for (MapViewData& view : data.views) {
      std::size_t kept = 0;
      for (std::size_t i = 0; i < view.landmarks.size(); ++i) {
        const std::uint32_t landmark = view.landmarks[i];
        if ((truth_ * data.landmarks[landmark].p_world).z() < up_to_m) continue;
        view.landmarks[kept] = landmark;
        view.keypoints_px[kept] = view.keypoints_px[i];
        view.descriptors[kept] = view.descriptors[i];
        ++kept;
      }
      view.landmarks.resize(kept);
      view.keypoints_px.resize(kept);
      view.descriptors.resize(kept);
    }
    const auto estimate = AlignToEstimatedGround(0, data);
    if (!estimate.ok() || !estimate->doubt.empty()) continue;
    EXPECT_LT(Tilt_rad(*estimate), 2.0 * kDegree) << up_to_m;
    EXPECT_NEAR(Height_m(*estimate), 0.0, 0.1) << up_to_m;
  }
}

}  // namespace
}  // namespace groundlock::map
