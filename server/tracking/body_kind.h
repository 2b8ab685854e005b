// SPDX-License-Identifier: Apache-2.0
// Of what kind a target is, by how large it is: what is known of the sizes of
// road users says which way one stands, and how large it is, before it or the
// camera has moved.
#ifndef GROUNDLOCK_SERVER_TRACKING_BODY_KIND_H_
#define GROUNDLOCK_SERVER_TRACKING_BODY_KIND_H_

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string_view>

#include "map_store/geometry/box.h"
#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"

namespace groundlock::tracking {

struct BodyKind {
  std::string_view name;
  Eigen::Vector3d size_m;     // length, width, height: the middle of the kind
  Eigen::Vector3d log_sigma;  // of their logarithms
  double share = 0.0;         // of the road users that are of it
  ground::SizePrior Size() const;
  ground::ShapePrior Shape() const;
};

// The means of sizes in the road data sets KITTI, nuScenes, Lyft Level 5 and
// Waymo, as their published detectors' anchors have them; sigmas are their
// scatter within a kind, at least that between the sets, and shares about those
// of the sets' labels (docs/method.md, "What kind of body it is").
std::span<const BodyKind> BodyKinds();

struct KindFit {
  const BodyKind* kind = nullptr;
  ground::BoxFit fit;  // its length along the likeliest way of standing
  // Of the direction of its length, either end being its front.
  double axis_sigma_rad = 0.0;
};

// The likeliest kind and way of standing of what box_px was drawn about: each
// kind in each direction is fitted and weighed by its evidence, against that of
// a body of any size. nullopt: it may as well be something else, or nothing is
// known of sizes there.
//   view  in metres.
// Thread-safe; 10 to 17 ms, or 0.2 of what is half or twice as large as any.
std::optional<KindFit> FitLikelyKind(const ground::GroundView& view,
                                     const geometry::Box2& box_px);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_BODY_KIND_H_
