// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/report.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/names_list.h"
#include "map_store/build/internal/report_pictures.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::build {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// Neighbours with fewer landmarks in common hang together badly.
constexpr int kFewCommonLandmarks = 30;
// A step of less than this share of the distance to what is seen, with a turn
// of more than kTurn_rad, is a turn on the spot: nothing new is triangulated.
constexpr double kSmallStep = 0.01;
constexpr double kTurn_rad = 0.05;
// Of images 1280 pixels wide; sound maps of photos and videos have 0.3 to 0.5.
constexpr double kPoorError_px = 0.8;
constexpr double kPoorErrorWidth_px = 1'280.0;

std::string Escaped(const std::string& text) {
  std::string html;
  for (const char c : text) {
    switch (c) {
      case '<':
        html += "&lt;";
        break;
      case '>':
        html += "&gt;";
        break;
      case '&':
        html += "&amp;";
        break;
      case '"':
        html += "&quot;";
        break;
      default:
        html += c;
    }
  }
  return html;
}

double MedianDepth(const map::MapData& data, const map::MapViewData& view) {
  std::vector<double> depths;
  for (const std::uint32_t landmark : view.landmarks) {
    depths.push_back(
        (view.camera_from_world * data.landmarks[landmark].p_world).z());
  }
  if (depths.empty()) return 0.0;
  const auto middle =
      depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  return *middle;
}

std::string Places(std::size_t count) {
  return count == 1 ? "1 place" : absl::StrCat(count, " places");
}

std::string HtmlReport(const BuildReport& report, const std::string& title) {
  std::string html = absl::StrCat(
      "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">"
      "<title>Map ",
      Escaped(title),
      "</title>\n<style>body{font:16px/1.5 sans-serif;max-width:60rem;"
      "margin:2rem auto;padding:0 1rem}table{border-collapse:collapse}"
      "td,th{padding:.2rem .8rem;text-align:left;border-bottom:1px solid #ccc}"
      "img{max-width:100%}.warning{background:#fff3cd;padding:.5rem 1rem}"
      ".missing{color:#a00}</style></head><body>\n<h1>Map ",
      Escaped(title),
      "</h1>\n");
  for (const std::string& warning : report.warnings) {
    absl::StrAppend(&html, "<p class=\"warning\">", Escaped(warning), "</p>\n");
  }
  const auto row = [&html](const std::string& name, const std::string& value) {
    absl::StrAppend(
        &html, "<tr><th>", name, "</th><td>", Escaped(value), "</td></tr>\n");
  };
  html += "<table>\n";
  row("Images",
      absl::StrCat(
          report.num_registered, " of ", report.images.size(), " in the map"));
  row("Landmarks", absl::StrCat(report.num_landmarks));
  row("Seen in",
      absl::StrFormat("%.1f images on average", report.mean_track_length));
  row("Reprojection error",
      absl::StrFormat("%.2f px on average", report.mean_reprojection_error_px));
  if (report.ground) {
    row("Ground",
        absl::StrFormat("estimated (+- %.1f deg; the cameras' height above it "
                        "+- %.0f %%), %d landmarks on it",
                        report.ground_sigma_deg,
                        100.0 * report.ground_height_sigma,
                        report.num_ground_landmarks));
  } else {
    row("Ground", absl::StrCat("unknown: ", report.ground_doubt));
  }
  row("Up",
      absl::StrCat("by ",
                   report.up_basis.empty() ? "the ways that cameras are held"
                                           : report.up_basis));
  for (const std::string& camera : report.cameras) row("Lens", camera);
  if (report.focal_sigma_px) {
    row("Focal length",
        absl::StrFormat("known to %.1f px (1 sigma)", *report.focal_sigma_px));
  }
  for (const StageReport& stage : report.stages) {
    row("Stage: " + stage.name,
        stage.was_there
            ? "was there already"
            : absl::StrFormat(
                  "%.1f s (%.1f s of computing)", stage.wall_s, stage.cpu_s));
  }
  html +=
      "</table>\n<h2>From above</h2>\n<p>Landmarks in their colours, cameras "
      "in "
      "red along their way; the grid's unit is the map's.</p>\n"
      "<img src=\"map_above.png\" alt=\"The map from above\">\n"
      "<h2>From the side</h2>\n<p>Across the direction in which the map is "
      "longest; the green line is the ground that was found, if one was. What "
      "should lie on the ground lies along it.</p>\n"
      "<img src=\"map_side.png\" alt=\"The map from the side\">\n"
      "<h2>Coverage</h2>\n<p>Where the map is good to be localised in: the "
      "more "
      "images have seen a place, the brighter it is.</p>\n"
      "<img src=\"coverage.png\" alt=\"Coverage\">\n<h2>Images</h2>\n<table>\n"
      "<tr><th>Image</th><th>Landmarks</th><th>Features</th><th>Sharpness</th>"
      "<th></th></tr>\n";
  for (const ImageReport& image : report.images) {
    absl::StrAppendFormat(&html,
                          "<tr%s><td>%s</td><td>%d</td><td>%d</td><td>%.2f%s</"
                          "td><td>%s</td></tr>\n",
                          image.is_registered ? "" : " class=\"missing\"",
                          Escaped(image.name),
                          image.num_landmarks,
                          image.num_features,
                          image.sharpness,
                          image.is_blurred ? " (blurred)" : "",
                          image.is_registered ? "" : "not in the map");
  }
  html += "</table>\n</body></html>\n";
  return html;
}

}  // namespace

