// SPDX-License-Identifier: Apache-2.0
#include "server/localization/window/gyroscope.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <random>
#include <string>
#include <vector>

#include "tests/unit/server/localization/walk_test.h"

namespace groundlock::localization {
namespace {

using Eigen::Vector3d;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using ::testing::HasSubstr;

double Seconds(nanoseconds t) {
  return std::chrono::duration<double>(t).count();
}

Eigen::Quaterniond Turn(const Vector3d& v) {
  return geometry::QuaternionFromRotationVector(v);
}

// Unit and camera are turned against each other by an angle of no symmetry.
ImuModel Tilted() {
  ImuModel imu;
  imu.imu_from_camera = Turn({0.4, -1.1, 0.7});
  return imu;
}

// What a unit fixed to a camera on `world_from_camera` measures. Its errors are
// along the camera's axes.
std::vector<InertialSample> SamplesOf(
    const std::function<geometry::Rigid3(double t_s)>& world_from_camera,
    const ImuModel& imu,
    const GyroscopeErrors& errors,
    double noise_rad_s,
    nanoseconds from,
    nanoseconds to) {
  constexpr nanoseconds kStep = milliseconds(5);
  std::vector<InertialSample> samples;
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal(0.0, noise_rad_s);
  for (nanoseconds t = from; t <= to; t += kStep) {
    const double h_s = 1e-4;
    const auto before = world_from_camera(Seconds(t) - h_s).rotation;
    const auto after = world_from_camera(Seconds(t) + h_s).rotation;
    const Vector3d rate =
        geometry::RotationVector(before.conjugate() * after) / (2.0 * h_s);
    samples.push_back(
        {t,
         imu.imu_from_camera *
                 (rate + errors.scale * rate + errors.bias_rad_s) +
             Vector3d{normal(random), normal(random), normal(random)},
         {0.0, 0.0, 9.8}});
  }
  return samples;
}

TEST(Gyroscope, IntegratesTheTurnBetweenAnyTwoTimes) {
  const auto pose = [](double t) {
    return geometry::Rigid3{
        Turn({0.8 * std::sin(3.0 * t), 0.5 * t, 0.3 * std::cos(2.0 * t)}), {}};
  };
  const ImuModel imu = Tilted();
  Gyroscope gyroscope(imu);
  gyroscope.Add(
      SamplesOf(pose, imu, GyroscopeErrors(), 0.0, {}, milliseconds(500)));
  for (const auto& [from, to] : {std::pair{0, 500},
                                 std::pair{101, 143},
                                 std::pair{42, 84},
                                 std::pair{201, 203}}) {
    const auto turn = gyroscope.Between(
        milliseconds(from), milliseconds(to), GyroscopeErrors());
    ASSERT_TRUE(turn) << from;
    const Eigen::Quaterniond truth =
        pose(1e-3 * from).rotation.conjugate() * pose(1e-3 * to).rotation;
    EXPECT_LT(geometry::AngleBetween_rad(turn->before_from_now, truth), 2e-5);
    EXPECT_NEAR(turn->duration_s, 1e-3 * (to - from), 1e-12);
  }
}

TEST(Gyroscope, TheJacobianSaysWhatItsErrorsTurn) {
  const auto pose = [](double t) {
    return geometry::Rigid3{Turn({2.0 * t, 5.0 * t * t, -3.0 * t}), {}};
  };
  const ImuModel imu = Tilted();
  Gyroscope gyroscope(imu);
  gyroscope.Add(
      SamplesOf(pose, imu, GyroscopeErrors(), 0.0, {}, milliseconds(300)));
  GyroscopeErrors assumed;
  assumed.bias_rad_s = {0.02, -0.01, 0.03};
  assumed.scale.setConstant(0.01);
  const auto before = gyroscope.Between({}, milliseconds(250), assumed);
  ASSERT_TRUE(before);
  // What is left is of the second order of these.
  constexpr double kStep = 1e-4;
  for (int i = 0; i < 12; ++i) {
    Eigen::Matrix<double, 12, 1> de = Eigen::Matrix<double, 12, 1>::Zero();
    de(i) = kStep;
    GyroscopeErrors more = assumed;
    more.bias_rad_s += de.head<3>();
    more.scale.reshaped() += de.tail<9>();
    const auto after = gyroscope.Between({}, milliseconds(250), more);
    ASSERT_TRUE(after);
    const Eigen::Quaterniond expected =
        before->before_from_now * Turn(-before->error_jacobian * de);
    EXPECT_LT(geometry::AngleBetween_rad(after->before_from_now, expected),
              0.01 * geometry::AngleBetween_rad(after->before_from_now,
                                                before->before_from_now))
        << i;
    const Vector3d slower = before->rate_now_rad_s - after->rate_now_rad_s;
    EXPECT_LT(
        (slower - (Eigen::Matrix3d::Identity() + assumed.scale).inverse() *
                      ErrorJacobianOfRate(before->rate_now_rad_s) * de)
            .norm(),
        0.01 * slower.norm())
        << i;
  }
}

TEST(Gyroscope, TakesOffTheErrorsThatAreKnown) {
  const auto pose = [](double t) {
    return geometry::Rigid3{Turn({2.0 * t, 5.0 * t * t, -3.0 * t}), {}};
  };
  const ImuModel imu = Tilted();
  GyroscopeErrors errors;
  errors.bias_rad_s = {0.02, -0.01, 0.03};
  errors.scale << 0.02, -0.01, 0.0, 0.01, -0.03, 0.01, 0.0, 0.02, 0.01;
  Gyroscope gyroscope(imu);
  gyroscope.Add(SamplesOf(pose, imu, errors, 0.0, {}, milliseconds(300)));
  const Eigen::Quaterniond truth =
      pose(0.0).rotation.conjugate() * pose(0.25).rotation;
  const auto known = gyroscope.Between({}, milliseconds(250), errors);
  const auto unknown =
      gyroscope.Between({}, milliseconds(250), GyroscopeErrors());
  ASSERT_TRUE(known && unknown);
  EXPECT_LT(geometry::AngleBetween_rad(known->before_from_now, truth), 4e-5);
  EXPECT_GT(geometry::AngleBetween_rad(unknown->before_from_now, truth), 5e-3);
}

TEST(Gyroscope, SaysNothingWhereSamplesAreMissing) {
  Gyroscope gyroscope{ImuModel()};
  const auto at = [](int ms) {
    return InertialSample{milliseconds(ms), {0.1, 0, 0}, {}};
  };
  const auto is_known = [&](int from, int to) {
    return gyroscope
        .Between(milliseconds(from), milliseconds(to), GyroscopeErrors())
        .has_value();
  };
  EXPECT_FALSE(is_known(0, 40));
  const std::vector<InertialSample> early = {at(0), at(20), at(40)};
  gyroscope.Add(early);
  EXPECT_TRUE(is_known(0, 40));
  EXPECT_TRUE(is_known(0, 60)) << "a late sample";
  EXPECT_FALSE(is_known(0, 200));
  const std::vector<InertialSample> late = {at(20), at(180), at(200)};
  gyroscope.Add(late);  // the first one again
  EXPECT_FALSE(is_known(0, 200)) << "140 ms without any";
  EXPECT_TRUE(is_known(180, 200));
  EXPECT_FALSE(is_known(200, 180));
  gyroscope.ForgetBefore(milliseconds(190));
  EXPECT_TRUE(is_known(190, 200));
  EXPECT_FALSE(is_known(0, 40));
}

TEST(Gyroscope, ErrorsNameSampleAndField) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto message = [](std::vector<InertialSample> samples) {
    return ValidateInertial(samples).ToString();
  };
  const InertialSample fine{milliseconds(5), {1, 2, 3}, {0, 0, 9.8}};
  InertialSample wrong = fine;
  EXPECT_EQ(message({fine}), "OK");
  EXPECT_THAT(message({fine, wrong}), HasSubstr("[1].time_ns: 5000000"));
  wrong.time = milliseconds(6);
  EXPECT_EQ(message({fine, wrong}), "OK");
  wrong.angular_rate_rad_s.y() = nan;
  EXPECT_THAT(message({fine, wrong}), HasSubstr("[1].angular_rate_rad_s"));
  wrong.angular_rate_rad_s.y() = 90.0;
  EXPECT_THAT(message({wrong}), HasSubstr("degrees"));
  wrong = fine;
  wrong.acceleration_m_s2.x() = std::numeric_limits<double>::infinity();
  EXPECT_THAT(message({wrong}), HasSubstr("[0].acceleration_m_s2"));
  wrong = fine;
  wrong.time = nanoseconds(-1);
  EXPECT_THAT(message({wrong}), HasSubstr("below 0"));
  EXPECT_THAT(message(std::vector<InertialSample>(kMaxInertialSamples + 1)),
              HasSubstr("at most 4096"));
  ImuModel imu;
  EXPECT_TRUE(imu.Validate().ok());
  imu.gyroscope_bias_rad_s = nan;
  EXPECT_THAT(imu.Validate().ToString(), HasSubstr("gyroscope_bias_rad_s"));
  imu = {};
  imu.imu_from_camera = {2, 0, 0, 0};
  EXPECT_THAT(imu.Validate().ToString(), HasSubstr("imu_from_camera"));
}

// A camera that whips to and fro before the wall, with what that smears. A whip
// turns by 0.56 rad within `whip_s`.
class FastPan : public WalkTest {
 protected:
  static constexpr double kFast_s = 0.28;     // up to 4 rad/s
  static constexpr double kFaster_s = 0.187;  // up to 6 rad/s
  static constexpr nanoseconds kExposure = milliseconds(14);
  static constexpr int kFrames = 40;

