// SPDX-License-Identifier: Apache-2.0
// A target's body on the ground: where it is, how it moves, its heading and its
// size. Robinson 2014, §3.6-3.7, with a size in metres that is estimated over
// the whole track (docs/method.md, "Size").
#ifndef GROUNDLOCK_SERVER_TRACKING_GROUND_TARGET_H_
#define GROUNDLOCK_SERVER_TRACKING_GROUND_TARGET_H_

#include <Eigen/Core>
#include <chrono>
#include <memory>
#include <numbers>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/body_fit.h"
#include "server/ground/body_motion.h"
#include "server/ground/body_outline.h"
#include "server/ground/body_pose.h"
#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"
#include "server/ground/ground_surface.h"
#include "server/motion/motion_predictor.h"
#include "server/tracking/association.h"
#include "server/tracking/body_follower.h"
#include "server/tracking/body_kind.h"
#include "server/tracking/body_size.h"
#include "server/tracking/camera_view.h"
#include "server/tracking/followed_point.h"
#include "server/tracking/ground_errors.h"
#include "server/tracking/outline_scale.h"
#include "server/tracking/patch_memory.h"
#include "server/tracking/tracker_picture.h"
#include "server/tracking/view_turn.h"

namespace groundlock::tracking {

// A 2D detection lifted to the ground.
struct GroundSighting {
  Eigen::Vector2d place_m =
      Eigen::Vector2d::Zero();  // in PlaneAxes of the reference plane
  // Of the part of the error that changes from frame to frame.
  Eigen::Matrix2d covariance_m2 = Eigen::Matrix2d::Identity();
  Eigen::Vector2d center_px = Eigen::Vector2d::Zero();
  Innovation innovation;
  // It tells a direction only, and no place of its own along it.
  bool is_bearing = false;
  // As points of the body tell; nullopt: they do not.
  std::optional<double> heading_rad = std::nullopt;
  double heading_sigma_rad = 0.0;  // of that
  // As its motion in the image tells, for where the motion starts anew.
  std::optional<Eigen::Vector2d> velocity_m_s = std::nullopt;
  Eigen::Matrix2d velocity_covariance_m2_s2 = Eigen::Matrix2d::Identity();
};

// What the centre of a detection's box stands for.
enum class BoxCenter {
  kOutline,  // the centre of the target's outline, as a person draws it
  kTexture,  // a point of its surface, as a tracker that learns follows it
};

// Lengths in metres or map units. Not thread-safe.
class GroundTarget {
 public:
  // Standard deviation of an angle that may be any.
  static constexpr double kAnyHeading_rad =
      std::numbers::pi / std::numbers::sqrt3;

  // From a target's box in a frame whose camera is known. It is of the kind
  // that was told or, where lengths are metres, of which it is by its size, if
  // that is known; its size is that kind's, and it stands as that lets it.
  // Errors as FitBox.
  static absl::StatusOr<GroundTarget> Create(
      const CameraView& camera,
      const geometry::Box2& box_px,
      std::chrono::nanoseconds time,
      BoxCenter center,
      const motion::MotionOptions& options,
      const std::optional<BodyKind>& told = std::nullopt);

