// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/patch_memory.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "map_store/base/order_statistics.h"
#include "server/ground/box_fit.h"
#include "server/image/luma_pyramid.h"
#include "server/image/patch_flow.h"
#include "server/tracking/patch_look.h"
#include "server/tracking/picture_difference.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::Box3;
using image::LumaPyramid;
using std::chrono::milliseconds;

constexpr double kRadPerDegree = std::numbers::pi / 180.0;

// The body's side in a picture, which is halved until it is no longer, and what
// is kept about it, and looked at, of that.
constexpr double kLongestSide_px = 96.0;
constexpr double kMargin = 0.25;
constexpr double kLookedAtMargin = 0.5;
constexpr std::size_t kMostKept = 12;
constexpr int kMostCorners = 60;
constexpr double kLeastQuality = 0.01;  // of the best one's
constexpr double kCornersApart_px = 3.0;
constexpr int kBlock_px = 3;
// What is nearer to the rim of the body's box may be the ground.
constexpr double kInner = 0.8;
// Corners are known in the body's frame, if that is turned by no more since.
constexpr double kSameFrame_rad = 10.0 * kRadPerDegree;
// One picture stands for directions that are no farther apart, and sizes; it is
// taken again after so long.
constexpr double kSameTurn_rad = 10.0 * kRadPerDegree;
constexpr double kSameSize = 1.5;
constexpr milliseconds kTakenAgain{1'000};
// Patches look alike from directions no farther apart, of areas of no more than
// so many times; a face is seen from before it (half an extent from the body's
// middle), and not as a line.
constexpr double kMostTurn_rad = 50.0 * kRadPerDegree;
constexpr double kLeastOblique = 0.5;
constexpr double kLeastFace_px2 = 25.0;
constexpr double kMostGrowth = 10.0;
constexpr std::size_t kMostLookedAt = 2;  // pictures
// A patch is found where it correlates so much.
constexpr double kLeastCorrelation = 0.8;
// Those that go as one are no farther apart than so much of the side, and
// pixels of the picture; two views of a point at rest meet to so many.
constexpr double kTogether = 0.06;
constexpr double kTogether_px = 1.5;
// Views tell a point's place if they have turned by so much, and it is the
// body's if it is in its box, so many times as large.
constexpr double kLeastTurn_rad = 5.0 * kRadPerDegree;
constexpr double kAboutBody = 1.5;
// So many of them are the body's own: in ten drives, 23,000 times looked
// for 1.2 and 2 of its sizes from where it is, and correlating 0.7, as many
// were never found. The fewer of the body's parts show them, the nearer to
// where it is expected: a wheel looks like another one.
constexpr std::size_t kOwnPatches = 6;
constexpr double kLeastSpread = 0.05;
constexpr double kShiftOfSpread = 0.4;

constexpr image::PatchFlowOptions kFlow{.coarsest_level = 2, .finest_level = 0};

// A part of a frame, in pixels that are halved until the body is small enough.
struct Part {
  cv::Mat luma;
  Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();
  double scale = 1.0;
};

Part TakePart(const image::Frame& frame, const Box2& body_px, double margin) {
  const auto pyramid = frame.Pyramid();
  const double side_px = std::sqrt(body_px.Area());
  int level = 0;
  while (level + 1 < std::ssize(pyramid->levels) &&
         std::ldexp(side_px, -level) > kLongestSide_px) {
    ++level;
  }
  Part part;
  part.scale = std::ldexp(1.0, -level);
  const cv::Mat& luma = pyramid->levels[level];
  const Eigen::Vector2d about = Eigen::Vector2d::Constant(margin * side_px);
  const cv::Rect region =
      PixelsWithin({body_px.min_px - about, body_px.max_px + about},
                   Eigen::Vector2d::Zero(),
                   part.scale,
                   luma.size());
  part.origin_px = Eigen::Vector2d(region.x, region.y) / part.scale;
  if (!region.empty()) part.luma = luma(region);
  return part;
}

// The area over which points are spread: the root of their covariance's
// determinant.
double SpreadOf(const std::vector<Eigen::Vector2d>& points) {
  const auto n = static_cast<double>(points.size());
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : points) mean += p / n;
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
  for (const Eigen::Vector2d& p : points) {
    covariance += (p - mean) * (p - mean).transpose() / n;
  }
  return std::sqrt(std::max(0.0, covariance.determinant()));
}

Eigen::Vector3d EyeFromBody(const CameraView& camera, const Box3& body_world) {
  return body_world.world_from_object.Inverse() *
         camera.view.world_from_camera.translation;
}

double AngleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

// A camera's ray through a pixel, in the body's frame.
struct Ray {
  Eigen::Vector3d origin;
  Eigen::Vector3d direction;
};

