// SPDX-License-Identifier: Apache-2.0
// What a user writes on the command line or in small JSON files, as values.
// Every error is kInvalidArgument, quotes the text and says what was expected.
#ifndef GROUNDLOCK_CLIENT_CLI_PARSE_H_
#define GROUNDLOCK_CLIENT_CLI_PARSE_H_

#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "client/media/video_source.h"
#include "client/sdk/types.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/similarity3.h"

namespace groundlock::cli {

// A finite number and nothing beside it, else nullopt.
std::optional<double> ParseFinite(absl::string_view text);

// "X,Y,W,H": the top-left corner and the size, pixels; the whole image is
// 0,0,width,height. Finite, W and H > 0.
absl::StatusOr<geometry::Box2> ParseBox(std::string_view text);

// A target to follow, as --target names it.
struct TargetSpec {
  std::string id;
  geometry::Box2 box_px;
  // The frame in which the box holds; unset = the first that is sent.
  std::optional<std::uint64_t> frame;
  sdk::TargetBody body = {};
};
// "ID:X,Y,W,H" or "ID:X,Y,W,H@FRAME"; ID is 1 to 64 of [A-Za-z0-9._-].
absl::StatusOr<TargetSpec> ParseTarget(std::string_view text);

// What is known of a target's body, as --body tells it.
struct BodySpec {
  std::string id;  // of the target; empty = the one that --init-box marks
  sdk::TargetBody body;
};
// "[ID:]KIND", "[ID:]LxWxH" or "[ID:]KIND,LxWxH": one of `kinds`, and length,
// width and height, > 0.
absl::StatusOr<BodySpec> ParseBody(std::string_view text,
                                   const std::vector<std::string>& kinds);

// "FROM:TO", "FROM:" or ":TO"; TO itself is left out, as in 0:100 for the first
// hundred frames.
absl::StatusOr<media::FrameRange> ParseFrameRange(std::string_view text);

struct SizePx {
  int width = 0;
  int height = 0;
};
// "1280x720", both in [1, 65535].
absl::StatusOr<SizePx> ParseSize(std::string_view text);

// align.json: {"scale":s,"rotation_wxyz":[w,x,y,z],"translation":[x,y,z]} for
// p_world = s R p_source + t. The quaternion must be of unit length to 1e-3 (it
// is then normalised): anything else is a mistake, not rounding.
absl::StatusOr<geometry::Similarity3> SimilarityFromJson(std::string_view json);

// The same from files; errors name the path.
absl::StatusOr<geometry::Similarity3> ReadAlignment(
    const std::filesystem::path& path);
absl::StatusOr<geometry::CameraModel> ReadCamera(
    const std::filesystem::path& path);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_PARSE_H_
