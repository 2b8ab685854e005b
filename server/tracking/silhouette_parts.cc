// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/silhouette_parts.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "server/tracking/picture_difference.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// Parts of a silhouette: half of each is where the body is expected, but for a
// rim. Those no farther apart than so much of the side are one.
constexpr double kPartRim = 0.25;
constexpr double kSamePart = 0.06;
// What may be the body beside what surely is, in a smaller share of its rows or
// columns than this, is the shade under it.
constexpr double kFewRows = 0.3;
// So much of the silhouette's box differs.
constexpr double kFilled = 0.3;
// A part is looked at from so much of the expected box on.
constexpr double kLeastPart = 0.05;
// From so much of an expected box on that lies beside a silhouette, and of
// which so much shows the ground, the body is not there. Neither was measured
// apart from the runs in docs/method.md.
constexpr double kLeastBeside = 0.4;
constexpr double kShowsGround = 0.75;

// Those pixels, without what is thinner than two of them: an opening.
cv::Mat_<std::uint8_t> Opened(const GroundLabels& labels,
                              std::initializer_list<GroundLabel> those) {
  cv::Mat_<std::uint8_t> mask(labels.size(), 0);
  const auto is_in = [&](int y, int x) {
    return std::find(those.begin(), those.end(), labels(y, x)) != those.end();
  };
  for (int y = 0; y + 1 < labels.rows; ++y) {
    for (int x = 0; x + 1 < labels.cols; ++x) {
      if (is_in(y, x) && is_in(y, x + 1) && is_in(y + 1, x) &&
          is_in(y + 1, x + 1)) {
        mask(cv::Rect(x, y, 2, 2)) = 1;
      }
    }
  }
  return mask;
}

// Parts of a mask are one, if they are as near each other as parts of a body.
struct Parts {
  cv::Mat_<int> numbers;  // of each pixel of the mask
  int count = 0;
};
Parts PartsOf(const cv::Mat_<std::uint8_t>& mask, const Box2& expected) {
  const int reach = std::max(
      1, static_cast<int>(0.5 * kSamePart * std::sqrt(expected.Area())));
  cv::Mat_<std::uint8_t> joined;
  cv::dilate(
      mask, joined, cv::Mat::ones(2 * reach + 1, 2 * reach + 1, CV_8UC1));
  Parts parts;
  parts.count = cv::connectedComponents(joined, parts.numbers);
  return parts;
}

// Of those parts of a mask that are not where the body is expected, nothing is
// left. Returns the box about the others.
cv::Rect KeepExpected(const Box2& expected, cv::Mat_<std::uint8_t>& mask) {
  const Parts parts = PartsOf(mask, expected);
  const Box2 about = EnlargedTimes(expected, 1.0 + 2.0 * kPartRim);
  std::vector<int> inside(parts.count, 0);  // less what is outside
  const auto each = [&](const auto& look) {
    for (int y = 0; y < mask.rows; ++y) {
      for (int x = 0; x < mask.cols; ++x) {
        if (mask(y, x) != 0) look(y, x, inside[parts.numbers(y, x)]);
      }
    }
  };
  each([&](int y, int x, int& part) {
    part += about.Contains(CenterOfPixel(x, y)) ? 1 : -1;
  });
  cv::Rect box;
  each([&](int y, int x, int part) {
    if (part > 0) {
      box |= cv::Rect(x, y, 1, 1);
    } else {
      mask(y, x) = 0;
    }
  });
  return box;
}

// Those parts of a mask that have pixels of another one.
cv::Mat_<std::uint8_t> PartsWith(const cv::Mat_<std::uint8_t>& pixels,
                                 const cv::Mat_<std::uint8_t>& mask) {
  cv::Mat_<int> numbers;
  const int count = cv::connectedComponents(mask, numbers);
  std::vector<bool> belongs(count, false);
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) {
      if (pixels(y, x) != 0) belongs[numbers(y, x)] = true;
    }
  }
  belongs[0] = false;
  cv::Mat_<std::uint8_t> parts(mask.size(), 0);
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) {
      if (belongs[numbers(y, x)]) parts(y, x) = 1;
    }
  }
  return parts;
}