std::optional<Ray> RayOf(const geometry::CameraModel& camera,
                         const geometry::Rigid3& camera_from_body,
                         const Eigen::Vector2d& pixel_px) {
  const auto direction = camera.RayFromImage(pixel_px);
  if (!direction) return std::nullopt;
  const geometry::Rigid3 body_from_camera = camera_from_body.Inverse();
  return Ray{body_from_camera.translation,
             body_from_camera.rotation * *direction};
}

// Where two rays are nearest to each other, midway; nullopt: nowhere before the
// cameras.
std::optional<Eigen::Vector3d> Meet(const Ray& a, const Ray& b) {
  Eigen::Matrix<double, 3, 2> ways;
  ways << a.direction, -b.direction;
  const Eigen::Matrix2d normal = ways.transpose() * ways;
  if (!(normal.determinant() > 0.0)) return std::nullopt;
  const Eigen::Vector2d range =
      normal.inverse() * ways.transpose() * (b.origin - a.origin);
  if (!(range.minCoeff() > 0.0)) return std::nullopt;
  return Eigen::Vector3d(0.5 * (a.origin + range[0] * a.direction + b.origin +
                                range[1] * b.direction));
}

}  // namespace

bool PatchMemory::AreKnownIn(double unturned_rad) const {
  return std::abs(std::remainder(unturned_rad - unturned_rad_,
                                 2.0 * std::numbers::pi)) < kSameFrame_rad;
}

void PatchMemory::Keep(const image::Frame& frame,
                       const CameraView& camera,
                       const Box3& body_world,
                       const Box2& outline_px,
                       double unturned_rad) {
  if (!AreKnownIn(unturned_rad)) pictures_.clear();
  unturned_rad_ = unturned_rad;
  const Eigen::Vector3d direction_body =
      EyeFromBody(camera, body_world).normalized();
  const double side_px = std::sqrt(outline_px.Area());
  const auto same =
      std::find_if(pictures_.begin(), pictures_.end(), [&](const Picture& p) {
        return AngleBetween(p.direction_body, direction_body) < kSameTurn_rad &&
               p.side_px < kSameSize * side_px &&
               side_px < kSameSize * p.side_px;
      });
  if (same != pictures_.end() &&
      frame.capture_time - same->time < kTakenAgain) {
    return;
  }
  const Part part = TakePart(frame, outline_px, kMargin);
  if (part.luma.empty()) return;
  Picture picture;
  picture.luma = part.luma.clone();
  picture.origin_px = part.origin_px;
  picture.scale = part.scale;
  picture.side_px = side_px;
  picture.camera = *camera.view.camera;
  picture.world_from_camera = camera.view.world_from_camera;
  picture.direction_body = direction_body;
  picture.time = frame.capture_time;
  picture.reset_count = camera.reset_count;
  picture.picture_from_face =
      FacesOf(camera, body_world, part.origin_px, part.scale);
  cv::Mat inside(part.luma.size(), CV_8UC1, cv::Scalar(0));
  inside(PixelsWithin(
      outline_px, part.origin_px, part.scale, part.luma.size())) = 255;
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(part.luma,
                          corners,
                          kMostCorners,
                          kLeastQuality,
                          kCornersApart_px,
                          inside,
                          kBlock_px);
  Box3 inner_world = body_world;
  inner_world.size_m *= kInner;
  for (const cv::Point2f& corner : corners) {
    const Eigen::Vector2d picture_px(corner.x + image::kPixelCenter,
                                     corner.y + image::kPixelCenter);
    const Eigen::Vector2d pixel_px = picture_px / part.scale + part.origin_px;
    if (ground::PointOnRay(camera.view, inner_world, pixel_px, 1.0).isZero()) {
      continue;
    }
    const Eigen::Vector3d share =
        ground::PointOnRay(camera.view, body_world, pixel_px, 1.0)
            .cwiseQuotient(body_world.size_m);
    int axis = 0;
    share.cwiseAbs().maxCoeff(&axis);
    picture.corners.push_back(
        {picture_px, share, 2 * axis + (share[axis] > 0.0 ? 1 : 0)});
  }
  if (picture.corners.size() < kOwnPatches) return;
  if (same != pictures_.end()) {
    *same = std::move(picture);
    return;
  }
  if (pictures_.size() >= kMostKept) {
    pictures_.erase(std::min_element(
        pictures_.begin(),
        pictures_.end(),
        [](const Picture& a, const Picture& b) { return a.time < b.time; }));
  }
  pictures_.push_back(std::move(picture));
}

