// SPDX-License-Identifier: Apache-2.0
#include "client/cli/evaluation_stills.h"

#include <algorithm>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "client/cli/evaluate/scores.h"

namespace groundlock::cli {

std::unordered_map<std::uint64_t, std::string> StillFrames(
    const std::vector<TruthRow>& truth,
    std::uint64_t first,
    std::uint64_t last) {
  std::unordered_map<std::uint64_t, std::string> frames;
  frames[last] = "the last";
  std::optional<std::uint64_t> hidden, seen_again;
  std::uint64_t hidden_to = 0;
  for (const TruthRow& row : truth) {
    if (row.frame < first || row.frame > last || !row.target_world) continue;
    if (row.seen_fraction < kHiddenFraction) {
      if (!hidden) hidden = row.frame;
      if (!seen_again) hidden_to = row.frame;
    } else if (hidden && !seen_again && row.seen_fraction > kSeenFraction) {
      seen_again = row.frame;
    }
  }
  if (hidden) {
    frames[(*hidden + hidden_to) / 2] = "out of sight";
    if (seen_again) {
      frames[std::min(last, *seen_again + 12)] =
          "half a second after it is seen again";
    }
  } else {
    frames[(first + last) / 2] = "half way";
  }
  frames[first] = "the first with the target";
  return frames;
}

std::string DrawStill(const geometry::CameraModel& camera,
                      const sdk::FrameResult& result,
                      const GroundTrails& trails,
                      const TruthRow& truth,
                      const cv::Mat& picture) {
  constexpr int kWidth = 640, kZoom = 3, kQuality = 80;
  cv::Mat bgr = picture.clone();
  DrawOverlay(camera, result, trails, OverlayColours{}, bgr);
  std::optional<Eigen::Vector2d> center;
  if (truth.target_world) {
    const Eigen::Vector3d p_camera =
        truth.world_from_camera.Inverse() * *truth.target_world;
    if (p_camera.z() > 0.1) center = camera.ImageFromCamera(p_camera);
  }
  const cv::Size inset(bgr.cols / 3, bgr.rows / 3);
  const cv::Rect image({}, bgr.size());
  const bool is_small =
      truth.visible_box_px && truth.visible_box_px->width() < inset.width / 2.0;
  if (center && is_small &&
      image.contains(cv::Point(static_cast<int>(center->x()),
                               static_cast<int>(center->y())))) {
    const cv::Size part(inset.width / kZoom, inset.height / kZoom);
    const cv::Rect at(
        std::clamp(static_cast<int>(center->x()) - part.width / 2,
                   0,
                   bgr.cols - part.width),
        std::clamp(static_cast<int>(center->y()) - 2 * part.height / 3,
                   0,
                   bgr.rows - part.height),
        part.width,
        part.height);
    cv::Mat enlarged;
    cv::resize(bgr(at), enlarged, inset, 0, 0, cv::INTER_CUBIC);
    const cv::Rect corner(bgr.cols - inset.width,
                          bgr.rows - inset.height,
                          inset.width,
                          inset.height);
    enlarged.copyTo(bgr(corner));
    cv::rectangle(bgr, corner, cv::Scalar::all(255), 2);
    cv::rectangle(bgr, at, cv::Scalar::all(255), 1);
  }
  cv::Mat small;
  const int height = std::max(1, bgr.rows * kWidth / bgr.cols);
  cv::resize(bgr, small, {kWidth, height}, 0, 0, cv::INTER_AREA);
  std::vector<std::uint8_t> bytes;
  cv::imencode(".jpg", small, bytes, {cv::IMWRITE_JPEG_QUALITY, kQuality});
  return {bytes.begin(), bytes.end()};
}

}  // namespace groundlock::cli
