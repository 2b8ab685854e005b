// SPDX-License-Identifier: Apache-2.0
// Images of a textured target before a textured background, for tests of 2D
// trackers.
#ifndef GROUNDLOCK_TESTS_SUPPORT_DRAWN_SCENE_H_
#define GROUNDLOCK_TESTS_SUPPORT_DRAWN_SCENE_H_

#include <cstdint>
#include <opencv2/core/mat.hpp>

namespace groundlock::test_support {

// Smooth random colours: a texture that can be moved by parts of a pixel.
cv::Mat Texture(int width, int height, std::uint64_t seed, double blur_px);

// The background with the target's texture pasted such that the target's box
// has its corner at (x, y). A pixel at the target's rim is left out, the same
// in all images.
cv::Mat Scene(const cv::Mat& background,
              const cv::Mat& target,
              double x,
              double y);

// The image moved by parts of a pixel (1/32), edges replicated.
cv::Mat Moved(const cv::Mat& image, double x, double y);

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_DRAWN_SCENE_H_
