// SPDX-License-Identifier: Apache-2.0
// The part of an HTTP connection that takes files.
#include <algorithm>
#include <chrono>
#include <limits>
#include <nlohmann/json.hpp>
#include <utility>

#include "client/dashboard/proxy/http_connection.h"
#include "map_store/base/status.h"

namespace groundlock::dashboard {
namespace {

// Uploads come over slow lines.
constexpr std::chrono::seconds kUploadTimeout{60};

absl::Status NoUploads() {
  return absl::FailedPreconditionError(
      "this dashboard takes no uploads: start it with --uploads");
}

}  // namespace

void HttpConnection::CreateUpload(const std::string& body,
                                  const std::string& owner) {
  if (core_->uploads == nullptr) {
    AnswerError(NoUploads());
    return;
  }
  const auto request = nlohmann::json::parse(body, nullptr, false);
  const auto text = [&request](const char* field) {
    return request.is_object() && request.contains(field) &&
                   request[field].is_string()
               ? request[field].get<std::string>()
               : std::string();
  };
  const std::string kind = text("kind");
  if (kind != "video" && kind != "map") {
    AnswerError(
        absl::InvalidArgumentError("kind: expected \"video\" or \"map\""));
    return;
  }
  OnDisk([self = shared_from_this(), kind, name = text("name"), owner] {
    auto upload = self->core_->uploads->Create(
        kind == "map" ? UploadKind::kMap : UploadKind::kVideo, name, owner);
    return [self, upload = std::move(upload)] {
      if (!upload.ok()) {
        self->AnswerUpload(upload.status());
        return;
      }
      self->AnswerJson(http::status::created,
                       nlohmann::json{{"upload_id", upload->id}}.dump());
    };
  });
}

void HttpConnection::RemoveUpload(const std::string& id) {
  if (core_->uploads == nullptr) {
    AnswerError(NoUploads());
    return;
  }
  OnDisk([self = shared_from_this(), id] {
    const absl::Status removed = self->core_->uploads->Remove(id);
    return [self, removed] {
      self->core_->catalogue->Refresh();
      if (removed.ok()) {
        self->Answer(self->MakeResponse(http::status::no_content));
      } else {
        self->AnswerError(removed);
      }
    };
  });
}

void HttpConnection::StartUpload(const std::string& id) {
  if (core_->uploads == nullptr) {
    AnswerError(NoUploads());
    return;
  }
  const std::uint64_t size = parser_->content_length().value_or(0);
  OnDisk([self = shared_from_this(),
          id,
          size,
          path = std::vector<std::string>(target_.path.begin() + 3,
                                          target_.path.end())] {
    auto file = self->core_->uploads->OpenFile(id, path, size);
    return [self, file = std::move(file)]() mutable {
      if (!file.ok()) {
        self->AnswerUpload(file.status());
        return;
      }
      const auto header = self->parser_->get().base();
      self->upload_ = std::make_shared<Upload>(std::move(*self->parser_));
      self->upload_->parser.body_limit(
          std::numeric_limits<std::uint64_t>::max());  // the file has its own
      self->upload_->file = *std::move(file);
      self->parser_.emplace();
      self->parser_->get().base() = header;
      self->body_unread_ = true;
      if (header[http::field::expect] != "100-continue") {
        self->ReadUpload();
        return;
      }
      const auto go_on = std::make_shared<http::response<http::empty_body>>(
          http::status::continue_, 11);
      http::async_write(
          self->stream_, *go_on, [self, go_on](error_code error, std::size_t) {
            if (!error) self->ReadUpload();
          });
    };
  });
}

void HttpConnection::ReadUpload() {
  upload_->block.resize(kBlockBytes);
  upload_->parser.get().body().data = upload_->block.data();
  upload_->parser.get().body().size = upload_->block.size();
  stream_.expires_after(kUploadTimeout);
  http::async_read(stream_,
                   buffer_,
                   upload_->parser,
                   [self = shared_from_this()](error_code error, std::size_t) {
                     self->OnUploadData(error);
                   });
}

void HttpConnection::OnUploadData(error_code error) {
  if (error && error != http::error::need_buffer) {
    upload_ = nullptr;  // broke off: what there is of the file goes
    return;
  }
  upload_->block.resize(upload_->block.size() -
                        upload_->parser.get().body().size);
  OnDisk([self = shared_from_this(), upload = upload_] {
    absl::Status status = upload->file->Write(upload->block);
    const bool done = upload->parser.is_done();
    if (status.ok() && done) status = upload->file->Commit();
    return [self, status, done] {
      self->body_unread_ = !done;
      if (status.ok() && !done) {
        self->ReadUpload();
        return;
      }
      self->upload_ = nullptr;
      self->AnswerUpload(status);
    };
  });
}

void HttpConnection::AnswerUpload(const absl::Status& status) {
  if (status.ok()) {
    core_->catalogue->Refresh();
    AnswerJson(http::status::created, "{}");
  } else if (absl::IsUnavailable(status)) {
    AnswerError(http::status::insufficient_storage, status);
  } else {
    AnswerError(status);
  }
}

}  // namespace groundlock::dashboard
