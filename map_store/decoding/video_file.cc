// SPDX-License-Identifier: Apache-2.0
#include "map_store/decoding/video_file.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <thread>
#include <utility>

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/display.h>
#include <libavutil/imgutils.h>
#include <libswscale/swscale.h>
}

namespace groundlock::decoding {
namespace {

// Packets in a row of which nothing can be decoded: behind so many, nothing
// comes.
constexpr int kMaxBroken = 64;
constexpr int kMaxThreads = 16;
// Of the film: a fisheye and a telescope.
constexpr double kShortest_mm = 4.0;
constexpr double kLongest_mm = 1'500.0;
// DJI's older drones write tenths of millimetres, without a point.
constexpr std::string_view kDjiFocal = "focal_len";
constexpr double kTenths = 10.0;
// Packets that are looked at for a subtitle when a video is opened.
constexpr int kSubtitlePackets = 200;

struct FreeFormat {
  void operator()(AVFormatContext* p) const { avformat_close_input(&p); }
};
struct FreeCodec {
  void operator()(AVCodecContext* p) const { avcodec_free_context(&p); }
};
struct FreePacket {
  void operator()(AVPacket* p) const { av_packet_free(&p); }
};
struct FreeFrame {
  void operator()(AVFrame* p) const { av_frame_free(&p); }
};
struct FreeScaler {
  void operator()(SwsContext* p) const { sws_freeContext(p); }
};

// Clockwise, in quarters of a turn.
int QuarterTurns(const AVStream& stream) {
  const std::uint8_t* matrix =
      av_stream_get_side_data(&stream, AV_PKT_DATA_DISPLAYMATRIX, nullptr);
  if (matrix == nullptr) return 0;
  const double angle_deg =
      av_display_rotation_get(reinterpret_cast<const std::int32_t*>(matrix));
  if (!std::isfinite(angle_deg)) return 0;
  return ((static_cast<int>(std::lround(-angle_deg / 90.0)) % 4) + 4) % 4;
}

std::optional<double> FilmFocalOf(const AVDictionary* dictionary) {
  const AVDictionaryEntry* entry = nullptr;
  while ((entry = av_dict_get(dictionary, "", entry, AV_DICT_IGNORE_SUFFIX)) !=
         nullptr) {
    if (!std::string_view(entry->key)
             .ends_with("camera.focal_length.35mm_equivalent")) {
      continue;
    }
    if (const auto focal_mm = FilmFocalFromText(entry->value)) return focal_mm;
  }
  return std::nullopt;
}

}  // namespace

struct VideoFile::Parts {
  std::unique_ptr<AVFormatContext, FreeFormat> format;
  std::unique_ptr<AVCodecContext, FreeCodec> codec;
  std::unique_ptr<AVPacket, FreePacket> packet{av_packet_alloc()};
  std::unique_ptr<AVFrame, FreeFrame> frame{av_frame_alloc()};
  std::unique_ptr<SwsContext, FreeScaler> scaler;
  int stream = -1;
  int quarter_turns = 0;
  bool is_drained = false;
  std::optional<double> film_focal_mm;
  cv::Mat bgr;
  cv::Mat upright;

  AVStream& video() const { return *format->streams[stream]; }

