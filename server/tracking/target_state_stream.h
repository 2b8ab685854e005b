// SPDX-License-Identifier: Apache-2.0
// The message in which the targets of a session are carried (session_targets.h)
// as bytes (map_store/base/state_stream.h) in which an image lies once, where
// it is named first: its number (2 bytes), which is that of images before it,
// then 2 + 2 bytes width and height, one for its channels, and its pixels, row
// by row. Later on its number stands for it; 65,535 for none.
#ifndef GROUNDLOCK_SERVER_TRACKING_TARGET_STATE_STREAM_H_
#define GROUNDLOCK_SERVER_TRACKING_TARGET_STATE_STREAM_H_

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <string_view>
#include <utility>
#include <vector>

#include "map_store/base/state_stream.h"
#include "server/ground/ground_surface.h"
#include "server/image/luma_pyramid.h"
#include "server/tracking/tracking_session.h"

namespace groundlock::tracking {

// Not thread-safe.
class TargetStateWriter : public base::StateWriter {
 public:
  // CV_8UC1 or CV_8UC3, or empty.
  void WriteImage(const cv::Mat& image);
  // Of an image that others have shared memory with: none.
  void WritePixels(const cv::Mat& image);

 private:
  std::vector<cv::Mat> images_;
};

// Not thread-safe. What it is given outlives it.
class TargetStateReader : public base::StateReader {
 public:
  //   options, ground  those of the session that reads.
  TargetStateReader(std::string_view message,
                    const SessionOptions& options,
                    std::shared_ptr<const ground::GroundSurface> ground)
      : StateReader(message), options_(options), ground_(std::move(ground)) {}

  const SessionOptions& options() const { return options_; }
  const std::shared_ptr<const ground::GroundSurface>& ground() const {
    return ground_;
  }
  // The time of the session's last frame: nothing is known of a later one.
  std::chrono::nanoseconds last_time() const { return last_time_; }
  void set_last_time(std::chrono::nanoseconds time) { last_time_ = time; }

  // Empty where none was written. Fails if it is of another type.
  cv::Mat ReadImage(int type);
  // Of such an image of CV_8UC1, the same for all who name it; or null.
  std::shared_ptr<const image::LumaPyramid> ReadPyramid();
  // As WritePixels wrote them.
  cv::Mat ReadPixels(cv::Size size, int type);

 private:
  struct Image {
    cv::Mat pixels;
    std::shared_ptr<const image::LumaPyramid> pyramid;  // once asked for
  };
  // Null where none was written, or it fails.
  Image* ReadNumbered(int type);

  const SessionOptions& options_;
  std::shared_ptr<const ground::GroundSurface> ground_;
  std::chrono::nanoseconds last_time_{0};
  std::vector<Image> images_;
};

// An image that fields may share; empty: none.
template <typename Stream, base::StateOf<cv::Mat> T>
void ImageField(Stream& stream, std::string_view field, T& image, int type) {
  stream.Enter(field);
  if constexpr (Stream::kReads) {
    image = stream.ReadImage(type);
  } else {
    stream.WriteImage(image);
  }
}

// The same with what was made of it, which is made again; null: none.
template <typename Stream,
          base::StateOf<std::shared_ptr<const image::LumaPyramid>> T>
void PyramidField(Stream& stream, std::string_view field, T& pyramid) {
  stream.Enter(field);
  if constexpr (Stream::kReads) {
    pyramid = stream.ReadPyramid();
  } else {
    stream.WriteImage(pyramid != nullptr ? pyramid->levels.front() : cv::Mat());
  }
}

// When something was: not after the session's last frame.
template <typename Stream, base::StateOf<std::chrono::nanoseconds> T>
void Moment(Stream& stream, std::string_view field, T& time) {
  Field(stream, field, time);
  if constexpr (Stream::kReads) {
    if (time > stream.last_time()) stream.Fail("is to come");
  }
}

template <typename Stream, typename T>
void Bounded(
    Stream& stream, std::string_view field, T& number, T least, T most) {
  Field(stream, field, number);
  if (!(number >= least && number <= most)) stream.Fail("is out of bounds");
}
template <typename Stream, typename T>
void Bounded(Stream& stream,
             std::string_view field,
             const T& number,
             T /*least*/,
             T /*most*/) {
  Field(stream, field, number);
}

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_TARGET_STATE_STREAM_H_
