// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/body_follower.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "server/ground/ground_model.h"
#include "server/image/patch_flow.h"
#include "server/tracking/body_size.h"
#include "server/tracking/patch_look.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

constexpr double kDegree = std::numbers::pi / 180.0;

// As many as a body's corners need to be told apart from what else is seen, and
// in all, those that are no longer followed included.
constexpr std::size_t kMaxFollowed = 90;
constexpr std::size_t kMaxPoints = 480;
// Corners are apart by so much of the outline's side, and pixels.
constexpr double kCornerDistance = 0.04;
constexpr double kCornerDistance_px = 3.0;
constexpr double kCornerQuality = 0.01;  // of the best one's
constexpr int kCornerBlock_px = 5;
// Large targets' corners are looked for in a smaller picture.
constexpr int kMaxCornerSide_px = 640;
// A point farther outside the outline is no longer on the target.
constexpr double kOutlineMargin = 0.1;
// A view is taken when the direction to the camera has turned by so much or the
// distance changed by that share, and there is news after three times as much.
constexpr double kViewTurn_rad = 1.0 * kDegree;
constexpr double kViewApproach = 0.04;
constexpr double kNewsTurn_rad = 3.0 * kDegree;
constexpr double kNewsApproach = 0.12;
// A body that moves shows itself quickly, and its structure costs more. With
// fewer known points than this, of which five must agree, it is found anew with
// each view: one that turns loses half of them in 0.1 s.
constexpr double kMovingNews = 1.7;
constexpr std::size_t kFewKnown = 12;
// A point that goes less than this share of its body's way, over so many
// pixels, has stayed behind. One that goes as far another way has not: where
// its body goes is known badly while that turns.
constexpr double kWayOfBody_px = 4.0;
constexpr double kShareOfWay = 0.4;
// So many points, and this share of those followed, stay behind in one frame
// where something comes before the body.
constexpr std::size_t kMinBehind = 2;
constexpr double kShareBehind = 0.1;
// Of longer tracks the body is known by then.
constexpr std::size_t kMaxViews = 256;
// The structure of a body that moves is found from so many of them.
constexpr std::size_t kViewsOfMotion = 24;
// Where a moving body is taken to be, of its side, and where it heads: before
// that was known, and after (Robinson 2014, §4.3: 20 cm for a car of 90 x 50).
constexpr double kPlaceSigma = 0.15;
constexpr double kFirstPlaceSigma = 0.3;
constexpr double kViewHeadingSigma_rad = 10.0 * kDegree;
constexpr double kFirstHeadingSigma_rad = 25.0 * kDegree;
// Of more, the first and the last ones are kept: they are farthest apart.
constexpr std::size_t kMaxObservations = 24;
// A point looks so much like itself in the view before, 1 degree or 4 % away,
// at least. Of those of a truck that passed behind palms, the carried away were
// alike to 0.02 at most, the other one to 0.84; of all looks at points of four
// drives and that flight, 96 % are above 0.66 (with patches that grow as the
// outline does). So are corners monitored by Shi & Tomasi 1994, "Good features
// to track", section 4.
constexpr double kAlike = 0.6;

constexpr image::PatchFlowOptions kFlow{.coarsest_level = 2, .finest_level = 0};
// Followed back, a patch ends so near to where it came from (docs/method.md,
// "A body in motion").
constexpr double kThereAndBack_px = 0.7;

// Is what was found at `to_px` the patch at `from_px`? What was lost, by a turn
// or by blur, is mostly found somewhere, and not again from there (Kalal,
// Mikolajczyk & Matas 2010, "Forward-backward error").
bool ComesBack(const image::LumaPyramid& from,
               const image::LumaPyramid& to,
               const Eigen::Vector2d& from_px,
               const cv::Point2d& to_px) {
  const cv::Point2d expected_px(from_px.x(), from_px.y());
  const auto back = image::FollowPatch(to, from, to_px, expected_px, {});
  return back && cv::norm(back->point_px - expected_px) <= kThereAndBack_px;
}

