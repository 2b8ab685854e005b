// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/dcf_filter.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>
#include <vector>

namespace groundlock::target::internal {
namespace {

constexpr int kCells = 8;
constexpr int kChannels = 16;
constexpr int kColumns = kCells / 2 + 1;
constexpr int kCropHalf = 2;  // cells; the least there is
constexpr int kCropSide = 2 * kCropHalf;
constexpr int kFirst = kCells / 2 - kCropHalf;
const Eigen::Vector2d kTarget(4.0, 4.0);

std::vector<float> RandomPatch(unsigned seed) {
  std::mt19937 generator(seed);
  std::normal_distribution<float> normal;
  std::vector<float> patch(kCells * kCells * kChannels);
  for (float& value : patch) value = normal(generator);
  return patch;
}

void Put(const std::vector<float>& patch, DcfFilter& filter) {
  std::copy(patch.begin(), patch.end(), filter.Patch());
}

// The same problem written as plain least squares over the filter's cells
// inside the crop: rows are shifts, columns (cell, channel).
class Direct {
 public:
  explicit Direct(const std::vector<float>& patch)
      : shifts_(kCells * kCells, kCropSide * kCropSide * kChannels),
        desired_(kCells * kCells) {
    for (int sy = 0; sy < kCells; ++sy) {
      for (int sx = 0; sx < kCells; ++sx) {
        const int row = sy * kCells + sx;
        int column = 0;
        for (int y = kFirst; y < kFirst + kCropSide; ++y) {
          for (int x = kFirst; x < kFirst + kCropSide; ++x) {
            const int cell = (y + sy) % kCells * kCells + (x + sx) % kCells;
            for (int c = 0; c < kChannels; ++c) {
              shifts_(row, column++) = patch[cell * kChannels + c];
            }
          }
        }
        const double dx = std::min(sx, kCells - sx) / 0.5;
        const double dy = std::min(sy, kCells - sy) / 0.5;
        desired_[row] = std::exp(-0.5 * (dx * dx + dy * dy));
      }
    }
  }

  // 1/2 |A f - y|^2 + weight/2 |f - before|^2.
  double Energy(const Eigen::VectorXd& f,
                const Eigen::VectorXd& before,
                double weight) const {
    return 0.5 * (shifts_ * f - desired_).squaredNorm() +
           0.5 * weight * (f - before).squaredNorm();
  }
  Eigen::VectorXd Solve(const Eigen::VectorXd& before, double weight) const {
    Eigen::MatrixXd normal = shifts_.transpose() * shifts_;
    normal.diagonal().array() += weight;
    return normal.ldlt().solve(shifts_.transpose() * desired_ +
                               weight * before);
  }