// How far to the left a mask reaches in the rows of a box, but for those few
// in which it reaches farther; the box's edge if it does not reach that.
int LeftOf(const cv::Mat_<std::uint8_t>& mask, const cv::Rect& box) {
  std::vector<int> first(box.height);
  for (int i = 0; i < box.height; ++i) {
    const std::uint8_t* row = mask[box.y + i];
    first[i] = static_cast<int>(std::find(row, row + box.x, 1) - row);
  }
  const auto few = first.begin() + static_cast<int>(kFewRows * box.height);
  std::nth_element(first.begin(), few, first.end());
  return *few;
}

// The same on all sides.
cv::Rect ReachOf(const cv::Mat_<std::uint8_t>& mask, const cv::Rect& box) {
  const auto right_of = [](const cv::Mat_<std::uint8_t>& of, cv::Rect in) {
    cv::Mat_<std::uint8_t> flipped;
    cv::flip(of, flipped, 1);
    in.x = of.cols - in.br().x;
    return of.cols - LeftOf(flipped, in);
  };
  const cv::Mat_<std::uint8_t> across = mask.t();
  const cv::Rect box_across(box.y, box.x, box.height, box.width);
  return {cv::Point(LeftOf(mask, box), LeftOf(across, box_across)),
          cv::Point(right_of(mask, box), right_of(across, box_across))};
}

}  // namespace

std::optional<PixelSilhouette> FindSilhouette(const GroundLabels& labels,
                                              const Box2& expected) {
  cv::Mat_<std::uint8_t> body = Opened(labels, {kBody});
  const cv::Rect sure = KeepExpected(expected, body);
  if (sure.empty()) return std::nullopt;
  if (cv::countNonZero(body) < kFilled * sure.area()) return std::nullopt;
  const cv::Mat_<std::uint8_t> possible =
      PartsWith(body, Opened(labels, {kBody, kEither, kUnknown}));
  return PixelSilhouette{sure, ReachOf(possible, sure)};
}

std::optional<Eigen::Vector2d> MiddleOfNextPart(const GroundLabels& labels,
                                                const Box2& expected) {
  const cv::Mat_<std::uint8_t> body = Opened(labels, {kBody});
  struct Part {
    int pixels = 0;
    int inside = 0;
    cv::Rect box;
  };
  const Parts numbered = PartsOf(body, expected);
  std::vector<Part> parts(numbered.count);
  for (int y = 0; y < body.rows; ++y) {
    for (int x = 0; x < body.cols; ++x) {
      if (body(y, x) == 0) continue;
      Part& part = parts[numbered.numbers(y, x)];
      ++part.pixels;
      part.inside += expected.Contains(CenterOfPixel(x, y)) ? 1 : 0;
      part.box |= cv::Rect(x, y, 1, 1);
    }
  }
  const auto largest = std::max_element(
      parts.begin(), parts.end(), [](const Part& a, const Part& b) {
        return a.pixels < b.pixels;
      });
  if (largest->pixels < kLeastPart * expected.Area() || largest->inside == 0) {
    return std::nullopt;
  }
  return Eigen::Vector2d(largest->box.x + 0.5 * largest->box.width,
                         largest->box.y + 0.5 * largest->box.height);
}

bool IsGroundBeside(const GroundLabels& labels,
                    const Box2& expected,
                    const Box2& seen) {
  int beside = 0;
  int ground = 0;
  int all = 0;
  for (int y = 0; y < labels.rows; ++y) {
    for (int x = 0; x < labels.cols; ++x) {
      const Eigen::Vector2d middle = CenterOfPixel(x, y);
      if (!expected.Contains(middle)) continue;
      ++all;
      if (seen.Contains(middle)) continue;
      ++beside;
      ground += labels(y, x) == kGround ? 1 : 0;
    }
  }
  return beside > kLeastBeside * all && ground > kShowsGround * beside;
}

}  // namespace groundlock::tracking
