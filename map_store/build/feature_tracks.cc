// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/feature_tracks.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::build::internal {
namespace {

const cv::Size kWindow_px(15, 15);
constexpr int kLevels = 4;
// What following there and back may differ by: three times the noise of a
// corner's place (0.2 px, measured on the residuals of adjusted maps).
constexpr float kMaxReturn_px = 0.6F;
// A corner per cell of that many along the image's longer side.
constexpr int kCells = 48;
// Points nearer to each other than this share of a cell are too many.
constexpr double kCrowded = 0.7;
constexpr double kCornerQuality = 0.003;  // of the best corner's
// Beyond this the noted place and the one against the last keyframe are not the
// same feature.
constexpr float kMaxRefinement_px = 2.0F;
// A frame into which fewer than this share of the points can be followed, where
// nine in ten are usual, is blurred or covered; the next may show them again.
// So many in a row are passed over.
constexpr double kBreak = 0.5;
constexpr int kMaxPassedOver = 3;
constexpr std::uint64_t kMaxTrackFileBytes = std::uint64_t{1} << 30;

std::vector<cv::Mat> Pyramid(const cv::Mat& luma) {
  std::vector<cv::Mat> pyramid;
  cv::buildOpticalFlowPyramid(luma, pyramid, kWindow_px, kLevels);
  return pyramid;
}

void FollowPoints(const std::vector<cv::Mat>& from,
                  const std::vector<cv::Mat>& to,
                  const std::vector<cv::Point2f>& points,
                  int levels,
                  std::vector<cv::Point2f>& there,
                  std::vector<unsigned char>& found) {
  std::vector<float> error;
  cv::calcOpticalFlowPyrLK(
      from,
      to,
      points,
      there,
      found,
      error,
      kWindow_px,
      levels,
      cv::TermCriteria(
          cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 20, 0.01),
      cv::OPTFLOW_USE_INITIAL_FLOW);
}

bool IsNear(const cv::Point2f& a, const cv::Point2f& b, float limit_px) {
  const cv::Point2f d = a - b;
  return d.dot(d) <= limit_px * limit_px;
}

template <typename T>
void Append(const T& value, std::string& out) {
  out.append(reinterpret_cast<const char*>(&value), sizeof(T));
}

}  // namespace

void TrackFollower::AddFrame(const cv::Mat& luma, bool is_keyframe) {
  std::vector<cv::Mat> pyramid = Pyramid(luma);
  if (!points_.empty()) {
    std::vector<Point> followed = Followed(pyramid);
    if (!is_keyframe && num_passed_over_ < kMaxPassedOver &&
        static_cast<double>(followed.size()) <
            kBreak * static_cast<double>(points_.size())) {
      ++num_passed_over_;
      return;
    }
    points_ = std::move(followed);
  }
  num_passed_over_ = 0;
  if (is_keyframe) {
    result_.width_px = luma.cols;
    result_.height_px = luma.rows;
    if (!last_keyframe_.empty()) Refine(pyramid);
    ThinOut(luma.size());
    Note();
    TakeUp(luma);
    ++result_.num_images;
    last_keyframe_ = pyramid;
  }
  previous_ = std::move(pyramid);
}

std::vector<TrackFollower::Point> TrackFollower::Followed(
    const std::vector<cv::Mat>& pyramid) const {
  std::vector<cv::Point2f> from;
  for (const Point& point : points_) from.push_back(point.at);
  std::vector<cv::Point2f> there = from;
  std::vector<unsigned char> found;
  FollowPoints(previous_, pyramid, from, kLevels, there, found);
  std::vector<cv::Point2f> back = from;
  std::vector<unsigned char> found_back;
  FollowPoints(pyramid, previous_, there, 1, back, found_back);
  std::vector<Point> followed;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    if (found[i] == 0 || found_back[i] == 0 ||
        !IsNear(back[i], from[i], kMaxReturn_px)) {
      continue;
    }
    followed.push_back(points_[i]);
    followed.back().at = there[i];
  }
  return followed;
}

// Steps from frame to frame add up their errors; one step from the keyframe
// before does not.
void TrackFollower::Refine(const std::vector<cv::Mat>& pyramid) {
  std::vector<cv::Point2f> from;
  std::vector<cv::Point2f> there;
  for (const Point& point : points_) {
    from.push_back(point.last_note);
    there.push_back(point.at);
  }
  if (from.empty()) return;
  std::vector<unsigned char> found;
  FollowPoints(last_keyframe_, pyramid, from, 0, there, found);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const bool agrees =
        found[i] != 0 && IsNear(there[i], points_[i].at, kMaxRefinement_px);
    points_[kept] = points_[i];
    if (agrees) points_[kept].at = there[i];
    ++kept;
  }
  points_.resize(kept);
}

