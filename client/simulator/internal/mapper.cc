// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/mapper.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <opencv2/features2d.hpp>
#include <optional>

#include "client/simulator/internal/parallel.h"
#include "map_store/features/sift_features.h"

namespace groundlock::simulator {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kMaxFeatures = 6'000;
constexpr double kContrast = 0.02;  // measured on sequences with blur
constexpr int kNeighbours = 7;      // views matched with each view
constexpr double kMinOverlap = 0.25;
constexpr double kMinBaseline_m = 0.12;
constexpr double kEpipolar_px = 2.0;
constexpr float kRatio = 0.8F;          // Lowe 2004
constexpr float kMaxDistance = 260.0F;  // of descriptors of length 512
constexpr float kSamePlace_px = 3.0F;   // second orientations do not compete
constexpr double kMaxError_px = 1.5;
constexpr double kMinAngle_rad = 0.026;  // 1.5 degrees
constexpr std::size_t kMinViews = 3;     // Robinson 2014, §3.3
constexpr int kGaussNewtonSteps = 5;

struct Match {
  int a = 0;
  int b = 0;
};

// A view's features as rays, for the epipolar search.
struct Rays {
  std::vector<Vector2d> x;   // undistorted, z = 1
  Eigen::Matrix2Xf x_float;  // the same
};

Rays MakeRays(const Lens& lens, const MapView& view) {
  Rays rays;
  rays.x_float.resize(2, static_cast<int>(view.p_px.size()));
  for (const Vector2d& p : view.p_px) {
    rays.x_float.col(static_cast<int>(rays.x.size())) =
        lens.Undistort(p.x(), p.y()).cast<float>();
    rays.x.push_back(lens.Undistort(p.x(), p.y()));
  }
  return rays;
}

// The share of a coarse set of points in front of `from` that `to` sees.
double Overlap(const Lens& lens, const MapView& from, const MapView& to) {
  const geometry::Rigid3 world_from_camera = from.camera_from_world.Inverse();
  int seen = 0;
  int all = 0;
  for (const double depth_m : {4.0, 8.0, 14.0}) {
    for (int i = 1; i < 8; i += 2) {
      for (int j = 1; j < 6; j += 2) {
        const Vector2d x =
            lens.Undistort(lens.width_px * i / 8.0, lens.height_px * j / 6.0);
        const Vector3d p = world_from_camera * (depth_m * x.homogeneous());
        const auto pixel = lens.Project(to.camera_from_world * p);
        ++all;
        if (pixel && lens.Contains(*pixel)) ++seen;
      }
    }
  }
  return static_cast<double>(seen) / all;
}

std::vector<std::pair<int, int>> ChoosePairs(const YardMap& map) {
  std::vector<std::pair<int, int>> pairs;
  const int count = static_cast<int>(map.views.size());
  for (int i = 0; i < count; ++i) {
    std::vector<std::pair<double, int>> candidates;
    const geometry::Rigid3 a = map.views[i].camera_from_world.Inverse();
    for (int j = 0; j < count; ++j) {
      const geometry::Rigid3 b = map.views[j].camera_from_world.Inverse();
      const double baseline_m = (a.translation - b.translation).norm();
      if (i == j || baseline_m < kMinBaseline_m) continue;
      const double overlap =
          std::min(Overlap(map.lens, map.views[i], map.views[j]),
                   Overlap(map.lens, map.views[j], map.views[i]));
      if (overlap < kMinOverlap) continue;
      // Near views match best: their descriptors have changed least.
      candidates.emplace_back(baseline_m - 1.5 * overlap, j);
    }
    std::sort(candidates.begin(), candidates.end());
    if (candidates.size() > kNeighbours) candidates.resize(kNeighbours);
    for (const auto& [score, j] : candidates) {
      pairs.emplace_back(std::min(i, j), std::max(i, j));
    }
  }
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  return pairs;
}

Matrix3d Essential(const geometry::Rigid3& b_from_a) {
  return geometry::Skew(b_from_a.translation) *
         b_from_a.rotation.toRotationMatrix();
}

float DescriptorDistance2(const std::uint8_t* a, const std::uint8_t* b) {
  int sum = 0;
  for (int i = 0; i < 128; ++i) {
    const int d = static_cast<int>(a[i]) - static_cast<int>(b[i]);
    sum += d * d;
  }
  return static_cast<float>(sum);
}

// The best of b's features near the epipolar line of one of a's, if it is
// clearly better than the next best elsewhere on the line.
int BestAlongLine(const MapView& a,
                  const MapView& b,
                  const Eigen::Matrix2Xf& x_b,
                  const Eigen::Vector3f& line,
                  float gate,
                  int feature,
                  std::vector<int>& near,
                  float* distance2) {
  near.clear();
  for (int j = 0; j < x_b.cols(); ++j) {
    const float d = line.x() * x_b(0, j) + line.y() * x_b(1, j) + line.z();
    if (std::abs(d) < gate) near.push_back(j);
  }
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  int best = -1;
  float first = kInfinity;
  float second = kInfinity;
  const auto* descriptor = a.descriptors.ptr<std::uint8_t>(feature);
  for (const int j : near) {
    const float d =
        DescriptorDistance2(descriptor, b.descriptors.ptr<std::uint8_t>(j));
    const bool same_place =
        best >= 0 && (b.p_px[j] - b.p_px[best]).norm() < kSamePlace_px;
    if (d < first) {
      if (!same_place) second = first;
      first = d;
      best = j;
    } else if (d < second && !same_place) {
      second = d;
    }
  }
  *distance2 = first;
  const bool good =
      first < kMaxDistance * kMaxDistance && first < kRatio * kRatio * second;
  return good ? best : -1;
}

std::vector<Match> MatchPair(const Lens& lens,
                             const MapView& a,
                             const MapView& b,
                             const Rays& rays_a,
                             const Rays& rays_b) {
  const geometry::Rigid3 b_from_a =
      b.camera_from_world * a.camera_from_world.Inverse();
  const Matrix3d essential = Essential(b_from_a);
  const auto gate = static_cast<float>(kEpipolar_px / lens.f);
  // For each of b's features the nearest of a's.
  std::vector<std::pair<float, int>> claim(b.p_px.size(), {0.0F, -1});
  std::vector<int> near;
  for (std::size_t i = 0; i < a.p_px.size(); ++i) {
    Vector3d line = essential * rays_a.x[i].homogeneous();
    line /= std::max(line.head<2>().norm(), 1e-12);
    float distance2 = 0.0F;
    const int j = BestAlongLine(a,
                                b,
                                rays_b.x_float,
                                line.cast<float>(),
                                gate,
                                static_cast<int>(i),
                                near,
                                &distance2);
    if (j < 0) continue;
    if (claim[j].second < 0 || distance2 < claim[j].first) {
      claim[j] = {distance2, static_cast<int>(i)};
    }
  }
  std::vector<Match> matches;
  for (std::size_t j = 0; j < claim.size(); ++j) {
    if (claim[j].second >= 0) {
      matches.push_back({claim[j].second, static_cast<int>(j)});
    }
  }
  return matches;
}

// Sets of features that matches connect.
class Tracks {
 public:
  explicit Tracks(const std::vector<MapView>& views) {
    int total = 0;
    for (const MapView& view : views) {
      first_.push_back(total);
      total += static_cast<int>(view.p_px.size());
    }
    first_.push_back(total);
    parent_.resize(total);
    std::iota(parent_.begin(), parent_.end(), 0);
  }
  void Join(int view_a, int a, int view_b, int b) {
    const int x = Root(first_[view_a] + a);
    const int y = Root(first_[view_b] + b);
    parent_[std::max(x, y)] = std::min(x, y);
  }
  std::vector<std::vector<std::pair<int, int>>> All() {
    std::map<int, std::vector<std::pair<int, int>>> sets;
    int view = 0;
    for (int i = 0; i < static_cast<int>(parent_.size()); ++i) {
      while (i >= first_[view + 1]) ++view;
      sets[Root(i)].emplace_back(view, i - first_[view]);
    }
    std::vector<std::vector<std::pair<int, int>>> tracks;
    for (auto& [root, members] : sets) {
      if (members.size() >= kMinViews) tracks.push_back(std::move(members));
    }
    return tracks;
  }

