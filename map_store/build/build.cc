// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/build.h"

#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/child_process.h"
#include "map_store/build/internal/colmap.h"
#include "map_store/build/internal/image_features.h"
#include "map_store/build/internal/image_pairs.h"
#include "map_store/build/internal/map_filter.h"
#include "map_store/build/internal/names_list.h"
#include "map_store/build/internal/stage_log.h"
#include "map_store/build/internal/sub_models.h"
#include "map_store/build/internal/video_frames.h"
#include "map_store/formats/colmap_database.h"
#include "map_store/formats/formats.h"

namespace groundlock::build {
namespace {

namespace fs = std::filesystem;
using internal::StageLog;
using nlohmann::json;

// Two images are no map; three is what a landmark must be seen in.
constexpr std::size_t kMinImages = 3;
constexpr double kGuessedFocal = 1.2;  // of the larger side, as COLMAP guesses
constexpr double kRatioTest = 0.8;     // Lowe 2004
constexpr std::size_t kMinMatches = 30;
constexpr double kMaxError_px = 4.0;  // as COLMAP's mapper filters
constexpr std::size_t kMinObservations = 10;
// Below this share of registered images, a more lenient mapper is tried.
constexpr double kPoorlyRegistered = 0.5;
// Photos differ in what they show, too; so they count as blurred later than
// the frames of a video, which are compared with the next ones.
constexpr double kBlurredPhoto = 0.25;
constexpr std::uint64_t kMaxJsonBytes = 64 << 20;

double CpuSeconds() {
  double seconds = 0.0;
  for (const int who : {RUSAGE_SELF, RUSAGE_CHILDREN}) {
    rusage usage{};
    getrusage(who, &usage);
    for (const timeval& time : {usage.ru_utime, usage.ru_stime}) {
      seconds += static_cast<double>(time.tv_sec) +
                 1e-6 * static_cast<double>(time.tv_usec);
    }
  }
  return seconds;
}

absl::Status EmptyFolder(const fs::path& folder) {
  std::error_code error;
  fs::remove_all(folder, error);
  fs::create_directories(folder, error);
  if (!error) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("cannot create ", folder.string(), ": ", error.message()));
}

// One build in its work folder. The stages run in order; each either finds its
// result there, under the same key, or makes it.
class MapBuild {
 public:
  MapBuild(const BuildOptions& options,
           const ProgressCallback& progress,
           StageLog log)
      : options_(options),
        progress_(progress),
        log_(std::move(log)),
        folder_(options.work_folder),
        database_(folder_ / "database.db") {}

  absl::StatusOr<BuildResult> Run();

 private:
  using Work = std::function<absl::Status()>;

  // Runs `work` unless its result is there; extends the key for what follows.
  absl::Status Stage(const char* name,
                     const std::string& own_key,
                     const Work& work);
  bool Progress(double fraction, const std::string& note = {}) const {
    return !progress_ || progress_({stage_, fraction, note});
  }
  std::function<bool(std::size_t)> CountProgress(std::size_t total,
                                                 const char* what) const;
  internal::Colmap MakeColmap() const;

  absl::Status CheckColmap() const;
  absl::Status HashInputs();
  absl::Status ExtractFrames();
  absl::Status ExtractFeatures();
  absl::Status ReadFeatureFacts();
  absl::Status MatchImages();
  absl::Status RunMapper();
  absl::Status RefineModel();
  absl::Status FinishMap();
  absl::Status WriteReportFiles();
  absl::Status TooFewRegistered(std::size_t num_registered) const;
  fs::path pairs_file() const { return folder_ / "pairs.txt"; }

