// SPDX-License-Identifier: Apache-2.0
// What a target's track is made of that hides nothing, each type's fields
// listed once for writing and reading (target_state_stream.h), and what must
// hold of them so that nobody is led astray by bytes that no session has
// written. For state_fields.h, which lists the types that keep theirs to
// themselves.
#ifndef GROUNDLOCK_SERVER_TRACKING_STATE_VALUES_H_
#define GROUNDLOCK_SERVER_TRACKING_STATE_VALUES_H_

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>

#include "map_store/base/state_stream.h"
#include "map_store/geometry/state_fields.h"
#include "server/tracking/target_state_stream.h"
#include "server/tracking/target_track.h"

namespace groundlock::tracking {

// Many times what there ever are.
inline constexpr std::size_t kMostPictures = 64;
inline constexpr std::size_t kMostLookalikes = 10'000;
inline constexpr std::size_t kMostOthers = 10'000;
inline constexpr std::size_t kMostRecent = 10'000;
inline constexpr std::size_t kMostText = 65'536;
// As many as there may be: fits to them take longer with more.
inline constexpr std::size_t kMostBodyViews = 256;
inline constexpr std::size_t kMostBodyPoints = 600;
inline constexpr std::size_t kMostSightings = 25;  // of a point
// What is counted further does not run over.
inline constexpr std::uint64_t kMostCounts = std::uint64_t{1} << 62;
inline constexpr int kMostFrames = std::numeric_limits<int>::max() / 2;
// Of angles, which are wound up.
inline constexpr double kMostAngle_rad = 1e6;

template <typename Stream, base::StateOf<std::string> T>
void StateValue(Stream& stream, T& text) {
  auto size = static_cast<std::uint32_t>(text.size());
  StateValue(stream, size);
  if constexpr (Stream::kReads) {
    if (size > kMostText) stream.Fail("is too long");
    text = stream.ok() ? std::string(stream.Bytes(size)) : "";
  } else {
    stream.Bytes(text);
  }
}

template <typename Stream, base::StateOf<geometry::Plane> T>
void StateValue(Stream& stream, T& plane) {
  StateValue(stream, plane.normal);
  StateValue(stream, plane.d);
  if constexpr (Stream::kReads) {
    if (std::abs(plane.normal.norm() - 1.0) < 1e-6) return;
    plane.normal = Eigen::Vector3d::UnitZ();
    stream.Fail("is no plane");
  }
}

// Of some size.
template <typename Stream, base::StateOf<geometry::Box2> T>
void BoxField(Stream& stream, std::string_view field, T& box_px) {
  Field(stream, field, box_px);
  if (!(box_px.width() > 0.0 && box_px.height() > 0.0)) {
    stream.Fail("is of no size");
  }
}

// A picture's pixels per pixel of the image, which was halved some times.
template <typename Stream, base::StateOf<double> T>
void ScaleField(Stream& stream, std::string_view field, T& scale) {
  Field(stream, field, scale);
  if (!(scale <= 1.0 && scale >= 1.0 / 256.0)) stream.Fail("is no scale");
}

// Length, width and height.
template <typename Stream, base::StateOf<Eigen::Vector3d> T>
void SizeField(Stream& stream, std::string_view field, T& size_m) {
  Field(stream, field, size_m);
  if (!(size_m.minCoeff() > 1e-9 && size_m.maxCoeff() < 1e9)) {
    stream.Fail("is no size");
  }
}

// What may be without end.
template <typename Stream, base::StateOf<double> T>
void Endless(Stream& stream, T& number) {
  constexpr double kNoEnd = std::numeric_limits<double>::infinity();
  std::uint8_t kind = number == kNoEnd ? 1 : number == -kNoEnd ? 2 : 0;
  StateValue(stream, kind);
  if (kind == 0) StateValue(stream, number);
  if constexpr (Stream::kReads) {
    if (kind > 2) stream.Fail("is no number");
    if (kind > 0) number = kind == 1 ? kNoEnd : -kNoEnd;
  }
}

// ----------------------------------------------------------------------------
// Of other rooms.

template <typename Stream, base::StateOf<ground::SeenOutline> T>
void StateValue(Stream& stream, T& outline) {
  StateValue(stream, outline.sure_px);
  for (int axis = 0; axis < 2; ++axis) {
    Endless(stream, outline.possible_px.min_px[axis]);
    Endless(stream, outline.possible_px.max_px[axis]);
  }
  StateValue(stream, outline.sigma_px);
  StateValue(stream, outline.is_seen);
  if (!(outline.sigma_px > 0.0)) stream.Fail("is known without error");
}

template <typename Stream, base::StateOf<ground::BodyShape> T>
void StateValue(Stream& stream, T& shape) {
  for (auto* share : {&shape.plan, &shape.roof, &shape.clearance}) {
    StateValue(stream, *share);
    if (!(*share >= 0.0 && *share <= 2.0)) stream.Fail("is no share");
  }
}

template <typename Stream, base::StateOf<ground::SizePrior> T>
void StateValue(Stream& stream, T& prior) {
  StateValue(stream, prior.size_m);
  StateValue(stream, prior.whitening_log);
  if (!(prior.size_m.minCoeff() > 0.0)) stream.Fail("is no size");
}

template <typename Stream, base::StateOf<ground::BodyPoint> T>
void StateValue(Stream& stream, T& point) {
  StateValue(stream, point.p_world);
  StateValue(stream, point.covariance_m2);
}

template <typename Stream, typename T>
requires base::StateOf<T, ground::BodyTrack::Observation>
void StateValue(Stream& stream, T& observation) {
  StateValue(stream, observation.view);
  StateValue(stream, observation.pixel_px);
}

// ----------------------------------------------------------------------------
// Of this one, without secrets.

template <typename Stream, base::StateOf<BodyKind> T>
void StateValue(Stream& stream, T& kind) {
  constexpr std::uint8_t kNone = 255;
  const auto kinds = BodyKinds();
  std::uint8_t index = kNone;
  if constexpr (!Stream::kReads) {
    const auto found =
        std::find_if(kinds.begin(), kinds.end(), [&](const BodyKind& known) {
          return known.name == kind.name;
        });
    if (found != kinds.end()) {
      index = static_cast<std::uint8_t>(found - kinds.begin());
    }
  }
  StateValue(stream, index);
  StateValue(stream, kind.size_m);
  StateValue(stream, kind.log_sigma);
  StateValue(stream, kind.share);
  StateValue(stream, kind.scale_sigma);
  StateValue(stream, kind.was_measured);
  if constexpr (Stream::kReads) {
    if (index != kNone && index >= kinds.size()) stream.Fail("is not known");
    kind.name = index < kinds.size() ? kinds[index].name : std::string_view();
    if (!(kind.size_m.minCoeff() > 1e-9 && kind.size_m.maxCoeff() < 1e9 &&
          kind.log_sigma.minCoeff() > 0.0 && kind.log_sigma.maxCoeff() < 10.0 &&
          std::abs(kind.scale_sigma) < 10.0)) {
      stream.Fail("is of no size");
    }
  }
}

template <typename Stream, base::StateOf<GroundSighting> T>
void StateValue(Stream& stream, T& sighting) {
  StateValue(stream, sighting.place_m);
  Covariance(stream, "sighting.covariance", sighting.covariance_m2);
  StateValue(stream, sighting.center_px);
  Endless(stream, sighting.innovation.surprise);
  Endless(stream, sighting.innovation.sigma_px2);
  StateValue(stream, sighting.is_bearing);
  StateValue(stream, sighting.heading_rad);
  StateValue(stream, sighting.heading_sigma_rad);
  StateValue(stream, sighting.velocity_m_s);
  Covariance(stream,
             "sighting.velocity_covariance",
             sighting.velocity_covariance_m2_s2);
}

template <typename Stream, base::StateOf<GroundErrors> T>
void StateValue(Stream& stream, T& errors) {
  StateValue(stream, errors.mean);
  Covariance(stream, "ground.errors", errors.covariance);
}

template <typename Stream, base::StateOf<ImageAffinity> T>
void StateValue(Stream& stream, T& affinity) {
  StateValue(stream, affinity.turn);
  StateValue(stream, affinity.shift_px);
}

template <typename Stream, base::StateOf<Picture> T>
void StateValue(Stream& stream, T& picture) {
  ImageField(stream, "saliency.picture", picture.luma, CV_8UC1);
  StateValue(stream, picture.origin_px);
  ScaleField(stream, "saliency.scale", picture.scale);
  Moment(stream, "saliency.time", picture.time);
  Field(stream, "saliency.to_now", picture.to_now);
  Field(stream, "saliency.target", picture.target_px);
}

template <typename Stream, base::StateOf<PatchTurn> T>
void StateValue(Stream& stream, T& turn) {
  StateValue(stream, turn.angle_rad);
  StateValue(stream, turn.size_ratio);
  if (!(std::abs(turn.angle_rad) < kMostAngle_rad &&
        turn.size_ratio.minCoeff() > 1e-6 &&
        turn.size_ratio.maxCoeff() < 1e6)) {
    stream.Fail("is no turn");
  }
}

template <typename Stream, typename T>
requires base::StateOf<T, ViewTurn::View>
void StateValue(Stream& stream, T& view) {
  StateValue(stream, view.px_per_m);
  StateValue(stream, view.to_eye);
  StateValue(stream, view.lean_rad);
  StateValue(stream, view.width_m);
  StateValue(stream, view.height_m);
}

template <typename Stream, typename T>
requires base::StateOf<T, MotionSaliency::Spot>
void StateValue(Stream& stream, T& spot) {
  BoxField(stream, "saliency.spot", spot.box_px);
  StateValue(stream, spot.share);
  StateValue(stream, spot.velocity_px_s);
  StateValue(stream, spot.is_whole);
  StateValue(stream, spot.has_gone_on);
}

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_STATE_VALUES_H_
