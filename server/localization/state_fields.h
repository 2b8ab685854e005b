// SPDX-License-Identifier: Apache-2.0
// What the parts of a localizer's state consist of, each listed once for
// writing and reading (map_store/base/state_stream.h), and what must hold of it
// so that nobody is led astray by bytes that no localizer has written. For the
// localizers' own sources.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_STATE_FIELDS_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_STATE_FIELDS_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "map_store/base/state_stream.h"
#include "map_store/geometry/state_fields.h"
#include "server/localization/camera_state.h"
#include "server/localization/follow/exposure_estimate.h"
#include "server/localization/follow/frame_bridge.h"
#include "server/localization/follow/key_frame_follower.h"
#include "server/localization/follow/session_landmarks.h"
#include "server/localization/search/anchor_job.h"
#include "server/localization/search/lens_check.h"
#include "server/localization/state_message.h"
#include "server/localization/window/gyroscope.h"
#include "server/localization/window/pose_filter.h"

namespace groundlock::localization {

// Of landmarks, matches and masks in a list: many times what there ever are.
inline constexpr std::size_t kMostListed = 100'000;
// Of frames, landmarks and tries that are counted: what is counted further
// does not run over.
inline constexpr std::uint64_t kMostCounted = std::uint64_t{1} << 62;

template <typename Stream, base::StateOf<LandmarkMatch> T>
void StateValue(Stream& stream, T& match) {
  StateValue(stream, match.landmark);
  StateValue(stream, match.pixel_px);
  const auto& pixel_px = match.pixel_px;
  if (!(pixel_px.minCoeff() >= 0.0 &&
        pixel_px.maxCoeff() <= geometry::CameraModel::kMaxSizePx)) {
    stream.Fail("lies in no image");
  }
}

template <typename Stream, base::StateOf<FollowedLandmark> T>
void StateValue(Stream& stream, T& landmark) {
  StateValue(stream, landmark.match);
  StateValue(stream, landmark.is_anchored);
}

template <typename Stream, base::StateOf<KeyFrame> T>
void StateValue(Stream& stream, T& key_frame) {
  Field(stream, "key_frame.image", key_frame.pyramid);
  List(stream, "key_frame.landmarks", key_frame.landmarks, kMostListed);
  List(stream, "key_frame.own", key_frame.own, kMostListed);
  List(stream, "key_frame.own_seen", key_frame.own_seen, kMostListed);
  Field(stream, "key_frame.pose", key_frame.world_from_camera);
  Field(stream, "key_frame.velocity_s", key_frame.velocity_s);
}

template <typename Stream, base::StateOf<LensMeasurement> T>
void StateValue(Stream& stream, T& measurement) {
  StateValue(stream, measurement.log_focal);
  StateValue(stream, measurement.log_focal_sigma);
  StateValue(stream, measurement.corner);
  StateValue(stream, measurement.corner_sigma);
}

template <typename Stream, base::StateOf<LensContradiction> T>
void StateValue(Stream& stream, T& contradiction) {
  StateValue(stream, contradiction.focal_ratio);
  StateValue(stream, contradiction.corner_share);
}

template <typename Stream, base::StateOf<PosePrior> T>
void StateValue(Stream& stream, T& prior) {
  // Placed in the map's world before anybody looks at it.
  StateValue(stream, prior.position_world);
  StateValue(stream, prior.position_sigma);
  StateValue(stream, prior.position_arm_camera);
  StateValue(stream, prior.rotation);
  StateValue(stream, prior.rotation_sigma_rad);
  if (const absl::Status valid = prior.Validate(); !valid.ok()) {
    stream.Fail(base::Std(valid.message()));
  }
}

// For the types that keep to themselves what they consist of.
struct StateFields {
  template <typename Stream, base::StateOf<CameraStateMachine> T>
  static void Of(Stream& stream, T& machine) {
    Field(stream, "camera_state.reset_count", machine.reset_count_);
    Field(stream, "camera_state.last", machine.last_);
  }

  template <typename Stream, base::StateOf<PoseFilter> T>
  static void Of(Stream& stream, T& filter) {
    Field(stream, "filter.time", filter.time_);
    Field(stream, "filter.last_measured", filter.last_measured_);
    Field(stream, "filter.last_step_s", filter.last_step_s_);
    Field(stream, "filter.turn_is_measured", filter.turn_is_measured_);
    Field(stream, "filter.pose", filter.world_from_camera_);
    Field(stream, "filter.velocity_s", filter.velocity_world_s_);
    Field(stream,
          "filter.angular_velocity_rad_s",
          filter.angular_velocity_world_rad_s_);
    Field(stream, "filter.frames", filter.frames_);
    Field(stream, "filter.remembered", filter.remembered_);
    Field(stream, "filter.bias", filter.bias_);
    Field(
        stream, "filter.gyroscope_bias_rad_s", filter.gyro_errors_.bias_rad_s);
    Field(stream, "filter.gyroscope_scale", filter.gyro_errors_.scale);
    bool expects_sensors = filter.expects_sensors_;
    Field(stream, "filter.expects_sensors", expects_sensors);
    if constexpr (Stream::kReads) {
      if (expects_sensors) filter.ExpectSensors();
    }
    Field(stream, "filter.sensor_errors", filter.sensor_errors_);
    // As the options have it: with a gyroscope or without.
    int size = filter.size_;
    Field(stream, "filter.covariance", size);
    if (size != filter.size_) stream.Fail("is of another size");
    StateValue(stream, filter.covariance_);
  }

