// SPDX-License-Identifier: Apache-2.0
#include "client/cli/map_output.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"
#include "client/cli/names.h"
#include "map_store/base/status.h"
#include "map_store/formats/formats.h"

namespace groundlock::cli {

std::string GroundText(const sdk::MapInfo& map) {
  if (map.ground_state == sdk::GroundState::kUnknown) {
    return "unknown: sessions give camera poses and 2D boxes, no boxes in the "
           "world (groundlock map align tells the ground)";
  }
  std::string text = GroundStateName(map.ground_state);
  if (map.ground_sigma_deg > 0.0) {
    absl::StrAppendFormat(&text, " (+- %.1f deg", map.ground_sigma_deg);
    if (map.ground_height_sigma > 0.0) {
      absl::StrAppendFormat(&text,
                            "; the cameras' height above it +- %.1f %%",
                            100.0 * map.ground_height_sigma);
    }
    text += ")";
  }
  if (map.ground_relief_m > 0.0) {
    absl::StrAppendFormat(
        &text,
        ", uneven by %.2f%s%s",
        map.ground_relief_m,
        map.metric ? " m" : " units",
        map.ground_relief_given ? " as its terrain says" : "");
  }
  return text;
}

absl::StatusOr<sdk::ImportReport> UploadMap(
    const std::string& name,
    const std::filesystem::path& model,
    const std::optional<geometry::Similarity3>& world_from_source,
    std::uint64_t seed,
    sdk::Client& client,
    VerbContext& context) {
  ASSIGN_OR_RETURN(const formats::ImportFiles found,
                   formats::FindImportFiles(model, {}));
  sdk::ImportRequest request;
  request.name = name;
  request.format = found.format == formats::Format::kGroundlock
                       ? sdk::MapFormat::kGroundlock
                       : sdk::MapFormat::kColmap;
  for (const formats::ImportFile& file : found.files) {
    request.files.push_back({file.path, file.remote});
  }
  request.model_path = found.model;
  request.database_path = found.database;
  request.world_from_source = world_from_source;
  request.seed = seed;
  std::unique_ptr<Progress> bar;
  auto report =
      client.ImportMap(request, UploadProgress(context, "upload", bar));
  if (bar) bar->ClearNote();
  bar.reset();
  if (context.interrupt.interrupted() && !report.ok()) {
    return absl::CancelledError("interrupted; no map was published");
  }
  return report;
}

bool StageProgress::Update(std::string_view stage,
                           double fraction,
                           const std::string& note) {
  if (stage != stage_) {
    Finish();
    stage_ = stage;
    const Terminal terminal = StderrTerminal();
    bar_ = std::make_unique<Progress>(
        context_.err,
        Progress::Options{.label = stage_,
                          .total = 1'000,
                          .unit = "",
                          .counts = false,
                          .terminal = terminal.is_terminal,
                          .columns = terminal.columns});
  }
  bar_->Update(static_cast<std::uint64_t>(
                   std::lround(1'000.0 * std::clamp(fraction, 0.0, 1.0))),
               note);
  return !context_.interrupt.interrupted();
}

void StageProgress::Finish() { bar_.reset(); }

}  // namespace groundlock::cli
