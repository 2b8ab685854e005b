// SPDX-License-Identifier: Apache-2.0
#include "map_store/decoding/internal/decoder_process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/image_header.h"
#include "map_store/base/status.h"
#include "map_store/cage/cage.h"

namespace groundlock::decoding::internal {
namespace {

std::atomic<bool> may_start{false};

constexpr int kHangUpChecks = 2'000;
constexpr auto kHangUpInterval = std::chrono::milliseconds(1);

// Where what a decoder of strangers' bytes prints goes.
constexpr const char* kNowhere = "/dev/null";

// posix_spawn's two lists, which want to be destroyed.
class SpawnSetup {
 public:
  SpawnSetup(int channel, int media_fd) {
    posix_spawn_file_actions_init(&actions_);
    posix_spawnattr_init(&attributes_);
    // Above what they are moved to; `Start` sees to it.
    posix_spawn_file_actions_adddup2(&actions_, channel, kChannel);
    posix_spawn_file_actions_addopen(&actions_, 1, kNowhere, O_WRONLY, 0);
    posix_spawn_file_actions_adddup2(&actions_, 1, 2);
    if (media_fd >= 0) {
      posix_spawn_file_actions_adddup2(&actions_, media_fd, kMediaFile);
    } else {
      // Else something of ours could have its number.
      posix_spawn_file_actions_addopen(
          &actions_, kMediaFile, kNowhere, O_RDONLY, 0);
    }
    // Threads of ours block signals that end a program.
    sigset_t signals;
    sigemptyset(&signals);
    posix_spawnattr_setsigmask(&attributes_, &signals);
    sigaddset(&signals, SIGPIPE);
    posix_spawnattr_setsigdefault(&attributes_, &signals);
    // A group of its own: what a terminal interrupts is us.
    posix_spawnattr_setflags(
        &attributes_,
        POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP);
  }
  ~SpawnSetup() {
    posix_spawn_file_actions_destroy(&actions_);
    posix_spawnattr_destroy(&attributes_);
  }
  SpawnSetup(const SpawnSetup&) = delete;
  SpawnSetup& operator=(const SpawnSetup&) = delete;
  const posix_spawn_file_actions_t* actions() const { return &actions_; }
  const posix_spawnattr_t* attributes() const { return &attributes_; }

 private:
  posix_spawn_file_actions_t actions_{};
  posix_spawnattr_t attributes_{};
};

std::vector<char*> Pointers(std::vector<std::string>& strings) {
  std::vector<char*> pointers;
  for (std::string& string : strings) pointers.push_back(string.data());
  pointers.push_back(nullptr);
  return pointers;
}

// 0, or errno.
int Spawn(const DecoderOptions& options,
          int channel,
          int media_fd,
          pid_t* child) {
  std::vector<std::string> arguments = {"groundlock-decoder",
                                        kDecoderArgument,
                                        std::to_string(options.memory_bytes),
                                        std::to_string(options.cpu_s)};
  std::vector<std::string> environment = cage::CleanEnvironment();
  // Threads' arenas of the C library's allocator, where a program has that,
  // reserve address space, which is bounded.
  environment.emplace_back("MALLOC_ARENA_MAX=2");
  const SpawnSetup setup(channel, media_fd);
  // This very program, also after its file was replaced.
  return posix_spawn(child,
                     "/proc/self/exe",
                     setup.actions(),
                     setup.attributes(),
                     Pointers(arguments).data(),
                     Pointers(environment).data());
}

}  // namespace

void AllowDecoders() { may_start = true; }

absl::StatusOr<std::unique_ptr<DecoderProcess>> DecoderProcess::Start(
    const DecoderOptions& options, int media_fd) {
  if (!may_start) {
    return absl::FailedPreconditionError(
        "this program decodes no media: its main() must call "
        "decoding::RunDecoderIfAsked");
  }
  int ends[2];
  if (socketpair(
          AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, ends) != 0) {
    return absl::ErrnoToStatus(errno, "cannot talk to a decoder");
  }
  // Moved above the numbers that the decoder knows them by, so that neither
  // takes the other's place; the copies end with the calls.
  const int channel = fcntl(ends[1], F_DUPFD_CLOEXEC, kMediaFile + 1);
  const int media =
      media_fd < 0 ? -1 : fcntl(media_fd, F_DUPFD_CLOEXEC, kMediaFile + 1);
  close(ends[1]);
  // The decoder's end waits; ours is polled.
  if (channel >= 0) fcntl(channel, F_SETFL, 0);
  pid_t child = 0;
  int error = channel < 0 || (media_fd >= 0 && media < 0)
                  ? EMFILE
                  : Spawn(options, channel, media, &child);
  if (channel >= 0) close(channel);
  if (media >= 0) close(media);
  if (error != 0) {
    close(ends[0]);
    return absl::InternalError(
        absl::StrCat("cannot start a decoder: ", std::strerror(error)));
  }
  return std::unique_ptr<DecoderProcess>(
      new DecoderProcess(options, child, ends[0]));
}

DecoderProcess::~DecoderProcess() { End(); }

int DecoderProcess::End() {
  int status = 0;
  if (channel_ >= 0) close(channel_);
  channel_ = -1;
  if (child_ > 0) {
    kill(child_, SIGKILL);
    while (waitpid(child_, &status, 0) < 0 && errno == EINTR) {
    }
  }
  child_ = 0;
  return status;
}

absl::Status DecoderProcess::HangUp() {
  // Its files are closed a moment before it can be waited for.
  for (int i = 0; i < kHangUpChecks; ++i) {
    int status = 0;
    if (waitpid(child_, &status, WNOHANG) == child_) {
      child_ = 0;
      End();
      if (WIFEXITED(status) && WEXITSTATUS(status) == kNoCage) {
        return absl::FailedPreconditionError(
            "media are not decoded: the kernel, or what runs this program "
            "(SystemCallFilter, a container's profile), allows no seccomp "
            "filter");
      }
      return absl::InvalidArgumentError(
          absl::StrCat("its decoder ", cage::HowItEnded(status)));
    }
    std::this_thread::sleep_for(kHangUpInterval);
  }
  return Fail("has closed its connection");
}

absl::Status DecoderProcess::Fail(std::string_view why) {
  End();
  return absl::InvalidArgumentError(
      absl::StrCat("its decoder ", base::Abseil(why)));
}

absl::Status DecoderProcess::Wait(short events) {
  const auto end = std::chrono::steady_clock::now() + options_.silence;
  for (;;) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(
        end - std::chrono::steady_clock::now());
    pollfd ready{.fd = channel_, .events = events, .revents = 0};
    const int count = poll(
        &ready,
        1,
        static_cast<int>(std::clamp<std::int64_t>(left.count(), 0, 1 << 30)));
    if (count > 0) return absl::OkStatus();
    if (count == 0) {
      return Fail(
          absl::StrCat("gave no answer for ",
                       std::chrono::duration<double>(options_.silence).count(),
                       " s and was ended"));
    }
    if (errno != EINTR) return Fail(std::strerror(errno));
  }
}

