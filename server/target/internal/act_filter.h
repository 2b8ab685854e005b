// SPDX-License-Identifier: Apache-2.0
// The correlation filter of the adaptive colour tracker, on fixed patches.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_ACT_FILTER_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_ACT_FILTER_H_

#include <Eigen/Core>
#include <array>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/target/colour_names.h"
#include "server/target/internal/patch_sampler.h"

namespace groundlock::target::internal {

struct ActOptions {
  int model_cells = 128;
  // Standard deviation of the desired output, relative to the target's size.
  double output_sigma = 1.0 / 16.0;
  double target_share = 0.5;  // of the patch's side: 1 / (1 + padding)
  double kernel_sigma = 0.2;
  // The closed-form colour names are nearly one-hot where the learnt table, for
  // which kernel_sigma was published, is soft: unscaled they drown the
  // intensity and make the kernel so narrow that sensor noise halves the
  // response. On ten sequences 1.0 gives an AUC of 0.20, anything from 0.05 to
  // 0.2 0.33.
  double name_scale = 0.2;
  double lambda = 0.01;
  double learning_rate = 0.075;
  double compression_learning_rate = 0.15;
};

// M. Danelljan, F. Shahbaz Khan, M. Felsberg, J. van de Weijer, "Adaptive color
// attributes for real-time visual tracking", CVPR 2014; equation numbers are
// theirs. Features: eleven colour names, compressed to two by an adaptive
// principal component analysis (section 3.3), and intensity. Not thread-safe.
class ActFilter {
 public:
  explicit ActFilter(const ActOptions& options);

  // Forgets everything and learns the patch that `sampler` holds.
  void Train(const PatchSampler& sampler);
  // Moves the model towards the patch by the learning rates.
  void Update(const PatchSampler& sampler);
  // Correlates the patch with the model: element s of the result (CV_32F,
  // periodic) says how well the target fits s cells from the patch's centre,
  // about 1 where it is. Valid until the next call.
  const cv::Mat& Respond(const PatchSampler& sampler);

 private:
  friend struct StateFields;

  static constexpr int kCompressed = 2;
  static constexpr int kChannels = kCompressed + 1;
  using NameMatrix =
      Eigen::Matrix<float, Eigen::Dynamic, kColourNames, Eigen::RowMajor>;
  using Covariance = Eigen::Matrix<double, kColourNames, kColourNames>;
  struct Features {
    std::array<cv::Mat, kChannels> plane;
    std::array<cv::Mat, kChannels> spectrum;
    double energy = 0.0;
  };

  void ReadPatch(const PatchSampler& sampler);
  void Learn(double rate, double compression_rate);
  void UpdateProjection(double rate);
  void Project(const NameMatrix& names,
               const Eigen::VectorXf& intensity,
               Features& features) const;
  void Kernel(const Features& x, const Features& z);

  ActOptions options_;
  int cells_;
  std::vector<float> window_;  // cells x cells
  cv::Mat desired_spectrum_;
  // The current patch, which is read anew by each call and not carried, and the
  // learnt appearance (eq. 12).
  NameMatrix names_, learnt_names_;
  Eigen::VectorXf intensity_, learnt_intensity_;
  Eigen::Matrix<float, kColourNames, kCompressed> projection_;
  Covariance smoothed_covariance_;  // Q of algorithm 1
  // Running numerator and denominator of the dual filter (eq. 11).
  cv::Mat numerator_, denominator_;
  // Of the patch; and of the learnt appearance, from which they follow.
  Features patch_features_, model_features_;
  cv::Mat product_, correlation_, kernel_spectrum_, response_;
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_ACT_FILTER_H_
