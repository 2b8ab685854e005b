// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "client/simulator/internal/brush.h"
#include "client/simulator/internal/paint.h"

namespace groundlock::simulator {
namespace {

void PaintLitter(cv::Mat& image, cv::RNG& rng, double px_per_m, double area) {
  const std::array<cv::Scalar, 6> leaves = {cv::Scalar(30, 110, 180),
                                            cv::Scalar(25, 60, 110),
                                            cv::Scalar(40, 150, 190),
                                            cv::Scalar(30, 95, 70),
                                            cv::Scalar(35, 45, 75),
                                            cv::Scalar(60, 170, 160)};
  const int pebbles = cvRound(55 * area);
  for (int i = 0; i < pebbles; ++i) {
    const double size = px_per_m * 0.004 * std::exp(rng.uniform(0.0, 1.5));
    const int level =
        rng.uniform(0, 3) == 0 ? rng.uniform(35, 70) : rng.uniform(120, 215);
    Ellipse(image,
            {rng.uniform(0.0, 1.0) * image.cols,
             rng.uniform(0.0, 1.0) * image.rows},
            size,
            size * rng.uniform(0.5, 1.0),
            rng.uniform(0, 180),
            cv::Scalar(level * 0.94, level * 0.98, level));
  }
  const int count = cvRound(11 * area);
  for (int i = 0; i < count; ++i) {
    const double size = px_per_m * rng.uniform(0.015, 0.05);
    Ellipse(image,
            {rng.uniform(0.0, 1.0) * image.cols,
             rng.uniform(0.0, 1.0) * image.rows},
            size,
            size * rng.uniform(0.3, 0.6),
            rng.uniform(0, 180),
            Shaded(leaves[rng.uniform(0, 6)], rng.uniform(0.7, 1.2)));
  }
}

void PaintMarkings(cv::Mat& image, cv::RNG& rng, double px_per_m) {
  const cv::Scalar white(205, 210, 212);
  for (int i = 0; i < 14; ++i) {  // stripes
    const cv::Point2d at(rng.uniform(0.1, 0.9) * image.cols,
                         rng.uniform(0.1, 0.9) * image.rows);
    const double angle = rng.uniform(0, 2) * CV_PI / 2 + rng.uniform(-0.1, 0.1);
    const double length = px_per_m * rng.uniform(1.0, 4.0);
    cv::line(
        image,
        Fixed(at.x, at.y),
        Fixed(at.x + length * std::cos(angle), at.y + length * std::sin(angle)),
        white,
        cvRound(px_per_m * 0.09),
        cv::LINE_AA,
        kShift);
  }
  for (int i = 0; i < 26; ++i) {  // numbers and letters
    const bool yellow = rng.uniform(0, 3) == 0;
    Text(image,
         rng,
         RandomWord(rng),
         {cvRound(rng.uniform(0.05, 0.9) * image.cols),
          cvRound(rng.uniform(0.05, 0.95) * image.rows)},
         px_per_m * rng.uniform(0.25, 0.6),
         yellow ? cv::Scalar(60, 190, 215) : white);
  }
  for (int i = 0; i < 16; ++i) {  // manhole covers
    const cv::Point2d at(rng.uniform(0.05, 0.95) * image.cols,
                         rng.uniform(0.05, 0.95) * image.rows);
    const double r = px_per_m * rng.uniform(0.2, 0.34);
    Ellipse(image, at, r, r, 0, cv::Scalar(58, 62, 64));
    Ellipse(image, at, r * 0.88, r * 0.88, 0, cv::Scalar(84, 88, 92));
    for (int j = 0; j < 8; ++j) {
      Polygon(image,
              rng,
              {at.x + r * rng.uniform(-0.5, 0.5),
               at.y + r * rng.uniform(-0.5, 0.5)},
              r * 0.2,
              4,
              cv::Scalar::all(rng.uniform(45, 130)));
    }
  }
}

}  // namespace

cv::Mat PaintGround(cv::RNG& rng, int side_px, float side_m) {
  const cv::Size size(side_px, side_px);
  const double px_per_m = side_px / side_m;
  const cv::Mat region = Noise(rng, size, 5, 5, 0.55F);
  const cv::Mat tone = Noise(rng, size, 12, 3, 0.8F);
  cv::Mat ground(size, CV_8UC3);
  ground.forEach<cv::Vec3b>([&](cv::Vec3b& pixel, const int* at) {
    // Asphalt where the region noise is low, sandy gravel where it is high.
    const float r = region.at<float>(at[0], at[1]);
    const float t = std::clamp((r - 0.15F) * 4.0F, 0.0F, 1.0F);
    const float level = 1.0F + 0.13F * tone.at<float>(at[0], at[1]);
    pixel[0] = cv::saturate_cast<uchar>(level * (108.0F + t * 6.0F));
    pixel[1] = cv::saturate_cast<uchar>(level * (110.0F + t * 28.0F));
    pixel[2] = cv::saturate_cast<uchar>(level * (111.0F + t * 44.0F));
  });
  for (int i = 0; i < 60; ++i) {  // repaired patches and stains
    const double level = rng.uniform(60, 135);
    Polygon(ground,
            rng,
            {rng.uniform(0.0, 1.0) * side_px, rng.uniform(0.0, 1.0) * side_px},
            px_per_m * rng.uniform(0.2, 1.2),
            rng.uniform(4, 9),
            cv::Scalar(level, level, level * 1.02));
  }
  PaintMarkings(ground, rng, px_per_m);
  PaintCracks(ground, rng, 150, px_per_m);
  Modulate(ground, Noise(rng, size, 96, 6, 0.85F), 0.34F);
  PaintLitter(ground, rng, px_per_m, side_m * side_m);
  return ground;
}

}  // namespace groundlock::simulator