  void Predict(std::chrono::nanoseconds time);
  // nullopt if no place on the ground projects there, or near there of the
  // predicted.
  //   sigma_of_box  by how much more than usual the box is off, of its sides.
  std::optional<GroundSighting> Lift(const CameraView& camera,
                                     const geometry::Box2& box_px,
                                     double sigma_of_box = 0.0) const;
  // Of a detection that may be anywhere: a ray that passes over a crest meets
  // the ground before it and behind it, and the target stands where it looks as
  // large as what was found. Otherwise as Lift.
  std::optional<GroundSighting> LiftAsLarge(const CameraView& camera,
                                            const geometry::Box2& box_px) const;
  // The box in which it is then to be looked for, about the same centre: the
  // same one if the target may look about so large there.
  geometry::Box2 BoxAsLarge(const CameraView& camera,
                            const geometry::Box2& box_px) const;
  // Takes a sighting at the time last predicted.
  void Update(const CameraView& camera, const GroundSighting& sighting);
  // How large the 2D tracker takes the target to look, by what it has measured
  // of its growth; nullopt if the body does not project.
  std::optional<Eigen::Vector2d> SeenSize_px(const CameraView& camera) const;
  // It looks larger than that by a factor. After an Update.
  void FollowGrowth(const CameraView& camera, double growth);
  // It was seen so large, by a tracker that was free to find any size. After an
  // Update.
  void FollowSize(const CameraView& camera, const Eigen::Vector2d& size_px);
  // A target that has not moved since it was marked: gets the body that points
  // of it tell, if they do (ground::FitBodyToPoints). After an Update.
  void FitBody(const CameraView& camera, const ground::BodyPoints& seen);
  bool has_moved() const { return heading_known_ || has_left_; }
  bool heading_known() const { return heading_known_; }
  // The ground that it stands on, as the surface has it, and the sigmas of its
  // height and of its tilt about each axis as far as these vary from place to
  // place (GroundErrors).
  geometry::Plane ground_as_known() const;
  Eigen::Vector3d ground_sigmas() const;
  // A walking person is none.
  bool is_rigid() const { return IsSquat(size_m_); }
  // Its outline is what the image shows: limbs make it, and no box on the
  // ground tells them. The ground tells where it is, and how it looks unseen.
  bool has_own_outline() const {
    return center_ == BoxCenter::kTexture && !is_rigid() &&
           (!fitted_ || has_moved());
  }
  // One whose heading its motion has told: gets the body that points tell which
  // were followed through views of it, the last one being this frame's. After
  // an Update.
  // nullopt: they tell nothing.
  std::optional<BodyFollower::Found> FitMovingBody(
      const CameraView& camera, const BodyFollower::Tracks& seen);
  // So many points say where a body is: its three unknowns take a point and a
  // half, and the rest of five agrees by chance in one of 3,000 cases, if one
  // of ten points does (IsSeenAtRest).
  static constexpr std::size_t kMinAgreeing = 5;
  // Such a body, where its points are seen. nullopt: fewer than kMinAgreeing,
  // or less than two thirds of them, agree on where it is.
  //   found_px  where the 2D tracker found it, which must bear them out.
  //   box_px  set to what the 2D tracker then follows.
  //   agrees  set to which of them do.
  std::optional<GroundSighting> SightByPoints(
      const CameraView& camera,
      std::span<const ground::BodySighting> seen,
      const std::optional<Eigen::Vector2d>& found_px,
      geometry::Box2& box_px,
      std::vector<bool>& agrees);
  // Such a body where it was fitted; nullopt if there is none, or it has moved.
  std::optional<geometry::Box3> BodyAtRest() const;
  // It is known to rest there: as a sighting of it, which stops its motion.
  //   box_px  set to what the 2D tracker then follows.
  // nullopt if it does not project.
  std::optional<GroundSighting> StayAtRest(const CameraView& camera,
                                           geometry::Box2& box_px);
  // As it is seen from another side, a tracker that learns ends up at the
  // outline's middle there; one that does not learn stays with what it knows,
  // as far as the body's shape is known. After each Update.
  void FollowView(const CameraView& camera, bool learns);
  // Its silhouette was measured: takes the place and the size that it tells.
  // The point that the 2D tracker follows, at `center_px`, is then another one
  // of the body. After an Update and FollowView.
  //   step_s  since the last one.
  // Returns by how much the body goes that way in its own frame: points of it
  // that are known there stay where they are seen.
  Eigen::Vector3d SeeSilhouette(const CameraView& camera,
                                const ground::SeenOutline& silhouette,
                                const Eigen::Vector2d& center_px,
                                double step_s);
  // kUnknown: it turned out not to be where it was followed to.
  enum class Whereabouts { kExpected, kUnknown };
  // The same silhouette as a sighting of a target that is not seen otherwise.
  // nullopt: its edges are not known well enough, or not where they would be;
  // of one whose whereabouts are unknown, it is of another size.
  //   box_px  set to what the 2D tracker then follows.
  std::optional<GroundSighting> SightBySilhouette(
      const CameraView& camera,
      const ground::SeenOutline& silhouette,
      Whereabouts whereabouts,
      geometry::Box2& box_px);
  // Where patches of a body that moves say that it is, which were looked for
  // about a place of it. nullopt: not where it may be.
  //   box_px  set to what the 2D tracker then follows.
  std::optional<GroundSighting> SightByPatches(const CameraView& camera,
                                               const geometry::Box3& about,
                                               const PatchMemory::Match& match,
                                               geometry::Box2& box_px);
  // Patches say that it rests where it was, as StayAtRest, of a body that need
  // not have been fitted.
  std::optional<GroundSighting> StayByPatches(const CameraView& camera,
                                              geometry::Box2& box_px);
  // The point that the 2D tracker follows is still the same, although the
  // target is seen from another side.
  void KeepView(const CameraView& camera) { view_rad_ = ViewAngle_rad(camera); }
  // By how much its frame was turned without that it turned.
  double unturned_rad() const { return unturned_rad_; }
  // From where the target was last sighted.
  double DistanceTo(const GroundSighting& sighting) const;
  // The velocity on the ground of what moves in the image with `velocity_px_s`
  // over the background where the sighting is, known to `sigma_px_s`.
  void TellVelocity(const CameraView& camera,
                    const Eigen::Vector2d& velocity_px_s,
                    double sigma_px_s,
                    GroundSighting& sighting) const;
  // Does what moves in the image with `velocity_px_s` over the background,
  // where it is predicted, go along the ground by more than so many of its
  // sides a second? What drives away hardly moves in the image. `error_px_s`:
  // the velocity may be off by so much.
  bool GoesOverGround(const CameraView& camera,
                      const Eigen::Vector2d& velocity_px_s,
                      double error_px_s,
                      double sides_s) const;
  // Forgets the motion and starts at the sighting; keeps size and heading.
  void Restart(const GroundSighting& sighting);

