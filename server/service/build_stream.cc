// SPDX-License-Identifier: Apache-2.0
#include "server/service/build_stream.h"

#include <utility>
#include <vector>

#include "absl/time/time.h"
#include "map_store/base/status.h"
#include "map_store/formats/formats.h"
#include "map_store/map/alignment.h"
#include "map_store/map/map_data.h"
#include "server/service/convert.h"
#include "server/service/guard.h"
#include "server/service/tenant_store.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {
namespace {

// COLMAP gives way to frames where both want a core.
constexpr int kLowerBy = 5;
constexpr std::uint32_t kMaxFeatures = 100'000;

}  // namespace

BuildStream* BuildStream::Start(const BuildContext& build,
                                grpc::CallbackServerContext* context,
                                const CallerPtr& caller) {
  auto* stream = new BuildStream(build, context, caller);
  build.import.calls->Add(stream);
  ++build.import.metrics->builds;
  const int max_builds = build.import.limits.max_concurrent_builds;
  const int num_builds = ++*build.num_builds;
  if (max_builds == 0) {
    stream->FinishWith(absl::UnimplementedError(
        "this server builds no maps; build it locally and upload it"));
  } else if (num_builds > max_builds) {
    stream->FinishWith(absl::ResourceExhaustedError(
        absl::StrCat("the server builds ",
                     max_builds,
                     " maps at a time; try again later, or build locally")));
  } else {
    absl::Status within;
    if (const auto& account = caller->principal->account) {
      auto place = account->TakeBuild();
      within = place.status();
      if (place.ok()) stream->place_ = *std::move(place);
    }
    if (within.ok()) {
      stream->Read();
    } else {
      stream->FinishWith(within);
    }
  }
  return stream;
}

BuildStream::BuildStream(const BuildContext& build,
                         grpc::CallbackServerContext* context,
                         CallerPtr caller)
    : build_(build),
      context_(context),
      caller_(std::move(caller)),
      read_(build.import.silence, build.import.limits.upload_timeout),
      farewell_(build.import.silence) {}

void BuildStream::Read() {
  read_.Begin();
  StartRead(&request_);
}

void BuildStream::ReadNext() {
  const auto& account = caller_->principal->account;
  if (account == nullptr || account->MayUpload()) {
    Read();
  } else {
    paused_ = true;  // OnTick goes on
  }
}

void BuildStream::OnTick(std::chrono::steady_clock::time_point now) {
  // OnCancel does the rest.
  if (!caller_->principal->CheckValid().ok()) context_->TryCancel();
  const auto& account = caller_->principal->account;
  if (paused_ && (cancelled_ || read_.IsOver(now) || account->MayUpload())) {
    paused_ = false;
    Read();
  }
  // It does not take the answer.
  if (farewell_.Expire(now)) context_->TryCancel();
  if (!read_.Expire(now)) return;
  build_.import.disk->Post([this] { FinishWith(read_.Why()); });
}

void BuildStream::OnReadDone(bool ok) {
  const std::size_t size = ok ? request_.ByteSizeLong() : 0;
  if (ok) caller_->CountMessage(size);
  if (!read_.End(size)) return;
  build_.import.disk->Post([this, ok] { ok ? HandleMessage() : HandleEnd(); });
}

void BuildStream::OnWriteDone(bool ok) {
  if (!ok) cancelled_ = true;
  Step step;
  {
    base::MutexLock lock(&mutex_);
    is_writing_ = false;
    step = NextStep();
  }
  Take(step);
}

void BuildStream::OnDone() {
  build_.import.calls->Remove(this);
  --build_.import.metrics->builds;
  delete this;
}

void BuildStream::HandleMessage() {
  const absl::Status status = Guard([this] { return Store(request_); });
  if (!status.ok()) {
    FinishWith(status);
    return;
  }
  if (const auto& account = caller_->principal->account) {
    account->AddUploaded(request_.ByteSizeLong());
  }
  ReadNext();
}

