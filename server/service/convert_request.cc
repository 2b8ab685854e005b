// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "map_store/base/status.h"
#include "server/service/convert.h"

namespace groundlock::service {
namespace {

// A day: keeps the count of nanoseconds within 64 bits.
constexpr double kMaxLostAfter_s = 86'400.0;

std::chrono::nanoseconds Nanoseconds(double seconds) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
      std::chrono::duration<double>(seconds));
}

template <typename... Parts>
absl::Status Invalid(std::string_view field, const Parts&... parts) {
  return absl::InvalidArgumentError(
      absl::StrCat(base::Abseil(field), ": ", parts...));
}

std::string Sub(std::string_view field, std::string_view name) {
  return absl::StrCat(
      base::Abseil(field), field.empty() ? "" : ".", base::Abseil(name));
}

bool IsFinite(std::initializer_list<double> values) {
  return std::all_of(values.begin(), values.end(), [](double value) {
    return std::isfinite(value);
  });
}

absl::Status ValidateName(const std::string& name,
                          const std::vector<std::string>& known,
                          std::string_view field) {
  if (std::find(known.begin(), known.end(), name) != known.end()) {
    return absl::OkStatus();
  }
  return Invalid(
      field, "unknown '", name, "', known are ", absl::StrJoin(known, ", "));
}

}  // namespace

grpc::Status ToGrpc(const absl::Status& status) {
  if (status.ok()) return grpc::Status::OK;
  return {static_cast<grpc::StatusCode>(status.code()),
          std::string(status.message())};
}

absl::Status ValidateId(std::string_view id, std::string_view field) {
  const bool known = std::all_of(id.begin(), id.end(), [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '.' || c == '_' || c == '-';
  });
  if (id.empty() || id.size() > 64 || !known) {
    return Invalid(field, "must be 1 to 64 of [A-Za-z0-9._-]");
  }
  return absl::OkStatus();
}

absl::StatusOr<geometry::CameraModel> FromProto(const pb::CameraModel& camera,
                                                std::string_view field) {
  geometry::CameraModelId id{};
  switch (camera.model()) {
    case pb::CAMERA_MODEL_ID_SIMPLE_PINHOLE:
      id = geometry::CameraModelId::kSimplePinhole;
      break;
    case pb::CAMERA_MODEL_ID_PINHOLE:
      id = geometry::CameraModelId::kPinhole;
      break;
    case pb::CAMERA_MODEL_ID_SIMPLE_RADIAL:
      id = geometry::CameraModelId::kSimpleRadial;
      break;
    case pb::CAMERA_MODEL_ID_RADIAL:
      id = geometry::CameraModelId::kRadial;
      break;
    case pb::CAMERA_MODEL_ID_OPENCV:
      id = geometry::CameraModelId::kOpenCv;
      break;
    case pb::CAMERA_MODEL_ID_OPENCV_FISHEYE:
      id = geometry::CameraModelId::kOpenCvFisheye;
      break;
    default:
      return Invalid(Sub(field, "model"),
                     "unset or unknown (",
                     static_cast<int>(camera.model()),
                     ")");
  }
  auto model = geometry::CameraModel::Create(
      id,
      camera.width_px(),
      camera.height_px(),
      {camera.params().data(), static_cast<std::size_t>(camera.params_size())});
  if (!model.ok()) return base::Annotate(model.status(), field);
  return model;
}

absl::StatusOr<geometry::Box2> FromProto(const pb::Box2& box,
                                         std::string_view field) {
  if (!IsFinite({box.x(), box.y(), box.width(), box.height()})) {
    return Invalid(field, "holds a number that is not finite");
  }
  if (!(box.width() > 0.0)) {
    return Invalid(Sub(field, "width"), box.width(), " is not above 0");
  }
  if (!(box.height() > 0.0)) {
    return Invalid(Sub(field, "height"), box.height(), " is not above 0");
  }
  return geometry::Box2::FromXywh(box.x(), box.y(), box.width(), box.height());
}

absl::StatusOr<geometry::Similarity3> FromProto(
    const pb::SimilarityTransform& similarity, std::string_view field) {
  const pb::Quaternion& q = similarity.rotation();
  const pb::Vector3& t = similarity.translation();
  if (!IsFinite({similarity.scale(),
                 q.w(),
                 q.x(),
                 q.y(),
                 q.z(),
                 t.x(),
                 t.y(),
                 t.z()})) {
    return Invalid(field, "holds a number that is not finite");
  }
  if (!(similarity.scale() > 0.0)) {
    return Invalid(Sub(field, "scale"), similarity.scale(), " is not above 0");
  }
  const Eigen::Quaterniond rotation(q.w(), q.x(), q.y(), q.z());
  // Text files carry six digits: a norm further off is no rotation.
  if (std::abs(rotation.norm() - 1.0) > 1e-3) {
    return Invalid(Sub(field, "rotation"),
                   "is not a unit quaternion, norm ",
                   rotation.norm());
  }
  return geometry::Similarity3{
      similarity.scale(), rotation.normalized(), {t.x(), t.y(), t.z()}};
}

