// SPDX-License-Identifier: Apache-2.0
// What may be chosen of the localizer "fast" (fast_localizer.h).
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_OPTIONS_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_OPTIONS_H_

#include <chrono>

#include "absl/status/status.h"

namespace groundlock::localization {

struct FastLocalizerOptions {
  int max_followed_landmarks = 220;
  // Below so many anchored inliers an anchor is asked for.
  int healthy_inliers = 110;
  // With fewer anchored inliers, a new key frame also takes in landmarks that
  // have come into view, by projection.
  int full_inliers = 200;
  int max_frames_per_key_frame = 30;
  // Each change of key frame adds a little drift.
  int max_key_frames_per_anchor = 2;
  std::chrono::nanoseconds anchor_period = std::chrono::seconds(1);
  // When LocalizerOptions::wait_for_anchor: an anchor is adopted so many frames
  // after the frame that asked for it.
  int anchor_delay_frames = 4;
  // Anchors are not asked for more often, however much comes into view.
  int min_frames_between_anchors = 12;
  // In hurried frames (LocalizationRequest) so many times as rarely.
  int hurried_anchor_factor = 4;
  // Of the session's own (session_landmarks.h), where the map has none. They
  // are observed every so many frames.
  int max_own_landmarks = 160;
  int frames_per_observation = 5;
  int frames_per_odometry_observation = 2;
  absl::Status Validate() const;  // names field, value and bound
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_OPTIONS_H_
