// SPDX-License-Identifier: Apache-2.0
// Draws what the tracker found over a frame, in the look of the thesis
// (Robinson 2014, §3.8): matched features purple, the target's 2D box, a green
// dot at the reprojected centre of its 3D box, a blue confidence bar along the
// bottom of the 2D box, the 3D box in yellow with its front face green. Added:
// boxes that are predicted rather than seen are dashed, the way of the target
// on the ground, what else moves with its speed, and states and times in words.
#ifndef GROUNDLOCK_CLIENT_CLI_OVERLAY_H_
#define GROUNDLOCK_CLIENT_CLI_OVERLAY_H_

#include <Eigen/Core>
#include <cstddef>
#include <deque>
#include <map>
#include <opencv2/core.hpp>
#include <string>

#include "client/sdk/types.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::cli {

// BGR, as OpenCV stores them.
struct OverlayColours {
  cv::Scalar match{211, 0, 148};          // purple
  cv::Scalar seen_box{255, 255, 255};     // white
  cv::Scalar predicted_box{0, 140, 255};  // orange, and dashed
  cv::Scalar box_world{0, 255, 255};      // yellow
  cv::Scalar front_face{0, 200, 0};       // green
  cv::Scalar center{0, 255, 0};           // green
  cv::Scalar confidence{255, 64, 0};      // blue
  cv::Scalar trail{255, 200, 80};         // light blue where seen
  cv::Scalar mover{255, 128, 255};        // pink, thin and dashed
};

// Where each target has been on the ground, as far as it is drawn.
class GroundTrails {
 public:
  explicit GroundTrails(std::size_t max_points = 240) : max_(max_points) {}

  struct Point {
    Eigen::Vector3d p_world;
    bool seen = false;
  };
  void Add(const sdk::FrameResult& result);
  const std::map<std::string, std::deque<Point>>& trails() const {
    return trails_;
  }

 private:
  std::size_t max_;
  std::map<std::string, std::deque<Point>> trails_;
};

// Draws over `bgr` (CV_8UC3, the size of `camera`). World geometry goes through
// the lens model, edges in short pieces, so that they bend as the image does.
// What lies behind the camera or outside the lens model is left out.
//   trails  the results so far, this one included.
void DrawOverlay(const geometry::CameraModel& camera,
                 const sdk::FrameResult& result,
                 const GroundTrails& trails,
                 const OverlayColours& colours,
                 cv::Mat& bgr);

// A frame without a result: darkened, with the reason.
void DrawNoResult(const std::string& reason, cv::Mat& bgr);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_OVERLAY_H_
