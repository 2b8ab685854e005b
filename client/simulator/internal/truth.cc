// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/truth.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace groundlock::simulator {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Box2;

constexpr int kSamples = 1'800;
constexpr int kEdgeSteps = 16;  // the lens bends a cuboid's edges

void Grow(std::optional<Box2>& box, const Vector2d& p) {
  if (!box) box = Box2{p, p};
  box->min_px = box->min_px.cwiseMin(p);
  box->max_px = box->max_px.cwiseMax(p);
}

// Box of the cuboid's twelve edges.
std::optional<Box2> CuboidBox(const Lens& lens,
                              const geometry::Rigid3& camera_from_car) {
  std::optional<Box2> box;
  const Vector3d half(
      kCarLength_m / 2.0, kCarWidth_m / 2.0, kCarHeight_m / 2.0);
  const auto corner = [&](int bits) {
    return Vector3d((bits & 1) != 0 ? half.x() : -half.x(),
                    (bits & 2) != 0 ? half.y() : -half.y(),
                    (bits & 4) != 0 ? 2 * half.z() : 0.0);
  };
  for (int from = 0; from < 8; ++from) {
    for (const int bit : {1, 2, 4}) {
      if ((from & bit) != 0) continue;
      for (int i = 0; i <= kEdgeSteps; ++i) {
        const double f = static_cast<double>(i) / kEdgeSteps;
        const Vector3d p = (1 - f) * corner(from) + f * corner(from | bit);
        const auto pixel = lens.Project(camera_from_car * p);
        if (!pixel) return std::nullopt;
        Grow(box, *pixel);
      }
    }
  }
  return box;
}

std::string BoxFields(const std::optional<Box2>& box) {
  if (!box) return ",,,,";
  return absl::StrFormat(
      ",%.2f,%.2f,%.2f,%.2f", box->x(), box->y(), box->width(), box->height());
}

std::string QuaternionFields(const Eigen::Quaterniond& q) {
  return absl::StrFormat(",%.9f,%.9f,%.9f,%.9f", q.w(), q.x(), q.y(), q.z());
}

}  // namespace

CarSamples::CarSamples(const std::vector<CarFace>& car, std::uint64_t seed) {
  std::vector<double> area_until;
  double total = 0.0;
  const auto triangle = [&](const CarFace& face, int half) {
    const auto& c = face.corners_car;
    return half == 0 ? std::array{c[0], c[1], c[2]}
                     : std::array{c[0], c[2], c[3]};
  };
  for (const CarFace& face : car) {
    for (const int half : {0, 1}) {
      const auto t = triangle(face, half);
      total += 0.5 * (t[1] - t[0]).cross(t[2] - t[0]).norm();
      area_until.push_back(total);
    }
  }
  cv::RNG rng(seed);
  for (int i = 0; i < kSamples; ++i) {
    // Stratified over the area, uniform within a triangle.
    const double at = total * (i + rng.uniform(0.0, 1.0)) / kSamples;
    const auto index = std::min<std::size_t>(
        std::upper_bound(area_until.begin(), area_until.end(), at) -
            area_until.begin(),
        area_until.size() - 1);
    const CarFace& face = car[index / 2];
    const auto t = triangle(face, static_cast<int>(index % 2));
    const double root = std::sqrt(rng.uniform(0.0, 1.0));
    const double b = rng.uniform(0.0, 1.0) * root;
    const Vector3d p = (1 - root) * t[0].cast<double>() +
                       (root - b) * t[1].cast<double>() +
                       b * t[2].cast<double>();
    samples_.push_back({p, face.normal_car.cast<double>()});
  }
}

TargetTruth CarSamples::Measure(const Renderer& renderer,
                                const Moment& moment) const {
  TargetTruth truth;
  const geometry::Rigid3& world_from_car = *moment.world_from_car;
  const geometry::Rigid3 camera_from_car =
      moment.world_from_camera.Inverse() * world_from_car;
  const Lens& lens = renderer.lens();
  truth.box = CuboidBox(lens, camera_from_car);
  const Vector3d eye_car = camera_from_car.Inverse().translation;
  int facing = 0;
  int visible = 0;
  int inframe = 0;
  int seen = 0;
  for (const Sample& sample : samples_) {
    if (sample.normal_car.dot(eye_car - sample.p_car) <= 0.0) continue;
    ++facing;
    const Vector3d eye = moment.world_from_camera.translation;
    const Vector3d p_world = world_from_car * sample.p_car;
    const bool is_visible =
        !renderer.Blocked(eye, p_world) &&
        std::none_of(moment.world_from_other_cars.begin(),
                     moment.world_from_other_cars.end(),
                     [&](const geometry::Rigid3& other) {
                       return renderer.BlockedByCar(other, eye, p_world);
                     });
    const auto pixel = lens.Project(camera_from_car * sample.p_car);
    const bool is_inframe = pixel && lens.Contains(*pixel);
    visible += is_visible ? 1 : 0;
    inframe += is_inframe ? 1 : 0;
    if (is_visible && is_inframe) {
      ++seen;
      Grow(truth.seen_box, *pixel);
    }
  }
  if (facing > 0) {
    truth.visible_fraction = static_cast<double>(visible) / facing;
    truth.inframe_fraction = static_cast<double>(inframe) / facing;
    truth.seen_fraction = static_cast<double>(seen) / facing;
  }
  return truth;
}

std::string TruthHeader(bool has_target) {
  std::string header = "frame,t_s,cam_x,cam_y,cam_z,q_w,q_x,q_y,q_z";
  if (has_target) {
    header +=
        ",tgt_x,tgt_y,tgt_z,tgt_heading_rad,tgt_len,tgt_wid,tgt_hei,"
        "tgt_qw,tgt_qx,tgt_qy,tgt_qz,box_x,box_y,box_w,box_h,"
        "vis_x,vis_y,vis_w,vis_h,visible_fraction,inframe_fraction,"
        "seen_fraction,in_view";
  }
  return header + "\n";
}

std::string TruthRow(int frame,
                     double t_s,
                     const Moment& moment,
                     const std::optional<TargetTruth>& target) {
  const Vector3d& eye = moment.world_from_camera.translation;
  std::string row = absl::StrFormat(
      "%d,%.6f,%.6f,%.6f,%.6f", frame, t_s, eye.x(), eye.y(), eye.z());
  row += QuaternionFields(moment.world_from_camera.rotation);
  if (target && moment.world_from_car) {
    const geometry::Rigid3& car = *moment.world_from_car;
    const Vector3d forward = car.rotation * Vector3d::UnitX();
    absl::StrAppend(&row,
                    absl::StrFormat(",%.6f,%.6f,%.6f,%.6f,%.2f,%.2f,%.2f",
                                    car.translation.x(),
                                    car.translation.y(),
                                    car.translation.z(),
                                    std::atan2(forward.y(), forward.x()),
                                    kCarLength_m,
                                    kCarWidth_m,
                                    kCarHeight_m),
                    QuaternionFields(car.rotation),
                    BoxFields(target->box),
                    BoxFields(target->seen_box),
                    absl::StrFormat(",%.4f,%.4f,%.4f,%d",
                                    target->visible_fraction,
                                    target->inframe_fraction,
                                    target->seen_fraction,
                                    target->in_view() ? 1 : 0));
  }
  return row + "\n";
}

}  // namespace groundlock::simulator
