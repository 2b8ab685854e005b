// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/gradient_histogram.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <random>
#include <vector>

namespace groundlock::target::internal {
namespace {

constexpr int kCells = 6;
constexpr int kSide = kCells * GradientHistogram::kCellPx;
constexpr int kFeatures = GradientHistogram::kFeatures;

using Planes = std::array<std::vector<float>, 3>;

std::vector<float> Compute(const Planes& planes) {
  GradientHistogram histogram(kCells);
  std::vector<float> out(kCells * kCells * kFeatures);
  const std::array<const float*, 3> pointers = {
      planes[0].data(), planes[1].data(), planes[2].data()};
  const int pitch = histogram.pitch();
  std::vector<float> rows(kCells * kFeatures * pitch);
  histogram.Compute(pointers.data(), rows.data(), kFeatures * pitch);
  for (int y = 0; y < kCells; ++y) {
    for (int x = 0; x < kCells; ++x) {
      for (int i = 0; i < kFeatures; ++i) {
        out[(y * kCells + x) * kFeatures + i] =
            rows[(y * kFeatures + i) * pitch + x];
      }
    }
  }
  return out;
}

// The definition, pixel by pixel and in double precision.
class Reference {
 public:
  explicit Reference(const Planes& planes) {
    for (int y = 0; y < kSide; ++y) {
      for (int x = 1; x < kSide - 1; ++x) Vote(planes, x, y);
    }
  }

  std::vector<double> Features(int x, int y) const {
    std::vector<double> features(kFeatures, 0.0);
    int n = 0;
    for (const int dy : {-1, 1}) {
      for (const int dx : {-1, 1}) {
        const double norm =
            std::sqrt(Energy(x, y) + Energy(x + dx, y) + Energy(x, y + dy) +
                      Energy(x + dx, y + dy) + 1e-4 * 65025.0);
        for (int i = 0; i < 18; ++i) {
          const double value = std::min(Bin(x, y, i) / norm, 0.2);
          features[i] += 0.5 * value;
          features[27 + n] += 0.2357 * value;
        }
        for (int i = 0; i < 9; ++i) {
          features[18 + i] +=
              0.5 * std::min((Bin(x, y, i) + Bin(x, y, i + 9)) / norm, 0.2);
        }
        ++n;
      }
    }
    return features;
  }

 private:
  void Vote(const Planes& planes, int x, int y) {
    double gx = 0.0;
    double gy = 0.0;
    for (const auto& plane : planes) {
      const auto at = [&plane](int px, int py) {
        return static_cast<double>(
            plane[std::clamp(py, 0, kSide - 1) * kSide + px]);
      };
      const double dx = at(x + 1, y) - at(x - 1, y);
      const double dy = at(x, y + 1) - at(x, y - 1);
      if (dx * dx + dy * dy > gx * gx + gy * gy) {
        gx = dx;
        gy = dy;
      }
    }
    const double turn = std::atan2(gy, gx) / (2.0 * std::numbers::pi) * 18.0;
    const int orientation = (static_cast<int>(std::lround(turn)) + 18) % 18;
    const double cx = (x + 0.5) / 4.0 - 0.5;
    const double cy = (y + 0.5) / 4.0 - 0.5;
    for (int j = 0; j < kCells; ++j) {
      for (int i = 0; i < kCells; ++i) {
        bins_[j][i][orientation] += std::hypot(gx, gy) *
                                    std::max(0.0, 1.0 - std::abs(cx - i)) *
                                    std::max(0.0, 1.0 - std::abs(cy - j));
      }
    }
  }
  double Bin(int x, int y, int i) const { return bins_[y][x][i]; }
  double Energy(int x, int y) const {
    x = std::clamp(x, 0, kCells - 1);
    y = std::clamp(y, 0, kCells - 1);
    double sum = 0.0;
    for (int i = 0; i < 9; ++i) {
      sum += std::pow(Bin(x, y, i) + Bin(x, y, i + 9), 2);
    }
    return sum;
  }

  double bins_[kCells][kCells][18] = {};
};

TEST(GradientHistogram, IsWhatItsDefinitionSays) {
  std::mt19937 generator(1);
  std::uniform_real_distribution<float> uniform(0.0F, 255.0F);
  Planes planes;
  for (auto& plane : planes) {
    plane.resize(kSide * kSide);
    for (float& value : plane) value = uniform(generator);
  }
  const std::vector<float> found = Compute(planes);
  const Reference reference(planes);
  for (int y = 0; y < kCells; ++y) {
    for (int x = 0; x < kCells; ++x) {
      const std::vector<double> expected = reference.Features(x, y);
      for (int i = 0; i < kFeatures; ++i) {
        // Single precision of values of order 1.
        ASSERT_NEAR(found[(y * kCells + x) * kFeatures + i], expected[i], 1e-5)
            << "cell " << x << "," << y << " feature " << i;
      }
    }
  }
}

TEST(GradientHistogram, AFlatPatchHasNone) {
  Planes planes;
  planes.fill(std::vector<float>(kSide * kSide, 200.0F));
  for (const float value : Compute(planes)) EXPECT_EQ(value, 0.0F);
}

// An edge seen in one colour only counts; its mirror image has the opposite
// signed and the same unsigned orientation.
TEST(GradientHistogram, SignedOrientationsTellAnEdgeFromItsMirrorImage) {
  Planes rising;
  rising.fill(std::vector<float>(kSide * kSide, 50.0F));
  Planes falling = rising;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      (x < kSide / 2 ? falling : rising)[1][y * kSide + x] = 150.0F;
    }
  }
  const std::vector<float> a = Compute(rising);
  const std::vector<float> b = Compute(falling);
  const int cell = (2 * kCells + 2) * kFeatures;
  EXPECT_GT(a[cell + 0], 0.1F);
  EXPECT_EQ(a[cell + 9], 0.0F);
  EXPECT_EQ(b[cell + 0], 0.0F);
  EXPECT_FLOAT_EQ(b[cell + 9], a[cell + 0]);
  EXPECT_FLOAT_EQ(b[cell + 18], a[cell + 18]);
}

}  // namespace
}  // namespace groundlock::target::internal
