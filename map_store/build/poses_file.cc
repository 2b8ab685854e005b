// SPDX-License-Identifier: Apache-2.0
// Poses of images as users have them: a CSV table, or JSON.
#include "map_store/build/internal/poses_file.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/build/posed.h"

namespace groundlock::build {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr std::uint64_t kMaxBytes = 256 << 20;
constexpr std::size_t kMaxNameBytes = 1'024;
// A quaternion farther from unit length is a mistake, not rounding.
constexpr double kMaxQuaternionError = 1e-3;

absl::StatusOr<geometry::Rigid3> MakePose(const std::array<double, 3>& center,
                                          const std::array<double, 4>& q_wxyz) {
  const Eigen::Quaterniond q(q_wxyz[0], q_wxyz[1], q_wxyz[2], q_wxyz[3]);
  const Eigen::Vector3d p(center[0], center[1], center[2]);
  if (!p.allFinite() || !q.coeffs().allFinite() ||
      std::abs(q.norm() - 1.0) > kMaxQuaternionError) {
    return absl::InvalidArgumentError(
        "the quaternion is not of unit length, or a number is not finite");
  }
  return geometry::Rigid3{q.normalized(), p};
}

// The columns that are read, in the order of the fields below.
constexpr std::array<const char*, 7> kColumns = {
    "x", "y", "z", "qw", "qx", "qy", "qz"};

template <std::size_t N>
absl::StatusOr<std::array<double, N>> Numbers(const json& entry,
                                              const char* field) {
  const auto it = entry.find(field);
  if (it == entry.end() || !it->is_array() || it->size() != N) {
    return absl::InvalidArgumentError(
        absl::StrCat(field, ": expected ", N, " numbers"));
  }
  std::array<double, N> numbers{};
  for (std::size_t i = 0; i < N; ++i) {
    if (!(*it)[i].is_number()) {
      return absl::InvalidArgumentError(
          absl::StrCat(field, ": expected ", N, " numbers"));
    }
    numbers[i] = (*it)[i].template get<double>();
  }
  return numbers;
}

// Only what is flat is written again: that goes as deep as the input does.
absl::StatusOr<geometry::CameraModel> ParseCamera(const json& entry) {
  json camera = json::object();
  for (const char* field : {"model", "width", "height", "params"}) {
    const auto it = entry.find(field);
    if (it == entry.end()) continue;
    const bool is_flat =
        !it->is_structured() ||
        (it->is_array() && std::none_of(it->begin(), it->end(), [](auto& item) {
           return item.is_structured();
         }));
    if (!is_flat) {
      return absl::InvalidArgumentError(
          absl::StrCat(field, ": neither a value nor a list of values"));
    }
    camera[field] = *it;
  }
  return geometry::CameraModelFromJson(camera.dump());
}

absl::StatusOr<PosedImage> ParseEntry(const json& entry) {
  if (!entry.is_object()) return absl::InvalidArgumentError("not an object");
  PosedImage image;
  const auto name = entry.find("image");
  if (name == entry.end() || !name->is_string() ||
      name->get_ref<const std::string&>().empty() ||
      name->get_ref<const std::string&>().size() > kMaxNameBytes) {
    return absl::InvalidArgumentError("image: expected the file's name");
  }
  image.name = name->get<std::string>();
  ASSIGN_OR_RETURN(const auto center, (Numbers<3>(entry, "centre_m")));
  ASSIGN_OR_RETURN(const auto q, (Numbers<4>(entry, "world_from_camera_wxyz")));
  ASSIGN_OR_RETURN(image.world_from_camera, MakePose(center, q));
  if (entry.contains("model")) {
    ASSIGN_OR_RETURN(image.camera, ParseCamera(entry));
  }
  return image;
}

}  // namespace

namespace internal {

absl::StatusOr<std::vector<PosedImage>> ParsePosesCsv(const std::string& text) {
  std::vector<PosedImage> poses;
  std::array<std::size_t, kColumns.size()> columns{};
  std::size_t name_column = 0;
  std::size_t num_columns = 0;
  std::size_t number = 0;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    ++number;
    line = absl::StripAsciiWhitespace(line);
    if (line.empty() || line.front() == '#') continue;
    std::vector<absl::string_view> cells = absl::StrSplit(line, ',');
    for (absl::string_view& cell : cells)
      cell = absl::StripAsciiWhitespace(cell);
    const auto fail = [number](const std::string& what) {
      return absl::InvalidArgumentError(
          absl::StrCat("line ", number, ": ", what));
    };
    if (num_columns == 0) {
      const auto find = [&cells](absl::string_view column) {
        return static_cast<std::size_t>(
            std::find(cells.begin(), cells.end(), column) - cells.begin());
      };
      num_columns = cells.size();
      name_column = std::min(find("name"), find("image"));
      if (name_column == num_columns) {
        return fail("the header has no column 'name'");
      }
      for (std::size_t i = 0; i < kColumns.size(); ++i) {
        columns[i] = find(kColumns[i]);
        if (columns[i] == num_columns) {
          return fail(
              absl::StrCat("the header has no column '", kColumns[i], "'"));
        }
      }
      continue;
    }
    if (cells.size() != num_columns) {
      return fail(
          absl::StrCat(cells.size(), " columns, the header has ", num_columns));
    }
    std::array<double, kColumns.size()> values{};
    for (std::size_t i = 0; i < kColumns.size(); ++i) {
      if (!absl::SimpleAtod(cells[columns[i]], &values[i])) {
        return fail(absl::StrCat("column '",
                                 kColumns[i],
                                 "': '",
                                 cells[columns[i]],
                                 "' is not a number"));
      }
    }
    PosedImage image;
    image.name = std::string(cells[name_column]);
    if (image.name.empty() || image.name.size() > kMaxNameBytes) {
      return fail("the name is empty or too long");
    }
    const auto pose = MakePose({values[0], values[1], values[2]},
                               {values[3], values[4], values[5], values[6]});
    if (!pose.ok()) return fail(std::string(pose.status().message()));
    image.world_from_camera = *pose;
    poses.push_back(std::move(image));
  }
  return poses;
}

absl::StatusOr<std::vector<PosedImage>> ParsePosesJson(
    const std::string& text) {
  const json entries = json::parse(text, nullptr, false);
  if (!entries.is_array()) {
    return absl::InvalidArgumentError("expected a JSON array of images");
  }
  std::vector<PosedImage> poses;
  for (std::size_t i = 0; i < entries.size(); ++i) {
    auto image = ParseEntry(entries[i]);
    if (!image.ok()) {
      return base::Annotate(image.status(), absl::StrCat("entry ", i));
    }
    poses.push_back(*std::move(image));
  }
  return poses;
}

}  // namespace internal

absl::StatusOr<std::vector<PosedImage>> ReadPoses(const fs::path& path) {
  ASSIGN_OR_RETURN(const std::string text, base::ReadFile(path, kMaxBytes));
  auto poses = path.extension() == ".json" ? internal::ParsePosesJson(text)
                                           : internal::ParsePosesCsv(text);
  if (!poses.ok()) return base::Annotate(poses.status(), path.string());
  if (poses->empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path.string(), ": no poses in it"));
  }
  return poses;
}

}  // namespace groundlock::build
