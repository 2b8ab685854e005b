// SPDX-License-Identifier: Apache-2.0
// How much larger or smaller a target looks than before.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_SCALE_FILTER_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_SCALE_FILTER_H_

#include <Eigen/Core>
#include <array>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "map_store/geometry/box.h"
#include "server/target/internal/gradient_histogram.h"
#include "server/target/internal/patch_sampler.h"
#include "server/target/internal/vectors.h"

namespace groundlock::target::internal {

// Between which sizes a scale filter decides.
struct ScaleSteps {
  double step;  // from each scale to the next
  // In sizes of the box, what of the image the scales are read from: holds the
  // largest, step^8.
  double patch_span;
};
// The paper's, for a target of which it is known how large it should look: what
// is left changes little from frame to frame.
inline constexpr ScaleSteps kFineSteps = {1.02, 1.2};
// For a target of which nothing else is known: at ten frames a second it grows
// by more than the paper's steps see (docs/method.md, Scale and outline).
inline constexpr ScaleSteps kCoarseSteps = {1.04, 1.4};

// A one-dimensional correlation filter over scale: M. Danelljan, G. Hager,
// F. Shahbaz Khan, M. Felsberg, "Discriminative scale space tracking", PAMI
// 2017, section 4, with their 17 scales, learning rate 0.025 and lambda 0.01.
// The target's box is reduced to 24 x 24 samples whatever its shape. Transforms
// over 17 scales are cheap enough to need none of the paper's compression; the
// response is evaluated between the scales as theirs is (section 5.1). Not
// thread-safe.
class ScaleFilter {
 public:
  // What is read of an image, in sizes of the box.
  static constexpr double kSpan = 1.65;

  explicit ScaleFilter(const ScaleSteps& steps);

  // Forgets everything and learns the box's content as scale 1.
  void Train(const cv::Mat& image, const geometry::Box2& box_px);
  void Update(const cv::Mat& image, const geometry::Box2& box_px);
  // By what factor the box should grow, from step^-8 to step^8.
  double Estimate(const cv::Mat& image, const geometry::Box2& box_px);

 private:
  friend struct StateFields;

  static constexpr int kScales = 17;
  static constexpr int kFrequencies = kScales / 2 + 1;
  // One patch is sampled from the image; the scales are sampled from it. It
  // holds about one sample a model sample at the smallest.
  static constexpr int kPatchSide = 40;
  static constexpr int kModelCells = 6;
  static constexpr int kModelSide = kModelCells * GradientHistogram::kCellPx;
  static constexpr int kDimensions =
      kModelCells * kModelCells * GradientHistogram::kFeatures;
  static constexpr int kFeaturePitch = WholeVectors(kModelCells);
  static constexpr int kRowFloats =
      GradientHistogram::kFeatures * kFeaturePitch;
  static_assert(WholeVectors(kPatchSide) == kPatchSide &&
                WholeVectors(kModelSide) == kModelSide);
  // Between which samples of the patch a scale reads, either way.
  struct Places {
    std::array<int, kModelSide> index;
    std::array<float, kModelSide> share;
  };
  using Samples =
      Eigen::Matrix<float, kScales, Eigen::Dynamic, Eigen::RowMajor>;
  // Real parts above imaginary ones.
  using Spectrum =
      Eigen::Matrix<float, 2 * kFrequencies, Eigen::Dynamic, Eigen::RowMajor>;
  using Wave = Eigen::Matrix<float, 2 * kFrequencies, kScales>;
  using Line = Eigen::Matrix<float, kFrequencies, 1>;

  // Fills `spectrum_` with the transform over scale of the box's content.
  void Sample(const cv::Mat& image, const geometry::Box2& box_px);
  void SetPlaces();
  void ReadScale(const Places& places);
  void Learn(float rate);

  ScaleSteps steps_;
  // But for what is learnt, numerator_ and denominator_, all of it is of one
  // call or follows from the steps: not carried.
  PatchSampler sampler_;
  GradientHistogram histogram_;
  std::vector<float> features_;  // as the histogram gives them
  std::array<Places, kScales> places_;
  // The patch, column by column, and what a scale reads of it, row by row.
  std::array<std::vector<float>, 3> patch_columns_, model_;
  Samples samples_;
  Spectrum spectrum_, numerator_;
  Line denominator_, desired_;
  Wave transform_;
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_SCALE_FILTER_H_
