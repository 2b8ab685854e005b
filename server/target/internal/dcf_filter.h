// SPDX-License-Identifier: Apache-2.0
// A background-aware correlation filter with temporal regularisation.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_DCF_FILTER_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_DCF_FILTER_H_

#include <Eigen/Core>
#include <complex>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/target/internal/lane_transform.h"
#include "server/target/internal/plane_transform.h"
#include "server/target/internal/spectrum.h"

namespace groundlock::target::internal {

struct DcfFilterOptions {
  int cells = 48;     // 2^a 3^b
  int channels = 32;  // a multiple of 16
  // Standard deviation of the desired output relative to the target's size.
  double output_sigma = 1.0 / 12.0;
  // Weight of the filter's change since the last training (STRCF's mu).
  double temporal = 15.0;
  // Weight of the constraint in the augmented Lagrangian (gamma).
  double penalty = 10.0;
  int iterations = 1;
  int first_iterations = 8;  // starting from nothing
  // Whether the filter is zero outside the target. If not, it is a plain
  // correlation filter, whose examples of background are cyclic shifts alone.
  bool crop = true;
};

// Finds the filter f that is zero outside the target and minimises
//   1/2 |sum_c x_c (*) f_c - y|^2 + mu/2 |f - f_before|^2
// over all cyclic shifts of the patch x: the crop of H. Galoogahi, A. Fagg,
// S. Lucey, "Learning background-aware correlation filters for visual
// tracking", ICCV 2017, makes the shifts real examples of background, and the
// second term, of F. Li, C. Tian, W. Zuo, L. Zhang, M.-H. Yang, "Learning
// spatial-temporal regularized correlation filters for visual tracking", CVPR
// 2018, stands in for a history of patches. Solved by ADMM: the data term per
// frequency (Sherman-Morrison), the crop per cell. mu and gamma weigh the
// squared modulus per frequency, of transforms that are not scaled, against the
// data's divided by cells^2; so channels of unit mean square suit them whatever
// their number of cells.
//
// Not thread-safe.
class DcfFilter {
 public:
  explicit DcfFilter(const DcfFilterOptions& options);

  // Where the caller puts the patch: channels / 16 blocks of cells^2 groups of
  // 16 values. Respond and Train consume it.
  float* Patch() { return patch_.data(); }
  // Nothing is to be seen in that cell of it.
  void ClearCell(int x, int y);

  // Forgets everything and learns the patch; `target_cells`: the size of the
  // target, which is at the patch's centre.
  void Train(const Eigen::Vector2d& target_cells);
  // Learns the patch while staying near the filter that there is.
  void Update(const Eigen::Vector2d& target_cells);
  // The same of the patch last responded to, moved (periodically) such that
  // what is `shift_cells` from its centre comes to lie there.
  void UpdateSeen(const Eigen::Vector2d& shift_cells,
                  const Eigen::Vector2d& target_cells);

  // Element s of the result (CV_32F, periodic) says how well the target fits s
  // cells from the patch's centre; about 1 where it is. Valid until the next
  // call.
  const cv::Mat& Respond();
  // The same patch once more, by another filter: one that filter() gave.
  const cv::Mat& RespondBy(const std::vector<float>& filter);

  // The maximum of the last response near `coarse`, by Newton's method on the
  // trigonometric polynomial through its cells (Danelljan et al., ECCV 2016,
  // section 3.4, does the same).
  Peak RefinedPeak(const Peak& coarse) const;

  // Its spectrum: per frequency (columns of `cells`) the real parts of all
  // channels, then the imaginary ones.
  const std::vector<float>& filter() const { return filter_; }
  // Goes on with a filter that filter() gave.
  void SetFilter(const std::vector<float>& filter) { filter_ = filter; }

 private:
  friend struct StateFields;

  // Half of the frequencies (the others are conjugate), column by column, each
  // with the real parts of all channels, then the imaginary ones.
  int Columns() const { return options_.cells / 2 + 1; }
  std::size_t ColumnFloats() const {
    return 2UL * options_.channels * options_.cells;
  }
  float* Block(int block);
  float* Column(int block, bool mirror);
  void Solve(int iterations, double temporal);
  void SolveFrequencies(double temporal, bool first, bool last);
  void SetTarget(const Eigen::Vector2d& target_cells);
  void SetOutput(double sigma_cells);
  void ToSpectrum(std::vector<float>& spectrum, int first_row, int end_row);
  void FromSpectrum(int x, int block);
  void Crop();
  void ShiftSample(const Eigen::Vector2d& shift_cells);

  DcfFilterOptions options_;
  LaneTransform transform_;
  // Where the filter may differ from zero, [first, end) in cells.
  Eigen::Vector2i crop_first_ = Eigen::Vector2i::Zero();
  Eigen::Vector2i crop_end_ = Eigen::Vector2i::Zero();
  double output_sigma_cells_ = 0.0;
  // Per frequency, real; as that sigma has it.
  std::vector<float> desired_;
  // What Respond and Train consume, and reckon in, is not carried.
  std::vector<float> patch_;  // blocks of cells
  // Of each block a column of packed spectra, then the one that mirrors it.
  std::vector<float> packed_;
  // Spectra: the patch, the filter, the filter before, the scaled multipliers.
  // The last two are of one training: not carried.
  std::vector<float> sample_, filter_, before_, multiplier_;
  // By what a shift turns the frequencies: rows', and a column's.
  std::vector<std::complex<double>> row_turns_;
  std::vector<float> cosines_, sines_;
  PlaneTransform plane_;
  std::vector<float> response_column_;                  // real, then imaginary
  std::vector<std::complex<float>> response_spectrum_;  // row by row
  cv::Mat response_;
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_DCF_FILTER_H_
