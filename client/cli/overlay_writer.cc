// SPDX-License-Identifier: Apache-2.0
#include "client/cli/overlay_writer.h"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/opt.h>
#include <libswscale/swscale.h>
}

#include <optional>
#include <string>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/cli/atomic_file.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;

// The usual clock of video: exact for all common frame rates.
constexpr AVRational kTimeBase = {1, 90'000};

absl::Status AvError(int code, std::string_view what) {
  char text[AV_ERROR_MAX_STRING_SIZE] = {};
  av_strerror(code, text, sizeof(text));
  const std::string message = absl::StrCat(base::Abseil(what), ": ", text);
  if (code == AVERROR(ENOSPC)) return absl::ResourceExhaustedError(message);
  if (code == AVERROR(EACCES)) return absl::PermissionDeniedError(message);
  if (code == AVERROR(ENOENT)) return absl::NotFoundError(message);
  return absl::InternalError(message);
}

}  // namespace

struct OverlayWriter::Impl {
  fs::path path;
  fs::path temporary;
  cv::Size size;  // even
  AVFormatContext* format = nullptr;
  AVCodecContext* codec = nullptr;
  AVStream* stream = nullptr;
  AVFrame* frame = nullptr;
  AVPacket* packet = nullptr;
  SwsContext* scaler = nullptr;
  bool finished = false;
  std::optional<std::chrono::nanoseconds> first_time;
  std::int64_t last_pts = -1;

  ~Impl() {
    sws_freeContext(scaler);
    av_packet_free(&packet);
    av_frame_free(&frame);
    avcodec_free_context(&codec);
    if (format != nullptr) avio_closep(&format->pb);
    avformat_free_context(format);
    std::error_code ignored;
    if (!finished && !temporary.empty()) fs::remove(temporary, ignored);
  }

  absl::Status Open(double fps);
  absl::Status OpenCodec(double fps);
  // Encodes one frame (null = flush) and writes what comes out.
  absl::Status Encode(const AVFrame* input);
};

