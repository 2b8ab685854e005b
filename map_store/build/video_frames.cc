// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/video_frames.h"

#include <algorithm>
#include <array>
#include <opencv2/imgcodecs.hpp>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/status.h"
#include "map_store/decoding/video_reader.h"

namespace groundlock::build::internal {
namespace {

namespace fs = std::filesystem;

// High enough that features move by less than their own noise.
constexpr int kJpegQuality = 95;
constexpr std::uint64_t kProgressEvery = 8;
// A way that gives fewer keyframes is looked at again, more closely: seen
// around its middle or straight ahead, a place moves little in the picture
// however far the camera goes.
constexpr std::size_t kFewKeyframes = 24;
// Shares of the progress after each look.
constexpr std::array<double, 4> kLooks = {0.0, 0.4, 0.5, 0.6};

absl::StatusOr<ChosenKeyframes> Choose(
    const fs::path& video,
    const KeyframeOptions& options,
    std::size_t max_keyframes,
    const std::function<bool(double)>& progress) {
  ASSIGN_OR_RETURN(decoding::VideoReader reader,
                   decoding::VideoReader::Open(video));
  const double total = reader.expected_frames();
  KeyframeSelector selector(options);
  cv::Size size_px;
  std::uint64_t i = 0;
  for (;; ++i) {
    ASSIGN_OR_RETURN(const cv::Mat luma, reader.NextLuma());
    if (luma.empty()) break;
    if (i == 0) size_px = luma.size();
    if (luma.size() != size_px) {
      return absl::InvalidArgumentError(absl::StrCat(video.string(),
                                                     ": frame ",
                                                     i,
                                                     " is ",
                                                     luma.cols,
                                                     "x",
                                                     luma.rows,
                                                     ", those before it ",
                                                     size_px.width,
                                                     "x",
                                                     size_px.height,
                                                     ": cut the video there"));
    }
    selector.Add(luma);
    if (i % kProgressEvery == 0 &&
        !progress(std::min(1.0, static_cast<double>(i) / total))) {
      return absl::CancelledError("cancelled");
    }
  }
  if (i < 2) {
    return absl::InvalidArgumentError(absl::StrCat(
        video.string(),
        i == 0 ? ": holds no frame that can be read"
               : ": holds a single frame; a map needs a camera that moves"));
  }
  ChosenKeyframes chosen{selector.Finish(), 0};
  const std::size_t num_all = chosen.keyframes.size();
  chosen.keyframes = ThinOut(std::move(chosen.keyframes), max_keyframes);
  chosen.num_left_out = num_all - chosen.keyframes.size();
  return chosen;
}

// Nothing can be followed into a blurred frame, nor from it: tracks would end
// there that go on behind it. Where most of the way is blurred, its keyframes
// are all that there is.
void DropBlurred(std::vector<Keyframe>& keyframes) {
  const auto num_blurred = std::count_if(
      keyframes.begin(), keyframes.end(), [](const Keyframe& keyframe) {
        return keyframe.is_blurred;
      });
  if (2 * static_cast<std::size_t>(num_blurred) > keyframes.size()) return;
  std::erase_if(keyframes,
                [](const Keyframe& keyframe) { return keyframe.is_blurred; });
}

absl::StatusOr<ChosenKeyframes> ChooseEnough(
    const fs::path& video,
    KeyframeOptions options,
    std::size_t max_keyframes,
    const std::function<bool(double)>& progress) {
  ChosenKeyframes chosen;
  for (std::size_t look = 1; look < kLooks.size(); ++look) {
    const double before = kLooks.at(look - 1);
    const double share = kLooks.at(look) - before;
    ASSIGN_OR_RETURN(chosen,
                     Choose(video, options, max_keyframes, [&](double done) {
                       return progress(before + share * done);
                     }));
    const std::size_t count = chosen.keyframes.size();
    if (count >= kFewKeyframes || count == 0 || count == max_keyframes) {
      break;
    }
    options.spacing *= 0.5;
  }
  DropBlurred(chosen.keyframes);
  return chosen;
}

}  // namespace

std::string KeyframeName(const Keyframe& keyframe) {
  return absl::StrFormat("frame_%06d.jpg", keyframe.frame);
}

absl::StatusOr<ChosenKeyframes> ExtractKeyframes(
    const fs::path& video,
    const KeyframeOptions& options,
    std::size_t max_keyframes,
    const fs::path& folder,
    const std::function<bool(double)>& progress,
    FeatureTracks* tracks) {
  try {
    ASSIGN_OR_RETURN(ChosenKeyframes chosen,
                     ChooseEnough(video, options, max_keyframes, progress));
    const std::vector<Keyframe>& keyframes = chosen.keyframes;
    if (keyframes.empty()) {
      return absl::InvalidArgumentError(absl::StrCat(
          video.string(), ": no frame with anything to see in it"));
    }
    std::error_code error;
    fs::remove_all(folder, error);
    fs::create_directories(folder, error);
    if (error) {
      return absl::FailedPreconditionError(absl::StrCat(
          "cannot create ", folder.string(), ": ", error.message()));
    }
    ASSIGN_OR_RETURN(decoding::VideoReader reader,
                     decoding::VideoReader::Open(video));
    TrackFollower follower;
    std::uint64_t number = 0;
    for (std::size_t i = 0; i < keyframes.size(); ++number) {
      const bool is_wanted = number == keyframes[i].frame;
      ASSIGN_OR_RETURN(const cv::Mat luma, reader.NextLuma());
      if (luma.empty()) {
        return absl::DataLossError(absl::StrCat(
            video.string(), ": frame ", number, " cannot be read again"));
      }
      // What comes before the first one shows nothing.
      if (i == 0 && !is_wanted) continue;
      follower.AddFrame(luma, is_wanted);
      if (!is_wanted) continue;
      ASSIGN_OR_RETURN(const cv::Mat frame, reader.Colour());
      const fs::path path = folder / KeyframeName(keyframes[i]);
      if (!cv::imwrite(
              path.string(), frame, {cv::IMWRITE_JPEG_QUALITY, kJpegQuality})) {
        return absl::ResourceExhaustedError(
            absl::StrCat("cannot write ", path.string(), ": disk full?"));
      }
      ++i;
      if (!progress(0.6 + 0.4 * static_cast<double>(i) /
                              static_cast<double>(keyframes.size()))) {
        return absl::CancelledError("cancelled");
      }
    }
    *tracks = follower.Finish();
    tracks->film_focal_mm = reader.film_focal_mm().value_or(0.0);
    return chosen;
  } catch (const cv::Exception& exception) {
    return absl::InvalidArgumentError(
        absl::StrCat(video.string(), ": ", exception.err));
  }
}

}  // namespace groundlock::build::internal