// A camera that flies backwards leaves nothing behind: all that it ever saw
// comes together in the middle, ever smaller, until many points follow the same
// few pixels. The one taken up last was seen at nearly the present size.
void TrackFollower::ThinOut(const cv::Size& size_px) {
  const int radius_px = static_cast<int>(
      std::lround(kCrowded * std::max(size_px.width, size_px.height) / kCells));
  cv::Mat is_free(size_px, CV_8UC1, cv::Scalar(255));
  std::vector<Point> kept;
  for (auto point = points_.rbegin(); point != points_.rend(); ++point) {
    const cv::Point at(std::clamp(cvRound(point->at.x), 0, size_px.width - 1),
                       std::clamp(cvRound(point->at.y), 0, size_px.height - 1));
    if (is_free.at<unsigned char>(at) == 0) continue;
    cv::circle(is_free, at, radius_px, cv::Scalar(0), cv::FILLED);
    kept.push_back(*point);
  }
  std::reverse(kept.begin(), kept.end());
  points_ = std::move(kept);
}

void TrackFollower::Note() {
  for (Point& point : points_) {
    point.last_note = point.at;
    result_.tracks[point.track].push_back(
        {result_.num_images,
         Eigen::Vector2f(point.at.x + 0.5F, point.at.y + 0.5F)});
  }
}

void TrackFollower::TakeUp(const cv::Mat& luma) {
  const double cell_px =
      static_cast<double>(std::max(luma.cols, luma.rows)) / kCells;
  cv::Mat is_free(luma.size(), CV_8UC1, cv::Scalar(255));
  for (const Point& point : points_) {
    cv::circle(is_free,
               point.at,
               static_cast<int>(std::lround(cell_px)),
               cv::Scalar(0),
               cv::FILLED);
  }
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(
      luma, corners, kCells * kCells, kCornerQuality, cell_px, is_free, 5);
  if (corners.empty()) return;
  cv::cornerSubPix(
      luma,
      corners,
      cv::Size(3, 3),
      cv::Size(-1, -1),
      cv::TermCriteria(
          cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 5, 0.05));
  for (const cv::Point2f& corner : corners) {
    const auto track = static_cast<std::uint32_t>(result_.tracks.size());
    result_.tracks.push_back(
        {{result_.num_images,
          Eigen::Vector2f(corner.x + 0.5F, corner.y + 0.5F)}});
    points_.push_back({corner, corner, track});
  }
}

FeatureTracks TrackFollower::Finish() {
  std::erase_if(result_.tracks,
                [](const FeatureTrack& track) { return track.size() < 2; });
  points_.clear();
  return std::exchange(result_, {});
}

absl::Status WriteTracks(const FeatureTracks& tracks,
                         const std::filesystem::path& path) {
  std::string bytes;
  Append(static_cast<std::uint32_t>(tracks.width_px), bytes);
  Append(static_cast<std::uint32_t>(tracks.height_px), bytes);
  Append(tracks.num_images, bytes);
  Append(tracks.film_focal_mm, bytes);
  Append(static_cast<std::uint32_t>(tracks.tracks.size()), bytes);
  for (const FeatureTrack& track : tracks.tracks) {
    Append(static_cast<std::uint32_t>(track.size()), bytes);
    for (const TrackSight& sight : track) {
      Append(sight.image, bytes);
      Append(sight.pixel_px.x(), bytes);
      Append(sight.pixel_px.y(), bytes);
    }
  }
  return base::WriteFileAtomically(path, bytes);
}

absl::StatusOr<FeatureTracks> ReadTracks(const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string bytes,
                   base::ReadFile(path, kMaxTrackFileBytes));
  std::size_t at = 0;
  const auto damaged = [&path](const char* what) {
    return absl::DataLossError(
        absl::StrCat(path.string(), ": damaged (", what, ")"));
  };
  const auto take = [&](auto& value) {
    if (bytes.size() - at < sizeof(value)) return false;
    std::memcpy(&value, bytes.data() + at, sizeof(value));
    at += sizeof(value);
    return true;
  };
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::uint32_t num_tracks = 0;
  FeatureTracks tracks;
  if (!take(width) || !take(height) || !take(tracks.num_images) ||
      !take(tracks.film_focal_mm) || !take(num_tracks)) {
    return damaged("too short");
  }
  if (!(tracks.film_focal_mm >= 0.0) || !std::isfinite(tracks.film_focal_mm)) {
    return damaged("the focal length");
  }
  constexpr std::uint32_t kMaxSize = 65'535;
  if (width == 0 || width > kMaxSize || height == 0 || height > kMaxSize) {
    return damaged("image size");
  }
  tracks.width_px = static_cast<int>(width);
  tracks.height_px = static_cast<int>(height);
  for (std::uint32_t i = 0; i < num_tracks; ++i) {
    std::uint32_t count = 0;
    if (!take(count) || count > (bytes.size() - at) / 12) {
      return damaged("a track's length");
    }
    FeatureTrack& track = tracks.tracks.emplace_back(count);
    for (std::uint32_t k = 0; k < count; ++k) {
      TrackSight& sight = track[k];
      if (!take(sight.image) || !take(sight.pixel_px.x()) ||
          !take(sight.pixel_px.y()) || sight.image >= tracks.num_images ||
          !sight.pixel_px.allFinite() ||
          (k > 0 && sight.image <= track[k - 1].image)) {
        return damaged("a track's sight");
      }
    }
  }
  if (at != bytes.size()) return damaged("bytes behind the end");
  return tracks;
}

}  // namespace groundlock::build::internal
