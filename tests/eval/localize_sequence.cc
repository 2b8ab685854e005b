// SPDX-License-Identifier: Apache-2.0
// Localises a video in a map, without a server, and compares the poses with a
// truth or reference. Prints one line per figure; poses go to a CSV on request.
//   localize_sequence MAP CAMERA.json VIDEO POSES.csv [--align align.json] ...
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <deque>
#include <fstream>
#include <functional>
#include <map>
#include <opencv2/videoio.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "client/cli/imu.h"
#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "map_store/map/map.h"
#include "server/localization/localizer.h"
#include "server/localization/search/lens_check.h"
#include "tests/support/cut_map.h"
#include "tests/support/recorded_data.h"

namespace groundlock {
namespace {

struct Arguments {
  std::string map;
  std::string camera;
  std::string video;
  std::string poses;
  std::string align;
  std::string results;
  std::string localizer = "baseline";
  int stride = 1;
  localization::LocalizerOptions options;
  double frames_per_second = 24.0;
  bool mask_target = false;
  std::string residuals;
  int jpeg_quality = 0;
  std::vector<int> blank;   // first and one past the last frame
  std::vector<double> cut;  // plane: normal and d
  // Frames by which every anchor is held back, as on a busy machine; unset:
  // as in a lossless session.
  std::optional<int> anchor_lag;
  std::string imu;
  std::string imu_model;
  double focal_ratio = 1.0;  // the lens is taken for another
  // Every so many frames another localizer goes on with what the one before
  // knows; 0: never.
  int move_every = 0;
};

// As the server takes a client's.
localization::ImuModel ModelOf(const sdk::ImuModel& imu) {
  localization::ImuModel model;
  model.imu_from_camera = imu.imu_from_camera;
  model.gyroscope_noise_rad_s_sqrt_hz =
      imu.gyroscope_noise_rad_s_sqrt_hz.value_or(
          model.gyroscope_noise_rad_s_sqrt_hz);
  model.gyroscope_walk_rad_s2_sqrt_hz =
      imu.gyroscope_walk_rad_s2_sqrt_hz.value_or(
          model.gyroscope_walk_rad_s2_sqrt_hz);
  model.gyroscope_bias_rad_s =
      imu.gyroscope_bias_rad_s.value_or(model.gyroscope_bias_rad_s);
  return model;
}

std::vector<localization::InertialSample> SamplesOf(
    const std::vector<sdk::InertialSample>& given) {
  std::vector<localization::InertialSample> samples;
  for (const sdk::InertialSample& sample : given) {
    samples.push_back(
        {sample.time, sample.angular_rate_rad_s, sample.acceleration_m_s2});
  }
  return samples;
}

// Runs what is to run in the background so many frames later.
class LateRunner {
 public:
  explicit LateRunner(int lag_frames) : lag_frames_(lag_frames) {}
  localization::BackgroundRunner Runner() {
    return [this](localization::Urgency, std::function<void()> task) {
      waiting_.emplace_back(frame_ + lag_frames_, std::move(task));
    };
  }
  void BeginFrame() {
    ++frame_;
    while (!waiting_.empty() && waiting_.front().first <= frame_) {
      waiting_.front().second();
      waiting_.pop_front();
    }
  }