bool HasChanged(const Eigen::Vector3d& before_m,
                const Eigen::Vector3d& now_m,
                double turn_rad,
                double approach) {
  const double turned =
      std::atan2(before_m.cross(now_m).norm(), before_m.dot(now_m));
  const double nearer = std::abs(std::log(now_m.norm() / before_m.norm()));
  return turned >= turn_rad || nearer >= approach;
}

// A body that stands on the ground as one knew it, not as its points have it:
// what is wrong with the ground is found anew with each fit.
geometry::Rigid3 OnGround(const geometry::Plane& ground_world,
                          const Eigen::Vector3d& p_world,
                          const Eigen::Quaterniond& rotation) {
  return {ground::UprightBox(ground_world,
                             p_world,
                             rotation * Eigen::Vector3d::UnitX(),
                             Eigen::Vector3d::Ones())
              .world_from_object.rotation,
          ground_world.Project(p_world)};
}

Box2 Enlarged(const Box2& box_px, double share) {
  return Box2::FromCenter(box_px.center_px(),
                          (1.0 + 2.0 * share) * box_px.size_px());
}

}  // namespace

void BodyFollower::Follow(const image::Frame& frame,
                          const CameraView& camera,
                          const Box2& outline_px,
                          const ExpectedMotion& motion) {
  if (last_pyramid_ == nullptr) return;
  const auto pyramid = frame.Pyramid();
  if (last_pyramid_->size_px != pyramid->size_px) {
    Lose();
    return;
  }
  const Eigen::Vector2d scale =
      outline_px.size_px().cwiseQuotient(last_outline_px_.size_px());
  const View now{*camera.view.camera, camera.view.world_from_camera.Inverse()};
  std::size_t known = 0;
  std::size_t behind = 0;
  for (Point& point : points_) {
    point.at_rest = std::nullopt;
    if (!point.followed) continue;
    const auto moved_px =
        point.place ? MotionAtRest_px(*last_view_, now, point.place->p_world)
                    : std::nullopt;
    const Eigen::Vector2d start_px =
        moved_px ? Eigen::Vector2d(point.pixel_px + *moved_px)
                 : Eigen::Vector2d(outline_px.min_px +
                                   scale.cwiseProduct(point.pixel_px -
                                                      last_outline_px_.min_px));
    auto flow = image::FollowPatch(*last_pyramid_,
                                   *pyramid,
                                   {point.pixel_px.x(), point.pixel_px.y()},
                                   {start_px.x(), start_px.y()},
                                   kFlow);
    // Of one whose place at rest is known, that tells more.
    if (flow && !moved_px &&
        !ComesBack(*last_pyramid_, *pyramid, point.pixel_px, flow->point_px)) {
      flow.reset();
    }
    point.followed = flow.has_value();
    const Eigen::Vector2d before_px = point.pixel_px;
    if (flow) point.pixel_px = {flow->point_px.x, flow->point_px.y};
    if (flow && point.p_body) {
      ++known;
      if (StaysBehind(point, now, before_px, motion)) {
        ++behind;
        point.followed = false;
      }
    }
    if (moved_px) {
      point.at_rest =
          flow && (point.pixel_px - start_px).norm() < kMaxRestError_px;
    }
  }
  if (behind >= kMinBehind && behind >= kShareBehind * known) {
    last_hidden_ = frame.capture_time;
  }
  EraseUnknown();
  last_pyramid_ = pyramid;
  last_view_ = now;
  last_outline_px_ = outline_px;
}

