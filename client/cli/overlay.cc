// SPDX-License-Identifier: Apache-2.0
#include "client/cli/overlay.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/names.h"

namespace groundlock::cli {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Pieces that an edge of the 3D box is drawn in: at 1 m and f = 1000 the bow of
// a strong lens over one of them stays far below a pixel.
constexpr int kPiecesPerEdge = 16;
// OpenCV draws with 4 fractional bits.
constexpr int kShift = 4;

class Canvas {
 public:
  Canvas(const geometry::CameraModel& camera,
         const std::optional<geometry::Rigid3>& world_from_camera,
         cv::Mat& bgr)
      : camera_(camera), bgr_(bgr) {
    if (world_from_camera) camera_from_world_ = world_from_camera->Inverse();
    scale_ = std::max(0.4, bgr.rows / 720.0);
  }

  // Sizes are given for an image 720 pixels high.
  int Scaled(double size) const {
    return std::max(1, static_cast<int>(std::lround(size * scale_)));
  }
  double scale() const { return scale_; }
  cv::Mat& bgr() { return bgr_; }

  std::optional<Vector2d> Project(const Vector3d& p_world) const {
    if (!camera_from_world_) return std::nullopt;
    const Vector3d p_camera = *camera_from_world_ * p_world;
    // Points closer than this are at, or behind, the lens.
    if (p_camera.z() < 1e-3) return std::nullopt;
    return camera_.ImageFromCamera(p_camera);
  }

  void Line(const Vector2d& a,
            const Vector2d& b,
            const cv::Scalar& colour,
            int thickness) {
    if (!Drawable(a) || !Drawable(b)) return;
    cv::line(bgr_, Fixed(a), Fixed(b), colour, thickness, cv::LINE_AA, kShift);
  }

  void Dot(const Vector2d& p, double radius, const cv::Scalar& colour) {
    if (!Drawable(p)) return;
    cv::circle(bgr_,
               Fixed(p),
               static_cast<int>(std::lround(radius * (1 << kShift))),
               colour,
               cv::FILLED,
               cv::LINE_AA,
               kShift);
  }

  void DashedLine(const Vector2d& a,
                  const Vector2d& b,
                  const cv::Scalar& colour,
                  int thickness) {
    const double dash = 8.0 * scale_;
    const double length = (b - a).norm();
    // A box far larger than the image would cost millions of dashes.
    if (!Drawable(a) || !Drawable(b) || length < 1e-9) return;
    const Vector2d direction = (b - a) / length;
    for (double s = 0.0; s < length; s += 2.0 * dash) {
      Line(a + s * direction,
           a + std::min(length, s + dash) * direction,
           colour,
           thickness);
    }
  }

  // A straight line in the world: bent by the lens.
  void WorldLine(const Vector3d& a,
                 const Vector3d& b,
                 const cv::Scalar& colour,
                 int thickness,
                 int pieces) {
    std::optional<Vector2d> last = Project(a);
    for (int i = 1; i <= pieces; ++i) {
      const double t = static_cast<double>(i) / pieces;
      const std::optional<Vector2d> next = Project((1.0 - t) * a + t * b);
      if (last && next) Line(*last, *next, colour, thickness);
      last = next;
    }
  }

  void Text(const std::string& text, int x, int y, const cv::Scalar& colour) {
    const double size = 0.5 * scale_;
    for (const bool outline : {true, false}) {
      cv::putText(bgr_,
                  text,
                  {x, y},
                  cv::FONT_HERSHEY_SIMPLEX,
                  size,
                  outline ? cv::Scalar::all(0) : colour,
                  Scaled(outline ? 3 : 1),
                  cv::LINE_AA);
    }
  }

 private:
  // Fixed-point coordinates must not overflow, and nothing that far away shows.
  static bool Drawable(const Vector2d& p) {
    return p.allFinite() && p.cwiseAbs().maxCoeff() < 1e5;
  }
  // OpenCV's (0, 0) is the centre of the first pixel, ours is (0.5, 0.5).
  static cv::Point Fixed(const Vector2d& p) {
    return {static_cast<int>(std::lround((p.x() - 0.5) * (1 << kShift))),
            static_cast<int>(std::lround((p.y() - 0.5) * (1 << kShift)))};
  }

