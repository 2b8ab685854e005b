// SPDX-License-Identifier: Apache-2.0
// Which colours are the target's and not its surroundings'.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_COLOUR_HISTOGRAM_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_COLOUR_HISTOGRAM_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "map_store/geometry/box.h"
#include "server/target/internal/patch_sampler.h"

namespace groundlock::target::internal {

// Histograms of 16^3 colours of the target and of what is around it; their
// ratio says for a pixel how probably it is the target's. After L. Bertinetto,
// J. Valmadre, S. Golodetz, O. Miksik, P. Torr, "Staple: complementary learners
// for real-time tracking", CVPR 2016, section 3.3. Every second sample of every
// second row is looked at. Keeps its buffers. Not thread-safe.
class ColourHistogram {
 public:
  // `side` samples of a patch, a multiple of 4.
  explicit ColourHistogram(int side);

  // The target of `target_samples` is at the centre of the patch. `rate` 1
  // forgets everything before.
  void Learn(const PatchSampler& sampler,
             const Eigen::Vector2d& target_samples,
             double rate);
  // Reads a patch.
  void Look(const PatchSampler& sampler);
  // Mean probability, in [0, 1], of the inner part of the target's box if its
  // centre lay `shift` samples from the centre of the patch last looked at.
  double Likelihood(const Eigen::Vector2d& shift_samples,
                    const Eigen::Vector2d& target_samples) const;
  // How probably each pixel of a CV_8UC3 image is the target's; CV_32F.
  cv::Mat Probability(const cv::Mat& bgr) const;
  // Reads a patch for BoxEvidence.
  void LookForBoxes(const PatchSampler& sampler);
  // By how much likelier the box of the patch last looked at has the target's
  // colours than its surroundings': the logarithm of the ratio, summed over the
  // samples looked at. What lies outside the patch says nothing.
  double BoxEvidence(const geometry::Box2& box_samples) const;
  // The mean probability as it is to be expected on the target, and around it:
  // how far they lie apart says what colours can tell.
  double expected() const { return expected_; }
  double around() const { return expected_around_; }

 private:
  friend struct StateFields;

  static constexpr int kBins = 16 * 16 * 16;
  static constexpr int kStep = 2;
  using Counts = std::vector<float>;

  // Of every second sample of row `y` of the patch, and what is between them.
  const std::int32_t* RowBins(const PatchSampler& sampler, int y);

  int side_, grid_;
  // What is not learnt is of the patch last looked at, at which the same frame
  // looked: not carried.
  std::vector<std::int32_t> bins_;  // of the current row
  Counts target_, around_, target_now_, around_now_;
  std::vector<float> probability_;  // kBins
  std::vector<float> integral_;     // (grid_ + 1)^2
  std::vector<float> evidence_;     // of a sample, by its bin
  std::vector<float> evidence_integral_;
  double expected_ = 0.5;
  double expected_around_ = 0.5;
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_COLOUR_HISTOGRAM_H_
