// SPDX-License-Identifier: Apache-2.0
// Where in the whole image something has a target's colours.
#ifndef GROUNDLOCK_SERVER_TRACKING_LIKELY_PLACES_H_
#define GROUNDLOCK_SERVER_TRACKING_LIKELY_PLACES_H_

#include <Eigen/Core>
#include <cstddef>
#include <functional>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/box.h"

namespace groundlock::tracking {

// How probably each pixel of a halved image is the target's, summed so that
// boxes are quickly told. Thread-safe as a constant.
class ColourMap {
 public:
  //   probability  CV_32F, of an image whose pixels are `scale` times those of
  //     the whole one, e.g. 0.125.
  ColourMap(const cv::Mat& probability, double scale);

  // By how much likelier the pixels in the box are the target's than those
  // around it, of which there are three times as many, times the root of their
  // number: of so many times more pixels chance tells so much less. Boxes of
  // the whole image, of finite edges; what lies outside of that is unlikely.
  double Excess(const geometry::Box2& box_px) const;

 private:
  // Of a box of the halved image, clipped to it.
  double Sum(const geometry::Box2& box) const;

  cv::Mat integral_;  // CV_64F
  double scale_;
};

// How large the target would look about a pixel; nullopt: it is not there.
using BoxAt =
    std::function<std::optional<geometry::Box2>(const Eigen::Vector2d&)>;

// Of the places, each with what is about it to a third of a step, those whose
// boxes stand out most by their colours, the likeliest first: at most `most`,
// and none that has its centre in the box of a likelier one.
//   step_of  the grid's, where the target looks like that box.
std::vector<Eigen::Vector2d> LikelyPlaces(
    const ColourMap& colours,
    std::span<const Eigen::Vector2d> places_px,
    const BoxAt& box_at,
    const std::function<Eigen::Vector2d(const geometry::Box2&)>& step_of,
    std::size_t most);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_LIKELY_PLACES_H_
