// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/brush.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

namespace groundlock::simulator {

cv::Point Fixed(double x, double y) {
  return {cvRound(x * (1 << kShift)), cvRound(y * (1 << kShift))};
}

cv::Scalar RandomColor(cv::RNG& rng, int low, int high) {
  constexpr double kGrey = 0.4;
  std::array<double, 3> channels{};
  for (double& channel : channels) channel = rng.uniform(low, high);
  const double mean = (channels[0] + channels[1] + channels[2]) / 3.0;
  for (double& channel : channels) channel += kGrey * (mean - channel);
  return {channels[0], channels[1], channels[2]};
}

cv::Scalar Shaded(const cv::Scalar& color, double factor) {
  return {color[0] * factor, color[1] * factor, color[2] * factor};
}

std::string RandomWord(cv::RNG& rng) {
  static constexpr char kLetters[] = "ABCDEFGHKLMNOPRSTUVXYZ23456789";
  std::string word;
  const int length = rng.uniform(2, 6);
  for (int i = 0; i < length; ++i) {
    word += kLetters[rng.uniform(0, static_cast<int>(sizeof(kLetters)) - 1)];
  }
  return word;
}

void Ellipse(cv::Mat& image,
             const cv::Point2d& center,
             double long_px,
             double short_px,
             double angle_deg,
             const cv::Scalar& color) {
  cv::ellipse(image,
              Fixed(center.x, center.y),
              Fixed(long_px, short_px),
              angle_deg,
              0,
              360,
              color,
              cv::FILLED,
              cv::LINE_AA,
              kShift);
}

void Polygon(cv::Mat& image,
             cv::RNG& rng,
             const cv::Point2d& center,
             double radius_px,
             int corners,
             const cv::Scalar& color) {
  std::vector<cv::Point> points;
  for (int i = 0; i < corners; ++i) {
    const double angle = CV_2PI * (i + rng.uniform(-0.35, 0.35)) / corners;
    const double r = radius_px * rng.uniform(0.5, 1.0);
    points.push_back(
        Fixed(center.x + r * std::cos(angle), center.y + r * std::sin(angle)));
  }
  cv::fillPoly(image,
               std::vector<std::vector<cv::Point>>{points},
               color,
               cv::LINE_AA,
               kShift);
}

void Modulate(cv::Mat& image, const cv::Mat& noise, float gain) {
  image.forEach<cv::Vec3b>([&](cv::Vec3b& pixel, const int* at) {
    const float factor = 1.0F + gain * noise.at<float>(at[0], at[1]);
    for (int c = 0; c < 3; ++c) {
      pixel[c] =
          cv::saturate_cast<uchar>(static_cast<float>(pixel[c]) * factor);
    }
  });
}

void Text(cv::Mat& image,
          cv::RNG& rng,
          const std::string& text,
          const cv::Point& at,
          double height_px,
          const cv::Scalar& color) {
  constexpr double kLetterHeight_px = 22.0;  // Hershey fonts at scale 1
  const std::array<int, 4> fonts = {cv::FONT_HERSHEY_SIMPLEX,
                                    cv::FONT_HERSHEY_DUPLEX,
                                    cv::FONT_HERSHEY_TRIPLEX,
                                    cv::FONT_HERSHEY_COMPLEX};
  const double scale = height_px / kLetterHeight_px;
  cv::putText(image,
              text,
              at,
              fonts[rng.uniform(0, 4)],
              scale,
              color,
              std::max(1, cvRound(scale * rng.uniform(1.5, 4.0))),
              cv::LINE_AA);
}

void PaintCracks(cv::Mat& image, cv::RNG& rng, int count, double px_per_m) {
  for (int i = 0; i < count; ++i) {
    cv::Point2d at(rng.uniform(0.0, 1.0) * image.cols,
                   rng.uniform(0.0, 1.0) * image.rows);
    double angle = rng.uniform(0.0, CV_2PI);
    const int steps = rng.uniform(10, 60);
    for (int s = 0; s < steps; ++s) {
      angle += rng.uniform(-0.6, 0.6);
      const double step = px_per_m * rng.uniform(0.03, 0.09);
      const cv::Point2d next(at.x + step * std::cos(angle),
                             at.y + step * std::sin(angle));
      cv::line(image,
               Fixed(at.x, at.y),
               Fixed(next.x, next.y),
               cv::Scalar::all(rng.uniform(30, 55)),
               rng.uniform(1, 3),
               cv::LINE_AA,
               kShift);
      at = next;
    }
  }
}

}  // namespace groundlock::simulator
