// SPDX-License-Identifier: Apache-2.0
// The decoder's own side: one thread that answers, and one that notices when
// nobody asks any more.
#include "map_store/decoding/decoder.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <memory>
#include <new>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "map_store/base/image_header.h"
#include "map_store/cage/cage.h"
#include "map_store/decoding/internal/decoder_process.h"
#include "map_store/decoding/internal/decoder_protocol.h"
#include "map_store/decoding/video_file.h"

extern "C" {
#include <libavutil/cpu.h>
#include <libavutil/log.h>
}

namespace groundlock::decoding {
namespace {

using internal::Answer;
using internal::Command;
using internal::kChannel;
using internal::kMediaFile;
using internal::Outcome;
using internal::Request;

// More than FFmpeg opens: one file, by the only name that there is.
constexpr std::uint64_t kOpenFiles = 16;
constexpr const char* kMediaName = "/media";

constexpr int kDone = 0;
constexpr int kBroken = 70;

// FFmpeg wants a name and opens it, maybe several times. The kernel opens
// nothing in the cage; this answers in its place.
void AnswerOpen(int /*signal*/, siginfo_t* info, void* context) {
  auto* machine = &static_cast<ucontext_t*>(context)->uc_mcontext;
#if defined(__x86_64__)
  auto& result = machine->gregs[REG_RAX];
  const auto name = static_cast<std::uintptr_t>(machine->gregs[REG_RSI]);
#elif defined(__aarch64__)
  auto& result = machine->regs[0];
  const auto name = static_cast<std::uintptr_t>(machine->regs[1]);
#else
#error "Where this architecture's calls have their arguments must be said here."
#endif
  if (info->si_syscall != SYS_openat) _exit(kBroken);
  long opened = -ENOENT;
  if (std::strcmp(reinterpret_cast<const char*>(name), kMediaName) == 0) {
    opened = dup(kMediaFile);
    if (opened < 0) opened = -EBADF;
    lseek(kMediaFile, 0, SEEK_SET);
  }
  result = static_cast<std::remove_reference_t<decltype(result)>>(opened);
}

bool ReadAll(void* to, std::size_t num_bytes) {
  char* next = static_cast<char*>(to);
  while (num_bytes > 0) {
    const ssize_t count = read(kChannel, next, num_bytes);
    if (count == 0 || (count < 0 && errno != EINTR)) return false;
    if (count < 0) continue;
    next += count;
    num_bytes -= static_cast<std::size_t>(count);
  }
  return true;
}

void WriteAll(const void* from, std::size_t num_bytes) {
  const char* next = static_cast<const char*>(from);
  while (num_bytes > 0) {
    const ssize_t count = write(kChannel, next, num_bytes);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) _exit(kBroken);
    next += count;
    num_bytes -= static_cast<std::size_t>(count);
  }
}

void Reply(Outcome outcome, std::string_view message) {
  Answer answer;
  answer.outcome = outcome;
  answer.message_bytes = static_cast<std::uint32_t>(
      std::min<std::size_t>(message.size(), internal::kMaxMessageBytes));
  WriteAll(&answer, sizeof(answer));
  WriteAll(message.data(), answer.message_bytes);
}

void Reply(const cv::Mat& pixels) {
  if (static_cast<std::uint64_t>(pixels.total()) > base::kMaxPhotoPixels) {
    Reply(Outcome::kTooLarge,
          std::to_string(pixels.cols) + "x" + std::to_string(pixels.rows) +
              " pixels are more than " + std::to_string(base::kMaxPhotoPixels));
    return;
  }
  Answer answer;
  answer.outcome = Outcome::kOk;
  answer.width_px = static_cast<std::uint32_t>(pixels.cols);
  answer.height_px = static_cast<std::uint32_t>(pixels.rows);
  answer.channels = static_cast<std::uint32_t>(pixels.channels());
  WriteAll(&answer, sizeof(answer));
  const cv::Mat whole = pixels.isContinuous() ? pixels : pixels.clone();
  WriteAll(whole.data, whole.total() * whole.elemSize());
}

void ReplyNumber(double number) {
  Answer answer;
  answer.outcome = Outcome::kOk;
  answer.number = number;
  WriteAll(&answer, sizeof(answer));
}

class Decoder {
 public:
  // False: nobody asks any more.
  bool AnswerOne() {
    Request request;
    if (!ReadAll(&request, sizeof(request))) return false;
    std::vector<std::uint8_t> bytes;
    try {
      if (request.num_bytes > internal::kMaxEncodedBytes) return false;
      bytes.resize(request.num_bytes);
      if (!ReadAll(bytes.data(), bytes.size())) return false;
      Handle(request.command, bytes);
    } catch (const std::bad_alloc&) {
      SayNoMemory();
    } catch (const cv::Exception& error) {
      if (error.code == cv::Error::StsNoMem) {
        SayNoMemory();
      } else {
        Reply(Outcome::kInvalid, error.err);
      }
    } catch (const std::exception& error) {
      Reply(Outcome::kInvalid, error.what());
    }
    return true;
  }