absl::Status BuildStream::Store(const pb::BuildMapRequest& message) {
  RETURN_IF_ERROR(CheckAlive());
  if (upload_ == nullptr) {
    if (!message.has_header()) {
      return absl::InvalidArgumentError(
          "message: the first one must be the header");
    }
    header_ = message.header();
    RETURN_IF_ERROR(CheckHeader());
    RETURN_IF_ERROR(caller_->maps->CheckRoom());
    ASSIGN_OR_RETURN(
        upload_,
        MapUpload::Create(*build_.import.scratch, build_.import.limits));
    return absl::OkStatus();
  }
  return upload_->Add(message);
}

absl::Status BuildStream::CheckHeader() const {
  RETURN_IF_ERROR(
      base::Annotate(storage::ValidateMapName(header_.name()), "header.name"));
  if (!header_.video_path().empty()) {
    RETURN_IF_ERROR(
        ValidateRelativePath(header_.video_path(), "header.video_path"));
  }
  if (header_.has_camera()) {
    RETURN_IF_ERROR(FromProto(header_.camera(), "header.camera").status());
  }
  if (header_.max_features() > kMaxFeatures) {
    return absl::InvalidArgumentError(absl::StrCat("header.max_features: ",
                                                   header_.max_features(),
                                                   " is above ",
                                                   kMaxFeatures));
  }
  return absl::OkStatus();
}

void BuildStream::HandleEnd() {
  absl::Status status = CheckAlive();
  if (status.ok() && upload_ == nullptr) {
    status = absl::InvalidArgumentError("message: the header is missing");
  }
  if (status.ok()) {
    status = Guard([this] { return upload_->Finish(header_.num_files()); });
  }
  if (!status.ok()) {
    FinishWith(status);
    return;
  }
  build_.builds->Post([this] {
    pb::BuildMapResponse result;
    const absl::Status built = Guard([&] { return Build(&result); });
    FinishWith(built, &result);
  });
}

absl::Status BuildStream::CheckAlive() const {
  if (cancelled_ || context_->IsCancelled()) {
    return absl::CancelledError("the client has gone");
  }
  if (std::chrono::steady_clock::now() > build_end_) {
    return absl::DeadlineExceededError(absl::StrCat(
        "the build took more than ",
        absl::FormatDuration(
            absl::FromChrono(build_.import.limits.build_timeout))));
  }
  return absl::OkStatus();
}

absl::StatusOr<build::BuildOptions> BuildStream::Options() const {
  build::BuildOptions options;
  if (header_.video_path().empty()) {
    ASSIGN_OR_RETURN(options.images, upload_->Resolve(".", "file_start.path"));
  } else {
    ASSIGN_OR_RETURN(
        options.video,
        upload_->Resolve(header_.video_path(), "header.video_path"));
  }
  options.work_folder = work_->path() / "work";
  if (header_.has_camera()) {
    ASSIGN_OR_RETURN(options.camera,
                     FromProto(header_.camera(), "header.camera"));
  }
  options.max_images = header_.max_images();
  if (header_.max_features() != 0) {
    options.max_features = static_cast<int>(header_.max_features());
  }
  options.seed = header_.seed();
  options.niceness = kLowerBy;
  options.colmap = build_.import.limits.colmap;
  options.memory_bytes = build_.import.limits.build_memory_bytes;
  RETURN_IF_ERROR(options.Validate());
  return options;
}

