// SPDX-License-Identifier: Apache-2.0
// A decoder, seen by who started it.
#ifndef GROUNDLOCK_MAP_STORE_DECODING_INTERNAL_DECODER_PROCESS_H_
#define GROUNDLOCK_MAP_STORE_DECODING_INTERNAL_DECODER_PROCESS_H_

#include <sys/types.h>

#include <memory>
#include <opencv2/core.hpp>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/decoding/decoder.h"
#include "map_store/decoding/internal/decoder_protocol.h"

namespace groundlock::decoding::internal {

// From now on Start may make decoders of this program.
void AllowDecoders();

struct Decoded {
  cv::Mat pixels;  // CV_8UC1 or CV_8UC3; empty behind the last frame
  double number = 0.0;
};

// Not thread-safe; may be used by one thread after the other. Ended, at once,
// on destruction.
class DecoderProcess {
 public:
  // media_fd: given to it as kMediaFile; -1 = none. kFailedPrecondition where
  // this program's main() does not call RunDecoderIfAsked; kInternal.
  static absl::StatusOr<std::unique_ptr<DecoderProcess>> Start(
      const DecoderOptions& options, int media_fd = -1);
  ~DecoderProcess();
  DecoderProcess(const DecoderProcess&) = delete;
  DecoderProcess& operator=(const DecoderProcess&) = delete;

  // kInvalidArgument: it says why, or it crashed or hung, and is gone;
  // kResourceExhausted: more memory or pixels than it may have;
  // kFailedPrecondition: it could not be caged.
  absl::StatusOr<Decoded> Ask(Command command, std::string_view bytes = {});

  // False after it has crashed or hung, or was ended for its answer.
  bool is_alive() const { return child_ > 0; }
  pid_t pid() const { return child_; }  // 0 = gone

 private:
  DecoderProcess(const DecoderOptions& options, pid_t child, int channel)
      : options_(options), child_(child), channel_(channel) {}
  absl::Status Send(std::string_view bytes);
  absl::Status Receive(void* to, std::size_t num_bytes);
  absl::StatusOr<Decoded> TakeAnswer();
  absl::Status Wait(short events);
  // It has closed its end: says how it ended.
  absl::Status HangUp();
  // Ends it and says why.
  absl::Status Fail(std::string_view why);
  int End();  // what waitpid gave

  DecoderOptions options_;
  pid_t child_;
  int channel_;
};

}  // namespace groundlock::decoding::internal

#endif  // GROUNDLOCK_MAP_STORE_DECODING_INTERNAL_DECODER_PROCESS_H_
