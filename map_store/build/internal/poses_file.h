// SPDX-License-Identifier: Apache-2.0
// The two forms of ReadPoses' files, as text.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_POSES_FILE_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_POSES_FILE_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/build/posed.h"

namespace groundlock::build::internal {

// kInvalidArgument names the line or the entry, and the field. No poses at all
// are no error here. Poses are finite, quaternions of unit length.
absl::StatusOr<std::vector<PosedImage>> ParsePosesCsv(const std::string& text);
absl::StatusOr<std::vector<PosedImage>> ParsePosesJson(const std::string& text);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_POSES_FILE_H_
