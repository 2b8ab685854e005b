// SPDX-License-Identifier: Apache-2.0
// By how much a target is turned in the image.
#ifndef GROUNDLOCK_SERVER_TRACKING_VIEW_TURN_H_
#define GROUNDLOCK_SERVER_TRACKING_VIEW_TURN_H_

#include <Eigen/Core>
#include <optional>

namespace groundlock::tracking {

// How far what is seen of a target is turned in the image, compared with what
// was learnt of it: because the camera rolls, because the ground is a slope, or
// because it is seen from above and turns, or the camera does. Angles in
// radians, clockwise in the image. Not thread-safe.
//
// From the side its upright tells the angle: seen from all around, a car stands
// on its wheels. From above it has none, and the angle goes on from what it was
// when the target was last learnt, by the rotation that takes what was to be
// seen of it then, its side and its top, nearest to where that is now (least
// squares; P. H. Schoenemann, "A generalized solution of the orthogonal
// Procrustes problem", Psychometrika 1966). No field of directions on the
// sphere of views is both without a seam (the hairy ball theorem): here it lies
// where a target that was above comes back to the side, and what is learnt
// returns to the upright by and by.
class ViewTurn {
 public:
  // A view of a target, in axes that turn as it does: two on the ground, and
  // its upright.
  struct View {
    // How far a metre along each goes in the image, whose y points down.
    Eigen::Matrix<double, 2, 3> px_per_m =
        Eigen::Matrix<double, 2, 3>::Identity();
    Eigen::Vector3d to_eye = Eigen::Vector3d::UnitX();  // unit
    // How its upright leans, beyond what perspective does to all that is seen
    // away from the image's middle. Means nothing from above.
    double lean_rad = 0.0;
    double width_m = 1.0;
    double height_m = 1.0;
  };
  void Follow(const View& view);
  // It was learnt from that view. Without one, since it was last called, it
  // learnt nothing of how it is turned.
  //   step_s  since it last was; 0: it was out of sight.
  void Learn(double step_s);
  // In [-pi, pi]; 0 as long as it is small.
  double angle_rad() const { return is_turned_ ? turn_rad_ : 0.0; }

 private:
  friend struct StateFields;

  std::optional<View> now_;
  struct Learnt {
    // Of the view, as the image was turned back.
    Eigen::Matrix<double, 2, 3> px_per_m;
    // What there was to be seen of it along its axes, squared.
    Eigen::Matrix3d extent_m2;
    bool is_upright = false;
  };
  std::optional<Learnt> learnt_;
  // How the target leant where it was first learnt from the side.
  std::optional<double> usual_lean_rad_;
  bool is_turned_ = false;
  double turn_rad_ = 0.0;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_VIEW_TURN_H_