  // The plane that touches the ground where it is.
  geometry::Plane tangent_world() const {
    return TangentAt(motion_->state().position_m);
  }
  geometry::Box3 box() const;
  // The same at another place, in PlaneAxes of the reference plane.
  geometry::Box3 BodyAt(const Eigen::Vector2d& place_m) const;
  // The box at a time near the present.
  geometry::Box3 BoxAt(std::chrono::nanoseconds time) const;
  // Of a body of this target's shape; nullopt if it does not project.
  std::optional<geometry::Box2> BodyHull(const CameraView& camera,
                                         const geometry::Box3& box) const {
    return ground::ProjectBodyHull(camera.view, box, shape_);
  }
  // Which part of the image it takes, which has that hull about it.
  std::optional<geometry::ConvexPolygon> BodyInImage(
      const CameraView& camera, const geometry::Box3& box) const {
    return ground::ProjectBody(camera.view, box, shape_);
  }
  // From where it was at a time near the present, going into the curve that its
  // acceleration tells.
  ExpectedMotion MotionSince(std::chrono::nanoseconds time) const;
  // The outline, as large as the target was seen to look there; the same if the
  // point that detections follow is at `center_px`; and the same box about that
  // point.
  std::optional<geometry::Box2> Project(const CameraView& camera) const;
  std::optional<geometry::Box2> ProjectAbout(
      const CameraView& camera, const Eigen::Vector2d& center_px) const;
  std::optional<geometry::Box2> ProjectForTracker(
      const CameraView& camera) const;
  // How large it looks where the point that detections follow is at
  // `center_px`; nullopt if no place on the ground projects there.
  std::optional<geometry::Box2> BoxForTrackerAt(
      const CameraView& camera, const Eigen::Vector2d& center_px) const;
  // Where the point that detections follow would be, if the body stood where it
  // was last sighted; nullopt if it does not project.
  std::optional<Eigen::Vector2d> LastSightedCenter(
      const CameraView& camera) const;
  // Covariance in the image of the box's centre as predicted on the ground;
  // nullopt if it does not project.
  //   any_motion_s  for so long it may have done anything, whatever its models
  //     of motion say.
  std::optional<Eigen::Matrix2d> ImageCovariance(
      const CameraView& camera, double any_motion_s = 0.0) const;
  // From which side the camera sees it: the direction on the ground that is
  // "up" in the image (away from the camera, or where its upper edge is if it
  // looks straight down), as seen from the body. In [-pi, pi]; what is 0
  // differs from target to target. Changes as the body turns, but not where
  // only what is known of its heading does.
  double ViewAngle_rad(const CameraView& camera) const;
  // The body as it is seen, in axes that turn as it was seen to turn, and not
  // by what was learnt of its heading; nullopt if it does not project.
  std::optional<ViewTurn::View> ViewOf(const CameraView& camera) const;
  // How its box would look if it were turned back by `angle_rad` in the image;
  // nullopt if it does not project.
  std::optional<PatchTurn> TurnOf(const CameraView& camera,
                                  double angle_rad) const;
  Eigen::Matrix2d ground_covariance_m2() const;
  Eigen::Vector3d velocity_world_m_s() const;
  // Standard deviation of the heading, that of its opposite if front_known() is
  // false; kAnyHeading_rad while nothing tells it.
  double HeadingSigma_rad() const;
  // Has its way told which end is the front?
  bool front_known() const { return heading_known_; }
  // Null: of none that is known.
  const BodyKind* kind() const { return kind_ ? &*kind_ : nullptr; }
  // Of length, width and height.
  Eigen::Matrix3d SizeCovariance_m2() const;
  // Standard deviation of its distance from the camera, along the ground.
  double RangeSigma_m(const CameraView& camera) const;