absl::StatusOr<geometry::GeodeticPosition> FromProto(
    const pb::GeodeticPosition& place, std::string_view field) {
  const geometry::GeodeticPosition position{
      place.latitude_deg(), place.longitude_deg(), place.height_m()};
  RETURN_IF_ERROR(base::Annotate(position.Validate(), field));
  return position;
}

absl::StatusOr<image::Encoding> FromProto(pb::ImageEncoding encoding,
                                          std::string_view field) {
  switch (encoding) {
    case pb::IMAGE_ENCODING_UNSPECIFIED:
      return image::Encoding::kAuto;
    case pb::IMAGE_ENCODING_JPEG:
      return image::Encoding::kJpeg;
    case pb::IMAGE_ENCODING_PNG:
      return image::Encoding::kPng;
    case pb::IMAGE_ENCODING_RAW_GRAY8:
      return image::Encoding::kRawGray8;
    case pb::IMAGE_ENCODING_RAW_BGR8:
      return image::Encoding::kRawBgr8;
    case pb::IMAGE_ENCODING_RAW_RGB8:
      return image::Encoding::kRawRgb8;
    default:
      return Invalid(field, "unknown (", static_cast<int>(encoding), ")");
  }
}

absl::StatusOr<formats::Format> FromProto(pb::MapFormat format,
                                          std::string_view field) {
  switch (format) {
    case pb::MAP_FORMAT_UNSPECIFIED:
      return formats::Format::kAuto;
    case pb::MAP_FORMAT_COLMAP:
      return formats::Format::kColmap;
    case pb::MAP_FORMAT_NVM:
      return formats::Format::kNvm;
    case pb::MAP_FORMAT_BUNDLER:
      return formats::Format::kBundler;
    case pb::MAP_FORMAT_OPENMVG:
      return formats::Format::kOpenMvg;
    case pb::MAP_FORMAT_OPENSFM:
      return formats::Format::kOpenSfm;
    case pb::MAP_FORMAT_GROUNDLOCK:
      return formats::Format::kGroundlock;
    default:
      return Invalid(field, "unknown (", static_cast<int>(format), ")");
  }
}

absl::StatusOr<formats::ExportFormat> FromProto(pb::MapExportFormat format,
                                                std::string_view field) {
  switch (format) {
    case pb::MAP_EXPORT_FORMAT_COLMAP:
      return formats::ExportFormat::kColmapBinary;
    case pb::MAP_EXPORT_FORMAT_COLMAP_TEXT:
      return formats::ExportFormat::kColmapText;
    case pb::MAP_EXPORT_FORMAT_NVM:
      return formats::ExportFormat::kNvm;
    case pb::MAP_EXPORT_FORMAT_PLY:
      return formats::ExportFormat::kPly;
    case pb::MAP_EXPORT_FORMAT_GROUNDLOCK:
      return formats::ExportFormat::kGroundlock;
    default:
      return Invalid(
          field, "unset or unknown (", static_cast<int>(format), ")");
  }
}