 private:
  // Requests are answered last of all, so nothing has been written yet.
  static void SayNoMemory() {
    Reply(Outcome::kTooLarge, "takes more memory than a decoder may have");
  }

  void Handle(Command command, const std::vector<std::uint8_t>& bytes) {
    switch (command) {
      case Command::kDecodeColour:
        Decode(bytes, cv::IMREAD_COLOR);
        return;
      case Command::kDecodeLuma:
        Decode(bytes, cv::IMREAD_GRAYSCALE);
        return;
      case Command::kOpenVideo:
        OpenVideo();
        return;
      case Command::kFilmFocal:
        FilmFocal();
        return;
      case Command::kNextLuma:
        NextLuma();
        return;
      case Command::kColour:
        Reply(frame_);
        return;
    }
    Reply(Outcome::kInvalid, "no such command");
  }

  static void Decode(const std::vector<std::uint8_t>& bytes, int how) {
    // The rotation that EXIF may ask for is for viewers.
    const cv::Mat image =
        cv::imdecode(bytes, how | cv::IMREAD_IGNORE_ORIENTATION);
    if (image.empty()) {
      Reply(Outcome::kInvalid, "cannot be read as an image");
    } else {
      Reply(image);
    }
  }

  void OpenVideo() {
    video_ = VideoFile::Open(kMediaName);
    if (video_ == nullptr) {
      Reply(Outcome::kInvalid, kUnreadableVideo);
      return;
    }
    ReplyNumber(video_->expected_frames());
  }

  void FilmFocal() {
    const auto focal_mm =
        video_ == nullptr ? std::nullopt : video_->film_focal_mm();
    ReplyNumber(focal_mm.value_or(0.0));
  }

  void NextLuma() {
    frame_ = cv::Mat();
    if (video_ != nullptr && video_->Grab()) frame_ = video_->Bgr();
    if (frame_.empty()) {
      Reply(Outcome::kEnd, "");
      return;
    }
    cv::cvtColor(frame_, luma_, cv::COLOR_BGR2GRAY);
    Reply(luma_);
  }

  std::unique_ptr<VideoFile> video_;
  cv::Mat frame_;
  cv::Mat luma_;
};

// What is looked up in files once, while there are files.
void WarmUp() {
  cv::getNumberOfCPUs();
  std::thread::hardware_concurrency();
  av_cpu_count();
  std::vector<std::uint8_t> bytes;
  cv::imencode(".png", cv::Mat::zeros(8, 8, CV_8UC3), bytes);
  cv::imdecode(bytes, cv::IMREAD_COLOR);
}

std::uint64_t Number(std::string_view text) {
  std::uint64_t number = 0;
  std::from_chars(text.data(), text.data() + text.size(), number);
  return number;
}

// Somebody who hangs does not notice that nobody waits for him.
void EndWithAsker() {
  std::thread([] {
    pollfd channel{.fd = kChannel, .events = 0, .revents = 0};
    while (poll(&channel, 1, -1) < 0 && errno == EINTR) {
    }
    _exit(kDone);
  }).detach();
}

int Serve(std::uint64_t memory_bytes, std::uint64_t cpu_s) {
  close_range(kMediaFile + 1, ~0U, 0);
  av_log_set_level(AV_LOG_QUIET);
  WarmUp();
  struct sigaction on_open {};
  on_open.sa_sigaction = AnswerOpen;
  on_open.sa_flags = SA_SIGINFO;
  sigaction(SIGSYS, &on_open, nullptr);
  const auto cage = cage::Cage::Create(cage::Kind::kDecoder,
                                       {.memory_bytes = memory_bytes,
                                        .cpu_s = cpu_s,
                                        .open_files = kOpenFiles,
                                        .file_bytes = 0});
  if (!cage.ok() || cage->Enter() != 0) return internal::kNoCage;
  EndWithAsker();
  Decoder decoder;
  while (decoder.AnswerOne()) {
  }
  return kDone;
}

}  // namespace

std::optional<int> RunDecoderIfAsked(int argc, char* const* argv) {
  if (argc != 4 || std::string_view(argv[1]) != internal::kDecoderArgument) {
    internal::AllowDecoders();
    return std::nullopt;
  }
  // Nothing of the program is to be tidied up.
  _exit(Serve(Number(argv[2]), Number(argv[3])));
}

}  // namespace groundlock::decoding
