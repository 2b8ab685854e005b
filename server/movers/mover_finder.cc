// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstddef>
#include <map>
#include <optional>
#include <utility>

#include "map_store/base/order_statistics.h"
#include "map_store/geometry/plane.h"
#include "server/movers/mover_list.h"
#include "server/movers/movers.h"
#include "server/movers/point_field.h"
#include "server/movers/point_judge.h"
#include "server/movers/thing_finder.h"

namespace groundlock::movers {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Box2;
using Kind = FieldPoint::Kind;

constexpr double kMaxGap_s = 1.0;
// Points are looked for around what moves.
constexpr double kBusyMargin = 0.3;
constexpr double kBusyMargin_px = 16.0;
constexpr std::size_t kMaxLonePoints = 16;
// A target's shadow and outline belong to it.
constexpr double kTargetMargin = 0.1;

Box2 Enlarged(const Box2& box_px, double share, double margin_px) {
  return Box2::FromCenter(box_px.center_px(),
                          (1.0 + 2.0 * share) * box_px.size_px() +
                              Vector2d::Constant(2.0 * margin_px));
}

// A place in the axes of the ground's reference plane, on the ground there.
Vector3d OnGround(const MoversFrame& frame,
                  const geometry::PlaneAxes& axes,
                  const Vector2d& place_m) {
  const Vector3d on_reference = axes.ToWorld(place_m);
  const auto patch = frame.ground->At(on_reference);
  if (!patch) return on_reference;
  const Vector3d& up = frame.ground->reference_world().normal;
  return on_reference -
         up * (patch->tangent_world.SignedDistance(on_reference) /
               patch->tangent_world.normal.dot(up));
}

}  // namespace

class MoverFinder::Impl {
 public:
  MoversReport Process(const MoversFrame& frame);
  void Restart();

 private:
  bool Continues(const MoversFrame& frame) const;
  void Follow(const MoversFrame& frame, std::span<const Box2> without_px);
  std::vector<Box2> BusyBoxes() const;
  MoversReport Report(const MoversFrame& frame) const;

  PointField field_;
  MoverList list_{ExistenceModel{}};
  PointJudge judge_;
  MoversState state_ = MoversState::kStarting;

  std::shared_ptr<const image::LumaPyramid> last_pyramid_;
  std::chrono::nanoseconds last_time_{0};
  geometry::Rigid3 last_world_from_camera_;
  geometry::CameraModel camera_;
  std::uint64_t pose_epoch_ = 0;
};

MoverFinder::MoverFinder() : impl_(std::make_unique<Impl>()) {}
MoverFinder::~MoverFinder() = default;

MoversReport MoverFinder::Process(const MoversFrame& frame) {
  return impl_->Process(frame);
}

MoversReport MoverFinder::Skip(MoversState reason) {
  // A frame or two without a pose are a gap, as frames that are missing.
  if (reason != MoversState::kNoPose) impl_->Restart();
  return {reason, {}};
}

void MoverFinder::Impl::Restart() {
  field_.Clear();
  list_.Clear();
  judge_ = PointJudge();
  state_ = MoversState::kStarting;
  last_pyramid_ = nullptr;
}

bool MoverFinder::Impl::Continues(const MoversFrame& frame) const {
  if (last_pyramid_ == nullptr) return false;
  const double step_s =
      std::chrono::duration<double>(frame.time - last_time_).count();
  return step_s > 0.0 && step_s <= kMaxGap_s &&
         frame.pose_epoch == pose_epoch_ && *frame.camera == camera_ &&
         last_pyramid_->size_px == frame.pyramid->size_px;
}

