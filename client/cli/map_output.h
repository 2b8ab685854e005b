// SPDX-License-Identifier: Apache-2.0
// What the map verbs print, and how they upload.
#ifndef GROUNDLOCK_CLIENT_CLI_MAP_OUTPUT_H_
#define GROUNDLOCK_CLIENT_CLI_MAP_OUTPUT_H_

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cli/progress.h"
#include "client/cli/verbs.h"
#include "client/sdk/client.h"
#include "map_store/geometry/similarity3.h"

namespace groundlock::cli {

// A map as `groundlock map show --json` prints it.
nlohmann::json MapInfoJson(const sdk::MapInfo& map);

// "measured", "estimated (+- 0.4 deg)", or "unknown: " and what follows from
// it.
std::string GroundText(const sdk::MapInfo& map);

// For calls that have nothing to clean up: they end at once, and the server
// drops what it does for a client that has gone.
void ExitOnInterrupt(VerbContext& context);

// Draws a transfer's progress and cancels it when the user interrupts.
sdk::Progress UploadProgress(const VerbContext& context,
                             std::string label,
                             std::unique_ptr<Progress>& bar);

// A COLMAP model with its database, or a map file (.glmap), as a new version of
// `name`. world_from_source: as ImportRequest has it.
absl::StatusOr<sdk::ImportReport> UploadMap(
    const std::string& name,
    const std::filesystem::path& model,
    const std::optional<geometry::Similarity3>& world_from_source,
    std::uint64_t seed,
    sdk::Client& client,
    VerbContext& context);

// Draws the stages of a long work one below the other.
class StageProgress {
 public:
  explicit StageProgress(VerbContext& context) : context_(context) {}
  // False once the user has interrupted.
  bool Update(std::string_view stage, double fraction, const std::string& note);
  void Finish();

 private:
  VerbContext& context_;
  std::string stage_;
  std::unique_ptr<Progress> bar_;
};

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_MAP_OUTPUT_H_