void DescribeMap(const map::MapData& data,
                 std::uint64_t seed,
                 BuildReport* report) {
  std::map<std::string, const map::MapViewData*> views;
  for (const map::MapViewData& view : data.views) views[view.name] = &view;
  report->num_registered = 0;
  for (ImageReport& image : report->images) {
    const auto it = views.find(image.name);
    image.is_registered = it != views.end();
    image.num_landmarks = image.is_registered
                              ? static_cast<int>(it->second->landmarks.size())
                              : 0;
    report->num_registered += image.is_registered ? 1 : 0;
  }
  const map::ReprojectionStatistics statistics = map::ComputeReprojection(data);
  report->num_landmarks = data.landmarks.size();
  report->num_observations = statistics.num_observations;
  report->mean_reprojection_error_px = statistics.mean_error_px;
  report->mean_track_length =
      data.landmarks.empty()
          ? 0.0
          : static_cast<double>(statistics.num_observations) /
                static_cast<double>(data.landmarks.size());
  report->cameras.clear();
  for (const geometry::CameraModel& camera : data.cameras) {
    report->cameras.push_back(geometry::CameraModelToJson(camera));
  }
  map::MapData copy = data;
  report->ground.reset();
  report->num_ground_landmarks = 0;
  report->up_basis = data.measured_up ? data.measured_up->basis : "";
  const auto ground = map::AlignToEstimatedGround(seed, copy);
  if (!ground.ok()) {
    report->ground_doubt = std::string(ground.status().message());
  } else if (!ground->doubt.empty()) {
    report->ground_doubt = ground->doubt;
  } else {
    report->ground = ground->ground_source;
    report->ground_sigma_deg = ground->sigma_rad * 180.0 / std::numbers::pi;
    report->num_ground_landmarks = ground->num_inliers;
    report->ground_height_sigma = ground->height_sigma_share();
  }
}

std::vector<std::string> FindWeaknesses(const map::MapData& data,
                                        const BuildReport& report) {
  std::map<std::string, const map::MapViewData*> views;
  for (const map::MapViewData& view : data.views) views[view.name] = &view;
  std::vector<std::string> blurred;
  std::vector<std::string> apart;
  std::vector<std::string> turned;
  for (const ImageReport& image : report.images) {
    if (image.is_blurred) blurred.push_back(image.name);
  }
  for (std::size_t i = 0; i + 1 < report.images.size(); ++i) {
    const auto first = views.find(report.images[i].name);
    const auto second = views.find(report.images[i + 1].name);
    if (first == views.end() || second == views.end()) continue;
    const map::MapViewData& a = *first->second;
    const map::MapViewData& b = *second->second;
    const std::string names = absl::StrCat(a.name, " to ", b.name);
    const std::set<std::uint32_t> seen(a.landmarks.begin(), a.landmarks.end());
    const auto common = std::count_if(
        b.landmarks.begin(),
        b.landmarks.end(),
        [&seen](std::uint32_t landmark) { return seen.count(landmark) > 0; });
    if (common < kFewCommonLandmarks) apart.push_back(names);
    const geometry::Rigid3 b_from_a =
        b.camera_from_world * a.camera_from_world.Inverse();
    const double depth = MedianDepth(data, a);
    if (depth > 0.0 && b_from_a.translation.norm() < kSmallStep * depth &&
        geometry::AngleBetween_rad(
            b_from_a.rotation, Eigen::Quaterniond::Identity()) > kTurn_rad) {
      turned.push_back(names);
    }
  }
  std::vector<std::string> warnings;
  double width_px = kPoorErrorWidth_px;
  for (const geometry::CameraModel& camera : data.cameras) {
    width_px = std::max(width_px, static_cast<double>(camera.width_px()));
  }
  if (report.mean_reprojection_error_px >
      kPoorError_px * width_px / kPoorErrorWidth_px) {
    warnings.push_back(absl::StrFormat(
        "the images fit together only to %.1f px on average (0.3 to 0.5 is "
        "usual), so the map may be bent: film sideways rather than ahead, "
        "past things at different distances that stand still, and check the "
        "lens given with --camera",
        report.mean_reprojection_error_px));
  }
  const std::string cameras_apart = internal::NamesList(apart);
  if (!blurred.empty()) {
    warnings.push_back(
        absl::StrCat(blurred.size(),
                     " blurred images (",
                     internal::NamesList(blurred),
                     "): move more slowly there, or film in more light"));
  }
  if (!apart.empty()) {
    warnings.push_back(
        absl::StrCat("too little overlap at ",
                     Places(apart.size()),
                     " (",
                     cameras_apart,
                     "): if the images are one walk, take more of them there"));
  }
  if (!turned.empty()) {
    warnings.push_back(absl::StrCat(
        "the camera only turned at ",
        Places(turned.size()),
        " (",
        internal::NamesList(turned),
        "): step sideways while turning, so that distances can be measured"));
  }
  return warnings;
}