absl::Status OverlayWriter::Impl::OpenCodec(double fps) {
  const AVCodec* encoder = avcodec_find_encoder_by_name("libx264");
  if (encoder == nullptr) encoder = avcodec_find_encoder(AV_CODEC_ID_H264);
  if (encoder == nullptr) {
    return absl::UnavailableError("FFmpeg here has no H.264 encoder");
  }
  codec = avcodec_alloc_context3(encoder);
  codec->width = size.width;
  codec->height = size.height;
  codec->pix_fmt = AV_PIX_FMT_YUV420P;
  codec->time_base = kTimeBase;
  codec->framerate = av_d2q(fps, 100'000);
  codec->color_range = AVCOL_RANGE_MPEG;
  codec->colorspace = AVCOL_SPC_BT709;
  codec->color_primaries = AVCOL_PRI_BT709;
  codec->color_trc = AVCOL_TRC_BT709;
  codec->gop_size = 48;  // a browser can jump to every two seconds or so
  if ((format->oformat->flags & AVFMT_GLOBALHEADER) != 0) {
    codec->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  }
  AVDictionary* options = nullptr;
  // Thin lines stay crisp at 20; "veryfast" leaves the cores to the tracker.
  av_dict_set(&options, "crf", "20", 0);
  av_dict_set(&options, "preset", "veryfast", 0);
  const int code = avcodec_open2(codec, encoder, &options);
  av_dict_free(&options);
  if (code < 0) return AvError(code, "H.264 encoder");
  return absl::OkStatus();
}

absl::Status OverlayWriter::Impl::Open(double fps) {
  const AVOutputFormat* container =
      av_guess_format(nullptr, path.filename().c_str(), nullptr);
  if (container == nullptr ||
      avformat_query_codec(container, AV_CODEC_ID_H264, FF_COMPLIANCE_NORMAL) !=
          1) {
    return absl::InvalidArgumentError(absl::StrCat(
        path.string(), ": expected a name that ends in .mp4, .mov or .mkv"));
  }
  int code = avformat_alloc_output_context2(
      &format, container, nullptr, temporary.c_str());
  if (code < 0) return AvError(code, path.string());
  RETURN_IF_ERROR(OpenCodec(fps));
  stream = avformat_new_stream(format, nullptr);
  stream->time_base = kTimeBase;
  stream->avg_frame_rate = codec->framerate;
  code = avcodec_parameters_from_context(stream->codecpar, codec);
  if (code < 0) return AvError(code, path.string());
  code = avio_open(&format->pb, temporary.c_str(), AVIO_FLAG_WRITE);
  if (code < 0) return AvError(code, path.string());
  AVDictionary* options = nullptr;
  av_dict_set(&options, "movflags", "+faststart", 0);
  code = avformat_write_header(format, &options);
  av_dict_free(&options);
  if (code < 0) return AvError(code, path.string());

  packet = av_packet_alloc();
  frame = av_frame_alloc();
  frame->format = codec->pix_fmt;
  frame->width = size.width;
  frame->height = size.height;
  code = av_frame_get_buffer(frame, 0);
  if (code < 0) return AvError(code, path.string());
  scaler = sws_getContext(size.width,
                          size.height,
                          AV_PIX_FMT_BGR24,
                          size.width,
                          size.height,
                          AV_PIX_FMT_YUV420P,
                          SWS_BILINEAR,
                          nullptr,
                          nullptr,
                          nullptr);
  if (scaler == nullptr) return absl::InternalError("cannot convert colours");
  const int* bt709 = sws_getCoefficients(SWS_CS_ITU709);
  sws_setColorspaceDetails(scaler, bt709, 1, bt709, 0, 0, 1 << 16, 1 << 16);
  return absl::OkStatus();
}

absl::Status OverlayWriter::Impl::Encode(const AVFrame* input) {
  int code = avcodec_send_frame(codec, input);
  if (code < 0) return AvError(code, path.string());
  while (true) {
    code = avcodec_receive_packet(codec, packet);
    if (code == AVERROR(EAGAIN) || code == AVERROR_EOF) return absl::OkStatus();
    if (code < 0) return AvError(code, path.string());
    // Without it the last frame would last no time at all.
    packet->duration = av_rescale_q(1, av_inv_q(codec->framerate), kTimeBase);
    av_packet_rescale_ts(packet, kTimeBase, stream->time_base);
    packet->stream_index = stream->index;
    code = av_interleaved_write_frame(format, packet);
    if (code < 0) return AvError(code, path.string());
  }
}

OverlayWriter::OverlayWriter(std::unique_ptr<Impl> impl)
    : impl_(std::move(impl)) {}
OverlayWriter::~OverlayWriter() = default;

absl::StatusOr<std::unique_ptr<OverlayWriter>> OverlayWriter::Create(
    const fs::path& path, cv::Size size_px, double fps) {
  if (size_px.width < 2 || size_px.height < 2) {
    return absl::InvalidArgumentError(
        absl::StrCat(path.string(),
                     ": ",
                     size_px.width,
                     "x",
                     size_px.height,
                     " is too small for a video"));
  }
  auto impl = std::make_unique<Impl>();
  impl->path = path;
  impl->temporary = PartialPath(path);
  impl->size = cv::Size(size_px.width & ~1, size_px.height & ~1);
  RETURN_IF_ERROR(impl->Open(fps));
  return std::unique_ptr<OverlayWriter>(new OverlayWriter(std::move(impl)));
}

absl::Status OverlayWriter::Write(const cv::Mat& bgr,
                                  std::chrono::nanoseconds time) {
  Impl& impl = *impl_;
  if (bgr.type() != CV_8UC3 || (bgr.cols & ~1) != impl.size.width ||
      (bgr.rows & ~1) != impl.size.height) {
    return absl::InvalidArgumentError(
        absl::StrCat(impl.path.string(), ": a frame has another size"));
  }
  if (!impl.first_time) impl.first_time = time;
  constexpr AVRational kNanoseconds = {1, 1'000'000'000};
  const std::int64_t pts = std::max(
      av_rescale_q((time - *impl.first_time).count(), kNanoseconds, kTimeBase),
      impl.last_pts + 1);
  impl.last_pts = pts;
  // The encoder may still hold the previous picture.
  const int code = av_frame_make_writable(impl.frame);
  if (code < 0) return AvError(code, impl.path.string());
  const std::uint8_t* source[1] = {bgr.data};
  const int stride[1] = {static_cast<int>(bgr.step)};
  sws_scale(impl.scaler,
            source,
            stride,
            0,
            impl.size.height,
            impl.frame->data,
            impl.frame->linesize);
  impl.frame->pts = pts;
  return impl.Encode(impl.frame);
}

absl::Status OverlayWriter::Finish() {
  Impl& impl = *impl_;
  if (impl.finished) return absl::OkStatus();
  RETURN_IF_ERROR(impl.Encode(nullptr));
  int code = av_write_trailer(impl.format);
  if (code >= 0) code = avio_closep(&impl.format->pb);
  if (code < 0) return AvError(code, impl.path.string());
  std::error_code error;
  fs::rename(impl.temporary, impl.path, error);
  if (error) {
    return absl::InternalError(
        absl::StrCat(impl.path.string(), ": ", error.message()));
  }
  impl.finished = true;
  return absl::OkStatus();
}

}  // namespace groundlock::cli
