// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/report_pictures.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/file.h"
#include "map_store/base/order_statistics.h"

namespace groundlock::build::internal {
namespace {

constexpr int kSize_px = 900;
constexpr int kMargin_px = 30;
constexpr int kCell_px = 12;
constexpr double kStrays = 0.02;  // of the landmarks, at either end
const cv::Scalar kBackground(250, 250, 250);
const cv::Scalar kGrid(225, 225, 225);
const cv::Scalar kText(90, 90, 90);
const cv::Scalar kCamera(40, 40, 220);
const cv::Scalar kGround(30, 130, 30);

// From world to picture. The plane's axes go to the right and up.
struct View {
  Eigen::Matrix<double, 2, 3> plane_from_world;
  Eigen::RowVector3d towards_viewer;
  Eigen::Vector2d min_map = Eigen::Vector2d::Zero();
  Eigen::Vector2d max_map = Eigen::Vector2d::Ones();
  double px_per_unit = 1.0;
  cv::Size size_px;

  cv::Point2d PixelOfPlane(const Eigen::Vector2d& p) const {
    return {kMargin_px + (p.x() - min_map.x()) * px_per_unit,
            size_px.height - kMargin_px - (p.y() - min_map.y()) * px_per_unit};
  }
  cv::Point2d Pixel(const Eigen::Vector3d& p) const {
    return PixelOfPlane(plane_from_world * p);
  }
  bool Holds(const cv::Point2d& pixel) const {
    return pixel.x >= 0 && pixel.y >= 0 && pixel.x < size_px.width &&
           pixel.y < size_px.height;
  }
};

// All cameras and nearly all landmarks: a few strays do not shrink the rest.
View ViewOf(const map::MapData& data,
            const Eigen::Matrix<double, 2, 3>& plane_from_world) {
  View view;
  view.plane_from_world = plane_from_world;
  view.towards_viewer = plane_from_world.row(0).cross(plane_from_world.row(1));
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::RowVector3d along = plane_from_world.row(axis);
    std::vector<double> landmarks;
    for (const map::MapLandmarkData& landmark : data.landmarks) {
      landmarks.push_back(along * landmark.p_world);
    }
    double low = landmarks.empty() ? 0.0 : base::Quantile(landmarks, kStrays);
    double high =
        landmarks.empty() ? 1.0 : base::Quantile(landmarks, 1.0 - kStrays);
    for (const map::MapViewData& camera : data.views) {
      const double at = along * camera.camera_from_world.Inverse().translation;
      low = std::min(low, at);
      high = std::max(high, at);
    }
    view.min_map[axis] = low;
    view.max_map[axis] = std::max(high, low + 1e-9);
  }
  const Eigen::Vector2d extent = view.max_map - view.min_map;
  view.px_per_unit = (kSize_px - 2 * kMargin_px) / extent.maxCoeff();
  view.size_px = cv::Size(
      2 * kMargin_px +
          std::max(1, static_cast<int>(extent.x() * view.px_per_unit)),
      2 * kMargin_px +
          std::max(1, static_cast<int>(extent.y() * view.px_per_unit)));
  return view;
}

View ViewFromAbove(const map::MapData& data) {
  Eigen::Matrix<double, 2, 3> plane_from_world;
  plane_from_world << 1.0, 0.0, 0.0, 0.0, 1.0, 0.0;
  return ViewOf(data, plane_from_world);
}

View ViewFromTheSide(const map::MapData& data) {
  // The medians leave strays without a say.
  std::vector<double> xs;
  std::vector<double> ys;
  for (const map::MapLandmarkData& landmark : data.landmarks) {
    xs.push_back(landmark.p_world.x());
    ys.push_back(landmark.p_world.y());
  }
  Eigen::Vector2d along = Eigen::Vector2d::UnitX();
  if (!xs.empty()) {
    const Eigen::Vector2d low(base::Quantile(xs, kStrays),
                              base::Quantile(ys, kStrays));
    const Eigen::Vector2d high(base::Quantile(xs, 1.0 - kStrays),
                               base::Quantile(ys, 1.0 - kStrays));
    const Eigen::Vector2d middle(base::Median(xs), base::Median(ys));
    Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
    for (const map::MapLandmarkData& landmark : data.landmarks) {
      const Eigen::Vector2d p = landmark.p_world.head<2>();
      if ((p.array() < low.array()).any() || (p.array() > high.array()).any()) {
        continue;
      }
      spread += (p - middle) * (p - middle).transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> axes(spread);
    if (axes.info() == Eigen::Success) along = axes.eigenvectors().col(1);
    // Not mirrored from one build to the next.
    if (along.x() < 0.0) along = -along;
  }
  Eigen::Matrix<double, 2, 3> plane_from_world;
  plane_from_world << along.x(), along.y(), 0.0, 0.0, 0.0, 1.0;
  return ViewOf(data, plane_from_world);
}

// 1, 2 or 5 times a power of ten, about a tenth of the picture.
double GridStep(const View& view) {
  const double wanted = kSize_px / view.px_per_unit / 10.0;
  const double power = std::pow(10.0, std::floor(std::log10(wanted)));
  for (const double step : {1.0, 2.0, 5.0}) {
    if (step * power >= wanted) return step * power;
  }
  return 10.0 * power;
}

void DrawGrid(const View& view, cv::Mat* picture) {
  const double step = GridStep(view);
  for (double x = std::ceil(view.min_map.x() / step) * step;
       x <= view.max_map.x();
       x += step) {
    const cv::Point p = view.PixelOfPlane({x, view.min_map.y()});
    cv::line(*picture, {p.x, 0}, {p.x, picture->rows}, kGrid);
  }
  for (double y = std::ceil(view.min_map.y() / step) * step;
       y <= view.max_map.y();
       y += step) {
    const cv::Point p = view.PixelOfPlane({view.min_map.x(), y});
    cv::line(*picture, {0, p.y}, {picture->cols, p.y}, kGrid);
  }
  cv::putText(*picture,
              absl::StrFormat("grid: %g", step),
              {8, picture->rows - 10},
              cv::FONT_HERSHEY_SIMPLEX,
              0.45,
              kText,
              1,
              cv::LINE_AA);
}

void DrawCameras(const map::MapData& data, const View& view, cv::Mat* picture) {
  std::vector<const map::MapViewData*> by_name;
  for (const map::MapViewData& camera : data.views) by_name.push_back(&camera);
  std::sort(by_name.begin(),
            by_name.end(),
            [](const map::MapViewData* a, const map::MapViewData* b) {
              return a->name < b->name;
            });
  for (const map::MapViewData* camera : by_name) {
    const geometry::Rigid3 world_from_camera =
        camera->camera_from_world.Inverse();
    const cv::Point2d at = view.Pixel(world_from_camera.translation);
    const Eigen::Vector2d ahead =
        view.plane_from_world *
        (world_from_camera.rotation * Eigen::Vector3d::UnitZ());
    Eigen::Vector2d direction(ahead.x(), -ahead.y());
    if (direction.norm() > 1e-6) direction.normalize();
    const Eigen::Vector2d side(-direction.y(), direction.x());
    std::vector<cv::Point> wedge = {cv::Point(at)};
    for (const double sign : {-1.0, 1.0}) {
      const Eigen::Vector2d corner = 13.0 * direction + sign * 6.0 * side;
      wedge.emplace_back(static_cast<int>(at.x + corner.x()),
                         static_cast<int>(at.y + corner.y()));
    }
    cv::polylines(*picture, wedge, true, kCamera, 1, cv::LINE_AA);
    cv::circle(*picture, at, 2, kCamera, cv::FILLED, cv::LINE_AA);
  }
}

absl::Status WritePng(const cv::Mat& picture,
                      const std::filesystem::path& path) {
  try {
    std::vector<unsigned char> bytes;
    if (cv::imencode(".png", picture, bytes)) {
      return base::WriteFileAtomically(
          path, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
    }
  } catch (const cv::Exception&) {
    // Says the same as false.
  }
  return absl::InternalError(absl::StrCat("cannot draw ", path.string()));
}

void DrawLandmarks(const map::MapData& data,
                   const View& view,
                   cv::Mat* picture) {
  // Nearer ones cover those behind them.
  std::vector<const map::MapLandmarkData*> from_behind;
  for (const map::MapLandmarkData& landmark : data.landmarks) {
    from_behind.push_back(&landmark);
  }
  std::stable_sort(
      from_behind.begin(),
      from_behind.end(),
      [&](const map::MapLandmarkData* a, const map::MapLandmarkData* b) {
        return view.towards_viewer.dot(a->p_world.transpose()) <
               view.towards_viewer.dot(b->p_world.transpose());
      });
  for (const map::MapLandmarkData* landmark : from_behind) {
    const cv::Point2d p = view.Pixel(landmark->p_world);
    if (!view.Holds(p)) continue;
    const auto& rgb = landmark->rgb;
    cv::circle(*picture, p, 1, cv::Scalar(rgb[2], rgb[1], rgb[0]), cv::FILLED);
  }
}

}  // namespace

absl::Status WritePictureFromAbove(const map::MapData& aligned,
                                   const std::filesystem::path& path) {
  const View view = ViewFromAbove(aligned);
  cv::Mat picture(view.size_px, CV_8UC3, kBackground);
  DrawGrid(view, &picture);
  DrawLandmarks(aligned, view, &picture);
  DrawCameras(aligned, view, &picture);
  return WritePng(picture, path);
}

absl::Status WritePictureFromTheSide(const map::MapData& aligned,
                                     bool has_ground,
                                     const std::filesystem::path& path) {
  const View view = ViewFromTheSide(aligned);
  cv::Mat picture(view.size_px, CV_8UC3, kBackground);
  DrawGrid(view, &picture);
  DrawLandmarks(aligned, view, &picture);
  if (has_ground) {
    const cv::Point ground = view.PixelOfPlane({view.min_map.x(), 0.0});
    cv::line(picture,
             {0, ground.y},
             {picture.cols, ground.y},
             kGround,
             1,
             cv::LINE_AA);
  }
  DrawCameras(aligned, view, &picture);
  return WritePng(picture, path);
}

absl::Status WriteCoveragePicture(const map::MapData& aligned,
                                  const std::filesystem::path& path) {
  const View view = ViewFromAbove(aligned);
  const int columns = view.size_px.width / kCell_px + 1;
  const int rows = view.size_px.height / kCell_px + 1;
  std::vector<std::set<std::uint32_t>> seen_by(
      static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows));
  for (std::uint32_t v = 0; v < aligned.views.size(); ++v) {
    for (const std::uint32_t landmark : aligned.views[v].landmarks) {
      const cv::Point2d p = view.Pixel(aligned.landmarks[landmark].p_world);
      if (!view.Holds(p)) continue;
      const auto cell = static_cast<std::size_t>(p.y / kCell_px) *
                            static_cast<std::size_t>(columns) +
                        static_cast<std::size_t>(p.x / kCell_px);
      seen_by[cell].insert(v);
    }
  }
  std::size_t most = 1;
  for (const auto& views : seen_by) most = std::max(most, views.size());
  cv::Mat counts(rows, columns, CV_8UC1, cv::Scalar(0));
  for (int y = 0; y < rows; ++y) {
    for (int x = 0; x < columns; ++x) {
      const auto& views = seen_by[static_cast<std::size_t>(y) *
                                      static_cast<std::size_t>(columns) +
                                  static_cast<std::size_t>(x)];
      counts.at<unsigned char>(y, x) =
          static_cast<unsigned char>(255.0 * static_cast<double>(views.size()) /
                                     static_cast<double>(most));
    }
  }
  cv::Mat large;
  cv::resize(counts, large, cv::Size(), kCell_px, kCell_px, cv::INTER_NEAREST);
  cv::Mat picture;
  cv::applyColorMap(large, picture, cv::COLORMAP_INFERNO);
  DrawCameras(aligned, view, &picture);
  cv::putText(picture,
              absl::StrFormat("brightest: seen by %d images", most),
              {8, picture.rows - 10},
              cv::FONT_HERSHEY_SIMPLEX,
              0.45,
              cv::Scalar(230, 230, 230),
              1,
              cv::LINE_AA);
  return WritePng(picture, path);
}

}  // namespace groundlock::build::internal
