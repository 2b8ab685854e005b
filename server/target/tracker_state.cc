// SPDX-License-Identifier: Apache-2.0
// What the trackers know as plain data.
#include <utility>

#include "server/target/act_tracker.h"
#include "server/target/dcf_tracker.h"
#include "server/target/internal/state_fields.h"

namespace groundlock::target {

using internal::StateFields;

void DcfTracker::SaveState(base::StateWriter& writer,
                           std::span<const Appearance* const> kept) const {
  StateFields::Of(writer, *this, kept);
}

void DcfTracker::RestoreState(base::StateReader& reader,
                              std::span<const Appearance* const> kept) {
  StateFields::Of(reader, *this, kept);
}

void DcfTracker::SaveAppearance(base::StateWriter& writer,
                                const Appearance& kept) const {
  const KeptAppearance* own = StateFields::AsKept(kept);
  if (own != nullptr) StateFields::Of(writer, *own);
}

std::unique_ptr<Appearance> DcfTracker::RestoreAppearance(
    base::StateReader& reader) const {
  auto kept = StateFields::MakeKept(*this);
  StateFields::Of(reader, *kept);
  if (!reader.ok()) return nullptr;
  return kept;
}

void ActTracker::SaveState(base::StateWriter& writer,
                           std::span<const Appearance* const> /*kept*/) const {
  StateFields::Of(writer, *this);
}

void ActTracker::RestoreState(base::StateReader& reader,
                              std::span<const Appearance* const> /*kept*/) {
  StateFields::Of(reader, *this);
}

}  // namespace groundlock::target