  const geometry::CameraModel& camera_;
  std::optional<geometry::Rigid3> camera_from_world_;
  cv::Mat& bgr_;
  double scale_ = 1.0;
};

// The four corners of each upright face, in order around it; the outward normal
// is an axis of the object.
struct Face {
  std::array<int, 4> corners;
  Vector3d normal_object;
};
std::array<Face, 4> UprightFaces() {
  return {{{{1, 3, 7, 5}, Vector3d::UnitX()},
           {{0, 2, 6, 4}, -Vector3d::UnitX()},
           {{2, 3, 7, 6}, Vector3d::UnitY()},
           {{0, 1, 5, 4}, -Vector3d::UnitY()}}};
}

// The front face is the one that looks at the camera (Robinson 2014, eq. 3.19).
Face FrontFace(const geometry::Box3& box, const Vector3d& camera_center_world) {
  Face front = UprightFaces()[0];
  double best = -2.0;
  for (const Face& face : UprightFaces()) {
    const Vector3d normal = box.world_from_object.rotation * face.normal_object;
    const double cosine = normal.dot(
        (camera_center_world - box.world_from_object.translation).normalized());
    if (cosine > best) {
      best = cosine;
      front = face;
    }
  }
  return front;
}

void DrawBoxWorld(const geometry::Box3& box,
                  const Vector3d& camera_center_world,
                  const OverlayColours& colours,
                  Canvas& canvas) {
  const std::array<Vector3d, 8> corners = box.CornersWorld();
  const int thickness = canvas.Scaled(1.5);
  const Face front = FrontFace(box, camera_center_world);
  const auto in_front = [&](int corner) {
    return std::find(front.corners.begin(), front.corners.end(), corner) !=
           front.corners.end();
  };
  for (int from = 0; from < 8; ++from) {
    for (const int bit : {1, 2, 4}) {
      const int to = from | bit;
      // Yellow under the green edges would shine through at their rims.
      if (to == from || (in_front(from) && in_front(to))) continue;
      canvas.WorldLine(corners[from],
                       corners[to],
                       colours.box_world,
                       thickness,
                       kPiecesPerEdge);
    }
  }
  for (size_t i = 0; i < 4; ++i) {
    canvas.WorldLine(corners[front.corners[i]],
                     corners[front.corners[(i + 1) % 4]],
                     colours.front_face,
                     canvas.Scaled(2.0),
                     kPiecesPerEdge);
  }
  if (const auto center = canvas.Project(box.world_from_object.translation)) {
    canvas.Dot(*center, 4.0 * canvas.scale(), colours.center);
  }
}

void DrawBoxImage(const sdk::TargetResult& target,
                  const OverlayColours& colours,
                  Canvas& canvas) {
  const geometry::Box2& box = *target.box_px;
  const Vector2d corners[4] = {box.min_px,
                               {box.max_px.x(), box.min_px.y()},
                               box.max_px,
                               {box.min_px.x(), box.max_px.y()}};
  const bool seen = target.state == sdk::TargetState::kTracked;
  const cv::Scalar& colour = seen ? colours.seen_box : colours.predicted_box;
  for (size_t i = 0; i < 4; ++i) {
    const Vector2d& a = corners[i];
    const Vector2d& b = corners[(i + 1) % 4];
    if (seen) {
      canvas.Line(a, b, colour, canvas.Scaled(2.0));
    } else {
      canvas.DashedLine(a, b, colour, canvas.Scaled(2.0));
    }
  }
  // The bar stands on the box's lower edge, inside it.
  const double share = std::clamp(target.confidence, 0.0, 1.0);
  const int thickness = canvas.Scaled(5.0);
  const double y = box.max_px.y() - 0.5 * thickness - canvas.scale();
  if (share > 0.0) {
    canvas.Line({box.min_px.x(), y},
                {box.min_px.x() + share * box.width(), y},
                colours.confidence,
                thickness);
  }
  const double x = std::clamp(box.min_px.x(), 0.0, 1e5);
  const double above = std::clamp(box.min_px.y() - 6.0, 12.0, 1e5);
  canvas.Text(target.id, static_cast<int>(x), static_cast<int>(above), colour);
}

void DrawMover(const sdk::Mover& mover,
               const OverlayColours& colours,
               Canvas& canvas) {
  const geometry::Box2& box = mover.box_px;
  const Vector2d corners[4] = {box.min_px,
                               {box.max_px.x(), box.min_px.y()},
                               box.max_px,
                               {box.min_px.x(), box.max_px.y()}};
  for (size_t i = 0; i < 4; ++i) {
    canvas.DashedLine(
        corners[i], corners[(i + 1) % 4], colours.mover, canvas.Scaled(1.0));
  }
  canvas.Text(absl::StrFormat(
                  "%d  %.1f m/s", mover.id, mover.velocity_world_m_s.norm()),
              static_cast<int>(std::clamp(box.min_px.x(), 0.0, 1e5)),
              static_cast<int>(std::clamp(box.min_px.y() - 6.0, 12.0, 1e5)),
              colours.mover);
}

void DrawTrail(const std::deque<GroundTrails::Point>& trail,
               const OverlayColours& colours,
               Canvas& canvas) {
  for (size_t i = 1; i < trail.size(); ++i) {
    canvas.WorldLine(trail[i - 1].p_world,
                     trail[i].p_world,
                     trail[i].seen ? colours.trail : colours.predicted_box,
                     canvas.Scaled(1.5),
                     /*pieces=*/1);
  }
}

std::string CameraWords(const sdk::FrameResult& result) {
  std::string words = absl::StrFormat(
      "frame %d  %.2f s  camera %s",
      result.sequence,
      std::chrono::duration<double>(result.capture_time).count(),
      CameraStateName(result.camera.state));
  if (result.camera.num_inliers > 0) {
    absl::StrAppendFormat(&words,
                          "  %d inliers, %.2f px",
                          result.camera.num_inliers,
                          result.camera.mean_reprojection_error_px);
  }
  return words;
}

std::string TargetWords(const sdk::FrameResult& result,
                        const sdk::TargetResult& target) {
  std::string words = absl::StrFormat("%s %s  confidence %.2f",
                                      target.id,
                                      TargetStateName(target.state),
                                      target.confidence);
  if (target.ground_center_world && result.camera.world_from_camera) {
    absl::StrAppendFormat(&words,
                          "  %.1f m away",
                          (*target.ground_center_world -
                           result.camera.world_from_camera->translation)
                              .norm());
  }
  if (target.state != sdk::TargetState::kTracked) {
    absl::StrAppendFormat(&words, "  unseen for %.1f s", target.age_s);
  }
  return words;
}

void DrawWords(const sdk::FrameResult& result,
               const OverlayColours& colours,
               Canvas& canvas) {
  std::vector<std::pair<std::string, cv::Scalar>> lines;
  const cv::Scalar white = cv::Scalar::all(255);
  lines.emplace_back(CameraWords(result),
                     result.camera.state == sdk::CameraState::kTracked
                         ? white
                         : colours.predicted_box);
  for (const sdk::TargetResult& target : result.targets) {
    lines.emplace_back(TargetWords(result, target),
                       target.state == sdk::TargetState::kTracked
                           ? white
                           : colours.predicted_box);
  }
  for (const sdk::TargetError& error : result.target_errors) {
    lines.emplace_back(absl::StrCat(error.id, ": ", error.message),
                       colours.predicted_box);
  }
  lines.emplace_back(
      absl::StrFormat("decode %.1f  localize %.1f  track %.1f  total %.1f ms",
                      result.times.decode_ms,
                      result.times.localize_ms,
                      result.times.track_ms,
                      result.times.total_ms),
      white);
  int y = canvas.Scaled(22);
  for (const auto& [text, colour] : lines) {
    canvas.Text(text, canvas.Scaled(10), y, colour);
    y += canvas.Scaled(22);
  }
}

}  // namespace

