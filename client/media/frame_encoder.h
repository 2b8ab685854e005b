// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_MEDIA_FRAME_ENCODER_H_
#define GROUNDLOCK_CLIENT_MEDIA_FRAME_ENCODER_H_

#include <string_view>

#include "absl/status/statusor.h"
#include "client/media/video_source.h"
#include "client/sdk/types.h"

namespace groundlock::media {

enum class EncodingChoice { kAuto, kJpeg, kPng, kRaw };

// "auto", "jpeg", "png", "raw"; kInvalidArgument lists them.
absl::StatusOr<EncodingChoice> EncodingFromName(std::string_view name);

// What kAuto means for a server at "host:port" (empty: one on this machine):
// raw pixels to this machine, where bytes cost less than time; JPEG over a
// network.
EncodingChoice ResolveEncoding(EncodingChoice choice, std::string_view server);

// The frame as the server takes it. A JPEG or PNG file goes as its own bytes
// if `keep_file_bytes`, or if it has the encoding asked for. JPEG at quality
// 75, which costs no accuracy that could be measured (docs/benchmarks.md).
// choice: not kAuto. kInvalidArgument if the frame cannot be decoded or
// encoded.
absl::StatusOr<sdk::Image> EncodeFrame(const SourceFrame& frame,
                                       EncodingChoice choice,
                                       bool keep_file_bytes);

}  // namespace groundlock::media

#endif  // GROUNDLOCK_CLIENT_MEDIA_FRAME_ENCODER_H_