bool BodyFollower::StaysBehind(Point& point,
                               const View& now,
                               const Eigen::Vector2d& before_px,
                               const ExpectedMotion& motion) const {
  const Eigen::Vector3d p_now_world = motion.world_from_body * *point.p_body;
  const Eigen::Vector3d p_before_world =
      motion.world_from_body_before * *point.p_body;
  const auto moved_px =
      now.camera.ImageFromCamera(now.camera_from_world * p_now_world);
  const auto rests_px =
      now.camera.ImageFromCamera(now.camera_from_world * p_before_world);
  const auto rest_way_px = MotionAtRest_px(*last_view_, now, p_before_world);
  if (!moved_px || !rests_px || !rest_way_px) return false;
  point.expected_way_px += *moved_px - *rests_px;
  point.way_px += point.pixel_px - before_px - *rest_way_px;
  const double expected_px2 = point.expected_way_px.squaredNorm();
  if (expected_px2 < kWayOfBody_px * kWayOfBody_px) return false;
  const bool stays =
      point.way_px.squaredNorm() < kShareOfWay * kShareOfWay * expected_px2;
  point.expected_way_px.setZero();
  point.way_px.setZero();
  return stays;
}

bool BodyFollower::Observe(const image::Frame& frame,
                           const CameraView& camera,
                           const Box2& outline_px,
                           const std::optional<ground::SeenOutline>& silhouette,
                           const BodyState& body) {
  if (is_over_) return false;
  if (body.moves && !moves_) BeginMoving();
  const Box2 within_px = Enlarged(outline_px, kOutlineMargin);
  for (Point& point : points_) {
    point.followed = point.followed && within_px.Contains(point.pixel_px);
  }
  EraseUnknown();
  const geometry::Rigid3& world_from_body = body.box_world.world_from_object;
  Eigen::Vector3d from_m =
      camera.view.world_from_camera.translation - world_from_body.translation;
  if (moves_) from_m = world_from_body.rotation.conjugate() * from_m;
  const bool is_view =
      views_.size() < kMaxViews &&
      (!viewed_from_m_ ||
       HasChanged(*viewed_from_m_, from_m, kViewTurn_rad, kViewApproach));
  if (is_view) {
    viewed_from_m_ = from_m;
    if (moves_) EndCarriedAway(frame);
    FindCorners(frame, camera, outline_px);
    TakeView(camera, silhouette, body);
  }
  last_pyramid_ = frame.Pyramid();
  last_view_ =
      View{*camera.view.camera, camera.view.world_from_camera.Inverse()};
  last_outline_px_ = outline_px;
  return is_view;
}

void BodyFollower::EndCarriedAway(const image::Frame& frame) {
  const auto pyramid = frame.Pyramid();
  for (Point& point : points_) {
    if (!point.followed) continue;
    cv::Mat look = PatchAround(pyramid->levels[0], point.pixel_px);
    point.followed =
        point.look.empty() || CorrelationOf(look, point.look) >= kAlike;
    point.look = std::move(look);
  }
}

void BodyFollower::BeginMoving() {
  moves_ = true;
  viewed_from_m_.reset();
  told_from_m_.reset();
  for (Point& point : points_) {
    point.place.reset();
    point.at_rest.reset();
  }
}

void BodyFollower::EraseUnknown() {
  std::erase_if(points_, [this](const Point& point) {
    // Of a body that moves, or may, a track tells as much when it has ended.
    return !point.followed && !point.place &&
           !((moves_ || point.moves) &&
             point.observations.size() >= kMinObservations);
  });
}

void BodyFollower::Lose() {
  last_pyramid_ = nullptr;
  if (moves_) {
    End();
    return;
  }
  for (Point& point : points_) point.followed = false;
  EraseUnknown();
}

void BodyFollower::End() {
  is_over_ = true;
  last_pyramid_ = nullptr;
  points_.clear();
  views_.clear();
}

bool BodyFollower::HasNews() {
  const double less = moves_ ? kMovingNews : 1.0;
  const bool is_new = viewed_from_m_ && (!told_from_m_ || KnowsFew() ||
                                         HasChanged(*told_from_m_,
                                                    *viewed_from_m_,
                                                    less * kNewsTurn_rad,
                                                    less * kNewsApproach));
  if (is_new) told_from_m_ = viewed_from_m_;
  return is_new;
}

bool BodyFollower::KnowsFew() const {
  const auto known =
      std::count_if(points_.begin(), points_.end(), [](const Point& point) {
        return point.followed && point.p_body;
      });
  return moves_ && views_.size() >= kMinObservations &&
         static_cast<std::size_t>(known) < kFewKnown;
}

