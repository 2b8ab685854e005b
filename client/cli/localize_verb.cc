// SPDX-License-Identifier: Apache-2.0
// groundlock localize IMAGE…
#include <CLI/CLI.hpp>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/atomic_file.h"
#include "client/cli/map_lens.h"
#include "client/cli/names.h"
#include "client/cli/parse.h"
#include "client/cli/priors.h"
#include "client/cli/progress.h"
#include "client/cli/results_csv.h"
#include "client/cli/verbs.h"
#include "client/media/frame_encoder.h"
#include "client/media/video_source.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct LocalizeFlags {
  std::vector<std::string> images;
  std::string map;
  std::string camera;
  std::string results;
  std::string localizer;
  std::string encoding = "auto";
  std::uint64_t seed = 0;
  PriorFlags prior;
};

// Folders stand for the images in them.
absl::StatusOr<std::vector<fs::path>> ExpandImages(
    const std::vector<std::string>& arguments) {
  std::vector<fs::path> images;
  for (const std::string& argument : arguments) {
    std::error_code error;
    if (fs::is_directory(argument, error)) {
      ASSIGN_OR_RETURN(const std::vector<fs::path> inside,
                       media::ListImages(argument));
      images.insert(images.end(), inside.begin(), inside.end());
    } else {
      images.emplace_back(argument);
    }
  }
  return images;
}

json ResultJson(const std::string& image,
                const absl::StatusOr<sdk::LocalizeReport>& report) {
  json object = {{"image", image}};
  if (!report.ok()) {
    object["error"] = std::string(report.status().message());
    return object;
  }
  object["camera_state"] = CameraStateName(report->camera.state);
  object["inliers"] = report->camera.num_inliers;
  object["total_ms"] = report->times.total_ms;
  if (const auto& pose = report->camera.world_from_camera) {
    object["center"] = {
        pose->translation.x(), pose->translation.y(), pose->translation.z()};
    object["world_from_camera_wxyz"] = {pose->rotation.w(),
                                        pose->rotation.x(),
                                        pose->rotation.y(),
                                        pose->rotation.z()};
  }
  return object;
}

std::string ResultText(const std::string& image,
                       const sdk::LocalizeReport& report) {
  std::string text =
      absl::StrFormat("%s  %s", image, CameraStateName(report.camera.state));
  if (const auto& pose = report.camera.world_from_camera) {
    absl::StrAppendFormat(&text,
                          "  at (%.3f, %.3f, %.3f)  %d inliers, %.2f px",
                          pose->translation.x(),
                          pose->translation.y(),
                          pose->translation.z(),
                          report.camera.num_inliers,
                          report.camera.mean_reprojection_error_px);
  }
  return text + "\n";
}

class LocalizeRun {
 public:
  LocalizeRun(const LocalizeFlags& flags, VerbContext& context)
      : flags_(flags), context_(context) {}

  absl::Status Run() {
    RETURN_IF_ERROR(Prepare());
    const Terminal terminal = StderrTerminal();
    Progress progress(context_.err,
                      {.label = "localize",
                       .total = images_.size(),
                       .unit = "images",
                       .terminal = terminal.is_terminal,
                       .columns = terminal.columns});
    for (size_t i = 0; i < images_.size(); ++i) {
      if (context_.interrupt.interrupted()) break;
      RETURN_IF_ERROR(One(i));
      progress.Update(i + 1, absl::StrCat(localised_, " localised"));
    }
    progress.Finish();
    if (csv_) RETURN_IF_ERROR(csv_->Finish());
    if (context_.common.json) {
      context_.out << results_.dump() << '\n';
    } else {
      context_.out << text_ << localised_ << " of " << images_.size()
                   << " images localised\n";
    }
    if (context_.interrupt.interrupted()) {
      return absl::CancelledError(
          "interrupted; the results up to there are kept");
    }
    // A picture that does not show the map is a result; one that cannot be
    // processed is an error.
    return first_error_;
  }

 private:
  absl::Status Prepare() {
    ASSIGN_OR_RETURN(images_, ExpandImages(flags_.images));
    if (!flags_.camera.empty()) {
      ASSIGN_OR_RETURN(camera_, ReadCamera(flags_.camera));
    }
    ASSIGN_OR_RETURN(prior_, PriorFromFlags(flags_.prior));
    ASSIGN_OR_RETURN(const media::EncodingChoice choice,
                     media::EncodingFromName(flags_.encoding));
    keep_bytes_ = choice == media::EncodingChoice::kAuto;
    encoding_ = media::ResolveEncoding(choice, context_.common.server);
    if (!flags_.results.empty()) {
      ASSIGN_OR_RETURN(csv_, AtomicFile::Create(flags_.results));
      RETURN_IF_ERROR(csv_->Append(LocalizeCsvHeader()));
    }
    ASSIGN_OR_RETURN(client_, Connect(context_));
    // Once, instead of with every image.
    if (camera_) return client_->GetMap(flags_.map).status();
    ASSIGN_OR_RETURN(lens_of_map_, LensOfMap(*client_, flags_.map));
    context_.err << "lens: that of map " << flags_.map << " ("
                 << LensText(lens_of_map_) << ")\n";
    return absl::OkStatus();
  }

