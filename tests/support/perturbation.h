// SPDX-License-Identifier: Apache-2.0
// What a test's outcome must not depend on, changed from outside: with
// GROUNDLOCK_PERTURBATION=N (1, 2, ...; tests/perturb.py) images get noise of a
// grey level and generators other seeds; without it, nothing is changed. Noise
// in the last digits of what is reckoned follows from that in the pixels. (The
// processor's direction of rounding is no way to it: OpenCV's SIFT rounds to
// indices by it, and writes beyond its memory where that is up.)
#ifndef GROUNDLOCK_TESTS_SUPPORT_PERTURBATION_H_
#define GROUNDLOCK_TESTS_SUPPORT_PERTURBATION_H_

#include <cstdint>
#include <opencv2/core.hpp>

namespace groundlock::test_support {

// The image (8 bits), each of its values off by -1, 0 or 1.
cv::Mat WithNoise(const cv::Mat& image, cv::RNG& generator);

// The image (8 bits), or one each of whose values is off by -1, 0 or 1; another
// call draws other noise. Thread-safe.
cv::Mat Perturbed(const cv::Mat& image);

// What is asserted of what noise decides about: of the images as they are, or
// what was measured to hold with noise. Thread-safe.
double Bound(double as_is, double perturbed);

// `seed`, or another one. Thread-safe.
std::uint64_t PerturbedSeed(std::uint64_t seed);

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_PERTURBATION_H_