  template <typename Stream, base::StateOf<SessionLandmarks> T>
  static void Of(Stream& stream, T& own) {
    // By their ids, so that the same state is the same message.
    std::vector<std::pair<std::uint32_t, SessionLandmarks::Landmark>> landmarks(
        own.landmarks_.begin(), own.landmarks_.end());
    std::sort(landmarks.begin(), landmarks.end(), [](auto& a, auto& b) {
      return a.first < b.first;
    });
    Field(stream, "own.next_id", own.next_id_);
    Field(stream, "own.first_frame", own.first_frame_);
    List(stream, "own.frames", own.frames_, kMostListed);
    List(stream, "own.landmarks", landmarks, kMostListed);
    if constexpr (Stream::kReads) {
      own.landmarks_.clear();
      if (own.next_id_ < own.first_id_ || own.first_frame_ > kMostCounted) {
        stream.Fail("are counted wrongly");
      }
      const std::uint64_t end = own.first_frame_ + own.frames_.size();
      for (auto& [id, landmark] : landmarks) {
        if (id < own.first_id_ || id >= own.next_id_) {
          stream.Fail("have an id that was not given");
        }
        for (const auto& observation : landmark.observations) {
          if (observation.frame >= end) stream.Fail("were seen in no frame");
        }
        landmark.p_world = landmark.At(landmark.inverse_depth);
        own.landmarks_.emplace(id, std::move(landmark));
      }
    }
  }

  template <typename Stream, base::StateOf<SessionLandmarks::Landmark> T>
  static void Of(Stream& stream, T& landmark) {
    StateValue(stream, landmark.world_from_host);
    StateValue(stream, landmark.normalized);
    StateValue(stream, landmark.inverse_depth);
    StateValue(stream, landmark.prior_inverse_depth);
    StateValue(stream, landmark.prior_sigma);
    StateValue(stream, landmark.inverse_depth_sigma);
    List(stream, "own.landmarks", landmark.observations, kMostListed);
    if (!(landmark.inverse_depth > 0.0 && landmark.prior_inverse_depth > 0.0 &&
          landmark.prior_sigma > 0.0 && landmark.inverse_depth_sigma > 0.0)) {
      stream.Fail("have no depth");
    }
  }

  template <typename Stream, base::StateOf<FrameBridge> T>
  static void Of(Stream& stream, T& bridge) {
    List(stream, "bridge.steps", bridge.steps_, FrameBridge::kMaxFrames);
    Field(stream, "bridge.turn_since_last_step", bridge.turn_since_last_step_);
    Field(stream, "bridge.num_added", bridge.num_added_);
    Field(stream, "bridge.stride", bridge.stride_);
    if (bridge.stride_ < 1 || bridge.stride_ > kMostCounted) {
      stream.Fail("is no number of frames");
    }
  }

  template <typename Stream, base::StateOf<ExposureEstimate> T>
  static void Of(Stream& stream, T& exposure) {
    Field(stream, "exposure.mismatch", exposure.mismatch_);
  }

  template <typename Stream, base::StateOf<Gyroscope> T>
  static void Of(Stream& stream, T& gyroscope) {
    List(stream,
         "gyroscope.samples",
         gyroscope.samples_,
         2 * kMaxInertialSamples);
    for (std::size_t i = 1; i < gyroscope.samples_.size(); ++i) {
      if (gyroscope.samples_[i].time <= gyroscope.samples_[i - 1].time) {
        stream.Fail("are not in order");
      }
    }
  }

  template <typename Stream, base::StateOf<LensCheck> T>
  static void Of(Stream& stream, T& check) {
    List(stream, "lens.measurements", check.measurements_, kMostListed);
    Field(stream, "lens.next_probe", check.next_probe_);
    Field(stream, "lens.num_probes", check.num_probes_);
    Field(stream, "lens.suspected_ratio", check.suspected_ratio_);
    Field(stream, "lens.is_confirmed", check.is_confirmed_);
    Field(stream, "lens.contradiction", check.contradiction_);
  }

  template <typename Stream, typename T>
  requires base::StateOf<T, CameraStateMachine::Success>
  static void Of(Stream& stream, T& success) {
    StateValue(stream, success.time);
    StateValue(stream, success.world_from_camera);
    StateValue(stream, success.covariance);
    StateValue(stream, success.speed_per_s);
    StateValue(stream, success.turn_rate_rad_per_s);
  }

  template <typename Stream, base::StateOf<FrameBridge::Step> T>
  static void Of(Stream& stream, T& step) {
    StateValue(stream, step.frame.sequence);
    StateValue(stream, step.frame.capture_time);
    std::shared_ptr<const image::LumaPyramid> pyramid;
    if constexpr (!Stream::kReads) pyramid = step.frame.Pyramid();
    StateValue(stream, pyramid);
    StateValue(stream, step.before_from_now);
    if constexpr (Stream::kReads) {
      if (pyramid == nullptr) {
        stream.Fail("have no image");
      } else {
        step.frame.luma = pyramid->levels.front();
      }
    }
  }

  template <typename Stream, base::StateOf<SessionLandmarks::Observation> T>
  static void Of(Stream& stream, T& observation) {
    StateValue(stream, observation.frame);
    StateValue(stream, observation.pixel_px);
  }

  template <typename Stream, base::StateOf<Gyroscope::Rate> T>
  static void Of(Stream& stream, T& rate) {
    StateValue(stream, rate.time);
    StateValue(stream, rate.rate_rad_s);
  }
};

template <typename Stream, typename T>
requires requires(Stream& stream, T& value) { StateFields::Of(stream, value); }
void StateValue(Stream& stream, T& value) { StateFields::Of(stream, value); }

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_STATE_FIELDS_H_
