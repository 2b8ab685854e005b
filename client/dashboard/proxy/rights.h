// SPDX-License-Identifier: Apache-2.0
// What a viewer may do, by what the server says of their token. What the
// server itself does, it decides on itself; this is for what the dashboard
// does: uploads, recordings, the sources that it feeds sessions from.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_RIGHTS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_RIGHTS_H_

#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "groundlock/v1/tracking.pb.h"

namespace groundlock::dashboard {

namespace gl = ::groundlock::v1;

// The token of viewers of a server that wants none. It is sent, so that a call
// of theirs never passes for one of the dashboard's own, which may have a
// certificate instead of a token.
inline constexpr std::string_view kNobodysToken = "-";

// Each kPermissionDenied, saying what is missing.
//
// Pages are shown all sessions and maps of the dashboard's tenant, whoever
// looks on.
absl::Status MayLookOn(const gl::GetCallerResponse& viewer,
                       const gl::GetCallerResponse& dashboard);
// What wants that scope of its own.
absl::Status MustHave(const gl::GetCallerResponse& viewer,
                      std::string_view scope);
// Files for maps or sessions.
absl::Status MayUpload(const gl::GetCallerResponse& viewer);
// Adding to an upload, or removing it.
absl::Status MayChangeUpload(const gl::GetCallerResponse& viewer,
                             const std::string& owner);
// Steering what feeds a session, recording it.
absl::Status MayActOn(const gl::GetCallerResponse& viewer,
                      const gl::Session& session);
// The same for those that are over, and for recordings, which belong to all.
absl::Status MayActOnAll(const gl::GetCallerResponse& viewer);

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_RIGHTS_H_