BodyFollower::Tracks BodyFollower::TracksOfMotion() const {
  Tracks result;
  // Evenly over the views, the first and the last one among them.
  const std::size_t count = std::min(views_.size(), kViewsOfMotion);
  std::vector<std::optional<std::size_t>> chosen(views_.size());
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t number =
        count == 1 ? 0 : i * (views_.size() - 1) / (count - 1);
    chosen[number] = i;
    result.view_numbers.push_back(number);
  }
  const auto known =
      std::find_if(views_.begin(), views_.end(), [](const View& view) {
        return view.heading_known;
      });
  for (const std::size_t number : result.view_numbers) {
    const View& view = views_[number];
    ground::BodyView& given = result.views.emplace_back();
    given.camera = view.camera;
    given.world_from_camera = view.camera_from_world.Inverse();
    given.world_from_body = view.world_from_body;
    given.place_sigma_m = kPlaceSigma * view.side_m;
    given.heading_sigma_rad = kViewHeadingSigma_rad;
    given.ground_covariance = view.ground_sigmas.cwiseAbs2().asDiagonal();
    given.outline = view.silhouette;
    if (view.heading_known || known == views_.end()) continue;
    // It headed about as it did when that became known.
    given.world_from_body = OnGround(view.ground_world,
                                     view.world_from_body.translation,
                                     known->world_from_body.rotation);
    given.place_sigma_m = kFirstPlaceSigma * view.side_m;
    given.heading_sigma_rad = kFirstHeadingSigma_rad;
  }
  for (std::size_t i = 0; i < points_.size(); ++i) {
    ground::BodyTrack track;
    for (const Observation& seen : points_[i].observations) {
      if (const auto view = chosen[seen.view]) {
        track.observations.push_back({*view, seen.pixel_px});
      }
    }
    if (track.observations.empty()) continue;
    result.tracks.push_back(std::move(track));
    result.point_numbers.push_back(i);
    result.known_body.push_back(points_[i].p_body);
  }
  return result;
}

void BodyFollower::Refine(const Tracks& tracks, const Found& found) {
  for (std::size_t i = 0; i < found.world_from_body.size(); ++i) {
    View& view = views_[tracks.view_numbers[i]];
    view.world_from_body = OnGround(view.ground_world,
                                    found.world_from_body[i].translation,
                                    found.world_from_body[i].rotation);
    view.heading_known = true;
  }
  std::vector<bool> goes_with_it(points_.size(), true);
  for (std::size_t i = 0; i < tracks.tracks.size(); ++i) {
    if (tracks.tracks[i].observations.size() < kMinObservations) continue;
    goes_with_it[tracks.point_numbers[i]] = false;
  }
  for (Point& point : points_) point.p_body.reset();
  for (std::size_t i = 0; i < found.tracks.size(); ++i) {
    const std::size_t number = tracks.point_numbers[found.tracks[i]];
    goes_with_it[number] = true;
    points_[number].p_body = found.points_body[i];
  }
  std::size_t number = 0;
  std::erase_if(points_, [&](const Point&) { return !goes_with_it[number++]; });
}

void BodyFollower::ShiftPoints(const Eigen::Vector3d& by_m) {
  bool is_known = false;
  for (Point& point : points_) {
    if (!point.p_body) continue;
    *point.p_body += by_m;
    is_known = true;
  }
  // Otherwise it was where it was taken to be in each view by itself.
  if (!is_known) return;
  for (View& view : views_) {
    view.world_from_body.translation -= view.world_from_body.rotation * by_m;
  }
}

std::vector<ground::BodySighting> BodyFollower::SightingsInMotion() const {
  std::vector<ground::BodySighting> seen;
  if (last_pyramid_ == nullptr) return seen;
  for (const Point& point : points_) {
    if (point.followed && point.p_body) {
      seen.push_back({*point.p_body, point.pixel_px});
    }
  }
  return seen;
}