 private:
  const int lag_frames_;
  int frame_ = 0;
  std::deque<std::pair<int, std::function<void()>>> waiting_;
};

using test_support::Quantile;

// Rows of a CSV with a header, by frame number; empty cells are left out.
using Row = std::map<std::string, double>;

std::map<int, Row> ReadPoses(const std::string& path) {
  std::map<int, Row> rows;
  std::ifstream file(path);
  std::string line;
  std::vector<std::string> names;
  while (std::getline(file, line)) {
    std::vector<std::string> cells;
    std::istringstream stream(line);
    for (std::string cell; std::getline(stream, cell, ',');) {
      cells.push_back(cell);
    }
    if (names.empty()) {
      names = cells;
      continue;
    }
    Row row;
    for (std::size_t i = 0; i < std::min(cells.size(), names.size()); ++i) {
      if (!cells[i].empty()) row[names[i]] = std::stod(cells[i]);
    }
    rows[static_cast<int>(row.at("frame"))] = row;
  }
  return rows;
}

geometry::Rigid3 PoseOf(const Row& row) {
  return {Eigen::Quaterniond(
              row.at("q_w"), row.at("q_x"), row.at("q_y"), row.at("q_z"))
              .normalized(),
          {row.at("cam_x"), row.at("cam_y"), row.at("cam_z")}};
}

double Mean(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return values.empty() ? std::nan("")
                        : sum / static_cast<double>(values.size());
}

// Diagonal of the box that holds 90 % of the landmarks along each axis.
double Extent(const map::Map& map) {
  Eigen::Vector3d size;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double> values;
    for (const map::Landmark& landmark : map.landmarks()) {
      values.push_back(landmark.p_world[axis]);
    }
    size[axis] = Quantile(values, 0.95) - Quantile(values, 0.05);
  }
  return size.norm();
}

double Degrees(double rad) { return rad * 180.0 / M_PI; }

geometry::Vector6d PoseError(const localization::LocalizationResult& result,
                             const geometry::Rigid3& truth) {
  const geometry::Rigid3& pose = *result.world_from_camera;
  geometry::Vector6d error;
  error << truth.translation - pose.translation,
      geometry::RotationVector(truth.rotation * pose.rotation.conjugate());
  return error;
}

// Of this thread.
double CpuMs() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) +
         1e-6 * static_cast<double>(now.tv_nsec);
}

class Statistics {
 public:
  void Add(const localization::LocalizationResult& result,
           double cpu_ms,
           const geometry::Rigid3* truth) {
    values_["CPU, ms"].push_back(cpu_ms);
    const auto& report = result.report;
    const auto add_ms = [&](const char* name, std::chrono::nanoseconds time) {
      values_[name].push_back(
          std::chrono::duration<double, std::milli>(time).count());
    };
    add_ms("time features, ms", report.features_time);
    add_ms("time matching, ms", report.matching_time);
    add_ms("time ransac, ms", report.ransac_time);
    add_ms("time refinement, ms", report.refinement_time);
    values_["features"].push_back(report.num_features);
    values_["views tried"].push_back(report.views_tried);
    ++frames_;
    if (result.world_from_camera && truth != nullptr) {
      const geometry::Vector6d error = PoseError(result, *truth);
      values_["any pose: centre error"].push_back(error.head<3>().norm());
      values_["any pose: angle, deg"].push_back(
          Degrees(error.tail<3>().norm()));
    }
    if (result.state == localization::CameraState::kHeld && truth != nullptr) {
      const geometry::Vector6d error = PoseError(result, *truth);
      values_["held: centre error"].push_back(error.head<3>().norm());
      values_["held: angle, deg"].push_back(Degrees(error.tail<3>().norm()));
    }
    values_["resets"] = {static_cast<double>(result.reset_count)};
    if (result.state == localization::CameraState::kOdometry) {
      AddOdometry(result, truth);
    } else {
      way_ = 0.0;
      last_.reset();
    }
    if (result.state != localization::CameraState::kTracked) return;
    ++tracked_;
    values_["inliers"].push_back(result.num_inliers);
    values_["matches"].push_back(report.num_matches);
    values_["ransac iterations"].push_back(report.ransac_iterations);
    values_["reprojection, px"].push_back(result.mean_reprojection_error_px);
    if (truth == nullptr) return;
    const geometry::Vector6d error = PoseError(result, *truth);
    values_["centre error"].push_back(error.head<3>().norm());
    values_["angle error, deg"].push_back(Degrees(error.tail<3>().norm()));
    values_["nees centre (3)"].push_back(error.head<3>().dot(
        result.covariance.topLeftCorner<3, 3>().ldlt().solve(error.head<3>())));
    values_["nees rotation (3)"].push_back(error.tail<3>().dot(
        result.covariance.bottomRightCorner<3, 3>().ldlt().solve(
            error.tail<3>())));
    values_["nees pose (6)"].push_back(
        error.dot(result.covariance.ldlt().solve(error)));
  }

