// SPDX-License-Identifier: Apache-2.0
// groundlock evaluate …
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>
#include <unordered_map>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "client/cli/evaluate/evaluation.h"
#include "client/cli/evaluate_trackers.h"
#include "client/cli/evaluation_stills.h"
#include "client/cli/map_output.h"
#include "client/cli/parse.h"
#include "client/cli/track_run.h"
#include "client/cli/verbs.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;

struct EvaluateFlags {
  std::string folder;
  std::vector<std::string> experiments;
  std::string video;
  std::string truth;
  std::string map;
  std::string camera;
  std::vector<std::string> configurations;
  bool compare_trackers = false;
  std::vector<std::string> trackers;
  std::string out = "evaluation";
  std::string frames;
  std::uint64_t seed = 0;
};

// A video and what is true of it.
struct Sequence {
  std::string name;
  fs::path video;
  fs::path truth;
};

constexpr const char* kTarget = "target";
constexpr const char* kTruthSuffix = "_truth.csv";
// The thesis' experiments come first, in its order.
constexpr const char* kThesisOrder[] = {
    "srun", "scale", "outofview", "occlusion"};

absl::StatusOr<std::vector<Configuration>> Configurations(
    const EvaluateFlags& flags) {
  if (flags.configurations.empty()) {
    return std::vector<Configuration>{{"baseline", "act"}, {}};
  }
  std::vector<Configuration> configurations;
  for (const std::string& text : flags.configurations) {
    const std::vector<std::string> parts = absl::StrSplit(text, '+');
    if (text == "defaults") {
      configurations.push_back({});
    } else if (parts.size() == 2 && !parts[0].empty() && !parts[1].empty()) {
      configurations.push_back({parts[0], parts[1]});
    } else {
      return absl::InvalidArgumentError(
          absl::StrCat("--configuration \"",
                       text,
                       "\": expected defaults, or LOCALIZER+TRACKER as in "
                       "baseline+act"));
    }
  }
  return configurations;
}

std::size_t ThesisRank(const std::string& name) {
  return std::find(std::begin(kThesisOrder), std::end(kThesisOrder), name) -
         std::begin(kThesisOrder);
}

// NAME.mp4 beside NAME_truth.csv, all of a folder or those asked for.
absl::StatusOr<std::vector<Sequence>> FindSequences(
    const fs::path& folder, const std::vector<std::string>& names) {
  std::error_code error;
  std::vector<Sequence> sequences;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    const std::string file = entry.path().filename().string();
    if (!file.ends_with(kTruthSuffix)) continue;
    const std::string name =
        file.substr(0, file.size() - std::string(kTruthSuffix).size());
    const fs::path video = folder / (name + ".mp4");
    if (fs::exists(video)) sequences.push_back({name, video, entry.path()});
  }
  if (error) {
    return absl::NotFoundError(
        absl::StrCat(folder.string(), ": ", error.message()));
  }
  for (const std::string& name : names) {
    if (std::none_of(sequences.begin(), sequences.end(), [&](const auto& s) {
          return s.name == name;
        })) {
      return absl::NotFoundError(absl::StrCat("--experiment ",
                                              name,
                                              ": there is no ",
                                              (folder / name).string(),
                                              ".mp4 with ",
                                              name,
                                              kTruthSuffix));
    }
  }
  if (!names.empty()) {
    std::erase_if(sequences, [&](const Sequence& s) {
      return std::find(names.begin(), names.end(), s.name) == names.end();
    });
  }
  if (sequences.empty()) {
    return absl::NotFoundError(absl::StrCat(
        folder.string(),
        ": no NAME.mp4 with a NAME_truth.csv beside it (groundlock "
        "simulate writes some)"));
  }
  std::sort(sequences.begin(),
            sequences.end(),
            [](const Sequence& a, const Sequence& b) {
              return std::pair(ThesisRank(a.name), a.name) <
                     std::pair(ThesisRank(b.name), b.name);
            });
  return sequences;
}

