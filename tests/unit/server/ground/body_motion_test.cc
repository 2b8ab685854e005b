// SPDX-License-Identifier: Apache-2.0
#include "server/ground/body_motion.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <random>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "server/ground/body_pose.h"
#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"

namespace groundlock::ground {
namespace {

using Eigen::Vector3d;
using geometry::Rigid3;

constexpr double kDegree = std::numbers::pi / 180.0;

// A car drives a bend in front of a camera that stands: it turns by 90 degrees
// in 16 views. Points of its sides are followed while they face the camera.
class BodyMotionTest : public testing::Test {
 protected:
  static constexpr int kViews = 16;

  static Rigid3 CameraPose() {
    const Vector3d eye(0.0, -5.0, 1.6);
    const Vector3d forward = (Vector3d(0.0, 0.0, 0.2) - eye).normalized();
    const Vector3d right = forward.cross(Vector3d::UnitZ()).normalized();
    Eigen::Matrix3d R;
    R << right, forward.cross(right), forward;
    return {Eigen::Quaterniond(R), eye};
  }
  static Rigid3 TruePose(int view) {
    const double turn_rad = 90.0 * kDegree * view / (kViews - 1);
    return {
        Eigen::Quaterniond(Eigen::AngleAxisd(turn_rad, Vector3d::UnitZ())),
        {-0.6 + 1.2 * std::sin(turn_rad), 0.6 - 1.2 * std::cos(turn_rad), 0.0}};
  }
  Eigen::Vector2d Pixel(const Rigid3& world_from_body,
                        const Vector3d& p_body) const {
    return *camera_.ImageFromCamera(CameraPose().Inverse() *
                                    (world_from_body * p_body));
  }

  // What is believed is off: the places by a share of their distance, all
  // alike, and the headings from view to view.
  void SetUp() override {
    std::normal_distribution<double> noise(0.0, 1.0);
    for (int v = 0; v < kViews; ++v) {
      Rigid3 guess = TruePose(v);
      const Vector3d foot(0.0, -5.0, 0.0);
      guess.translation = foot + 1.05 * (guess.translation - foot) +
                          0.03 * Vector3d{noise(random_), noise(random_), 0.0};
      guess.rotation = Eigen::Quaterniond(Eigen::AngleAxisd(
                           6.0 * kDegree * noise(random_), Vector3d::UnitZ())) *
                       guess.rotation;
      views_.push_back({camera_, CameraPose(), guess, 0.2, 20.0 * kDegree});
    }
    std::uniform_real_distribution<double> unit(-1.0, 1.0);
    for (int i = 0; i < 150; ++i) {
      Vector3d share{unit(random_), unit(random_), unit(random_)};
      const int face = i % 5;
      Vector3d normal = Vector3d::UnitZ();
      if (face < 4) {
        normal = (face % 2 == 0 ? 1 : -1) * Vector3d::Unit(face / 2);
      }
      share -= share.cwiseProduct(normal.cwiseAbs()) - normal;
      const Vector3d p_body = 0.5 * share.cwiseProduct(kSize_m) +
                              0.5 * kSize_m.z() * Vector3d::UnitZ();
      BodyTrack track;
      for (int v = 0; v < kViews; ++v) {
        const Rigid3 pose = TruePose(v);
        const Vector3d to_eye =
            (CameraPose().translation - pose * p_body).normalized();
        if (to_eye.dot(pose.rotation * normal) < 0.25) continue;
        track.observations.push_back(
            {static_cast<std::size_t>(v),
             Pixel(pose, p_body) +
                 0.3 * Eigen::Vector2d{noise(random_), noise(random_)}});
      }
      tracks_.push_back(track);
    }
  }

