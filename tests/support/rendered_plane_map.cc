// SPDX-License-Identifier: Apache-2.0
#include "tests/support/rendered_plane_map.h"

#include <Eigen/LU>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <opencv2/core/eigen.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <string>
#include <tuple>
#include <utility>

#include "map_store/features/sift_features.h"
#include "map_store/geometry/plane.h"
#include "server/image/frame.h"
#include "tests/support/perturbation.h"

namespace groundlock::test_support {
namespace {

using geometry::Rigid3;

constexpr int kWidth_px = 640;
constexpr int kHeight_px = 360;
constexpr double kFocal_px = 520.0;
constexpr int kFeatures = 2'500;

// Shapes of all sizes over two octaves of noise: corners and blobs for SIFT,
// gradients everywhere for Lucas-Kanade.
cv::Mat MakeTexture(int width_px, int height_px, std::mt19937_64& engine) {
  cv::Mat texture(height_px, width_px, CV_8UC1, cv::Scalar(128));
  const auto draw = [&](int limit) {
    return static_cast<int>(engine() % static_cast<std::uint64_t>(limit));
  };
  const int shapes = width_px * height_px / 220;
  for (int i = 0; i < shapes; ++i) {
    const cv::Point center(draw(width_px), draw(height_px));
    // Many small ones, a few large ones, large ones first.
    const int size = 3 + draw(1 + 60 * (shapes - i) / shapes + 6) / 2;
    const cv::Scalar level(30 + draw(196));
    if (i % 3 == 0) {
      cv::circle(texture, center, size / 2 + 1, level, cv::FILLED);
    } else {
      const cv::RotatedRect box(
          cv::Point2f(center),
          cv::Size2f(static_cast<float>(size), 3.0F + draw(size)),
          static_cast<float>(draw(180)));
      std::array<cv::Point2f, 4> corners;
      box.points(corners.data());
      std::array<cv::Point, 4> polygon;
      for (int c = 0; c < 4; ++c) polygon[c] = corners[c];
      cv::fillConvexPoly(texture, polygon.data(), 4, level);
    }
  }
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px; ++x) {
      auto& value = texture.at<std::uint8_t>(y, x);
      value = cv::saturate_cast<std::uint8_t>(value + draw(25) - 12);
    }
  }
  // Band-limited, so that bilinear sampling shows the same from every view.
  cv::GaussianBlur(texture, texture, cv::Size(), 0.9);
  return texture;
}

}  // namespace

RenderedPlace::RenderedPlace(std::uint64_t seed) {
  const std::array<double, 3> params = {
      kFocal_px, kWidth_px / 2.0, kHeight_px / 2.0};
  camera_ =
      geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                    kWidth_px,
                                    kHeight_px,
                                    params)
          .value();
  std::mt19937_64 engine(seed);
  const auto add = [&](const Eigen::Vector3d& corner_world,
                       const Eigen::Vector3d& u_world,
                       const Eigen::Vector3d& v_world,
                       const Eigen::Vector2d& size_m,
                       double pixels_per_m) {
    panels_.push_back({corner_world,
                       u_world.normalized(),
                       v_world.normalized(),
                       pixels_per_m,
                       MakeTexture(static_cast<int>(size_m.x() * pixels_per_m),
                                   static_cast<int>(size_m.y() * pixels_per_m),
                                   engine)});
  };
  // Textures about as fine as the image: 520 px / depth.
  const Eigen::Vector3d right = Eigen::Vector3d::UnitX();
  const Eigen::Vector3d down = -Eigen::Vector3d::UnitZ();
  add({-9.0, 9.0, 6.0}, right, down, {18.0, 6.0}, 60.0);
  add({-7.0, 9.0, 0.0}, right, -Eigen::Vector3d::UnitY(), {14.0, 5.5}, 70.0);
  add({-3.6, 7.5, 2.4}, {0.9, -0.45, 0.0}, down, {1.8, 2.4}, 80.0);
  add({1.6, 6.6, 2.0}, {0.9, 0.45, 0.0}, down, {1.8, 2.0}, 80.0);
  add({-0.6, 6.2, 1.3}, right, down, {1.4, 1.3}, 85.0);
  add({2.2, 5.0, 0.9}, right, down, {1.0, 0.9}, 100.0);
}

