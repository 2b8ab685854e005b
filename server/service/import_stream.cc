// SPDX-License-Identifier: Apache-2.0
#include "server/service/import_stream.h"

#include <string>
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

ImportStream* ImportStream::Start(const ImportContext& import,
                                  grpc::CallbackServerContext* context,
                                  const CallerPtr& caller,
                                  pb::ImportMapResponse* response) {
  auto* stream = new ImportStream(import, context, caller, response);
  import.calls->Add(stream);
  if (++*import.num_uploads > import.limits.max_concurrent_uploads) {
    stream->FinishWith(absl::ResourceExhaustedError(
        absl::StrCat("the server takes ",
                     import.limits.max_concurrent_uploads,
                     " imports at a time; try again later")));
  } else {
    stream->Read();
  }
  return stream;
}

ImportStream::ImportStream(const ImportContext& import,
                           grpc::CallbackServerContext* context,
                           CallerPtr caller,
                           pb::ImportMapResponse* response)
    : import_(import),
      context_(context),
      caller_(std::move(caller)),
      response_(response),
      read_(import.silence, import.limits.upload_timeout),
      farewell_(import.silence) {}

void ImportStream::Read() {
  read_.Begin();
  StartRead(&request_);
}

void ImportStream::ReadNext() {
  const auto& account = caller_->principal->account;
  if (account == nullptr || account->MayUpload()) {
    Read();
  } else {
    paused_ = true;  // OnTick goes on
  }
}

void ImportStream::OnTick(std::chrono::steady_clock::time_point now) {
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
  // It removes files, which this thread must not wait for.
  import_.disk->Post([this] { FinishWith(read_.Why()); });
}

void ImportStream::OnReadDone(bool ok) {
  const std::size_t size = ok ? request_.ByteSizeLong() : 0;
  if (ok) caller_->CountMessage(size);
  if (!read_.End(size)) return;
  if (ok) {
    import_.disk->Post([this] { HandleMessage(); });
  } else {
    import_.disk->Post([this] { HandleEnd(); });
  }
}

void ImportStream::OnDone() {
  import_.calls->Remove(this);
  delete this;
}

