// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <cmath>
#include <numbers>
#include <variant>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "google/protobuf/util/time_util.h"
#include "map_store/base/status.h"
#include "server/service/convert.h"

namespace groundlock::service {
namespace {

void ToProto(const Eigen::Vector3d& v, pb::Vector3* out) {
  out->set_x(v.x());
  out->set_y(v.y());
  out->set_z(v.z());
}

void ToProto(const Eigen::Quaterniond& q, pb::Quaternion* out) {
  out->set_w(q.w());
  out->set_x(q.x());
  out->set_y(q.y());
  out->set_z(q.z());
}

void ToProto(const geometry::Box2& box, pb::Box2* out) {
  out->set_x(box.x());
  out->set_y(box.y());
  out->set_width(box.width());
  out->set_height(box.height());
}

void ToProto(std::chrono::system_clock::time_point time,
             google::protobuf::Timestamp* out) {
  const auto since_epoch = std::chrono::duration_cast<std::chrono::nanoseconds>(
      time.time_since_epoch());
  *out = google::protobuf::util::TimeUtil::NanosecondsToTimestamp(
      since_epoch.count());
}

double Milliseconds(std::chrono::nanoseconds duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

// Direction of the object's x axis about world z.
double Heading_rad(const Eigen::Quaterniond& world_from_object) {
  const Eigen::Vector3d forward = world_from_object * Eigen::Vector3d::UnitX();
  const double heading = std::atan2(forward.y(), forward.x());
  return heading == -std::numbers::pi ? std::numbers::pi : heading;
}

pb::CameraModelId ModelId(geometry::CameraModelId id) {
  switch (id) {
    case geometry::CameraModelId::kSimplePinhole:
      return pb::CAMERA_MODEL_ID_SIMPLE_PINHOLE;
    case geometry::CameraModelId::kPinhole:
      return pb::CAMERA_MODEL_ID_PINHOLE;
    case geometry::CameraModelId::kSimpleRadial:
      return pb::CAMERA_MODEL_ID_SIMPLE_RADIAL;
    case geometry::CameraModelId::kRadial:
      return pb::CAMERA_MODEL_ID_RADIAL;
    case geometry::CameraModelId::kOpenCv:
      return pb::CAMERA_MODEL_ID_OPENCV;
    case geometry::CameraModelId::kOpenCvFisheye:
      return pb::CAMERA_MODEL_ID_OPENCV_FISHEYE;
  }
  return pb::CAMERA_MODEL_ID_UNSPECIFIED;
}

pb::CameraState StateOf(localization::CameraState state) {
  switch (state) {
    case localization::CameraState::kInitializing:
      return pb::CAMERA_STATE_INITIALIZING;
    case localization::CameraState::kTracked:
      return pb::CAMERA_STATE_TRACKED;
    case localization::CameraState::kHeld:
      return pb::CAMERA_STATE_HELD;
    case localization::CameraState::kLost:
      return pb::CAMERA_STATE_LOST;
    case localization::CameraState::kOdometry:
      return pb::CAMERA_STATE_ODOMETRY;
  }
  return pb::CAMERA_STATE_UNSPECIFIED;
}

pb::TargetState StateOf(tracking::TargetState state) {
  switch (state) {
    case tracking::TargetState::kTracked:
      return pb::TARGET_STATE_TRACKED;
    case tracking::TargetState::kPredicted:
      return pb::TARGET_STATE_PREDICTED;
    case tracking::TargetState::kLost:
      return pb::TARGET_STATE_LOST;
  }
  return pb::TARGET_STATE_UNSPECIFIED;
}

pb::MoversState StateOf(movers::MoversState state) {
  switch (state) {
    case movers::MoversState::kNotAsked:
      return pb::MOVERS_STATE_UNSPECIFIED;
    case movers::MoversState::kWatching:
      return pb::MOVERS_STATE_WATCHING;
    case movers::MoversState::kStarting:
      return pb::MOVERS_STATE_STARTING;
    case movers::MoversState::kNoMap:
      return pb::MOVERS_STATE_NO_MAP;
    case movers::MoversState::kNoGround:
      return pb::MOVERS_STATE_NO_GROUND;
    case movers::MoversState::kNoPose:
      return pb::MOVERS_STATE_NO_POSE;
    case movers::MoversState::kPoseContradicted:
      return pb::MOVERS_STATE_POSE_CONTRADICTED;
  }
  return pb::MOVERS_STATE_UNSPECIFIED;
}

void ToProto(const movers::Mover& mover, pb::Mover* out) {
  out->set_mover_id(mover.id);
  ToProto(mover.box_px, out->mutable_box());
  ToProto(mover.ground_world, out->mutable_ground_center_m());
  ToProto(mover.velocity_world_m_s, out->mutable_velocity_world_m_s());
  for (int row = 0; row < 2; ++row) {
    for (int column = 0; column < 2; ++column) {
      out->add_ground_covariance_m2(mover.ground_covariance_m2(row, column));
      out->add_velocity_covariance_m2_s2(
          mover.velocity_covariance_m2_s2(row, column));
    }
  }
  out->set_confidence(mover.confidence);
}

// Unspecified: of none.
pb::BodyKind KindNamed(std::string_view name) {
  pb::BodyKind kind = pb::BODY_KIND_UNSPECIFIED;
  if (name.empty()) return kind;
  pb::BodyKind_Parse(
      absl::StrCat("BODY_KIND_", absl::AsciiStrToUpper(base::Abseil(name))),
      &kind);
  return kind;
}

void ToProto(const tracking::TargetResult& target, pb::TargetResult* out) {
  out->set_target_id(target.id);
  out->set_state(StateOf(target.state));
  out->set_confidence(target.confidence);
  if (target.box_px.has_value()) ToProto(*target.box_px, out->mutable_box());
  if (target.box_world.has_value()) {
    const geometry::Box3& box = *target.box_world;
    service::ToProto(box.world_from_object,
                     out->mutable_box_world()->mutable_world_from_object());
    ToProto(box.size_m, out->mutable_box_world()->mutable_size_m());
    ToProto(box.BottomCenterWorld(), out->mutable_ground_center_m());
    out->set_heading_rad(Heading_rad(box.world_from_object.rotation));
    for (int row = 0; row < 2; ++row) {
      for (int column = 0; column < 2; ++column) {
        out->add_ground_covariance_m2(target.ground_covariance_m2(row, column));
      }
    }
    ToProto(target.velocity_world_m_s, out->mutable_velocity_world_m_s());
    out->set_heading_sigma_rad(target.heading_sigma_rad);
    out->set_front_known(target.front_known);
    out->set_body_kind(KindNamed(target.body_kind));
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column) {
        out->add_size_covariance_m2(target.size_covariance_m2(row, column));
      }
    }
  }
  out->set_age_s(std::chrono::duration<double>(target.age).count());
}

}  // namespace