  // Along the camera's axes.
  static GyroscopeErrors UnitErrors() {
    GyroscopeErrors errors;
    errors.bias_rad_s = {0.03, -0.05, 0.04};
    errors.scale << 0.008, 0.006, -0.011,  //
        -0.009, -0.012, 0.007,             //
        0.013, -0.005, 0.009;
    return errors;
  }
  static geometry::Rigid3 PoseAt(double whip_s, double t_s) {
    const auto whip = [whip_s, t_s](double begin_s) {
      const double x = std::clamp((t_s - begin_s) / whip_s, 0.0, 1.0);
      return x * x * x * (x * (6.0 * x - 15.0) + 10.0);
    };
    const double yaw_rad =
        -0.28 + 0.56 * whip(0.35) - 0.56 * whip(0.8) + 0.3 * whip(1.3);
    return test_support::LookAlongY(
        {0.2 * std::sin(t_s), 0.1 * std::cos(t_s), 1.65},
        yaw_rad,
        -0.03 + 0.01 * std::sin(5.0 * t_s));
  }
  static geometry::Rigid3 Truth(double whip_s, int frame) {
    return PoseAt(whip_s, Seconds(frame * kFrame));
  }
  static const cv::Mat& Smeared(double whip_s, int frame) {
    static std::map<double, std::vector<cv::Mat>> images_by_whip;
    std::vector<cv::Mat>& images = images_by_whip[whip_s];
    constexpr int kMoments = 12;
    while (static_cast<int>(images.size()) <= frame) {
      const double t_s = Seconds(static_cast<int>(images.size()) * kFrame);
      cv::Mat sum;
      for (int i = 0; i < kMoments; ++i) {
        const double f = (i + 0.5) / kMoments - 0.5;
        cv::Mat moment;
        place_->Render(PoseAt(whip_s, t_s + f * Seconds(kExposure)))
            .convertTo(moment, CV_32F);
        sum = sum.empty() ? moment : cv::Mat(sum + moment);
      }
      cv::Mat image;
      sum.convertTo(image, CV_8U, 1.0 / kMoments);
      images.push_back(image);
    }
    return images[frame];
  }

