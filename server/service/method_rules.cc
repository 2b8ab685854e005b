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
constexpr std::size_t kMessage = 0;  // as large as messages may be

constexpr Scopes kRead = kNoScopes | Scope::kMapsRead;
constexpr Scopes kWrite = kNoScopes | Scope::kMapsWrite;
// Which sessions it is good for, SessionManager tells.
constexpr Scopes kAct = kNoScopes | Scope::kSessionsOwn;
constexpr Scopes kSee = Scope::kSessionsOwn | Scope::kSessionsWatch;

#define TRACKING "/groundlock.v1.TrackingService/"
#define MAPS "/groundlock.v1.MapService/"
constexpr std::array kRules = {
    MethodRule{TRACKING "CreateSession", kAct, kChanges, kSmall},
    MethodRule{TRACKING "ListSessions", kSee, kReads, kSmall},
    MethodRule{TRACKING "GetSession", kSee, kReads, kSmall},
    MethodRule{TRACKING "DeleteSession", kAct, kChanges, kSmall},
    MethodRule{TRACKING "SetTarget", kAct, kChanges, kSmall},
    MethodRule{TRACKING "MoveTarget", kAct, kChanges, kSmall},
    MethodRule{TRACKING "DropTarget", kAct, kChanges, kSmall},
    MethodRule{TRACKING "Track", kAct, kChanges, kMessage},
    MethodRule{TRACKING "WatchSession", kSee, kReads, kSmall},
    MethodRule{TRACKING "Localize", kRead, kReads, kMessage},
    MethodRule{TRACKING "GetCaller", kNoScopes, kReads, kSmall},
    MethodRule{MAPS "ImportMap", kWrite, kChanges, kMessage},
    MethodRule{MAPS "BuildMap", kWrite, kChanges, kMessage},
    MethodRule{MAPS "ListMaps", kRead, kReads, kSmall},
    MethodRule{MAPS "GetMap", kRead, kReads, kSmall},
    MethodRule{MAPS "DeleteMap", kWrite, kChanges, kSmall},
    MethodRule{MAPS "GetPointCloud", kRead, kReads, kSmall},
    MethodRule{MAPS "ExportMap", kRead, kReads, kSmall},
    MethodRule{MAPS "AlignMap", kWrite, kChanges, kMedium},
    MethodRule{MAPS "CheckMap", kRead, kReads, kSmall},
};
#undef MAPS
#undef TRACKING

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