void ToProto(const geometry::Rigid3& rigid, pb::RigidTransform* out) {
  ToProto(rigid.rotation, out->mutable_rotation());
  ToProto(rigid.translation, out->mutable_translation());
}

void ToProto(const geometry::CameraModel& camera, pb::CameraModel* out) {
  out->set_model(ModelId(camera.id()));
  out->set_width_px(camera.width_px());
  out->set_height_px(camera.height_px());
  for (const double param : camera.params()) out->add_params(param);
}

void ToProto(const geometry::GeodeticPosition& place,
             pb::GeodeticPosition* out) {
  out->set_latitude_deg(place.latitude_deg);
  out->set_longitude_deg(place.longitude_deg);
  out->set_height_m(place.height_m);
}

void ToProto(const geometry::Similarity3& similarity,
             pb::SimilarityTransform* out) {
  out->set_scale(similarity.scale);
  ToProto(similarity.rotation, out->mutable_rotation());
  ToProto(similarity.translation, out->mutable_translation());
}

void ToProto(const storage::MapVersion& map, pb::MapInfo* out) {
  const map::MapInfo& info = map.info;
  out->set_name(map.name);
  out->set_version(map.version);
  out->set_content_hash(info.content_hash);
  ToProto(map.created, out->mutable_create_time());
  out->set_source_format(info.source_format);
  out->set_metric(info.metric);
  ToProto(info.world_from_source, out->mutable_world_from_source());
  ToProto(info.ground_world.normal,
          out->mutable_ground_world()->mutable_normal());
  out->mutable_ground_world()->set_d(info.ground_world.d);
  if (info.origin) ToProto(*info.origin, out->mutable_origin());
  if (info.lens) ToProto(*info.lens, out->mutable_lens());
  switch (info.ground_state) {
    case map::GroundState::kUnknown:
      out->set_ground_state(pb::GROUND_STATE_UNKNOWN);
      break;
    case map::GroundState::kEstimated:
      out->set_ground_state(pb::GROUND_STATE_ESTIMATED);
      break;
    case map::GroundState::kMeasured:
      out->set_ground_state(pb::GROUND_STATE_MEASURED);
      break;
  }
  out->set_ground_sigma_deg(info.ground_sigma_rad * 180.0 / std::numbers::pi);
  out->set_ground_height_sigma(info.ground_height_sigma);
  out->set_ground_relief_m(info.ground_relief_m);
  out->set_ground_relief_given(info.ground_relief_given);
  out->set_num_cameras(info.num_cameras);
  out->set_num_views(info.num_views);
  out->set_num_landmarks(info.num_landmarks);
  out->set_num_observations(info.num_observations);
  out->set_mean_reprojection_error_px(info.mean_reprojection_error_px);
  out->set_has_descriptors(info.has_descriptors);
  out->set_file_bytes(info.file_bytes);
}