void GroundTrails::Add(const sdk::FrameResult& result) {
  for (const sdk::TargetResult& target : result.targets) {
    if (!target.ground_center_world ||
        target.state == sdk::TargetState::kLost) {
      continue;
    }
    std::deque<Point>& trail = trails_[target.id];
    trail.push_back({*target.ground_center_world,
                     target.state == sdk::TargetState::kTracked});
    if (trail.size() > max_) trail.pop_front();
  }
}

void DrawOverlay(const geometry::CameraModel& camera,
                 const sdk::FrameResult& result,
                 const GroundTrails& trails,
                 const OverlayColours& colours,
                 cv::Mat& bgr) {
  Canvas canvas(camera, result.camera.world_from_camera, bgr);
  for (const Eigen::Vector2f& match : result.camera.match_xy_px) {
    canvas.Dot(match.cast<double>(), 2.0 * canvas.scale(), colours.match);
  }
  for (const auto& [id, trail] : trails.trails()) {
    DrawTrail(trail, colours, canvas);
  }
  for (const sdk::Mover& mover : result.movers) {
    if (mover.box_px.IsFinite()) DrawMover(mover, colours, canvas);
  }
  for (const sdk::TargetResult& target : result.targets) {
    if (target.state == sdk::TargetState::kLost) continue;
    if (target.box_px && target.box_px->IsFinite()) {
      DrawBoxImage(target, colours, canvas);
    }
    if (target.box_world && result.camera.world_from_camera) {
      DrawBoxWorld(*target.box_world,
                   result.camera.world_from_camera->translation,
                   colours,
                   canvas);
    }
  }
  DrawWords(result, colours, canvas);
}

void DrawNoResult(const std::string& reason, cv::Mat& bgr) {
  bgr *= 0.5;
  const geometry::CameraModel unused;
  Canvas canvas(unused, std::nullopt, bgr);
  canvas.Text(
      reason, canvas.Scaled(10), canvas.Scaled(22), cv::Scalar::all(255));
}

}  // namespace groundlock::cli