cv::Mat RenderedPlace::Render(const Rigid3& world_from_camera) const {
  cv::Mat image(kHeight_px, kWidth_px, CV_8UC1, cv::Scalar(110));
  const Rigid3 camera_from_world = world_from_camera.Inverse();
  Eigen::Matrix3d K = camera_.CalibrationMatrix();
  // OpenCV's first pixel is (0, 0).
  K(0, 2) -= image::kPixelCenter;
  K(1, 2) -= image::kPixelCenter;
  for (const Panel& panel : panels_) {
    const Eigen::Vector3d u = panel.u_world / panel.pixels_per_m;
    const Eigen::Vector3d v = panel.v_world / panel.pixels_per_m;
    Eigen::Matrix3d H;
    H << camera_from_world.rotation * u, camera_from_world.rotation * v,
        camera_from_world *
            Eigen::Vector3d(panel.corner_world + image::kPixelCenter * (u + v));
    const Eigen::RowVector3d depth = H.row(2);
    bool is_in_front = true;
    for (const double x : {0.0, 1.0 * panel.texture.cols}) {
      for (const double y : {0.0, 1.0 * panel.texture.rows}) {
        is_in_front &= depth.dot(Eigen::Vector3d(x, y, 1.0)) > 0.1;
      }
    }
    if (!is_in_front) continue;
    cv::Mat image_from_texture;
    cv::eigen2cv(Eigen::Matrix3d(K * H), image_from_texture);
    cv::warpPerspective(panel.texture,
                        image,
                        image_from_texture,
                        image.size(),
                        cv::INTER_LINEAR,
                        cv::BORDER_TRANSPARENT);
  }
  return Perturbed(image);
}

std::optional<RenderedPlace::Hit> RenderedPlace::Intersect(
    const Rigid3& world_from_camera, const Eigen::Vector2d& pixel_px) const {
  const auto ray_camera = camera_.RayFromImage(pixel_px);
  if (!ray_camera) return std::nullopt;
  const Eigen::Vector3d ray_world = world_from_camera.rotation * *ray_camera;
  for (std::size_t i = panels_.size(); i-- > 0;) {
    const Panel& panel = panels_[i];
    const Eigen::Vector3d normal = panel.u_world.cross(panel.v_world);
    const auto p_world =
        geometry::IntersectRay({normal, -normal.dot(panel.corner_world)},
                               world_from_camera.translation,
                               ray_world);
    if (!p_world) continue;
    const Eigen::Vector3d offset = *p_world - panel.corner_world;
    const double x = offset.dot(panel.u_world) * panel.pixels_per_m;
    const double y = offset.dot(panel.v_world) * panel.pixels_per_m;
    if (x >= 0.0 && y >= 0.0 && x < panel.texture.cols &&
        y < panel.texture.rows) {
      return Hit{i, *p_world};
    }
  }
  return std::nullopt;
}

Rigid3 LookAlongY(const Eigen::Vector3d& center_world,
                  double yaw_rad,
                  double pitch_rad) {
  const Eigen::Quaterniond level(
      Eigen::AngleAxisd(-M_PI / 2.0, Eigen::Vector3d::UnitX()));
  const Eigen::Quaterniond yaw(
      Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()));
  const Eigen::Quaterniond pitch(
      Eigen::AngleAxisd(pitch_rad, Eigen::Vector3d::UnitX()));
  return {(yaw * pitch * level).normalized(), center_world};
}

std::vector<Rigid3> MappingViews() {
  std::vector<Rigid3> views;
  for (int i = 0; i < 7; ++i) {
    const double x_m = 0.6 * (i - 3);
    views.push_back(LookAlongY(
        {x_m, 0.2 * (i % 2), 1.6 + 0.15 * (i % 3)}, 0.06 * x_m, -0.03));
  }
  return views;
}

