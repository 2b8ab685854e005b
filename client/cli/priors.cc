// SPDX-License-Identifier: Apache-2.0
#include "client/cli/priors.h"

#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/cli/parse.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

using base::Abseil;

// A day at 60 frames a second, a hundred bytes a row.
constexpr std::uint64_t kMaxPriorsCsvBytes = 1ULL << 29;

absl::StatusOr<Eigen::Vector3d> ParseThree(std::string_view flag,
                                           std::string_view text,
                                           std::string_view form) {
  const std::vector<absl::string_view> parts =
      absl::StrSplit(Abseil(text), ',');
  Eigen::Vector3d values;
  bool valid = parts.size() == 3;
  for (std::size_t i = 0; valid && i < 3; ++i) {
    const auto value = ParseFinite(parts[i]);
    valid = value.has_value();
    if (valid) values[static_cast<Eigen::Index>(i)] = *value;
  }
  if (valid) return values;
  return absl::InvalidArgumentError(absl::StrCat(
      Abseil(flag), " \"", Abseil(text), "\": expected ", Abseil(form)));
}

class PriorTable {
 public:
  absl::Status ReadHeader(absl::string_view line) {
    const std::vector<absl::string_view> names = absl::StrSplit(line, ',');
    for (std::size_t i = 0; i < names.size(); ++i) {
      column_.emplace(std::string(absl::StripAsciiWhitespace(names[i])), i);
    }
    if (!column_.contains("frame")) {
      return absl::InvalidArgumentError("line 1: there is no column \"frame\"");
    }
    return absl::OkStatus();
  }

  absl::Status ReadRow(std::size_t number, absl::string_view line) {
    line_ = number;
    cells_ = absl::StrSplit(line, ',');
    const absl::string_view frame_text = Cell("frame");
    std::uint64_t frame = 0;
    if (!absl::SimpleAtoi(frame_text, &frame)) {
      return Wrong("frame", "a frame number");
    }
    sdk::PosePrior prior;
    if (!Cell("x").empty()) {
      ASSIGN_OR_RETURN(const auto p, (Numbers<3>({"x", "y", "z"})));
      prior.position_world = Eigen::Vector3d(p[0], p[1], p[2]);
    }
    if (!Cell("latitude").empty()) {
      ASSIGN_OR_RETURN(const auto p,
                       (Numbers<3>({"latitude", "longitude", "height"})));
      prior.geodetic_position = geometry::GeodeticPosition{p[0], p[1], p[2]};
      if (prior.position_world) {
        return Wrong("latitude", "nothing beside x, y, z");
      }
      if (const auto valid = prior.geodetic_position->Validate(); !valid.ok()) {
        return base::Annotate(valid, base::Std(absl::StrCat("line ", line_)));
      }
    }
    if (prior.position_world || prior.geodetic_position) {
      ASSIGN_OR_RETURN(prior.position_sigma_m, Positive("sigma"));
    }
    if (!Cell("arm_x").empty()) {
      ASSIGN_OR_RETURN(const auto arm,
                       (Numbers<3>({"arm_x", "arm_y", "arm_z"})));
      if (!prior.position_world && !prior.geodetic_position) {
        return Wrong("arm_x", "nothing without a position");
      }
      prior.position_arm_camera_m = Eigen::Vector3d(arm[0], arm[1], arm[2]);
    }
    if (!Cell("qw").empty()) {
      ASSIGN_OR_RETURN(const auto q, (Numbers<4>({"qw", "qx", "qy", "qz"})));
      const Eigen::Quaterniond rotation(q[0], q[1], q[2], q[3]);
      if (std::abs(rotation.norm() - 1.0) > 1e-3) {
        return Wrong("qw", "a quaternion of unit length");
      }
      prior.rotation = rotation.normalized();
      ASSIGN_OR_RETURN(const double sigma_deg, Positive("rotation_sigma_deg"));
      prior.rotation_sigma_rad = sigma_deg * std::numbers::pi / 180.0;
    }
    if (!priors_.emplace(frame, prior).second) {
      return Wrong("frame", "every frame once");
    }
    return absl::OkStatus();
  }

