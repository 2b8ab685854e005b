// SPDX-License-Identifier: Apache-2.0
#include "client/cli/imu.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
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
using nlohmann::json;

// Two hours at 1 kHz.
constexpr std::uint64_t kMaxImuCsvBytes = 1ULL << 30;
constexpr std::uint64_t kMaxImuJsonBytes = 1ULL << 20;
// TrackRequest.Frame.inertial
constexpr std::size_t kMaxPerFrame = 4'096;

constexpr std::array<const char*, 7> kColumns = {
    "timestamp [ns]", "w_x", "w_y", "w_z", "a_x", "a_y", "a_z"};

absl::StatusOr<sdk::InertialSample> SampleFromRow(std::size_t line,
                                                  absl::string_view row) {
  const std::vector<absl::string_view> cells = absl::StrSplit(row, ',');
  const auto wrong = [&](std::size_t column, const char* expected) {
    return absl::InvalidArgumentError(absl::StrCat(
        "line ",
        line,
        ", column ",
        column + 1,
        " (",
        kColumns.at(column),
        "): ",
        column < cells.size() ? absl::StrCat("\"", cells[column], "\"")
                              : std::string("missing"),
        ", expected ",
        expected));
  };
  std::int64_t time_ns = 0;
  if (!absl::SimpleAtoi(cells[0], &time_ns) || time_ns < 0) {
    return wrong(0, "nanoseconds, not below 0");
  }
  std::array<double, 6> values{};
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (i + 1 >= cells.size() ||
        !absl::SimpleAtod(cells[i + 1], &values.at(i)) ||
        !std::isfinite(values.at(i))) {
      return wrong(i + 1, "a number");
    }
  }
  return sdk::InertialSample{std::chrono::nanoseconds(time_ns),
                             {values[0], values[1], values[2]},
                             {values[3], values[4], values[5]}};
}

absl::StatusOr<std::optional<double>> NumberOf(const json& object,
                                               const char* field) {
  const auto found = object.find(field);
  if (found == object.end()) return std::nullopt;
  if (found->is_number()) {
    const double value = found->get<double>();
    if (std::isfinite(value) && value >= 0.0) return value;
  }
  return absl::InvalidArgumentError(
      absl::StrCat("field \"", field, "\": expected a number, not below 0"));
}

}  // namespace

absl::StatusOr<std::vector<sdk::InertialSample>> InertialFromCsv(
    std::string_view csv) {
  std::vector<sdk::InertialSample> samples;
  std::size_t line = 0;
  for (absl::string_view row : absl::StrSplit(Abseil(csv), '\n')) {
    ++line;
    row = absl::StripAsciiWhitespace(row);
    if (row.empty() || row.front() == '#') continue;
    ASSIGN_OR_RETURN(const sdk::InertialSample sample,
                     SampleFromRow(line, row));
    if (!samples.empty() && sample.time <= samples.back().time) {
      return absl::InvalidArgumentError(
          absl::StrCat("line ",
                       line,
                       ", column 1 (timestamp [ns]): ",
                       sample.time.count(),
                       " is not above ",
                       samples.back().time.count(),
                       ", that of the row before"));
    }
    samples.push_back(sample);
  }
  return samples;
}

absl::StatusOr<sdk::ImuModel> ImuFromJson(std::string_view text) {
  const json object = json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!object.is_object()) {
    return absl::InvalidArgumentError("not a JSON object");
  }
  constexpr const char* kRotation = "imu_from_camera_wxyz";
  const auto rotation = object.find(kRotation);
  const bool is_quaternion =
      rotation != object.end() && rotation->is_array() &&
      rotation->size() == 4 &&
      std::all_of(rotation->begin(), rotation->end(), [](const json& value) {
        return value.is_number();
      });
  sdk::ImuModel imu;
  if (is_quaternion) {
    imu.imu_from_camera = Eigen::Quaterniond((*rotation)[0].get<double>(),
                                             (*rotation)[1].get<double>(),
                                             (*rotation)[2].get<double>(),
                                             (*rotation)[3].get<double>());
  }
  if (!is_quaternion || !imu.imu_from_camera.coeffs().allFinite() ||
      std::abs(imu.imu_from_camera.norm() - 1.0) > 1e-3) {
    return absl::InvalidArgumentError(absl::StrCat(
        "field \"", kRotation, "\": expected a unit quaternion [w, x, y, z]"));
  }
  imu.imu_from_camera.normalize();
  ASSIGN_OR_RETURN(imu.gyroscope_noise_rad_s_sqrt_hz,
                   NumberOf(object, "gyroscope_noise_rad_s_sqrt_hz"));
  ASSIGN_OR_RETURN(imu.gyroscope_walk_rad_s2_sqrt_hz,
                   NumberOf(object, "gyroscope_walk_rad_s2_sqrt_hz"));
  ASSIGN_OR_RETURN(imu.gyroscope_bias_rad_s,
                   NumberOf(object, "gyroscope_bias_rad_s"));
  return imu;
}

absl::StatusOr<std::vector<sdk::InertialSample>> ReadInertial(
    const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string csv,
                   base::ReadFile(path, kMaxImuCsvBytes));
  auto samples = InertialFromCsv(csv);
  if (!samples.ok()) return base::Annotate(samples.status(), path.string());
  return samples;
}

absl::StatusOr<sdk::ImuModel> ReadImu(const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string text,
                   base::ReadFile(path, kMaxImuJsonBytes));
  auto imu = ImuFromJson(text);
  if (!imu.ok()) return base::Annotate(imu.status(), path.string());
  return imu;
}

InertialTrack::InertialTrack(std::vector<sdk::InertialSample> samples,
                             std::chrono::nanoseconds epoch)
    : samples_(std::move(samples)) {
  for (sdk::InertialSample& sample : samples_) sample.time -= epoch;
  // The frames' clock begins at 0.
  std::erase_if(samples_, [](const sdk::InertialSample& sample) {
    return sample.time.count() < 0;
  });
}

std::vector<sdk::InertialSample> InertialTrack::Until(
    std::chrono::nanoseconds capture_time) {
  std::size_t end = next_;
  while (end < samples_.size() && samples_[end].time < capture_time) ++end;
  end = std::min(samples_.size(), end + 1);
  const std::size_t begin =
      std::max(next_, end > kMaxPerFrame ? end - kMaxPerFrame : 0);
  next_ = end;
  const auto at = [&](std::size_t index) {
    return samples_.begin() + static_cast<std::ptrdiff_t>(index);
  };
  return {at(begin), at(end)};
}

}  // namespace groundlock::cli