absl::StatusOr<SessionSpec> FromProto(const pb::CreateSessionRequest& request,
                                      const ServerOptions& options) {
  SessionSpec spec;
  spec.id = request.session_id();
  if (!spec.id.empty()) RETURN_IF_ERROR(ValidateId(spec.id, "session_id"));
  spec.map_name = request.map_name();
  if (!spec.map_name.empty()) {
    RETURN_IF_ERROR(
        base::Annotate(storage::ValidateMapName(spec.map_name), "map_name"));
  }
  spec.map_version = request.map_version();
  if (request.has_camera()) {
    ASSIGN_OR_RETURN(spec.camera, FromProto(request.camera(), "camera"));
  }

  const pb::SessionOptions& given = request.options();
  tracking::SessionOptions& session = spec.options;
  session.localizer =
      given.localizer().empty() ? options.default_localizer : given.localizer();
  RETURN_IF_ERROR(ValidateName(
      session.localizer, localization::LocalizerNames(), "options.localizer"));
  session.tracker.name =
      given.tracker().empty() ? options.default_tracker : given.tracker();
  RETURN_IF_ERROR(ValidateName(
      session.tracker.name, target::AllTrackerNames(), "options.tracker"));
  session.tracker.models = options.tracker_models;
  switch (given.flow_mode()) {
    case pb::FLOW_MODE_UNSPECIFIED:
    case pb::FLOW_MODE_LOSSLESS:
      spec.live = false;
      break;
    case pb::FLOW_MODE_LIVE:
      spec.live = true;
      break;
    default:
      return Invalid("options.flow_mode",
                     "unknown (",
                     static_cast<int>(given.flow_mode()),
                     ")");
  }
  // Lossless: results do not depend on the machine's speed; live: never wait.
  session.localization.wait_for_anchor = !spec.live;
  if (given.has_confidence_threshold()) {
    const double threshold = given.confidence_threshold();
    if (!(threshold > 0.0 && threshold < 1.0)) {
      return Invalid(
          "options.confidence_threshold", threshold, " is not in (0, 1)");
    }
    session.confidence_threshold = threshold;
  }
  if (given.has_target_lost_after_s()) {
    const double seconds = given.target_lost_after_s();
    if (!(seconds > 0.0 && seconds <= kMaxLostAfter_s)) {
      return Invalid(
          "options.target_lost_after_s", seconds, " is not in (0, 86400]");
    }
    session.target_lost_after = Nanoseconds(seconds);
  }
  if (given.has_camera_lost_after_s()) {
    const double seconds = given.camera_lost_after_s();
    if (!(seconds >= 0.0 && seconds <= kMaxLostAfter_s)) {
      return Invalid(
          "options.camera_lost_after_s", seconds, " is not in [0, 86400]");
    }
    session.localization.lost_after = Nanoseconds(seconds);
  }
  session.seed = given.seed();
  session.localization.seed = given.seed();
  session.max_targets = options.sessions.max_targets;
  spec.report_matches = given.report_matches();
  session.report_movers = given.report_movers();
  if (given.has_imu()) {
    ASSIGN_OR_RETURN(session.localization.imu,
                     FromProto(given.imu(), "options.imu"));
  }
  RETURN_IF_ERROR(base::Annotate(session.Validate(), "options"));
  return spec;
}

absl::StatusOr<localization::PosePrior> FromProto(const pb::PosePrior& prior,
                                                  std::string_view field) {
  localization::PosePrior result;
  if (prior.has_position_m()) {
    const pb::Vector3& p = prior.position_m();
    result.position_world = Eigen::Vector3d(p.x(), p.y(), p.z());
    result.position_sigma = prior.position_sigma_m();
  }
  if (prior.has_geodetic_position()) {
    if (result.position_world) {
      return Invalid(field, "has position_m and geodetic_position");
    }
    const pb::GeodeticPosition& place = prior.geodetic_position();
    result.geodetic_position = geometry::GeodeticPosition{
        place.latitude_deg(), place.longitude_deg(), place.height_m()};
    result.position_sigma = prior.geodetic_sigma_m();
  }
  if (prior.has_position_arm_m()) {
    const pb::Vector3& arm = prior.position_arm_m();
    const std::string arm_field = Sub(field, "position_arm_m");
    if (!result.position_world && !result.geodetic_position) {
      return Invalid(arm_field, "goes with position_m or geodetic_position");
    }
    if (!IsFinite({arm.x(), arm.y(), arm.z()})) {
      return Invalid(arm_field, "holds a number that is not finite");
    }
    result.position_arm_camera = Eigen::Vector3d(arm.x(), arm.y(), arm.z());
  }
  if (prior.has_rotation()) {
    const pb::Quaternion& q = prior.rotation();
    const Eigen::Quaterniond rotation(q.w(), q.x(), q.y(), q.z());
    // Sensors speak in single precision.
    if (!rotation.coeffs().allFinite() ||
        std::abs(rotation.norm() - 1.0) > 1e-3) {
      return Invalid(Sub(field, "rotation"), "is not a unit quaternion");
    }
    result.rotation = rotation.normalized();
    result.rotation_sigma_rad = prior.rotation_sigma_rad();
  }
  RETURN_IF_ERROR(base::Annotate(result.Validate(), field));
  return result;
}

