// SPDX-License-Identifier: Apache-2.0
// Maps that the server builds from a video or photos.
#include <chrono>
#include <future>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "client/sdk/client.h"
#include "client/sdk/connection.h"
#include "client/sdk/convert.h"
#include "client/sdk/file_upload.h"
#include "map_store/base/mutex.h"
#include "map_store/base/status.h"

namespace groundlock::sdk {
namespace {

// How often `progress` is asked while the server builds.
constexpr std::chrono::milliseconds kBuildPollInterval{100};

// What the server has said so far: written by the thread that reads, looked at
// by the one that called.
class Answers {
 public:
  void Take(pb::BuildMapResponse message) {
    base::MutexLock lock(&mutex_);
    if (message.has_progress()) {
      progress_ = std::move(*message.mutable_progress());
    } else if (message.has_result()) {
      result_ = std::move(*message.mutable_result());
    }
  }
  pb::BuildMapResponse::Progress progress() const {
    base::MutexLock lock(&mutex_);
    return progress_;
  }
  pb::BuildMapResponse::Result result() const {
    base::MutexLock lock(&mutex_);
    return result_;
  }

 private:
  mutable base::Mutex mutex_;
  pb::BuildMapResponse::Progress progress_ ABSL_GUARDED_BY(mutex_);
  pb::BuildMapResponse::Result result_ ABSL_GUARDED_BY(mutex_);
};

void FillHeader(const BuildRequest& request,
                pb::BuildMapRequest::Header* header) {
  header->set_name(request.name);
  header->set_video_path(request.video_path);
  if (request.camera) ToProto(*request.camera, header->mutable_camera());
  header->set_max_images(request.max_images);
  header->set_max_features(request.max_features);
  header->set_seed(request.seed);
  header->set_num_files(request.files.size());
}

}  // namespace

absl::StatusOr<BuildReport> Client::BuildMap(const BuildRequest& request,
                                             const BuildProgress& progress) {
  ASSIGN_OR_RETURN(const std::uint64_t total, TotalBytes(request.files));
  grpc::ClientContext context;
  const auto stream = connection_->maps->BuildMap(&context);
  pb::BuildMapRequest message;
  FillHeader(request, message.mutable_header());
  absl::Status local;
  if (stream->Write(message)) {
    local = SendFiles<pb::BuildMapRequest>(
        request.files,
        total,
        [&](std::uint64_t done, std::uint64_t all) {
          return !progress || progress("uploading",
                                       all == 0 ? 1.0
                                                : static_cast<double>(done) /
                                                      static_cast<double>(all),
                                       "");
        },
        *stream);
  }
  if (!local.ok()) context.TryCancel();

  Answers answers;
  auto finished = std::async(std::launch::async, [&stream, &answers] {
    pb::BuildMapResponse response;
    while (stream->Read(&response)) answers.Take(std::move(response));
    return FromGrpc(stream->Finish());
  });
  while (finished.wait_for(kBuildPollInterval) != std::future_status::ready) {
    const pb::BuildMapResponse::Progress now = answers.progress();
    if (local.ok() && progress &&
        !progress(now.stage().empty() ? "uploading" : now.stage(),
                  now.stage().empty() ? 1.0 : now.fraction(),
                  now.note())) {
      local = absl::CancelledError("the build was cancelled");
      context.TryCancel();
    }
  }
  const absl::Status remote = finished.get();
  RETURN_IF_ERROR(local);
  RETURN_IF_ERROR(remote);
  const pb::BuildMapResponse::Result result = answers.result();
  BuildReport report{FromProto(result.map()), {}, result.report_json()};
  report.warnings.assign(result.warnings().begin(), result.warnings().end());
  return report;
}

}  // namespace groundlock::sdk