  // The body of those points that looked as it was drawn in the first view.
  std::optional<BodyFit> FitAsDrawn(const BodyMotion& motion,
                                    const Vector3d& guess_m,
                                    double ground_sigma_m) const {
    const GroundView drawn{
        &camera_, motion.world_from_body.front().Inverse() * CameraPose(), {}};
    BodyPoints seen{motion.points, {}};
    for (const Rigid3& world_from_body : motion.world_from_body) {
      seen.eyes_world.push_back(
          (world_from_body.Inverse() * CameraPose()).translation);
    }
    const auto truth_px =
        ProjectBodyHull(GroundView{&camera_, CameraPose(), {}},
                        UprightBox(geometry::Plane{},
                                   TruePose(0).translation,
                                   TruePose(0).rotation * Vector3d::UnitX(),
                                   kSize_m));
    if (!truth_px) return std::nullopt;
    return FitBodyToPoints(
        drawn,
        *truth_px,
        UprightBox(
            geometry::Plane{}, Vector3d::Zero(), Vector3d::UnitX(), guess_m),
        {.heading_sigma_rad = 10.0 * kDegree,
         .scale_sigma = 0.1,
         .ground_sigma_m = ground_sigma_m},
        seen);
  }
  double SizeError(const BodyFit& fit) const {
    const Vector3d ratio = (fit.scale * fit.box.size_m).cwiseQuotient(kSize_m);
    return (ratio - Vector3d::Ones()).cwiseAbs().maxCoeff();
  }

  void LetPointsSlide() {
    // Followed for five views each, they stay behind the body's turn by a
    // degree from view to view.
    std::uniform_real_distribution<double> unit(-1.0, 1.0);
    tracks_.clear();
    for (int i = 0; i < 150; ++i) {
      const Vector3d p_body{0.45 * unit(random_),
                            0.25 * unit(random_),
                            0.2 + 0.15 * unit(random_)};
      const int first = i % (kViews - 4);
      BodyTrack track;
      for (int k = 0; k < 5; ++k) {
        const Rigid3 slides{Eigen::Quaterniond(Eigen::AngleAxisd(
                                -k * kDegree, Vector3d::UnitZ())),
                            Vector3d::Zero()};
        track.observations.push_back(
            {static_cast<std::size_t>(first + k),
             Pixel(TruePose(first + k) * slides, p_body)});
      }
      tracks_.push_back(track);
    }
  }

  // Of the body where it really is.
  SeenOutline TrueOutline(int view) const {
    const GroundView seen_by{&camera_, CameraPose(), {}};
    const Rigid3 pose = TruePose(view);
    geometry::Box3 box;
    box.size_m = kSize_m;
    box.world_from_object = {pose.rotation,
                             pose * Vector3d(0.0, 0.0, 0.5 * kSize_m.z())};
    const auto outline_px = *ProjectBodyHull(seen_by, box, BodyShape{});
    return {outline_px, outline_px, 2.0};
  }

  // Of the last tracks, which are none of the body's, hardly one is kept.
  void ExpectOnlyTheBody(std::size_t others) const {
    const auto motion = SolveBodyMotion(views_, tracks_, {kSize_m});
    ASSERT_TRUE(motion);
    std::size_t kept = 0;
    for (const std::size_t track : motion->tracks) {
      kept += track >= tracks_.size() - others ? 1 : 0;
    }
    EXPECT_LT(kept, 4U);
    EXPECT_GT(motion->tracks.size() - kept, 80U);
  }

