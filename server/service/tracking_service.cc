// SPDX-License-Identifier: Apache-2.0
#include "server/service/tracking_service.h"

#include <algorithm>
#include <chrono>
#include <string>
#include <utility>

#include "map_store/base/status.h"
#include "server/image/frame.h"
#include "server/localization/localizer.h"
#include "server/service/convert.h"
#include "server/service/session_lens.h"
#include "server/service/tenant_store.h"
#include "server/service/track_stream.h"
#include "server/service/watch_stream.h"

namespace groundlock::service {

TrackingService::TrackingService(const ServerOptions& options,
                                 const Gate& gate,
                                 SessionManager* sessions,
                                 const Executors& executors,
                                 Metrics* metrics)
    : GatedService("groundlock.v1.TrackingService", gate),
      options_(options),
      sessions_(sessions),
      executors_(executors),
      metrics_(metrics) {
  AddUnary("CreateSession", this, &TrackingService::CreateSession);
  AddUnary("ListSessions", this, &TrackingService::ListSessions);
  AddUnary("GetSession", this, &TrackingService::GetSession);
  AddUnary("DeleteSession", this, &TrackingService::DeleteSession);
  AddUnary("SetTarget", this, &TrackingService::SetTarget);
  AddUnary("MoveTarget", this, &TrackingService::MoveTarget);
  AddUnary("DropTarget", this, &TrackingService::DropTarget);
  AddUnary("Localize", this, &TrackingService::Localize);
  AddUnary("GetCaller", this, &TrackingService::GetCaller);
  AddStream<pb::TrackRequest, pb::TrackResponse>(
      "Track",
      [this](grpc::CallbackServerContext* context, const CallTerms& terms) {
        return TrackStream::Start(context, sessions_, terms, metrics_);
      });
  AddStream<pb::WatchSessionRequest, pb::WatchSessionResponse>(
      "WatchSession",
      [this](grpc::CallbackServerContext* context, const CallTerms& terms) {
        return WatchStream::Start(
            context, sessions_, terms, executors_.disk, metrics_);
      });
}

void TrackingService::CreateSession(
    Call<pb::CreateSessionRequest, pb::CreateSessionResponse>& call) {
  // A map may have to come from a database first.
  BackgroundExecutor* executor =
      call.request().map_name().empty() ? executors_.disk : executors_.opening;
  call.ReplyFrom(executor, [this, &call]() -> absl::Status {
    ASSIGN_OR_RETURN(SessionSpec spec, FromProto(call.request(), options_));
    spec.tenant = call.caller().principal->tenant;
    spec.owner = call.caller().principal->name;
    if (const auto& span = call.caller().span) spec.span = span->context();
    ASSIGN_OR_RETURN(const auto session,
                     sessions_->Create(std::move(spec),
                                       *call.caller().maps,
                                       call.caller().principal->account));
    ToProto(session->Describe(), call.response().mutable_session());
    return absl::OkStatus();
  });
}

void TrackingService::ListSessions(
    Call<pb::ListSessionsRequest, pb::ListSessionsResponse>& call) {
  const auto size = PageSize(call.request().page_size());
  if (!size.ok()) return call.Reply(size.status());
  const auto wanted = static_cast<std::size_t>(*size);
  const auto sessions = sessions_->List(
      *call.caller().principal, call.request().page_token(), wanted + 1);
  for (std::size_t i = 0; i < std::min(wanted, sessions.size()); ++i) {
    ToProto(sessions[i]->Describe(), call.response().add_sessions());
  }
  if (sessions.size() > wanted) {
    call.response().set_next_page_token(sessions[wanted - 1]->spec().id);
  }
  call.Reply(absl::OkStatus());
}

void TrackingService::GetSession(
    Call<pb::GetSessionRequest, pb::GetSessionResponse>& call) {
  const auto session = sessions_->Find(
      *call.caller().principal, call.request().session_id(), Deed::kSee);
  if (!session.ok()) return call.Reply(session.status());
  ToProto((*session)->Describe(), call.response().mutable_session());
  call.Reply(absl::OkStatus());
}

void TrackingService::GetCaller(
    Call<pb::GetCallerRequest, pb::GetCallerResponse>& call) {
  const Principal& principal = *call.caller().principal;
  pb::GetCallerResponse& response = call.response();
  response.set_open_to_all(gate().access->open_to_all());
  response.set_name(principal.name);
  response.set_tenant(principal.tenant);
  for (const std::string& scope : ScopeNames(principal.scopes)) {
    response.add_scopes(scope);
  }
  call.Reply(absl::OkStatus());
}

void TrackingService::DeleteSession(
    Call<pb::DeleteSessionRequest, pb::DeleteSessionResponse>& call) {
  call.Reply(
      sessions_->Delete(*call.caller().principal, call.request().session_id()));
}

void TrackingService::SetTarget(
    Call<pb::SetTargetRequest, pb::SetTargetResponse>& call) {
  const absl::Status status = DoSetTarget(call);
  if (!status.ok()) call.Reply(status);
}

// Replies unless it returns an error.
absl::Status TrackingService::DoSetTarget(
    Call<pb::SetTargetRequest, pb::SetTargetResponse>& call) {
  const pb::SetTargetRequest& request = call.request();
  ASSIGN_OR_RETURN(
      const auto session,
      sessions_->Find(
          *call.caller().principal, request.session_id(), Deed::kAct));
  ASSIGN_OR_RETURN(const auto box, FromProto(request.box(), "box"));
  ASSIGN_OR_RETURN(auto body, FromProto(request.body(), "body"));
  std::string id = request.target_id();
  if (id.empty()) {
    id = session->MakeTargetId();
  } else {
    RETURN_IF_ERROR(ValidateId(id, "target_id"));
  }
  call.response().set_target_id(id);
  std::optional<std::uint64_t> sequence;
  if (request.has_sequence()) sequence = request.sequence();
  session->SetTarget(
      std::move(id),
      box,
      sequence,
      std::move(body),
      [&call](const absl::Status& status) { call.Reply(status); });
  return absl::OkStatus();
}

void TrackingService::MoveTarget(
    Call<pb::MoveTargetRequest, pb::MoveTargetResponse>& call) {
  const auto session = sessions_->Find(
      *call.caller().principal, call.request().session_id(), Deed::kAct);
  if (!session.ok()) return call.Reply(session.status());
  const auto box = FromProto(call.request().box(), "box");
  if (!box.ok()) return call.Reply(box.status());
  (*session)->MoveTarget(
      call.request().target_id(), *box, [&call](const absl::Status& status) {
        call.Reply(status);
      });
}

void TrackingService::DropTarget(
    Call<pb::DropTargetRequest, pb::DropTargetResponse>& call) {
  const auto session = sessions_->Find(
      *call.caller().principal, call.request().session_id(), Deed::kAct);
  if (!session.ok()) return call.Reply(session.status());
  (*session)->DropTarget(
      call.request().target_id(),
      [&call](const absl::Status& status) { call.Reply(status); });
}

void TrackingService::Localize(
    Call<pb::LocalizeRequest, pb::LocalizeResponse>& call) {
  const auto bytes =
      static_cast<std::int64_t>(call.request().image().data().size());
  if (const auto& account = call.caller().principal->account) {
    const absl::Status within =
        account->TakeFrame(call.request().image().data().size());
    if (!within.ok()) return call.Reply(within);
  }
  const std::int64_t before = waiting_image_bytes_.fetch_add(bytes);
  // Given back when the image is not waited for any more, in whatever way.
  const std::shared_ptr<void> waiting(
      nullptr, [this, bytes](void*) { waiting_image_bytes_ -= bytes; });
  if (before > 0 && before + bytes > options_.max_waiting_image_bytes) {
    return call.Reply(absl::ResourceExhaustedError(
        "too many images wait to be localized; try again later"));
  }
  call.ReplyFrom(executors_.heavy, [this, waiting, &call] {
    return DoLocalize(*call.caller().maps, call.request(), &call.response());
  });
}

absl::Status TrackingService::DoLocalize(storage::Store& maps,
                                         const pb::LocalizeRequest& request,
                                         pb::LocalizeResponse* response) {
  const auto start = std::chrono::steady_clock::now();
  RETURN_IF_ERROR(
      base::Annotate(storage::ValidateMapName(request.map_name()), "map_name"));
  ASSIGN_OR_RETURN(const image::Encoding encoding,
                   FromProto(request.image().encoding(), "image.encoding"));
  std::optional<localization::PosePrior> prior;
  if (request.has_prior()) {
    ASSIGN_OR_RETURN(prior, FromProto(request.prior(), "prior"));
  }
  ASSIGN_OR_RETURN(const storage::MapVersion version,
                   maps.Get(request.map_name(), request.map_version()));
  ASSIGN_OR_RETURN(const auto map, maps.Open(version.name, version.version));
  std::optional<geometry::CameraModel> camera;
  if (request.has_camera()) {
    ASSIGN_OR_RETURN(camera, FromProto(request.camera(), "camera"));
  }
  localization::LocalizerOptions localizer_options;
  localizer_options.is_single_frame = true;
  localizer_options.seed = request.seed();
  ASSIGN_OR_RETURN(const auto localizer,
                   localization::CreateLocalizer(
                       request.localizer().empty() ? options_.default_localizer
                                                   : request.localizer(),
                       map,
                       localizer_options));
  const std::string& bytes = request.image().data();
  const auto decode_start = std::chrono::steady_clock::now();
  auto frame = image::DecodeImage(
      {encoding,
       {reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()},
       request.image().width_px(),
       request.image().height_px()},
      options_.sessions.image);
  if (!frame.ok()) return base::Annotate(frame.status(), "image");
  if (!camera) {
    ASSIGN_OR_RETURN(camera, LensOfMap(*map, version.name));
    ASSIGN_OR_RETURN(camera, LensForSize(camera, frame->size_px()));
  }
  const auto localize_start = std::chrono::steady_clock::now();
  ASSIGN_OR_RETURN(localization::LocalizationResult result,
                   localizer->Localize({&*frame, *camera, {}, prior}));
  const auto end = std::chrono::steady_clock::now();
  // A single image has no earlier pose to fall back to.
  if (result.state != localization::CameraState::kTracked) {
    result.state = localization::CameraState::kLost;
  }
  ++metrics_->images_localized;
  ToProto(
      result, map.get(), /*report_matches=*/false, response->mutable_camera());
  response->set_map_version(version.version);
  tracking::StageTimes times;
  times.decode = localize_start - decode_start;
  times.localize = end - localize_start;
  times.total = end - start;
  ToProto(times, {}, response->mutable_times());
  return absl::OkStatus();
}

}  // namespace groundlock::service