std::string ReportJson(const BuildReport& report) {
  json images = json::array();
  for (const ImageReport& image : report.images) {
    images.push_back({{"name", image.name},
                      {"registered", image.is_registered},
                      {"features", image.num_features},
                      {"landmarks", image.num_landmarks},
                      {"sharpness", image.sharpness},
                      {"blurred", image.is_blurred}});
  }
  json stages = json::array();
  double wall_s = 0.0;
  double cpu_s = 0.0;
  for (const StageReport& stage : report.stages) {
    stages.push_back({{"name", stage.name},
                      {"wall_s", stage.wall_s},
                      {"cpu_s", stage.cpu_s},
                      {"was_there", stage.was_there}});
    wall_s += stage.wall_s;
    cpu_s += stage.cpu_s;
  }
  json cameras = json::array();
  for (const std::string& camera : report.cameras) {
    cameras.push_back(json::parse(camera));
  }
  json ground = nullptr;
  if (report.ground) {
    ground = {{"normal",
               {report.ground->normal.x(),
                report.ground->normal.y(),
                report.ground->normal.z()}},
              {"d", report.ground->d},
              {"sigma_deg", report.ground_sigma_deg},
              {"height_sigma", report.ground_height_sigma},
              {"landmarks", report.num_ground_landmarks}};
  }
  return json{{"num_images", report.images.size()},
              {"num_registered", report.num_registered},
              {"num_landmarks", report.num_landmarks},
              {"num_observations", report.num_observations},
              {"mean_track_length", report.mean_track_length},
              {"mean_reprojection_error_px", report.mean_reprojection_error_px},
              {"cameras", cameras},
              {"focal_sigma_px",
               report.focal_sigma_px ? json(*report.focal_sigma_px) : json()},
              {"ground", ground},
              {"up_basis", report.up_basis},
              {"num_with_gps", report.num_with_gps},
              {"warnings", report.warnings},
              {"stages", stages},
              {"wall_s", wall_s},
              {"cpu_s", cpu_s},
              {"images", images}}
      .dump(-1, ' ', false, json::error_handler_t::replace);
}

namespace {

// For `track --camera`; one of an earlier build would be wrong.
absl::Status WriteLens(const map::MapData& data, const fs::path& file) {
  std::set<std::uint32_t> used;
  for (const map::MapViewData& view : data.views) used.insert(view.camera);
  bool is_one = !used.empty();
  for (const std::uint32_t camera : used) {
    is_one &= data.cameras[camera] == data.cameras[*used.begin()];
  }
  if (!is_one) {
    std::error_code error;
    fs::remove(file, error);
    return absl::OkStatus();
  }
  return base::WriteFileAtomically(
      file, geometry::CameraModelToJson(data.cameras[*used.begin()]) + "\n");
}

}  // namespace

absl::Status WriteReport(const BuildReport& report,
                         const map::MapData& data,
                         std::uint64_t seed,
                         const std::string& title,
                         const fs::path& folder) {
  map::MapData aligned = data;
  // Without a ground, the pictures are of the model's own axes.
  (void)map::AlignToEstimatedGround(seed, aligned).status().ok();
  RETURN_IF_ERROR(
      internal::WritePictureFromAbove(aligned, folder / "map_above.png"));
  RETURN_IF_ERROR(internal::WritePictureFromTheSide(
      aligned, report.ground.has_value(), folder / "map_side.png"));
  RETURN_IF_ERROR(
      internal::WriteCoveragePicture(aligned, folder / "coverage.png"));
  RETURN_IF_ERROR(WriteLens(data, folder / "camera.json"));
  RETURN_IF_ERROR(
      base::WriteFileAtomically(folder / "report.json", ReportJson(report)));
  return base::WriteFileAtomically(folder / "report.html",
                                   HtmlReport(report, title));
}

}  // namespace groundlock::build
