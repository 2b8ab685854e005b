// SPDX-License-Identifier: Apache-2.0
#include "client/cli/evaluate/truth_csv.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

using base::Abseil;

// Hours of video at 60 frames a second, 400 bytes a row.
constexpr std::uint64_t kMaxCsvBytes = 1ULL << 28;
// Nothing that is filmed lasts longer; nanoseconds must not overflow.
constexpr double kMaxTime_s = 1e8;

class TruthTable {
 public:
  absl::Status ReadHeader(absl::string_view line) {
    const std::vector<absl::string_view> names = absl::StrSplit(line, ',');
    for (std::size_t i = 0; i < names.size(); ++i) {
      column_.emplace(std::string(absl::StripAsciiWhitespace(names[i])), i);
    }
    for (const char* name :
         {"frame", "cam_x", "cam_y", "cam_z", "q_w", "q_x", "q_y", "q_z"}) {
      if (!column_.contains(name)) {
        return absl::InvalidArgumentError(
            absl::StrCat("line 1: there is no column \"", name, "\""));
      }
    }
    return absl::OkStatus();
  }

  absl::Status ReadRow(std::size_t number, absl::string_view line) {
    line_ = number;
    cells_ = absl::StrSplit(line, ',');
    TruthRow row;
    if (!absl::SimpleAtoi(Cell("frame"), &row.frame)) {
      return Wrong("frame", "a frame number");
    }
    if (!rows_.empty() && row.frame <= rows_.back().frame) {
      return Wrong("frame", "numbers that rise");
    }
    if (!Cell("t_s").empty()) {
      ASSIGN_OR_RETURN(const auto t, Numbers<1>({"t_s"}));
      if (!(std::abs(t[0]) < kMaxTime_s)) return Wrong("t_s", "seconds");
      row.time = std::chrono::nanoseconds(std::llround(t[0] * 1e9));
    }
    ASSIGN_OR_RETURN(const auto p, (Numbers<3>({"cam_x", "cam_y", "cam_z"})));
    row.world_from_camera.translation = {p[0], p[1], p[2]};
    ASSIGN_OR_RETURN(const auto q, (Numbers<4>({"q_w", "q_x", "q_y", "q_z"})));
    const Eigen::Quaterniond rotation(q[0], q[1], q[2], q[3]);
    if (!(std::abs(rotation.norm() - 1.0) < 1e-3)) {
      return Wrong("q_w", "a quaternion of unit length");
    }
    row.world_from_camera.rotation = rotation.normalized();
    RETURN_IF_ERROR(ReadTarget(row));
    rows_.push_back(row);
    return absl::OkStatus();
  }

  std::vector<TruthRow> Take() { return std::move(rows_); }

 private:
  absl::Status ReadTarget(TruthRow& row) const {
    if (!Cell("tgt_x").empty()) {
      ASSIGN_OR_RETURN(const auto p, (Numbers<3>({"tgt_x", "tgt_y", "tgt_z"})));
      row.target_world = Eigen::Vector3d(p[0], p[1], p[2]);
    }
    if (!Cell("vis_x").empty()) {
      ASSIGN_OR_RETURN(const auto b,
                       (Numbers<4>({"vis_x", "vis_y", "vis_w", "vis_h"})));
      if (b[2] < 0.0) return Wrong("vis_w", "no number below 0");
      if (b[3] < 0.0) return Wrong("vis_h", "no number below 0");
      // A single point that is seen spans no box.
      if (b[2] > 0.0 && b[3] > 0.0) {
        row.visible_box_px = geometry::Box2::FromXywh(b[0], b[1], b[2], b[3]);
      }
    }
    row.seen_fraction = row.visible_box_px ? 1.0 : 0.0;
    if (!Cell("seen_fraction").empty()) {
      ASSIGN_OR_RETURN(const auto share, Numbers<1>({"seen_fraction"}));
      if (!(share[0] >= 0.0 && share[0] <= 1.0)) {
        return Wrong("seen_fraction", "a number from 0 to 1");
      }
      row.seen_fraction = share[0];
    }
    return absl::OkStatus();
  }

  // Empty if there is no such column, or no such cell in the row.
  absl::string_view Cell(const std::string& name) const {
    const auto it = column_.find(name);
    if (it == column_.end() || it->second >= cells_.size()) return {};
    return absl::StripAsciiWhitespace(cells_[it->second]);
  }
  absl::Status Wrong(const std::string& name, const char* expected) const {
    return absl::InvalidArgumentError(absl::StrCat("line ",
                                                   line_,
                                                   ", column ",
                                                   name,
                                                   ": \"",
                                                   Cell(name),
                                                   "\", expected ",
                                                   expected));
  }
  template <std::size_t kCount>
  absl::StatusOr<std::array<double, kCount>> Numbers(
      const std::array<const char*, kCount>& names) const {
    std::array<double, kCount> values{};
    for (std::size_t i = 0; i < kCount; ++i) {
      if (!absl::SimpleAtod(Cell(names[i]), &values[i]) ||
          !std::isfinite(values[i])) {
        return Wrong(names[i], "a number");
      }
    }
    return values;
  }

  std::map<std::string, std::size_t> column_;
  std::size_t line_ = 0;
  std::vector<absl::string_view> cells_;
  std::vector<TruthRow> rows_;
};

}  // namespace

absl::StatusOr<std::vector<TruthRow>> TruthFromCsv(std::string_view csv) {
  TruthTable table;
  std::size_t number = 0;
  for (const absl::string_view line : absl::StrSplit(Abseil(csv), '\n')) {
    ++number;
    if (number == 1) {
      RETURN_IF_ERROR(table.ReadHeader(line));
    } else if (!absl::StripAsciiWhitespace(line).empty()) {
      RETURN_IF_ERROR(table.ReadRow(number, line));
    }
  }
  std::vector<TruthRow> rows = table.Take();
  if (rows.empty()) return absl::InvalidArgumentError("there are no rows");
  return rows;
}

absl::StatusOr<std::vector<TruthRow>> ReadTruth(
    const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string csv, base::ReadFile(path, kMaxCsvBytes));
  auto rows = TruthFromCsv(csv);
  if (!rows.ok()) return base::Annotate(rows.status(), path.string());
  return rows;
}

}  // namespace groundlock::cli