 private:
  int Root(int i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  std::vector<int> first_;
  std::vector<int> parent_;
};

using Track = std::vector<std::pair<int, int>>;

// A set that joins two places of one view is wrong somewhere: all its members
// in that view go.
Track WithoutConflicts(const YardMap& map, const Track& track) {
  Track kept;
  for (std::size_t i = 0; i < track.size();) {
    std::size_t end = i + 1;
    bool conflict = false;
    const MapView& view = map.views[track[i].first];
    while (end < track.size() && track[end].first == track[i].first) {
      conflict =
          conflict ||
          (view.p_px[track[end].second] - view.p_px[track[i].second]).norm() >
              kSamePlace_px;
      ++end;
    }
    if (!conflict) kept.push_back(track[i]);
    i = end;
  }
  return kept;
}

Vector2d Residual(const YardMap& map,
                  const std::pair<int, int>& at,
                  const Vector3d& p_world) {
  const MapView& view = map.views[at.first];
  const auto pixel = map.lens.Project(view.camera_from_world * p_world);
  if (!pixel) return Vector2d::Constant(1e6);
  return *pixel - view.p_px[at.second];
}

// Nearest point to all rays, then Gauss-Newton on the reprojection error
// (Hartley & Zisserman, 2nd ed., §12.3).
std::optional<Vector3d> Solve(const YardMap& map,
                              const std::vector<Rays>& rays,
                              const Track& track) {
  Matrix3d A = Matrix3d::Zero();
  Vector3d b = Vector3d::Zero();
  for (const auto& [v, f] : track) {
    const geometry::Rigid3 world_from_camera =
        map.views[v].camera_from_world.Inverse();
    const Vector3d d =
        (world_from_camera.rotation * rays[v].x[f].homogeneous()).normalized();
    const Matrix3d across = Matrix3d::Identity() - d * d.transpose();
    A += across;
    b += across * world_from_camera.translation;
  }
  Vector3d p = A.ldlt().solve(b);
  for (int step = 0; step < kGaussNewtonSteps; ++step) {
    Matrix3d H = Matrix3d::Zero();
    Vector3d g = Vector3d::Zero();
    for (const auto& at : track) {
      const Vector2d r = Residual(map, at, p);
      if (r.norm() > 1e5) return std::nullopt;
      Eigen::Matrix<double, 2, 3> J;
      constexpr double kStep_m = 1e-5;
      for (int k = 0; k < 3; ++k) {
        J.col(k) =
            (Residual(map, at, p + kStep_m * Vector3d::Unit(k)) - r) / kStep_m;
      }
      H += J.transpose() * J;
      g += J.transpose() * r;
    }
    p -= H.ldlt().solve(g);
  }
  return p.allFinite() ? std::optional(p) : std::nullopt;
}

bool IsWide(const YardMap& map, const Track& track, const Vector3d& p) {
  double widest = 0.0;
  std::vector<Vector3d> rays;
  for (const auto& at : track) {
    rays.push_back(
        (map.views[at.first].camera_from_world.Inverse().translation - p)
            .normalized());
    for (const Vector3d& other : rays) {
      widest = std::max(
          widest, std::acos(std::clamp(rays.back().dot(other), -1.0, 1.0)));
    }
  }
  return widest >= kMinAngle_rad;
}

// nullopt unless three views agree on a point.
std::optional<MapLandmark> TriangulateTrack(const YardMap& map,
                                            const std::vector<Rays>& rays,
                                            Track track) {
  track = WithoutConflicts(map, track);
  while (track.size() >= kMinViews) {
    const auto p = Solve(map, rays, track);
    if (!p) return std::nullopt;
    std::size_t worst = 0;
    double worst_error = 0.0;
    double sum = 0.0;
    for (std::size_t i = 0; i < track.size(); ++i) {
      const double error = Residual(map, track[i], *p).norm();
      sum += error;
      if (error > worst_error) {
        worst_error = error;
        worst = i;
      }
    }
    if (worst_error <= kMaxError_px) {
      if (!IsWide(map, track, *p)) return std::nullopt;
      MapLandmark landmark;
      landmark.p_world = *p;
      landmark.error_px = sum / static_cast<double>(track.size());
      landmark.rgb = map.views[track[0].first].rgb[track[0].second];
      landmark.track = std::move(track);
      return landmark;
    }
    track.erase(track.begin() + static_cast<std::ptrdiff_t>(worst));
  }
  return std::nullopt;
}

}  // namespace

void ExtractFeatures(const cv::Mat& bgr, MapView& view) {
  cv::Mat grey;
  cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  cv::SIFT::create(kMaxFeatures, 3, kContrast)
      ->detectAndCompute(grey, cv::noArray(), keypoints, descriptors);
  const int count = static_cast<int>(keypoints.size());
  view.descriptors.create(count, 128, CV_8U);
  for (int i = 0; i < count; ++i) {
    const cv::KeyPoint& k = keypoints[i];
    view.p_px.push_back(features::PixelOfSift(k));
    view.scale_angle.push_back(
        {0.5F * k.size, k.angle * static_cast<float>(CV_PI / 180.0)});
    const cv::Vec3b color =
        bgr.at<cv::Vec3b>(std::clamp(cvRound(k.pt.y), 0, bgr.rows - 1),
                          std::clamp(cvRound(k.pt.x), 0, bgr.cols - 1));
    view.rgb.push_back({color[2], color[1], color[0]});
    const map::Descriptor root = features::RootSift(
        std::span<const float, 128>(descriptors.ptr<float>(i), 128));
    std::copy(root.begin(), root.end(), view.descriptors.ptr<std::uint8_t>(i));
  }
  view.landmarks.assign(count, -1);
}

bool Triangulate(YardMap& map,
                 int threads,
                 const std::function<bool(double)>& progress) {
  std::vector<Rays> rays(map.views.size());
  ParallelFor(static_cast<int>(rays.size()), threads, [&](int i) {
    rays[i] = MakeRays(map.lens, map.views[i]);
  });
  const auto pairs = ChoosePairs(map);
  const int count = static_cast<int>(pairs.size());
  std::vector<std::vector<Match>> matches(pairs.size());
  constexpr int kBatch = 16;  // between two calls of progress
  for (int start = 0; start < count; start += kBatch) {
    ParallelFor(std::min(kBatch, count - start), threads, [&](int i) {
      const auto [a, b] = pairs[start + i];
      matches[start + i] =
          MatchPair(map.lens, map.views[a], map.views[b], rays[a], rays[b]);
    });
    if (!progress(0.8 *
                  std::min(1.0, static_cast<double>(start + kBatch) / count))) {
      return false;
    }
  }
  Tracks tracks(map.views);
  for (int i = 0; i < count; ++i) {
    for (const Match& match : matches[i]) {
      tracks.Join(pairs[i].first, match.a, pairs[i].second, match.b);
    }
  }
  const auto all = tracks.All();
  std::vector<std::optional<MapLandmark>> found(all.size());
  ParallelFor(static_cast<int>(all.size()), threads, [&](int i) {
    found[i] = TriangulateTrack(map, rays, all[i]);
  });
  for (auto& landmark : found) {
    if (!landmark) continue;
    for (const auto& [view, feature] : landmark->track) {
      map.views[view].landmarks[feature] =
          static_cast<int>(map.landmarks.size());
    }
    map.landmarks.push_back(*std::move(landmark));
  }
  return progress(1.0);
}

}  // namespace groundlock::simulator
