// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/view_memory.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace groundlock::tracking {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kDegree = kPi / 180.0;
// A view leaves its sector this far beyond its edge.
constexpr double kHysteresis_rad = 5.0 * kDegree;
// Where the view stays, what it looks like is kept anew so often; it counts as
// staying within this.
constexpr std::chrono::milliseconds kKeepEvery{500};
constexpr double kSameView_rad = 2.0 * kDegree;
// What was seen from a side that differs by no more than this may help, and
// from so much more with every second in which the target may have turned.
constexpr double kHelps_rad = 50.0 * kDegree;
constexpr double kTurns_rad_s = 60.0 * kDegree;

double Apart_rad(double a_rad, double b_rad) {
  return std::abs(std::remainder(a_rad - b_rad, 2.0 * kPi));
}

}  // namespace

ViewMemory::ViewMemory(int sectors) : sectors_(std::max(sectors, 0)) {}

double ViewMemory::Middle_rad(int sector) const {
  return 2.0 * kPi * sector / static_cast<double>(sectors_.size());
}

void ViewMemory::Remember(double view_rad,
                          std::chrono::nanoseconds time,
                          const target::TargetTracker& tracker) {
  if (sectors_.empty() || !std::isfinite(view_rad)) return;
  const auto count = static_cast<int>(sectors_.size());
  const double width_rad = 2.0 * kPi / count;
  bool entered = false;
  if (sector_ < 0 || Apart_rad(view_rad, Middle_rad(sector_)) >
                         0.5 * width_rad + kHysteresis_rad) {
    const auto nearest = static_cast<int>(
        std::lround(std::remainder(view_rad, 2.0 * kPi) / width_rad));
    sector_ = (nearest + count) % count;
    entered = true;
  }
  Sector& sector = sectors_[sector_];
  const double off_rad = Apart_rad(view_rad, Middle_rad(sector_));
  if (!entered && sector.appearance != nullptr) {
    const bool nearer = off_rad < sector.off_middle_rad - kSameView_rad;
    const bool stays = off_rad < sector.off_middle_rad + kSameView_rad &&
                       time - sector.time >= kKeepEvery;
    if (!nearer && !stays) return;
  }
  tracker.Keep(sector.appearance);
  sector.view_rad = view_rad;
  sector.off_middle_rad = off_rad;
  sector.time = time;
}

std::vector<const target::Appearance*> ViewMemory::All() const {
  std::vector<const target::Appearance*> all;
  for (const Sector& sector : sectors_) {
    if (sector.appearance != nullptr) all.push_back(sector.appearance.get());
  }
  return all;
}

std::vector<const target::Appearance*> ViewMemory::Recall(
    std::optional<double> view_rad, std::chrono::nanoseconds unseen) {
  const double unseen_s = std::chrono::duration<double>(unseen).count();
  const double helps_rad = kHelps_rad + kTurns_rad_s * unseen_s;
  std::vector<std::pair<double, const target::Appearance*>> known;
  for (const Sector& sector : sectors_) {
    if (sector.appearance == nullptr) continue;
    const double apart_rad =
        view_rad ? Apart_rad(sector.view_rad, *view_rad) : 0.0;
    if (apart_rad > helps_rad) continue;
    known.emplace_back(apart_rad, sector.appearance.get());
  }
  std::stable_sort(
      known.begin(), known.end(), [](const auto& a, const auto& b) {
        return a.first < b.first;
      });
  std::vector<const target::Appearance*> recalled;
  for (const auto& [apart_rad, appearance] : known) {
    recalled.push_back(appearance);
  }
  if (recalled.size() <= kRecalled) return recalled;
  // The nearest always, if one is.
  const std::size_t fixed = view_rad ? 1 : 0;
  const std::size_t others = recalled.size() - fixed;
  std::vector<const target::Appearance*> turned(recalled.begin(),
                                                recalled.begin() + fixed);
  while (turned.size() < kRecalled) {
    turned.push_back(recalled[fixed + turn_++ % others]);
  }
  return turned;
}

}  // namespace groundlock::tracking
