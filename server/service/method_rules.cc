// SPDX-License-Identifier: Apache-2.0
#include "server/service/method_rules.h"

#include <algorithm>
#include <array>

#include "absl/base/optimization.h"

namespace groundlock::service {
namespace {

constexpr std::size_t kSmall = 64 << 10;
// Control points, at most some thousand of them.
constexpr std::size_t kMedium = 4 << 20;

constexpr std::array kRules = {
    MethodRule{"/groundlock.v1.TrackingService/CreateSession", kSmall},
    MethodRule{"/groundlock.v1.TrackingService/ListSessions", kSmall},
    MethodRule{"/groundlock.v1.TrackingService/GetSession", kSmall},
    MethodRule{"/groundlock.v1.TrackingService/DeleteSession", kSmall},
    MethodRule{"/groundlock.v1.TrackingService/SetTarget", kSmall},
    MethodRule{"/groundlock.v1.TrackingService/MoveTarget", kSmall},
    MethodRule{"/groundlock.v1.TrackingService/DropTarget", kSmall},
    MethodRule{"/groundlock.v1.TrackingService/Track", 0},
    MethodRule{"/groundlock.v1.TrackingService/WatchSession", kSmall},
    MethodRule{"/groundlock.v1.TrackingService/Localize", 0},
    MethodRule{"/groundlock.v1.MapService/ImportMap", 0},
    MethodRule{"/groundlock.v1.MapService/BuildMap", 0},
    MethodRule{"/groundlock.v1.MapService/ListMaps", kSmall},
    MethodRule{"/groundlock.v1.MapService/GetMap", kSmall},
    MethodRule{"/groundlock.v1.MapService/DeleteMap", kSmall},
    MethodRule{"/groundlock.v1.MapService/GetPointCloud", kSmall},
    MethodRule{"/groundlock.v1.MapService/ExportMap", kSmall},
    MethodRule{"/groundlock.v1.MapService/AlignMap", kMedium},
    MethodRule{"/groundlock.v1.MapService/CheckMap", kSmall},
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
