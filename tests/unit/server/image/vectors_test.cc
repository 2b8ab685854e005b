// SPDX-License-Identifier: Apache-2.0
#include "server/image/vectors.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::image
#define GROUNDLOCK_KERNELS "tests/unit/server/image/vectors_test_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::image {
namespace {

constexpr int kN = kVectorFloats;
constexpr int kResults = 10;

constexpr std::array<float, kN> kA = {
    1.5F, -2.25F, 3.0F, 1e-3F, -70.1F, 0.7F, 255.0F, 12.3F};
constexpr std::array<float, kN> kB = {
    0.5F, 2.0F, -3.0F, 1e3F, -70.0F, 0.7F, 3.3F, -1.0F};

// Both widths, where the machine has them, against what the operations are.
class VectorsTest : public ::testing::TestWithParam<bool> {
 protected:
  void SetUp() override {
#if GROUNDLOCK_WIDE_VECTORS
    if (GetParam() && !kMachineIsWide) GTEST_SKIP() << "no AVX2 here";
#else
    if (GetParam()) GTEST_SKIP() << "this build has one width";
#endif
  }
};

#if GROUNDLOCK_WIDE_VECTORS
#define AT_WIDTH(kernel) (GetParam() ? &wide::kernel : &narrow::kernel)
#else
#define AT_WIDTH(kernel) (&narrow::kernel)
#endif

TEST_P(VectorsTest, ElementsAreWorkedOnOneByOne) {
  std::array<float, kResults * kN> found;
  AT_WIDTH(Elements)(kA.data(), kB.data(), found.data());
  for (int i = 0; i < kN; ++i) {
    const float a = kA[i];
    const float b = kB[i];
    const std::array<float, kResults> expected = {a + b,
                                                  a - b,
                                                  a * b,
                                                  a / b,
                                                  std::min(a, b),
                                                  std::max(a, b),
                                                  std::abs(a),
                                                  std::sqrt(std::abs(a)),
                                                  a > b ? a : 7.0F,
                                                  a > b ? b : 0.0F};
    for (int k = 0; k < kResults; ++k) {
      EXPECT_EQ(found[k * kN + i], expected[k]) << k << " of " << a << "," << b;
    }
  }
}

TEST_P(VectorsTest, WholeNumbersAreCutOffAndShifted) {
  std::array<std::int32_t, 2 * kN> found;
  AT_WIDTH(Whole)(kA.data(), found.data());
  for (int i = 0; i < kN; ++i) {
    const auto whole = static_cast<std::int32_t>(kA[i]);
    EXPECT_EQ(found[i], whole);
    EXPECT_EQ(found[kN + i], (whole * 8) | (whole >> 1)) << whole;
  }
}

TEST_P(VectorsTest, BytesHaveNoSign) {
  constexpr std::array<std::uint8_t, kN> kBytes = {
      0, 1, 127, 128, 129, 200, 254, 255};
  std::array<float, kN> found;
  AT_WIDTH(Bytes)(kBytes.data(), found.data());
  for (int i = 0; i < kN; ++i) EXPECT_EQ(found[i], kBytes[i]);
}

TEST_P(VectorsTest, PairsOfBytesAreTakenApartInTheirOrderInMemory) {
  constexpr std::array<std::uint8_t, 2 * kN> kBytes = {
      0, 255, 1, 254, 127, 128, 129, 126, 200, 3, 255, 255, 0, 0, 17, 128};
  std::array<std::uint16_t, kN> pairs;
  std::memcpy(pairs.data(), kBytes.data(), sizeof(pairs));
  std::array<float, 2 * kN> found;
  AT_WIDTH(PairsOfBytes)(pairs.data(), found.data());
  for (int i = 0; i < kN; ++i) {
    EXPECT_EQ(found[i], kBytes[2 * i]);
    EXPECT_EQ(found[kN + i], kBytes[2 * i + 1]);
  }
}

TEST_P(VectorsTest, WholeNumbersBecomeFloatsAgain) {
  std::array<float, kN> found;
  AT_WIDTH(Truncate)(kA.data(), found.data());
  for (int i = 0; i < kN; ++i) EXPECT_EQ(found[i], std::trunc(kA[i]));
}

TEST_P(VectorsTest, OrdersAreWhatTheirNamesSay) {
  std::array<float, kN * kN> rows;
  for (int i = 0; i < kN * kN; ++i) rows[i] = static_cast<float>(i);
  std::array<float, 16 * kN> found;
  AT_WIDTH(Orders)(rows.data(), found.data());
  const float* at = found.data();
  for (int i = 0; i < kN; ++i) {
    for (int k = 0; k < 2; ++k) EXPECT_EQ(*at++, rows[k * kN + i]);
  }
  for (int i = 0; i < 2 * kN; ++i) EXPECT_EQ(*at++, rows[i]);
  for (int i = 0; i < kN; ++i) {
    for (int k = 0; k < 4; ++k) EXPECT_EQ(*at++, rows[k * kN + i]);
  }
  for (int i = 0; i < kN; ++i) {
    for (int k = 0; k < kN; ++k) EXPECT_EQ(*at++, rows[k * kN + i]);
  }
}

// To the bit, so that results do not depend on it.
TEST(Vectors, BothWidthsAgree) {
#if GROUNDLOCK_WIDE_VECTORS
  if (!kMachineIsWide) GTEST_SKIP() << "no AVX2 here";
  std::vector<float> a(kN);
  std::vector<float> b(kN);
  for (int round = 0; round < 1'000; ++round) {
    for (int i = 0; i < kN; ++i) {
      a[i] = std::sin(12.9898F * (0.5F + static_cast<float>(kN * round + i))) *
             1e4F;
      b[i] = std::sin(78.233F * (0.5F + static_cast<float>(kN * round + i))) *
             10.0F;
    }
    std::array<float, kResults * kN> narrow_found;
    std::array<float, kResults * kN> wide_found;
    narrow::Elements(a.data(), b.data(), narrow_found.data());
    wide::Elements(a.data(), b.data(), wide_found.data());
    ASSERT_EQ(narrow_found, wide_found) << round;
  }
#else
  GTEST_SKIP() << "this build has one width";
#endif
}

INSTANTIATE_TEST_SUITE_P(Widths,
                         VectorsTest,
                         ::testing::Bool(),
                         [](const auto& width) {
                           return width.param ? "Wide" : "Narrow";
                         });

}  // namespace
}  // namespace groundlock::image
