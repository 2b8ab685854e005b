// SPDX-License-Identifier: Apache-2.0
// Writes COLMAP's model, binary or text, and a database with the descriptors.
// Ids are indices plus one.
#include <charconv>
#include <cstring>

#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/sqlite.h"

namespace groundlock::formats::internal {
namespace {

namespace fs = std::filesystem;

// One observation of a landmark, as points3D wants it.
struct TrackElement {
  std::uint32_t image_id = 0;
  std::uint32_t index = 0;
};
using Tracks = std::vector<std::vector<TrackElement>>;

Tracks TracksOf(const map::MapData& data) {
  Tracks tracks(data.landmarks.size());
  for (std::uint32_t i = 0; i < data.views.size(); ++i) {
    const std::vector<std::uint32_t>& landmarks = data.views[i].landmarks;
    for (std::uint32_t j = 0; j < landmarks.size(); ++j) {
      tracks[landmarks[j]].push_back({i + 1, j});
    }
  }
  return tracks;
}

// w, x, y, z and t, in the file's order.
std::array<double, 7> PoseNumbers(const geometry::Rigid3& rigid) {
  const Eigen::Quaterniond& q = rigid.rotation;
  const Eigen::Vector3d& t = rigid.translation;
  return {q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z()};
}

template <typename T>
void Put(T value, std::string* out) {
  static_assert(std::is_arithmetic_v<T>);
  char bytes[sizeof(T)];
  std::memcpy(bytes, &value, sizeof(T));
  out->append(bytes, sizeof(T));
}

// The shortest text that reads back as the same number.
template <typename T>
void Print(T value, std::string* out) {
  char text[64];
  const auto result = std::to_chars(text, text + sizeof(text), value);
  out->append(text, result.ptr);
}

template <typename T>
void PrintWord(T value, std::string* out) {
  Print(value, out);
  out->push_back(' ');
}

std::string CamerasBinary(const map::MapData& data) {
  std::string out;
  Put<std::uint64_t>(data.cameras.size(), &out);
  for (std::uint32_t i = 0; i < data.cameras.size(); ++i) {
    const geometry::CameraModel& camera = data.cameras[i];
    Put<std::uint32_t>(i + 1, &out);
    Put<std::int32_t>(static_cast<std::int32_t>(camera.id()), &out);
    Put<std::uint64_t>(static_cast<std::uint64_t>(camera.width_px()), &out);
    Put<std::uint64_t>(static_cast<std::uint64_t>(camera.height_px()), &out);
    for (const double param : camera.params()) Put(param, &out);
  }
  return out;
}

std::string ImagesBinary(const map::MapData& data) {
  std::string out;
  Put<std::uint64_t>(data.views.size(), &out);
  for (std::uint32_t i = 0; i < data.views.size(); ++i) {
    const map::MapViewData& view = data.views[i];
    Put<std::uint32_t>(i + 1, &out);
    for (const double v : PoseNumbers(view.camera_from_world)) Put(v, &out);
    Put<std::uint32_t>(view.camera + 1, &out);
    out.append(view.name).push_back('\0');
    Put<std::uint64_t>(view.landmarks.size(), &out);
    for (std::size_t j = 0; j < view.landmarks.size(); ++j) {
      Put<double>(view.keypoints_px[j].x(), &out);
      Put<double>(view.keypoints_px[j].y(), &out);
      Put<std::uint64_t>(view.landmarks[j] + std::uint64_t{1}, &out);
    }
  }
  return out;
}

std::string PointsBinary(const map::MapData& data) {
  const Tracks tracks = TracksOf(data);
  std::string out;
  Put<std::uint64_t>(data.landmarks.size(), &out);
  for (std::size_t i = 0; i < data.landmarks.size(); ++i) {
    const map::MapLandmarkData& landmark = data.landmarks[i];
    Put<std::uint64_t>(i + 1, &out);
    for (const double v : landmark.p_world) Put(v, &out);
    for (const std::uint8_t c : landmark.rgb) Put(c, &out);
    Put<double>(landmark.error_px, &out);
    Put<std::uint64_t>(tracks[i].size(), &out);
    for (const TrackElement& element : tracks[i]) {
      Put(element.image_id, &out);
      Put(element.index, &out);
    }
  }
  return out;
}

std::string CamerasText(const map::MapData& data) {
  std::string out = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
  for (std::size_t i = 0; i < data.cameras.size(); ++i) {
    const geometry::CameraModel& camera = data.cameras[i];
    PrintWord(i + 1, &out);
    out.append(geometry::CameraModelName(camera.id())).push_back(' ');
    PrintWord(camera.width_px(), &out);
    Print(camera.height_px(), &out);
    for (const double param : camera.params()) {
      out.push_back(' ');
      Print(param, &out);
    }
    out.push_back('\n');
  }
  return out;
}

std::string ImagesText(const map::MapData& data) {
  std::string out =
      "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
      "# POINTS2D[] as (X, Y, POINT3D_ID)\n";
  for (std::size_t i = 0; i < data.views.size(); ++i) {
    const map::MapViewData& view = data.views[i];
    PrintWord(i + 1, &out);
    for (const double v : PoseNumbers(view.camera_from_world)) {
      PrintWord(v, &out);
    }
    PrintWord(view.camera + 1, &out);
    out.append(view.name).push_back('\n');
    for (std::size_t j = 0; j < view.landmarks.size(); ++j) {
      PrintWord(view.keypoints_px[j].x(), &out);
      PrintWord(view.keypoints_px[j].y(), &out);
      PrintWord(view.landmarks[j] + std::uint64_t{1}, &out);
    }
    if (!view.landmarks.empty()) out.pop_back();
    out.push_back('\n');
  }
  return out;
}

std::string PointsText(const map::MapData& data) {
  const Tracks tracks = TracksOf(data);
  std::string out =
      "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, "
      "POINT2D_IDX)\n";
  for (std::size_t i = 0; i < data.landmarks.size(); ++i) {
    const map::MapLandmarkData& landmark = data.landmarks[i];
    PrintWord(i + 1, &out);
    for (const double v : landmark.p_world) PrintWord(v, &out);
    for (const std::uint8_t c : landmark.rgb) PrintWord(int{c}, &out);
    Print(landmark.error_px, &out);
    for (const TrackElement& element : tracks[i]) {
      out.push_back(' ');
      PrintWord(element.image_id, &out);
      Print(element.index, &out);
    }
    out.push_back('\n');
  }
  return out;
}

}  // namespace

absl::Status ExportColmap(const map::MapData& data,
                          bool binary,
                          const fs::path& path) {
  const fs::path parent =
      path.has_parent_path() ? path.parent_path() : fs::path(".");
  ASSIGN_OR_RETURN(base::TemporaryDirectory directory,
                   base::TemporaryDirectory::Create(parent));
  const fs::path& root = directory.path();
  if (binary) {
    RETURN_IF_ERROR(
        base::WriteFileAtomically(root / "cameras.bin", CamerasBinary(data)));
    RETURN_IF_ERROR(
        base::WriteFileAtomically(root / "images.bin", ImagesBinary(data)));
    RETURN_IF_ERROR(
        base::WriteFileAtomically(root / "points3D.bin", PointsBinary(data)));
  } else {
    RETURN_IF_ERROR(
        base::WriteFileAtomically(root / "cameras.txt", CamerasText(data)));
    RETURN_IF_ERROR(
        base::WriteFileAtomically(root / "images.txt", ImagesText(data)));
    RETURN_IF_ERROR(
        base::WriteFileAtomically(root / "points3D.txt", PointsText(data)));
  }
  if (data.has_descriptors()) {
    RETURN_IF_ERROR(WriteColmapDatabase(data, root / "database.db"));
  }
  // A temporary directory is its owner's alone; an export is a folder like any.
  std::error_code error;
  fs::permissions(root,
                  fs::perms::owner_all | fs::perms::group_read |
                      fs::perms::group_exec | fs::perms::others_read |
                      fs::perms::others_exec,
                  error);
  if (!error) fs::rename(root, path, error);
  if (error) {
    return absl::InternalError(
        absl::StrCat(path.string(), ": ", error.message()));
  }
  directory.Release();
  return absl::OkStatus();
}

}  // namespace groundlock::formats::internal