void ToProto(const SessionDescription& session, pb::Session* out) {
  const SessionSpec& spec = session.spec;
  out->set_session_id(spec.id);
  out->set_owner(spec.owner);
  out->set_map_name(spec.map_name);
  out->set_map_version(spec.map_version);
  if (spec.camera) ToProto(*spec.camera, out->mutable_camera());
  pb::SessionOptions* options = out->mutable_options();
  options->set_localizer(spec.options.localizer);
  options->set_tracker(spec.options.tracker.name);
  options->set_flow_mode(spec.live ? pb::FLOW_MODE_LIVE
                                   : pb::FLOW_MODE_LOSSLESS);
  options->set_confidence_threshold(spec.options.confidence_threshold);
  options->set_target_lost_after_s(
      std::chrono::duration<double>(spec.options.target_lost_after).count());
  options->set_camera_lost_after_s(
      std::chrono::duration<double>(spec.options.localization.lost_after)
          .count());
  options->set_seed(spec.options.seed);
  options->set_report_matches(spec.report_matches);
  options->set_report_movers(spec.options.report_movers);
  if (const auto& imu = spec.options.localization.imu) {
    pb::ImuModel* model = options->mutable_imu();
    model->mutable_imu_from_camera()->set_w(imu->imu_from_camera.w());
    model->mutable_imu_from_camera()->set_x(imu->imu_from_camera.x());
    model->mutable_imu_from_camera()->set_y(imu->imu_from_camera.y());
    model->mutable_imu_from_camera()->set_z(imu->imu_from_camera.z());
    model->set_gyroscope_noise_rad_s_sqrt_hz(
        imu->gyroscope_noise_rad_s_sqrt_hz);
    model->set_gyroscope_walk_rad_s2_sqrt_hz(
        imu->gyroscope_walk_rad_s2_sqrt_hz);
    model->set_gyroscope_bias_rad_s(imu->gyroscope_bias_rad_s);
  }
  ToProto(session.created, out->mutable_create_time());
  out->set_next_sequence(session.next_sequence);
  out->set_frames_processed(session.frames_processed);
  out->set_frames_dropped(session.frames_dropped);
  out->set_frames_failed(session.frames_failed);
  for (const std::string& id : session.target_ids) out->add_target_ids(id);
  out->set_streaming(session.streaming);
}

