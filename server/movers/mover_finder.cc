// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <deque>
#include <map>
#include <optional>
#include <utility>

#include "server/ground/box_fit.h"
#include "server/movers/mover_list.h"
#include "server/movers/movers.h"
#include "server/movers/moving_groups.h"
#include "server/movers/point_field.h"
#include "server/movers/point_motion.h"

namespace groundlock::movers {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Box2;
using geometry::Matrix6d;
using Kind = FieldPoint::Kind;

// Poses and sightings are kept so often, kKeyViews of them: a window of some
// 0.9 s. What a slower video has between is every frame.
constexpr double kKeyStep_s = 0.1;
constexpr double kMaxGap_s = 1.0;
// Sightings before a point is judged.
constexpr std::size_t kMinSightings = 4;
// A point that rests is taken to move once in 30,000 times (4 sigma); that of a
// thing which moves is taken for neither once in 700 (3 sigma).
constexpr double kRestLimit_sigma = 4.0;
constexpr double kMotionLimit_sigma = 3.0;
// Things jolt, and people swing their limbs: their points are off smooth motion
// by so much more than noise.
constexpr double kUnsteadiness = 3.0;
// A car that turns on the spot changes its velocity by its whole within a
// second (1 sigma).
constexpr double kChangePerSecond = 1.0;
// A speed is one if it is above zero by so many sigmas.
constexpr double kMinSpeed_sigma = 5.0;
// Points at the edges of things that stand before others slide by a few pixels:
// what moves goes farther in the image than that while it is judged.
constexpr double kMinShift_px = 5.0;  // at 1280 pixels
// Beyond what is stated of it, the ground is rough by this share of the
// camera's height over it, and falls or rises by this share of the way to it:
// seen from a drone, a far fence in a hollow went with the camera before
// (flight car10).
constexpr double kRoughness = 0.01;
constexpr double kSlope = 0.02;
// The pose is doubted if more than this share of the points contradicts it, and
// nothing is said before so many rest.
constexpr double kMaxContradicting = 0.5;
constexpr std::size_t kMinResting = 12;
// Groups reach as far as points are apart, beyond the patches' own size.
constexpr double kLinkShare = 1.0 / 32.0;  // of the image's width
constexpr double kBoxMargin_px = 4.0;      // at 1280 pixels
// Points on the outline of something that stands before a background slide
// along it together: they lie on a line, as wide as this share of its length
// (bins and crates of rendered yards were reported so).
constexpr double kMinWidth = 0.2;
// Where a group's box ends is known to this share of its size.
constexpr double kBoxSigma = 0.08;
// Points are looked for around what moves.
constexpr double kBusyMargin = 0.3;
constexpr double kBusyMargin_px = 16.0;
constexpr std::size_t kMaxLonePoints = 16;
// A target's shadow and outline belong to it.
constexpr double kTargetMargin = 0.1;
// Boxes of things; 3D shape priors as for targets of unknown kind.
const ground::ShapePrior kShape;

Box2 Enlarged(const Box2& box_px, double share, double margin_px) {
  return Box2::FromCenter(box_px.center_px(),
                          (1.0 + 2.0 * share) * box_px.size_px() +
                              Vector2d::Constant(2.0 * margin_px));
}

// The part of a symmetric matrix without negative eigenvalues.
Matrix6d PositivePart(const Matrix6d& matrix) {
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(matrix);
  return solver.eigenvectors() *
         solver.eigenvalues().cwiseMax(0.0).asDiagonal() *
         solver.eigenvectors().transpose();
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

// How wide points lie over how long, in standard deviations.
double WidthOverLength(const MovingGroup& group,
                       std::span<const MovingPoint> points) {
  Vector2d mean = Vector2d::Zero();
  for (const std::size_t i : group.members) mean += points[i].pixel_px;
  mean /= static_cast<double>(group.members.size());
  Matrix2d scatter = Matrix2d::Zero();
  for (const std::size_t i : group.members) {
    const Vector2d off = points[i].pixel_px - mean;
    scatter += off * off.transpose();
  }
  const Vector2d squares =
      Eigen::SelfAdjointEigenSolver<Matrix2d>(scatter).eigenvalues();
  return std::sqrt(std::max(0.0, squares[0]) / std::max(1e-9, squares[1]));
}

double Median(std::vector<double>& values) {
  const auto middle =
      values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

class MoverFinder::Impl {
 public:
  MoversReport Process(const MoversFrame& frame);
  void Restart();

 private:
  bool Continues(const MoversFrame& frame) const;
  void Follow(const MoversFrame& frame, std::span<const Box2> without_px);
  void TakeKeyView(const MoversFrame& frame);
  // The poses' covariances as they count now.
  std::vector<KeyView> ViewsNow() const;
  void Judge(const MoversFrame& frame);
  // Makes it one that moves, if it goes over the ground.
  void TakeMotion(const MoversFrame& frame,
                  std::span<const Sighting> sightings,
                  std::span<const KeyView> views,
                  const PointNoise& noise,
                  FieldPoint& point) const;
  std::vector<Finding> FindGroups(const MoversFrame& frame);
  std::optional<Finding> Locate(const MoversFrame& frame,
                                const MovingGroup& group,
                                const std::vector<std::size_t>& indices);
  std::optional<LocalGround> GroundUnder(const MoversFrame& frame,
                                         const Vector2d& xy) const;
  std::vector<Box2> BusyBoxes() const;
  MoversReport Report(const MoversFrame& frame) const;

  struct Key {
    KeyView view;
    bool by_odometry = false;
  };

  PointField field_;
  MoverList list_{ExistenceModel{}};
  std::deque<Key> keys_;
  std::uint64_t first_key_ = 0;  // number of keys_.front()
  MoversState state_ = MoversState::kStarting;
  // The variances of sightings as they turn out to be, over those expected.
  double excess_ = 1.0;

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
  keys_.clear();
  first_key_ = 0;
  state_ = MoversState::kStarting;
  excess_ = 1.0;
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
  // Half a frame early is nearer to the time that is meant than half one late.
  const double half_step_s = 0.5 * std::chrono::duration<double>(step).count();
  if (keys_.empty() ||
      now_s + half_step_s - keys_.back().view.time_s >= kKeyStep_s) {
    const double key_step_s =
        keys_.empty() ? 0.0 : now_s - keys_.back().view.time_s;
    if (last_pyramid_ != nullptr) {
      field_.ForgetUnreturned(*frame.pyramid, *last_pyramid_);
    }
    TakeKeyView(frame);
    Judge(frame);
    if (state_ == MoversState::kWatching) {
      const cv::Size size = frame.pyramid->size_px;
      list_.Update(
          FindGroups(frame), key_step_s, 1.0 * size.width * size.height);
      const geometry::PlaneAxes axes(frame.ground->reference_world());
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
  const double key_s = keys_.back().view.time_s;
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

void MoverFinder::Impl::TakeKeyView(const MoversFrame& frame) {
  Key key;
  key.view.time_s = std::chrono::duration<double>(frame.time).count();
  key.view.world_from_camera = frame.world_from_camera;
  key.view.covariance = frame.pose_covariance;
  key.by_odometry = frame.by_odometry;
  keys_.push_back(key);
  if (keys_.size() > kKeyViews) {
    keys_.pop_front();
    ++first_key_;
  }
  const std::uint64_t number = first_key_ + keys_.size() - 1;
  std::erase_if(field_.points(), [&](FieldPoint& point) {
    const auto xy = frame.camera->NormalizedFromImage(point.pixel_px);
    if (!xy) return true;
    point.xy_by_key[number % kKeyViews] = *xy;
    point.key_pixel_px = point.pixel_px;
    if (!point.first_key) point.first_key = number;
    return false;
  });
}

std::vector<KeyView> MoverFinder::Impl::ViewsNow() const {
  std::vector<KeyView> views;
  for (const Key& key : keys_) {
    views.push_back(key.view);
    // Errors of poses in the map are taken to be independent. Those of odometry
    // add up on the way: what counts is what has come since.
    if (keys_.back().by_odometry) {
      views.back().covariance =
          PositivePart(keys_.back().view.covariance - key.view.covariance);
    }
  }
  return views;
}

std::optional<LocalGround> MoverFinder::Impl::GroundUnder(
    const MoversFrame& frame, const Vector2d& xy) const {
  const Vector3d& eye_world = frame.world_from_camera.translation;
  const Vector3d direction_world =
      frame.world_from_camera.rotation * xy.homogeneous();
  const geometry::Plane& reference = frame.ground->reference_world();
  const double height_m = frame.ground->HeightOf(eye_world).value_or(
      reference.SignedDistance(eye_world));
  if (!(height_m > 0.0)) return std::nullopt;
  const auto place_world = frame.ground->IntersectRay(
      eye_world, direction_world, ground::kMaxRangeOverHeight * height_m);
  // What is seen over the horizon rests on nothing, and may rest.
  if (!place_world) return LocalGround{reference, height_m};
  const auto patch = frame.ground->At(*place_world);
  if (!patch) return std::nullopt;
  return LocalGround{patch->tangent_world,
                     std::hypot(patch->height_sigma_m,
                                kRoughness * height_m,
                                kSlope * (*place_world - eye_world).norm())};
}

void MoverFinder::Impl::Judge(const MoversFrame& frame) {
  const std::vector<KeyView> views = ViewsNow();
  const std::uint64_t newest = first_key_ + keys_.size() - 1;
  const PointNoise noise{field_.sigma_px() / frame.camera->mean_focal_px()};
  struct Judged {
    std::size_t index;
    std::vector<Sighting> sightings;
    RestFit rest;
  };
  std::vector<Judged> judged;
  std::vector<double> excesses;
  auto& points = field_.points();
  for (std::size_t i = 0; i < points.size(); ++i) {
    FieldPoint& point = points[i];
    const std::uint64_t first = std::max(*point.first_key, first_key_);
    const Vector2d& xy = point.xy_by_key[newest % kKeyViews];
    if (!point.ground || point.kind == Kind::kMoving ||
        newest - point.ground_key >= kKeyViews) {
      point.ground = GroundUnder(frame, xy);
      point.ground_key = newest;
    }
    if (!point.ground) continue;
    Judged one{i, {}, {}};
    for (std::uint64_t key = first; key <= newest; ++key) {
      one.sightings.push_back({static_cast<std::size_t>(key - first_key_),
                               point.xy_by_key[key % kKeyViews]});
    }
    if (one.sightings.size() < 2) continue;
    one.rest = FitRest(one.sightings, views, *point.ground, noise);
    if (one.rest.degrees <= 0) continue;
    point.inverse_depth = one.rest.inverse_depth;
    if (one.sightings.size() < kMinSightings) continue;
    // The median of a chi-square is that of Wilson and Hilferty's normal.
    excesses.push_back(one.rest.chi2 / ChiSquareAt(one.rest.degrees, 0.0));
    judged.push_back(std::move(one));
  }
  if (judged.size() < kMinResting) {
    state_ = MoversState::kStarting;
    return;
  }
  // Most of the picture rests: if even that is off by more than the pose and
  // the points are said to be, these are worse than said.
  excess_ = std::max(1.0, Median(excesses));
  std::size_t resting = 0;
  for (Judged& one : judged) {
    FieldPoint& point = points[one.index];
    if (one.rest.chi2 / excess_ <
        ChiSquareAt(one.rest.degrees, kRestLimit_sigma)) {
      point.kind = Kind::kAtRest;
      ++resting;
      continue;
    }
    point.kind = Kind::kOdd;
    TakeMotion(frame, one.sightings, views, noise, point);
    // What has begun to move, or is followed on something else now, is looked
    // at anew.
    if (point.kind == Kind::kOdd) {
      point.first_key = newest;
      point.inverse_depth = 0.0;
    }
  }
  std::size_t contradicting = 0;
  for (const FieldPoint& point : points) {
    contradicting +=
        point.kind == Kind::kMoving || point.kind == Kind::kOdd ? 1 : 0;
  }
  state_ =
      static_cast<double>(contradicting) >
              kMaxContradicting * static_cast<double>(contradicting + resting)
          ? MoversState::kPoseContradicted
      : resting < kMinResting ? MoversState::kStarting
                              : MoversState::kWatching;
}

void MoverFinder::Impl::TakeMotion(const MoversFrame& frame,
                                   std::span<const Sighting> sightings,
                                   std::span<const KeyView> views,
                                   const PointNoise& noise,
                                   FieldPoint& point) const {
  const GroundMotion motion =
      FitGroundMotion(sightings, views, *point.ground, noise, kChangePerSecond);
  if (motion.degrees <= 0 ||
      motion.chi2 / (excess_ * kUnsteadiness * kUnsteadiness) >
          ChiSquareAt(motion.degrees, kMotionLimit_sigma)) {
    return;
  }
  const Matrix2d covariance = motion.covariance.bottomRightCorner<2, 2>();
  const double speed_squared_sigma =
      motion.velocity_m_s.dot(covariance.inverse() * motion.velocity_m_s);
  if (!(speed_squared_sigma > excess_ * kMinSpeed_sigma * kMinSpeed_sigma)) {
    return;
  }
  const geometry::PlaneAxes local(point.ground->plane_world);
  const geometry::Rigid3 camera_from_world = frame.world_from_camera.Inverse();
  const double lasted_s = views[sightings.back().view].time_s -
                          views[sightings.front().view].time_s;
  const auto now_px = frame.camera->ImageFromCamera(
      camera_from_world * local.ToWorld(motion.place_m));
  const auto then_px = frame.camera->ImageFromCamera(
      camera_from_world *
      local.ToWorld(motion.place_m - lasted_s * motion.velocity_m_s));
  const double min_shift_px =
      kMinShift_px * std::max(1.0, frame.camera->width_px() / 1'280.0);
  if (!now_px || !then_px || !((*now_px - *then_px).norm() > min_shift_px)) {
    return;
  }
  const geometry::PlaneAxes axes(frame.ground->reference_world());
  point.kind = Kind::kMoving;
  point.place_m = axes.FromWorld(local.ToWorld(motion.place_m));
  point.velocity_m_s =
      axes.axes_world.transpose() * local.DirectionToWorld(motion.velocity_m_s);
  point.covariance = excess_ * motion.covariance;
}

std::vector<Finding> MoverFinder::Impl::FindGroups(const MoversFrame& frame) {
  const auto& points = field_.points();
  std::vector<MovingPoint> moving;
  std::vector<std::size_t> indices;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (points[i].kind != Kind::kMoving) continue;
    moving.push_back({points[i].pixel_px,
                      points[i].velocity_m_s,
                      points[i].covariance.bottomRightCorner<2, 2>()});
    indices.push_back(i);
  }
  GroupingOptions options;
  options.link_px = kLinkShare * frame.pyramid->size_px.width;
  std::vector<Finding> findings;
  for (const MovingGroup& group : GroupPoints(moving, options)) {
    // Where most of what is seen rests, points move by chance.
    const auto resting = static_cast<std::size_t>(
        std::count_if(points.begin(), points.end(), [&](const FieldPoint& p) {
          return p.kind == Kind::kAtRest && group.box_px.Contains(p.pixel_px);
        }));
    if (resting > group.members.size() ||
        WidthOverLength(group, moving) < kMinWidth) {
      continue;
    }
    auto finding = Locate(frame, group, indices);
    if (!finding) continue;
    const bool is_target =
        std::any_of(frame.targets_px.begin(),
                    frame.targets_px.end(),
                    [&](const Box2& box_px) {
                      return IsSamePlace(box_px, finding->box_px);
                    });
    if (!is_target) findings.push_back(*std::move(finding));
  }
  return findings;
}

std::optional<Finding> MoverFinder::Impl::Locate(
    const MoversFrame& frame,
    const MovingGroup& group,
    const std::vector<std::size_t>& indices) {
  const auto& points = field_.points();
  const geometry::PlaneAxes axes(frame.ground->reference_world());
  Finding finding;
  for (const std::size_t member : group.members) {
    finding.point_ids.push_back(points[indices[member]].id);
  }
  std::sort(finding.point_ids.begin(), finding.point_ids.end());
  const Box2 image_px =
      Box2::FromXywh(0, 0, frame.camera->width_px(), frame.camera->height_px());
  finding.box_px = geometry::Intersection(
      Enlarged(group.box_px,
               0.0,
               kBoxMargin_px * std::max(1.0, image_px.width() / 1'280.0)),
      image_px);
  const LocalGround& local = *points[indices[group.members.front()]].ground;
  const ground::GroundView view{
      frame.camera, frame.world_from_camera, local.plane_world};
  const Vector3d heading_world =
      axes.DirectionToWorld(group.velocity_m_s.normalized());
  const auto body = ground::FitBox(view, finding.box_px, heading_world, kShape);
  // A box whose foot is not on the ground is of nothing that stands there.
  if (!body.ok()) return std::nullopt;
  const Vector3d place_world = body->BottomCenterWorld();
  finding.place_m = axes.FromWorld(place_world);
  // Points were taken to be on the ground: those above it, at heights up to the
  // body's, seem to move by what the camera does, too.
  double height_m = 0.0;
  for (const std::size_t member : group.members) {
    const Vector3d p_object = ground::PointOnRay(
        view, *body, points[indices[member]].pixel_px, /*depth=*/1.0);
    height_m += p_object.z() + 0.5 * body->size_m.z();
  }
  height_m /= static_cast<double>(group.members.size());
  const double eye_height_m = ground::CameraHeight_m(view);
  if (!(eye_height_m > 0.0)) return std::nullopt;
  const double raised = std::clamp(height_m / eye_height_m, 0.0, 0.8);
  const KeyView& oldest = keys_.front().view;
  const KeyView& newest = keys_.back().view;
  const Vector2d eye_velocity_m_s =
      (axes.FromWorld(newest.world_from_camera.translation) -
       axes.FromWorld(oldest.world_from_camera.translation)) /
      std::max(1e-3, newest.time_s - oldest.time_s);
  finding.velocity_m_s =
      (1.0 - raised) * group.velocity_m_s + raised * eye_velocity_m_s;
  finding.velocity_covariance_m2_s2 = group.velocity_covariance_m2_s2;
  // Where its outline ends is seen only as well as its points show.
  const auto placed = ground::PlaceBoxByCenter(view,
                                               finding.box_px.center_px(),
                                               heading_world,
                                               body->size_m,
                                               place_world);
  if (!placed) return std::nullopt;
  const double box_sigma_px =
      2.0 * field_.sigma_px() + kBoxSigma * finding.box_px.size_px().norm();
  finding.place_covariance_m2 = box_sigma_px * box_sigma_px *
                                    (placed->place_by_center_m_px *
                                     placed->place_by_center_m_px.transpose()) +
                                ground::GroundCovarianceFromPose(
                                    view, place_world, frame.pose_covariance);
  finding.ground_per_image_m2_px2 =
      std::abs(placed->place_by_center_m_px.determinant());
  return finding;
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
                             keys_.back().view.time_s;
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
      shift_px = {Median(dx), Median(dy)};
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
