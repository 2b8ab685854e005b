// SPDX-License-Identifier: Apache-2.0
// Points followed through a video, and where its keyframes show them.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_FEATURE_TRACKS_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_FEATURE_TRACKS_H_

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <opencv2/core.hpp>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::build::internal {

// One sight of a point: in which keyframe (index), and where there; the first
// pixel's centre is (0.5, 0.5).
struct TrackSight {
  std::uint32_t image = 0;
  Eigen::Vector2f pixel_px = Eigen::Vector2f::Zero();
};
// By rising image, at most one sight each.
using FeatureTrack = std::vector<TrackSight>;

struct FeatureTracks {
  int width_px = 0;
  int height_px = 0;
  std::uint32_t num_images = 0;
  // Of the camera, as it wrote it into the video: on film of 36 mm x 24 mm,
  // with the same diagonal angle of view. 0 = it did not.
  double film_focal_mm = 0.0;
  std::vector<FeatureTrack> tracks;  // of two sights and more
};

// Follows corners from frame to frame by pyramidal Lucas-Kanade, there and
// back; a keyframe notes where they are, finds those that it notes already a
// little more exactly against their patch in the keyframe before, and takes up
// new corners where there are none; of points that have come close to each
// other the one goes on that was taken up last. Single frames in between into
// which hardly anything can be followed, e.g. blurred ones, are passed over.
// Deterministic. Not thread-safe. Source: Shi & Tomasi 1994; Bouguet 2001; the
// check by following back: Kalal et al. 2010.
class TrackFollower {
 public:
  // luma: CV_8UC1, all of one size.
  void AddFrame(const cv::Mat& luma, bool is_keyframe);
  FeatureTracks Finish();

 private:
  struct Point {
    cv::Point2f at;         // in the last frame, OpenCV's pixels
    cv::Point2f last_note;  // in the last keyframe
    std::uint32_t track = 0;
  };
  // Those that are seen in the frame.
  std::vector<Point> Followed(const std::vector<cv::Mat>& pyramid) const;
  void Refine(const std::vector<cv::Mat>& pyramid);
  void ThinOut(const cv::Size& size_px);
  void Note();
  void TakeUp(const cv::Mat& luma);

  std::vector<cv::Mat> previous_;  // pyramids, as OpenCV builds them
  std::vector<cv::Mat> last_keyframe_;
  std::vector<Point> points_;
  int num_passed_over_ = 0;  // since the last frame that was followed
  FeatureTracks result_;
};

// To hand tracks from one stage of a build to the next. Reading bounds every
// count by the file's size; kDataLoss names what is wrong.
absl::Status WriteTracks(const FeatureTracks& tracks,
                         const std::filesystem::path& path);
absl::StatusOr<FeatureTracks> ReadTracks(const std::filesystem::path& path);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_FEATURE_TRACKS_H_