void ToProto(const localization::LocalizationResult& camera,
             const map::Map* map,
             bool report_matches,
             pb::CameraResult* out) {
  out->set_state(StateOf(camera.state));
  if (camera.world_from_camera.has_value()) {
    ToProto(*camera.world_from_camera, out->mutable_world_from_camera());
    for (int row = 0; row < 6; ++row) {
      for (int column = 0; column < 6; ++column) {
        out->add_covariance(camera.covariance(row, column));
      }
    }
  }
  out->set_reset_count(camera.reset_count);
  out->set_ignores_gyroscope(camera.ignores_gyroscope);
  if (camera.lens_contradiction) {
    auto* lens = out->mutable_lens_contradiction();
    lens->set_focal_ratio(camera.lens_contradiction->focal_ratio);
    lens->set_corner_share(camera.lens_contradiction->corner_share);
  }
  out->set_num_inliers(camera.num_inliers);
  out->set_mean_reprojection_error_px(camera.mean_reprojection_error_px);
  if (!report_matches || map == nullptr) return;
  for (const localization::LandmarkMatch& match : camera.inliers) {
    out->add_match_xy_px(static_cast<float>(match.pixel_px.x()));
    out->add_match_xy_px(static_cast<float>(match.pixel_px.y()));
    const map::Landmark& landmark = map->landmarks()[match.landmark];
    for (const double coordinate : landmark.p_world) {
      out->add_match_xyz_m(static_cast<float>(coordinate));
    }
  }
}

void ToProto(const tracking::StageTimes& times,
             std::chrono::nanoseconds queue_time,
             pb::StageTimes* out) {
  out->set_queue_ms(Milliseconds(queue_time));
  out->set_decode_ms(Milliseconds(times.decode));
  out->set_localize_ms(Milliseconds(times.localize));
  out->set_track_ms(Milliseconds(times.track));
  out->set_total_ms(Milliseconds(times.total));
  out->set_movers_ms(Milliseconds(times.movers));
}

void ToProto(const FrameOutcome& outcome,
             const SessionSpec& spec,
             const map::Map* map,
             pb::FrameResult* out) {
  const tracking::FrameResult& result = outcome.result;
  out->set_sequence(result.sequence);
  out->set_capture_time_ns(result.capture_time.count());
  ToProto(result.camera, map, spec.report_matches, out->mutable_camera());
  for (const tracking::TargetResult& target : result.targets) {
    ToProto(target, out->add_targets());
  }
  for (const movers::Mover& mover : result.movers.movers) {
    ToProto(mover, out->add_movers());
  }
  out->set_movers_state(StateOf(result.movers.state));
  out->set_map_version(spec.map_version);
  service::ToProto(result.times, outcome.queue_time, out->mutable_times());
  for (const TargetFault& fault : outcome.target_faults) {
    pb::TargetError* error = out->add_target_errors();
    error->set_target_id(fault.target_id);
    error->set_message(fault.message);
  }
}

void ToProto(const Answer& answer,
             const SessionSpec& spec,
             const map::Map* map,
             pb::TrackResponse* out) {
  if (const auto* outcome = std::get_if<FrameOutcome>(&answer.content)) {
    service::ToProto(*outcome, spec, map, out->mutable_result());
  } else if (const auto* status = std::get_if<absl::Status>(&answer.content)) {
    pb::FrameError* error = out->mutable_error();
    error->set_sequence(answer.sequence);
    error->set_code(static_cast<int>(status->code()));
    error->set_message(std::string(status->message()));
  } else {
    pb::FrameDropped* dropped = out->mutable_dropped();
    dropped->set_sequence(answer.sequence);
    dropped->set_reason(std::get<DropReason>(answer.content) ==
                                DropReason::kOverload
                            ? pb::FrameDropped::REASON_OVERLOAD
                            : pb::FrameDropped::REASON_SHUTDOWN);
  }
}

}  // namespace groundlock::service
