// SPDX-License-Identifier: Apache-2.0
#include "server/service/convert.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>

namespace groundlock::service {
namespace {

using ::testing::HasSubstr;

TEST(Convert, EveryCameraModelGoesThereAndBack) {
  using geometry::CameraModelId;
  for (const CameraModelId id : {CameraModelId::kSimplePinhole,
                                 CameraModelId::kPinhole,
                                 CameraModelId::kSimpleRadial,
                                 CameraModelId::kRadial,
                                 CameraModelId::kOpenCv,
                                 CameraModelId::kOpenCvFisheye}) {
    std::vector<double> params(
        static_cast<std::size_t>(geometry::NumCameraModelParams(id)), 0.01);
    params[0] = 500.0;
    params[1] = 510.0;
    const auto camera = *geometry::CameraModel::Create(id, 640, 480, params);
    pb::CameraModel proto;
    ToProto(camera, &proto);
    const auto back = FromProto(proto, "camera");
    ASSERT_TRUE(back.ok()) << back.status();
    EXPECT_EQ(*back, camera);
  }
}

TEST(Convert, RejectsUnknownEnumsByName) {
  EXPECT_THAT(FromProto(static_cast<pb::ImageEncoding>(42), "image.encoding")
                  .status()
                  .ToString(),
              HasSubstr("image.encoding: unknown (42)"));
  EXPECT_FALSE(FromProto(static_cast<pb::MapFormat>(42), "f").ok());
  EXPECT_FALSE(FromProto(static_cast<pb::MapExportFormat>(42), "f").ok());
  EXPECT_FALSE(FromProto(pb::MAP_EXPORT_FORMAT_UNSPECIFIED, "f").ok());
}

TEST(Convert, RejectsBoxesAndTransformsThatAreNone) {
  pb::Box2 box;
  box.set_width(10);
  EXPECT_THAT(FromProto(box, "box").status().ToString(),
              HasSubstr("box.height"));
  box.set_height(std::numeric_limits<double>::infinity());
  EXPECT_FALSE(FromProto(box, "box").ok());
  pb::SimilarityTransform similarity;
  EXPECT_THAT(FromProto(similarity, "s").status().ToString(),
              HasSubstr("s.scale"));
  similarity.set_scale(2.0);
  EXPECT_THAT(FromProto(similarity, "s").status().ToString(),
              HasSubstr("s.rotation"));
  similarity.mutable_rotation()->set_w(1.0);
  EXPECT_TRUE(FromProto(similarity, "s").ok());
  similarity.mutable_translation()->set_y(std::nan(""));
  EXPECT_FALSE(FromProto(similarity, "s").ok());
}

TEST(Convert, AFrameWithAWrongFieldIsAcceptedAndMarked) {
  pb::TrackRequest::Frame frame;
  frame.set_sequence(5);
  frame.set_capture_time_ns(-1);
  EXPECT_THAT(TakeFrame(frame).status.ToString(),
              HasSubstr("frame.capture_time_ns"));
  frame.set_capture_time_ns(1);
  frame.mutable_image()->set_data("abc");
  frame.mutable_camera()->set_width_px(3);
  EXPECT_THAT(TakeFrame(frame).status.ToString(), HasSubstr("frame.camera"));
  frame.clear_camera();
  const FrameJob job = TakeFrame(frame);
  EXPECT_TRUE(job.status.ok());
  EXPECT_EQ(job.sequence, 5U);
  EXPECT_EQ(job.bytes, "abc");
}

TEST(Convert, APositionsArmGoesWithThePosition) {
  pb::PosePrior prior;
  prior.mutable_position_m()->set_x(1.0);
  prior.set_position_sigma_m(0.5);
  const auto without = FromProto(prior, "prior");
  ASSERT_TRUE(without.ok()) << without.status();
  EXPECT_EQ(without->position_arm_camera, Eigen::Vector3d::Zero());

  pb::Vector3* arm = prior.mutable_position_arm_m();
  arm->set_x(0.1);
  arm->set_y(-0.3);
  arm->set_z(-1.2);
  const auto in_world = FromProto(prior, "prior");
  ASSERT_TRUE(in_world.ok()) << in_world.status();
  EXPECT_EQ(in_world->position_arm_camera, Eigen::Vector3d(0.1, -0.3, -1.2));

  prior.clear_position_m();
  EXPECT_THAT(FromProto(prior, "prior").status().ToString(),
              HasSubstr("prior.position_arm_m: goes with position_m"));
  prior.mutable_geodetic_position()->set_latitude_deg(58.0);
  prior.set_geodetic_sigma_m(3.0);
  const auto on_earth = FromProto(prior, "prior");
  ASSERT_TRUE(on_earth.ok()) << on_earth.status();
  EXPECT_EQ(on_earth->position_arm_camera, in_world->position_arm_camera);

  pb::TrackRequest::Frame frame;
  frame.mutable_image()->set_data("abc");
  for (const double wrong :
       {std::nan(""), std::numeric_limits<double>::infinity()}) {
    arm->set_y(wrong);
    *frame.mutable_prior() = prior;
    EXPECT_THAT(TakeFrame(frame).status.ToString(),
                HasSubstr("frame.prior.position_arm_m: holds a number"));
  }
}

TEST(Convert, ASessionSaysAfterHowLongItsCameraIsLost) {
  const ServerOptions options;
  pb::CreateSessionRequest request;
  EXPECT_EQ(FromProto(request, options)->options.localization.lost_after,
            std::chrono::seconds(2));
  for (const double seconds : {0.0, 0.5, 86'400.0}) {
    request.mutable_options()->set_camera_lost_after_s(seconds);
    const auto spec = FromProto(request, options);
    ASSERT_TRUE(spec.ok()) << spec.status();
    EXPECT_EQ(
        std::chrono::duration<double>(spec->options.localization.lost_after)
            .count(),
        seconds);
  }
  for (const double wrong : {-0.1, 86'401.0, std::nan("")}) {
    request.mutable_options()->set_camera_lost_after_s(wrong);
    EXPECT_THAT(FromProto(request, options).status().ToString(),
                HasSubstr("options.camera_lost_after_s"));
  }
}

TEST(Convert, InertialSamplesAreCheckedByName) {
  pb::TrackRequest::Frame frame;
  frame.mutable_image()->set_data("abc");
  for (int i = 0; i < 3; ++i) {
    pb::InertialSample* sample = frame.add_inertial();
    sample->set_time_ns(5 + i);
    sample->mutable_angular_rate_rad_s()->set_y(0.5);
    sample->mutable_acceleration_m_s2()->set_z(9.8);
  }
  const FrameJob job = TakeFrame(frame);
  ASSERT_TRUE(job.status.ok()) << job.status;
  ASSERT_EQ(job.sensors.inertial.size(), 3U);
  EXPECT_EQ(job.sensors.inertial[1].time.count(), 6);
  EXPECT_EQ(job.sensors.inertial[1].angular_rate_rad_s.y(), 0.5);
  EXPECT_EQ(job.sensors.inertial[1].acceleration_m_s2.z(), 9.8);
  frame.mutable_inertial(2)->set_time_ns(6);
  EXPECT_THAT(TakeFrame(frame).status.ToString(),
              HasSubstr("frame.inertial: [2].time_ns"));
  frame.mutable_inertial(2)->set_time_ns(7);
  frame.mutable_inertial(0)->mutable_angular_rate_rad_s()->set_x(
      std::numeric_limits<double>::quiet_NaN());
  EXPECT_THAT(TakeFrame(frame).status.ToString(),
              HasSubstr("frame.inertial: [0].angular_rate_rad_s"));
  for (int i = 0; i < 5'000; ++i) frame.add_inertial();
  EXPECT_THAT(TakeFrame(frame).status.ToString(),
              HasSubstr("frame.inertial: 5003 samples"));
}

TEST(Convert, TheUnitsRotationIsRequired) {
  pb::CreateSessionRequest request;
  pb::ImuModel* imu = request.mutable_options()->mutable_imu();
  EXPECT_THAT(FromProto(request, ServerOptions()).status().ToString(),
              HasSubstr("options.imu.imu_from_camera: is missing"));
  imu->mutable_imu_from_camera()->set_w(3.0);
  EXPECT_THAT(FromProto(request, ServerOptions()).status().ToString(),
              HasSubstr("options.imu.imu_from_camera: is not a unit"));
  imu->mutable_imu_from_camera()->set_w(0.6);
  imu->mutable_imu_from_camera()->set_x(0.8);
  imu->set_gyroscope_bias_rad_s(-1.0);
  EXPECT_THAT(FromProto(request, ServerOptions()).status().ToString(),
              HasSubstr("gyroscope_bias_rad_s"));
  imu->set_gyroscope_bias_rad_s(0.25);
  const auto spec = FromProto(request, ServerOptions());
  ASSERT_TRUE(spec.ok()) << spec.status();
  ASSERT_TRUE(spec->options.localization.imu);
  EXPECT_EQ(spec->options.localization.imu->gyroscope_bias_rad_s, 0.25);
  EXPECT_EQ(spec->options.localization.imu->imu_from_camera.x(), 0.8);
}

TEST(Convert, AResultCarriesEverything) {
  FrameOutcome outcome;
  outcome.result.sequence = 9;
  outcome.result.capture_time = std::chrono::nanoseconds(77);
  localization::LocalizationResult& camera = outcome.result.camera;
  camera.state = localization::CameraState::kTracked;
  camera.world_from_camera = geometry::Rigid3{
      Eigen::Quaterniond(Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitX())),
      {1, 2, 3}};
  camera.covariance(0, 5) = 0.25;
  tracking::TargetResult target;
  target.id = "t";
  target.state = tracking::TargetState::kTracked;
  target.box_px = geometry::Box2::FromXywh(1, 2, 3, 4);
  target.box_world =
      geometry::Box3{{Eigen::Quaterniond(Eigen::AngleAxisd(
                          std::numbers::pi / 2, Eigen::Vector3d::UnitZ())),
                      {10, 20, 1}},
                     {4, 2, 2}};
  target.ground_covariance_m2 << 1, 2, 3, 4;
  target.heading_sigma_rad = 0.25;
  target.front_known = true;
  target.size_covariance_m2 << 1, 2, 3, 4, 5, 6, 7, 8, 9;
  target.age = std::chrono::milliseconds(1'500);
  outcome.result.targets.push_back(target);
  outcome.target_faults.push_back({"u", "why"});
  SessionSpec spec;
  spec.map_version = 3;
  pb::FrameResult proto;
  ToProto(outcome, spec, nullptr, &proto);
  EXPECT_EQ(proto.sequence(), 9U);
  EXPECT_EQ(proto.capture_time_ns(), 77);
  EXPECT_EQ(proto.map_version(), 3U);
  EXPECT_EQ(proto.camera().state(), pb::CAMERA_STATE_TRACKED);
  ASSERT_EQ(proto.camera().covariance_size(), 36);
  EXPECT_EQ(proto.camera().covariance(5), 0.25);  // row 0, column 5
  const pb::TargetResult& t = proto.targets(0);
  EXPECT_EQ(t.box().width(), 3.0);
  EXPECT_NEAR(t.heading_rad(), std::numbers::pi / 2, 1e-12);
  EXPECT_NEAR(t.ground_center_m().z(), 0.0, 1e-12);
  EXPECT_EQ(t.ground_covariance_m2(1), 2.0);
  EXPECT_EQ(t.heading_sigma_rad(), 0.25);
  EXPECT_TRUE(t.front_known());
  ASSERT_EQ(t.size_covariance_m2_size(), 9);
  EXPECT_EQ(t.size_covariance_m2(5), 6.0);
  EXPECT_EQ(t.age_s(), 1.5);
  EXPECT_EQ(proto.target_errors(0).message(), "why");
}

TEST(Convert, PageSizes) {
  EXPECT_EQ(*PageSize(0), 100);
  EXPECT_EQ(*PageSize(7), 7);
  EXPECT_FALSE(PageSize(-1).ok());
  EXPECT_FALSE(PageSize(1'001).ok());
}

TEST(Convert, Ids) {
  EXPECT_TRUE(ValidateId("a.B_9-", "id").ok());
  EXPECT_FALSE(ValidateId("", "id").ok());
  EXPECT_FALSE(ValidateId("a b", "id").ok());
  EXPECT_FALSE(ValidateId("\xc3\xa4", "id").ok());
  EXPECT_FALSE(ValidateId(std::string(65, 'a'), "id").ok());
}

}  // namespace
}  // namespace groundlock::service
