// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_SENSOR_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_SENSOR_H_

#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

namespace groundlock::simulator {

// What a camera does to the light: corner shading, slow changes of exposure,
// and noise whose variance grows with the signal.
class Sensor {
 public:
  Sensor(cv::Size size_px, std::uint64_t seed, int threads);

  // rendered  CV_32FC3, display values. Returns CV_8UC3. The same frame index
  // gives the same noise; t_s drives the exposure.
  cv::Mat Expose(const cv::Mat& rendered, int frame, double t_s) const;

 private:
  std::uint64_t seed_;
  int threads_;
  cv::Mat vignette_;           // CV_32F
  std::vector<float> normal_;  // a table of normal deviates
};

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_SENSOR_H_