  absl::StatusOr<sdk::LocalizeReport> Localize(const fs::path& path) {
    ASSIGN_OR_RETURN(const media::SourceFrame frame, media::ReadImage(path));
    sdk::LocalizeSpec spec;
    ASSIGN_OR_RETURN(spec.image,
                     media::EncodeFrame(frame, encoding_, keep_bytes_));
    spec.map_name = flags_.map;
    spec.camera = camera_;
    if (!camera_) {
      ASSIGN_OR_RETURN(const cv::Mat picture, media::DecodeFrame(frame));
      auto lens =
          LensForSize(lens_of_map_, flags_.map, picture.cols, picture.rows);
      if (!lens.ok()) return base::Annotate(lens.status(), path.string());
      spec.camera = *std::move(lens);
    }
    spec.localizer = flags_.localizer;
    spec.seed = flags_.seed;
    spec.prior = prior_;
    auto report = client_->Localize(spec);
    if (!report.ok()) return base::Annotate(report.status(), path.string());
    return report;
  }

  absl::Status One(size_t i) {
    const std::string image = images_[i].string();
    const absl::StatusOr<sdk::LocalizeReport> report = Localize(images_[i]);
    if (report.ok()) {
      if (report->camera.state == sdk::CameraState::kTracked) ++localised_;
      text_ += ResultText(image, *report);
    } else {
      context_.err << report.status().message() << '\n';
      if (first_error_.ok()) first_error_ = report.status();
    }
    results_.push_back(ResultJson(image, report));
    if (!csv_) return absl::OkStatus();
    return csv_->Append(report.ok() ? LocalizeCsvRow(i, *report, image)
                                    : LocalizeCsvEmptyRow(i, image));
  }

  const LocalizeFlags& flags_;
  VerbContext& context_;
  std::vector<fs::path> images_;
  std::optional<geometry::CameraModel> camera_;  // unset = lens_of_map_
  geometry::CameraModel lens_of_map_;
  std::optional<sdk::PosePrior> prior_;
  media::EncodingChoice encoding_ = media::EncodingChoice::kRaw;
  bool keep_bytes_ = true;
  std::unique_ptr<AtomicFile> csv_;
  std::unique_ptr<sdk::Client> client_;
  json results_ = json::array();
  std::string text_;
  size_t localised_ = 0;
  absl::Status first_error_;
};

}  // namespace

void AddLocalizeVerb(CLI::App& app, VerbContext& context) {
  CLI::App* verb =
      app.add_subcommand("localize", "Find the camera of single images");
  auto flags = std::make_shared<LocalizeFlags>();
  verb->add_option("IMAGE", flags->images, "Images, or folders of them")
      ->required();
  verb->add_option("--map", flags->map, "Map that the images show")
      ->type_name("NAME")
      ->required();
  verb->add_option(
          "--camera", flags->camera, "The camera's lens [the map's own]")
      ->type_name("camera.json");
  verb->add_option("--results", flags->results, "Results, one row per image")
      ->type_name("out.csv");
  verb->add_option("--localizer",
                   flags->localizer,
                   "How: fast or baseline [the server's default]");
  verb->add_option("--encoding", flags->encoding, "auto, jpeg, png or raw")
      ->capture_default_str();
  verb->add_option("--seed", flags->seed, "Seed of everything random");
  verb->add_option("--prior-position",
                   flags->prior.position,
                   "About where the camera was, in world: found sooner")
      ->type_name("X,Y,Z");
  verb->add_option("--prior-geodetic",
                   flags->prior.geodetic,
                   "The same on the Earth (WGS84, height above the "
                   "ellipsoid), if the map has an origin")
      ->type_name("LATITUDE,LONGITUDE,HEIGHT");
  verb->add_option("--prior-sigma",
                   flags->prior.sigma_m,
                   "Standard deviation of the prior position, per axis")
      ->type_name("M");
  AddCommonOptions(*verb, context);
  verb->callback([flags, &context] {
    context.run = [flags, &context] {
      return LocalizeRun(*flags, context).Run();
    };
  });
}

}  // namespace groundlock::cli
