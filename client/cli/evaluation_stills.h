// SPDX-License-Identifier: Apache-2.0
// The pictures of `groundlock evaluate`.
#ifndef GROUNDLOCK_CLIENT_CLI_EVALUATION_STILLS_H_
#define GROUNDLOCK_CLIENT_CLI_EVALUATION_STILLS_H_

#include <cstdint>
#include <opencv2/core.hpp>
#include <string>
#include <unordered_map>
#include <vector>

#include "client/cli/evaluate/truth_csv.h"
#include "client/cli/overlay.h"
#include "client/sdk/types.h"

namespace groundlock::cli {

// Frames to show: where the target is marked, while it is hidden, half a second
// after it is seen again (or half way, where it never hides), and at the end.
std::unordered_map<std::uint64_t, std::string> StillFrames(
    const std::vector<TruthRow>& truth,
    std::uint64_t first,
    std::uint64_t last);

// The overlay, and in its corner the true place of a small target, enlarged;
// a JPEG.
std::string DrawStill(const geometry::CameraModel& camera,
                      const sdk::FrameResult& result,
                      const GroundTrails& trails,
                      const TruthRow& truth,
                      const cv::Mat& picture);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_EVALUATION_STILLS_H_