  const Vector3d kSize_m{0.9, 0.5, 0.35};
  std::mt19937_64 random_{3};
  geometry::CameraModel camera_ =
      *geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                     1280,
                                     720,
                                     std::array{1050.0, 640.0, 360.0});
  std::vector<BodyView> views_;
  std::vector<BodyTrack> tracks_;
};

TEST_F(BodyMotionTest, PointsAndTheDrawnBoxTellSizeAndPlaceOfACarInABend) {
  const Vector3d wrong_m(0.75, 0.65, 0.3);
  const auto motion = SolveBodyMotion(views_, tracks_, {wrong_m});
  ASSERT_TRUE(motion);
  EXPECT_GT(motion->tracks.size(), 80U);
  // Turns between the views are those of the body.
  const double turn_rad =
      geometry::AngleBetween_rad(motion->world_from_body.front().rotation,
                                 motion->world_from_body.back().rotation);
  EXPECT_NEAR(turn_rad, 90.0 * kDegree, 3.0 * kDegree);

  const auto fit = FitAsDrawn(*motion, wrong_m, 0.0);
  ASSERT_TRUE(fit);
  EXPECT_LT(SizeError(*fit), 0.08);
  const Vector3d bottom_world =
      motion->world_from_body.front() * fit->box.BottomCenterWorld();
  const Vector3d& eye = CameraPose().translation;
  const Vector3d place = eye + fit->scale * (bottom_world - eye);
  EXPECT_LT((place - TruePose(0).translation).norm(), 0.06)
      << place.transpose() << " scale " << fit->scale;
}

// Where it starts the ground is said to be 5 cm higher, and tilted by 10
// degrees otherwise, than it is, and less so where it goes.
TEST_F(BodyMotionTest, TheGroundNeedNotBeAsItIsSaidToBe) {
  constexpr double kRise_m = 0.05;
  constexpr double kTilt_rad = 10.0 * kDegree;
  for (int v = 0; v < kViews; ++v) {
    const double share = 1.0 - 1.0 * v / (kViews - 1);
    Rigid3& pose = views_[static_cast<std::size_t>(v)].world_from_body;
    pose.translation.z() += share * kRise_m;
    pose.rotation = Eigen::Quaterniond(Eigen::AngleAxisd(share * kTilt_rad,
                                                         Vector3d::UnitX())) *
                    pose.rotation;
  }
  struct Errors {
    double heading_rad = 0.0;  // the largest one
    double size = 1.0;
  };
  const auto off = [&](double height_sigma_m, double tilt_sigma_rad) {
    for (BodyView& view : views_) {
      view.ground_covariance =
          Vector3d(height_sigma_m, tilt_sigma_rad, tilt_sigma_rad)
              .cwiseAbs2()
              .asDiagonal();
    }
    Errors errors;
    const auto motion = SolveBodyMotion(views_, tracks_, {kSize_m});
    EXPECT_TRUE(motion);
    if (!motion) return errors;
    for (int v = 0; v < kViews; ++v) {
      const Rigid3& pose = motion->world_from_body[static_cast<std::size_t>(v)];
      const Vector3d along =
          TruePose(v).rotation.conjugate() * pose.rotation * Vector3d::UnitX();
      errors.heading_rad = std::max(errors.heading_rad,
                                    std::abs(std::atan2(along.y(), along.x())));
    }
    const auto fit = FitAsDrawn(*motion, kSize_m, height_sigma_m);
    EXPECT_TRUE(fit);
    if (fit) errors.size = SizeError(*fit);
    return errors;
  };
  const Errors known = off(0.0, 0.0);
  EXPECT_GT(known.heading_rad, 10.0 * kDegree);
  EXPECT_GT(known.size, 0.1);
  const Errors found = off(kRise_m, kTilt_rad);
  EXPECT_LT(found.heading_rad, 3.0 * kDegree);
  EXPECT_LT(found.size, 0.06);
}

TEST_F(BodyMotionTest, LeavesOutWhatGoesOtherwise) {
  // The ground under it, which does not go with the car.
  std::uniform_real_distribution<double> unit(-0.4, 0.4);
  constexpr std::size_t kGround = 40;
  for (std::size_t i = 0; i < kGround; ++i) {
    const Vector3d p_world{unit(random_), unit(random_) - 0.2, 0.0};
    BodyTrack track;
    for (std::size_t v = 0; v < 8; ++v) {
      track.observations.push_back({v, Pixel(Rigid3{}, p_world)});
    }
    tracks_.push_back(track);
  }
  ExpectOnlyTheBody(kGround);
}

TEST_F(BodyMotionTest, LeavesOutWhatRestsThoughItIsSeenBriefly) {
  // The ground behind it, in three views each: some depth on a body that turns
  // explains nearly the same pixels.
  std::uniform_real_distribution<double> unit(-0.5, 0.5);
  std::normal_distribution<double> noise(0.0, 0.2);
  constexpr std::size_t kGround = 60;
  for (std::size_t i = 0; i < kGround; ++i) {
    const std::size_t first = i % (kViews - 2);
    const Vector3d p_world = TruePose(static_cast<int>(first)).translation +
                             Vector3d{unit(random_), 0.5 + unit(random_), 0.0};
    BodyTrack track;
    for (std::size_t v = first; v < first + 3; ++v) {
      track.observations.push_back(
          {v,
           Pixel(Rigid3{}, p_world) +
               Eigen::Vector2d{noise(random_), noise(random_)}});
    }
    tracks_.push_back(track);
  }
  ExpectOnlyTheBody(kGround);
}

TEST_F(BodyMotionTest, KeepsWhatIsSeenOnlyWhileTheBodyRests) {
  // It stands in six views before it goes, and the camera goes by.
  constexpr std::size_t kResting = 6;
  std::vector<BodyView> resting;
  for (std::size_t v = 0; v < kResting; ++v) {
    BodyView view = views_.front();
    view.world_from_camera.translation.x() -= 0.15 * static_cast<double>(v + 1);
    resting.insert(resting.begin(), view);
  }
  views_.insert(views_.begin(), resting.begin(), resting.end());
  for (BodyTrack& track : tracks_) {
    for (auto& seen : track.observations) seen.view += kResting;
  }
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  std::normal_distribution<double> noise(0.0, 0.2);
  constexpr std::size_t kSeenAtRest = 40;
  for (std::size_t i = 0; i < kSeenAtRest; ++i) {
    const Vector3d p_body{
        0.45 * unit(random_), -0.25, 0.2 + 0.1 * unit(random_)};
    BodyTrack track;
    for (std::size_t v = 0; v < kResting; ++v) {
      track.observations.push_back(
          {v,
           *camera_.ImageFromCamera(views_[v].world_from_camera.Inverse() *
                                    (TruePose(0) * p_body)) +
               Eigen::Vector2d{noise(random_), noise(random_)}});
    }
    tracks_.push_back(track);
  }
  const auto motion = SolveBodyMotion(views_, tracks_, {kSize_m});
  ASSERT_TRUE(motion);
  EXPECT_EQ(motion->seen_in_first, kSeenAtRest);
}

TEST_F(BodyMotionTest, ItsWayHoldsTheHeadingWherePointsSlide) {
  LetPointsSlide();
  const auto motion = SolveBodyMotion(views_, tracks_, {kSize_m});
  ASSERT_TRUE(motion);
  const double turn_rad =
      geometry::AngleBetween_rad(motion->world_from_body.front().rotation,
                                 motion->world_from_body.back().rotation);
  // 76.7 to 78.1 degrees in twelve draws; of the points alone 75.5 to 75.7.
  EXPECT_GT(turn_rad, 76.2 * kDegree);
  EXPECT_LT(turn_rad, 90.0 * kDegree);
}

TEST_F(BodyMotionTest, ItsSilhouettesHoldThePlacesWherePointsSlide) {
  LetPointsSlide();
  const auto worst_m = [&] {
    const auto motion = SolveBodyMotion(views_, tracks_, {kSize_m});
    double most_m = 0.0;
    for (int v = 0; motion && v < kViews; ++v) {
      most_m = std::max(
          most_m,
          (motion->world_from_body[v].translation - TruePose(v).translation)
              .norm());
    }
    return motion ? most_m : 1e9;
  };
  EXPECT_GT(worst_m(), 0.2);
  for (int v = 0; v < kViews; v += 2) views_[v].outline = TrueOutline(v);
  EXPECT_LT(worst_m(), 0.1);
}

TEST_F(BodyMotionTest, KnownPointsTellThePoseWhateverAThirdOfThemDoes) {
  const Vector3d p_body[] = {{0.4, -0.25, 0.1},
                             {-0.4, -0.25, 0.1},
                             {0.0, -0.25, 0.2},
                             {0.3, -0.1, 0.2},
                             {-0.1, 0.0, 0.35},
                             {0.1, 0.1, 0.35},
                             {0.2, -0.25, 0.15},
                             {-0.3, -0.2, 0.2},
                             {0.45, 0.0, 0.1},
                             {0.45, -0.2, 0.15},
                             {-0.2, -0.25, 0.05},
                             {0.05, -0.25, 0.1}};
  BodyView predicted = views_[4];
  predicted.world_from_body = TruePose(3);
  predicted.place_sigma_m = 0.3;
  std::vector<BodySighting> seen;
  for (std::size_t i = 0; i < std::size(p_body); ++i) {
    // Every third stays where it was.
    const Rigid3 pose = TruePose(i % 3 == 2 ? 3 : 4);
    seen.push_back({p_body[i], Pixel(pose, p_body[i])});
  }
  const auto pose = LocateBody(predicted, seen, 0.5);
  ASSERT_TRUE(pose);
  EXPECT_EQ(pose->agreeing, 8U);
  EXPECT_LT(
      (pose->world_from_body.translation - TruePose(4).translation).norm(),
      0.01);
  EXPECT_LT(geometry::AngleBetween_rad(pose->world_from_body.rotation,
                                       TruePose(4).rotation),
            1.0 * kDegree);
  EXPECT_FALSE(LocateBody(predicted, std::span(seen).first(2), 0.5));
}

// A few centimetres of the ground's height are decimetres of distance, as low
// as this camera is; how large the body looks tells both.
TEST_F(BodyMotionTest, SizeTellsTheDistanceWhereTheGroundsHeightIsNotKnown) {
  constexpr double kRise_m = 0.06;
  Rigid3 truth = TruePose(4);
  truth.translation.z() += kRise_m;
  std::vector<BodySighting> seen;
  for (const double along : {-0.45, -0.2, 0.1, 0.45}) {
    for (const double high : {0.05, 0.2, 0.35}) {
      const Vector3d p_body(along, -0.25, high);
      seen.push_back({p_body, Pixel(truth, p_body)});
    }
  }
  BodyView predicted = views_[4];
  predicted.world_from_body = TruePose(4);
  predicted.place_sigma_m = 0.3;
  const auto off_m = [&](const std::optional<BodyPose>& pose) {
    return (pose->world_from_body.translation - truth.translation)
        .head<2>()
        .norm();
  };
  const auto on_ground = LocateBody(predicted, seen, 0.5);
  ASSERT_TRUE(on_ground);
  EXPECT_NEAR(on_ground->ground.norm(), 0.0, 1e-9);
  EXPECT_GT(off_m(on_ground), 0.1);
  predicted.ground_covariance(0, 0) = 0.05 * 0.05;
  const auto risen = LocateBody(predicted, seen, 0.5);
  ASSERT_TRUE(risen);
  EXPECT_LT(off_m(risen), 0.02);
  EXPECT_NEAR(risen->ground[0], kRise_m, 0.01);
  EXPECT_LT(risen->ground_covariance(0, 0), 0.01 * 0.01);
}

TEST_F(BodyMotionTest, SaysWhereTheFirstViewSharesNoPoints) {
  for (BodyTrack& track : tracks_) {
    std::erase_if(track.observations,
                  [](const auto& seen) { return seen.view == 0; });
  }
  const auto motion = SolveBodyMotion(views_, tracks_, {kSize_m});
  ASSERT_TRUE(motion);
  EXPECT_EQ(motion->seen_in_first, 0U);
  EXPECT_FALSE(SolveBodyMotion(views_, {}, {kSize_m}));
  EXPECT_FALSE(SolveBodyMotion({}, {}, {kSize_m}));
}

}  // namespace
}  // namespace groundlock::ground
