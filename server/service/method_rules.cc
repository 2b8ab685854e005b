// SPDX-License-Identifier: Apache-2.0
#include "server/service/method_rules.h"

#include <algorithm>
#include <array>

#include "absl/base/optimization.h"

namespace groundlock::service {
namespace {

constexpr bool kReads = false;
constexpr bool kChanges = true;
constexpr std::size_t kSmall = 64 << 10;
// Control points, at most some thousand of them.
constexpr std::size_t kMedium = 4 << 20;

constexpr std::array kRules = {
    MethodRule{"/groundlock.v1.TrackingService/CreateSession",
               Scope::kSessionsAll,
               kChanges,
               kSmall},
    MethodRule{"/groundlock.v1.TrackingService/ListSessions",
               Scope::kSessionsWatch,
               kReads,
               kSmall},
    MethodRule{"/groundlock.v1.TrackingService/GetSession",
               Scope::kSessionsWatch,
               kReads,
               kSmall},
    MethodRule{"/groundlock.v1.TrackingService/DeleteSession",
               Scope::kSessionsAll,
               kChanges,
               kSmall},
    MethodRule{"/groundlock.v1.TrackingService/SetTarget",
               Scope::kSessionsAll,
               kChanges,
               kSmall},
    MethodRule{"/groundlock.v1.TrackingService/MoveTarget",
               Scope::kSessionsAll,
               kChanges,
               kSmall},
    MethodRule{"/groundlock.v1.TrackingService/DropTarget",
               Scope::kSessionsAll,
               kChanges,
               kSmall},
    MethodRule{"/groundlock.v1.TrackingService/Track",
               Scope::kSessionsAll,
               kChanges,
               0},
    MethodRule{"/groundlock.v1.TrackingService/WatchSession",
               Scope::kSessionsWatch,
               kReads,
               kSmall},
    MethodRule{
        "/groundlock.v1.TrackingService/Localize", Scope::kMapsRead, kReads, 0},
    MethodRule{
        "/groundlock.v1.MapService/ImportMap", Scope::kMapsWrite, kChanges, 0},
    MethodRule{
        "/groundlock.v1.MapService/BuildMap", Scope::kMapsWrite, kChanges, 0},
    MethodRule{
        "/groundlock.v1.MapService/ListMaps", Scope::kMapsRead, kReads, kSmall},
    MethodRule{
        "/groundlock.v1.MapService/GetMap", Scope::kMapsRead, kReads, kSmall},
    MethodRule{"/groundlock.v1.MapService/DeleteMap",
               Scope::kMapsWrite,
               kChanges,
               kSmall},
    MethodRule{"/groundlock.v1.MapService/GetPointCloud",
               Scope::kMapsRead,
               kReads,
               kSmall},
    MethodRule{"/groundlock.v1.MapService/ExportMap",
               Scope::kMapsRead,
               kReads,
               kSmall},
    MethodRule{"/groundlock.v1.MapService/AlignMap",
               Scope::kMapsWrite,
               kChanges,
               kMedium},
    MethodRule{
        "/groundlock.v1.MapService/CheckMap", Scope::kMapsRead, kReads, kSmall},
};

}  // namespace

std::span<const MethodRule> MethodRules() { return kRules; }

const MethodRule& RuleOf(std::string_view method) {
  const auto found =
      std::find_if(kRules.begin(), kRules.end(), [method](const auto& rule) {
        return rule.method == method;
      });
  ABSL_ASSERT(found != kRules.end());
  return *found;
}

}  // namespace groundlock::service
