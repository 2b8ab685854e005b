// SPDX-License-Identifier: Apache-2.0
// What the fast localizer promises, on rendered sequences with a truth.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "server/localization/localizer.h"
#include "tests/support/cut_map.h"
#include "tests/support/perturbation.h"
#include "tests/support/recorded_data.h"

namespace groundlock::localization {
namespace {

using geometry::Vector6d;
using test_support::Quantile;

struct Errors {
  int frames = 0;
  int odometry_frames = 0;
  std::vector<double> centre_m;
  std::vector<double> angle_deg;
  std::vector<double> over_sigma;  // of the centre, by what is said of it
  // Normalised estimation error squared: its mean is the dimension.
  double sum_nees_pose = 0.0;
  double sum_nees_centre = 0.0;
  double sum_nees_rotation = 0.0;
};

double Nees(const Eigen::VectorXd& error, const Eigen::MatrixXd& covariance) {
  return error.dot(covariance.ldlt().solve(error));
}

// Of a sequence, and of the map that it is localised in.
struct Part {
  int first_frame = 0;
  int frames = 1 << 30;
  // The map is without what lies before it.
  std::optional<geometry::Plane> cut = std::nullopt;
};

absl::StatusOr<Errors> Localise(const std::string& name,
                                const Part& part = {}) {
  auto sequence = test_support::FindSequence(name);
  if (!sequence.ok()) return sequence.status();
  auto map = test_support::ImportMap(sequence->reconstruction, sequence->align);
  if (!map.ok()) return map.status();
  if (part.cut) {
    map = test_support::WriteAndOpen(
        test_support::CutMap((*map)->ToData(), *part.cut));
    if (!map.ok()) return map.status();
  }
  auto camera = test_support::ReadCamera(sequence->camera);
  if (!camera.ok()) return camera.status();
  auto truth = test_support::ReadTrueFrames(sequence->truth);
  if (!truth.ok()) return truth.status();
  auto frames = test_support::ReadFrames(
      sequence->video, 1, std::min(1 << 30, part.first_frame + part.frames));
  if (!frames.ok()) return frames.status();
  auto localizer = CreateLocalizer("fast", *map, LocalizerOptions());
  if (!localizer.ok()) return localizer.status();
  Errors errors;
  for (const auto& [index, bgr] : *frames) {
    if (index < part.first_frame) continue;
    image::Frame frame = image::Frame::FromBgr(bgr);
    frame.sequence = static_cast<std::uint64_t>(index);
    frame.capture_time = std::chrono::nanoseconds(
        static_cast<std::int64_t>(1e9 * index / sequence->frames_per_second));
    auto result = (*localizer)->Localize({&frame, *camera, {}});
    if (!result.ok()) return result.status();
    ++errors.frames;
    if (result->state == CameraState::kOdometry) {
      ++errors.odometry_frames;
    } else if (result->state != CameraState::kTracked) {
      continue;
    }
    const geometry::Rigid3& true_pose = truth->at(index).world_from_camera;
    const geometry::Rigid3& pose = *result->world_from_camera;
    Vector6d error;
    error << true_pose.translation - pose.translation,
        geometry::RotationVector(true_pose.rotation *
                                 pose.rotation.conjugate());
    errors.centre_m.push_back(error.head<3>().norm());
    errors.angle_deg.push_back(error.tail<3>().norm() * 180.0 / EIGEN_PI);
    errors.over_sigma.push_back(
        error.head<3>().norm() /
        std::sqrt(result->covariance.topLeftCorner<3, 3>().trace()));
    errors.sum_nees_pose += Nees(error, result->covariance);
    errors.sum_nees_centre +=
        Nees(error.head<3>(), result->covariance.topLeftCorner<3, 3>());
    errors.sum_nees_rotation +=
        Nees(error.tail<3>(), result->covariance.bottomRightCorner<3, 3>());
  }
  return errors;
}

TEST(RenderedSequences, AreTrackedWithSmallErrorsThatItKnows) {
  if (!std::filesystem::exists(test_support::DataFolder() / "sim/lot")) {
    GTEST_SKIP() << "no rendered sequences in " << test_support::DataFolder();
  }
  Errors all;
  for (const char* name : {"srun", "scale", "outofview", "occlusion"}) {
    const auto errors = Localise(name);
    ASSERT_TRUE(errors.ok()) << errors.status();
    const auto tracked = static_cast<double>(errors->centre_m.size());
    EXPECT_GE(tracked, 0.99 * errors->frames) << name;
    all.frames += static_cast<int>(tracked);
    all.sum_nees_pose += errors->sum_nees_pose;
    all.sum_nees_centre += errors->sum_nees_centre;
    all.sum_nees_rotation += errors->sum_nees_rotation;
    EXPECT_LE(Quantile(errors->over_sigma, 0.95), 2.5) << name;
    // For seconds, `outofview` sees a far strip of facade alone: there the
    // baseline's median is 1.35 cm, and noise decides about the rest: with
    // other qualities of JPEG, or a grey level of noise, the median is up to
    // 1.5 cm, the p95 is 2.7 to 9.0 cm, and that it says so is what counts.
    const bool is_far = std::string_view(name) == "outofview";
    const auto bound = [is_far](double near, double far, double far_noisy) {
      return is_far ? test_support::Bound(far, far_noisy) : near;
    };
    EXPECT_LE(Quantile(errors->centre_m, 0.5), bound(0.01, 0.0135, 0.018))
        << name;
    EXPECT_LE(Quantile(errors->centre_m, 0.95), bound(0.03, 0.035, 0.15))
        << name;
    EXPECT_LE(Quantile(errors->centre_m, 1.0), bound(0.1, 0.1, 0.2)) << name;
    EXPECT_LE(Quantile(errors->angle_deg, 0.5), bound(0.03, 0.03, 0.04))
        << name;
    EXPECT_LE(Quantile(errors->angle_deg, 0.95), bound(0.1, 0.1, 0.3)) << name;
  }
  std::printf(
      "mean normalised error squared: pose %.2f, centre %.2f, "
      "rotation %.2f\n",
      all.sum_nees_pose / all.frames,
      all.sum_nees_centre / all.frames,
      all.sum_nees_rotation / all.frames);
  EXPECT_NEAR(all.sum_nees_pose / all.frames, 6.0, 0.3 * 6.0);
  EXPECT_NEAR(all.sum_nees_centre / all.frames, 3.0, 0.3 * 3.0);
  EXPECT_NEAR(all.sum_nees_rotation / all.frames, 3.0, 0.3 * 3.0);
}

// The camera turns by more than 90 degrees and moves by 25 cm. What it then
// sees shows hardly any parallax, and is not in the map.
TEST(RenderedSequences, ATurnOutOfTheMapHoldsThePlace) {
  if (!std::filesystem::exists(test_support::DataFolder() / "sim/lot")) {
    GTEST_SKIP() << "no rendered sequences in " << test_support::DataFolder();
  }
  const auto errors = Localise(
      "outofview", {.cut = geometry::Plane{-Eigen::Vector3d::UnitX(), -2.0}});
  ASSERT_TRUE(errors.ok()) << errors.status();
  EXPECT_EQ(errors->centre_m.size(), static_cast<std::size_t>(errors->frames));
  EXPECT_GE(errors->odometry_frames, 40);
  EXPECT_LE(Quantile(errors->centre_m, 1.0), 0.25);
  EXPECT_LE(Quantile(errors->over_sigma, 0.95), 2.5);
}

// The wall that the camera sees is not in the map; a board that shows the same
// photograph is, 90 degrees to the side.
TEST(RenderedSequences, APictureThatHangsElsewhereIsNotThePlace) {
  if (!std::filesystem::exists(test_support::DataFolder() / "sim/lot")) {
    GTEST_SKIP() << "no rendered sequences in " << test_support::DataFolder();
  }
  const auto errors =
      Localise("occlusion",
               {.first_frame = 106,
                .frames = 24,
                .cut = geometry::Plane{Eigen::Vector3d::UnitY(), -4.0}});
  ASSERT_TRUE(errors.ok()) << errors.status();
  EXPECT_EQ(errors->frames, 24);
  for (const double centre_m : errors->centre_m) EXPECT_LT(centre_m, 0.3);
}

}  // namespace
}  // namespace groundlock::localization