  Priors Take() { return std::move(priors_); }

 private:
  // Empty if there is no such column, or no such cell in the row.
  absl::string_view Cell(const std::string& name) const {
    const auto it = column_.find(name);
    if (it == column_.end() || it->second >= cells_.size()) return {};
    return absl::StripAsciiWhitespace(cells_[it->second]);
  }
  absl::Status Wrong(const std::string& name, std::string_view expected) const {
    return absl::InvalidArgumentError(absl::StrCat("line ",
                                                   line_,
                                                   ", column ",
                                                   name,
                                                   ": \"",
                                                   Cell(name),
                                                   "\", expected ",
                                                   Abseil(expected)));
  }
  template <std::size_t kCount>
  absl::StatusOr<std::array<double, kCount>> Numbers(
      const std::array<const char*, kCount>& names) const {
    std::array<double, kCount> values{};
    for (std::size_t i = 0; i < kCount; ++i) {
      const auto value = ParseFinite(Cell(names[i]));
      if (!value) return Wrong(names[i], "a number");
      values[i] = *value;
    }
    return values;
  }
  absl::StatusOr<double> Positive(const std::string& name) const {
    const auto value = ParseFinite(Cell(name));
    if (!value || !(*value > 0.0)) return Wrong(name, "a number above 0");
    return *value;
  }

  std::map<std::string, std::size_t> column_;
  std::size_t line_ = 0;
  std::vector<absl::string_view> cells_;
  Priors priors_;
};

}  // namespace

absl::StatusOr<std::optional<sdk::PosePrior>> PriorFromFlags(
    const PriorFlags& flags) {
  if (flags.position.empty() && flags.geodetic.empty()) return std::nullopt;
  if (!flags.position.empty() && !flags.geodetic.empty()) {
    return absl::InvalidArgumentError(
        "--prior-position and --prior-geodetic exclude each other");
  }
  if (!(flags.sigma_m > 0.0)) {
    return absl::InvalidArgumentError(
        "--prior-sigma is missing: the position's standard deviation, m");
  }
  sdk::PosePrior prior;
  prior.position_sigma_m = flags.sigma_m;
  if (!flags.position.empty()) {
    ASSIGN_OR_RETURN(
        prior.position_world,
        ParseThree("--prior-position", flags.position, "X,Y,Z in metres"));
    return prior;
  }
  ASSIGN_OR_RETURN(const Eigen::Vector3d place,
                   ParseThree("--prior-geodetic",
                              flags.geodetic,
                              "LATITUDE,LONGITUDE,HEIGHT in degrees and m"));
  prior.geodetic_position =
      geometry::GeodeticPosition{place.x(), place.y(), place.z()};
  RETURN_IF_ERROR(
      base::Annotate(prior.geodetic_position->Validate(), "--prior-geodetic"));
  return prior;
}

absl::StatusOr<Priors> PriorsFromCsv(std::string_view csv) {
  PriorTable table;
  std::size_t number = 0;
  for (const absl::string_view line : absl::StrSplit(Abseil(csv), '\n')) {
    ++number;
    if (number == 1) {
      RETURN_IF_ERROR(table.ReadHeader(line));
    } else if (!absl::StripAsciiWhitespace(line).empty()) {
      RETURN_IF_ERROR(table.ReadRow(number, line));
    }
  }
  return table.Take();
}

absl::StatusOr<Priors> ReadPriors(const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string csv,
                   base::ReadFile(path, kMaxPriorsCsvBytes));
  auto priors = PriorsFromCsv(csv);
  if (!priors.ok()) return base::Annotate(priors.status(), path.string());
  return priors;
}

}  // namespace groundlock::cli
