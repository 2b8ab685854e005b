// SPDX-License-Identifier: Apache-2.0
#include "tests/support/perturbation.h"

#include <atomic>
#include <cstdlib>
#include <opencv2/core.hpp>

#include "map_store/base/mix_seed.h"

namespace groundlock::test_support {
namespace {

// Which perturbation; 0: none.
std::uint64_t Number() {
  static const std::uint64_t number = [] {
    const char* const text = std::getenv("GROUNDLOCK_PERTURBATION");
    return text == nullptr ? 0 : std::strtoull(text, nullptr, 10);
  }();
  return number;
}

}  // namespace

cv::Mat WithNoise(const cv::Mat& image, cv::RNG& generator) {
  cv::Mat result(image.size(), image.type());
  generator.fill(result, cv::RNG::UNIFORM, 0, 3);
  cv::add(result, image, result);
  cv::subtract(result, cv::Scalar::all(1), result);
  return result;
}

cv::Mat Perturbed(const cv::Mat& image) {
  if (Number() == 0) return image;
  static std::atomic<std::uint64_t> calls = 0;
  cv::RNG generator(base::MixSeed(Number(), ++calls));
  return WithNoise(image, generator);
}

double Bound(double as_is, double perturbed) {
  return Number() == 0 ? as_is : perturbed;
}

std::uint64_t PerturbedSeed(std::uint64_t seed) {
  return Number() == 0 ? seed : base::MixSeed(seed, Number());
}

}  // namespace groundlock::test_support
