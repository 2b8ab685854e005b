// SPDX-License-Identifier: Apache-2.0
#include "tests/eval/sequence_csv.h"

#include <cmath>
#include <cstdlib>
#include <map>
#include <sstream>
#include <string>
#include <utility>

#include "absl/strings/str_split.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::eval {
namespace {

constexpr std::uint64_t kMaxTruthBytes = 1 << 26;

double Milliseconds(std::chrono::nanoseconds time) {
  return std::chrono::duration<double, std::milli>(time).count();
}

const char* Name(localization::CameraState state) {
  switch (state) {
    case localization::CameraState::kInitializing:
      return "INITIALIZING";
    case localization::CameraState::kTracked:
      return "TRACKED";
    case localization::CameraState::kHeld:
      return "HELD";
    case localization::CameraState::kLost:
      return "LOST";
    case localization::CameraState::kOdometry:
      return "ODOMETRY";
  }
  return "";
}

const char* Name(tracking::TargetState state) {
  switch (state) {
    case tracking::TargetState::kTracked:
      return "TRACKED";
    case tracking::TargetState::kPredicted:
      return "PREDICTED";
    case tracking::TargetState::kLost:
      return "LOST";
  }
  return "";
}

void WriteTarget(std::ostream& out, const tracking::TargetResult& target) {
  out << target.id << ',' << Name(target.state) << ',' << target.confidence;
  if (target.box_px) {
    out << ',' << target.box_px->x() << ',' << target.box_px->y() << ','
        << target.box_px->width() << ',' << target.box_px->height();
  } else {
    out << ",,,,";
  }
  if (target.box_world) {
    const Eigen::Vector3d p = target.box_world->BottomCenterWorld();
    const Eigen::Vector3d heading =
        target.box_world->world_from_object.rotation * Eigen::Vector3d::UnitX();
    const Eigen::Vector3d& size_m = target.box_world->size_m;
    out << ',' << p.x() << ',' << p.y() << ',' << p.z() << ','
        << std::atan2(heading.y(), heading.x()) << ',' << size_m.x() << ','
        << size_m.y() << ',' << size_m.z();
  } else {
    out << ",,,,,,,";
  }
}

}  // namespace

absl::StatusOr<std::vector<TruthRow>> ReadTruth(
    const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string text,
                   base::ReadFile(path, kMaxTruthBytes));
  std::vector<std::string> lines =
      absl::StrSplit(text, '\n', absl::SkipEmpty());
  if (lines.empty()) {
    return absl::InvalidArgumentError(path.string() + ": empty");
  }
  const std::vector<std::string> names = absl::StrSplit(lines[0], ',');
  std::map<std::string, std::size_t> column;
  for (std::size_t i = 0; i < names.size(); ++i) column[names[i]] = i;
  for (const char* name : {"frame",
                           "t_s",
                           "cam_x",
                           "cam_y",
                           "cam_z",
                           "q_w",
                           "q_x",
                           "q_y",
                           "q_z",
                           "tgt_x",
                           "tgt_y",
                           "tgt_z",
                           "vis_x",
                           "vis_y",
                           "vis_w",
                           "vis_h",
                           "seen_fraction"}) {
    if (!column.contains(name)) {
      return absl::InvalidArgumentError(path.string() + ": no column " + name);
    }
  }
  std::vector<TruthRow> rows;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    const std::vector<std::string> cells = absl::StrSplit(lines[i], ',');
    const auto text_of = [&](const char* name) {
      const std::size_t index = column[name];
      return index < cells.size() ? cells[index] : std::string();
    };
    const auto value = [&](const char* name) {
      return std::strtod(text_of(name).c_str(), nullptr);
    };
    TruthRow row;
    row.frame = static_cast<int>(value("frame"));
    row.time = std::chrono::nanoseconds(std::llround(value("t_s") * 1e9));
    row.world_from_camera.translation = {
        value("cam_x"), value("cam_y"), value("cam_z")};
    row.world_from_camera.rotation =
        Eigen::Quaterniond(
            value("q_w"), value("q_x"), value("q_y"), value("q_z"))
            .normalized();
    row.target_world = {value("tgt_x"), value("tgt_y"), value("tgt_z")};
    row.seen_fraction = value("seen_fraction");
    if (!text_of("vis_x").empty()) {
      row.visible_box_px = geometry::Box2::FromXywh(
          value("vis_x"), value("vis_y"), value("vis_w"), value("vis_h"));
    }
    rows.push_back(row);
  }
  return rows;
}

void WriteResultsHeader(std::ostream& out) {
  out << "frame,t_s,camera_state,cam_x,cam_y,cam_z,cam_qw,cam_qx,cam_qy,cam_qz,"
         "inliers,target,target_state,confidence,box_x,box_y,box_w,box_h,"
         "ground_x,ground_y,ground_z,heading_rad,length_m,width_m,height_m,"
         "decode_ms,localize_ms,track_ms,total_ms\n";
}

void WriteResults(std::ostream& out, const tracking::FrameResult& result) {
  std::ostringstream camera;
  camera.precision(10);
  camera << result.sequence << ','
         << std::chrono::duration<double>(result.capture_time).count() << ','
         << Name(result.camera.state);
  if (result.camera.world_from_camera) {
    const Eigen::Vector3d& p = result.camera.world_from_camera->translation;
    const Eigen::Quaterniond& q = result.camera.world_from_camera->rotation;
    camera << ',' << p.x() << ',' << p.y() << ',' << p.z() << ',' << q.w()
           << ',' << q.x() << ',' << q.y() << ',' << q.z();
  } else {
    camera << ",,,,,,,";
  }
  camera << ',' << result.camera.num_inliers << ',';
  std::ostringstream times;
  times << ',' << Milliseconds(result.times.decode) << ','
        << Milliseconds(result.times.localize) << ','
        << Milliseconds(result.times.track) << ','
        << Milliseconds(result.times.total) << '\n';
  if (result.targets.empty()) {
    out << camera.str() << ",,,,,,,,,,,,," << times.str();
  }
  for (const tracking::TargetResult& target : result.targets) {
    std::ostringstream cells;
    cells.precision(8);
    WriteTarget(cells, target);
    out << camera.str() << cells.str() << times.str();
  }
}

}  // namespace groundlock::eval
