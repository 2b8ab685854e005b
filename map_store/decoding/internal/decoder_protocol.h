// SPDX-License-Identifier: Apache-2.0
// What a decoder is asked and answers, through a socket between two processes
// of one program: requests with bytes behind them, answers with a message and
// pixels behind them. Who asks believes nothing of an answer.
#ifndef GROUNDLOCK_MAP_STORE_DECODING_INTERNAL_DECODER_PROTOCOL_H_
#define GROUNDLOCK_MAP_STORE_DECODING_INTERNAL_DECODER_PROTOCOL_H_

#include <cstdint>

namespace groundlock::decoding::internal {

// The program's arguments as a decoder: this, memory in bytes, CPU in seconds.
inline constexpr const char* kDecoderArgument = "--decode-media";
inline constexpr int kChannel = 0;    // file descriptor of the socket
inline constexpr int kMediaFile = 3;  // of the video

// Its exit status where it could not be caged, and has looked at nothing.
inline constexpr int kNoCage = 71;

inline constexpr std::uint64_t kMaxEncodedBytes = std::uint64_t{1} << 30;
inline constexpr std::uint32_t kMaxMessageBytes = 1'024;

enum class Command : std::uint32_t {
  kDecodeColour = 1,  // the bytes that follow, as CV_8UC3
  kDecodeLuma,        // as CV_8UC1
  kOpenVideo,         // kMediaFile; the answer's number: frames, about
  kNextLuma,          // of the next frame; kEnd behind the last one
  kColour,            // of the same frame
  kFilmFocal,         // the answer's number: mm; 0 = the video does not tell
};

struct Request {
  Command command{};
  std::uint32_t unused = 0;
  std::uint64_t num_bytes = 0;
};

enum class Outcome : std::uint32_t { kOk, kEnd, kInvalid, kTooLarge };

struct Answer {
  Outcome outcome{};
  std::uint32_t width_px = 0;  // 0: no pixels follow
  std::uint32_t height_px = 0;
  std::uint32_t channels = 0;
  double number = 0.0;
  std::uint32_t message_bytes = 0;
  std::uint32_t unused = 0;
};

}  // namespace groundlock::decoding::internal

#endif  // GROUNDLOCK_MAP_STORE_DECODING_INTERNAL_DECODER_PROTOCOL_H_
