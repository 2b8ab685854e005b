// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/other_targets.h"

#include "server/tracking/association.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// What overlaps another target so much is on the same thing, or is that one.
constexpr double kSameThing = 0.3;

bool Overlap(const Box2& a_px, const Box2& b_px) {
  return geometry::IntersectionOverUnion(a_px, b_px) > kSameThing;
}

}  // namespace

void OtherTargets::Note(const Box2& own_px, std::span<const SeenTarget> seen) {
  for (const SeenTarget& other : seen) {
    const auto [entry, is_new] = goes_with_.emplace(other.id, true);
    entry->second = entry->second && Overlap(own_px, other.box_px);
  }
}

bool OtherTargets::GoesWith(const std::string& id) const {
  const auto entry = goes_with_.find(id);
  return entry != goes_with_.end() && entry->second;
}

bool OtherTargets::IsTaken(const Box2& found_px,
                           std::optional<double> likelihood,
                           std::span<const SeenTarget> seen) const {
  for (const SeenTarget& other : seen) {
    if (GoesWith(other.id)) continue;
    const bool is_taken =
        likelihood
            ? SeenLikelihood(other.box_px, found_px.center_px()) > *likelihood
            : Overlap(found_px, other.box_px);
    if (is_taken) return true;
  }
  return false;
}

}  // namespace groundlock::tracking
