// SPDX-License-Identifier: Apache-2.0
#include "tests/eval/sequence_csv.h"

#include <chrono>
#include <cmath>
#include <sstream>

namespace groundlock::eval {
namespace {

double Milliseconds(std::chrono::nanoseconds time) {
  return std::chrono::duration<double, std::milli>(time).count();
}

const char* Name(localization::CameraState state) {
  switch (state) {
    case localization::CameraState::kInitializing:
      return "INITIALIZING";
    case localization::CameraState::kTracked:
      return "TRACKED";
    case localization::CameraState::kHeld:
      return "HELD";
    case localization::CameraState::kLost:
      return "LOST";
    case localization::CameraState::kOdometry:
      return "ODOMETRY";
  }
  return "";
}

const char* Name(tracking::TargetState state) {
  switch (state) {
    case tracking::TargetState::kTracked:
      return "TRACKED";
    case tracking::TargetState::kPredicted:
      return "PREDICTED";
    case tracking::TargetState::kLost:
      return "LOST";
  }
  return "";
}

const char* Name(movers::MoversState state) {
  switch (state) {
    case movers::MoversState::kNotAsked:
      return "NOT_ASKED";
    case movers::MoversState::kWatching:
      return "WATCHING";
    case movers::MoversState::kStarting:
      return "STARTING";
    case movers::MoversState::kNoMap:
      return "NO_MAP";
    case movers::MoversState::kNoGround:
      return "NO_GROUND";
    case movers::MoversState::kNoPose:
      return "NO_POSE";
    case movers::MoversState::kPoseContradicted:
      return "POSE_CONTRADICTED";
  }
  return "";
}

void WriteTarget(std::ostream& out, const tracking::TargetResult& target) {
  out << target.id << ',' << Name(target.state) << ',' << target.confidence;
  if (target.box_px) {
    out << ',' << target.box_px->x() << ',' << target.box_px->y() << ','
        << target.box_px->width() << ',' << target.box_px->height();
  } else {
    out << ",,,,";
  }
  if (target.box_world) {
    const Eigen::Vector3d p = target.box_world->BottomCenterWorld();
    const Eigen::Vector3d heading =
        target.box_world->world_from_object.rotation * Eigen::Vector3d::UnitX();
    const Eigen::Vector3d& size_m = target.box_world->size_m;
    out << ',' << p.x() << ',' << p.y() << ',' << p.z() << ','
        << std::atan2(heading.y(), heading.x()) << ',' << size_m.x() << ','
        << size_m.y() << ',' << size_m.z();
  } else {
    out << ",,,,,,,";
  }
}

}  // namespace

void WriteResultsHeader(std::ostream& out) {
  out << "frame,t_s,camera_state,cam_x,cam_y,cam_z,cam_qw,cam_qx,cam_qy,cam_qz,"
         "inliers,target,target_state,confidence,box_x,box_y,box_w,box_h,"
         "ground_x,ground_y,ground_z,heading_rad,length_m,width_m,height_m,"
         "decode_ms,localize_ms,track_ms,total_ms,"
         "heading_sigma_rad,front_known,length_sigma_m,width_sigma_m,"
         "height_sigma_m\n";
}

void WriteResults(std::ostream& out, const tracking::FrameResult& result) {
  std::ostringstream camera;
  camera.precision(10);
  camera << result.sequence << ','
         << std::chrono::duration<double>(result.capture_time).count() << ','
         << Name(result.camera.state);
  if (result.camera.world_from_camera) {
    const Eigen::Vector3d& p = result.camera.world_from_camera->translation;
    const Eigen::Quaterniond& q = result.camera.world_from_camera->rotation;
    camera << ',' << p.x() << ',' << p.y() << ',' << p.z() << ',' << q.w()
           << ',' << q.x() << ',' << q.y() << ',' << q.z();
  } else {
    camera << ",,,,,,,";
  }
  camera << ',' << result.camera.num_inliers << ',';
  std::ostringstream times;
  times << ',' << Milliseconds(result.times.decode) << ','
        << Milliseconds(result.times.localize) << ','
        << Milliseconds(result.times.track) << ','
        << Milliseconds(result.times.total);
  if (result.targets.empty()) {
    out << camera.str() << ",,,,,,,,,,,,," << times.str() << ",,,,,\n";
  }
  for (const tracking::TargetResult& target : result.targets) {
    std::ostringstream cells;
    cells.precision(8);
    WriteTarget(cells, target);
    out << camera.str() << cells.str() << times.str();
    if (target.box_world) {
      const Eigen::Vector3d sigma_m =
          target.size_covariance_m2.diagonal().cwiseSqrt();
      out << ',' << target.heading_sigma_rad << ',' << target.front_known << ','
          << sigma_m.x() << ',' << sigma_m.y() << ',' << sigma_m.z() << '\n';
    } else {
      out << ",,,,,\n";
    }
  }
}

void WriteMoversHeader(std::ostream& out) {
  out << "frame,t_s,movers_state,mover,confidence,box_x,box_y,box_w,box_h,"
         "ground_x,ground_y,ground_z,velocity_x,velocity_y,velocity_z,"
         "place_sigma_m,velocity_sigma_m_s\n";
}

void WriteMovers(std::ostream& out, const tracking::FrameResult& result) {
  std::ostringstream line;
  line.precision(10);
  line << result.sequence << ','
       << std::chrono::duration<double>(result.capture_time).count() << ','
       << Name(result.movers.state);
  if (result.movers.movers.empty()) out << line.str() << ",,,,,,,,,,,,,,\n";
  for (const movers::Mover& mover : result.movers.movers) {
    const geometry::Box2& box_px = mover.box_px;
    const Eigen::Vector3d& p = mover.ground_world;
    const Eigen::Vector3d& v = mover.velocity_world_m_s;
    out << line.str() << ',' << mover.id << ',' << mover.confidence << ','
        << box_px.x() << ',' << box_px.y() << ',' << box_px.width() << ','
        << box_px.height() << ',' << p.x() << ',' << p.y() << ',' << p.z()
        << ',' << v.x() << ',' << v.y() << ',' << v.z() << ','
        << std::sqrt(0.5 * mover.ground_covariance_m2.trace()) << ','
        << std::sqrt(0.5 * mover.velocity_covariance_m2_s2.trace()) << '\n';
  }
}

}  // namespace groundlock::eval
