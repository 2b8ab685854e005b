// SPDX-License-Identifier: Apache-2.0
// From a video to the model that its landmarks make.
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <system_error>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/feature_tracks.h"
#include "map_store/build/internal/given_lens.h"
#include "map_store/build/internal/map_build.h"
#include "map_store/build/internal/map_filter.h"
#include "map_store/build/internal/track_motion.h"
#include "map_store/build/internal/video_frames.h"
#include "map_store/build/internal/video_landmarks.h"
#include "map_store/formats/formats.h"

namespace groundlock::build::internal {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// A try that holds this share of the keyframes is the last one.
constexpr double kHeldShare = 0.9;
// Keyframes of a further try lie closer together by this.
constexpr double kFinerSpacing = 0.5;
constexpr double kMaxTrackError_px = 3.0;
constexpr std::size_t kMinViewTracks = 10;

int ThreadsOrAll(int threads) {
  return threads > 0 ? threads
                     : static_cast<int>(
                           std::max(1U, std::thread::hardware_concurrency()));
}

std::size_t CountHeld(const VideoMotion& motion) {
  return static_cast<std::size_t>(
      std::count_if(motion.camera_from_world.begin(),
                    motion.camera_from_world.end(),
                    [](const auto& pose) { return pose.has_value(); }));
}

}  // namespace

absl::Status MapBuild::ExtractFrames(double finer, const std::string& suffix) {
  images_ = folder_ / absl::StrCat("images", suffix);
  tracks_file_ = folder_ / absl::StrCat("tracks", suffix, ".bin");
  frames_file_ = folder_ / absl::StrCat("frames", suffix, ".json");
  KeyframeOptions keyframes = options_.keyframes;
  keyframes.spacing *= finer;
  return Stage(
      suffix.empty() ? "frames" : "frames_finer",
      absl::StrCat(keyframes.spacing,
                   " ",
                   keyframes.min_survivors,
                   " ",
                   keyframes.blurred_below,
                   " ",
                   options_.max_images),
      [&]() -> absl::Status {
        FeatureTracks tracks;
        ASSIGN_OR_RETURN(
            const ChosenKeyframes chosen,
            ExtractKeyframes(
                options_.video,
                keyframes,
                options_.max_images,
                images_,
                [this](double fraction) { return Progress(fraction); },
                &tracks));
        if (chosen.keyframes.size() < kMinImages) {
          return absl::FailedPreconditionError(absl::StrCat(
              options_.video.string(),
              ": only ",
              chosen.keyframes.size(),
              " frames differ from each other; the camera has to move "
              "through the place (or lower --spacing)"));
        }
        if (options_.camera &&
            (options_.camera->width_px() != tracks.width_px ||
             options_.camera->height_px() != tracks.height_px)) {
          return absl::InvalidArgumentError(
              absl::StrCat(options_.video.string(),
                           ": frames are ",
                           tracks.width_px,
                           "x",
                           tracks.height_px,
                           ", but the camera's images are ",
                           options_.camera->width_px(),
                           "x",
                           options_.camera->height_px()));
        }
        RETURN_IF_ERROR(WriteTracks(tracks, tracks_file_));
        json blurred = json::array();
        for (const Keyframe& keyframe : chosen.keyframes) {
          if (keyframe.is_blurred) blurred.push_back(KeyframeName(keyframe));
        }
        return base::WriteFileAtomically(
            frames_file_,
            json{{"blurred", blurred}, {"left_out", chosen.num_left_out}}
                .dump());
      });
}

absl::Status MapBuild::FindMotion(const std::string& suffix) {
  motion_file_ = folder_ / absl::StrCat("motion", suffix, ".json");
  return Stage(
      suffix.empty() ? "mapping" : "mapping_finer",
      options_.camera ? "4, lens judged" : "4",
      [&]() -> absl::Status {
        ASSIGN_OR_RETURN(const FeatureTracks tracks, ReadTracks(tracks_file_));
        MotionOptions motion_options;
        motion_options.camera = options_.camera;
        motion_options.threads = ThreadsOrAll(options_.threads);
        // A given lens is judged in the second half.
        const double share = options_.camera ? 0.5 : 1.0;
        motion_options.progress = [this, share](double fraction,
                                                const std::string& note) {
          return Progress(share * fraction, note);
        };
        const auto found = ReconstructMotion(tracks, motion_options);
        VideoMotion motion;
        if (found.ok()) {
          motion = {found->camera,
                    found->focal_sigma_px,
                    found->scene.camera_from_world,
                    found->notes,
                    /*lens_doubt=*/""};
        } else if (absl::IsFailedPrecondition(found.status())) {
          // A try that found nothing; the next one may.
          motion.camera_from_world.resize(tracks.num_images);
          motion.notes = {std::string(found.status().message())};
        } else {
          return found.status();
        }
        if (options_.camera) {
          motion_options.progress = [this, share](double fraction,
                                                  const std::string& /*note*/) {
            return Progress(share + (1.0 - share) * fraction,
                            "judging the given lens");
          };
          ASSIGN_OR_RETURN(const auto other,
                           FindOtherLens(tracks,
                                         found.ok() ? &found->scene : nullptr,
                                         motion_options));
          if (other) motion.lens_doubt = other->ToText();
        }
        return WriteMotion(motion, motion_file_);
      });
}