 private:
  Eigen::MatrixXd shifts_;
  Eigen::VectorXd desired_;
};

// The filter's cells inside the crop from its half spectrum; `outside` gets the
// largest value elsewhere.
Eigen::VectorXd InCells(const DcfFilter& filter, double* outside) {
  Eigen::VectorXd inside(kCropSide * kCropSide * kChannels);
  *outside = 0.0;
  int next = 0;
  for (int y = 0; y < kCells; ++y) {
    for (int x = 0; x < kCells; ++x) {
      const bool in = y >= kFirst && y < kFirst + kCropSide && x >= kFirst &&
                      x < kFirst + kCropSide;
      for (int c = 0; c < kChannels; ++c) {
        double sum = 0.0;
        for (int ky = 0; ky < kCells; ++ky) {
          for (int kx = 0; kx < kColumns; ++kx) {
            const float* f =
                &filter.filter()[2 * kChannels * (kx * kCells + ky)];
            const double angle = 2.0 * M_PI * (ky * y + kx * x) / kCells;
            const double weight = kx == 0 || kx == kCells / 2 ? 1.0 : 2.0;
            sum += weight * (f[c] * std::cos(angle) -
                             f[kChannels + c] * std::sin(angle));
          }
        }
        sum /= kCells * kCells;
        if (in) {
          inside[next++] = sum;
        } else {
          *outside = std::max(*outside, std::abs(sum));
        }
      }
    }
  }
  return inside;
}

DcfFilterOptions Options(int iterations) {
  DcfFilterOptions options;
  options.cells = kCells;
  options.channels = kChannels;
  options.iterations = iterations;
  options.first_iterations = iterations;
  return options;
}

// mu weighs the change times the number of cells; see the header.
constexpr double kTemporalWeight = 15.0 * kCells * kCells;

TEST(DcfFilter, ManyIterationsSolveTheCroppedLeastSquares) {
  const std::vector<float> first = RandomPatch(1);
  const std::vector<float> second = RandomPatch(2);
  DcfFilter filter(Options(2'000));
  Put(first, filter);
  filter.Train(kTarget);
  double outside = 0.0;
  const Eigen::VectorXd before = InCells(filter, &outside);
  EXPECT_LT(outside, 1e-6);
  Put(second, filter);
  filter.Update(kTarget);
  const Eigen::VectorXd found = InCells(filter, &outside);
  EXPECT_LT(outside, 1e-6);
  const Eigen::VectorXd expected =
      Direct(second).Solve(before, kTemporalWeight);
  // Single precision through 2000 transforms.
  EXPECT_LT((found - expected).norm(), 1e-3 * expected.norm());
}

TEST(DcfFilter, AFewIterationsLowerTheEnergy) {
  const std::vector<float> first = RandomPatch(1);
  const std::vector<float> second = RandomPatch(2);
  const Direct direct(second);
  double last = 0.0;
  for (const int iterations : {0, 1, 2, 4, 8}) {
    DcfFilterOptions options = Options(8);
    options.iterations = iterations;
    DcfFilter filter(options);
    Put(first, filter);
    filter.Train(kTarget);
    double outside = 0.0;
    const Eigen::VectorXd before = InCells(filter, &outside);
    Put(second, filter);
    filter.Update(kTarget);
    const double energy =
        direct.Energy(InCells(filter, &outside), before, kTemporalWeight);
    if (iterations > 0) {
      EXPECT_LT(energy, last) << iterations << " iterations";
    }
    last = energy;
  }
}

TEST(DcfFilter, TheResponsePeaksWhereThePatchWasMovedTo) {
  DcfFilter filter(Options(50));
  const std::vector<float> patch = RandomPatch(3);
  Put(patch, filter);
  filter.Train(kTarget);
  std::vector<float> moved(patch.size());
  for (int y = 0; y < kCells; ++y) {
    for (int x = 0; x < kCells; ++x) {
      const int to = (y + 7) % kCells * kCells + (x + 2) % kCells;
      std::copy_n(&patch[(y * kCells + x) * kChannels],
                  kChannels,
                  &moved[to * kChannels]);
    }
  }
  Put(moved, filter);
  const Peak peak = filter.RefinedPeak(FindPeak(filter.Respond()));
  // Whole cells: what is left is how well 256 unknowns fit 64 shifts of noise.
  EXPECT_NEAR(peak.shift_cells.x(), 2.0, 0.05);
  EXPECT_NEAR(peak.shift_cells.y(), -1.0, 0.05);
  EXPECT_NEAR(peak.value, 1.0, 0.25) << "short of 1 as 50 iterations are";
}

TEST(DcfFilter, LearnsAPatchItHasSeenAsOneThatIsCentred) {
  const std::vector<float> first = RandomPatch(1);
  const std::vector<float> second = RandomPatch(2);
  std::vector<float> moved(second.size());
  for (int y = 0; y < kCells; ++y) {
    for (int x = 0; x < kCells; ++x) {
      const int to = (y + 1) % kCells * kCells + (x + 6) % kCells;
      std::copy_n(&second[(y * kCells + x) * kChannels],
                  kChannels,
                  &moved[to * kChannels]);
    }
  }
  DcfFilter centred(Options(8));
  Put(first, centred);
  centred.Train(kTarget);
  Put(second, centred);
  centred.Update(kTarget);
  DcfFilter seen(Options(8));
  Put(first, seen);
  seen.Train(kTarget);
  Put(moved, seen);
  seen.Respond();
  seen.UpdateSeen({-2.0, 1.0}, kTarget);
  for (std::size_t i = 0; i < seen.filter().size(); ++i) {
    ASSERT_NEAR(seen.filter()[i], centred.filter()[i], 1e-4) << i;
  }
}

}  // namespace
}  // namespace groundlock::target::internal
