// SPDX-License-Identifier: Apache-2.0
// Brushes that the painters share. Positions in pixels, drawn anti-aliased at
// fractions of a pixel.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_BRUSH_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_BRUSH_H_

#include <opencv2/core.hpp>
#include <string>

namespace groundlock::simulator {

// Fractional bits of OpenCV's drawing functions.
inline constexpr int kShift = 4;

// For the drawing functions that take kShift.
cv::Point Fixed(double x, double y);
// Each channel in [low, high), drawn half-way to grey: paint outdoors is dull.
cv::Scalar RandomColor(cv::RNG& rng, int low, int high);
cv::Scalar Shaded(const cv::Scalar& color, double factor);
// Two to five capital letters and digits.
std::string RandomWord(cv::RNG& rng);
void Ellipse(cv::Mat& image,
             const cv::Point2d& center,
             double long_px,
             double short_px,
             double angle_deg,
             const cv::Scalar& color);
// A random star-shaped polygon.
void Polygon(cv::Mat& image,
             cv::RNG& rng,
             const cv::Point2d& center,
             double radius_px,
             int corners,
             const cv::Scalar& color);
// image *= 1 + gain * noise, per pixel.
void Modulate(cv::Mat& image, const cv::Mat& noise, float gain);
void Text(cv::Mat& image,
          cv::RNG& rng,
          const std::string& text,
          const cv::Point& at,
          double height_px,
          const cv::Scalar& color);
void PaintCracks(cv::Mat& image, cv::RNG& rng, int count, double px_per_m);

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_BRUSH_H_
