// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/build.h"

#include <sys/resource.h>

#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/image_features.h"
#include "map_store/build/internal/map_build.h"
#include "map_store/cage/child_process.h"

namespace groundlock::build {
namespace internal {
namespace {

namespace fs = std::filesystem;

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

}  // namespace

absl::Status MapBuild::Stage(const char* name,
                             const std::string& own_key,
                             const Work& work) {
  stage_ = name;
  key_ = HashOf(std::vector<std::string>{key_, name, own_key});
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

Colmap MapBuild::MakeColmap() const {
  return Colmap({.program = options_.colmap,
                 .log = folder_ / "colmap.log",
                 .threads = options_.threads,
                 .niceness = options_.niceness,
                 .memory_bytes = options_.memory_bytes,
                 .progress = [this](double fraction, const std::string& note) {
                   return Progress(fraction, note);
                 }});
}

absl::Status MapBuild::CheckColmap() const {
  const absl::Status status =
      cage::RunChildProcess({.arguments = {options_.colmap, "help"},
                             .log = folder_ / "colmap.log",
                             .niceness = 0,
                             .memory_bytes = options_.memory_bytes,
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
    ASSIGN_OR_RETURN(files, ListImages(options_.images));
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
  ASSIGN_OR_RETURN(const std::string inputs, HashOfFiles(files));
  key_ = HashOf(std::vector<std::string>{
      "4",
      inputs,
      options_.camera ? geometry::CameraModelToJson(*options_.camera) : ""});
  return absl::OkStatus();
}

absl::StatusOr<BuildResult> MapBuild::Run() {
  const bool is_video = !options_.video.empty();
  if (!is_video || options_.features == FeatureKind::kColmap) {
    RETURN_IF_ERROR(CheckColmap());
  }
  RETURN_IF_ERROR(HashInputs());
  if (is_video) {
    RETURN_IF_ERROR(MapVideo());
    RETURN_IF_ERROR(FindFeatures());
    RETURN_IF_ERROR(PlaceVideoLandmarks());
    RETURN_IF_ERROR(DescribeVideo());
  } else {
    images_ = options_.images;
    RETURN_IF_ERROR(FindFeatures());
    RETURN_IF_ERROR(MatchImages());
    RETURN_IF_ERROR(RunMapper());
    RETURN_IF_ERROR(RefineModel());
    RETURN_IF_ERROR(FinishMap());
  }
  RETURN_IF_ERROR(WriteReportFiles());
  return BuildResult{folder_ / "map", std::move(report_)};
}

}  // namespace internal

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
  if (max_images != 0 && max_images < internal::kMinImages) {
    return absl::InvalidArgumentError(absl::StrCat(
        "max_images: ", max_images, " is below ", internal::kMinImages));
  }
  if (threads < 0 || niceness < 0 || niceness > 19) {
    return absl::InvalidArgumentError("threads, niceness: out of range");
  }
  return keyframes.Validate();
}

absl::StatusOr<BuildResult> Build(const BuildOptions& options,
                                  const ProgressCallback& progress) {
  RETURN_IF_ERROR(options.Validate());
  ASSIGN_OR_RETURN(internal::StageLog log,
                   internal::StageLog::Open(options.work_folder));
  return internal::MapBuild(options, progress, std::move(log)).Run();
}

}  // namespace groundlock::build
