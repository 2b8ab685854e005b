// SPDX-License-Identifier: Apache-2.0
// groundlock simulate SCENE SEQUENCE --out DIR
#include <CLI/CLI.hpp>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/parse.h"
#include "client/cli/progress.h"
#include "client/cli/verbs.h"
#include "client/simulator/simulator.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

using nlohmann::json;
using simulator::SimulationOptions;
using simulator::SimulationProgress;
using simulator::SimulationReport;

struct SimulateFlags {
  SimulationOptions options;
  std::string output;
  std::string size;
};

std::string BoxText(const geometry::Box2& box) {
  return absl::StrFormat(
      "%.2f,%.2f,%.2f,%.2f", box.x(), box.y(), box.width(), box.height());
}

// One bar per stage.
class StageProgress {
 public:
  explicit StageProgress(VerbContext& context) : context_(context) {}

  bool Update(const SimulationProgress& progress) {
    if (progress.stage != stage_) {
      bar_.reset();
      stage_ = progress.stage;
      const Terminal terminal = StderrTerminal();
      bar_.emplace(context_.err,
                   Progress::Options{.label = stage_,
                                     .total = 100,
                                     .unit = "%",
                                     .terminal = terminal.is_terminal,
                                     .columns = terminal.columns});
    }
    bar_->Update(static_cast<std::uint64_t>(progress.fraction * 100.0));
    return !context_.interrupt.interrupted();
  }

 private:
  VerbContext& context_;
  std::string stage_;
  std::optional<Progress> bar_;
};

json ReportJson(const SimulationReport& report,
                const SimulationOptions& options) {
  json files = json::array();
  for (const auto& file : report.files) files.push_back(file.string());
  json object = {{"scene", options.scene},
                 {"sequence", options.sequence},
                 {"frames", report.frames},
                 {"files", files},
                 {"total_s", report.total_s}};
  if (report.init_frame) object["init_frame"] = *report.init_frame;
  if (report.init_box) {
    const geometry::Box2& box = *report.init_box;
    object["init_box"] = {box.x(), box.y(), box.width(), box.height()};
    object["hidden_frames"] = report.hidden_frames;
    object["unseen_frames"] = report.unseen_frames;
  }
  if (report.num_landmarks > 0) {
    object["num_landmarks"] = report.num_landmarks;
    object["mean_reprojection_error_px"] = report.mean_reprojection_error_px;
  }
  return object;
}

// What was written, and the commands that take it from there.
std::string ReportText(const SimulationReport& report,
                       const SimulationOptions& options) {
  std::string text;
  for (const auto& file : report.files) {
    absl::StrAppend(&text, "wrote ", file.string(), "\n");
  }
  absl::StrAppendFormat(
      &text, "%d frames in %.1f s\n", report.frames, report.total_s);
  const std::string folder = options.output.string();
  if (report.num_landmarks > 0) {
    absl::StrAppendFormat(
        &text,
        "map: %d landmarks, %.2f px mean reprojection error\n\n"
        "  groundlock map import %s %s/map --align %s/align.json\n",
        report.num_landmarks,
        report.mean_reprojection_error_px,
        options.scene,
        folder,
        folder);
  }
  if (report.init_box) {
    absl::StrAppendFormat(
        &text,
        "the target is out of sight in %d frames, %d of them hidden by other "
        "things\n\n"
        "  groundlock track %s/%s.mp4 --map %s --camera %s/camera.json "
        "--init-box %s%s --results results.csv --overlay overlay.mp4\n",
        report.unseen_frames,
        report.hidden_frames,
        folder,
        options.sequence,
        options.scene,
        folder,
        BoxText(*report.init_box),
        report.init_frame.value_or(0) > 0
            ? absl::StrCat(" --init-frame ", *report.init_frame)
            : std::string());
  }
  return text;
}

absl::Status RunSimulate(SimulateFlags flags, VerbContext& context) {
  flags.options.output = flags.output;
  if (!flags.size.empty()) {
    auto size = ParseSize(flags.size);
    if (!size.ok()) return base::Annotate(size.status(), "--size");
    flags.options.width_px = size->width;
    flags.options.height_px = size->height;
  }
  absl::StatusOr<SimulationReport> report;
  {
    StageProgress progress(context);
    report = simulator::Simulate(flags.options,
                                 [&](const SimulationProgress& stage) {
                                   return progress.Update(stage);
                                 });
  }
  if (context.interrupt.interrupted() && !report.ok()) {
    return absl::CancelledError("interrupted");
  }
  RETURN_IF_ERROR(report.status());
  if (context.common.json) {
    context.out << ReportJson(*report, flags.options).dump() << '\n';
  } else {
    context.out << ReportText(*report, flags.options);
  }
  return absl::OkStatus();
}

}  // namespace

void AddSimulateVerb(CLI::App& app, VerbContext& context) {
  std::string known;
  for (const std::string& scene : simulator::SceneNames()) {
    absl::StrAppend(&known,
                    known.empty() ? "" : "; ",
                    scene,
                    ": ",
                    absl::StrJoin(simulator::SequenceNames(scene), ", "));
  }
  CLI::App* verb = app.add_subcommand(
      "simulate",
      "Render a yard with ground truth. Scenes and sequences: " + known);
  auto flags = std::make_shared<SimulateFlags>();
  SimulationOptions& options = flags->options;
  verb->add_option("SCENE", options.scene, "Scene")->required();
  verb->add_option("SEQUENCE", options.sequence, "Sequence")->required();
  verb->add_option("--out", flags->output, "Folder to write to")
      ->type_name("DIR")
      ->required();
  verb->add_option(
      "--frames", options.frames, "Number of frames [the sequence's own]");
  verb->add_option("--size", flags->size, "Image size [1280x720]")
      ->type_name("WxH");
  verb->add_option("--fps", options.fps, "Frames per second")
      ->capture_default_str();
  verb->add_option("--samples",
                   options.samples_per_pixel,
                   "Rays per pixel; also the moments of the motion blur")
      ->capture_default_str();
  verb->add_option(
          "--seed", options.seed, "Seed of textures, layout, hand and noise")
      ->capture_default_str();
  verb->add_option("--threads", options.threads, "0 = all cores")
      ->capture_default_str();
  AddCommonOptions(*verb, context);
  verb->callback([flags, &context] {
    context.run = [flags, &context] { return RunSimulate(*flags, context); };
  });
}

}  // namespace groundlock::cli