  const BuildOptions& options_;
  const ProgressCallback& progress_;
  StageLog log_;
  const fs::path folder_;
  const fs::path database_;
  fs::path images_;  // where the images lie
  std::string key_;  // of the last stage
  const char* stage_ = "";
  std::vector<std::string> model_images_;  // of the sub-model that was chosen
  BuildReport report_;
};

absl::Status MapBuild::Stage(const char* name,
                             const std::string& own_key,
                             const Work& work) {
  stage_ = name;
  key_ = internal::HashOf(std::vector<std::string>{key_, name, own_key});
  StageReport stage{.name = name};
  if (log_.IsDone(name, key_)) {
    stage.was_there = true;
  } else {
    if (!Progress(0.0)) return absl::CancelledError("cancelled");
    RETURN_IF_ERROR(log_.Begin(name));
    const auto start = std::chrono::steady_clock::now();
    const double cpu_start = CpuSeconds();
    RETURN_IF_ERROR(work());
    stage.cpu_s = CpuSeconds() - cpu_start;
    stage.wall_s =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
            .count();
    RETURN_IF_ERROR(log_.Finish(name, key_));
  }
  if (!Progress(1.0, stage.was_there ? "was there already" : "")) {
    return absl::CancelledError("cancelled");
  }
  report_.stages.push_back(stage);
  return absl::OkStatus();
}

std::function<bool(std::size_t)> MapBuild::CountProgress(
    std::size_t total, const char* what) const {
  return [this, total, what](std::size_t done) {
    return Progress(
        total == 0 ? 1.0
                   : static_cast<double>(done) / static_cast<double>(total),
        absl::StrCat(done, " of ", total, " ", what));
  };
}

internal::Colmap MapBuild::MakeColmap() const {
  return internal::Colmap(
      {.program = options_.colmap,
       .log = folder_ / "colmap.log",
       .threads = options_.threads,
       .niceness = options_.niceness,
       .progress = [this](double fraction, const std::string& note) {
         return Progress(fraction, note);
       }});
}

absl::Status MapBuild::CheckColmap() const {
  const absl::Status status =
      internal::RunChildProcess({.arguments = {options_.colmap, "help"},
                                 .log = folder_ / "colmap.log",
                                 .niceness = 0,
                                 .on_line = nullptr,
                                 .is_cancelled = nullptr});
  if (status.code() != absl::StatusCode::kNotFound) return status;
  return absl::NotFoundError(
      absl::StrCat(status.message(),
                   ": install COLMAP (on Debian: apt-get install colmap), or "
                   "name its program"));
}

absl::Status MapBuild::HashInputs() {
  std::vector<fs::path> files;
  if (options_.video.empty()) {
    ASSIGN_OR_RETURN(files, internal::ListImages(options_.images));
    if (files.size() < kMinImages) {
      return absl::InvalidArgumentError(
          absl::StrCat(options_.images.string(),
                       ": ",
                       files.size(),
                       " images; a map needs at least ",
                       kMinImages));
    }
  } else {
    files.push_back(options_.video);
  }
  ASSIGN_OR_RETURN(const std::string inputs, internal::HashOfFiles(files));
  key_ = internal::HashOf(std::vector<std::string>{
      "2",
      inputs,
      options_.camera ? geometry::CameraModelToJson(*options_.camera) : ""});
  return absl::OkStatus();
}

absl::Status MapBuild::ExtractFrames() {
  if (options_.video.empty()) {
    images_ = options_.images;
    return absl::OkStatus();
  }
  images_ = folder_ / "images";
  const KeyframeOptions& keyframes = options_.keyframes;
  return Stage(
      "frames",
      absl::StrCat(keyframes.spacing,
                   " ",
                   keyframes.min_survivors,
                   " ",
                   keyframes.blurred_below,
                   " ",
                   options_.max_images),
      [&]() -> absl::Status {
        ASSIGN_OR_RETURN(const std::vector<Keyframe> chosen,
                         internal::ExtractKeyframes(options_.video,
                                                    keyframes,
                                                    options_.max_images,
                                                    images_,
                                                    [this](double fraction) {
                                                      return Progress(fraction);
                                                    }));
        json blurred = json::array();
        for (const Keyframe& keyframe : chosen) {
          if (keyframe.is_blurred)
            blurred.push_back(internal::KeyframeName(keyframe));
        }
        if (chosen.size() < kMinImages) {
          return absl::FailedPreconditionError(absl::StrCat(
              options_.video.string(),
              ": only ",
              chosen.size(),
              " frames differ from each other; the camera has to move sideways "
              "through the place (or lower --spacing)"));
        }
        return base::WriteFileAtomically(folder_ / "blurred.json",
                                         blurred.dump());
      });
}

absl::Status MapBuild::ExtractFeatures() {
  ASSIGN_OR_RETURN(const std::vector<fs::path> files,
                   internal::ListImages(images_));
  const bool own = options_.features == FeatureKind::kGroundlock;
  const absl::Status extracted = Stage(
      "features",
      absl::StrCat(own, " ", options_.max_features),
      [&]() -> absl::Status {
        // Sharpness is measured in any case; few features then suffice.
        internal::ImageFeatureOptions extraction;
        extraction.max_features = own ? options_.max_features : 1;
        extraction.threads = options_.threads;
        ASSIGN_OR_RETURN(
            const std::vector<internal::ImageFeatures> features,
            internal::ExtractFeatures(
                files, extraction, CountProgress(files.size(), "images")));
        // One lens for all images of one size.
        std::map<std::pair<int, int>, std::uint32_t> cameras_by_size;
        std::vector<formats::ColmapDatabaseCamera> cameras;
        std::vector<formats::ColmapDatabaseImage> images;
        json facts = json::array();
        for (const internal::ImageFeatures& image : features) {
          const auto [it, is_new] = cameras_by_size.emplace(
              std::make_pair(image.width_px, image.height_px),
              static_cast<std::uint32_t>(cameras.size()));
          if (is_new && options_.camera) {
            if (image.width_px != options_.camera->width_px() ||
                image.height_px != options_.camera->height_px()) {
              return absl::InvalidArgumentError(
                  absl::StrCat(image.name,
                               ": ",
                               image.width_px,
                               "x",
                               image.height_px,
                               ", but the camera's images are ",
                               options_.camera->width_px(),
                               "x",
                               options_.camera->height_px()));
            }
            cameras.push_back({*options_.camera, true});
          } else if (is_new) {
            const double focal =
                kGuessedFocal * std::max(image.width_px, image.height_px);
            ASSIGN_OR_RETURN(const geometry::CameraModel guess,
                             geometry::CameraModel::Create(
                                 geometry::CameraModelId::kSimpleRadial,
                                 image.width_px,
                                 image.height_px,
                                 std::vector<double>{focal,
                                                     0.5 * image.width_px,
                                                     0.5 * image.height_px,
                                                     0.0}));
            cameras.push_back({guess, false});
          }
          images.push_back(
              {image.name, it->second, image.keypoints_px, image.descriptors});
          facts.push_back({{"name", image.name},
                           {"features", image.keypoints_px.size()},
                           {"sharpness", image.sharpness}});
        }
        RETURN_IF_ERROR(
            base::WriteFileAtomically(folder_ / "features.json", facts.dump()));
        if (own)
          return formats::CreateColmapDatabase(database_, cameras, images);
        if (cameras.size() > 1) {
          return absl::InvalidArgumentError(
              "images of different sizes: COLMAP's features need one lens; use "
              "the default features");
        }
        std::error_code error;
        fs::remove(database_, error);
        return MakeColmap().ExtractFeatures(
            database_, images_, options_.camera, options_.max_features);
      });
  RETURN_IF_ERROR(extracted);
  return ReadFeatureFacts();
}

absl::Status MapBuild::ReadFeatureFacts() {
  ASSIGN_OR_RETURN(const std::string content,
                   base::ReadFile(folder_ / "features.json", kMaxJsonBytes));
  const json facts = json::parse(content, nullptr, false);
  std::vector<double> sharpness;
  for (const json& fact : facts.is_array() ? facts : json::array()) {
    ImageReport image;
    image.name = fact.value("name", "");
    image.num_features = fact.value("features", 0);
    image.sharpness = fact.value("sharpness", 0.0);
    sharpness.push_back(image.sharpness);
    report_.images.push_back(std::move(image));
  }
  // Photos are compared with their neighbours here, frames were when chosen.
  std::set<std::string> blurred;
  if (const auto list = base::ReadFile(folder_ / "blurred.json", kMaxJsonBytes);
      list.ok() && !options_.video.empty()) {
    for (const json& name : json::parse(*list, nullptr, false)) {
      if (name.is_string()) blurred.insert(name.get<std::string>());
    }
  }
  constexpr std::ptrdiff_t kNeighbours = 7;
  const auto count = static_cast<std::ptrdiff_t>(sharpness.size());
  for (std::ptrdiff_t i = 0; i < count; ++i) {
    ImageReport& image = report_.images[static_cast<std::size_t>(i)];
    std::vector<double> near(
        sharpness.begin() + std::max<std::ptrdiff_t>(0, i - kNeighbours),
        sharpness.begin() + std::min(count, i + kNeighbours + 1));
    std::sort(near.begin(), near.end());
    image.is_blurred = blurred.count(image.name) > 0 ||
                       image.sharpness < options_.keyframes.blurred_below *
                                             near[near.size() / 2];
  }
  return absl::OkStatus();
}

absl::Status MapBuild::MatchImages() {
  const absl::Status matched =
      Stage("matching", absl::StrCat(options_.seed), [&]() -> absl::Status {
        ASSIGN_OR_RETURN(const std::vector<formats::ColmapDatabaseImage> images,
                         formats::ReadColmapFeatures(database_));
        std::vector<std::span<const map::Descriptor>> descriptors;
        for (const formats::ColmapDatabaseImage& image : images) {
          descriptors.emplace_back(image.descriptors);
        }
        internal::PairOptions choice;
        choice.seed = options_.seed;
        const std::vector<internal::ImagePair> pairs =
            internal::ChoosePairs(descriptors, choice);
        ASSIGN_OR_RETURN(
            const std::vector<internal::PairMatches> matches,
            internal::MatchPairs(descriptors,
                                 pairs,
                                 kRatioTest,
                                 kMinMatches,
                                 options_.threads,
                                 CountProgress(pairs.size(), "pairs")));
        std::vector<formats::ColmapPairMatches> stored;
        std::string list;
        for (const internal::PairMatches& match : matches) {
          if (match.features.empty()) continue;
          stored.push_back(
              {match.pair.first, match.pair.second, match.features});
          absl::StrAppend(&list,
                          images[match.pair.first].name,
                          " ",
                          images[match.pair.second].name,
                          "\n");
        }
        if (stored.empty()) return TooFewRegistered(0);
        RETURN_IF_ERROR(formats::AddColmapMatches(database_, stored));
        return base::WriteFileAtomically(pairs_file(), list);
      });
  RETURN_IF_ERROR(matched);
  return Stage("verifying", "", [&] {
    return MakeColmap().VerifyMatches(database_, pairs_file());
  });
}

absl::Status MapBuild::TooFewRegistered(std::size_t num_registered) const {
  std::string message = absl::StrCat("no map: only ",
                                     num_registered,
                                     " of ",
                                     report_.images.size(),
                                     " images could be put together. ");
  int neighbours = 0;
  int flat = 0;
  if (const auto pairs = formats::ReadColmapVerifiedPairs(database_);
      pairs.ok()) {
    for (const formats::ColmapVerifiedPair& pair : *pairs) {
      if (pair.image2 != pair.image1 + 1 || pair.num_inliers == 0) continue;
      ++neighbours;
      flat += pair.is_planar_or_rotation ? 1 : 0;
    }
  }
  if (neighbours > 0 && 2 * flat > neighbours) {
    absl::StrAppend(
        &message,
        "The camera only turned on the spot, or filmed one flat surface: "
        "walk sideways, past things at different distances.");
  } else if (3 * neighbours < static_cast<int>(report_.images.size())) {
    absl::StrAppend(
        &message,
        "Neighbouring images have too little in common: film more slowly, "
        "so that they overlap by two thirds, and where there is texture.");
  } else {
    absl::StrAppend(
        &message,
        "Film sideways through the place in one walk, in good light, and "
        "give the lens with --camera if you know it.");
  }
  return absl::FailedPreconditionError(message);
}

absl::Status MapBuild::RunMapper() {
  const fs::path sparse = folder_ / "sparse";
  return Stage("mapping", "", [&]() -> absl::Status {
    internal::Colmap::MapperOptions mapper;
    mapper.fix_lens = options_.camera.has_value();
    mapper.num_images = report_.images.size();
    std::size_t best = 0;
    for (const bool lenient : {false, true}) {
      const fs::path output = folder_ / (lenient ? "sparse_lenient" : "sparse");
      RETURN_IF_ERROR(EmptyFolder(output));
      mapper.lenient = lenient;
      const absl::Status status =
          MakeColmap().RunMapper(database_, images_, output, mapper);
      if (status.code() == absl::StatusCode::kCancelled ||
          status.code() == absl::StatusCode::kNotFound) {
        return status;
      }
      // COLMAP exits with an error when it found no model; others repeat.
      ASSIGN_OR_RETURN(const std::vector<internal::SubModel> models,
                       internal::ReadSubModels(output));
      if (models.empty()) {
        if (lenient) break;
        continue;
      }
      const std::size_t size =
          models[internal::ChooseSubModel(models)].images.size();
      if (lenient && size > best) {
        std::error_code error;
        fs::remove_all(sparse, error);
        fs::rename(output, sparse, error);
      }
      best = std::max(best, size);
      if (static_cast<double>(best) >=
          kPoorlyRegistered * static_cast<double>(report_.images.size())) {
        break;
      }
    }
    return best >= kMinImages ? absl::OkStatus() : TooFewRegistered(best);
  });
}

absl::Status MapBuild::RefineModel() {
  ASSIGN_OR_RETURN(const std::vector<internal::SubModel> models,
                   internal::ReadSubModels(folder_ / "sparse"));
  if (models.empty()) {
    return absl::DataLossError(absl::StrCat(
        folder_.string(), ": the mapper's models are gone; remove the folder"));
  }
  const std::size_t chosen = internal::ChooseSubModel(models);
  std::vector<std::string> names;
  for (const ImageReport& image : report_.images) names.push_back(image.name);
  report_.warnings = internal::DescribeGaps(names, models, chosen);
  model_images_ = models[chosen].images;
  return Stage("refining", absl::StrCat(chosen), [&]() -> absl::Status {
    const fs::path refined = folder_ / "refined";
    RETURN_IF_ERROR(EmptyFolder(refined));
    return MakeColmap().Adjust(
        models[chosen].path, refined, options_.camera.has_value());
  });
}

absl::Status MapBuild::FinishMap() {
  return Stage("finishing",
               absl::StrCat("2 ", options_.min_views),
               [&]() -> absl::Status {
                 formats::ImportOptions import;
                 import.format = formats::Format::kColmap;
                 import.database = database_;
                 std::vector<std::string> warnings;
                 ASSIGN_OR_RETURN(
                     map::MapData data,
                     formats::Import(folder_ / "refined", import, &warnings));
                 std::vector<internal::VerifiedPair> verified;
                 ASSIGN_OR_RETURN(const auto pairs,
                                  formats::ReadColmapVerifiedPairs(database_));
                 for (const formats::ColmapVerifiedPair& pair : pairs) {
                   if (pair.image2 >= report_.images.size()) continue;
                   verified.push_back({report_.images[pair.image1].name,
                                       report_.images[pair.image2].name,
                                       pair.num_inliers});
                 }
                 internal::DropMisplacedViews(verified, &data);
                 internal::FilterMap(options_.min_views, kMaxError_px, &data);
                 internal::DropEmptyViews(kMinObservations, &data);
                 if (data.views.size() < kMinImages)
                   return TooFewRegistered(data.views.size());
                 std::error_code error;
                 fs::remove_all(folder_ / "map", error);
                 return formats::Export(data,
                                        formats::ExportFormat::kColmapBinary,
                                        folder_ / "map");
               });
}

absl::Status MapBuild::WriteReportFiles() {
  std::vector<std::string> warnings;
  ASSIGN_OR_RETURN(const map::MapData data,
                   formats::Import(folder_ / "map", {}, &warnings));
  DescribeMap(data, options_.seed, &report_);
  std::vector<std::string> taken_out;
  for (const ImageReport& image : report_.images) {
    if (!image.is_registered &&
        std::find(model_images_.begin(), model_images_.end(), image.name) !=
            model_images_.end()) {
      taken_out.push_back(image.name);
    }
  }
  if (!taken_out.empty()) {
    report_.warnings.push_back(
        absl::StrCat(taken_out.size(),
                     " images were taken out again (",
                     internal::NamesList(taken_out),
                     "): they saw too little, or were put where another place "
                     "looks the same"));
  }
  for (std::string& weakness : FindWeaknesses(data, report_)) {
    report_.warnings.push_back(std::move(weakness));
  }
  const fs::path& input =
      options_.video.empty() ? options_.images : options_.video;
  return WriteReport(report_,
                     data,
                     options_.seed,
                     input.has_filename()
                         ? input.filename().string()
                         : input.parent_path().filename().string(),
                     folder_);
}

absl::StatusOr<BuildResult> MapBuild::Run() {
  RETURN_IF_ERROR(CheckColmap());
  RETURN_IF_ERROR(HashInputs());
  RETURN_IF_ERROR(ExtractFrames());
  RETURN_IF_ERROR(ExtractFeatures());
  RETURN_IF_ERROR(MatchImages());
  RETURN_IF_ERROR(RunMapper());
  RETURN_IF_ERROR(RefineModel());
  RETURN_IF_ERROR(FinishMap());
  RETURN_IF_ERROR(WriteReportFiles());
  return BuildResult{folder_ / "map", std::move(report_)};
}

}  // namespace

absl::Status BuildOptions::Validate() const {
  if (video.empty() == images.empty()) {
    return absl::InvalidArgumentError(
        "video, images: give either a video or a folder of photos");
  }
  if (work_folder.empty())
    return absl::InvalidArgumentError("work_folder: empty");
  if (max_features < 100) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_features: ", max_features, " is below 100"));
  }
  if (min_views < 2) {
    return absl::InvalidArgumentError(
        absl::StrCat("min_views: ", min_views, " is below 2"));
  }
  if (max_images != 0 && max_images < kMinImages) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_images: ", max_images, " is below ", kMinImages));
  }
  if (threads < 0 || niceness < 0 || niceness > 19) {
    return absl::InvalidArgumentError("threads, niceness: out of range");
  }
  return keyframes.Validate();
}

absl::StatusOr<BuildResult> Build(const BuildOptions& options,
                                  const ProgressCallback& progress) {
  RETURN_IF_ERROR(options.Validate());
  ASSIGN_OR_RETURN(StageLog log, StageLog::Open(options.work_folder));
  return MapBuild(options, progress, std::move(log)).Run();
}

}  // namespace groundlock::build