absl::Status MapBuild::MapVideo() {
  struct Try {
    fs::path images;
    fs::path tracks;
    fs::path frames;
    fs::path motion;
    std::string key;
    double share = -1.0;
  };
  Try best;
  std::vector<std::string> given_up;
  const std::string inputs = key_;
  double finer = 1.0;
  for (const char* suffix : {"", "_finer"}) {
    key_ = inputs;
    RETURN_IF_ERROR(ExtractFrames(finer, suffix));
    RETURN_IF_ERROR(FindMotion(suffix));
    ASSIGN_OR_RETURN(const VideoMotion motion, ReadMotion(motion_file_));
    const double share = static_cast<double>(CountHeld(motion)) /
                         static_cast<double>(std::max<std::size_t>(
                             1, motion.camera_from_world.size()));
    if (CountHeld(motion) < kMinImages) {
      given_up.insert(given_up.end(), motion.notes.begin(), motion.notes.end());
    }
    if (share > best.share) {
      best = {images_, tracks_file_, frames_file_, motion_file_, key_, share};
    }
    if (best.share >= kHeldShare) break;
    finer *= kFinerSpacing;
  }
  images_ = best.images;
  tracks_file_ = best.tracks;
  frames_file_ = best.frames;
  motion_file_ = best.motion;
  key_ = best.key;
  ASSIGN_OR_RETURN(const VideoMotion motion, ReadMotion(motion_file_));
  if (CountHeld(motion) >= kMinImages) {
    if (!motion.lens_doubt.empty()) notes_.push_back(motion.lens_doubt);
    notes_.insert(notes_.end(), motion.notes.begin(), motion.notes.end());
    for (const std::string& why : given_up) {
      notes_.push_back(absl::StrCat(
          "a try was given up (",
          why,
          "); the map is made from keyframes of another spacing instead"));
    }
    return absl::OkStatus();
  }
  if (!motion.lens_doubt.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat(options_.video.string(), ": no map: ", motion.lens_doubt));
  }
  return absl::FailedPreconditionError(absl::StrCat(
      options_.video.string(),
      ": no map: nothing in it shows depth. The camera turned on the spot or "
      "hardly moved, or what fills the picture moves by itself (water, "
      "leaves). Film while moving past things that stand still; without a map, "
      "track --no-map follows targets in the picture"));
}

absl::Status MapBuild::PlaceVideoLandmarks() {
  return Stage(
      "landmarks",
      absl::StrCat("5 ", options_.min_views),
      [&]() -> absl::Status {
        ASSIGN_OR_RETURN(const FeatureTracks tracks, ReadTracks(tracks_file_));
        ASSIGN_OR_RETURN(VideoMotion motion, ReadMotion(motion_file_));
        ASSIGN_OR_RETURN(const std::vector<ImageFeatures> features,
                         ReadImageFeatures());
        LandmarkOptions landmarks;
        landmarks.lens_is_known = options_.camera.has_value();
        landmarks.min_views = options_.min_views;
        landmarks.threads = ThreadsOrAll(options_.threads);
        landmarks.progress = [this](double fraction) {
          return Progress(fraction);
        };
        ASSIGN_OR_RETURN(map::MapData data,
                         PlaceLandmarks(tracks, features, landmarks, &motion));
        FilterMap(options_.min_views, kMaxTrackError_px, &data);
        DropEmptyViews(kMinViewTracks, &data);
        if (data.views.size() < kMinImages) {
          return absl::FailedPreconditionError(absl::StrCat(
              options_.video.string(),
              ": no map: only ",
              data.views.size(),
              " frames have features that others show again. Film where there "
              "is texture that stands still"));
        }
        RETURN_IF_ERROR(WriteMotion(motion, folder_ / "lens.json"));
        std::error_code error;
        fs::remove_all(folder_ / "map", error);
        RETURN_IF_ERROR(formats::Export(
            data, formats::ExportFormat::kColmapBinary, folder_ / "map"));
        return KeepUpReadings(data);
      });
}

absl::Status MapBuild::DescribeVideo() {
  ASSIGN_OR_RETURN(const VideoMotion motion, ReadMotion(folder_ / "lens.json"));
  report_.focal_sigma_px = motion.focal_sigma_px;
  return absl::OkStatus();
}

}  // namespace groundlock::build::internal
