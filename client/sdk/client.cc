// SPDX-License-Identifier: Apache-2.0
#include "client/sdk/client.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <optional>
#include <utility>

#include "absl/strings/match.h"
#include "client/sdk/channel.h"
#include "client/sdk/connection.h"
#include "client/sdk/convert.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/base/version.h"

namespace groundlock::sdk {

const char* Version() { return base::Version(); }

absl::Status ClientOptions::Validate() const {
  if (connect_timeout.count() <= 0) {
    return absl::InvalidArgumentError("connect_timeout: must be above 0");
  }
  if (call_timeout.count() <= 0) {
    return absl::InvalidArgumentError("call_timeout: must be above 0");
  }
  if (max_message_bytes < 1 << 20) {
    return absl::InvalidArgumentError(
        "max_message_bytes: must be at least 1 MiB");
  }
  if (tls.certificate.empty() != tls.key.empty()) {
    return absl::InvalidArgumentError(
        "tls: a certificate needs its key, and a key its certificate");
  }
  return absl::OkStatus();
}

absl::StatusOr<std::string> FindToken(const std::filesystem::path& file) {
  if (file.empty()) {
    const char* token = std::getenv("GROUNDLOCK_TOKEN");
    return std::string(token == nullptr ? "" : token);
  }
  constexpr std::uint64_t kMaxFileBytes = 1 << 20;
  ASSIGN_OR_RETURN(std::string text, base::ReadFile(file, kMaxFileBytes));
  text.resize(std::min(text.find_first_of("\r\n"), text.size()));
  if (text.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(file.string(), ": the first line has no token"));
  }
  return text;
}

namespace {

using SystemClock = std::chrono::system_clock;

// Why the channel cannot connect, in gRPC's words. gRPC tells it only to a call
// that does not wait for the connection.
std::string ConnectFailure(pb::MapService::Stub& maps) {
  grpc::ClientContext context;
  context.set_deadline(SystemClock::now() + std::chrono::seconds(1));
  context.set_wait_for_ready(false);
  pb::ListMapsRequest request;
  pb::ListMapsResponse response;
  request.set_page_size(1);
  return maps.ListMaps(&context, request, &response).error_message();
}

// Returns nothing once the channel is connected, else why it is not. A server
// that does not listen yet is waited for; certificates that do not please stay
// as they are, so that a refused handshake ends the waiting.
std::optional<std::string> WaitUntilConnected(grpc::Channel* channel,
                                              pb::MapService::Stub& maps,
                                              const ClientOptions& options) {
  const auto deadline = SystemClock::now() + options.connect_timeout;
  std::string failure = "no answer in time";
  while (true) {
    const grpc_connectivity_state state =
        channel->GetState(/*try_to_connect=*/true);
    if (state == GRPC_CHANNEL_READY) return std::nullopt;
    if (state == GRPC_CHANNEL_TRANSIENT_FAILURE) {
      failure = ConnectFailure(maps);
      if (absl::StrContains(failure, "handshake failed")) return failure;
    }
    if (!channel->WaitForStateChange(state, deadline)) return failure;
  }
}

}  // namespace

std::unique_ptr<grpc::ClientContext> Client::Connection::Context() const {
  auto context = std::make_unique<grpc::ClientContext>();
  context->set_deadline(std::chrono::system_clock::now() +
                        options.call_timeout);
  return context;
}

absl::StatusOr<std::unique_ptr<Client>> Client::Connect(
    const std::string& target, const ClientOptions& options) {
  RETURN_IF_ERROR(options.Validate());
  auto connection = std::make_shared<Connection>();
  connection->options = options;
  ASSIGN_OR_RETURN(connection->channel, MakeChannel(target, options));
  connection->maps = pb::MapService::NewStub(connection->channel);
  if (const std::optional<std::string> failure = WaitUntilConnected(
          connection->channel.get(), *connection->maps, options)) {
    const bool secure = options.tls.enabled || target.starts_with("grpcs://");
    return absl::UnavailableError(
        absl::StrCat("no Groundlock server answers at ",
                     target,
                     secure ? " with TLS, or its certificate is not trusted, "
                              "or it wants another of this client: "
                            : " without TLS: ",
                     *failure));
  }
  connection->tracking = pb::TrackingService::NewStub(connection->channel);
  return std::unique_ptr<Client>(new Client(std::move(connection)));
}

Client::Client(std::shared_ptr<Connection> connection)
    : connection_(std::move(connection)) {}

Client::~Client() = default;

absl::StatusOr<SessionInfo> Client::CreateSession(const SessionSpec& spec) {
  pb::CreateSessionRequest request;
  pb::CreateSessionResponse response;
  ToProto(spec, &request);
  RETURN_IF_ERROR(FromGrpc(connection_->tracking->CreateSession(
      connection_->Context().get(), request, &response)));
  return FromProto(response.session());
}