  bool Open(const std::string& path);
  bool OpenFormat(const std::string& path);
  bool HasSubtitles() const;
  std::optional<double> FilmFocalInSubtitles();
};

bool VideoFile::Parts::OpenFormat(const std::string& path) {
  format.reset();
  AVFormatContext* opened = nullptr;
  if (avformat_open_input(&opened, path.c_str(), nullptr, nullptr) != 0) {
    return false;
  }
  format.reset(opened);
  if (avformat_find_stream_info(opened, nullptr) < 0) return false;
  stream = -1;
  for (unsigned i = 0; i < opened->nb_streams && stream < 0; ++i) {
    const AVStream& candidate = *opened->streams[i];
    if (candidate.codecpar->codec_type == AVMEDIA_TYPE_VIDEO &&
        (candidate.disposition & AV_DISPOSITION_ATTACHED_PIC) == 0) {
      stream = static_cast<int>(i);
    }
  }
  return stream >= 0;
}

bool VideoFile::Parts::Open(const std::string& path) {
  if (packet == nullptr || frame == nullptr || !OpenFormat(path)) return false;
  film_focal_mm = FilmFocalOf(video().metadata);
  if (!film_focal_mm) film_focal_mm = FilmFocalOf(format->metadata);
  if (!film_focal_mm && HasSubtitles()) {
    film_focal_mm = FilmFocalInSubtitles();
    // From the beginning again; not every container can be sought in.
    if (!OpenFormat(path)) return false;
  }
  const AVCodec* decoder = avcodec_find_decoder(video().codecpar->codec_id);
  if (decoder == nullptr) return false;
  codec.reset(avcodec_alloc_context3(decoder));
  if (codec == nullptr ||
      avcodec_parameters_to_context(codec.get(), video().codecpar) < 0) {
    return false;
  }
  codec->pkt_timebase = video().time_base;
  codec->thread_count = std::clamp(
      static_cast<int>(std::thread::hardware_concurrency()), 1, kMaxThreads);
  if (avcodec_open2(codec.get(), decoder, nullptr) < 0) return false;
  quarter_turns = QuarterTurns(video());
  return true;
}

bool VideoFile::Parts::HasSubtitles() const {
  for (unsigned i = 0; i < format->nb_streams; ++i) {
    if (format->streams[i]->codecpar->codec_type == AVMEDIA_TYPE_SUBTITLE) {
      return true;
    }
  }
  return false;
}

std::optional<double> VideoFile::Parts::FilmFocalInSubtitles() {
  std::optional<double> focal_mm;
  for (int i = 0; i < kSubtitlePackets && !focal_mm; ++i) {
    if (av_read_frame(format.get(), packet.get()) < 0) break;
    const AVStream& from = *format->streams[packet->stream_index];
    const std::string_view text(reinterpret_cast<const char*>(packet->data),
                                static_cast<std::size_t>(packet->size));
    if (from.codecpar->codec_type == AVMEDIA_TYPE_SUBTITLE &&
        text.find(kDjiFocal) != std::string_view::npos) {
      focal_mm = FilmFocalFromText(text);
    }
    av_packet_unref(packet.get());
  }
  return focal_mm;
}

VideoFile::VideoFile(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
VideoFile::~VideoFile() = default;

std::unique_ptr<VideoFile> VideoFile::Open(const std::string& path) {
  auto parts = std::make_unique<Parts>();
  if (!parts->Open(path)) return nullptr;
  return std::unique_ptr<VideoFile>(new VideoFile(std::move(parts)));
}

double VideoFile::fps() const {
  const AVRational rate =
      av_guess_frame_rate(parts_->format.get(), &parts_->video(), nullptr);
  return rate.num > 0 && rate.den > 0 ? av_q2d(rate) : 0.0;
}

double VideoFile::expected_frames() const {
  const AVStream& video = parts_->video();
  if (video.nb_frames > 0) return static_cast<double>(video.nb_frames);
  double duration_s = 0.0;
  if (parts_->format->duration != AV_NOPTS_VALUE) {
    duration_s = static_cast<double>(parts_->format->duration) / AV_TIME_BASE;
  } else if (video.duration != AV_NOPTS_VALUE) {
    duration_s = static_cast<double>(video.duration) * av_q2d(video.time_base);
  }
  return std::max(0.0, std::floor(duration_s * fps() + 0.5));
}

std::optional<double> VideoFile::film_focal_mm() const {
  return parts_->film_focal_mm;
}

bool VideoFile::Grab() {
  AVCodecContext* codec = parts_->codec.get();
  AVPacket* packet = parts_->packet.get();
  int broken = 0;
  while (true) {
    const int got = avcodec_receive_frame(codec, parts_->frame.get());
    if (got == 0) return true;
    if (got != AVERROR(EAGAIN) && (parts_->is_drained || ++broken > kMaxBroken))
      return false;
    if (parts_->is_drained) return false;
    if (av_read_frame(parts_->format.get(), packet) < 0) {
      // What the decoder still holds.
      parts_->is_drained = true;
      avcodec_send_packet(codec, nullptr);
      continue;
    }
    if (packet->stream_index == parts_->stream &&
        avcodec_send_packet(codec, packet) < 0 && ++broken > kMaxBroken) {
      av_packet_unref(packet);
      return false;
    }
    av_packet_unref(packet);
  }
}

std::optional<double> VideoFile::time_s() const {
  const std::int64_t at = parts_->frame->best_effort_timestamp;
  if (at == AV_NOPTS_VALUE) return std::nullopt;
  const AVStream& video = parts_->video();
  const std::int64_t start =
      video.start_time == AV_NOPTS_VALUE ? 0 : video.start_time;
  return static_cast<double>(at - start) * av_q2d(video.time_base);
}

cv::Mat VideoFile::Bgr() {
  const AVFrame& frame = *parts_->frame;
  if (frame.width <= 0 || frame.height <= 0 || frame.data[0] == nullptr) {
    return {};
  }
  const auto format = static_cast<AVPixelFormat>(frame.format);
  // Made anew where a frame differs from the one before.
  parts_->scaler.reset(sws_getCachedContext(parts_->scaler.release(),
                                            frame.width,
                                            frame.height,
                                            format,
                                            frame.width,
                                            frame.height,
                                            AV_PIX_FMT_BGR24,
                                            SWS_BICUBIC,
                                            nullptr,
                                            nullptr,
                                            nullptr));
  if (parts_->scaler == nullptr) return {};
  // Its rows are padded, as the conversion's vectors want them.
  const int stride = static_cast<int>((3 * frame.width + 63) / 64 * 64);
  cv::Mat padded(frame.height + 1, stride, CV_8UC1);
  std::uint8_t* rows[4] = {padded.data, nullptr, nullptr, nullptr};
  const int strides[4] = {stride, 0, 0, 0};
  if (sws_scale(parts_->scaler.get(),
                frame.data,
                frame.linesize,
                0,
                frame.height,
                rows,
                strides) <= 0) {
    return {};
  }
  cv::Mat(frame.height,
          frame.width,
          CV_8UC3,
          padded.data,
          static_cast<std::size_t>(stride))
      .copyTo(parts_->bgr);
  switch (parts_->quarter_turns) {
    case 1:
      cv::rotate(parts_->bgr, parts_->upright, cv::ROTATE_90_CLOCKWISE);
      return parts_->upright;
    case 2:
      cv::rotate(parts_->bgr, parts_->upright, cv::ROTATE_180);
      return parts_->upright;
    case 3:
      cv::rotate(parts_->bgr, parts_->upright, cv::ROTATE_90_COUNTERCLOCKWISE);
      return parts_->upright;
    default:
      return parts_->bgr;
  }
}

std::optional<double> FilmFocalFromText(std::string_view text) {
  const std::size_t name = text.find(kDjiFocal);
  const bool is_dji = name != std::string_view::npos;
  if (is_dji) {
    text.remove_prefix(name);
    text.remove_prefix(std::min(text.size(), text.find_first_of(":=")));
    if (!text.empty()) text.remove_prefix(1);
  }
  text.remove_prefix(std::min(text.size(), text.find_first_not_of(' ')));
  double focal_mm = 0.0;
  const auto [end, error] =
      std::from_chars(text.data(), text.data() + text.size(), focal_mm);
  if (error != std::errc{}) return std::nullopt;
  const auto length = static_cast<std::size_t>(end - text.data());
  if (is_dji && text.substr(0, length).find('.') == std::string_view::npos) {
    focal_mm /= kTenths;
  }
  if (!(focal_mm >= kShortest_mm && focal_mm <= kLongest_mm)) {
    return std::nullopt;
  }
  return focal_mm;
}

}  // namespace groundlock::decoding
