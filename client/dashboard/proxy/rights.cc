// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/rights.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::dashboard {
namespace {

bool Has(const gl::GetCallerResponse& viewer, std::string_view scope) {
  return viewer.open_to_all() ||
         std::find(viewer.scopes().begin(), viewer.scopes().end(), scope) !=
             viewer.scopes().end();
}

}  // namespace

absl::Status MayLookOn(const gl::GetCallerResponse& viewer,
                       const gl::GetCallerResponse& dashboard) {
  if (viewer.tenant() != dashboard.tenant()) {
    return absl::PermissionDeniedError(
        "this dashboard shows what is another tenant's");
  }
  if (Has(viewer, "sessions:watch") && Has(viewer, "maps:read")) {
    return absl::OkStatus();
  }
  return absl::PermissionDeniedError(
      "this token may not watch all sessions and read all maps, which the "
      "dashboard shows (scopes sessions:watch and maps:read)");
}

absl::Status MustHave(const gl::GetCallerResponse& viewer,
                      std::string_view scope) {
  if (Has(viewer, scope)) return absl::OkStatus();
  return absl::PermissionDeniedError(
      absl::StrCat("this wants the scope ", base::Abseil(scope)));
}

absl::Status MayUpload(const gl::GetCallerResponse& viewer) {
  if (Has(viewer, "maps:write") || Has(viewer, "sessions:own")) {
    return absl::OkStatus();
  }
  return absl::PermissionDeniedError(
      "uploads want the scope maps:write or sessions:own");
}

absl::Status MayChangeUpload(const gl::GetCallerResponse& viewer,
                             const std::string& owner) {
  RETURN_IF_ERROR(MayUpload(viewer));
  if (!owner.empty() && owner == viewer.name()) return absl::OkStatus();
  return MayActOnAll(viewer);
}

absl::Status MayActOn(const gl::GetCallerResponse& viewer,
                      const gl::Session& session) {
  if (session.owner() == viewer.name() && Has(viewer, "sessions:own")) {
    return absl::OkStatus();
  }
  return MayActOnAll(viewer);
}

absl::Status MayActOnAll(const gl::GetCallerResponse& viewer) {
  if (Has(viewer, "sessions:all")) return absl::OkStatus();
  return absl::PermissionDeniedError(
      "this is another's: it wants the scope sessions:all");
}

}  // namespace groundlock::dashboard
