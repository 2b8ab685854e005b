// SPDX-License-Identifier: Apache-2.0
// The one place that translates between the API's messages and the types of the
// rooms. Everything from a client is checked here: unknown enums, numbers that
// are not finite, sizes out of range. Errors are kInvalidArgument and name the
// field.
#ifndef GROUNDLOCK_SERVER_SERVICE_CONVERT_H_
#define GROUNDLOCK_SERVER_SERVICE_CONVERT_H_

#include <grpcpp/support/status.h>

#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "groundlock/v1/maps.pb.h"
#include "groundlock/v1/tracking.pb.h"
#include "map_store/formats/formats.h"
#include "map_store/map/alignment.h"
#include "map_store/storage/store.h"
#include "server/service/options.h"
#include "server/service/session_types.h"

namespace groundlock::service {

namespace pb = ::groundlock::v1;

// absl's codes are gRPC's.
grpc::Status ToGrpc(const absl::Status& status);

// From clients ---------------------------------------------------------------

// An id of a session or target: 1 to 64 of [A-Za-z0-9._-].
absl::Status ValidateId(std::string_view id, std::string_view field);
absl::StatusOr<geometry::CameraModel> FromProto(const pb::CameraModel& camera,
                                                std::string_view field);
absl::StatusOr<geometry::Box2> FromProto(const pb::Box2& box,
                                         std::string_view field);
absl::StatusOr<geometry::Similarity3> FromProto(
    const pb::SimilarityTransform& similarity, std::string_view field);
absl::StatusOr<geometry::GeodeticPosition> FromProto(
    const pb::GeodeticPosition& place, std::string_view field);
absl::StatusOr<image::Encoding> FromProto(pb::ImageEncoding encoding,
                                          std::string_view field);
absl::StatusOr<formats::Format> FromProto(pb::MapFormat format,
                                          std::string_view field);
absl::StatusOr<formats::ExportFormat> FromProto(pb::MapExportFormat format,
                                                std::string_view field);

// Fills what the request leaves to the server: `options`' defaults. The id may
// be empty.
absl::StatusOr<SessionSpec> FromProto(const pb::CreateSessionRequest& request,
                                      const ServerOptions& options);
// Unset, nothing is told; the rest is checked by TrackingSession::SetTarget.
absl::StatusOr<tracking::TargetBody> FromProto(const pb::TargetBody& body,
                                               std::string_view field);
absl::StatusOr<localization::PosePrior> FromProto(const pb::PosePrior& prior,
                                                  std::string_view field);
// The unit's rotation must be given.
absl::StatusOr<localization::ImuModel> FromProto(const pb::ImuModel& imu,
                                                 std::string_view field);
absl::StatusOr<std::vector<localization::InertialSample>> FromProto(
    const google::protobuf::RepeatedPtrField<pb::InertialSample>& samples,
    std::string_view field);

// Takes the image's bytes out of `frame`. A field that is wrong is noted in the
// job's status: the frame is accepted, and answered so.
FrameJob TakeFrame(pb::TrackRequest::Frame& frame);

absl::StatusOr<map::AlignmentRequest> FromProto(
    const pb::AlignMapRequest& request);

// Page sizes of list requests: 0 = 100, at most 1000.
absl::StatusOr<int> PageSize(int requested);

// To clients -----------------------------------------------------------------

void ToProto(const storage::MapVersion& map, pb::MapInfo* out);
void ToProto(const geometry::GeodeticPosition& place,
             pb::GeodeticPosition* out);
void ToProto(const geometry::Similarity3& similarity,
             pb::SimilarityTransform* out);
void ToProto(const map::AlignmentReport& report, pb::AlignMapResponse* out);
void ToProto(const geometry::CameraModel& camera, pb::CameraModel* out);
void ToProto(const geometry::Rigid3& rigid, pb::RigidTransform* out);
void ToProto(const SessionDescription& session, pb::Session* out);
// map: the one that the result refers to; null = none, and no matches.
void ToProto(const localization::LocalizationResult& camera,
             const map::Map* map,
             bool report_matches,
             pb::CameraResult* out);
void ToProto(const FrameOutcome& outcome,
             const SessionSpec& spec,
             const map::Map* map,
             pb::FrameResult* out);
void ToProto(const Answer& answer,
             const SessionSpec& spec,
             const map::Map* map,
             pb::TrackResponse* out);
void ToProto(const tracking::StageTimes& times,
             std::chrono::nanoseconds queue_time,
             pb::StageTimes* out);

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_CONVERT_H_
