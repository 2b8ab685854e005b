// SPDX-License-Identifier: Apache-2.0
#include "server/service/tracking_service.h"

#include <algorithm>
#include <chrono>
#include <string>
#include <utility>

#include "map_store/base/status.h"
#include "server/image/frame.h"
#include "server/localization/localizer.h"
#include "server/service/access.h"
#include "server/service/convert.h"
#include "server/service/session_lens.h"
#include "server/service/track_stream.h"
#include "server/service/unary.h"
#include "server/service/watch_stream.h"

namespace groundlock::service {

TrackingService::TrackingService(const ServerOptions& options,
                                 SessionManager* sessions,
                                 storage::Store* store,
                                 const Executors& executors,
                                 const Access* access,
                                 Metrics* metrics)
    : options_(options),
      sessions_(sessions),
      store_(store),
      executors_(executors),
      access_(access),
      metrics_(metrics) {}

grpc::ServerUnaryReactor* TrackingService::CreateSession(
    grpc::CallbackServerContext* context,
    const pb::CreateSessionRequest* request,
    pb::CreateSessionResponse* response) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  return ReplyFrom(executors_.disk, context, [this, request, response] {
    return DoCreateSession(*request, response);
  });
}

absl::Status TrackingService::DoCreateSession(
    const pb::CreateSessionRequest& request,
    pb::CreateSessionResponse* response) {
  ASSIGN_OR_RETURN(SessionSpec spec, FromProto(request, options_));
  ASSIGN_OR_RETURN(const auto session, sessions_->Create(std::move(spec)));
  ToProto(session->Describe(), response->mutable_session());
  return absl::OkStatus();
}

grpc::ServerUnaryReactor* TrackingService::ListSessions(
    grpc::CallbackServerContext* context,
    const pb::ListSessionsRequest* request,
    pb::ListSessionsResponse* response) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  const auto size = PageSize(request->page_size());
  if (!size.ok()) return Reply(context, size.status());
  const auto wanted = static_cast<std::size_t>(*size);
  const auto sessions = sessions_->List(request->page_token(), wanted + 1);
  for (std::size_t i = 0; i < std::min(wanted, sessions.size()); ++i) {
    ToProto(sessions[i]->Describe(), response->add_sessions());
  }
  if (sessions.size() > wanted) {
    response->set_next_page_token(sessions[wanted - 1]->spec().id);
  }
  return Reply(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* TrackingService::GetSession(
    grpc::CallbackServerContext* context,
    const pb::GetSessionRequest* request,
    pb::GetSessionResponse* response) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  const auto session = sessions_->Find(request->session_id());
  if (!session.ok()) return Reply(context, session.status());
  ToProto((*session)->Describe(), response->mutable_session());
  return Reply(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* TrackingService::DeleteSession(
    grpc::CallbackServerContext* context,
    const pb::DeleteSessionRequest* request,
    pb::DeleteSessionResponse* /*response*/) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  return Reply(context, sessions_->Delete(request->session_id()));
}

grpc::ServerUnaryReactor* TrackingService::SetTarget(
    grpc::CallbackServerContext* context,
    const pb::SetTargetRequest* request,
    pb::SetTargetResponse* response) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  const auto session = sessions_->Find(request->session_id());
  if (!session.ok()) return Reply(context, session.status());
  const auto box = FromProto(request->box(), "box");
  if (!box.ok()) return Reply(context, box.status());
  std::string id = request->target_id();
  if (id.empty()) {
    id = (*session)->MakeTargetId();
  } else if (const absl::Status valid = ValidateId(id, "target_id");
             !valid.ok()) {
    return Reply(context, valid);
  }
  response->set_target_id(id);
  std::optional<std::uint64_t> sequence;
  if (request->has_sequence()) sequence = request->sequence();
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  (*session)->SetTarget(
      std::move(id), *box, sequence, [reactor](const absl::Status& status) {
        reactor->Finish(ToGrpc(status));
      });
  return reactor;
}

grpc::ServerUnaryReactor* TrackingService::MoveTarget(
    grpc::CallbackServerContext* context,
    const pb::MoveTargetRequest* request,
    pb::MoveTargetResponse* /*response*/) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  const auto session = sessions_->Find(request->session_id());
  if (!session.ok()) return Reply(context, session.status());
  const auto box = FromProto(request->box(), "box");
  if (!box.ok()) return Reply(context, box.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  (*session)->MoveTarget(
      request->target_id(), *box, [reactor](const absl::Status& s) {
        reactor->Finish(ToGrpc(s));
      });
  return reactor;
}

grpc::ServerUnaryReactor* TrackingService::DropTarget(
    grpc::CallbackServerContext* context,
    const pb::DropTargetRequest* request,
    pb::DropTargetResponse* /*response*/) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  const auto session = sessions_->Find(request->session_id());
  if (!session.ok()) return Reply(context, session.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  (*session)->DropTarget(
      request->target_id(),
      [reactor](const absl::Status& s) { reactor->Finish(ToGrpc(s)); });
  return reactor;
}

grpc::ServerBidiReactor<pb::TrackRequest, pb::TrackResponse>*
TrackingService::Track(grpc::CallbackServerContext* context) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Refuse<grpc::ServerBidiReactor<pb::TrackRequest, pb::TrackResponse>>(
        status);
  }
  return TrackStream::Start(sessions_, metrics_);
}

grpc::ServerWriteReactor<pb::WatchSessionResponse>*
TrackingService::WatchSession(grpc::CallbackServerContext* context,
                              const pb::WatchSessionRequest* request) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Refuse<grpc::ServerWriteReactor<pb::WatchSessionResponse>>(status);
  }
  auto session = sessions_->Find(request->session_id());
  // An error may be all that a client gets, and then without headers: this one
  // tells it that it is watching, before the first result.
  if (session.ok()) context->AddInitialMetadata("groundlock-watching", "1");
  return WatchStream::Start(std::move(session),
                            request->include_images(),
                            request->image_width_px(),
                            executors_.disk,
                            metrics_);
}

grpc::ServerUnaryReactor* TrackingService::Localize(
    grpc::CallbackServerContext* context,
    const pb::LocalizeRequest* request,
    pb::LocalizeResponse* response) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  return ReplyFrom(executors_.heavy, context, [this, request, response] {
    return DoLocalize(*request, response);
  });
}

absl::Status TrackingService::DoLocalize(const pb::LocalizeRequest& request,
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
                   store_->Get(request.map_name(), request.map_version()));
  ASSIGN_OR_RETURN(const auto map, store_->Open(version.name, version.version));
  std::optional<geometry::CameraModel> camera;
  if (request.has_camera()) {
    ASSIGN_OR_RETURN(camera, FromProto(request.camera(), "camera"));
  }
  localization::LocalizerOptions localizer_options;
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