std::string MachineText() {
  std::ifstream file("/proc/cpuinfo");
  std::string model = "unknown processor";
  for (std::string line; std::getline(file, line);) {
    const std::size_t colon = line.find(": ");
    if (line.starts_with("model name") && colon != std::string::npos) {
      model = line.substr(colon + 2);
      break;
    }
  }
  return absl::StrCat(
      model, " (", std::thread::hardware_concurrency(), " cores)");
}

// A map that is on the server for as long as this object lives.
class BorrowedMap {
 public:
  explicit BorrowedMap(VerbContext& context) : context_(context) {}
  BorrowedMap(const BorrowedMap&) = delete;
  BorrowedMap& operator=(const BorrowedMap&) = delete;
  ~BorrowedMap() {
    if (!client_) return;
    const absl::Status status = client_->DeleteMap(name_);
    if (!status.ok()) {
      context_.err << "map " << name_
                   << " could not be deleted: " << status.message() << '\n';
    }
  }

  absl::Status Import(const fs::path& folder, std::uint64_t seed) {
    ASSIGN_OR_RETURN(const geometry::Similarity3 align,
                     ReadAlignment(folder / "align.json"));
    ASSIGN_OR_RETURN(auto client, Connect(context_));
    name_ = absl::StrFormat(
        "evaluation-%x-%x",
        getpid(),
        std::chrono::system_clock::now().time_since_epoch().count());
    ASSIGN_OR_RETURN(
        const sdk::ImportReport report,
        UploadMap(name_, folder / "map", align, seed, *client, context_));
    client_ = std::move(client);
    landmarks_ = report.map.num_landmarks;
    return absl::OkStatus();
  }
  const std::string& name() const { return name_; }
  std::uint64_t landmarks() const { return landmarks_; }

 private:
  VerbContext& context_;
  std::unique_ptr<sdk::Client> client_;  // set: the map is there
  std::string name_;
  std::uint64_t landmarks_ = 0;
};

// What all runs have in common.
struct Setting {
  std::string map_name;
  std::optional<geometry::CameraModel> camera;  // unset = the map's
  media::FrameRange frames;
  fs::path out;
  std::uint64_t seed = 0;
};

absl::StatusOr<EvaluatedRun> RunOnce(const Sequence& sequence,
                                     const std::vector<TruthRow>& truth,
                                     const Configuration& configuration,
                                     const Setting& setting,
                                     VerbContext& context) {
  EvaluatedRun run{configuration, {}, {}, {}};
  TrackOptions options;
  options.input = sequence.video.string();
  options.map_name = setting.map_name;
  options.camera = setting.camera;
  options.source.frames = setting.frames;
  options.session.localizer = configuration.localizer;
  options.session.tracker = configuration.tracker;
  options.session.seed = setting.seed;
  options.session.report_matches = true;  // for the pictures
  options.results =
      (setting.out /
       absl::StrCat(sequence.name, "_", configuration.Name(), ".csv"))
          .string();
  std::unordered_map<std::uint64_t, const TruthRow*> rows;
  std::optional<std::uint64_t> first;
  std::uint64_t last = 0;
  for (const TruthRow& row : truth) {
    if (row.frame < setting.frames.begin || row.frame >= setting.frames.end) {
      continue;
    }
    rows[row.frame] = &row;
    last = row.frame;
    if (first || !row.visible_box_px) continue;
    first = row.frame;
    options.targets.push_back({kTarget, *row.visible_box_px, row.frame});
  }
  if (rows.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        sequence.truth.string(), ": no row is of a frame that is asked for"));
  }
  const auto stills = StillFrames(truth, first.value_or(last), last);
  GroundTrails trails;
  options.observer = [&](const sdk::FrameResult& result,
                         const cv::Mat& bgr,
                         const geometry::CameraModel& camera) {
    const auto row = rows.find(result.sequence);
    if (row == rows.end()) return;
    trails.Add(result);
    run.frames.push_back(ScoreFrame(result, *row->second));
    const auto still = stills.find(result.sequence);
    if (still == stills.end() || bgr.empty()) return;
    run.stills.push_back(
        {result.sequence,
         still->second,
         DrawStill(camera, result, trails, *row->second, bgr)});
  };
  context.err << sequence.name << ", " << configuration.Name() << '\n';
  RETURN_IF_ERROR(
      base::Annotate(TrackRun(options, context).Run(), sequence.name));
  if (run.frames.size() != rows.size()) {
    context.err << "warning: " << sequence.name << ": the truth has "
                << rows.size() << " frames, " << run.frames.size()
                << " of them were answered\n";
  }
  if (run.frames.empty()) {
    return absl::DataLossError(absl::StrCat(sequence.video.string(),
                                            ": none of its frames is in ",
                                            sequence.truth.string()));
  }
  run.score = ScoreRun(run.frames);
  return run;
}