std::optional<PatchMemory::Match> PatchMemory::Find(const image::Frame& frame,
                                                    const CameraView& camera,
                                                    const Box3& body_world,
                                                    bool rests) const {
  const Eigen::Vector3d eye_body = EyeFromBody(camera, body_world);
  std::vector<std::pair<double, const Picture*>> near;
  for (const Picture& picture : pictures_) {
    const double turn_rad = AngleBetween(picture.direction_body, eye_body);
    if (turn_rad < kMostTurn_rad) near.emplace_back(turn_rad, &picture);
  }
  std::sort(near.begin(), near.end());
  if (near.size() > kMostLookedAt) near.resize(kMostLookedAt);
  std::optional<Match> best;
  for (const auto& [turn_rad, picture] : near) {
    auto match = FindAsIn(*picture, frame, camera, body_world, rests);
    if (match && (!best || match->patches.size() > best->patches.size())) {
      best = std::move(match);
    }
  }
  return best;
}

PatchMemory::Faces PatchMemory::FacesOf(const CameraView& camera,
                                        const Box3& body_world,
                                        const Eigen::Vector2d& origin_px,
                                        double scale) {
  const geometry::Rigid3 camera_from_body =
      camera.view.world_from_camera.Inverse() * body_world.world_from_object;
  const Eigen::Vector3d eye =
      EyeFromBody(camera, body_world).cwiseQuotient(body_world.size_m);
  const auto project = [&](const Eigen::Vector3d& share) {
    auto pixel = camera.view.camera->ImageFromCamera(
        camera_from_body * share.cwiseProduct(body_world.size_m));
    if (pixel) *pixel = scale * (*pixel - origin_px);
    return pixel;
  };
  constexpr double kStep = 0.25;
  Faces faces;
  for (int face = 0; face < std::ssize(faces); ++face) {
    const int axis = face / 2;
    const double side = face % 2 == 1 ? 0.5 : -0.5;
    if (!(eye[axis] * side > 0.0) || std::abs(eye[axis]) < kLeastOblique) {
      continue;
    }
    const Eigen::Vector3d middle = side * Eigen::Vector3d::Unit(axis);
    const auto m = project(middle);
    const auto u =
        project(middle + kStep * Eigen::Vector3d::Unit((axis + 1) % 3));
    const auto v =
        project(middle + kStep * Eigen::Vector3d::Unit((axis + 2) % 3));
    if (!m || !u || !v) continue;
    Affinity affinity;
    affinity << (*u - *m) / kStep, (*v - *m) / kStep, *m;
    if (std::abs(affinity.leftCols<2>().determinant()) >= kLeastFace_px2) {
      faces[face] = affinity;
    }
  }
  return faces;
}

