// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/requests.h"

#include <google/protobuf/util/time_util.h>

#include <chrono>
#include <string>
#include <utility>

#include "client/dashboard/proxy/rights.h"
#include "client/dashboard/proxy/session_start.h"
#include "client/dashboard/proxy/viewer.h"
#include "map_store/base/status.h"

namespace groundlock::dashboard {
namespace {

using ViewerPtr = std::shared_ptr<Viewer>;

// Points of a map that a recording holds, so that it can be replayed alone.
constexpr std::uint64_t kRecordedPoints = 100'000;

// One request and the way back to who has made it.
struct Task {
  Core* core;
  ViewerPtr viewer;
  std::uint64_t id;

  void Done(const absl::Status& status) const { viewer->ReplyDone(id, status); }
  void Reply(pb::ServerMessage message) const {
    viewer->Reply(id, std::move(message));
  }
  // Runs `work` where files may be read, unless the pool is gone.
  template <typename Work>
  void OnDisk(Work work) const {
    asio::post(core->work, [task = *this, work = std::move(work)]() mutable {
      work(task);
    });
  }
  // Passes a request on; `fill` makes the reply of the response.
  template <typename Request, typename Response, typename Fill>
  void Relay(const Request& request, Fill fill) const {
    sdk::Reply<Response> reply = [task = *this,
                                  fill](absl::StatusOr<Response> response) {
      if (!response.ok()) {
        task.Done(response.status());
        return;
      }
      pb::ServerMessage message;
      fill(*response, &message);
      task.Reply(std::move(message));
    };
    core->relay->Call(viewer->token(), request, std::move(reply));
  }
  // The same for requests whose reply says no more than that they are done.
  template <typename Request, typename Response>
  void RelayDone(const Request& request, bool lists_change) const {
    Relay<Request, Response>(
        request,
        [core = core, lists_change](const Response&, pb::ServerMessage* out) {
          out->mutable_done();
          if (lists_change) core->catalogue->Refresh();
        });
  }
};

void Handle(const Task& task, const pb::Ping& ping) {
  pb::ServerMessage message;
  pb::Pong* pong = message.mutable_pong();
  pong->set_client_time_ms(ping.client_time_ms());
  pong->set_server_time_ns(
      std::chrono::duration_cast<std::chrono::nanoseconds>(
          std::chrono::steady_clock::now().time_since_epoch())
          .count());
  *pong->mutable_wall_time() =
      google::protobuf::util::TimeUtil::GetCurrentTime();
  task.Reply(std::move(message));
}

// Calls `use` with the session, as the viewer's token may see it.
template <typename Use>
void WithSession(const Task& task, const std::string& session_id, Use use) {
  gl::GetSessionRequest request;
  request.set_session_id(session_id);
  task.core->relay->Call(
      task.viewer->token(),
      request,
      [task, use = std::move(use)](
          const absl::StatusOr<gl::GetSessionResponse>& response) {
        if (response.ok()) {
          use(response->session());
        } else {
          task.Done(response.status());
        }
      });
}

void Handle(const Task& task, const pb::Subscribe& subscribe) {
  WithSession(
      task, subscribe.session_id(), [task, subscribe](const gl::Session& s) {
        task.viewer->Subscribe(task.id, subscribe, s);
      });
}

void Handle(const Task& task, const pb::GetPointCloud& request) {
  task.core->clouds->Get(
      task.viewer->token(),
      request.map_name(),
      request.map_version(),
      [task](absl::StatusOr<std::shared_ptr<const EncodedCloud>> cloud) {
        if (!cloud.ok()) {
          task.Done(cloud.status());
          return;
        }
        pb::ServerMessage message;
        *message.mutable_point_cloud_start() = (*cloud)->start;
        task.Reply(std::move(message));
        task.viewer->SendParts((*cloud)->blocks);
      });
}

void Handle(const Task& task, const pb::StartSession& start) {
  if (const auto may = MustHave(task.viewer->caller(), "sessions:own");
      !may.ok()) {
    return task.Done(may);
  }
  StartSession(*task.core,
               task.viewer->token(),
               start,
               /*use_existing=*/false,
               [task](const absl::StatusOr<gl::Session>& session) {
                 if (!session.ok()) {
                   task.Done(session.status());
                   return;
                 }
                 pb::ServerMessage message;
                 *message.mutable_session_started()->mutable_session() =
                     *session;
                 task.Reply(std::move(message));
               });
}

// The same if the viewer may act on it, too.
template <typename Use>
void WithOwnSession(const Task& task, const std::string& session_id, Use use) {
  WithSession(task, session_id, [task, use](const gl::Session& session) {
    const absl::Status may = MayActOn(task.viewer->caller(), session);
    if (may.ok()) {
      use(session);
    } else {
      task.Done(may);
    }
  });
}

template <typename Use>
void WithRecordings(const Task& task, const std::string& session_id, Use use) {
  if (task.core->recordings == nullptr) {
    task.Done(absl::FailedPreconditionError(
        "this dashboard does not record: start it with --recordings"));
    return;
  }
  WithOwnSession(task, session_id, [task, use](const gl::Session& session) {
    task.OnDisk([session, use](const Task& t) { use(t, session); });
  });
}

void ReplyRecording(const Task& task,
                    const absl::StatusOr<pb::RecordingInfo>& info) {
  if (!info.ok()) {
    task.Done(info.status());
    return;
  }
  pb::ServerMessage message;
  *message.mutable_recording() = *info;
  task.Reply(std::move(message));
  task.core->catalogue->Refresh();
}

void Handle(const Task& task, const pb::StartRecording& start) {
  WithRecordings(
      task,
      start.session_id(),
      [name = start.name()](const Task& t, const gl::Session& session) {
        const auto info = t.core->recordings->Start(
            session,
            t.core->catalogue->FindMap(session.map_name(),
                                       session.map_version()),
            name);
        ReplyRecording(t, info);
        if (!info.ok() || session.map_name().empty()) return;
        gl::GetPointCloudRequest points;
        points.set_name(session.map_name());
        points.set_version(session.map_version());
        points.set_max_points(kRecordedPoints);
        t.core->relay->GetPointCloud(
            t.viewer->token(),
            points,
            [core = t.core,
             id = session.session_id()](gl::GetPointCloudResponse block) {
              core->recordings->AddPoints(
                  id,
                  std::make_shared<const gl::GetPointCloudResponse>(
                      std::move(block)));
              return true;
            },
            [](const absl::Status&) {});  // the recording goes without
      });
}

void Handle(const Task& task, const pb::StopRecording& stop) {
  if (task.core->recordings == nullptr) {
    task.Done(absl::NotFoundError("nothing is being recorded"));
    return;
  }
  const auto end = [task, id = stop.session_id()] {
    task.OnDisk([id](const Task& t) {
      ReplyRecording(t, t.core->recordings->Stop(id));
    });
  };
  // The session itself may be over by now.
  if (MayActOnAll(task.viewer->caller()).ok()) return end();
  WithOwnSession(task, stop.session_id(), [end](const gl::Session&) { end(); });
}

void Handle(const Task& task, const pb::DeleteRecording& request) {
  if (task.core->recordings == nullptr) {
    task.Done(absl::NotFoundError("there are no recordings"));
    return;
  }
  if (const auto may = MayActOnAll(task.viewer->caller()); !may.ok()) {
    return task.Done(may);
  }
  task.OnDisk([name = request.name()](const Task& t) {
    t.Done(t.core->recordings->Delete(name));
    t.core->catalogue->Refresh();
  });
}

void Handle(const Task& task, const gl::DeleteSessionRequest& request) {
  task.Relay<gl::DeleteSessionRequest, gl::DeleteSessionResponse>(
      request,
      [core = task.core, id = request.session_id()](
          const gl::DeleteSessionResponse&, pb::ServerMessage* out) {
        out->mutable_done();
        // What feeds it would only find it gone.
        core->runs->Control(id, pb::ControlSource::ACTION_STOP).IgnoreError();
        core->catalogue->Refresh();
      });
}

void Handle(const Task& task, const pb::ControlSource& control) {
  const auto steer = [task, control] {
    task.Done(task.core->runs->Control(control.session_id(), control.action()));
    task.core->catalogue->Refresh();
  };
  // The session itself may be over by now.
  if (MayActOnAll(task.viewer->caller()).ok()) return steer();
  WithOwnSession(
      task, control.session_id(), [steer](const gl::Session&) { steer(); });
}

// An import or a build: `start` begins it.
template <typename Request, typename Start>
void MakeMap(const Task& task, const Request& request, Start start) {
  if (const auto may = MustHave(task.viewer->caller(), "maps:write");
      !may.ok()) {
    return task.Done(may);
  }
  if (task.core->uploads == nullptr) {
    task.Done(absl::FailedPreconditionError(
        "this dashboard takes no uploads: start it with --uploads"));
    return;
  }
  const auto upload = task.core->uploads->Find(request.upload_id());
  if (!upload.ok()) {
    task.Done(upload.status());
    return;
  }
  const auto cancel = std::make_shared<std::atomic<bool>>(false);
  MapJobCallbacks callbacks;
  callbacks.progress = [task](const pb::Progress& progress) {
    pb::ServerMessage message;
    *message.mutable_progress() = progress;
    task.Reply(std::move(message));
  };
  callbacks.done = [task, upload_id = upload->id](
                       const absl::StatusOr<pb::MapImported>& imported) {
    task.viewer->RemoveCancel(task.id);
    if (!imported.ok()) {
      task.Done(imported.status());
      return;
    }
    task.core->uploads->Remove(upload_id).IgnoreError();
    task.core->catalogue->Refresh();
    gl::GetMapRequest get;
    get.set_name(imported->map().name());
    get.set_version(imported->map().version());
    task.Relay<gl::GetMapRequest, gl::GetMapResponse>(
        get,
        [imported = *imported](const gl::GetMapResponse& response,
                               pb::ServerMessage* out) {
          *out->mutable_map_imported() = imported;
          *out->mutable_map_imported()->mutable_map() = response.map();
        });
  };
  task.viewer->AddCancel(task.id, cancel);
  const absl::Status started = (*task.core->jobs.*start)(
      request, *upload, task.viewer->token(), cancel, std::move(callbacks));
  if (!started.ok()) {
    task.viewer->RemoveCancel(task.id);
    task.Done(started);
  }
}

}  // namespace

void HandleRequest(Core& core,
                   const ViewerPtr& viewer,
                   pb::ClientMessage request) {
  const Task task{&core, viewer, request.request_id()};
  switch (request.request_case()) {
    case pb::ClientMessage::kPing:
      return Handle(task, request.ping());
    case pb::ClientMessage::kSubscribe:
      return Handle(task, request.subscribe());
    case pb::ClientMessage::kUnsubscribe:
      viewer->Unsubscribe(request.unsubscribe().session_id());
      return task.Done(absl::OkStatus());
    case pb::ClientMessage::kGetPointCloud:
      return Handle(task, request.get_point_cloud());
    case pb::ClientMessage::kSetTarget:
      return task.Relay<gl::SetTargetRequest, gl::SetTargetResponse>(
          request.set_target(),
          [](const gl::SetTargetResponse& response, pb::ServerMessage* out) {
            out->mutable_target_set()->set_target_id(response.target_id());
          });
    case pb::ClientMessage::kMoveTarget:
      return task.RelayDone<gl::MoveTargetRequest, gl::MoveTargetResponse>(
          request.move_target(), /*lists_change=*/false);
    case pb::ClientMessage::kDropTarget:
      return task.RelayDone<gl::DropTargetRequest, gl::DropTargetResponse>(
          request.drop_target(), /*lists_change=*/false);
    case pb::ClientMessage::kDeleteSession:
      return Handle(task, request.delete_session());
    case pb::ClientMessage::kDeleteMap:
      return task.RelayDone<gl::DeleteMapRequest, gl::DeleteMapResponse>(
          request.delete_map(), /*lists_change=*/true);
    case pb::ClientMessage::kAlignMap:
      return task.Relay<gl::AlignMapRequest, gl::AlignMapResponse>(
          request.align_map(),
          [&core](const gl::AlignMapResponse& response,
                  pb::ServerMessage* out) {
            *out->mutable_map_aligned() = response;
            core.catalogue->Refresh();
          });
    case pb::ClientMessage::kCheckMap:
      return task.Relay<gl::CheckMapRequest, gl::CheckMapResponse>(
          request.check_map(),
          [](const gl::CheckMapResponse& response, pb::ServerMessage* out) {
            *out->mutable_map_checked() = response;
          });
    case pb::ClientMessage::kStartSession:
      return Handle(task, request.start_session());
    case pb::ClientMessage::kControlSource:
      return Handle(task, request.control_source());
    case pb::ClientMessage::kStartRecording:
      return Handle(task, request.start_recording());
    case pb::ClientMessage::kStopRecording:
      return Handle(task, request.stop_recording());
    case pb::ClientMessage::kDeleteRecording:
      return Handle(task, request.delete_recording());
    case pb::ClientMessage::kImportMap:
      return MakeMap(task, request.import_map(), &MapJobs::Import);
    case pb::ClientMessage::kBuildMap:
      return MakeMap(task, request.build_map(), &MapJobs::Build);
    case pb::ClientMessage::kCancel:
      return task.Done(
          viewer->Cancel(request.cancel().request_id())
              ? absl::OkStatus()
              : absl::NotFoundError("request_id: nothing of it is under way"));
    default:
      return task.Done(
          absl::UnimplementedError("request: this dashboard cannot do that"));
  }
}

}  // namespace groundlock::dashboard