void BodyFollower::KeepAgreeing(const std::vector<bool>& agrees) {
  auto agreeing = agrees.begin();
  for (Point& point : points_) {
    if (!point.followed || !point.p_body) continue;
    point.followed = *agreeing++;
  }
  EraseUnknown();
}

void BodyFollower::FindCorners(const image::Frame& frame,
                               const CameraView& camera,
                               const Box2& outline_px) {
  const Box2 within_px = Enlarged(outline_px, kOutlineMargin);
  const auto followed = static_cast<std::size_t>(
      std::count_if(points_.begin(), points_.end(), [](const Point& point) {
        return point.followed;
      }));
  const std::size_t room =
      std::min(kMaxFollowed - std::min(kMaxFollowed, followed),
               moves_ ? kMaxFollowed
                      : kMaxPoints - std::min(kMaxPoints, points_.size()));
  const cv::Rect image(cv::Point(), frame.size_px());
  const cv::Rect region = cv::Rect2d(
      outline_px.x(), outline_px.y(), outline_px.width(), outline_px.height());
  const cv::Rect seen = region & image;
  if (room == 0 || seen.width <= kCornerBlock_px ||
      seen.height <= kCornerBlock_px) {
    return;
  }
  const double apart_px = std::max(
      kCornerDistance_px, kCornerDistance * std::sqrt(outline_px.Area()));
  const double shrink = std::min(
      1.0, 1.0 * kMaxCornerSide_px / std::max(seen.width, seen.height));
  cv::Mat luma = frame.luma(seen);
  if (shrink < 1.0) {
    cv::resize(luma, luma, cv::Size(), shrink, shrink, cv::INTER_AREA);
  }
  cv::Mat free(luma.size(), CV_8UC1, cv::Scalar(255));
  const geometry::Rigid3 camera_from_world =
      camera.view.world_from_camera.Inverse();
  for (const Point& point : points_) {
    std::optional<Eigen::Vector2d> pixel = point.pixel_px;
    if (!point.followed) {
      pixel = point.place ? camera.view.camera->ImageFromCamera(
                                camera_from_world * point.place->p_world)
                          : std::nullopt;
    }
    if (!pixel || !within_px.Contains(*pixel)) continue;
    cv::circle(free,
               cv::Point(static_cast<int>(shrink * (pixel->x() - seen.x)),
                         static_cast<int>(shrink * (pixel->y() - seen.y))),
               static_cast<int>(std::ceil(shrink * apart_px)),
               cv::Scalar(0),
               cv::FILLED);
  }
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(luma,
                          corners,
                          static_cast<int>(room),
                          kCornerQuality,
                          shrink * apart_px,
                          free,
                          kCornerBlock_px);
  for (const cv::Point2f& corner : corners) {
    Point point;
    point.pixel_px = {(corner.x + image::kPixelCenter) / shrink + seen.x,
                      (corner.y + image::kPixelCenter) / shrink + seen.y};
    points_.push_back(std::move(point));
  }
}

void BodyFollower::TakeView(
    const CameraView& camera,
    const std::optional<ground::SeenOutline>& silhouette,
    const BodyState& body) {
  views_.push_back({*camera.view.camera,
                    camera.view.world_from_camera.Inverse(),
                    OnGround(body.ground_world,
                             body.box_world.BottomCenterWorld(),
                             body.box_world.world_from_object.rotation),
                    Side(body.box_world.size_m),
                    body.heading_known,
                    body.ground_world,
                    body.ground_sigmas,
                    silhouette});
  for (Point& point : points_) {
    if (!point.followed) continue;
    point.observations.push_back({views_.size() - 1, point.pixel_px});
    if (point.observations.size() > kMaxObservations) {
      point.observations.erase(point.observations.begin() + 1);
    }
  }
  if (!moves_) {
    TriangulatePoints(camera.view.ground_world, body);
    return;
  }
  std::size_t too_many = points_.size() - std::min(kMaxPoints, points_.size());
  std::erase_if(points_, [&too_many](const Point& point) {
    if (point.followed || too_many == 0) return false;
    --too_many;
    return true;
  });
}

}  // namespace groundlock::tracking
