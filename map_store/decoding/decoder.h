// SPDX-License-Identifier: Apache-2.0
// Strangers' images and videos are decoded in processes of their own: this same
// program, started once more and caged before it sees a byte of them.
#ifndef GROUNDLOCK_MAP_STORE_DECODING_DECODER_H_
#define GROUNDLOCK_MAP_STORE_DECODING_DECODER_H_

#include <chrono>
#include <cstdint>
#include <optional>

namespace groundlock::decoding {

struct DecoderOptions {
  // Address space: a photo of base::kMaxPhotoPixels takes half of it.
  std::uint64_t memory_bytes = std::uint64_t{4} << 30;
  // Of one decoder's life: more than the longest video takes.
  std::uint64_t cpu_s = 12 * 3'600;
  // A decoder that is silent for so long over an image or a frame is ended.
  std::chrono::milliseconds silence = std::chrono::seconds(60);
};

// To be called first of all in main(), before there are threads, once OpenCV is
// set up. A decoder's whole life, and its exit status; or nullopt: this is not
// a decoder, and from now on it may start some.
//
// What a decoder can do: read the bytes or the one open file that it was given,
// and write pixels. It has no environment but what says where libraries are, no
// files, no sockets, no children; bounded memory and time (cage::kDecoder). It
// ends when whoever started it is gone.
std::optional<int> RunDecoderIfAsked(int argc, char* const* argv);

}  // namespace groundlock::decoding

#endif  // GROUNDLOCK_MAP_STORE_DECODING_DECODER_H_