absl::StatusOr<fs::path> Folder(const EvaluateFlags& flags) {
  if (!flags.folder.empty()) return fs::path(flags.folder);
  const char* data = std::getenv("GROUNDLOCK_DATA");
  if (data != nullptr && *data != '\0') return fs::path(data) / "sim/lot";
  return absl::InvalidArgumentError(
      "FOLDER is missing (or --video, --truth and --map; or the environment's "
      "GROUNDLOCK_DATA, with sim/lot)");
}

// Where the sequences are, and the map that they are in.
absl::StatusOr<std::vector<Sequence>> Prepare(const EvaluateFlags& flags,
                                              BorrowedMap& map,
                                              Setting& setting,
                                              Evaluation& evaluation,
                                              VerbContext& context) {
  if (!flags.frames.empty()) {
    auto frames = ParseFrameRange(flags.frames);
    if (!frames.ok()) return base::Annotate(frames.status(), "--frames");
    setting.frames = *frames;
  }
  setting.out = flags.out;
  setting.seed = flags.seed;
  const bool is_video = !flags.video.empty();
  if (is_video != !flags.truth.empty() || is_video != !flags.map.empty()) {
    return absl::InvalidArgumentError(
        "--video, --truth and --map go together: none or all of them");
  }
  if (is_video && !flags.folder.empty()) {
    return absl::InvalidArgumentError("FOLDER and --video exclude each other");
  }
  if (!flags.camera.empty()) {
    ASSIGN_OR_RETURN(setting.camera, ReadCamera(flags.camera));
  }
  std::vector<Sequence> sequences;
  if (is_video) {
    setting.map_name = flags.map;
    const fs::path video = flags.video;
    sequences = {{video.stem().string(), video, flags.truth}};
    ASSIGN_OR_RETURN(const auto client, Connect(context));
    ASSIGN_OR_RETURN(const sdk::MapInfo info, client->GetMap(flags.map));
    evaluation.map_landmarks = info.num_landmarks;
    evaluation.data = video.filename().string();
    return sequences;
  }
  ASSIGN_OR_RETURN(const fs::path folder, Folder(flags));
  ASSIGN_OR_RETURN(sequences, FindSequences(folder, flags.experiments));
  if (!setting.camera) {
    ASSIGN_OR_RETURN(setting.camera, ReadCamera(folder / "camera.json"));
  }
  RETURN_IF_ERROR(map.Import(folder, flags.seed));
  setting.map_name = map.name();
  evaluation.map_landmarks = map.landmarks();
  evaluation.data = fs::absolute(folder).lexically_normal().filename().string();
  return sequences;
}

absl::Status MakeOut(const std::string& out) {
  std::error_code error;
  fs::create_directories(out, error);
  if (!error) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("--out ", out, ": ", error.message()));
}

absl::Status RunTrackers(const EvaluateFlags& flags, VerbContext& context) {
  if (flags.folder.empty()) {
    return absl::InvalidArgumentError(
        "--trackers: FOLDER is missing, with NAME.mp4 and NAME.txt, or "
        "NAME/img and NAME/groundtruth.txt");
  }
  RETURN_IF_ERROR(MakeOut(flags.out));
  return EvaluateTrackers({flags.folder,
                           flags.experiments,
                           flags.trackers,
                           flags.out,
                           flags.seed,
                           MachineText()},
                          context);
}

