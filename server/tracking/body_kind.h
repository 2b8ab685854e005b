// SPDX-License-Identifier: Apache-2.0
// Of what kind a target is, as a client tells or by how large it is: what is
// known of the sizes of road users says which way one stands, and how large it
// is, before it or the camera has moved.
#ifndef GROUNDLOCK_SERVER_TRACKING_BODY_KIND_H_
#define GROUNDLOCK_SERVER_TRACKING_BODY_KIND_H_

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"

namespace groundlock::tracking {

struct BodyKind {
  std::string_view name;      // empty: of none, of which a size was told
  Eigen::Vector3d size_m;     // length, width, height: the middle of the kind
  Eigen::Vector3d log_sigma;  // of their logarithms
  double share = 0.0;         // of the road users that are of it
  double scale_sigma = 0.0;   // of all three together, beside log_sigma
  // size_m was measured of the very body, in the map's lengths even where these
  // are no metres.
  bool was_measured = false;
  ground::SizePrior Size() const;
  // Where lengths are of an unknown unit: its proportions, as large as a
  // footprint of about that side.
  ground::SizePrior SizeInAnyUnit(double side) const;
};

// The means of sizes in the road data sets KITTI, nuScenes, Lyft Level 5 and
// Waymo, as their published detectors' anchors have them; sigmas are their
// scatter within a kind, at least that between the sets, and shares about those
// of the sets' labels. Boats are as the register of the United States has them;
// none is taken for one unless it is told to be (docs/method.md, "What kind of
// body it is").
std::span<const BodyKind> BodyKinds();

// What a client says of a target's body; by default nothing.
struct TargetBody {
  std::string kind;  // the name of one of BodyKinds; empty: not told
  // Length, width and height, in the map's lengths, as a tape or a data sheet
  // has them.
  std::optional<Eigen::Vector3d> size_m = std::nullopt;
};

// nullopt: nothing is told. kInvalidArgument, naming the field: no such kind,
// or a size that is not finite, not positive, or of no body's proportions.
absl::StatusOr<std::optional<BodyKind>> KindOf(const TargetBody& told);

struct KindFit {
  BodyKind kind;
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

// The likeliest way of standing of a body that is known to be of that kind.
// nullopt: it fits in no direction.
//   metric  the view is in metres; else kinds tell proportions alone.
// Thread-safe; 3 ms.
std::optional<KindFit> FitKind(const ground::GroundView& view,
                               const geometry::Box2& box_px,
                               const BodyKind& kind,
                               bool metric);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_BODY_KIND_H_
