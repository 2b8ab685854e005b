// SPDX-License-Identifier: Apache-2.0
#include "client/cli/results_csv.h"

#include <array>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/names.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

constexpr std::array<std::string_view, 29> kColumns = {
    "frame",     "t_s",         "camera_state", "cam_x",      "cam_y",
    "cam_z",     "cam_qw",      "cam_qx",       "cam_qy",     "cam_qz",
    "inliers",   "target",      "target_state", "confidence", "box_x",
    "box_y",     "box_w",       "box_h",        "ground_x",   "ground_y",
    "ground_z",  "heading_rad", "length_m",     "width_m",    "height_m",
    "decode_ms", "localize_ms", "track_ms",     "total_ms"};
constexpr int kCameraFields = 9;   // camera_state to inliers
constexpr int kTargetFields = 14;  // target to height_m
constexpr int kTimeFields = 4;

// One line under construction.
class Row {
 public:
  void Text(std::string_view text) {
    absl::StrAppend(&line_, first_ ? "" : ",", CsvField(text));
    first_ = false;
  }
  void Integer(std::uint64_t value) { Text(absl::StrCat(value)); }
  // Empty if not a number: a table has no better word for it.
  void Number(double value, int decimals) {
    Text(std::isfinite(value) ? absl::StrFormat("%.*f", decimals, value) : "");
  }
  void Empty(int fields) {
    for (int i = 0; i < fields; ++i) Text("");
  }
  std::string End() { return line_ + "\n"; }

 private:
  std::string line_;
  bool first_ = true;
};

double Seconds(std::chrono::nanoseconds time) {
  return std::chrono::duration<double>(time).count();
}

// Micrometres and 1e-9 in the quaternion: far below any accuracy, so that the
// rounding never shows in an evaluation.
void AddCamera(const sdk::CameraResult& camera, Row& row) {
  row.Text(CameraStateName(camera.state));
  if (camera.world_from_camera) {
    const geometry::Rigid3& pose = *camera.world_from_camera;
    for (int i = 0; i < 3; ++i) row.Number(pose.translation[i], 6);
    row.Number(pose.rotation.w(), 9);
    row.Number(pose.rotation.x(), 9);
    row.Number(pose.rotation.y(), 9);
    row.Number(pose.rotation.z(), 9);
  } else {
    row.Empty(7);
  }
  row.Integer(static_cast<std::uint64_t>(std::max(0, camera.num_inliers)));
}

void AddTarget(const sdk::TargetResult& target, Row& row) {
  row.Text(target.id);
  row.Text(TargetStateName(target.state));
  row.Number(target.confidence, 4);
  if (target.box_px) {
    row.Number(target.box_px->x(), 3);
    row.Number(target.box_px->y(), 3);
    row.Number(target.box_px->width(), 3);
    row.Number(target.box_px->height(), 3);
  } else {
    row.Empty(4);
  }
  if (target.ground_center_world) {
    for (int i = 0; i < 3; ++i) row.Number((*target.ground_center_world)[i], 6);
    row.Number(target.heading_rad, 6);
  } else {
    row.Empty(4);
  }
  if (target.box_world) {
    for (int i = 0; i < 3; ++i) row.Number(target.box_world->size_m[i], 4);
  } else {
    row.Empty(3);
  }
}

void AddTimes(const sdk::StageTimes& times, Row& row) {
  row.Number(times.decode_ms, 3);
  row.Number(times.localize_ms, 3);
  row.Number(times.track_ms, 3);
  row.Number(times.total_ms, 3);
}

}  // namespace

std::string CsvField(std::string_view text) {
  if (text.find_first_of(",\"\r\n") == std::string_view::npos) {
    return std::string(text);
  }
  std::string field = "\"";
  for (const char c : text) {
    field += c;
    if (c == '"') field += c;
  }
  return field + "\"";
}

std::string ResultsCsvHeader() {
  std::string header;
  for (const std::string_view column : kColumns) {
    absl::StrAppend(&header, header.empty() ? "" : ",", base::Abseil(column));
  }
  return header + "\n";
}

std::string ResultsCsvRows(const sdk::FrameResult& result) {
  std::string rows;
  const size_t count = std::max<size_t>(1, result.targets.size());
  for (size_t i = 0; i < count; ++i) {
    Row row;
    row.Integer(result.sequence);
    row.Number(Seconds(result.capture_time), 6);
    AddCamera(result.camera, row);
    if (result.targets.empty()) {
      row.Empty(kTargetFields);
    } else {
      AddTarget(result.targets[i], row);
    }
    AddTimes(result.times, row);
    rows += row.End();
  }
  return rows;
}

std::string ResultsCsvEmptyRow(std::uint64_t frame,
                               std::chrono::nanoseconds capture_time) {
  Row row;
  row.Integer(frame);
  row.Number(Seconds(capture_time), 6);
  row.Empty(kCameraFields + kTargetFields + kTimeFields);
  return row.End();
}

std::string LocalizeCsvHeader() {
  std::string header = ResultsCsvHeader();
  header.pop_back();
  return header + ",image\n";
}

std::string LocalizeCsvRow(std::uint64_t index,
                           const sdk::LocalizeReport& report,
                           std::string_view image) {
  Row row;
  row.Integer(index);
  row.Empty(1);
  AddCamera(report.camera, row);
  row.Empty(kTargetFields);
  AddTimes(report.times, row);
  row.Text(image);
  return row.End();
}

std::string LocalizeCsvEmptyRow(std::uint64_t index, std::string_view image) {
  Row row;
  row.Integer(index);
  row.Empty(1 + kCameraFields + kTargetFields + kTimeFields);
  row.Text(image);
  return row.End();
}

}  // namespace groundlock::cli