absl::Status RunEvaluate(const EvaluateFlags& flags, VerbContext& context) {
  if (flags.compare_trackers) return RunTrackers(flags, context);
  ASSIGN_OR_RETURN(const std::vector<Configuration> configurations,
                   Configurations(flags));
  RETURN_IF_ERROR(MakeOut(flags.out));
  Evaluation evaluation;
  evaluation.version = context.version;
  evaluation.machine = MachineText();
  Setting setting;
  BorrowedMap map(context);
  ASSIGN_OR_RETURN(const std::vector<Sequence> sequences,
                   Prepare(flags, map, setting, evaluation, context));
  for (const Sequence& sequence : sequences) {
    ASSIGN_OR_RETURN(const std::vector<TruthRow> truth,
                     ReadTruth(sequence.truth));
    Experiment& experiment = evaluation.experiments.emplace_back();
    experiment.name = sequence.name;
    experiment.video = sequence.video.filename().string();
    for (const Configuration& configuration : configurations) {
      ASSIGN_OR_RETURN(
          EvaluatedRun run,
          RunOnce(sequence, truth, configuration, setting, context));
      experiment.runs.push_back(std::move(run));
    }
  }
  const std::string json = ReportJson(evaluation);
  RETURN_IF_ERROR(
      base::WriteFileAtomically(setting.out / "evaluation.json", json));
  RETURN_IF_ERROR(base::WriteFileAtomically(setting.out / "report.html",
                                            ReportHtml(evaluation)));
  if (context.common.json) {
    context.out << json << '\n';
  } else {
    context.out << ReportText(evaluation) << "wrote "
                << (setting.out / "report.html").string() << " and "
                << (setting.out / "evaluation.json").string() << '\n';
  }
  return absl::OkStatus();
}

}  // namespace

void AddEvaluateVerb(CLI::App& app, VerbContext& context) {
  CLI::App* verb = app.add_subcommand(
      "evaluate",
      "Measure against a truth, in the figures of the thesis, and write a "
      "report");
  auto flags = std::make_shared<EvaluateFlags>();
  verb->add_option("FOLDER",
                   flags->folder,
                   "NAME.mp4 and NAME_truth.csv, map/, align.json and "
                   "camera.json, as simulate writes them [sim/lot in "
                   "$GROUNDLOCK_DATA]");
  verb->add_option("--experiment",
                   flags->experiments,
                   "Only this NAME of the folder; may be given several times")
      ->type_name("NAME")
      ->take_all()
      ->allow_extra_args(false);
  verb->add_option("--video", flags->video, "In place of a folder: a video")
      ->type_name("FILE");
  verb->add_option("--truth", flags->truth, "What is true of its frames")
      ->type_name("truth.csv");
  verb->add_option("--map", flags->map, "The map that its truth is in")
      ->type_name("NAME");
  verb->add_option(
          "--camera", flags->camera, "The lens [the folder's or map's]")
      ->type_name("camera.json");
  verb->add_option("--configuration",
                   flags->configurations,
                   "defaults, or LOCALIZER+TRACKER; may be given several times "
                   "[baseline+act, defaults]")
      ->type_name("NAME")
      ->take_all()
      ->allow_extra_args(false);
  verb->add_option("--frames", flags->frames, "Only the frames FROM to TO - 1")
      ->type_name("FROM:TO");
  CLI::Option* trackers = verb->add_flag(
      "--trackers",
      flags->compare_trackers,
      "Compare 2D trackers with those that are published: FOLDER has NAME.mp4 "
      "and NAME.txt, or NAME/img and NAME/groundtruth.txt (x,y,w,h per frame)");
  for (const char* other : {"--video",
                            "--truth",
                            "--map",
                            "--camera",
                            "--configuration",
                            "--frames"}) {
    trackers->excludes(verb->get_option(other));
  }
  verb->add_option("--tracker",
                   flags->trackers,
                   "With --trackers: one to measure; may be given several "
                   "times [dcf, act, csrt, kcf]")
      ->type_name("NAME")
      ->take_all()
      ->allow_extra_args(false)
      ->needs(trackers);
  verb->add_option("--out", flags->out, "Folder to write to")
      ->type_name("DIR")
      ->capture_default_str();
  verb->add_option("--seed", flags->seed, "Seed of everything random");
  AddCommonOptions(*verb, context);
  verb->callback([flags, &context] {
    context.run = [flags, &context] { return RunEvaluate(*flags, context); };
  });
}

}  // namespace groundlock::cli
