// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/video_file.h"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/opt.h>
#include <libswscale/swscale.h>
}

#include <array>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::simulator {
namespace {

// Fixed: the bits that x264 writes depend on how many threads it has.
constexpr int kThreads = 2;
constexpr int kMaxRateDenominator = 1'001'000;

std::string Reason(int error) {
  std::array<char, AV_ERROR_MAX_STRING_SIZE> text{};
  av_strerror(error, text.data(), text.size());
  return text.data();
}

}  // namespace

struct VideoFile::State {
  std::string path;
  AVFormatContext* format = nullptr;
  AVCodecContext* codec = nullptr;
  AVStream* stream = nullptr;
  AVFrame* frame = nullptr;
  AVPacket* packet = nullptr;
  SwsContext* scaler = nullptr;
  bool has_header = false;

  absl::Status Error(std::string_view what, int error) const {
    return absl::UnavailableError(
        absl::StrCat(path, ": ", base::Abseil(what), ": ", Reason(error)));
  }

  absl::Status Open(cv::Size size_px, double fps);
  absl::Status OpenEncoder(cv::Size size_px, double fps);
};

absl::Status VideoFile::State::OpenEncoder(cv::Size size_px, double fps) {
  const AVCodec* encoder = avcodec_find_encoder_by_name("libx264");
  if (encoder == nullptr) {
    return absl::UnimplementedError(
        absl::StrCat(path, ": this FFmpeg has no libx264 encoder"));
  }
  codec = avcodec_alloc_context3(encoder);
  frame = av_frame_alloc();
  packet = av_packet_alloc();
  stream = avformat_new_stream(format, nullptr);
  if (codec == nullptr || frame == nullptr || packet == nullptr ||
      stream == nullptr) {
    return absl::ResourceExhaustedError(path);
  }
  codec->width = size_px.width;
  codec->height = size_px.height;
  codec->framerate = av_d2q(fps, kMaxRateDenominator);
  codec->time_base = av_inv_q(codec->framerate);
  codec->pix_fmt = AV_PIX_FMT_YUV420P;
  codec->colorspace = AVCOL_SPC_BT709;
  codec->color_primaries = AVCOL_PRI_BT709;
  codec->color_trc = AVCOL_TRC_BT709;
  codec->color_range = AVCOL_RANGE_MPEG;
  if ((format->oformat->flags & AVFMT_GLOBALHEADER) != 0) {
    codec->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  }
  av_opt_set(codec->priv_data, "crf", "16", 0);
  av_opt_set(codec->priv_data, "preset", "veryfast", 0);
  av_opt_set(codec->priv_data, "x264-params", "log=0", 0);  // errors only
  codec->log_level_offset = AV_LOG_INFO - AV_LOG_ERROR;     // chatter is debug
  codec->thread_count = kThreads;
  if (const int e = avcodec_open2(codec, encoder, nullptr); e < 0) {
    return Error("cannot open the H.264 encoder", e);
  }
  avcodec_parameters_from_context(stream->codecpar, codec);
  stream->time_base = codec->time_base;
  stream->avg_frame_rate = codec->framerate;
  return absl::OkStatus();
}