 private:
  friend struct StateFields;

  // How well the way tells which way a body heads: of its velocity's direction,
  // and what its body, which follows it, lags behind in a curve.
  static constexpr double kWayHeadingSigma_rad =
      10.0 * std::numbers::pi / 180.0;
  // How deep under the surface the point lies that a tracker follows: it sees
  // the whole patch, whose mean depth is behind its nearest point.
  static constexpr double kTextureDepth = 0.8;
  // Newton's method converges quadratically where it does.
  static constexpr int kMaxPlaceRounds = 8;
  // A box that is fitted again to what was drawn stands where it stood before,
  // but for so many of its sides.
  static constexpr double kStartsWithin = 1.5;
  // Error of a place that stays from frame to frame, of the size of a body that
  // points of it tell (docs/method.md, "A body at rest").
  static constexpr double kFittedSigma = 0.03;

  GroundTarget(std::shared_ptr<const ground::GroundSurface> surface,
               const geometry::Plane& tangent_world,
               const CameraView& camera,
               const geometry::Box2& box_px);

  // Places are in axes_. The plane that touches the ground there, the point on
  // it, and the body if it stood there.
  geometry::Plane TangentAt(const Eigen::Vector2d& place_m) const;
  Eigen::Vector3d OnGround(const Eigen::Vector2d& place_m) const;
  // The body's axes as it would head by its turns alone.
  Eigen::Matrix3d TurningAxes() const;
  // Towards the camera, in these.
  Eigen::Vector3d ToEye(const CameraView& camera) const;
  // How an upright leans in the image, clockwise: as the camera rolls, and as
  // the ground is a slope across the view.
  double LeanInImage_rad(const CameraView& camera,
                         const Eigen::Vector3d& upright_world) const;
  // From the axes of a plane that touches the ground to axes_.
  Eigen::Matrix2d FromTangent(const geometry::Plane& tangent_world) const;
  // Remembers the ground where the target is.
  void Settle();

