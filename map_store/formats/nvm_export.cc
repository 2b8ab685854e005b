// SPDX-License-Identifier: Apache-2.0
// Writes VisualSFM's .nvm and, if the map has descriptors, a .sift file for
// each image beside it.
#include <algorithm>
#include <cstring>

#include "absl/container/flat_hash_set.h"
#include "absl/strings/str_format.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/descriptors.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/nvm_model.h"

namespace groundlock::formats::internal {
namespace {

namespace fs = std::filesystem;

// As for imports: a tenth of a keypoint's noise.
constexpr double kInexactExport_px = 0.05;

// A name that is a file right beside the .nvm, whatever the view is called.
std::string FlatName(const std::string& view_name) {
  std::string name = view_name;
  for (char& c : name) {
    if (c == '/' || c == '\\') c = '_';
  }
  return name == "." || name == ".." ? "_" : name;
}

std::string SiftName(const std::string& view_name) {
  return fs::path(FlatName(view_name)).replace_extension(".sift").string();
}

// VisualSFM writes blanks in names as '"'; '#' would start a comment.
std::string EncodedName(const std::string& view_name) {
  std::string name = FlatName(view_name);
  std::replace(name.begin(), name.end(), ' ', '"');
  return name.front() == '#' ? "./" + name : name;
}

void AppendCamera(const map::MapViewData& view,
                  const FittedNvm& nvm,
                  std::string* out) {
  const Eigen::Quaterniond& q = view.camera_from_world.rotation;
  const Eigen::Vector3d center = view.camera_from_world.Inverse().translation;
  absl::StrAppendFormat(out,
                        "%s\t%.12g %.17g %.17g %.17g %.17g %.17g %.17g %.17g "
                        "%.12g 0\n",
                        EncodedName(view.name),
                        nvm.focal_px,
                        q.w(),
                        q.x(),
                        q.y(),
                        q.z(),
                        center.x(),
                        center.y(),
                        center.z(),
                        nvm.r);
}

// A measurement is relative to the principal point, which the importer finds
// again as its difference to the .sift file.
struct Observation {
  std::uint32_t view = 0;
  std::uint32_t feature = 0;
};

void AppendPoints(const map::MapData& data, std::string* out) {
  std::vector<std::vector<Observation>> tracks(data.landmarks.size());
  for (std::uint32_t i = 0; i < data.views.size(); ++i) {
    const std::vector<std::uint32_t>& landmarks = data.views[i].landmarks;
    for (std::uint32_t j = 0; j < landmarks.size(); ++j) {
      tracks[landmarks[j]].push_back({i, j});
    }
  }
  absl::StrAppendFormat(out, "%d\n", data.landmarks.size());
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    const map::MapLandmarkData& landmark = data.landmarks[i];
    absl::StrAppendFormat(out,
                          "%.17g %.17g %.17g %d %d %d %d ",
                          landmark.p_world.x(),
                          landmark.p_world.y(),
                          landmark.p_world.z(),
                          landmark.rgb[0],
                          landmark.rgb[1],
                          landmark.rgb[2],
                          tracks[i].size());
    for (const Observation& o : tracks[i]) {
      const map::MapViewData& view = data.views[o.view];
      const Eigen::Vector2d xy_px =
          view.keypoints_px[o.feature].cast<double>() -
          data.cameras[view.camera].principal_point_px();
      absl::StrAppendFormat(
          out, "%d %d %.12g %.12g ", o.view, o.feature, xy_px.x(), xy_px.y());
    }
    out->push_back('\n');
  }
}

std::string SiftBytes(const map::MapViewData& view) {
  std::string out = "SIFTV4.0";
  const auto put = [&out](auto value) {
    char bytes[sizeof(value)];
    std::memcpy(bytes, &value, sizeof(value));
    out.append(bytes, sizeof(value));
  };
  put(static_cast<std::int32_t>(view.keypoints_px.size()));
  put(std::int32_t{5});
  put(std::int32_t{128});
  for (const Eigen::Vector2f& keypoint : view.keypoints_px) {
    put(keypoint.x());
    put(keypoint.y());
    put(0.0F);  // colour, scale and orientation are not in a map
    put(1.0F);
    put(0.0F);
  }
  for (const map::Descriptor& descriptor : view.descriptors) {
    for (const std::uint8_t value : SiftFromRootSift(descriptor)) put(value);
  }
  return out +
         "\xFF"
         "EOF";
}

absl::StatusOr<std::string> NvmText(const map::MapData& data,
                                    std::vector<std::string>* warnings) {
  std::vector<FittedNvm> fitted;
  double max_residual_px = 0.0;
  for (std::size_t i = 0; i < data.cameras.size(); ++i) {
    auto nvm = NvmFromCamera(data.cameras[i]);
    if (!nvm.ok()) {
      return base::Annotate(nvm.status(), absl::StrCat("camera ", i));
    }
    max_residual_px = std::max(max_residual_px, nvm->max_residual_px);
    fitted.push_back(*nvm);
  }
  if (max_residual_px > kInexactExport_px && warnings != nullptr) {
    warnings->push_back(absl::StrCat(
        "NVM has one distortion coefficient, in the other direction; at the "
        "border the exported cameras are up to ",
        max_residual_px,
        " px off"));
  }
  std::string out = absl::StrCat("NVM_V3 \n\n", data.views.size(), "\n");
  for (const map::MapViewData& view : data.views) {
    AppendCamera(view, fitted[view.camera], &out);
  }
  out += "\n";
  AppendPoints(data, &out);
  return out + "\n0\n";
}

// Renames every file of `directory` into `parent`, the .nvm last; on an error
// those already moved go away again.
absl::Status Publish(const fs::path& directory,
                     const fs::path& parent,
                     const std::vector<std::string>& names) {
  std::error_code error;
  for (std::size_t i = 0; i < names.size(); ++i) {
    fs::rename(directory / names[i], parent / names[i], error);
    if (!error) continue;
    std::error_code ignored;
    for (std::size_t j = 0; j < i; ++j) fs::remove(parent / names[j], ignored);
    return absl::InternalError(
        absl::StrCat((parent / names[i]).string(), ": ", error.message()));
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status ExportNvm(const map::MapData& data,
                       const fs::path& path,
                       std::vector<std::string>* warnings) {
  const fs::path parent =
      path.has_parent_path() ? path.parent_path() : fs::path(".");
  ASSIGN_OR_RETURN(const std::string text, NvmText(data, warnings));
  ASSIGN_OR_RETURN(const base::TemporaryDirectory directory,
                   base::TemporaryDirectory::Create(parent));
  std::vector<std::string> names;
  absl::flat_hash_set<std::string> taken = {path.filename().string()};
  for (const map::MapViewData& view : data.views) {
    if (!data.has_descriptors()) break;
    const std::string name = SiftName(view.name);
    if (!taken.insert(name).second) {
      return absl::FailedPreconditionError(
          absl::StrCat("image ",
                       view.name,
                       ": another file of this export is called ",
                       name));
    }
    std::error_code error;
    if (fs::exists(parent / name, error)) {
      return absl::AlreadyExistsError(
          absl::StrCat((parent / name).string(), " is already there"));
    }
    RETURN_IF_ERROR(
        base::WriteFileAtomically(directory.path() / name, SiftBytes(view)));
    names.push_back(name);
  }
  names.push_back(path.filename().string());
  RETURN_IF_ERROR(
      base::WriteFileAtomically(directory.path() / names.back(), text));
  return Publish(directory.path(), parent, names);
}

}  // namespace groundlock::formats::internal
