// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/named_files.h"

#include <algorithm>

#include "absl/container/flat_hash_map.h"
#include "map_store/base/status.h"

namespace groundlock::formats::internal {
namespace {

namespace fs = std::filesystem;

std::string WithForwardSlashes(std::string name) {
  std::replace(name.begin(), name.end(), '\\', '/');
  return name;
}

// Relative paths that the name may stand for.
std::vector<fs::path> Candidates(const std::string& name) {
  std::vector<fs::path> candidates;
  const fs::path path(WithForwardSlashes(name));
  const bool climbs =
      std::any_of(path.begin(), path.end(), [](const fs::path& part) {
        return part == "..";
      });
  if (!climbs && path.is_relative()) candidates.push_back(path);
  if (path.has_filename() && path.filename() != "..") {
    candidates.push_back(path.filename());
  }
  return candidates;
}

bool IsFile(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

}  // namespace

std::optional<fs::path> FindNamedFile(std::span<const fs::path> folders,
                                      const std::string& name,
                                      std::string_view extension) {
  for (const fs::path& folder : folders) {
    for (const fs::path& candidate : Candidates(name)) {
      fs::path path = folder / candidate;
      if (extension.empty()) {
        if (IsFile(path)) return path;
        continue;
      }
      fs::path appended = path;
      appended += extension;
      path.replace_extension(extension);
      if (IsFile(path)) return path;
      if (IsFile(appended)) return appended;
    }
  }
  return std::nullopt;
}

std::string RemoteName(const std::string& name, std::string_view extension) {
  const std::vector<fs::path> candidates = Candidates(name);
  fs::path path = fs::path(kImagesFolder) /
                  (candidates.empty() ? fs::path("unnamed") : candidates[0]);
  if (!extension.empty()) path.replace_extension(extension);
  return path.lexically_normal().generic_string();
}

absl::StatusOr<std::vector<std::string>> ViewNames(
    std::span<const std::string> image_names) {
  absl::flat_hash_map<std::string, int> uses;
  absl::flat_hash_map<std::string, int> full_uses;
  const auto base_name = [](const std::string& name) {
    return fs::path(WithForwardSlashes(name)).filename().string();
  };
  for (const std::string& name : image_names) {
    ++uses[base_name(name)];
    if (++full_uses[name] > 1) {
      return absl::InvalidArgumentError(
          absl::StrCat("image ", name, " is there more than once"));
    }
  }
  std::vector<std::string> names;
  names.reserve(image_names.size());
  for (const std::string& full : image_names) {
    const std::string base = base_name(full);
    names.push_back(base.empty() || uses[base] > 1 ? full : base);
  }
  return names;
}

fs::path FolderOf(const fs::path& path) {
  return path.has_parent_path() ? path.parent_path() : fs::path(".");
}

}  // namespace groundlock::formats::internal