MoversReport MoverFinder::Impl::Process(const MoversFrame& frame) {
  if (!Continues(frame)) Restart();
  std::vector<Box2> without_px;
  for (const Box2& box_px : frame.targets_px) {
    without_px.push_back(Enlarged(box_px, kTargetMargin, 0.0));
  }
  const auto step = last_pyramid_ != nullptr ? frame.time - last_time_
                                             : std::chrono::nanoseconds(0);
  if (last_pyramid_ != nullptr) Follow(frame, without_px);
  list_.Forget(frame.targets_px);
  const double now_s = std::chrono::duration<double>(frame.time).count();
  const double step_s = std::chrono::duration<double>(step).count();
  if (judge_.IsDue(now_s, step_s)) {
    const double key_step_s =
        judge_.empty() ? 0.0 : now_s - judge_.newest().time_s;
    if (last_pyramid_ != nullptr) {
      field_.ForgetUnreturned(*frame.pyramid, *last_pyramid_);
    }
    judge_.TakeKeyView(frame, field_.points());
    state_ = judge_.Judge(frame, field_.sigma_px(), field_.points());
    if (state_ == MoversState::kWatching) {
      const cv::Size size = frame.pyramid->size_px;
      const geometry::PlaneAxes axes(frame.ground->reference_world());
      const KeyView& oldest = judge_.oldest();
      const KeyView& newest = judge_.newest();
      const Vector2d eye_velocity_m_s =
          (axes.FromWorld(newest.world_from_camera.translation) -
           axes.FromWorld(oldest.world_from_camera.translation)) /
          std::max(1e-3, newest.time_s - oldest.time_s);
      list_.Update(
          FindThings(
              frame, field_.points(), eye_velocity_m_s, field_.sigma_px()),
          key_step_s,
          1.0 * size.width * size.height);
      const geometry::Rigid3 camera_from_world =
          frame.world_from_camera.Inverse();
      list_.NotePlaces([&](const Vector2d& place_m) {
        return frame.camera->ImageFromCamera(camera_from_world *
                                             OnGround(frame, axes, place_m));
      });
    } else {
      list_.Clear();
    }
    field_.Thin();
    field_.SeedBusy(*frame.pyramid, BusyBoxes(), without_px);
  }
  // All of the first frame.
  field_.Seed(*frame.pyramid,
              last_pyramid_ != nullptr ? step : std::chrono::seconds(1),
              without_px);
  last_pyramid_ = frame.pyramid;
  last_time_ = frame.time;
  last_world_from_camera_ = frame.world_from_camera;
  camera_ = *frame.camera;
  pose_epoch_ = frame.pose_epoch;
  return Report(frame);
}

void MoverFinder::Impl::Follow(const MoversFrame& frame,
                               std::span<const Box2> without_px) {
  const geometry::Rigid3 now_from_last =
      frame.world_from_camera.Inverse() * last_world_from_camera_;
  const Eigen::Matrix3d rotation = now_from_last.rotation.matrix();
  const geometry::PlaneAxes axes(frame.ground->reference_world());
  const geometry::Rigid3 camera_from_world = frame.world_from_camera.Inverse();
  const double now_s = std::chrono::duration<double>(frame.time).count();
  const double key_s = judge_.newest().time_s;
  const double last_s = std::chrono::duration<double>(last_time_).count();
  const geometry::Plane& reference = frame.ground->reference_world();
  const Vector3d up_last =
      last_world_from_camera_.rotation.conjugate() * reference.normal;
  const double last_height_m = std::max(
      1e-9, reference.SignedDistance(last_world_from_camera_.translation));
  // How far something that goes over the ground goes in the image: where it is
  // there, in itself, is off by the point's height.
  const geometry::Rigid3 last_from_world = last_world_from_camera_.Inverse();
  const auto moved_px = [&](const Vector2d& key_place_m,
                            const Vector2d& velocity_m_s) {
    const auto pixel_at = [&](double time_s,
                              const geometry::Rigid3& from_world) {
      return camera_.ImageFromCamera(
          from_world *
          axes.ToWorld(key_place_m + (time_s - key_s) * velocity_m_s));
    };
    const auto before = pixel_at(last_s, last_from_world);
    const auto after = pixel_at(now_s, camera_from_world);
    return before && after ? std::optional<Vector2d>(*after - *before)
                           : std::nullopt;
  };
  struct Going {
    Box2 box_px;
    Vector2d moved_px;
  };
  std::vector<Going> going;
  for (const ListedMover& mover : list_.movers()) {
    const auto moved = moved_px(mover.state.head<2>(), mover.state.tail<2>());
    if (!moved) continue;
    going.push_back({Enlarged(mover.box_px, kBusyMargin, 0.0), *moved});
  }
  const auto expected_px = [&](const FieldPoint& point) {
    PointField::Starts starts;
    if (point.kind == Kind::kMoving) {
      const auto moved = moved_px(point.place_m, point.velocity_m_s);
      starts.Add(moved ? Vector2d(point.pixel_px + *moved) : point.pixel_px);
      return starts;
    }
    // What rests on the ground or, once that is known, over it.
    const auto xy = camera_.NormalizedFromImage(point.pixel_px);
    std::optional<Vector2d> resting_px;
    if (xy) {
      const double inverse_depth =
          point.inverse_depth > 0.0
              ? point.inverse_depth
              : std::max(0.0, -up_last.dot(xy->homogeneous()) / last_height_m);
      resting_px =
          camera_.ImageFromCamera(rotation * xy->homogeneous() +
                                  inverse_depth * now_from_last.translation);
    }
    if (resting_px) starts.Add(*resting_px);
    if (point.kind == Kind::kAtRest) return starts;
    // What goes with a thing that is known to move, or is kept where it is in
    // the image by a camera that follows it.
    for (const Going& thing : going) {
      if (!thing.box_px.Contains(point.pixel_px)) continue;
      starts.Add(point.pixel_px + thing.moved_px);
      break;
    }
    starts.Add(point.pixel_px);
    return starts;
  };
  field_.Follow(*last_pyramid_,
                *frame.pyramid,
                frame.time - last_time_,
                expected_px,
                without_px);
}

