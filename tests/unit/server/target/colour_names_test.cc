// SPDX-License-Identifier: Apache-2.0
#include "server/target/colour_names.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>

namespace groundlock::target {
namespace {

struct Check {
  int red, green, blue;
  ColourName name;
  double at_least;
};

// What people call clear examples of each colour; the model gives all of them
// more than 0.99, except this blue, part of which it calls purple.
constexpr Check kChecks[] = {
    {220, 20, 20, ColourName::kRed, 0.99},
    {255, 150, 0, ColourName::kOrange, 0.99},
    {110, 60, 20, ColourName::kBrown, 0.99},
    {250, 240, 30, ColourName::kYellow, 0.99},
    {30, 160, 40, ColourName::kGreen, 0.99},
    {20, 40, 200, ColourName::kBlue, 0.55},
    {140, 30, 160, ColourName::kPurple, 0.99},
    {250, 160, 190, ColourName::kPink, 0.99},
    {8, 8, 8, ColourName::kBlack, 0.99},
    {128, 128, 128, ColourName::kGrey, 0.99},
    {250, 250, 250, ColourName::kWhite, 0.99},
    {90, 92, 95, ColourName::kGrey, 0.99},
};

ColourName Largest(const ColourNameVector& p) {
  return static_cast<ColourName>(std::max_element(p.begin(), p.end()) -
                                 p.begin());
}

TEST(NameColour, NamesClearExamples) {
  for (const Check& check : kChecks) {
    const ColourNameVector p = NameColour(check.red, check.green, check.blue);
    EXPECT_EQ(Largest(p), check.name)
        << check.red << "," << check.green << "," << check.blue;
    EXPECT_GE(p[static_cast<int>(check.name)], check.at_least)
        << check.red << "," << check.green << "," << check.blue;
  }
}

TEST(NameColour, BlueSharesWithPurple) {
  const ColourNameVector p = NameColour(20, 40, 200);
  EXPECT_NEAR(p[static_cast<int>(ColourName::kBlue)], 0.56, 0.01);
  EXPECT_NEAR(p[static_cast<int>(ColourName::kPurple)], 0.44, 0.01);
}

TEST(ColourNameTable, HoldsProbabilitiesEverywhere) {
  const ColourNameTable& table = ColourNameTable::Get();
  for (int cell = 0; cell < 32 * 32 * 32; ++cell) {
    const ColourNameVector& p =
        table.At((cell >> 10) * 8, ((cell >> 5) & 31) * 8, (cell & 31) * 8);
    ASSERT_NEAR(std::accumulate(p.begin(), p.end(), 0.0), 1.0, 1e-5);
    for (const float value : p) ASSERT_TRUE(value >= 0.0F && value <= 1.0F);
  }
}

TEST(ColourNameTable, IsTheModelAtTheCellsCentre) {
  const ColourNameTable& table = ColourNameTable::Get();
  for (const Check& check : kChecks) {
    EXPECT_EQ(Largest(table.At(static_cast<std::uint8_t>(check.red),
                               static_cast<std::uint8_t>(check.green),
                               static_cast<std::uint8_t>(check.blue))),
              check.name);
  }
  EXPECT_EQ(table.At(40, 80, 160), NameColour(43.5, 83.5, 163.5));
  EXPECT_EQ(table.At(47, 87, 167), NameColour(43.5, 83.5, 163.5));
}

}  // namespace
}  // namespace groundlock::target
