// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/target_background.h"

#include <utility>

namespace groundlock::tracking {

std::optional<TargetBackground::View> TargetBackground::ViewOf(
    const CameraView* camera) {
  if (camera == nullptr || !camera->verified) return std::nullopt;
  return View{*camera->view.camera,
              camera->view.world_from_camera,
              camera->reset_count};
}

void TargetBackground::Start(const image::Frame& frame,
                             const CameraView* camera) {
  image_.Keep(frame);
  last_view_ = ViewOf(camera);
}

void TargetBackground::Follow(const image::Frame& frame,
                              const CameraView* camera,
                              const geometry::Plane* ground_world,
                              const geometry::Box2& target_px) {
  const auto before = std::exchange(last_view_, ViewOf(camera));
  const bool continues = before && last_view_ &&
                         before->camera == last_view_->camera &&
                         before->reset_count == last_view_->reset_count;
  motion_ = ground_world != nullptr && continues
                ? MotionOfPlane(last_view_->camera,
                                before->world_from_camera,
                                last_view_->world_from_camera,
                                *ground_world,
                                target_px)
                : std::nullopt;
  is_known_ = motion_.has_value();
  if (is_known_) {
    image_.Keep(frame);
  } else {
    motion_ = image_.Follow(frame, target_px);
  }
}

void TargetBackground::Skip(const CameraView* camera) {
  last_view_ = ViewOf(camera);
  image_.Forget();
  motion_.reset();
}

}  // namespace groundlock::tracking
