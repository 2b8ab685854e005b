// SPDX-License-Identifier: Apache-2.0
// Aligning a map by distance, control points, camera positions and ground.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "map_store/geometry/geodesy.h"
#include "map_store/geometry/robust_similarity.h"
#include "map_store/map/alignment.h"

namespace groundlock::map {
namespace {

using geometry::GeodeticPosition;
using geometry::Similarity3;
using ::testing::Contains;
using ::testing::HasSubstr;

constexpr GeodeticPosition kBerlin{52.519, 13.4, 80.0};

// A metric, level world: a textured ground at z = 0 with some boxes on it, and
// cameras that look down from 10 m on a bent path.
MapData TrueMap(bool straight = false) {
  std::mt19937_64 generator(3);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  MapData data;
  data.source_format = "test";
  data.cameras.push_back(
      *geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                     640,
                                     480,
                                     std::vector<double>{400, 320, 240}));
  for (int i = 0; i < 600; ++i) {
    const double height = i % 6 == 0 ? 1.0 + unit(generator) : 0.0;
    data.landmarks.push_back(
        {{30.0 * unit(generator), 30.0 * unit(generator), height}, {}, 0.0F});
  }
  for (int i = 0; i < 20; ++i) {
    MapViewData& view = data.views.emplace_back();
    view.name = "image" + std::to_string(i) + ".jpg";
    const Eigen::Vector3d center(
        -20.0 + 2.0 * i, straight ? 0.0 : 12.0 * std::sin(0.3 * i), 10.0);
    // Looks down and ahead: y of the image is down in the world.
    const Eigen::Quaterniond world_from_camera(
        Eigen::AngleAxisd(M_PI + 0.4, Eigen::Vector3d::UnitX()));
    view.camera_from_world =
        geometry::Rigid3{world_from_camera, center}.Inverse();
    for (std::uint32_t j = 0; j < data.landmarks.size(); ++j) {
      const auto pixel = data.cameras[0].ImageFromCamera(
          view.camera_from_world * data.landmarks[j].p_world);
      if (!pixel || !data.cameras[0].IsInsideImage(*pixel)) continue;
      view.keypoints_px.push_back(pixel->cast<float>());
      view.landmarks.push_back(j);
    }
  }
  return data;
}

const Similarity3 kSomewhere{
    0.31,
    Eigen::Quaterniond(
        Eigen::AngleAxisd(1.1, Eigen::Vector3d(0.3, -0.5, 1).normalized())),
    {4, -3, 2}};

Eigen::Vector3d CenterOf(const MapData& data, std::size_t view) {
  return data.views[view].camera_from_world.Inverse().translation;
}

void ExpectSame(const MapData& a, const MapData& b, double tolerance) {
  for (std::size_t i = 0; i < a.landmarks.size(); i += 7) {
    EXPECT_LT((a.landmarks[i].p_world - b.landmarks[i].p_world).norm(),
              tolerance);
  }
}

TEST(AlignMap, ByDistanceScalesAndKeepsTheAxes) {
  const MapData truth = TrueMap();
  MapData data = truth;
  data.Transform({0.5, Eigen::Quaterniond::Identity(), {0, 0, 0}});
  AlignmentRequest request;
  KnownDistance distance;
  distance.from.p_world = data.landmarks[1].p_world;
  // The other end by where two images show it.
  const std::uint32_t landmark = data.views[3].landmarks[0];
  for (std::size_t v = 0; v < data.views.size(); ++v) {
    for (std::size_t i = 0; i < data.views[v].landmarks.size(); ++i) {
      if (data.views[v].landmarks[i] != landmark) continue;
      distance.to.pixels.push_back(
          {data.views[v].name, data.views[v].keypoints_px[i].cast<double>()});
    }
  }
  ASSERT_GE(distance.to.pixels.size(), 2U);
  distance.distance_m =
      (truth.landmarks[1].p_world - truth.landmarks[landmark].p_world).norm();
  request.method = distance;
  const auto report = AlignMap(request, data);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_NEAR(report->new_world_from_world.scale, 2.0, 1e-4);
  EXPECT_TRUE(data.metric);
  ExpectSame(data, truth, 0.01);
}

TEST(AlignMap, ByControlPointsOnEarthNamesTheWrongOne) {
  const MapData truth = TrueMap();
  MapData data = truth;
  data.Transform(kSomewhere);
  AlignmentRequest request;
  ControlPoints points;
  for (const std::size_t i : {0U, 1U, 2U, 3U, 4U, 5U, 7U}) {
    ControlPoint& point = points.points.emplace_back();
    point.name = "p" + std::to_string(i);
    point.point.p_world = data.landmarks[i].p_world;
    point.place =
        geometry::GeodeticFromWorld(kBerlin, truth.landmarks[i].p_world);
  }
  request.method = points;
  request.origin = kBerlin;
  MapData right = data;
  auto report = AlignMap(request, right);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_LT(report->max_error_m, 1e-5);
  EXPECT_EQ(right.origin, kBerlin);
  ExpectSame(right, truth, 1e-4);
  // The ground was found where it is, not moved.
  EXPECT_NEAR(right.ground.normal.z(), 1.0, 1e-3);
  EXPECT_NEAR(right.ground.d, 0.0, 0.05);

  points.points[2].place = geometry::GeodeticFromWorld(
      kBerlin, truth.landmarks[2].p_world + Eigen::Vector3d(4, 0, 0));
  request.method = points;
  report = AlignMap(request, data);
  ASSERT_TRUE(report.ok());
  EXPECT_THAT(report->warnings, Contains(HasSubstr("p2 is 4.0")));
}

AlignmentRequest GpsRequest(const MapData& truth, double sigma_m) {
  std::mt19937_64 generator(5);
  std::normal_distribution<double> noise(0.0, sigma_m);
  CameraPositions positions;
  positions.accuracy_m = sigma_m;
  for (std::size_t i = 0; i < truth.views.size(); ++i) {
    Eigen::Vector3d p =
        CenterOf(truth, i) +
        Eigen::Vector3d{noise(generator), noise(generator), noise(generator)};
    if (i % 5 == 2) p += Eigen::Vector3d(40, -25, 60);  // a bad fix
    positions.positions.push_back(
        {truth.views[i].name, geometry::GeodeticFromWorld(kBerlin, p)});
  }
  positions.positions.push_back({"not there.jpg", kBerlin});
  AlignmentRequest request;
  request.method = positions;
  return request;
}

TEST(AlignMap, ByGpsLeavesOutBadFixesAndPutsTheGroundAtZero) {
  const MapData truth = TrueMap();
  MapData data = truth;
  data.Transform(kSomewhere);
  // Tools put folders before names.
  for (MapViewData& view : data.views) view.name = "flight/1\\" + view.name;
  const auto report = AlignMap(GpsRequest(truth, 0.3), data);
  ASSERT_TRUE(report.ok()) << report.status();
  std::size_t num_left_out = 0;
  for (const auto& residual : report->residuals) {
    if (!residual.used) ++num_left_out;
  }
  EXPECT_EQ(num_left_out, 4U);
  EXPECT_THAT(report->warnings, Contains(HasSubstr("1 of 21 positions")));
  // 16 good fixes of 0.3 m.
  EXPECT_LT(report->rms_error_m, 3 * 0.3);
  ASSERT_TRUE(data.origin.has_value());
  EXPECT_NEAR(data.origin->height_m, 80.0, 1.0);
  // Where the map says a landmark is on Earth, it is.
  for (std::size_t i = 0; i < truth.landmarks.size(); i += 50) {
    const auto place =
        geometry::GeodeticFromWorld(*data.origin, data.landmarks[i].p_world);
    EXPECT_LT((geometry::WorldFromGeodetic(kBerlin, place) -
               truth.landmarks[i].p_world)
                  .norm(),
              1.5);
  }
  const Eigen::Vector3d below =
      CenterOf(data, 10).cwiseProduct(Eigen::Vector3d(1, 1, 0));
  EXPECT_LT(std::abs(data.ground.SignedDistance(below)), 1.0);
}

// A cheap receiver: it drifts, and its height by far more.
TEST(AlignMap, HeightsThatDriftAreLeftOutAndSaid) {
  const MapData truth = TrueMap();
  MapData data = truth;
  // Level already, but turned, shifted and of another scale.
  const Eigen::Quaterniond turn(
      Eigen::AngleAxisd(1.1, Eigen::Vector3d::UnitZ()));
  data.Transform({0.31, turn, {4, -3, 0}});
  CameraPositions positions;
  positions.accuracy_m = 0.5;
  for (std::size_t i = 0; i < truth.views.size(); ++i) {
    const double t = static_cast<double>(i);
    const Eigen::Vector3d drift(std::sin(0.9 * t), std::cos(0.7 * t), 4.0 * t);
    positions.positions.push_back(
        {truth.views[i].name,
         geometry::GeodeticFromWorld(kBerlin, CenterOf(truth, i) + drift)});
  }
  AlignmentRequest request;
  request.method = positions;
  MapData moved = data;
  const auto report = AlignMap(request, moved);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_THAT(report->warnings, Contains(HasSubstr("heights contradict")));
  EXPECT_NEAR(moved.ground.normal.z(), 1.0, 1e-3);
  EXPECT_NEAR(report->new_world_from_world.scale, 1 / 0.31, 0.1 / 0.31);
  EXPECT_LT(report->rms_horizontal_error_m, 1.5);

  // Places that have nothing to do with the map are still refused.
  std::mt19937_64 generator(8);
  std::uniform_real_distribution<double> unit(-30.0, 30.0);
  for (CameraPosition& position : positions.positions) {
    position.place = geometry::GeodeticFromWorld(
        kBerlin, {unit(generator), unit(generator), unit(generator)});
  }
  request.method = positions;
  const auto refused = AlignMap(request, data);
  EXPECT_EQ(refused.status().code(), absl::StatusCode::kFailedPrecondition);
}

TEST(AlignMap, PositionsWorseThanExpectedAreTakenWithAWarning) {
  const MapData truth = TrueMap();
  MapData data = truth;
  data.Transform(
      {0.31,
       Eigen::Quaterniond(Eigen::AngleAxisd(1.1, Eigen::Vector3d::UnitZ())),
       {4, -3, 0}});
  AlignmentRequest request = GpsRequest(truth, 1.0);
  std::get<CameraPositions>(request.method).accuracy_m = 0.2;
  const auto report = AlignMap(request, data);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_THAT(report->warnings,
              Contains(HasSubstr("not to the 0.2 m that were expected")));
  // 16 fixes of 1 m over 40 m.
  EXPECT_NEAR(report->new_world_from_world.scale, 1 / 0.31, 0.06 / 0.31);
}

TEST(AlignMap, AStraightWalkTakesTheMapsOwnUp) {
  const MapData truth = TrueMap(/*straight=*/true);
  MapData data = truth;
  // Level already, but turned, shifted and of another scale.
  data.Transform(
      {0.31,
       Eigen::Quaterniond(Eigen::AngleAxisd(1.1, Eigen::Vector3d::UnitZ())),
       {4, -3, 0}});
  const auto report = AlignMap(GpsRequest(truth, 0.3), data);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_THAT(report->warnings, Contains(HasSubstr("nearly on a line")));
  EXPECT_NEAR(data.ground.normal.z(), 1.0, 1e-3);
}

TEST(AlignMap, ByGroundAlone) {
  const MapData truth = TrueMap();
  for (const bool by_seed : {true, false}) {
    MapData data = truth;
    data.Transform(kSomewhere);
    AlignmentRequest request;
    if (by_seed) {
      request.ground = GroundSeed{kSomewhere * Eigen::Vector3d(0, 0, 0)};
    } else {
      request.ground = GroundAutomatic{};
    }
    const auto report = AlignMap(request, data);
    ASSERT_TRUE(report.ok()) << report.status();
    EXPECT_FALSE(data.metric);
    double worst = 0.0;
    for (std::size_t i = 0; i < truth.landmarks.size(); ++i) {
      worst = std::max(worst,
                       std::abs(data.landmarks[i].p_world.z() / 0.31 -
                                truth.landmarks[i].p_world.z()));
    }
    EXPECT_LT(worst, 0.05) << by_seed;
  }
}

// A source that GPS has placed keeps its axes: a wall that its cameras look at
// is no ground.
TEST(PutIntoWorld, AGeoreferencedSourceMovesOnlyUpOrDown) {
  MapData data = TrueMap();
  std::mt19937_64 generator(9);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  const std::size_t first = data.landmarks.size();
  for (int i = 0; i < 1'500; ++i) {
    data.landmarks.push_back(
        {{25.0 * unit(generator), 25.0, 5.0 + 5.0 * unit(generator)},
         {},
         0.0F});
  }
  for (auto& view : data.views) {
    for (std::size_t j = first; j < data.landmarks.size(); ++j) {
      view.keypoints_px.emplace_back(1.0F, 1.0F);
      view.landmarks.push_back(static_cast<std::uint32_t>(j));
    }
  }
  data.Transform({1.0, Eigen::Quaterniond::Identity(), {0, 0, 17}});
  data.world_from_source = {};
  data.metric = true;
  data.origin = kBerlin;
  std::vector<std::string> warnings;
  ASSERT_TRUE(PutIntoWorld(std::nullopt, std::nullopt, 0, data, warnings).ok());
  EXPECT_NEAR(data.world_from_source.translation.z(), -17.0, 0.1);
  EXPECT_NEAR(data.origin->height_m, kBerlin.height_m + 17.0, 0.1);
  EXPECT_GT(data.ground.normal.z(), 0.99);
  EXPECT_TRUE(data.in_world);
}

TEST(AlignMap, RefusesWhatDoesNotDetermineIt) {
  MapData data = TrueMap();
  const MapData before = data;
  AlignmentRequest request;
  CameraPositions positions;
  positions.positions = {{"image0.jpg", kBerlin}, {"image1.jpg", kBerlin}};
  request.method = positions;
  EXPECT_EQ(AlignMap(request, data).status().code(),
            absl::StatusCode::kFailedPrecondition);
  request.method = KnownDistance{};
  EXPECT_EQ(AlignMap(request, data).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(data.landmarks[0].p_world, before.landmarks[0].p_world);
}

TEST(Geodesy, GoesThereAndBackAndCurves) {
  const GeodeticPosition place{52.6, 13.5, 35.0};
  const Eigen::Vector3d p = geometry::WorldFromGeodetic(kBerlin, place);
  const GeodeticPosition back = geometry::GeodeticFromWorld(kBerlin, p);
  EXPECT_NEAR(back.latitude_deg, place.latitude_deg, 1e-11);
  EXPECT_NEAR(back.height_m, place.height_m, 1e-5);
  // A kilometre away, the ellipsoid has fallen by 1000^2 / 2 / 6.38e6 m.
  const auto far = geometry::GeodeticFromWorld(kBerlin, {1'000, 0, 0});
  EXPECT_NEAR(far.height_m - kBerlin.height_m, 0.078, 0.001);
  // One point, through two worlds.
  const geometry::Rigid3 world_from_other =
      geometry::WorldFromWorld(kBerlin, place);
  const Eigen::Vector3d q(120, -50, 7);
  EXPECT_LT((world_from_other * q -
             geometry::WorldFromGeodetic(kBerlin,
                                         geometry::GeodeticFromWorld(place, q)))
                .norm(),
            1e-5);
}

}  // namespace
}  // namespace groundlock::map
