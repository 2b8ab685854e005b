// SPDX-License-Identifier: Apache-2.0
// groundlock evaluate …
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <thread>
#include <unordered_map>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "client/cli/evaluate/evaluation.h"
#include "client/cli/map_output.h"
#include "client/cli/overlay.h"
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

// Frames to show: where the target is marked, while it is hidden, half a second
// after it is seen again (or half way, where it never hides), and at the end.
std::unordered_map<std::uint64_t, std::string> StillFrames(
    const std::vector<TruthRow>& truth,
    std::uint64_t first,
    std::uint64_t last) {
  std::unordered_map<std::uint64_t, std::string> frames;
  frames[last] = "the last";
  std::optional<std::uint64_t> hidden, seen_again;
  std::uint64_t hidden_to = 0;
  for (const TruthRow& row : truth) {
    if (row.frame < first || row.frame > last || !row.target_world) continue;
    if (row.seen_fraction < kHiddenFraction) {
      if (!hidden) hidden = row.frame;
      if (!seen_again) hidden_to = row.frame;
    } else if (hidden && !seen_again && row.seen_fraction > kSeenFraction) {
      seen_again = row.frame;
    }
  }
  if (hidden) {
    frames[(*hidden + hidden_to) / 2] = "out of sight";
    if (seen_again) {
      frames[std::min(last, *seen_again + 12)] =
          "half a second after it is seen again";
    }
  } else {
    frames[(first + last) / 2] = "half way";
  }
  frames[first] = "the first with the target";
  return frames;
}

// The overlay, and in its corner the true place of a small target, enlarged.
std::string DrawStill(const geometry::CameraModel& camera,
                      const sdk::FrameResult& result,
                      const GroundTrails& trails,
                      const TruthRow& truth,
                      const cv::Mat& picture) {
  constexpr int kWidth = 640, kZoom = 3, kQuality = 80;
  cv::Mat bgr = picture.clone();
  DrawOverlay(camera, result, trails, OverlayColours{}, bgr);
  std::optional<Eigen::Vector2d> center;
  if (truth.target_world) {
    const Eigen::Vector3d p_camera =
        truth.world_from_camera.Inverse() * *truth.target_world;
    if (p_camera.z() > 0.1) center = camera.ImageFromCamera(p_camera);
  }
  const cv::Size inset(bgr.cols / 3, bgr.rows / 3);
  const cv::Rect image({}, bgr.size());
  const bool is_small =
      truth.visible_box_px && truth.visible_box_px->width() < inset.width / 2.0;
  if (center && is_small &&
      image.contains(cv::Point(static_cast<int>(center->x()),
                               static_cast<int>(center->y())))) {
    const cv::Size part(inset.width / kZoom, inset.height / kZoom);
    const cv::Rect at(
        std::clamp(static_cast<int>(center->x()) - part.width / 2,
                   0,
                   bgr.cols - part.width),
        std::clamp(static_cast<int>(center->y()) - 2 * part.height / 3,
                   0,
                   bgr.rows - part.height),
        part.width,
        part.height);
    cv::Mat enlarged;
    cv::resize(bgr(at), enlarged, inset, 0, 0, cv::INTER_CUBIC);
    const cv::Rect corner(bgr.cols - inset.width,
                          bgr.rows - inset.height,
                          inset.width,
                          inset.height);
    enlarged.copyTo(bgr(corner));
    cv::rectangle(bgr, corner, cv::Scalar::all(255), 2);
    cv::rectangle(bgr, at, cv::Scalar::all(255), 1);
  }
  cv::Mat small;
  const int height = std::max(1, bgr.rows * kWidth / bgr.cols);
  cv::resize(bgr, small, {kWidth, height}, 0, 0, cv::INTER_AREA);
  std::vector<std::uint8_t> bytes;
  cv::imencode(".jpg", small, bytes, {cv::IMWRITE_JPEG_QUALITY, kQuality});
  return {bytes.begin(), bytes.end()};
}

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

absl::Status RunEvaluate(const EvaluateFlags& flags, VerbContext& context) {
  ASSIGN_OR_RETURN(const std::vector<Configuration> configurations,
                   Configurations(flags));
  std::error_code error;
  fs::create_directories(flags.out, error);
  if (error) {
    return absl::InvalidArgumentError(
        absl::StrCat("--out ", flags.out, ": ", error.message()));
  }
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