std::optional<PatchMemory::Match> PatchMemory::FindAsIn(
    const Picture& picture,
    const image::Frame& frame,
    const CameraView& camera,
    const Box3& body_world,
    bool rests) {
  const geometry::Rigid3& world_from_body = body_world.world_from_object;
  const geometry::Rigid3 camera_from_body =
      camera.view.world_from_camera.Inverse() * world_from_body;
  // Where they would be now.
  std::vector<Eigen::Vector2d> expected_px;
  std::vector<const Corner*> corners;
  for (const Corner& corner : picture.corners) {
    const auto pixel = camera.view.camera->ImageFromCamera(
        camera_from_body * corner.share.cwiseProduct(body_world.size_m));
    if (!pixel) continue;
    expected_px.push_back(*pixel);
    corners.push_back(&corner);
  }
  if (corners.size() < kOwnPatches) return std::nullopt;
  Box2 about_px{expected_px[0], expected_px[0]};
  for (const Eigen::Vector2d& p : expected_px) {
    about_px.min_px = about_px.min_px.cwiseMin(p);
    about_px.max_px = about_px.max_px.cwiseMax(p);
  }
  const double side_px = std::sqrt(about_px.Area());
  if (!(side_px > 0.0)) return std::nullopt;
  const Part now = TakePart(frame, about_px, kLookedAtMargin);
  // Patches that reach over its rim are none of the image.
  constexpr double kRim = 0.5 * LumaPyramid::kWindowPx;
  if (std::min(now.luma.cols, now.luma.rows) <= 2.0 * kRim) return std::nullopt;
  const Box2 inside = Box2::FromXywh(
      kRim, kRim, now.luma.cols - 2.0 * kRim, now.luma.rows - 2.0 * kRim);
  const auto now_pyramid = image::BuildPyramid(now.luma.clone());
  // The picture, drawn as each face of it would be seen now.
  struct Drawn {
    Affinity from_picture;
    std::shared_ptr<const LumaPyramid> pyramid;
  };
  std::array<std::optional<Drawn>, 6> drawn;
  const Faces now_from_face =
      FacesOf(camera, body_world, now.origin_px, now.scale);
  for (std::size_t face = 0; face < drawn.size(); ++face) {
    const auto& from = picture.picture_from_face[face];
    const auto& to = now_from_face[face];
    if (!from || !to) continue;
    const Eigen::Matrix2d A = to->leftCols<2>() * from->leftCols<2>().inverse();
    if (!(A.determinant() > 1.0 / kMostGrowth &&
          A.determinant() < kMostGrowth)) {
      continue;
    }
    const Eigen::Vector2d b = to->col(2) - A * from->col(2);
    const Eigen::Vector2d first =
        b + (A - Eigen::Matrix2d::Identity()) *
                Eigen::Vector2d::Constant(image::kPixelCenter);
    cv::Mat luma;
    cv::warpAffine(
        picture.luma,
        luma,
        cv::Matx23d(A(0, 0), A(0, 1), first.x(), A(1, 0), A(1, 1), first.y()),
        now.luma.size(),
        cv::INTER_LINEAR,
        cv::BORDER_REPLICATE);
    drawn[face].emplace();
    drawn[face]->from_picture << A, b;
    drawn[face]->pyramid = image::BuildPyramid(luma);
  }
  const bool by_rays =
      rests && picture.reset_count == camera.reset_count &&
      AngleBetween(picture.direction_body, EyeFromBody(camera, body_world)) >
          kLeastTurn_rad;
  const geometry::Rigid3 then_from_body =
      picture.world_from_camera.Inverse() * world_from_body;
  const auto meets = [&](const Patch& patch) {
    const auto a = RayOf(picture.camera, then_from_body, patch.then_px);
    const auto b = RayOf(*camera.view.camera, camera_from_body, patch.now_px);
    const auto p = a && b ? Meet(*a, *b) : std::nullopt;
    if (!p || (p->cwiseQuotient(body_world.size_m)).cwiseAbs().maxCoeff() >
                  0.5 * kAboutBody) {
      return false;
    }
    const auto then_px = picture.camera.ImageFromCamera(then_from_body * *p);
    const auto now_px =
        camera.view.camera->ImageFromCamera(camera_from_body * *p);
    return then_px && now_px &&
           picture.scale * (*then_px - patch.then_px).norm() < kTogether_px &&
           now.scale * (*now_px - patch.now_px).norm() < kTogether_px;
  };
  std::vector<Patch> found;
  std::vector<Eigen::Vector2d> off_px;
  std::vector<double> off_x;
  std::vector<double> off_y;
  const Eigen::Vector3d to_base(0.0, 0.0, 0.5 * body_world.size_m.z());
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const auto& face = drawn[corners[i]->face];
    if (!face) continue;
    const Eigen::Vector2d from_px =
        face->from_picture * corners[i]->picture_px.homogeneous();
    const Eigen::Vector2d start_px =
        now.scale * (expected_px[i] - now.origin_px);
    if (!inside.Contains(from_px) || !inside.Contains(start_px)) continue;
    const auto flow = image::FollowPatch(*face->pyramid,
                                         *now_pyramid,
                                         {from_px.x(), from_px.y()},
                                         {start_px.x(), start_px.y()},
                                         kFlow);
    if (!flow) continue;
    const Eigen::Vector2d there_px(flow->point_px.x, flow->point_px.y);
    if (!inside.Contains(there_px)) continue;
    if (!(CorrelationOf(PatchAround(face->pyramid->levels[0], from_px),
                        PatchAround(now.luma, there_px)) >=
          kLeastCorrelation)) {
      continue;
    }
    const Patch patch{
        corners[i]->picture_px / picture.scale + picture.origin_px,
        there_px / now.scale + now.origin_px,
        corners[i]->share.cwiseProduct(body_world.size_m) + to_base};
    if (by_rays && !meets(patch)) continue;
    found.push_back(patch);
    off_px.push_back(patch.now_px - expected_px[i]);
    off_x.push_back(off_px.back().x());
    off_y.push_back(off_px.back().y());
  }
  if (found.size() < kOwnPatches) return std::nullopt;
  const Eigen::Vector2d usual_px(base::Median(off_x), base::Median(off_y));
  const double together_px =
      std::max(kTogether_px / now.scale, kTogether * side_px);
  Match match;
  std::vector<Eigen::Vector2d> at_px;
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (!by_rays && (off_px[i] - usual_px).norm() > together_px) continue;
    match.shift_px += off_px[i];
    at_px.push_back(found[i].now_px);
    match.patches.push_back(found[i]);
  }
  if (match.patches.size() < kOwnPatches) return std::nullopt;
  match.shift_px /= static_cast<double>(match.patches.size());
  const double whole = SpreadOf(expected_px);
  if (!(whole > 0.0)) return std::nullopt;
  const double spread = SpreadOf(at_px) / whole;
  if (!(spread >= kLeastSpread) ||
      (!by_rays &&
       match.shift_px.norm() > kShiftOfSpread * std::sqrt(spread) * side_px)) {
    return std::nullopt;
  }
  return match;
}

}  // namespace groundlock::tracking