absl::Status VideoFile::State::Open(cv::Size size_px, double fps) {
  if (const int e =
          avformat_alloc_output_context2(&format, nullptr, "mp4", path.c_str());
      e < 0) {
    return Error("cannot make an MP4 file", e);
  }
  RETURN_IF_ERROR(OpenEncoder(size_px, fps));
  frame->format = codec->pix_fmt;
  frame->width = size_px.width;
  frame->height = size_px.height;
  if (const int e = av_frame_get_buffer(frame, 0); e < 0) {
    return Error("cannot allocate a frame", e);
  }
  scaler = sws_getContext(size_px.width,
                          size_px.height,
                          AV_PIX_FMT_BGR24,
                          size_px.width,
                          size_px.height,
                          codec->pix_fmt,
                          SWS_BICUBIC | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INP,
                          nullptr,
                          nullptr,
                          nullptr);
  if (scaler == nullptr) {
    return absl::InternalError(absl::StrCat(path, ": no colour conversion"));
  }
  const int* bt709 = sws_getCoefficients(SWS_CS_ITU709);
  constexpr int kOne = 1 << 16;  // swscale's fixed point: contrast, saturation
  sws_setColorspaceDetails(scaler, bt709, 1, bt709, 0, 0, kOne, kOne);
  if (const int e = avio_open(&format->pb, path.c_str(), AVIO_FLAG_WRITE);
      e < 0) {
    return Error("cannot write", e);
  }
  if (const int e = avformat_write_header(format, nullptr); e < 0) {
    return Error("cannot write the header", e);
  }
  has_header = true;
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<VideoFile>> VideoFile::Create(
    const std::filesystem::path& path, cv::Size size_px, double fps) {
  auto state = std::make_unique<State>();
  state->path = path.string();
  std::unique_ptr<VideoFile> file(new VideoFile(std::move(state)));
  RETURN_IF_ERROR(file->state_->Open(size_px, fps));
  return file;
}

VideoFile::VideoFile(std::unique_ptr<State> state) : state_(std::move(state)) {}

VideoFile::~VideoFile() {
  if (state_->format != nullptr && state_->format->pb != nullptr) {
    avio_closep(&state_->format->pb);
  }
  sws_freeContext(state_->scaler);
  av_packet_free(&state_->packet);
  av_frame_free(&state_->frame);
  avcodec_free_context(&state_->codec);
  avformat_free_context(state_->format);
}

absl::Status VideoFile::Drain() {
  State& s = *state_;
  while (true) {
    const int received = avcodec_receive_packet(s.codec, s.packet);
    if (received == AVERROR(EAGAIN) || received == AVERROR_EOF) {
      return absl::OkStatus();
    }
    if (received < 0) return s.Error("cannot encode", received);
    s.packet->duration = 1;
    av_packet_rescale_ts(s.packet, s.codec->time_base, s.stream->time_base);
    s.packet->stream_index = s.stream->index;
    if (const int e = av_interleaved_write_frame(s.format, s.packet); e < 0) {
      return s.Error("cannot write", e);
    }
  }
}

absl::Status VideoFile::Write(const cv::Mat& bgr) {
  State& s = *state_;
  if (bgr.type() != CV_8UC3 || bgr.cols != s.codec->width ||
      bgr.rows != s.codec->height) {
    return absl::InvalidArgumentError(
        absl::StrCat(s.path, ": a frame of another size or type"));
  }
  if (const int e = av_frame_make_writable(s.frame); e < 0) {
    return s.Error("cannot allocate a frame", e);
  }
  const std::array<const std::uint8_t*, 1> planes = {bgr.ptr<std::uint8_t>()};
  const std::array<int, 1> strides = {static_cast<int>(bgr.step[0])};
  sws_scale(s.scaler,
            planes.data(),
            strides.data(),
            0,
            bgr.rows,
            s.frame->data,
            s.frame->linesize);
  s.frame->pts = s.codec->frame_number == 0 && s.frame->pts == AV_NOPTS_VALUE
                     ? 0
                     : s.frame->pts + 1;
  if (const int e = avcodec_send_frame(s.codec, s.frame); e < 0) {
    return s.Error("cannot encode", e);
  }
  return Drain();
}

absl::Status VideoFile::Finish() {
  State& s = *state_;
  if (const int e = avcodec_send_frame(s.codec, nullptr); e < 0) {
    return s.Error("cannot encode", e);
  }
  RETURN_IF_ERROR(Drain());
  if (const int e = av_write_trailer(s.format); e < 0) {
    return s.Error("cannot write", e);
  }
  if (const int e = avio_closep(&s.format->pb); e < 0) {
    return s.Error("cannot close", e);
  }
  return absl::OkStatus();
}

}  // namespace groundlock::simulator