std::vector<Box2> MoverFinder::Impl::BusyBoxes() const {
  std::vector<Box2> boxes_px;
  std::vector<std::uint64_t> listed;
  for (const ListedMover& mover : list_.movers()) {
    boxes_px.push_back(Enlarged(mover.box_px, kBusyMargin, kBusyMargin_px));
    listed.insert(listed.end(), mover.point_ids.begin(), mover.point_ids.end());
  }
  std::sort(listed.begin(), listed.end());
  std::size_t lone = 0;
  for (const FieldPoint& point : field_.points()) {
    if (lone >= kMaxLonePoints) break;
    if (point.kind != Kind::kMoving ||
        std::binary_search(listed.begin(), listed.end(), point.id)) {
      continue;
    }
    ++lone;
    boxes_px.push_back(Box2::FromCenter(
        point.pixel_px, Vector2d::Constant(2.5 * kBusyMargin_px)));
  }
  return boxes_px;
}

MoversReport MoverFinder::Impl::Report(const MoversFrame& frame) const {
  MoversReport report{state_, {}};
  if (state_ != MoversState::kWatching) return report;
  const geometry::PlaneAxes axes(frame.ground->reference_world());
  const geometry::Rigid3 camera_from_world = frame.world_from_camera.Inverse();
  const double since_key_s = std::chrono::duration<double>(frame.time).count() -
                             judge_.newest().time_s;
  std::map<std::uint64_t, const FieldPoint*> by_id;
  for (const FieldPoint& point : field_.points()) {
    by_id.emplace(point.id, &point);
  }
  for (const ListedMover& listed : list_.movers()) {
    if (!listed.reported() || report.movers.size() >= kMaxMovers) continue;
    Mover mover;
    mover.id = listed.id;
    mover.confidence = listed.existence;
    const Vector2d velocity = listed.state.tail<2>();
    const Vector2d place = listed.state.head<2>() + since_key_s * velocity;
    mover.ground_world = OnGround(frame, axes, place);
    mover.velocity_world_m_s = axes.DirectionToWorld(velocity);
    mover.ground_covariance_m2 =
        listed.covariance.topLeftCorner<2, 2>() +
        since_key_s * since_key_s * listed.covariance.bottomRightCorner<2, 2>();
    mover.velocity_covariance_m2_s2 =
        listed.covariance.bottomRightCorner<2, 2>();
    // The box goes with its points since the key view, or with the place.
    std::vector<double> dx, dy;
    for (const std::uint64_t id : listed.point_ids) {
      const auto it = by_id.find(id);
      if (it == by_id.end()) continue;
      const Vector2d moved = it->second->pixel_px - it->second->key_pixel_px;
      dx.push_back(moved.x());
      dy.push_back(moved.y());
    }
    Vector2d shift_px = Vector2d::Zero();
    if (dx.size() >= 2 && listed.unseen_s == 0.0) {
      shift_px = {base::Median(std::move(dx)), base::Median(std::move(dy))};
    } else if (listed.place_px) {
      const auto now_px =
          frame.camera->ImageFromCamera(camera_from_world * mover.ground_world);
      if (!now_px) continue;
      shift_px = *now_px - *listed.place_px;
    }
    mover.box_px = {listed.box_px.min_px + shift_px,
                    listed.box_px.max_px + shift_px};
    report.movers.push_back(mover);
  }
  return report;
}

}  // namespace groundlock::movers
