// SPDX-License-Identifier: Apache-2.0
// What HttpConnection serves: the page, recordings, trajectories.
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/dashboard/proxy/http_connection.h"
#include "client/dashboard/proxy/static_files.h"
#include "client/dashboard/proxy/trajectory.h"
#include "client/dashboard/recording/session_recording.h"
#include "map_store/base/status.h"

namespace groundlock::dashboard {
namespace {

constexpr char kNotBuilt[] =
    "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\">"
    "<title>Groundlock dashboard</title><body><h1>The page was not built</h1>"
    "<p>The dashboard runs, but its page is missing. Build it with "
    "<code>cmake --build build --target groundlock_web</code> (needs Node.js), "
    "or name its folder with <code>--web DIR</code>.</p></body></html>\n";

}  // namespace

void HttpConnection::ServeStatic() {
  OnDisk([self = shared_from_this(),
          root = core_->options.web,
          path = target_.path,
          gzip =
              AcceptsGzip(View(parser_->get()[http::field::accept_encoding]))] {
    auto file = ReadStaticFile(root, path, gzip);
    return [self, file = std::move(file)]() mutable {
      if (absl::IsFailedPrecondition(file.status())) {
        Response response = self->MakeResponse(http::status::not_found);
        response.set(http::field::content_type, "text/html; charset=utf-8");
        response.body() = kNotBuilt;
        self->Answer(std::move(response));
        return;
      }
      if (!file.ok()) {
        self->AnswerError(file.status());
        return;
      }
      const bool known =
          View(self->parser_->get()[http::field::if_none_match]) == file->etag;
      Response response = self->MakeResponse(known ? http::status::not_modified
                                                   : http::status::ok);
      response.set(http::field::etag, file->etag);
      response.set(http::field::vary, "Accept-Encoding");
      response.set(
          http::field::cache_control,
          file->immutable ? "public, max-age=31536000, immutable" : "no-cache");
      response.set(http::field::content_type, std::string(file->mime));
      if (!known) {
        if (file->gzip) response.set(http::field::content_encoding, "gzip");
        response.body() = std::move(file->bytes);
      }
      self->Answer(std::move(response));
    };
  });
}

void HttpConnection::ServeRecording(const std::string& name) {
  constexpr std::string_view kExtension = ".mcap";
  if (core_->recordings == nullptr || !name.ends_with(kExtension)) {
    AnswerError(absl::NotFoundError("no such recording"));
    return;
  }
  OnDisk([self = shared_from_this(),
          stem = name.substr(0, name.size() - kExtension.size()),
          range_header =
              std::string(View(parser_->get()[http::field::range]))] {
    const auto path = self->core_->recordings->PathOf(stem);
    auto download = std::make_shared<Download>();
    std::error_code error;
    std::uint64_t size = 0;
    absl::Status status = path.status();
    if (status.ok()) {
      size = std::filesystem::file_size(*path, error);
      download->file.open(*path, std::ios::binary);
      if (error || !download->file) {
        status = absl::NotFoundError("no such recording");
      }
    }
    const auto range = ParseRange(range_header, size);
    if (status.ok() && range.ok()) {
      download->file.seekg(static_cast<std::streamoff>(range->begin));
      download->left = range->end - range->begin;
    }
    return [self, status, download, range, size, stem] {
      if (!status.ok() || !range.ok()) {
        self->AnswerError(status.ok() ? range.status() : status);
        return;
      }
      const auto response = std::make_shared<http::response<http::empty_body>>(
          http::response<http::empty_body>(
              self->MakeResponse(range->partial ? http::status::partial_content
                                                : http::status::ok)
                  .base()));
      response->set(http::field::content_type, "application/octet-stream");
      response->set(http::field::accept_ranges, "bytes");
      response->set(http::field::cache_control, "no-store");
      response->set(http::field::content_disposition,
                    absl::StrCat("attachment; filename=\"", stem, ".mcap\""));
      if (range->partial) {
        response->set(
            http::field::content_range,
            absl::StrCat(
                "bytes ", range->begin, "-", range->end - 1, "/", size));
      }
      response->content_length(download->left);
      download->keep_alive =
          self->parser_->get().keep_alive() && !self->body_unread_;
      response->keep_alive(download->keep_alive);
      if (self->parser_->get().method() == http::verb::head) {
        download->left = 0;
      }
      self->download_ = download;
      const auto serializer =
          std::make_shared<http::response_serializer<http::empty_body>>(
              *response);
      self->stream_.expires_after(kTimeout);
      http::async_write_header(
          self->stream_,
          *serializer,
          [self, response, serializer](error_code write_error, std::size_t) {
            if (!write_error) self->SendFilePart();
          });
    };
  });
}

void HttpConnection::SendFilePart() {
  if (download_->left == 0) {
    const bool keep_alive = download_->keep_alive;
    download_ = nullptr;
    OnAnswered(keep_alive, {});
    return;
  }
  OnDisk([self = shared_from_this(), download = download_] {
    download->block.resize(
        std::min<std::uint64_t>(download->left, kBlockBytes));
    download->file.read(download->block.data(),
                        static_cast<std::streamsize>(download->block.size()));
    const bool whole = static_cast<std::size_t>(download->file.gcount()) ==
                       download->block.size();
    return [self, download, whole] {
      if (!whole) {  // became shorter: the length is promised already
        self->stream_.close();
        return;
      }
      download->left -= download->block.size();
      self->stream_.expires_after(kTimeout);
      asio::async_write(self->stream_,
                        asio::buffer(download->block),
                        [self](error_code error, std::size_t) {
                          if (!error) self->SendFilePart();
                        });
    };
  });
}

void HttpConnection::ServeRecordedTrajectory(const std::string& name) {
  if (core_->recordings == nullptr) {
    AnswerError(absl::NotFoundError("no such recording"));
    return;
  }
  OnDisk([self = shared_from_this(), name] {
    std::vector<std::shared_ptr<const gl::FrameResult>> results;
    std::optional<gl::GeodeticPosition> origin;
    const auto path = self->core_->recordings->PathOf(name);
    absl::Status status = path.status();
    if (status.ok()) {
      const auto description = recording::DescribeRecording(*path);
      status = description.status();
      if (description.ok() && description->map.has_value() &&
          description->map->has_origin()) {
        origin = description->map->origin();
      }
    }
    if (status.ok()) {
      status = recording::ReadResults(*path, [&](const gl::FrameResult& one) {
        auto result = std::make_shared<gl::FrameResult>(one);
        result->mutable_camera()->clear_match_xy_px();
        result->mutable_camera()->clear_match_xyz_m();
        results.push_back(std::move(result));
        return true;
      });
    }
    return [self, status, results = std::move(results), origin, name] {
      if (status.ok()) {
        self->AnswerTrajectory(results, origin, name);
      } else {
        self->AnswerError(status);
      }
    };
  });
}

void HttpConnection::ServeTrajectory(const Login& login,
                                     const std::string& session_id) {
  const auto feed = core_->feeds->Find(session_id);
  if (feed == nullptr) {
    AnswerError(absl::NotFoundError(
        "the dashboard has kept no results of this session: watch it first"));
    return;
  }
  gl::GetSessionRequest request;
  request.set_session_id(session_id);
  core_->relay->Call(
      login.token,
      request,
      [self = shared_from_this(), feed, session_id](
          const absl::StatusOr<gl::GetSessionResponse>& response) {
        // Without the session its results are still of use.
        std::optional<gl::GeodeticPosition> origin;
        if (response.ok()) {
          const auto map = self->core_->catalogue->FindMap(
              response->session().map_name(),
              response->session().map_version());
          if (map.has_value() && map->has_origin()) origin = map->origin();
        }
        asio::post(
            self->stream_.get_executor(), [self, feed, origin, session_id] {
              self->AnswerTrajectory(feed->history(), origin, session_id);
            });
      });
}

void HttpConnection::AnswerTrajectory(
    const std::vector<std::shared_ptr<const gl::FrameResult>>& results,
    const std::optional<gl::GeodeticPosition>& origin,
    const std::string& name) {
  const auto format = TrajectoryFormatFromName(target_.query["format"]);
  if (!format.ok()) {
    AnswerError(format.status());
    return;
  }
  auto text = WriteTrajectory(results, *format, target_.query["of"], origin);
  if (!text.ok()) {
    AnswerError(text.status());
    return;
  }
  Response response = MakeResponse(http::status::ok);
  response.set(http::field::content_type, std::string(MimeType(*format)));
  response.set(http::field::cache_control, "no-store");
  if (ValidateName(name, "name").ok()) {
    response.set(http::field::content_disposition,
                 absl::StrCat("attachment; filename=\"",
                              name,
                              base::Abseil(Extension(*format)),
                              "\""));
  }
  response.body() = *std::move(text);
  Answer(std::move(response));
}

}  // namespace groundlock::dashboard
