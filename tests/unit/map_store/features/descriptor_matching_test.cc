// SPDX-License-Identifier: Apache-2.0
#include "map_store/features/descriptor_matching.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <tuple>
#include <vector>

namespace groundlock::features {
namespace {

std::vector<map::Descriptor> RandomDescriptors(int count, std::uint64_t seed) {
  std::mt19937_64 engine(seed);
  std::uniform_int_distribution<int> value(0, 255);
  std::vector<map::Descriptor> descriptors(count);
  for (map::Descriptor& descriptor : descriptors) {
    for (std::uint8_t& entry : descriptor) {
      entry = static_cast<std::uint8_t>(value(engine));
    }
  }
  return descriptors;
}

// Copies of some references with a little noise among random ones.
std::vector<map::Descriptor> Noisy(const std::vector<map::Descriptor>& from,
                                   std::uint64_t seed) {
  std::mt19937_64 engine(seed);
  std::uniform_int_distribution<int> noise(-40, 40);
  std::vector<map::Descriptor> result = from;
  for (map::Descriptor& descriptor : result) {
    for (std::uint8_t& entry : descriptor) {
      entry = static_cast<std::uint8_t>(
          std::clamp(int{entry} + noise(engine), 0, 255));
    }
  }
  return result;
}

double Distance(const map::Descriptor& a, const map::Descriptor& b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    sum += std::pow(double{1.0} * a[i] - b[i], 2);
  }
  return std::sqrt(sum);
}

// The definition, word for word.
std::vector<DescriptorMatch> Reference(
    const std::vector<map::Descriptor>& queries,
    const std::vector<map::Descriptor>& references,
    double ratio) {
  std::vector<DescriptorMatch> matches;
  for (std::size_t q = 0; q < queries.size(); ++q) {
    std::vector<std::pair<double, std::size_t>> sorted;
    for (std::size_t r = 0; r < references.size(); ++r) {
      sorted.emplace_back(Distance(queries[q], references[r]), r);
    }
    std::sort(sorted.begin(), sorted.end());
    if (sorted.size() >= 2 && sorted[0].first / sorted[1].first <= ratio) {
      matches.push_back({static_cast<std::uint32_t>(q),
                         static_cast<std::uint32_t>(sorted[0].second),
                         static_cast<std::int32_t>(
                             std::lround(sorted[0].first * sorted[0].first))});
    }
  }
  return matches;
}

// Sizes around the block (64) and the lanes (4, 16) of the implementations.
class MatchSizes : public testing::TestWithParam<std::tuple<int, Arithmetic>> {
};

TEST_P(MatchSizes, AgreesWithTheDefinition) {
  const std::vector<map::Descriptor> references =
      RandomDescriptors(std::get<0>(GetParam()), 1);
  const Arithmetic arithmetic = std::get<1>(GetParam());
  std::vector<map::Descriptor> queries = Noisy(references, 2);
  const std::vector<map::Descriptor> others = RandomDescriptors(30, 3);
  queries.insert(queries.end(), others.begin(), others.end());
  for (const double ratio : {0.5, 0.8, 0.95}) {
    EXPECT_EQ(MatchDescriptors(DescriptorSet(queries, arithmetic),
                               DescriptorSet(references, arithmetic),
                               ratio),
              Reference(queries, references, ratio));
  }
}

INSTANTIATE_TEST_SUITE_P(
    Sizes,
    MatchSizes,
    testing::Combine(testing::Values(2, 3, 4, 5, 15, 16, 17, 63, 64, 65, 131),
                     testing::Values(Arithmetic::kFastest,
                                     Arithmetic::kPortable)));

TEST(MatchDescriptors, NeedsASecondNeighbour) {
  const std::vector<map::Descriptor> one = RandomDescriptors(1, 1);
  EXPECT_TRUE(
      MatchDescriptors(DescriptorSet(one), DescriptorSet(one), 0.8).empty());
  EXPECT_TRUE(
      MatchDescriptors(DescriptorSet(one), DescriptorSet(), 0.8).empty());
  EXPECT_TRUE(
      MatchDescriptors(DescriptorSet(), DescriptorSet(one), 0.8).empty());
}

TEST(MatchDescriptors, TwinsAreAmbiguous) {
  std::vector<map::Descriptor> references = RandomDescriptors(5, 1);
  references[3] = references[1];
  const std::vector<map::Descriptor> query = {references[1]};
  EXPECT_TRUE(
      MatchDescriptors(DescriptorSet(query), DescriptorSet(references), 0.8)
          .empty());
}

TEST(MatchDescriptors, ExtremesDoNotOverflow) {
  std::vector<map::Descriptor> references(3);
  references[0].fill(255);
  references[1].fill(0);
  references[2].fill(128);
  for (const Arithmetic arithmetic :
       {Arithmetic::kFastest, Arithmetic::kPortable}) {
    for (std::uint32_t i = 0; i < references.size(); ++i) {
      const auto matches = MatchDescriptors(
          DescriptorSet(std::vector{references[i]}, arithmetic),
          DescriptorSet(references, arithmetic),
          0.8);
      ASSERT_EQ(matches.size(), 1U);
      EXPECT_EQ(matches[0].reference, i);
      EXPECT_EQ(matches[0].squared_distance, 0);
    }
    // As far apart as it gets: 128 * 255^2, and 128 * 128^2 for the nearest.
    const auto far = MatchDescriptors(
        DescriptorSet(std::vector{references[1]}, arithmetic),
        DescriptorSet(std::vector{references[0], references[2]}, arithmetic),
        0.8);
    ASSERT_EQ(far.size(), 1U);
    EXPECT_EQ(far[0].reference, 1U);
    EXPECT_EQ(far[0].squared_distance, 128 * 128 * 128);
  }
}

}  // namespace
}  // namespace groundlock::features