void ImportStream::HandleMessage() {
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

absl::Status ImportStream::Store(const pb::ImportMapRequest& message) {
  RETURN_IF_ERROR(CheckAlive());
  if (upload_ == nullptr) {
    if (!message.has_header()) {
      return absl::InvalidArgumentError(
          "message: the first one must be the header");
    }
    header_ = message.header();
    RETURN_IF_ERROR(CheckHeader());
    RETURN_IF_ERROR(caller_->maps->CheckRoom());
    ASSIGN_OR_RETURN(upload_,
                     MapUpload::Create(*import_.scratch, import_.limits));
    return absl::OkStatus();
  }
  return upload_->Add(message);
}

absl::Status ImportStream::CheckHeader() const {
  RETURN_IF_ERROR(
      base::Annotate(storage::ValidateMapName(header_.name()), "header.name"));
  RETURN_IF_ERROR(FromProto(header_.format(), "header.format").status());
  if (header_.has_world_from_source()) {
    RETURN_IF_ERROR(
        FromProto(header_.world_from_source(), "header.world_from_source")
            .status());
  }
  if (header_.has_origin()) {
    if (!header_.has_world_from_source()) {
      return absl::InvalidArgumentError(
          "header.origin: needs header.world_from_source");
    }
    RETURN_IF_ERROR(FromProto(header_.origin(), "header.origin").status());
  }
  return absl::OkStatus();
}

void ImportStream::HandleEnd() {
  absl::Status status = CheckAlive();
  if (status.ok() && upload_ == nullptr) {
    status = absl::InvalidArgumentError("message: the header is missing");
  }
  if (status.ok()) {
    status = Guard([this] { return upload_->Finish(header_.num_files()); });
  }
  if (status.ok()) {
    status = import_.heavy->TryPost(
        [this] { FinishWith(Guard([this] { return Import(); })); });
    if (status.ok()) return;  // `this` may be gone by now
  }
  FinishWith(status);
}

absl::Status ImportStream::CheckAlive() const {
  if (cancelled_ || context_->IsCancelled()) {
    return absl::CancelledError("the client has gone");
  }
  if (std::chrono::steady_clock::now() > import_end_) {
    return absl::DeadlineExceededError(absl::StrCat(
        "the import took more than ",
        absl::FormatDuration(absl::FromChrono(import_.limits.import_timeout))));
  }
  return absl::OkStatus();
}

absl::Status ImportStream::Import() {
  const base::LogFields fields = caller_->Fields();
  RETURN_IF_ERROR(CheckAlive());
  ASSIGN_OR_RETURN(const auto format,
                   FromProto(header_.format(), "header.format"));
  formats::ImportOptions options;
  options.format = format;
  options.memory_bytes = import_.limits.import_memory_bytes;
  import_end_ =
      std::chrono::steady_clock::now() + import_.limits.import_timeout;
  options.go_on = [this] { return CheckAlive().ok(); };
  ASSIGN_OR_RETURN(
      const auto model,
      upload_->Resolve(
          header_.model_path().empty() ? "." : header_.model_path(),
          "header.model_path"));
  if (!header_.database_path().empty()) {
    ASSIGN_OR_RETURN(
        options.database,
        upload_->Resolve(header_.database_path(), "header.database_path"));
  }
  // Always set: importers must not look outside of what was uploaded.
  if (!header_.images_path().empty()) {
    ASSIGN_OR_RETURN(
        options.images,
        upload_->Resolve(header_.images_path(), "header.images_path"));
  } else {
    options.images =
        std::filesystem::is_directory(model) ? model : model.parent_path();
  }
  std::vector<std::string> warnings;
  auto imported = formats::Import(model, options, &warnings);
  // Its own reason counts more than that it was told to end.
  RETURN_IF_ERROR(CheckAlive());
  ASSIGN_OR_RETURN(map::MapData data, std::move(imported));
  std::optional<geometry::Similarity3> world_from_source;
  std::optional<geometry::GeodeticPosition> origin;
  if (header_.has_world_from_source()) {
    ASSIGN_OR_RETURN(
        world_from_source,
        FromProto(header_.world_from_source(), "header.world_from_source"));
  }
  if (header_.has_origin()) {
    ASSIGN_OR_RETURN(origin, FromProto(header_.origin(), "header.origin"));
  }
  RETURN_IF_ERROR(map::PutIntoWorld(
      world_from_source, origin, header_.seed(), data, warnings));
  RETURN_IF_ERROR(CheckAlive());
  ASSIGN_OR_RETURN(const storage::MapVersion version,
                   caller_->maps->Publish(
                       header_.name(), data, [this] { return CheckAlive(); }));
  ToProto(version, response_->mutable_map());
  for (const std::string& warning : warnings) {
    response_->add_warnings(upload_->Anonymized(warning));
  }
  spdlog::info("map {} version {}: {} landmarks in {} views",
               NameOfTenant(caller_->principal->tenant, version.name),
               version.version,
               version.info.num_landmarks,
               version.info.num_views);
  return absl::OkStatus();
}

void ImportStream::FinishWith(const absl::Status& status) {
  const base::LogFields fields = caller_->Fields();
  absl::Status shown = status;
  if (status.ok()) {
    ++import_.metrics->maps_imported;
  } else {
    ++import_.metrics->map_imports_failed;
    if (upload_ != nullptr) {
      shown = absl::Status(status.code(),
                           upload_->Anonymized(base::Std(status.message())));
    }
    spdlog::warn("import of map '{}' failed: {}",
                 NameOfTenant(caller_->principal->tenant, header_.name()),
                 shown.ToString());
  }
  caller_->Tell(header_.name(), shown);
  // Before the client hears of the end: its files are gone then, and its next
  // import finds room.
  upload_ = nullptr;
  --*import_.num_uploads;
  farewell_.Begin();
  Finish(ToGrpc(shown));
}

}  // namespace groundlock::service
