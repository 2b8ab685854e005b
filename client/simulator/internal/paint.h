// SPDX-License-Identifier: Apache-2.0
// Procedural paint: albedo images (CV_8UC3, blue green red, display-encoded)
// with detail at every scale and nothing that repeats, so that features match
// without ambiguity.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_PAINT_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_PAINT_H_

#include <opencv2/core.hpp>

namespace groundlock::simulator {

// Sum of octaves of smooth noise, about [-1, 1], CV_32F. The first octave has
// `cells` cells along the longer side; each further one twice as many.
cv::Mat Noise(cv::RNG& rng, cv::Size size, int cells, int octaves, float decay);

// Asphalt, gravel and concrete with stains, cracks, leaves, pebbles and painted
// lines. Square, `side_px` for `side_m`.
cv::Mat PaintGround(cv::RNG& rng, int side_px, float side_m);

enum class Facade { kBrick, kPlaster, kBlocks, kPlanks };
// A wall with windows, doors, posters and pipes.
cv::Mat PaintFacade(cv::RNG& rng, Facade style, cv::Size size, float px_per_m);

enum class Prop { kCrate, kPoster, kMetal, kStone, kBarrel };
// One face of a prop in its own main colour.
cv::Mat PaintProp(cv::RNG& rng,
                  Prop style,
                  cv::Size size,
                  float px_per_m,
                  const cv::Scalar& color_bgr);

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_PAINT_H_