map::MapData MapFromViews(const RenderedPlace& place,
                          std::span<const Rigid3> world_from_camera) {
  // Features that observe one landmark lie within SIFT's error of each other:
  // 1.5 px at 9 m.
  constexpr double kSamePlace_m = 0.025;
  constexpr int kAlike = 230 * 230;  // RootSIFT; unrelated ones lie at 500^2
  struct Candidate {
    Eigen::Vector3d sum_world = Eigen::Vector3d::Zero();
    int count = 0;
    std::size_t last_view = 0;
    map::Descriptor descriptor{};
  };
  using Cell = std::tuple<std::size_t, int, int, int>;
  std::map<Cell, std::vector<std::uint32_t>> cells;
  std::vector<Candidate> candidates;
  map::MapData data;
  data.source_format = "rendered";
  data.metric = true;
  data.cameras.push_back(place.camera());
  for (std::size_t v = 0; v < world_from_camera.size(); ++v) {
    const auto features = features::ExtractSift(
        place.Render(world_from_camera[v]), {}, {.max_features = kFeatures});
    map::MapViewData& view = data.views.emplace_back();
    view.name = "view" + std::to_string(v) + ".png";
    view.camera_from_world = world_from_camera[v].Inverse();
    for (std::size_t i = 0; i < features->descriptors.size(); ++i) {
      const map::Descriptor& descriptor = features->descriptors[i];
      const auto hit =
          place.Intersect(world_from_camera[v], features->keypoints_px[i]);
      if (!hit) continue;
      const Eigen::Vector3i cell =
          (hit->p_world / kSamePlace_m).array().floor().cast<int>();
      std::uint32_t best = 0;
      int best_distance = kAlike;
      for (int n = 0; n < 27; ++n) {
        const auto found = cells.find({hit->panel,
                                       cell.x() + n % 3 - 1,
                                       cell.y() + n / 3 % 3 - 1,
                                       cell.z() + n / 9 - 1});
        if (found == cells.end()) continue;
        for (const std::uint32_t id : found->second) {
          const Candidate& candidate = candidates[id];
          const double distance_m =
              (candidate.sum_world / candidate.count - hit->p_world).norm();
          const int distance =
              map::SquaredDistance(candidate.descriptor, descriptor);
          if (candidate.last_view != v && distance_m < kSamePlace_m &&
              distance < best_distance) {
            best = id;
            best_distance = distance;
          }
        }
      }
      if (best_distance == kAlike) {
        best = static_cast<std::uint32_t>(candidates.size());
        candidates.emplace_back();
        cells[{hit->panel, cell.x(), cell.y(), cell.z()}].push_back(best);
      }
      Candidate& candidate = candidates[best];
      candidate.sum_world += hit->p_world;
      ++candidate.count;
      candidate.last_view = v;
      candidate.descriptor = descriptor;
      view.keypoints_px.emplace_back(features->keypoints_px[i].cast<float>());
      view.landmarks.push_back(best);
      view.descriptors.push_back(descriptor);
    }
  }
  for (const Candidate& candidate : candidates) {
    data.landmarks.push_back(
        {candidate.sum_world / candidate.count, {128, 128, 128}, 0.5F});
  }
  return data;
}

std::shared_ptr<const map::Map> OpenTemporaryMap(const map::MapData& data) {
  std::string folder =
      (std::filesystem::temp_directory_path() / "groundlock_test_XXXXXX")
          .string();
  if (mkdtemp(folder.data()) == nullptr) return nullptr;
  const std::filesystem::path path = std::filesystem::path(folder) / "map";
  if (!map::WriteMapFile(data, path).ok()) return nullptr;
  auto opened = map::Map::Open(path);
  // The mapping outlives the name.
  std::filesystem::remove_all(folder);
  return opened.ok() ? *opened : nullptr;
}

}  // namespace groundlock::test_support