  Eigen::Vector3d HeadingWorld() const;
  ground::BodyForm Form() const;
  // Where it is predicted, and as well as that, its heading and size are known.
  ground::StandingBody Standing(const CameraView& camera) const;
  // How it was drawn, as a body that heads that way; nullopt: it is none.
  std::optional<ground::BoxFit> FitStartAlong(
      const ground::GroundView& start, const Eigen::Vector2d& direction) const;
  // What is taken for granted of its size along its way.
  ground::SizePrior SizeAlongWay() const;
  static ground::GroundView Over(const CameraView& camera,
                                 const geometry::Plane& tangent_world);
  static bool IsOn(const geometry::Plane& tangent_world,
                   const geometry::Box3& box);
  // Newton's method on the surface, from a place near which it is sought.
  std::optional<ground::PlacedBox> Place(const CameraView& camera,
                                         const Eigen::Vector2d& center_px,
                                         Eigen::Vector2d place_m) const;
  // In axes_, that of the camera's pose for a point on the ground.
  Eigen::Matrix2d PoseCovariance(const CameraView& camera,
                                 const Eigen::Vector3d& p_world) const;
  // A sighting of the body there: with the pose's covariance as well, and how
  // far that is from where it is predicted.
  GroundSighting SightAt(const CameraView& camera,
                         const Eigen::Vector3d& p_world,
                         const Eigen::Matrix2d& covariance_m2) const;
  // A view in which the body is looked for there: known as well as its place,
  // and its shape to a share of its side.
  ground::BodyView ExpectAt(const CameraView& camera,
                            const geometry::Box3& body,
                            double shape_sigma) const;
  // And a sighting of it where it was located then.
  GroundSighting SightLocated(const CameraView& camera,
                              const ground::BodyPose& pose,
                              double shape_sigma) const;
  // It stands there, and its motion begins anew; nullopt: it may be any.
  GroundSighting StandStill(const Eigen::Vector2d& place_m,
                            std::optional<double> speed_sigma_m_s);
  // The same pixel means another place for another body than the one that stood
  // at `before`: the target goes there without an innovation.
  void GoWith(const CameraView& camera,
              const std::optional<ground::PlacedBox>& before);
  std::optional<ground::PlacedBox> PlaceNearby(
      const CameraView& camera, const Eigen::Vector2d& center_px) const;
  // Of the places on the ray one at which the target looks as large as the box.
  std::optional<ground::PlacedBox> PlaceAsLarge(
      const CameraView& camera, const geometry::Box2& box_px) const;
  // A detection's sighting there.
  GroundSighting SightPlaced(const CameraView& camera,
                             const ground::PlacedBox& placed,
                             const geometry::Box2& box_px,
                             const Eigen::Vector2d& sigma_px) const;
  // Wherever that was predicted: from the ground that is seen there.
  std::optional<ground::PlacedBox> PlaceOnRay(
      const CameraView& camera, const Eigen::Vector2d& center_px) const;
  // The body's outline where it stands. Of a tall one, whose shape an upright
  // box tells badly (limbs, masts, a lean at the image's edge), only the area
  // goes by the ground; its shape is the drawn one.
  std::optional<geometry::Box2> OutlineOf(const CameraView& camera,
                                          const geometry::Box3& box) const;
  // If the target were at a place: how far from there in the image its followed
  // point is seen, and by how many pixels that goes with each metre of the
  // place. nullopt if it does not project.
  struct SeenFrom {
    Eigen::Vector2d place_m;
    Eigen::Vector2d off_px;
    Eigen::Matrix2d to_px;
  };
  std::optional<SeenFrom> SeeFrom(const CameraView& camera,
                                  const Eigen::Vector2d& center_px,
                                  const Eigen::Vector2d& place_m) const;
  // What a detection tells where no place on the ground projects there, because
  // the ground is seen edge-on or its height is not known so well: across the
  // view where the target is, and how far away only as the way there moves it
  // in the image. Linearised where the target is likeliest by that and by the
  // prediction (the iterated extended Kalman filter: Bell & Cathey, IEEE TAC
  // 38(2), 1993), as a place and its covariance. nullopt: there it cannot be by
  // what was predicted, or no place about there is where it is seen.
  std::optional<GroundSighting> SightBearing(
      const CameraView& camera,
      const Eigen::Vector2d& center_px,
      const Eigen::Vector2d& sigma_px) const;
  // Of where it is seen to be, by what moves that from frame to frame.
  Eigen::Matrix2d ApparentCovariance_m2() const;
  // What of that its unknown shape does.
  Eigen::Matrix2d ShapeCovariance_m2() const;
  // How far along the ground, in axes_, the place goes for each metre that what
  // is followed is higher over the ground than it is taken to be: far where the
  // ground is seen at a grazing angle, and no farther than a bearing leaves it
  // open. nullopt where it does not project, or the ground is seen just
  // edge-on.
  std::optional<Eigen::Vector2d> WayPerHeight(
      const CameraView& camera, const Eigen::Vector2d& place_m) const;
  // 1 sigma of that height, as the body's size is known.
  double FollowedHeightSigma_m() const;
  Eigen::Vector3d GroundSigmasAt(const Eigen::Vector2d& place_m) const;
  // What the ground is off by where the body stands so.
  void FindGroundErrors(const geometry::Rigid3& world_from_body);
  // What the ground is off by is something else where it is by now.
  void GoOnFrom(const Eigen::Vector2d& before_m);
  // Pixels by which the followed point moves for each metre that the body goes
  // along each axis of axes_; and for each that a body's ground is higher.
  std::optional<Eigen::Matrix2d> WayInImage(
      const CameraView& camera, const Eigen::Vector2d& place_m) const;
  std::optional<Eigen::Vector2d> RiseInImage(const CameraView& camera,
                                             geometry::Box3 box) const;
  std::optional<Eigen::Vector2d> FollowedPointAt(
      const CameraView& camera, const geometry::Box3& box) const;
  // Which way its way tells that it heads, and how well; nullopt: not yet.
  struct Direction {
    Eigen::Vector2d along;      // unit, in axes_
    Eigen::Vector2d along_way;  // in the mean since it was marked
    double sigma_rad = 0.0;
  };
  std::optional<Direction> DirectionOfWay();
  void LearnHeadingFromStart(const CameraView& camera,
                             const Eigen::Vector2d& center_px);
  // It turns as its way does, seen or not.
  void TurnAlongWay(double step_s);
  void FollowHeading(double step_s);
  // What tells anew where the target was when it was marked: may it be there?
  bool StartsAt(const Eigen::Vector2d& place_m) const;
  // A body that was fitted where it rests and is sighted elsewhere has left.
  void NoteLeaving(const GroundSighting& sighting);
  // What was taken for its rear is its front; the body stays as it is.
  void TurnRound();
  // Is it likelier to stand than to go?
  bool Stands() const;
  // The heading was measured, at the present time.
  void NoteHeading(double sigma_rad);
  // Turns the heading; a body whose rear is followed turns about its rear.
  void Turn(double angle_rad);

