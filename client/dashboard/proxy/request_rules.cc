// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/request_rules.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "absl/strings/str_cat.h"
#include "client/dashboard/proxy/http_rules.h"
#include "map_store/base/status.h"

namespace groundlock::dashboard {
namespace {

namespace gl = ::groundlock::v1;

constexpr int kMaxIdBytes = 64;
constexpr double kMaxImageRate = 1'000.0;
constexpr std::uint32_t kMaxImagesInFlight = 64;

absl::Status CheckId(const std::string& id, std::string_view field) {
  if (!id.empty() && id.size() <= kMaxIdBytes) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(base::Abseil(field), ": expected 1 to 64 characters"));
}

absl::Status CheckBox(const gl::Box2& box, std::string_view field) {
  if (std::isfinite(box.x()) && std::isfinite(box.y()) &&
      std::isfinite(box.width()) && std::isfinite(box.height()) &&
      box.width() > 0.0 && box.height() > 0.0) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(
      absl::StrCat(base::Abseil(field), ": not a box"));
}

absl::Status Check(const pb::ClientMessage& message) {
  switch (message.request_case()) {
    case pb::ClientMessage::kSubscribe: {
      const double rate = message.subscribe().max_images_per_s();
      if (!(rate >= 0.0 && rate <= kMaxImageRate)) {
        return absl::InvalidArgumentError(
            "max_images_per_s: expected 0 to 1000");
      }
      if (message.subscribe().max_images_in_flight() > kMaxImagesInFlight) {
        return absl::InvalidArgumentError(
            "max_images_in_flight: expected 0 to 64");
      }
      return CheckId(message.subscribe().session_id(), "session_id");
    }
    case pb::ClientMessage::kImageTaken:
      return CheckId(message.image_taken().session_id(), "session_id");
    case pb::ClientMessage::kUnsubscribe:
      return CheckId(message.unsubscribe().session_id(), "session_id");
    case pb::ClientMessage::kGetPointCloud:
      return CheckId(message.get_point_cloud().map_name(), "map_name");
    case pb::ClientMessage::kSetTarget:
      RETURN_IF_ERROR(CheckId(message.set_target().session_id(), "session_id"));
      return CheckBox(message.set_target().box(), "box");
    case pb::ClientMessage::kMoveTarget:
      RETURN_IF_ERROR(
          CheckId(message.move_target().session_id(), "session_id"));
      return CheckBox(message.move_target().box(), "box");
    case pb::ClientMessage::kStartSession: {
      const pb::StartSession& start = message.start_session();
      if (start.source_id().empty()) {
        return absl::InvalidArgumentError("source_id: none was chosen");
      }
      for (int i = 0; i < start.targets_size(); ++i) {
        RETURN_IF_ERROR(CheckBox(start.targets(i).box(),
                                 absl::StrCat("targets[", i, "].box")));
      }
      return absl::OkStatus();
    }
    case pb::ClientMessage::kControlSource:
      if (message.control_source().action() <=
              pb::ControlSource::ACTION_UNSPECIFIED ||
          message.control_source().action() > pb::ControlSource::ACTION_STEP) {
        return absl::InvalidArgumentError("action: not a known one");
      }
      return CheckId(message.control_source().session_id(), "session_id");
    case pb::ClientMessage::kStartRecording:
      if (!message.start_recording().name().empty()) {
        RETURN_IF_ERROR(ValidateName(message.start_recording().name(), "name"));
      }
      return CheckId(message.start_recording().session_id(), "session_id");
    case pb::ClientMessage::kStopRecording:
      return CheckId(message.stop_recording().session_id(), "session_id");
    case pb::ClientMessage::kDeleteRecording:
      return ValidateName(message.delete_recording().name(), "name");
    case pb::ClientMessage::kImportMap:
      RETURN_IF_ERROR(CheckId(message.import_map().upload_id(), "upload_id"));
      return ValidateName(message.import_map().name(), "name");
    case pb::ClientMessage::kBuildMap:
      RETURN_IF_ERROR(CheckId(message.build_map().upload_id(), "upload_id"));
      return ValidateName(message.build_map().name(), "name");
    case pb::ClientMessage::REQUEST_NOT_SET:
      return absl::InvalidArgumentError("request: none that is known here");
    default:
      return absl::OkStatus();  // the server's to judge
  }
}

}  // namespace

absl::StatusOr<pb::ClientMessage> ParseRequest(std::string_view bytes) {
  pb::ClientMessage message;
  if (!message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) {
    return absl::InvalidArgumentError("not a ClientMessage");
  }
  if (message.request_id() == 0 && !message.has_image_taken()) {
    return absl::InvalidArgumentError("request_id: must be above 0");
  }
  if (const absl::Status status = Check(message); !status.ok()) {
    return status;
  }
  return message;
}

bool RateLimit::Take(std::chrono::steady_clock::time_point now) {
  if (last_ != std::chrono::steady_clock::time_point{}) {
    const std::chrono::duration<double> passed = now - last_;
    left_ = std::min(left_ + per_second_ * passed.count(), 2.0 * per_second_);
  }
  last_ = now;
  if (left_ < 1.0) return false;
  left_ -= 1.0;
  return true;
}

}  // namespace groundlock::dashboard
