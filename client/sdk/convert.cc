// SPDX-License-Identifier: Apache-2.0
#include "client/sdk/convert.h"

#include <algorithm>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "google/protobuf/util/time_util.h"
#include "map_store/base/status.h"

namespace groundlock::sdk {
namespace {

using sdk::FromProto;  // the functions below would hide them

Eigen::Vector3d FromProto(const pb::Vector3& v) {
  return {v.x(), v.y(), v.z()};
}

Eigen::Quaterniond FromProto(const pb::Quaternion& q) {
  return {q.w(), q.x(), q.y(), q.z()};
}

geometry::Box2 FromProto(const pb::Box2& box) {
  return geometry::Box2::FromXywh(box.x(), box.y(), box.width(), box.height());
}

std::chrono::system_clock::time_point FromProto(
    const google::protobuf::Timestamp& time) {
  return std::chrono::system_clock::time_point(
      std::chrono::duration_cast<std::chrono::system_clock::duration>(
          std::chrono::nanoseconds(
              google::protobuf::util::TimeUtil::TimestampToNanoseconds(time))));
}

pb::CameraModelId ToProto(geometry::CameraModelId id) {
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

CameraState FromProto(pb::CameraState state) {
  switch (state) {
    case pb::CAMERA_STATE_INITIALIZING:
      return CameraState::kInitializing;
    case pb::CAMERA_STATE_TRACKED:
      return CameraState::kTracked;
    case pb::CAMERA_STATE_HELD:
      return CameraState::kHeld;
    case pb::CAMERA_STATE_ODOMETRY:
      return CameraState::kOdometry;
    default:
      return CameraState::kLost;
  }
}

TargetState FromProto(pb::TargetState state) {
  switch (state) {
    case pb::TARGET_STATE_TRACKED:
      return TargetState::kTracked;
    case pb::TARGET_STATE_PREDICTED:
      return TargetState::kPredicted;
    default:
      return TargetState::kLost;
  }
}

constexpr const char* kKindPrefix = "BODY_KIND_";

// Empty: of none.
std::string NameOf(pb::BodyKind kind) {
  absl::string_view name = pb::BodyKind_Name(kind);
  if (kind == pb::BODY_KIND_UNSPECIFIED ||
      !absl::ConsumePrefix(&name, kKindPrefix)) {
    return "";
  }
  return absl::AsciiStrToLower(name);
}

TargetResult FromProto(const pb::TargetResult& target) {
  TargetResult result;
  result.id = target.target_id();
  result.state = FromProto(target.state());
  result.confidence = target.confidence();
  if (target.has_box()) result.box_px = FromProto(target.box());
  if (target.has_box_world()) {
    result.box_world =
        geometry::Box3{FromProto(target.box_world().world_from_object()),
                       FromProto(target.box_world().size_m())};
  }
  if (target.has_ground_center_m()) {
    result.ground_center_world = FromProto(target.ground_center_m());
  }
  result.heading_rad = target.heading_rad();
  if (target.ground_covariance_m2_size() == 4) {
    result.ground_covariance_m2 =
        Eigen::Map<const Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(
            target.ground_covariance_m2().data());
  }
  result.velocity_world_m_s = FromProto(target.velocity_world_m_s());
  result.age_s = target.age_s();
  result.heading_sigma_rad = target.heading_sigma_rad();
  result.front_known = target.front_known();
  if (target.size_covariance_m2_size() == 9) {
    result.size_covariance_m2 =
        Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(
            target.size_covariance_m2().data());
  }
  result.body_kind = NameOf(target.body_kind());
  return result;
}

}  // namespace

absl::Status FromGrpc(const grpc::Status& status) {
  if (status.ok()) return absl::OkStatus();
  return {static_cast<absl::StatusCode>(status.error_code()),
          status.error_message()};
}

const std::vector<std::string>& BodyKinds() {
  static const std::vector<std::string> kNames = [] {
    std::vector<std::string> names;
    for (int i = 1; i < pb::BodyKind_ARRAYSIZE; ++i) {
      names.push_back(NameOf(static_cast<pb::BodyKind>(i)));
    }
    return names;
  }();
  return kNames;
}

absl::Status ToProto(const TargetBody& body, pb::TargetBody* out) {
  if (!body.kind.empty()) {
    pb::BodyKind kind = pb::BODY_KIND_UNSPECIFIED;
    const auto& known = BodyKinds();
    if (std::find(known.begin(), known.end(), body.kind) == known.end() ||
        !pb::BodyKind_Parse(
            absl::StrCat(kKindPrefix, absl::AsciiStrToUpper(body.kind)),
            &kind)) {
      return absl::InvalidArgumentError(
          absl::StrCat("body.kind: '",
                       body.kind,
                       "' is none of ",
                       absl::StrJoin(known, ", ")));
    }
    out->set_kind(kind);
  }
  if (body.size_m) {
    out->mutable_size_m()->set_x(body.size_m->x());
    out->mutable_size_m()->set_y(body.size_m->y());
    out->mutable_size_m()->set_z(body.size_m->z());
  }
  return absl::OkStatus();
}

void ToProto(const geometry::CameraModel& camera, pb::CameraModel* out) {
  out->set_model(ToProto(camera.id()));
  out->set_width_px(camera.width_px());
  out->set_height_px(camera.height_px());
  for (const double param : camera.params()) out->add_params(param);
}

void ToProto(const geometry::Box2& box, pb::Box2* out) {
  out->set_x(box.x());
  out->set_y(box.y());
  out->set_width(box.width());
  out->set_height(box.height());
}

void ToProto(const geometry::Similarity3& similarity,
             pb::SimilarityTransform* out) {
  out->set_scale(similarity.scale);
  pb::Quaternion* rotation = out->mutable_rotation();
  rotation->set_w(similarity.rotation.w());
  rotation->set_x(similarity.rotation.x());
  rotation->set_y(similarity.rotation.y());
  rotation->set_z(similarity.rotation.z());
  pb::Vector3* translation = out->mutable_translation();
  translation->set_x(similarity.translation.x());
  translation->set_y(similarity.translation.y());
  translation->set_z(similarity.translation.z());
}

void ToProto(const Image& image, pb::Image* out) {
  switch (image.encoding) {
    case ImageEncoding::kAuto:
      out->set_encoding(pb::IMAGE_ENCODING_UNSPECIFIED);
      break;
    case ImageEncoding::kJpeg:
      out->set_encoding(pb::IMAGE_ENCODING_JPEG);
      break;
    case ImageEncoding::kPng:
      out->set_encoding(pb::IMAGE_ENCODING_PNG);
      break;
    case ImageEncoding::kRawGray8:
      out->set_encoding(pb::IMAGE_ENCODING_RAW_GRAY8);
      break;
    case ImageEncoding::kRawBgr8:
      out->set_encoding(pb::IMAGE_ENCODING_RAW_BGR8);
      break;
    case ImageEncoding::kRawRgb8:
      out->set_encoding(pb::IMAGE_ENCODING_RAW_RGB8);
      break;
  }
  out->set_data(image.bytes);
  out->set_width_px(image.width_px);
  out->set_height_px(image.height_px);
}

namespace {

void ToProto(const Eigen::Quaterniond& q, pb::Quaternion* out) {
  out->set_w(q.w());
  out->set_x(q.x());
  out->set_y(q.y());
  out->set_z(q.z());
}

void ToProto(const Eigen::Vector3d& v, pb::Vector3* out) {
  out->set_x(v.x());
  out->set_y(v.y());
  out->set_z(v.z());
}

void ToProto(const ImuModel& imu, pb::ImuModel* out) {
  ToProto(imu.imu_from_camera, out->mutable_imu_from_camera());
  if (imu.gyroscope_noise_rad_s_sqrt_hz) {
    out->set_gyroscope_noise_rad_s_sqrt_hz(*imu.gyroscope_noise_rad_s_sqrt_hz);
  }
  if (imu.gyroscope_walk_rad_s2_sqrt_hz) {
    out->set_gyroscope_walk_rad_s2_sqrt_hz(*imu.gyroscope_walk_rad_s2_sqrt_hz);
  }
  if (imu.gyroscope_bias_rad_s) {
    out->set_gyroscope_bias_rad_s(*imu.gyroscope_bias_rad_s);
  }
}

ImuModel FromProto(const pb::ImuModel& imu) {
  return {FromProto(imu.imu_from_camera()),
          imu.gyroscope_noise_rad_s_sqrt_hz(),
          imu.gyroscope_walk_rad_s2_sqrt_hz(),
          imu.gyroscope_bias_rad_s()};
}

}  // namespace

void ToProto(const PosePrior& prior, pb::PosePrior* out) {
  if (prior.position_world) {
    ToProto(*prior.position_world, out->mutable_position_m());
    out->set_position_sigma_m(prior.position_sigma_m);
  }
  if (prior.geodetic_position) {
    pb::GeodeticPosition* place = out->mutable_geodetic_position();
    place->set_latitude_deg(prior.geodetic_position->latitude_deg);
    place->set_longitude_deg(prior.geodetic_position->longitude_deg);
    place->set_height_m(prior.geodetic_position->height_m);
    out->set_geodetic_sigma_m(prior.position_sigma_m);
  }
  if (prior.position_arm_camera_m) {
    ToProto(*prior.position_arm_camera_m, out->mutable_position_arm_m());
  }
  if (prior.rotation) {
    ToProto(*prior.rotation, out->mutable_rotation());
    out->set_rotation_sigma_rad(prior.rotation_sigma_rad);
  }
}

void ToProto(const Frame& frame, pb::TrackRequest::Frame* out) {
  out->set_sequence(frame.sequence);
  out->set_capture_time_ns(frame.capture_time.count());
  ToProto(frame.image, out->mutable_image());
  if (frame.camera.has_value()) ToProto(*frame.camera, out->mutable_camera());
  if (frame.prior.has_value()) ToProto(*frame.prior, out->mutable_prior());
  for (const InertialSample& sample : frame.inertial) {
    pb::InertialSample* added = out->add_inertial();
    added->set_time_ns(sample.time.count());
    ToProto(sample.angular_rate_rad_s, added->mutable_angular_rate_rad_s());
    ToProto(sample.acceleration_m_s2, added->mutable_acceleration_m_s2());
  }
}

void ToProto(const SessionSpec& spec, pb::CreateSessionRequest* out) {
  out->set_session_id(spec.session_id);
  out->set_map_name(spec.map_name);
  out->set_map_version(spec.map_version);
  if (spec.camera) ToProto(*spec.camera, out->mutable_camera());
  const SessionOptions& options = spec.options;
  pb::SessionOptions* proto = out->mutable_options();
  proto->set_localizer(options.localizer);
  proto->set_tracker(options.tracker);
  proto->set_flow_mode(options.flow_mode == FlowMode::kLive
                           ? pb::FLOW_MODE_LIVE
                           : pb::FLOW_MODE_LOSSLESS);
  if (options.confidence_threshold.has_value()) {
    proto->set_confidence_threshold(*options.confidence_threshold);
  }
  if (options.target_lost_after_s.has_value()) {
    proto->set_target_lost_after_s(*options.target_lost_after_s);
  }
  if (options.camera_lost_after_s.has_value()) {
    proto->set_camera_lost_after_s(*options.camera_lost_after_s);
  }
  proto->set_seed(options.seed);
  proto->set_report_matches(options.report_matches);
  proto->set_report_movers(options.report_movers);
  if (options.imu) ToProto(*options.imu, proto->mutable_imu());
}

void ToProto(const geometry::GeodeticPosition& place,
             pb::GeodeticPosition* out) {
  out->set_latitude_deg(place.latitude_deg);
  out->set_longitude_deg(place.longitude_deg);
  out->set_height_m(place.height_m);
}

geometry::GeodeticPosition FromProto(const pb::GeodeticPosition& place) {
  return {place.latitude_deg(), place.longitude_deg(), place.height_m()};
}

pb::MapFormat ToProto(MapFormat format) {
  switch (format) {
    case MapFormat::kColmap:
      return pb::MAP_FORMAT_COLMAP;
    case MapFormat::kNvm:
      return pb::MAP_FORMAT_NVM;
    case MapFormat::kBundler:
      return pb::MAP_FORMAT_BUNDLER;
    case MapFormat::kOpenMvg:
      return pb::MAP_FORMAT_OPENMVG;
    case MapFormat::kOpenSfm:
      return pb::MAP_FORMAT_OPENSFM;
    case MapFormat::kGroundlock:
      return pb::MAP_FORMAT_GROUNDLOCK;
    case MapFormat::kAuto:
      break;
  }
  return pb::MAP_FORMAT_UNSPECIFIED;
}

pb::MapExportFormat ToProto(MapExportFormat format) {
  switch (format) {
    case MapExportFormat::kColmap:
      return pb::MAP_EXPORT_FORMAT_COLMAP;
    case MapExportFormat::kColmapText:
      return pb::MAP_EXPORT_FORMAT_COLMAP_TEXT;
    case MapExportFormat::kNvm:
      return pb::MAP_EXPORT_FORMAT_NVM;
    case MapExportFormat::kPly:
      return pb::MAP_EXPORT_FORMAT_PLY;
    case MapExportFormat::kGroundlock:
      return pb::MAP_EXPORT_FORMAT_GROUNDLOCK;
  }
  return pb::MAP_EXPORT_FORMAT_UNSPECIFIED;
}

MapInfo FromProto(const pb::MapInfo& map) {
  MapInfo info;
  info.name = map.name();
  info.version = map.version();
  info.content_hash = map.content_hash();
  info.create_time = FromProto(map.create_time());
  info.source_format = map.source_format();
  info.metric = map.metric();
  info.world_from_source = {map.world_from_source().scale(),
                            FromProto(map.world_from_source().rotation()),
                            FromProto(map.world_from_source().translation())};
  info.ground_world = {FromProto(map.ground_world().normal()),
                       map.ground_world().d()};
  info.ground_state = map.ground_state() == pb::GROUND_STATE_MEASURED
                          ? GroundState::kMeasured
                      : map.ground_state() == pb::GROUND_STATE_ESTIMATED
                          ? GroundState::kEstimated
                          : GroundState::kUnknown;
  info.ground_sigma_deg = map.ground_sigma_deg();
  info.ground_height_sigma = map.ground_height_sigma();
  info.ground_relief_m = map.ground_relief_m();
  info.ground_relief_given = map.ground_relief_given();
  if (map.has_lens()) {
    // A lens that this client does not know is as good as none.
    if (auto lens = FromProto(map.lens()); lens.ok()) info.lens = *lens;
  }
  if (map.has_origin()) info.origin = FromProto(map.origin());
  info.num_cameras = map.num_cameras();
  info.num_views = map.num_views();
  info.num_landmarks = map.num_landmarks();
  info.num_observations = map.num_observations();
  info.mean_reprojection_error_px = map.mean_reprojection_error_px();
  info.has_descriptors = map.has_descriptors();
  info.file_bytes = map.file_bytes();
  return info;
}

absl::StatusOr<geometry::CameraModel> FromProto(const pb::CameraModel& camera) {
  // The API's numbers are COLMAP's plus one.
  const auto id = static_cast<geometry::CameraModelId>(
      static_cast<int>(camera.model()) - 1);
  if (camera.model() < pb::CAMERA_MODEL_ID_SIMPLE_PINHOLE ||
      camera.model() > pb::CAMERA_MODEL_ID_OPENCV_FISHEYE) {
    return absl::InternalError("the server sent an unknown camera model");
  }
  return geometry::CameraModel::Create(
      id,
      camera.width_px(),
      camera.height_px(),
      {camera.params().data(), static_cast<std::size_t>(camera.params_size())});
}

geometry::Rigid3 FromProto(const pb::RigidTransform& rigid) {
  return {FromProto(rigid.rotation()), FromProto(rigid.translation())};
}

absl::StatusOr<SessionInfo> FromProto(const pb::Session& session) {
  SessionInfo info;
  info.spec.session_id = session.session_id();
  info.spec.map_name = session.map_name();
  info.spec.map_version = session.map_version();
  if (session.has_camera()) {
    ASSIGN_OR_RETURN(info.spec.camera, FromProto(session.camera()));
  }
  const pb::SessionOptions& options = session.options();
  info.spec.options.localizer = options.localizer();
  info.spec.options.tracker = options.tracker();
  info.spec.options.flow_mode = options.flow_mode() == pb::FLOW_MODE_LIVE
                                    ? FlowMode::kLive
                                    : FlowMode::kLossless;
  info.spec.options.confidence_threshold = options.confidence_threshold();
  info.spec.options.target_lost_after_s = options.target_lost_after_s();
  info.spec.options.camera_lost_after_s = options.camera_lost_after_s();
  info.spec.options.seed = options.seed();
  info.spec.options.report_matches = options.report_matches();
  info.spec.options.report_movers = options.report_movers();
  if (options.has_imu()) info.spec.options.imu = FromProto(options.imu());
  info.create_time = FromProto(session.create_time());
  info.next_sequence = session.next_sequence();
  info.frames_processed = session.frames_processed();
  info.frames_dropped = session.frames_dropped();
  info.frames_failed = session.frames_failed();
  info.target_ids.assign(session.target_ids().begin(),
                         session.target_ids().end());
  info.streaming = session.streaming();
  info.owner = session.owner();
  return info;
}

CameraResult FromProto(const pb::CameraResult& camera) {
  CameraResult result;
  result.state = FromProto(camera.state());
  if (camera.has_world_from_camera()) {
    result.world_from_camera = FromProto(camera.world_from_camera());
  }
  if (camera.covariance_size() == 36) {
    result.covariance =
        Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(
            camera.covariance().data());
  }
  result.reset_count = camera.reset_count();
  result.ignores_gyroscope = camera.ignores_gyroscope();
  if (camera.has_lens_contradiction()) {
    result.lens_contradiction = {camera.lens_contradiction().focal_ratio(),
                                 camera.lens_contradiction().corner_share()};
  }
  result.num_inliers = camera.num_inliers();
  result.mean_reprojection_error_px = camera.mean_reprojection_error_px();
  const int matches =
      std::min(camera.match_xy_px_size() / 2, camera.match_xyz_m_size() / 3);
  for (int i = 0; i < matches; ++i) {
    result.match_xy_px.emplace_back(camera.match_xy_px(2 * i),
                                    camera.match_xy_px(2 * i + 1));
    result.match_xyz_world.emplace_back(camera.match_xyz_m(3 * i),
                                        camera.match_xyz_m(3 * i + 1),
                                        camera.match_xyz_m(3 * i + 2));
  }
  return result;
}

StageTimes FromProto(const pb::StageTimes& times) {
  return {times.queue_ms(),
          times.decode_ms(),
          times.localize_ms(),
          times.track_ms(),
          times.total_ms(),
          times.movers_ms()};
}

MoversState FromProto(pb::MoversState state) {
  switch (state) {
    case pb::MOVERS_STATE_WATCHING:
      return MoversState::kWatching;
    case pb::MOVERS_STATE_STARTING:
      return MoversState::kStarting;
    case pb::MOVERS_STATE_NO_MAP:
      return MoversState::kNoMap;
    case pb::MOVERS_STATE_NO_GROUND:
      return MoversState::kNoGround;
    case pb::MOVERS_STATE_NO_POSE:
      return MoversState::kNoPose;
    case pb::MOVERS_STATE_POSE_CONTRADICTED:
      return MoversState::kPoseContradicted;
    default:
      return MoversState::kNotAsked;
  }
}

Mover FromProto(const pb::Mover& proto) {
  Mover mover;
  mover.id = proto.mover_id();
  mover.box_px = FromProto(proto.box());
  mover.ground_center_world = FromProto(proto.ground_center_m());
  if (proto.ground_covariance_m2_size() == 4) {
    mover.ground_covariance_m2 =
        Eigen::Map<const Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(
            proto.ground_covariance_m2().data());
  }
  mover.velocity_world_m_s = FromProto(proto.velocity_world_m_s());
  if (proto.velocity_covariance_m2_s2_size() == 4) {
    mover.velocity_covariance_m2_s2 =
        Eigen::Map<const Eigen::Matrix<double, 2, 2, Eigen::RowMajor>>(
            proto.velocity_covariance_m2_s2().data());
  }
  mover.confidence = proto.confidence();
  return mover;
}

FrameResult FromProto(const pb::FrameResult& proto) {
  FrameResult result;
  result.sequence = proto.sequence();
  result.capture_time = std::chrono::nanoseconds(proto.capture_time_ns());
  result.camera = FromProto(proto.camera());
  for (const pb::TargetResult& target : proto.targets()) {
    result.targets.push_back(FromProto(target));
  }
  result.map_version = proto.map_version();
  result.times = FromProto(proto.times());
  for (const pb::TargetError& error : proto.target_errors()) {
    result.target_errors.push_back({error.target_id(), error.message()});
  }
  for (const pb::Mover& mover : proto.movers()) {
    result.movers.push_back(FromProto(mover));
  }
  result.movers_state = FromProto(proto.movers_state());
  return result;
}

Image FromProto(const pb::Image& image) {
  Image result;
  switch (image.encoding()) {
    case pb::IMAGE_ENCODING_JPEG:
      result.encoding = ImageEncoding::kJpeg;
      break;
    case pb::IMAGE_ENCODING_PNG:
      result.encoding = ImageEncoding::kPng;
      break;
    default:  // watchers are sent no raw images
      result.encoding = ImageEncoding::kAuto;
  }
  result.bytes = image.data();
  result.width_px = image.width_px();
  result.height_px = image.height_px();
  return result;
}

absl::StatusOr<FrameReply> FromProto(const pb::TrackResponse& response) {
  switch (response.message_case()) {
    case pb::TrackResponse::kResult:
      return FromProto(response.result());
    case pb::TrackResponse::kError:
      return FrameError{
          response.error().sequence(),
          absl::Status(static_cast<absl::StatusCode>(response.error().code()),
                       response.error().message())};
    case pb::TrackResponse::kDropped: {
      using Reason = FrameDropped::Reason;
      const auto reason = response.dropped().reason();
      return FrameDropped{
          response.dropped().sequence(),
          reason == pb::FrameDropped::REASON_OVERLOAD   ? Reason::kOverload
          : reason == pb::FrameDropped::REASON_SHUTDOWN ? Reason::kShutdown
                                                        : Reason::kUnknown};
    }
    default:
      return absl::InternalError("the server sent no answer to a frame");
  }
}

}  // namespace groundlock::sdk
