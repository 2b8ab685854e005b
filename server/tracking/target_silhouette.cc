// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/target_silhouette.h"

#include "server/tracking/body_size.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

constexpr std::chrono::milliseconds kSilhouettesApart{100};
// So often in a row a target's silhouette stands beside where it is followed,
// where that shows the ground, before it is believed.
constexpr int kTimesBeside = 2;

}  // namespace

void TargetSilhouette::Begin() {
  seen_.reset();
  beside_.reset();
}

bool TargetSilhouette::IsDue(std::chrono::nanoseconds time) const {
  return time - asked_ >= kSilhouettesApart;
}

void TargetSilhouette::Measure(
    const image::Frame& frame,
    const CameraView& camera,
    const GroundTarget& body,
    const std::function<bool(const Box2&)>& is_shared) {
  if (asked_ == frame.capture_time) return;
  asked_ = frame.capture_time;
  const auto expected_px = body.Project(camera);
  if (!expected_px) return;
  const auto silhouette =
      pictures_.Measure(frame, camera, body.tangent_world(), *expected_px);
  if (!silhouette || is_shared(silhouette->outline.sure_px)) return;
  if (silhouette->stands_beside) {
    beside_ = silhouette->outline;
    ++times_beside_;
  } else {
    seen_ = silhouette->outline;
    times_beside_ = 0;
  }
}

std::optional<ground::SeenOutline> TargetSilhouette::Beside() const {
  return times_beside_ >= kTimesBeside ? beside_ : std::nullopt;
}

Eigen::Vector3d TargetSilhouette::Teach(const CameraView& camera,
                                        const Box2& box_px,
                                        bool by_body,
                                        std::chrono::nanoseconds time,
                                        GroundTarget& body) {
  if (by_body_ != by_body) recent_.Forget();
  by_body_ = by_body;
  const double range_m = (body.box().world_from_object.translation -
                          camera.view.world_from_camera.translation)
                             .norm();
  const ground::SeenOutline outline =
      recent_.Add(*seen_,
                  box_px.center_px(),
                  camera.view.camera->mean_focal_px() / range_m,
                  time);
  const auto before_px = body.Project(camera);
  const Eigen::Vector3d shift_m =
      body.SeeSilhouette(camera,
                         outline,
                         box_px.center_px(),
                         std::chrono::duration<double>(time - taught_).count());
  taught_ = time;
  const auto after_px = body.Project(camera);
  if (by_body && before_px && after_px) {
    recent_.Shift(after_px->center_px() - before_px->center_px());
  }
  return shift_m;
}

void TargetSilhouette::Keep(const image::Frame& frame,
                            const CameraView& camera,
                            const Box2& outline_px,
                            const geometry::Box3& body_world) {
  pictures_.Keep(frame,
                 camera,
                 outline_px,
                 body_world.BottomCenterWorld(),
                 Side(body_world.size_m));
}

}  // namespace groundlock::tracking