absl::Status BuildStream::Build(pb::BuildMapResponse* result) {
  const base::LogFields fields = caller_->Fields();
  build_end_ =
      std::chrono::steady_clock::now() + build_.import.limits.build_timeout;
  RETURN_IF_ERROR(CheckAlive());
  ASSIGN_OR_RETURN(work_, build_.import.scratch->Create());
  ASSIGN_OR_RETURN(const build::BuildOptions options, Options());
  const std::string log_name =
      NameOfTenant(caller_->principal->tenant, header_.name());
  spdlog::info("map {}: building begins", log_name);
  const auto built =
      build::Build(options, [this](const build::BuildProgress& progress) {
        Tell(progress);
        return CheckAlive().ok();
      });
  // Its own reason counts more than that it was told to end.
  RETURN_IF_ERROR(CheckAlive());
  RETURN_IF_ERROR(built.status());
  std::vector<std::string> warnings = built->report.warnings;
  ASSIGN_OR_RETURN(map::MapData data,
                   formats::Import(built->model, {}, &warnings));
  RETURN_IF_ERROR(map::PutIntoWorld(
      std::nullopt, std::nullopt, header_.seed(), data, warnings));
  RETURN_IF_ERROR(CheckAlive());
  ASSIGN_OR_RETURN(const storage::MapVersion version,
                   caller_->maps->Publish(
                       header_.name(), data, [this] { return CheckAlive(); }));
  ToProto(version, result->mutable_result()->mutable_map());
  for (const std::string& warning : warnings) {
    result->mutable_result()->add_warnings(Anonymized(warning));
  }
  result->mutable_result()->set_report_json(
      Anonymized(build::ReportJson(built->report)));
  spdlog::info("map {} version {}: built, {} of {} images, {} landmarks",
               log_name,
               version.version,
               built->report.num_registered,
               built->report.images.size(),
               version.info.num_landmarks);
  return absl::OkStatus();
}

std::string BuildStream::Anonymized(std::string_view message) const {
  std::string shown(message);
  if (upload_ != nullptr) shown = upload_->Anonymized(shown);
  if (work_ != nullptr) shown = WithoutFolder(shown, work_->path());
  return shown;
}

void BuildStream::FinishWith(const absl::Status& status,
                             pb::BuildMapResponse* result) {
  const base::LogFields fields = caller_->Fields();
  absl::Status shown = status;
  if (status.ok()) {
    ++build_.import.metrics->maps_built;
  } else {
    ++build_.import.metrics->map_builds_failed;
    shown =
        absl::Status(status.code(), Anonymized(base::Std(status.message())));
    spdlog::warn("build of map '{}' failed: {}",
                 NameOfTenant(caller_->principal->tenant, header_.name()),
                 shown.ToString());
  }
  caller_->Tell(header_.name(), shown);
  // Before the client hears of the end: its files are gone then, and its next
  // build finds room.
  work_ = nullptr;
  upload_ = nullptr;
  place_ = nullptr;
  --*build_.num_builds;
  farewell_.Begin();
  Step step;
  {
    base::MutexLock lock(&mutex_);
    if (status.ok()) result_ = std::move(*result);
    progress_.reset();
    end_ = std::move(shown);
    step = NextStep();
  }
  // Unless there is a step to take, `this` may be gone: OnWriteDone ended it.
  Take(step);
}

void BuildStream::Tell(const build::BuildProgress& progress) {
  pb::BuildMapResponse message;
  message.mutable_progress()->set_stage(std::string(progress.stage));
  message.mutable_progress()->set_fraction(progress.fraction);
  message.mutable_progress()->set_note(progress.note);
  Step step;
  {
    base::MutexLock lock(&mutex_);
    progress_ = std::move(message);
    step = NextStep();
  }
  Take(step);
}

BuildStream::Step BuildStream::NextStep() {
  Step step;
  if (is_writing_) return step;
  std::optional<pb::BuildMapResponse>& next = result_ ? result_ : progress_;
  if (next) {
    written_ = std::move(*next);
    next.reset();
    step.writes = true;
  } else {
    step.end = std::exchange(end_, std::nullopt);
  }
  // After the end for good: nothing may follow it.
  is_writing_ = step.writes || step.end.has_value();
  return step;
}

void BuildStream::Take(const Step& step) {
  if (step.writes) {
    StartWrite(&written_);
  } else if (step.end) {
    Finish(ToGrpc(*step.end));
  }
}

}  // namespace groundlock::service