absl::StatusOr<Caller> Client::GetCaller() {
  pb::GetCallerResponse response;
  RETURN_IF_ERROR(FromGrpc(connection_->tracking->GetCaller(
      connection_->Context().get(), pb::GetCallerRequest(), &response)));
  return Caller{response.open_to_all(),
                response.name(),
                response.tenant(),
                {response.scopes().begin(), response.scopes().end()}};
}

absl::StatusOr<std::vector<SessionInfo>> Client::ListSessions() {
  std::vector<SessionInfo> sessions;
  pb::ListSessionsRequest request;
  do {
    pb::ListSessionsResponse response;
    RETURN_IF_ERROR(FromGrpc(connection_->tracking->ListSessions(
        connection_->Context().get(), request, &response)));
    for (const pb::Session& session : response.sessions()) {
      ASSIGN_OR_RETURN(SessionInfo info, FromProto(session));
      sessions.push_back(std::move(info));
    }
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  return sessions;
}

absl::StatusOr<SessionInfo> Client::GetSession(const std::string& session_id) {
  pb::GetSessionRequest request;
  pb::GetSessionResponse response;
  request.set_session_id(session_id);
  RETURN_IF_ERROR(FromGrpc(connection_->tracking->GetSession(
      connection_->Context().get(), request, &response)));
  return FromProto(response.session());
}

absl::Status Client::DeleteSession(const std::string& session_id) {
  pb::DeleteSessionRequest request;
  pb::DeleteSessionResponse response;
  request.set_session_id(session_id);
  return FromGrpc(connection_->tracking->DeleteSession(
      connection_->Context().get(), request, &response));
}

absl::StatusOr<std::string> Client::SetTarget(
    const std::string& session_id,
    const std::string& target_id,
    const geometry::Box2& box_px,
    std::optional<std::uint64_t> sequence,
    const TargetBody& body) {
  pb::SetTargetRequest request;
  pb::SetTargetResponse response;
  request.set_session_id(session_id);
  request.set_target_id(target_id);
  ToProto(box_px, request.mutable_box());
  if (sequence.has_value()) request.set_sequence(*sequence);
  if (!body.kind.empty() || body.size_m) {
    RETURN_IF_ERROR(ToProto(body, request.mutable_body()));
  }
  RETURN_IF_ERROR(FromGrpc(connection_->tracking->SetTarget(
      connection_->Context().get(), request, &response)));
  return response.target_id();
}

absl::Status Client::MoveTarget(const std::string& session_id,
                                const std::string& target_id,
                                const geometry::Box2& box_px) {
  pb::MoveTargetRequest request;
  pb::MoveTargetResponse response;
  request.set_session_id(session_id);
  request.set_target_id(target_id);
  ToProto(box_px, request.mutable_box());
  return FromGrpc(connection_->tracking->MoveTarget(
      connection_->Context().get(), request, &response));
}

absl::Status Client::DropTarget(const std::string& session_id,
                                const std::string& target_id) {
  pb::DropTargetRequest request;
  pb::DropTargetResponse response;
  request.set_session_id(session_id);
  request.set_target_id(target_id);
  return FromGrpc(connection_->tracking->DropTarget(
      connection_->Context().get(), request, &response));
}

absl::StatusOr<std::unique_ptr<TrackingStream>> Client::Track(
    const std::string& session_id, const TrackingStreamOptions& options) {
  return OpenTrackingStream(
      {connection_, connection_->tracking.get()}, session_id, options);
}

absl::StatusOr<std::unique_ptr<SessionWatcher>> Client::Watch(
    const std::string& session_id,
    bool include_images,
    std::uint32_t image_width_px) {
  return OpenWatcher({connection_, connection_->tracking.get()},
                     session_id,
                     include_images,
                     image_width_px);
}

absl::StatusOr<LocalizeReport> Client::Localize(const LocalizeSpec& spec) {
  pb::LocalizeRequest request;
  pb::LocalizeResponse response;
  request.set_map_name(spec.map_name);
  request.set_map_version(spec.map_version);
  if (spec.camera) ToProto(*spec.camera, request.mutable_camera());
  ToProto(spec.image, request.mutable_image());
  request.set_localizer(spec.localizer);
  request.set_seed(spec.seed);
  if (spec.prior) ToProto(*spec.prior, request.mutable_prior());
  grpc::ClientContext context;
  RETURN_IF_ERROR(
      FromGrpc(connection_->tracking->Localize(&context, request, &response)));
  return LocalizeReport{FromProto(response.camera()),
                        response.map_version(),
                        FromProto(response.times())};
}

}  // namespace groundlock::sdk