  // Errors as they grow with the way since the map was left.
  void AddOdometry(const localization::LocalizationResult& result,
                   const geometry::Rigid3* truth) {
    ++odometry_;
    if (truth == nullptr) return;
    if (last_) way_ += (truth->translation - *last_).norm();
    last_ = truth->translation;
    const geometry::Vector6d error = PoseError(result, *truth);
    const double centre = error.head<3>().norm();
    values_["odometry: centre error"].push_back(centre);
    values_["odometry: way"].push_back(way_);
    values_["odometry: over 1 % + 2 cm"].push_back(
        std::max(0.0, centre - 0.01 * way_ - 0.02));
    values_["odometry: nees centre (3)"].push_back(error.head<3>().dot(
        result.covariance.topLeftCorner<3, 3>().ldlt().solve(error.head<3>())));
  }

  void Print(double extent) const {
    std::printf("odometry %d\n", odometry_);
    std::printf("frames %d, tracked %d (%.2f %%), scene extent %.3f\n",
                frames_,
                tracked_,
                100.0 * tracked_ / std::max(frames_, 1),
                extent);
    const auto errors = values_.find("centre error");
    if (errors != values_.end()) {
      const auto above = [&](double bound) {
        return std::count_if(errors->second.begin(),
                             errors->second.end(),
                             [&](double error) { return error > bound; });
      };
      std::printf("tracked, centre off by more than 0.03: %td, 0.1: %td\n",
                  above(0.03),
                  above(0.1));
    }
    for (const auto& [name, values] : values_) {
      std::printf("%-22s mean %9.4f  median %9.4f  95%% %9.4f  max %9.4f\n",
                  name.c_str(),
                  Mean(values),
                  Quantile(values, 0.5),
                  Quantile(values, 0.95),
                  Quantile(values, 1.0));
    }
  }

 private:
  std::map<std::string, std::vector<double>> values_;
  int frames_ = 0;
  int tracked_ = 0;
  int odometry_ = 0;
  double way_ = 0.0;
  std::optional<Eigen::Vector3d> last_;
};

void WriteRow(std::FILE* file,
              int index,
              const localization::LocalizationResult& result) {
  std::fprintf(file, "%d,%d", index, static_cast<int>(result.state));
  if (result.world_from_camera) {
    const Eigen::Vector3d& p = result.world_from_camera->translation;
    const Eigen::Quaterniond& q = result.world_from_camera->rotation;
    std::fprintf(
        file,
        ",%.6f,%.6f,%.6f,%.9f,%.9f,%.9f,%.9f,%d,%.6f,%.6f",
        p.x(),
        p.y(),
        p.z(),
        q.w(),
        q.x(),
        q.y(),
        q.z(),
        result.num_inliers,
        std::sqrt(result.covariance.topLeftCorner<3, 3>().trace()),
        std::sqrt(result.covariance.bottomRightCorner<3, 3>().trace()));
  }
  std::fprintf(file, "\n");
}

// What each followed landmark is off by, were the camera where it truly is.
void WriteResiduals(std::FILE* file,
                    int index,
                    const localization::LocalizationResult& result,
                    const map::Map& map,
                    const geometry::CameraModel& camera,
                    const geometry::Rigid3& truth) {
  for (const localization::LandmarkMatch& match : result.inliers) {
    const Eigen::Vector3d p_camera =
        truth.Inverse() * map.landmarks()[match.landmark].Position();
    const auto pixel = camera.ImageFromCamera(p_camera);
    if (!pixel) continue;
    const Eigen::Vector2d residual = match.pixel_px - *pixel;
    std::fprintf(file,
                 "%d,%u,%.3f,%.3f,%.3f,%.3f,%.3f\n",
                 index,
                 match.landmark,
                 match.pixel_px.x(),
                 match.pixel_px.y(),
                 residual.x(),
                 residual.y(),
                 p_camera.z());
  }
}