  std::shared_ptr<const ground::GroundSurface> surface_;
  GroundErrors ground_errors_;
  // Touches the ground where the target was last on ground that is known, which
  // stands in where nothing is.
  geometry::Plane last_tangent_world_;
  geometry::PlaneAxes axes_;  // of the surface's reference plane
  std::unique_ptr<motion::MotionPredictor> motion_;
  // WayPerHeight where it was last sighted, and where its place was told by
  // what stands on the ground: its feet in the first box, or points of it at
  // rest.
  Eigen::Vector2d way_per_height_ = Eigen::Vector2d::Zero();
  Eigen::Vector2d start_way_per_height_ = Eigen::Vector2d::Zero();
  // From where its way is measured that tells which way it heads, and
  // WayPerHeight there.
  Eigen::Vector2d way_from_m_ = Eigen::Vector2d::Zero();
  Eigen::Vector2d way_from_per_height_ = Eigen::Vector2d::Zero();
  Eigen::Vector3d size_m_ = Eigen::Vector3d::Zero();
  ground::BodyShape shape_;
  std::optional<BodyKind> kind_;
  ground::SizePrior kind_size_;  // in the map's unit; of no meaning without one
  // Of the logarithms of the extents, as a box or points of the body told them.
  Eigen::Matrix3d log_size_covariance_ = Eigen::Matrix3d::Zero();
  int times_measured_ = 0;  // while it moved
  OutlineScale outline_scale_;
  double seen_log_ratio_ = 0.0;  // of SeenSize_px to the body's outline
  BoxCenter center_ = BoxCenter::kTexture;
  Eigen::Vector3d texture_object_ = Eigen::Vector3d::Zero();
  FollowedPoint followed_point_;
  double view_rad_ = 0.0;     // from where texture_object_ is what is followed
  double heading_rad_ = 0.0;  // in PlaneAxes of the reference plane
  // Until it has moved, a target's heading is that of its longer side.
  bool heading_known_ = false;
  // Where it rested when points told its body, or where it was marked.
  bool has_left_ = false;
  bool fitted_ = false;  // size and heading are those that points of it tell
  // How much of the heading is no turn of the body: what was not known at
  // first, and going backwards.
  double unturned_rad_ = 0.0;
  double heading_sigma_rad_ = kAnyHeading_rad;  // when last measured
  double axis_sigma_rad_ = 0.0;                 // of the fit to points
  bool turned_unseen_ = false;  // it may have, since it was last on its way
  std::chrono::nanoseconds time_{0};

  // How it looked when it was marked: fitted anew once its heading is known.
  geometry::CameraModel start_camera_;
  geometry::Rigid3 start_world_from_camera_;
  geometry::Box2 start_box_px_;
  Eigen::Vector2d start_place_m_ = Eigen::Vector2d::Zero();

  std::optional<GroundSighting> last_sighting_;
  std::chrono::nanoseconds last_sighting_time_{0};
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_GROUND_TARGET_H_
