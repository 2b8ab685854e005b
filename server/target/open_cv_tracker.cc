// SPDX-License-Identifier: Apache-2.0
#include "server/target/open_cv_tracker.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/tracking.hpp>
#include <opencv2/tracking/tracking_legacy.hpp>
#include <opencv2/video/tracking.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "server/target/internal/input_check.h"

namespace groundlock::target {
namespace {

using geometry::Box2;

constexpr int kAppearanceCells = 24;
constexpr double kAppearanceRate = 0.05;
constexpr double kBelievedCorrelation = 0.5;
// Smaller boxes make some of OpenCV's trackers divide by zero or run forever.
constexpr double kSmallestSidePx = 8.0;
// TLD crashes without room for background around the target.
constexpr double kSmallestCanvasPx = 160.0;

// Reproducible random numbers for the trackers that draw from OpenCV's
// generator of the thread, which others must not notice.
class SeedScope {
 public:
  explicit SeedScope(std::uint64_t seed) : state_(cv::theRNG().state) {
    cv::theRNG().state = seed;
  }
  ~SeedScope() { cv::theRNG().state = state_; }
  SeedScope(const SeedScope&) = delete;
  SeedScope& operator=(const SeedScope&) = delete;

 private:
  std::uint64_t state_;
};

template <typename Tracker>
OpenCvStart StartModern() {
  return [](const cv::Mat& frame, const cv::Rect2d& box) -> OpenCvUpdate {
    const cv::Ptr<Tracker> tracker = Tracker::create();
    cv::Rect rect(box);
    tracker->init(frame, rect);
    return [tracker](const cv::Mat& image, cv::Rect2d& found) {
      cv::Rect result(found);
      if (!tracker->update(image, result)) return false;
      found = result;
      return true;
    };
  };
}

template <typename Tracker>
OpenCvStart StartLegacy() {
  return [](const cv::Mat& frame, const cv::Rect2d& box) -> OpenCvUpdate {
    const cv::Ptr<Tracker> tracker = Tracker::create();
    if (!tracker->init(frame, box)) {
      CV_Error(cv::Error::StsBadArg, "the tracker refused the box");
    }
    return [tracker](const cv::Mat& image, cv::Rect2d& found) {
      return tracker->update(image, found);
    };
  };
}

// Zero mean, unit length; all zero for a patch without contrast.
void Normalise(std::vector<float>& v) {
  double mean = 0.0;
  for (const float value : v) mean += value;
  mean /= static_cast<double>(v.size());
  double energy = 0.0;
  for (float& value : v) {
    value -= static_cast<float>(mean);
    energy += value * value;
  }
  const auto scale =
      static_cast<float>(energy > 1e-6 ? 1.0 / std::sqrt(energy) : 0.0);
  for (float& value : v) value *= scale;
}

double Dot(const std::vector<float>& a, const std::vector<float>& b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

}  // namespace

const std::vector<OpenCvTrackerKind>& OpenCvTrackerKinds() {
  static const std::vector<OpenCvTrackerKind> kinds = {
      {"kcf", StartModern<cv::TrackerKCF>()},
      {"csrt", StartModern<cv::TrackerCSRT>()},
      {"mosse", StartLegacy<cv::legacy::TrackerMOSSE>()},
      {"mil", StartModern<cv::TrackerMIL>()},
      {"tld", StartLegacy<cv::legacy::TrackerTLD>()},
  };
  return kinds;
}

OpenCvTracker::OpenCvTracker(std::string name, OpenCvStart start)
    : name_(std::move(name)),
      start_(std::move(start)),
      sampler_(kAppearanceCells) {}

const cv::Mat& OpenCvTracker::ToCanvas(const cv::Mat& image) {
  const cv::Mat* source = &image;
  if (image.channels() == 1) {
    cv::cvtColor(image, colour_, cv::COLOR_GRAY2BGR);
    source = &colour_;
  }
  if (view_.IsIdentity() && source->size() == canvas_size_) return *source;
  // OpenCV's affine maps take the first pixel's centre as (0, 0).
  const double s = view_.scale;
  const cv::Matx23d canvas_from_image(s,
                                      0,
                                      view_.offset_px.x() + 0.5 * s - 0.5,
                                      0,
                                      s,
                                      view_.offset_px.y() + 0.5 * s - 0.5);
  cv::warpAffine(*source,
                 canvas_,
                 canvas_from_image,
                 canvas_size_,
                 cv::INTER_LINEAR,
                 cv::BORDER_REPLICATE);
  return canvas_;
}

absl::Status OpenCvTracker::Initialize(const cv::Mat& image,
                                       const Box2& box_px) {
  RETURN_IF_ERROR(internal::CheckImage(image));
  RETURN_IF_ERROR(internal::CheckStartBox(image, box_px));
  update_ = nullptr;
  view_ = {};
  frame_ = 0;
  box_px_ = box_px;
  canvas_size_ = {std::max<int>(image.cols, kSmallestCanvasPx),
                  std::max<int>(image.rows, kSmallestCanvasPx)};
  // The part inside the image, grown to the smallest size they can follow.
  const Eigen::Vector2d canvas(canvas_size_.width, canvas_size_.height);
  const Eigen::Vector2d image_size(image.cols, image.rows);
  const Eigen::Vector2d low = box_px.min_px.cwiseMax(0.0);
  const Eigen::Vector2d high = box_px.max_px.cwiseMin(image_size);
  const Eigen::Vector2d size = (high - low).cwiseMax(kSmallestSidePx);
  const Eigen::Vector2d corner =
      (0.5 * (low + high - size)).cwiseMin(canvas - size).cwiseMax(0.0);
  rect_ = {corner.x(), corner.y(), size.x(), size.y()};
  box_center_in_rect_ =
      (box_px.center_px() - corner - 0.5 * size).cwiseQuotient(size);
  box_size_in_rect_ = box_px.size_px().cwiseQuotient(size);
  try {
    const SeedScope seed(base::MixSeed(0, frame_));
    update_ = start_(ToCanvas(image), rect_);
  } catch (const cv::Exception& error) {
    return absl::InvalidArgumentError(
        absl::StrCat(name_, ": cannot start: ", error.what()));
  }
  first_appearance_ = Appearance(image);
  mean_appearance_ = first_appearance_;
  return absl::OkStatus();
}

Box2 OpenCvTracker::BoxFromRect() const {
  const Eigen::Vector2d size(rect_.width, rect_.height);
  const Eigen::Vector2d center(rect_.x, rect_.y);
  const Box2 canvas_box = Box2::FromCenter(
      center + 0.5 * size + box_center_in_rect_.cwiseProduct(size),
      box_size_in_rect_.cwiseProduct(size));
  return {(canvas_box.min_px - view_.offset_px) / view_.scale,
          (canvas_box.max_px - view_.offset_px) / view_.scale};
}

void OpenCvTracker::Place(const Box2& box_px) {
  // Closer than this it is where the tracker has it anyway, and the image can
  // be used as it is.
  constexpr double kSamePlacePx = 0.5;
  constexpr double kSameSize = 0.02;
  if (update_ == nullptr || !internal::IsUsable(box_px)) return;
  const Box2 believed_px = BoxFromRect();
  box_px_ = box_px;
  const double ratio =
      std::sqrt(believed_px.Area() / std::max(1e-6, box_px.Area()));
  const Eigen::Vector2d move = box_px.center_px() - believed_px.center_px();
  if (move.cwiseAbs().maxCoeff() < kSamePlacePx &&
      std::abs(ratio - 1.0) < kSameSize) {
    return;
  }
  // A box far smaller or larger than any target would warp to nothing.
  const double scale = std::clamp(view_.scale * ratio, 1.0 / 64.0, 64.0);
  const Eigen::Vector2d center_canvas =
      view_.scale * believed_px.center_px() + view_.offset_px;
  view_ = {scale, center_canvas - scale * box_px.center_px()};
}

bool OpenCvTracker::Update(const cv::Mat& canvas) {
  try {
    const SeedScope seed(base::MixSeed(0, frame_));
    cv::Rect2d found = rect_;
    if (!update_(canvas, found)) return false;
    if (!std::isfinite(found.x) || !std::isfinite(found.y) ||
        !(found.width >= 1.0) || !(found.height >= 1.0)) {
      return false;
    }
    rect_ = found;
    return true;
  } catch (const cv::Exception&) {
    // They assert on boxes that left the frame; what they have lost, they may
    // find again.
    return false;
  }
}

absl::StatusOr<TargetObservation> OpenCvTracker::Detect(const cv::Mat& image,
                                                        bool fixed_size) {
  if (update_ == nullptr) {
    return absl::FailedPreconditionError(
        absl::StrCat(name_, ": Detect before Initialize"));
  }
  RETURN_IF_ERROR(internal::CheckImage(image));
  ++frame_;
  if (!internal::Touches(image, box_px_))
    return TargetObservation{box_px_, 0.0};
  if (!Update(ToCanvas(image))) return TargetObservation{box_px_, 0.0};
  const Box2 found_px = BoxFromRect();
  if (!internal::IsUsable(found_px)) return TargetObservation{box_px_, 0.0};
  box_px_ = fixed_size
                ? Box2::FromCenter(found_px.center_px(), box_px_.size_px())
                : found_px;
  return TargetObservation{box_px_, Correlate(image)};
}

std::vector<float> OpenCvTracker::Appearance(const cv::Mat& image) {
  sampler_.Sample(image, box_px_);
  std::vector<float> gray(sampler_.plane(0).size());
  for (std::size_t i = 0; i < gray.size(); ++i) {
    gray[i] = 0.299F * sampler_.plane(2)[i] + 0.587F * sampler_.plane(1)[i] +
              0.114F * sampler_.plane(0)[i];
  }
  Normalise(gray);
  return gray;
}

double OpenCvTracker::Correlate(const cv::Mat& image) {
  const std::vector<float> now = Appearance(image);
  const double correlation = std::clamp(
      std::max(Dot(now, first_appearance_), Dot(now, mean_appearance_)),
      0.0,
      1.0);
  if (correlation >= kBelievedCorrelation) {
    for (std::size_t i = 0; i < now.size(); ++i) {
      mean_appearance_[i] +=
          static_cast<float>(kAppearanceRate) * (now[i] - mean_appearance_[i]);
    }
    Normalise(mean_appearance_);
  }
  return correlation;
}

}  // namespace groundlock::target