absl::Status DecoderProcess::Send(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t count =
        send(channel_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (count > 0) {
      bytes.remove_prefix(static_cast<std::size_t>(count));
    } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
      RETURN_IF_ERROR(Wait(POLLOUT));
    } else if (errno != EINTR) {
      return HangUp();
    }
  }
  return absl::OkStatus();
}

absl::Status DecoderProcess::Receive(void* to, std::size_t num_bytes) {
  char* next = static_cast<char*>(to);
  while (num_bytes > 0) {
    const ssize_t count = recv(channel_, next, num_bytes, 0);
    if (count > 0) {
      next += count;
      num_bytes -= static_cast<std::size_t>(count);
    } else if (count < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) {
      RETURN_IF_ERROR(Wait(POLLIN));
    } else if (count == 0 || errno != EINTR) {
      return HangUp();
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<Decoded> DecoderProcess::Ask(Command command,
                                            std::string_view bytes) {
  if (child_ <= 0) return absl::InternalError("its decoder is gone");
  const Request request{
      .command = command, .unused = 0, .num_bytes = bytes.size()};
  RETURN_IF_ERROR(Send(std::string_view(reinterpret_cast<const char*>(&request),
                                        sizeof(request))));
  RETURN_IF_ERROR(Send(bytes));
  return TakeAnswer();
}

absl::StatusOr<Decoded> DecoderProcess::TakeAnswer() {
  Answer answer;
  RETURN_IF_ERROR(Receive(&answer, sizeof(answer)));
  const std::uint64_t pixels =
      std::uint64_t{answer.width_px} * answer.height_px;
  const bool is_sound =
      answer.message_bytes <= kMaxMessageBytes &&
      pixels <= base::kMaxPhotoPixels && answer.width_px <= 1U << 20 &&
      answer.height_px <= 1U << 20 &&
      (pixels == 0 || answer.channels == 1 || answer.channels == 3);
  if (!is_sound) return Fail("gave an answer that makes no sense");
  std::string message(answer.message_bytes, '\0');
  RETURN_IF_ERROR(Receive(message.data(), message.size()));
  for (char& c : message) {
    if (!absl::ascii_isprint(static_cast<unsigned char>(c))) c = '?';
  }
  if (answer.outcome == Outcome::kTooLarge) {
    return absl::ResourceExhaustedError(message);
  }
  if (answer.outcome != Outcome::kOk && answer.outcome != Outcome::kEnd) {
    return absl::InvalidArgumentError(message);
  }
  Decoded decoded;
  decoded.number = std::isfinite(answer.number) ? answer.number : 0.0;
  if (pixels > 0 && answer.outcome == Outcome::kOk) {
    decoded.pixels.create(static_cast<int>(answer.height_px),
                          static_cast<int>(answer.width_px),
                          CV_8UC(static_cast<int>(answer.channels)));
    RETURN_IF_ERROR(Receive(decoded.pixels.data, pixels * answer.channels));
  }
  return decoded;
}

}  // namespace groundlock::decoding::internal
