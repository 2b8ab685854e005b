// SPDX-License-Identifier: Apache-2.0
#include "server/service/watch_stream.h"

#include <algorithm>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <variant>
#include <vector>

#include "map_store/base/status.h"
#include "server/service/convert.h"
#include "server/service/guard.h"

namespace groundlock::service {
namespace {

constexpr std::size_t kMaxWaiting = 2;
// To be looked at, not measured in: half the bytes and time of OpenCV's 95.
constexpr int kWatchedJpegQuality = 85;

bool IsRaw(image::Encoding encoding) {
  return encoding == image::Encoding::kRawGray8 ||
         encoding == image::Encoding::kRawBgr8 ||
         encoding == image::Encoding::kRawRgb8;
}

// The frame as the client sent it, raw ones as JPEG of about the width at which
// it is shown. Leaves the image out if it cannot be encoded: the result still
// counts.
void FillImage(const FrameJob& frame,
               std::uint32_t image_width_px,
               pb::Image* out) {
  if (!IsRaw(frame.encoding)) {
    out->set_encoding(frame.encoding == image::Encoding::kJpeg
                          ? pb::IMAGE_ENCODING_JPEG
                      : frame.encoding == image::Encoding::kPng
                          ? pb::IMAGE_ENCODING_PNG
                          : pb::IMAGE_ENCODING_UNSPECIFIED);
    out->set_data(frame.bytes);
    return;
  }
  const int channels = frame.encoding == image::Encoding::kRawGray8 ? 1 : 3;
  if (frame.width_px <= 0 || frame.height_px <= 0 ||
      frame.bytes.size() !=
          std::size_t{1} * channels * frame.width_px * frame.height_px) {
    return;
  }
  // imencode reads only.
  cv::Mat pixels(frame.height_px,
                 frame.width_px,
                 CV_8UC(channels),
                 const_cast<char*>(frame.bytes.data()));
  const int shrink =
      image_width_px == 0
          ? 1
          : static_cast<int>(static_cast<std::uint32_t>(frame.width_px) /
                             image_width_px);
  if (shrink > 1) {
    cv::Mat smaller;
    cv::resize(pixels,
               smaller,
               {std::max(1, frame.width_px / shrink),
                std::max(1, frame.height_px / shrink)},
               0.0,
               0.0,
               cv::INTER_AREA);
    pixels = smaller;
  }
  if (frame.encoding == image::Encoding::kRawRgb8) {
    cv::Mat bgr;
    cv::cvtColor(pixels, bgr, cv::COLOR_RGB2BGR);
    pixels = bgr;
  }
  std::vector<std::uint8_t> jpeg;
  if (!cv::imencode(".jpg",
                    pixels,
                    jpeg,
                    {cv::IMWRITE_JPEG_QUALITY, kWatchedJpegQuality})) {
    return;
  }
  out->set_encoding(pb::IMAGE_ENCODING_JPEG);
  out->set_data(jpeg.data(), jpeg.size());
}

}  // namespace

WatchStream* WatchStream::Start(grpc::CallbackServerContext* context,
                                SessionManager* sessions,
                                const CallTerms& terms,
                                BackgroundExecutor* executor,
                                Metrics* metrics) {
  std::shared_ptr<WatchStream> stream(
      new WatchStream(context, sessions, terms, executor, metrics));
  stream->self_ = stream;
  terms.calls->Add(stream.get());
  stream->first_read_.Begin();
  stream->StartRead(&stream->request_);
  return stream.get();
}

WatchStream::WatchStream(grpc::CallbackServerContext* context,
                         SessionManager* sessions,
                         const CallTerms& terms,
                         BackgroundExecutor* executor,
                         Metrics* metrics)
    : context_(context),
      sessions_(sessions),
      calls_(terms.calls),
      caller_(terms.caller),
      first_read_(terms),
      write_(terms.silence),
      executor_(executor),
      metrics_(metrics) {
  ++metrics_->watchers;
}

void WatchStream::OnReadDone(bool ok) {
  absl::Status status = first_read_.End(ok, request_);
  if (absl::IsCancelled(status)) return;
  if (status.ok()) status = StartToWatch();
  caller_->Tell(request_.session_id(), status);
  if (!status.ok()) OnEnd(status);
}

absl::Status WatchStream::StartToWatch() {
  ASSIGN_OR_RETURN(
      const auto session,
      sessions_->Find(*caller_->principal, request_.session_id(), Deed::kSee));
  {
    base::MutexLock lock(&mutex_);
    if (!end_.ok()) return end_;
    session_ = session;
  }
  // Headers now, so that a client knows that it is watching; before the session
  // may write, since the first write would send them too. An error may be all
  // that a client gets, and then without headers: this one tells the two apart.
  context_->AddInitialMetadata("groundlock-watching", "1");
  StartSendInitialMetadata();
  RETURN_IF_ERROR(session->AddWatcher(shared_from_this()));
  base::MutexLock lock(&mutex_);
  // Whoever ended it meanwhile has not found it among the watchers.
  if (session_ == nullptr) session->RemoveWatcher(this);
  return absl::OkStatus();
}

void WatchStream::OnTick(std::chrono::steady_clock::time_point now) {
  // It takes nothing; OnWriteDone does the rest.
  if (write_.Expire(now)) context_->TryCancel();
  absl::Status end = first_read_.OnTick(now);
  if (end.ok()) end = caller_->principal->CheckValid();
  if (!end.ok()) OnEnd(end);
}

void WatchStream::OnAnswer(const std::shared_ptr<const Answer>& answer) {
  if (!std::holds_alternative<FrameOutcome>(answer->content)) return;
  base::MutexLock lock(&mutex_);
  if (!end_.ok()) return;
  if (waiting_.size() >= kMaxWaiting) {
    waiting_.pop_front();
    ++skipped_;
  }
  waiting_.push_back(answer);
  Pump();
}

void WatchStream::Pump() {
  if (finished_ || busy_) return;
  if (waiting_.empty() || !end_.ok()) {
    if (!end_.ok()) FinishNow(end_);
    return;
  }
  const std::shared_ptr<const Answer> answer = std::move(waiting_.front());
  waiting_.pop_front();
  busy_ = true;
  response_.Clear();
  ToProto(std::get<FrameOutcome>(answer->content),
          session_->spec(),
          session_->map(),
          response_.mutable_result());
  response_.set_skipped(std::exchange(skipped_, 0));
  if (request_.include_images() && answer->frame != nullptr) {
    image_memory_ = session_->HoldForWatcher(answer->frame->bytes.size());
  }
  if (image_memory_ != nullptr) {
    executor_->Post([self = shared_from_this(), answer] {
      self->WriteWithImage(*answer->frame);
    });
  } else {
    Write();
  }
}

void WatchStream::Write() {
  write_.Begin();
  StartWrite(&response_);
}

void WatchStream::WriteWithImage(const FrameJob& frame) {
  // A result without its image still counts.
  const absl::Status filled = Guard([&] {
    FillImage(frame, request_.image_width_px(), response_.mutable_image());
    return absl::OkStatus();
  });
  if (!filled.ok()) response_.clear_image();
  Write();
}

void WatchStream::OnWriteDone(bool ok) {
  write_.End(ReadDeadline::kAllBack);
  {
    base::MutexLock lock(&mutex_);
    busy_ = false;
    image_memory_ = nullptr;
    if (ok) {
      Pump();
      return;
    }
  }
  OnEnd(absl::CancelledError("the stream broke"));
}

void WatchStream::OnEnd(const absl::Status& reason) {
  std::shared_ptr<Session> session;
  {
    base::MutexLock lock(&mutex_);
    if (end_.ok()) end_ = reason;
    session = std::exchange(session_, nullptr);
    waiting_.clear();
    Pump();
  }
  if (session != nullptr) session->RemoveWatcher(this);
}

void WatchStream::OnCancel() { OnEnd(absl::CancelledError("cancelled")); }

void WatchStream::FinishNow(const absl::Status& status) {
  finished_ = true;
  Finish(ToGrpc(status));
}

void WatchStream::OnDone() {
  --metrics_->watchers;
  calls_->Remove(this);
  const std::shared_ptr<WatchStream> last = std::move(self_);
}

}  // namespace groundlock::service