absl::Status Run(const Arguments& arguments) {
  ASSIGN_OR_RETURN(auto map,
                   test_support::ImportMap(arguments.map, arguments.align));
  if (arguments.cut.size() == 4) {
    const geometry::Plane plane{
        Eigen::Vector3d(arguments.cut.data()).normalized(), arguments.cut[3]};
    ASSIGN_OR_RETURN(
        map,
        test_support::WriteAndOpen(test_support::CutMap(map->ToData(), plane)));
  }
  ASSIGN_OR_RETURN(auto camera, test_support::ReadCamera(arguments.camera));
  if (arguments.focal_ratio != 1.0) {
    const auto other =
        localization::WithFocalRatio(camera, arguments.focal_ratio);
    if (!other) return absl::InvalidArgumentError("--focal-ratio");
    camera = *other;
  }
  LateRunner late(arguments.anchor_lag.value_or(0));
  localization::LocalizerOptions options = arguments.options;
  cli::InertialTrack inertial;
  if (!arguments.imu.empty()) {
    ASSIGN_OR_RETURN(const auto imu, cli::ReadImu(arguments.imu_model));
    options.imu = ModelOf(imu);
    ASSIGN_OR_RETURN(auto samples, cli::ReadInertial(arguments.imu));
    inertial = cli::InertialTrack(std::move(samples), {});
  }
  options.wait_for_anchor = !arguments.anchor_lag.has_value();
  const auto create = [&] {
    return localization::CreateLocalizer(
        arguments.localizer,
        map,
        options,
        arguments.anchor_lag ? late.Runner()
                             : localization::BackgroundRunner());
  };
  ASSIGN_OR_RETURN(auto localizer, create());
  std::size_t largest_state_bytes = 0;
  const std::map<int, Row> rows = ReadPoses(arguments.poses);
  cv::VideoCapture video(arguments.video);
  if (!video.isOpened()) return absl::NotFoundError(arguments.video);
  std::FILE* results = nullptr;
  if (!arguments.results.empty()) {
    results = std::fopen(arguments.results.c_str(), "w");
    if (results == nullptr) return absl::NotFoundError(arguments.results);
    std::fprintf(results,
                 "frame,state,cam_x,cam_y,cam_z,q_w,q_x,q_y,q_z,inliers,"
                 "centre_sigma,angle_sigma_rad\n");
  }
  std::FILE* residuals = nullptr;
  if (!arguments.residuals.empty()) {
    residuals = std::fopen(arguments.residuals.c_str(), "w");
    if (residuals == nullptr) return absl::NotFoundError(arguments.residuals);
    std::fprintf(residuals, "frame,landmark,x,y,dx,dy,depth\n");
  }
  Statistics statistics;
  std::optional<localization::LensContradiction> lens_contradiction;
  for (int index = 0; video.grab(); ++index) {
    if (index % arguments.stride != 0) continue;
    cv::Mat bgr;
    video.retrieve(bgr);
    if (arguments.blank.size() == 2 && index >= arguments.blank[0] &&
        index < arguments.blank[1]) {
      bgr.setTo(0);
    }
    image::Frame frame = image::Frame::FromBgr(bgr);
    if (arguments.jpeg_quality > 0) {
      ASSIGN_OR_RETURN(frame,
                       image::DecodeImage({.bytes = test_support::EncodeJpeg(
                                               bgr, arguments.jpeg_quality)},
                                          {}));
    }
    frame.sequence = static_cast<std::uint64_t>(index);
    frame.capture_time = std::chrono::nanoseconds(
        static_cast<std::int64_t>(1e9 * index / arguments.frames_per_second));
    localization::LocalizationRequest request{&frame, camera, {}};
    const std::vector<localization::InertialSample> samples =
        SamplesOf(inertial.Until(frame.capture_time));
    request.inertial = samples;
    const auto row = rows.find(index);
    if (arguments.mask_target && row != rows.end() &&
        row->second.contains("vis_x")) {
      const Row& cells = row->second;
      request.masks_px.push_back(geometry::Box2::FromXywh(cells.at("vis_x"),
                                                          cells.at("vis_y"),
                                                          cells.at("vis_w"),
                                                          cells.at("vis_h")));
    }
    late.BeginFrame();
    if (arguments.move_every > 0 && index % arguments.move_every == 0) {
      const std::string state = localizer->Save();
      largest_state_bytes = std::max(largest_state_bytes, state.size());
      ASSIGN_OR_RETURN(localizer, create());
      RETURN_IF_ERROR(localizer->Restore(state));
    }
    const double began_ms = CpuMs();
    ASSIGN_OR_RETURN(const auto result, localizer->Localize(request));
    const double spent_ms = CpuMs() - began_ms;
    geometry::Rigid3 truth;
    if (row != rows.end()) truth = PoseOf(row->second);
    statistics.Add(result, spent_ms, row != rows.end() ? &truth : nullptr);
    if (result.lens_contradiction && !lens_contradiction) {
      std::printf("another lens from frame %d on\n", index);
    }
    lens_contradiction = result.lens_contradiction;
    if (results != nullptr) WriteRow(results, index, result);
    if (residuals != nullptr && row != rows.end()) {
      WriteResiduals(residuals, index, result, *map, camera, truth);
    }
  }
  if (residuals != nullptr) std::fclose(residuals);
  if (results != nullptr) std::fclose(results);
  statistics.Print(Extent(*map));
  if (arguments.move_every > 0) {
    std::printf("states of up to %zu bytes\n", largest_state_bytes);
  }
  if (lens_contradiction) {
    std::printf("lens: focal length x %.3f, corner %+.3f\n",
                lens_contradiction->focal_ratio,
                lens_contradiction->corner_share);
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock

int main(int argc, char** argv) {
  groundlock::features::SetUpOpenCv();
  groundlock::Arguments arguments;
  CLI::App app("Localises a video in a map and compares it with known poses");
  app.add_option("map", arguments.map, "reconstruction to import")->required();
  app.add_option("camera", arguments.camera, "camera.json")->required();
  app.add_option("video", arguments.video)->required();
  app.add_option("poses", arguments.poses, "CSV: frame,cam_*,q_*")->required();
  app.add_option("--align", arguments.align, "align.json");
  app.add_option("--results", arguments.results, "CSV to write");
  app.add_option("--localizer", arguments.localizer);
  app.add_option("--stride", arguments.stride, "every n-th frame only")
      ->check(CLI::PositiveNumber);
  app.add_option("--fps", arguments.frames_per_second)
      ->check(CLI::PositiveNumber);
  app.add_option("--min-inliers", arguments.options.min_inliers);
  app.add_option("--residuals",
                 arguments.residuals,
                 "CSV to write: landmarks against the true pose");
  app.add_option("--jpeg-quality",
                 arguments.jpeg_quality,
                 "frames go through JPEG of this quality")
      ->check(CLI::Range(1, 100));
  app.add_option("--blank", arguments.blank, "frames FROM to TO - 1 are black")
      ->expected(2);
  app.add_option("--cut",
                 arguments.cut,
                 "the map without all before the plane: normal and d")
      ->expected(4);
  app.add_option("--anchor-lag",
                 arguments.anchor_lag,
                 "a live session whose anchors come so many frames late")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--imu", arguments.imu, "inertial samples, EuRoC's data.csv");
  app.add_option("--imu-model", arguments.imu_model, "imu.json");
  app.add_option("--focal-ratio",
                 arguments.focal_ratio,
                 "take the focal length for so many times the true one");
  app.add_option("--move-every",
                 arguments.move_every,
                 "another localizer goes on with the state every n-th frame")
      ->check(CLI::NonNegativeNumber);
  app.add_flag("--mask-target", arguments.mask_target, "mask the vis_* box");
  CLI11_PARSE(app, argc, argv);
  try {
    const absl::Status status = groundlock::Run(arguments);
    if (status.ok()) return 0;
    std::fprintf(stderr, "%s\n", status.ToString().c_str());
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
  }
  return 1;
}
