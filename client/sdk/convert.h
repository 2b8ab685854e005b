// SPDX-License-Identifier: Apache-2.0
// Between the SDK's structs and the API's messages. Internal to the SDK.
#ifndef GROUNDLOCK_CLIENT_SDK_CONVERT_H_
#define GROUNDLOCK_CLIENT_SDK_CONVERT_H_

#include <grpcpp/support/status.h>

#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/sdk/types.h"
#include "groundlock/v1/maps.pb.h"
#include "groundlock/v1/tracking.pb.h"

namespace groundlock::sdk {

namespace pb = ::groundlock::v1;

// gRPC's codes are absl's.
absl::Status FromGrpc(const grpc::Status& status);

// To the server.
void ToProto(const geometry::CameraModel& camera, pb::CameraModel* out);
void ToProto(const geometry::Box2& box, pb::Box2* out);
// kInvalidArgument: there is no such kind.
absl::Status ToProto(const TargetBody& body, pb::TargetBody* out);
void ToProto(const geometry::Similarity3& similarity,
             pb::SimilarityTransform* out);
void ToProto(const Image& image, pb::Image* out);
void ToProto(const PosePrior& prior, pb::PosePrior* out);
void ToProto(const Frame& frame, pb::TrackRequest::Frame* out);
void ToProto(const SessionSpec& spec, pb::CreateSessionRequest* out);
pb::MapFormat ToProto(MapFormat format);
pb::MapExportFormat ToProto(MapExportFormat format);

void ToProto(const geometry::GeodeticPosition& place,
             pb::GeodeticPosition* out);

// From the server. Enums that this client does not know become the most careful
// of those it knows (say, a target that is not TRACKED).
MapInfo FromProto(const pb::MapInfo& map);
// kInternal if the server sent a camera that is none.
absl::StatusOr<geometry::CameraModel> FromProto(const pb::CameraModel& camera);
geometry::Rigid3 FromProto(const pb::RigidTransform& rigid);
geometry::GeodeticPosition FromProto(const pb::GeodeticPosition& place);
absl::StatusOr<SessionInfo> FromProto(const pb::Session& session);
CameraResult FromProto(const pb::CameraResult& camera);
StageTimes FromProto(const pb::StageTimes& times);
FrameResult FromProto(const pb::FrameResult& result);
Image FromProto(const pb::Image& image);
// kInternal if it is no answer.
absl::StatusOr<FrameReply> FromProto(const pb::TrackResponse& response);

}  // namespace groundlock::sdk

#endif  // GROUNDLOCK_CLIENT_SDK_CONVERT_H_