absl::StatusOr<tracking::TargetBody> FromProto(const pb::TargetBody& body,
                                               std::string_view field) {
  tracking::TargetBody result;
  if (body.kind() != pb::BODY_KIND_UNSPECIFIED) {
    absl::string_view name = pb::BodyKind_Name(body.kind());
    if (!absl::ConsumePrefix(&name, "BODY_KIND_")) {
      return Invalid(Sub(field, "kind"),
                     static_cast<int>(body.kind()),
                     " is no known kind of body");
    }
    result.kind = absl::AsciiStrToLower(name);
  }
  if (body.has_size_m()) {
    result.size_m.emplace(
        body.size_m().x(), body.size_m().y(), body.size_m().z());
  }
  return result;
}

absl::StatusOr<localization::ImuModel> FromProto(const pb::ImuModel& imu,
                                                 std::string_view field) {
  localization::ImuModel result;
  if (!imu.has_imu_from_camera()) {
    return Invalid(Sub(field, "imu_from_camera"), "is missing");
  }
  const pb::Quaternion& q = imu.imu_from_camera();
  const Eigen::Quaterniond rotation(q.w(), q.x(), q.y(), q.z());
  if (!rotation.coeffs().allFinite() ||
      std::abs(rotation.norm() - 1.0) > 1e-3) {
    return Invalid(Sub(field, "imu_from_camera"), "is not a unit quaternion");
  }
  result.imu_from_camera = rotation.normalized();
  if (imu.has_gyroscope_noise_rad_s_sqrt_hz()) {
    result.gyroscope_noise_rad_s_sqrt_hz = imu.gyroscope_noise_rad_s_sqrt_hz();
  }
  if (imu.has_gyroscope_walk_rad_s2_sqrt_hz()) {
    result.gyroscope_walk_rad_s2_sqrt_hz = imu.gyroscope_walk_rad_s2_sqrt_hz();
  }
  if (imu.has_gyroscope_bias_rad_s()) {
    result.gyroscope_bias_rad_s = imu.gyroscope_bias_rad_s();
  }
  RETURN_IF_ERROR(base::Annotate(result.Validate(), field));
  return result;
}

absl::StatusOr<std::vector<localization::InertialSample>> FromProto(
    const google::protobuf::RepeatedPtrField<pb::InertialSample>& samples,
    std::string_view field) {
  if (static_cast<std::size_t>(samples.size()) >
      localization::kMaxInertialSamples) {
    return Invalid(field,
                   samples.size(),
                   " samples, at most ",
                   localization::kMaxInertialSamples);
  }
  const auto vector = [](const pb::Vector3& v) {
    return Eigen::Vector3d(v.x(), v.y(), v.z());
  };
  std::vector<localization::InertialSample> result;
  result.reserve(static_cast<std::size_t>(samples.size()));
  for (const pb::InertialSample& sample : samples) {
    result.push_back({std::chrono::nanoseconds(sample.time_ns()),
                      vector(sample.angular_rate_rad_s()),
                      vector(sample.acceleration_m_s2())});
  }
  RETURN_IF_ERROR(
      base::Annotate(localization::ValidateInertial(result), field));
  return result;
}

FrameJob TakeFrame(pb::TrackRequest::Frame& frame) {
  FrameJob job;
  job.received = std::chrono::steady_clock::now();
  job.sequence = frame.sequence();
  job.capture_time = std::chrono::nanoseconds(frame.capture_time_ns());
  if (job.capture_time.count() < 0) {
    job.status = Invalid(
        "frame.capture_time_ns", job.capture_time.count(), " is below 0");
  }
  auto encoding = FromProto(frame.image().encoding(), "frame.image.encoding");
  if (encoding.ok()) {
    job.encoding = *encoding;
  } else {
    job.status = encoding.status();
  }
  job.width_px = frame.image().width_px();
  job.height_px = frame.image().height_px();
  if (frame.has_camera()) {
    auto camera = FromProto(frame.camera(), "frame.camera");
    if (camera.ok()) {
      job.camera = *std::move(camera);
    } else {
      job.status = camera.status();
    }
  }
  if (frame.has_prior()) {
    auto prior = FromProto(frame.prior(), "frame.prior");
    if (prior.ok()) {
      job.sensors.prior = *std::move(prior);
    } else {
      job.status = prior.status();
    }
  }
  if (auto inertial = FromProto(frame.inertial(), "frame.inertial");
      inertial.ok()) {
    job.sensors.inertial = *std::move(inertial);
  } else {
    job.status = inertial.status();
  }
  if (job.status.ok()) {
    job.bytes = std::move(*frame.mutable_image()->mutable_data());
  }
  return job;
}

absl::StatusOr<int> PageSize(int requested) {
  if (requested < 0 || requested > 1'000) {
    return Invalid("page_size", requested, " is not in [0, 1000]");
  }
  return requested == 0 ? 100 : requested;
}

}  // namespace groundlock::service