  struct Flight {
    std::vector<double> angle_error_rad;  // frames with a pose
    int tracked = 0;
    LocalizationResult last;
  };
  // axes: as they are said to be.
  static Flight Fly(double whip_s,
                    const std::optional<ImuModel>& imu,
                    const Eigen::Quaterniond& axes) {
    LocalizerOptions options;
    options.seed = test_support::PerturbedSeed(5);
    options.imu = imu;
    if (options.imu) options.imu->imu_from_camera = axes;
    auto localizer = *CreateLocalizer("fast", map_, options);
    Flight flight;
    for (int i = 0; i < kFrames; ++i) {
      image::Frame frame;
      frame.sequence = static_cast<std::uint64_t>(i);
      frame.capture_time = i * kFrame;
      frame.luma = Smeared(whip_s, i);
      LocalizationRequest request{&frame, place_->camera(), {}};
      std::vector<InertialSample> samples;
      if (imu) {
        samples =
            SamplesOf([whip_s](double t_s) { return PoseAt(whip_s, t_s); },
                      *imu,
                      UnitErrors(),
                      imu->gyroscope_noise_rad_s_sqrt_hz * std::sqrt(200.0),
                      std::max(nanoseconds(0), (i - 1) * nanoseconds(kFrame)),
                      i * kFrame + milliseconds(5));
        request.inertial = samples;
      }
      const auto result = localizer->Localize(request);
      EXPECT_TRUE(result.ok()) << result.status();
      if (!result.ok()) return flight;
      flight.last = *result;
      flight.tracked += result->state == CameraState::kTracked ? 1 : 0;
      if (!result->world_from_camera) continue;
      flight.angle_error_rad.push_back(test_support::AngleError_rad(
          *result->world_from_camera, Truth(whip_s, i)));
    }
    return flight;
  }
  static double MeanOf(const std::vector<double>& values) {
    double sum = 0.0;
    for (const double value : values) sum += value;
    return sum / static_cast<double>(values.size());
  }
};

// The unit is off by 1 % in the sensitivity and the directions of its axes, as
// far as its data sheet allows. By the image alone, the faster pan is lost in
// each whip; the other one is followed all the way, and known to 0.4 mrad.
TEST_F(FastPan, AGyroscopeHalvesTheErrorWhereTheImageLosesIt) {
  const Flight without = Fly(kFaster_s, std::nullopt, {});
  const Flight with = Fly(kFaster_s, Tilted(), Tilted().imu_from_camera);
  EXPECT_GT(MeanOf(without.angle_error_rad), 0.002) << "nothing to halve";
  EXPECT_LT(MeanOf(with.angle_error_rad),
            0.5 * MeanOf(without.angle_error_rad));
  EXPECT_GE(with.angle_error_rad.size(), without.angle_error_rad.size());
  EXPECT_GE(with.tracked, without.tracked);
  EXPECT_FALSE(with.last.ignores_gyroscope);
}

TEST_F(FastPan, AGyroscopeHelpsWhereTheImageFollows) {
  const Flight without = Fly(kFast_s, std::nullopt, {});
  const Flight with = Fly(kFast_s, Tilted(), Tilted().imu_from_camera);
  EXPECT_LT(MeanOf(with.angle_error_rad), MeanOf(without.angle_error_rad));
  EXPECT_GE(with.tracked, kFrames * 9 / 10);
  EXPECT_FALSE(with.last.ignores_gyroscope);
}

// Axes that are said to be others: the images win, and it is told.
TEST_F(FastPan, AWrongGyroscopeIsFoundOut) {
  const Flight without = Fly(kFast_s, std::nullopt, {});
  // To the unit, a turn to the side is one up or down.
  const Flight wrong =
      Fly(kFast_s, Tilted(), Tilted().imu_from_camera * Turn({0.0, 0.0, 1.6}));
  EXPECT_TRUE(wrong.last.ignores_gyroscope);
  EXPECT_GE(wrong.tracked, without.tracked - 6);
  EXPECT_EQ(wrong.last.state, CameraState::kTracked);
  EXPECT_LT(wrong.angle_error_rad.back(), 0.004);
}

}  // namespace
}  // namespace groundlock::localization
