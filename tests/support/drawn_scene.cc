// SPDX-License-Identifier: Apache-2.0
#include "tests/support/drawn_scene.h"

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "tests/support/perturbation.h"

namespace groundlock::test_support {

cv::Mat Texture(int width, int height, std::uint64_t seed, double blur_px) {
  cv::Mat noise(height, width, CV_8UC3);
  cv::RNG rng(seed);
  rng.fill(noise, cv::RNG::UNIFORM, 0, 256);
  cv::Mat smooth;
  cv::GaussianBlur(noise, smooth, {}, blur_px);
  cv::normalize(smooth, smooth, 0, 255, cv::NORM_MINMAX);
  return smooth;
}

cv::Mat Scene(const cv::Mat& background,
              const cv::Mat& target,
              double x,
              double y) {
  cv::Mat image = background.clone();
  cv::warpAffine(target,
                 image,
                 cv::Matx23d(1, 0, x, 0, 1, y),
                 image.size(),
                 cv::INTER_CUBIC,
                 cv::BORDER_TRANSPARENT);
  return Perturbed(image);
}

cv::Mat Moved(const cv::Mat& image, double x, double y) {
  cv::Mat moved;
  cv::warpAffine(image,
                 moved,
                 cv::Matx23d(1, 0, x, 0, 1, y),
                 image.size(),
                 cv::INTER_CUBIC,
                 cv::BORDER_REPLICATE);
  return Perturbed(moved);
}

}  // namespace groundlock::test_support
