// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/landmark_index.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <string>
#include <vector>

namespace groundlock::map {
namespace {

using Values = std::array<double, 128>;

// As RootSIFT: not negative, 512 long. Unrelated ones lie at about 500.
Values RandomValues(std::mt19937_64& engine) {
  std::exponential_distribution<double> exponential;
  Values values;
  double sum = 0.0;
  for (double& value : values) {
    value = exponential(engine);
    sum += value * value;
  }
  for (double& value : values) value *= 512.0 / std::sqrt(sum);
  return values;
}

// `distance` away, in expectation.
Descriptor Noisy(const Values& values,
                 double distance,
                 std::mt19937_64& engine) {
  std::normal_distribution<double> noise(0.0, distance / std::sqrt(128.0));
  Descriptor descriptor;
  for (int i = 0; i < 128; ++i) {
    descriptor[i] = static_cast<std::uint8_t>(
        std::clamp(std::lround(values[i] + noise(engine)), 0L, 255L));
  }
  return descriptor;
}

struct Looks {
  std::vector<Values> of_landmark;
  MapData map;
};

// Every landmark is seen in three views, the last ten in two.
Looks MakeLooks(int num_landmarks) {
  std::mt19937_64 engine(1);
  Looks looks;
  looks.map.landmarks.resize(num_landmarks);
  looks.map.views.resize(3);
  for (int i = 0; i < num_landmarks; ++i) {
    looks.of_landmark.push_back(RandomValues(engine));
    for (int v = 0; v < (i < num_landmarks - 10 ? 3 : 2); ++v) {
      looks.map.views[v].landmarks.push_back(i);
      looks.map.views[v].descriptors.push_back(
          Noisy(looks.of_landmark.back(), 100.0, engine));
    }
  }
  return looks;
}

// The definition, word for word, over all descriptors of the map that the index
// holds.
IndexMatch BruteForce(const LandmarkIndex& index, const Descriptor& query) {
  std::vector<int> nearest(20'000, std::numeric_limits<int>::max());
  for (std::size_t i = 0; i < index.entry_landmarks.size(); ++i) {
    int& of_landmark = nearest[index.entry_landmarks[i]];
    of_landmark = std::min(of_landmark,
                           SquaredDistance(index.entry_descriptors[i], query));
  }
  IndexMatch match;
  for (std::uint32_t i = 0; i < nearest.size(); ++i) {
    if (nearest[i] < match.squared_distance) {
      match.second_squared_distance = match.squared_distance;
      match.squared_distance = nearest[i];
      match.landmark = i;
    } else {
      match.second_squared_distance =
          std::min(match.second_squared_distance, nearest[i]);
    }
  }
  return match;
}

TEST(SquaredDistance, IsEuclidean) {
  Descriptor a{};
  Descriptor b{};
  EXPECT_EQ(SquaredDistance(a, b), 0);
  b.fill(255);
  EXPECT_EQ(SquaredDistance(a, b), 128 * 255 * 255);
  EXPECT_EQ(SquaredDistance(b, a), 128 * 255 * 255);
  b.fill(0);
  b[127] = 3;
  b[0] = 4;
  EXPECT_EQ(SquaredDistance(a, b), 25);
}

TEST(LandmarkIndex, FindsTheNearestOfNoisyQueries) {
  const Looks looks = MakeLooks(4'000);
  const LandmarkIndexData data = BuildLandmarkIndex(looks.map);
  const LandmarkIndex index = ViewOf(data);
  ASSERT_TRUE(HasConsistentSizes(index));
  ASSERT_TRUE(VerifyIndex(index, 4'000).ok());
  std::mt19937_64 engine(2);
  constexpr int kQueries = 500;
  int found = 0;
  int same_second = 0;
  for (int i = 0; i < kQueries; ++i) {
    const auto landmark = static_cast<std::uint32_t>(engine() % 3'990);
    const Descriptor query = Noisy(looks.of_landmark[landmark], 150.0, engine);
    const IndexMatch truth = BruteForce(index, query);
    ASSERT_EQ(truth.landmark, landmark);
    const IndexMatch match = FindLandmark(index, query, 12);
    found += match.landmark == truth.landmark;
    // What was not looked into can only be missing.
    EXPECT_GE(match.squared_distance, truth.squared_distance);
    EXPECT_GE(match.second_squared_distance, match.squared_distance);
    if (match.landmark == truth.landmark) {
      EXPECT_GE(match.second_squared_distance, truth.second_squared_distance);
      same_second += match.second_squared_distance <
                     1.3 * 1.3 * truth.second_squared_distance;
    }
  }
  EXPECT_GT(found, kQueries * 95 / 100);
  // The second nearest, far away, need not be the very one, but is one as far.
  EXPECT_GT(same_second, kQueries * 90 / 100);
}

TEST(LandmarkIndex, LooksIntoAllListsIfAskedTo) {
  const Looks looks = MakeLooks(300);
  const LandmarkIndexData data = BuildLandmarkIndex(looks.map);
  const LandmarkIndex index = ViewOf(data);
  ASSERT_EQ(index.branching, 4U);  // all inner words are looked into
  std::mt19937_64 engine(3);
  for (int i = 0; i < 100; ++i) {
    // Whatever the query: these are near nothing.
    const Descriptor query = Noisy(RandomValues(engine), 200.0, engine);
    const IndexMatch truth = BruteForce(index, query);
    const IndexMatch match = FindLandmark(index, query, 1'000'000);
    EXPECT_EQ(match.squared_distance, truth.squared_distance);
    EXPECT_EQ(match.second_squared_distance, truth.second_squared_distance);
  }
}

TEST(LandmarkIndex, SecondNearestIsOfAnotherLandmark) {
  // Two landmarks, each of two clearly different looks.
  std::mt19937_64 engine(4);
  MapData map;
  map.landmarks.resize(2);
  map.views.resize(6);
  std::vector<Values> looks;
  for (int i = 0; i < 4; ++i) looks.push_back(RandomValues(engine));
  for (int v = 0; v < 6; ++v) {
    for (std::uint32_t landmark = 0; landmark < 2; ++landmark) {
      map.views[v].landmarks.push_back(landmark);
      map.views[v].descriptors.push_back(
          Noisy(looks[2 * landmark + v % 2], 20.0, engine));
    }
  }
  const LandmarkIndexData data = BuildLandmarkIndex(map);
  // Both looks are kept, near copies are not.
  EXPECT_EQ(data.entry_landmarks.size(), 4U);
  for (std::uint32_t look = 0; look < 4; ++look) {
    const Descriptor query = Noisy(looks[look], 50.0, engine);
    const IndexMatch match = FindLandmark(ViewOf(data), query, 100);
    EXPECT_EQ(match.landmark, look / 2);
    EXPECT_LT(match.squared_distance, 100 * 100);
    // The landmark's own other look is as far as the other landmark's: the
    // nearest of the other landmark is what counts.
    int other = std::numeric_limits<int>::max();
    for (std::size_t i = 0; i < data.entry_landmarks.size(); ++i) {
      if (data.entry_landmarks[i] == look / 2) continue;
      other =
          std::min(other, SquaredDistance(data.entry_descriptors[i], query));
    }
    EXPECT_EQ(match.second_squared_distance, other);
  }
}

TEST(LandmarkIndex, HoldsLandmarksOfEnoughViewsAndNoMoreThanFourLooks) {
  const Looks looks = MakeLooks(500);
  const LandmarkIndexData three = BuildLandmarkIndex(looks.map, 3);
  const LandmarkIndexData two = BuildLandmarkIndex(looks.map, 2);
  const auto landmarks_of = [](const LandmarkIndexData& index) {
    std::vector<int> count(500);
    for (const std::uint32_t landmark : index.entry_landmarks) {
      ++count[landmark];
    }
    return count;
  };
  const std::vector<int> in_three = landmarks_of(three);
  const std::vector<int> in_two = landmarks_of(two);
  for (int i = 0; i < 500; ++i) {
    EXPECT_EQ(in_three[i] > 0, i < 490) << i;
    EXPECT_GT(in_two[i], 0) << i;
    EXPECT_LE(in_two[i], kMaxDescriptorsPerLandmark);
  }

  std::mt19937_64 engine(5);
  MapData many;
  many.landmarks.resize(1);
  for (int v = 0; v < 20; ++v) {
    many.views.emplace_back().landmarks = {0};
    many.views.back().descriptors = {Noisy(RandomValues(engine), 0.0, engine)};
  }
  EXPECT_EQ(BuildLandmarkIndex(many).entry_landmarks.size(),
            static_cast<std::size_t>(kMaxDescriptorsPerLandmark));
}

TEST(LandmarkIndex, IsDeterministic) {
  const Looks looks = MakeLooks(500);
  const LandmarkIndexData one = BuildLandmarkIndex(looks.map);
  const LandmarkIndexData two = BuildLandmarkIndex(looks.map);
  EXPECT_EQ(one.inner_words, two.inner_words);
  EXPECT_EQ(one.leaf_words, two.leaf_words);
  EXPECT_EQ(one.list_begin, two.list_begin);
  EXPECT_EQ(one.entry_landmarks, two.entry_landmarks);
  EXPECT_EQ(one.entry_descriptors, two.entry_descriptors);
}

TEST(LandmarkIndex, EmptyMapsHaveAnEmptyIndex) {
  MapData without_descriptors;
  without_descriptors.landmarks.resize(3);
  without_descriptors.views.emplace_back().landmarks = {0, 1, 2};
  for (const MapData& map : {MapData(), without_descriptors}) {
    const LandmarkIndexData data = BuildLandmarkIndex(map);
    const LandmarkIndex index = ViewOf(data);
    EXPECT_TRUE(index.empty());
    EXPECT_TRUE(HasConsistentSizes(index));
    EXPECT_TRUE(VerifyIndex(index, map.landmarks.size()).ok());
    EXPECT_EQ(FindLandmark(index, Descriptor{}, 12).landmark,
              IndexMatch::kNone);
  }
}

TEST(LandmarkIndex, OneLandmarkIsFoundAndHasNoRival) {
  MapData map;
  map.landmarks.resize(1);
  for (int v = 0; v < 3; ++v) {
    map.views.emplace_back().landmarks = {0};
    map.views.back().descriptors.emplace_back().fill(7);
  }
  const LandmarkIndexData data = BuildLandmarkIndex(map);
  const IndexMatch match = FindLandmark(ViewOf(data), Descriptor{}, 1);
  EXPECT_EQ(match.landmark, 0U);
  EXPECT_EQ(match.squared_distance, 128 * 49);
  EXPECT_EQ(match.second_squared_distance, std::numeric_limits<int>::max());
}

// Damage that Map::Open does not read for must be found by VerifyIndex, and
// must not lead FindLandmark outside (the address sanitizer would see it).
TEST(LandmarkIndex, DamageIsFoundAndHarmless) {
  const Looks looks = MakeLooks(500);
  const LandmarkIndexData good = BuildLandmarkIndex(looks.map);
  const auto expect_damaged = [&](const LandmarkIndexData& data,
                                  const std::string& cause) {
    const LandmarkIndex index = ViewOf(data);
    ASSERT_TRUE(HasConsistentSizes(index));
    const absl::Status status = VerifyIndex(index, 500);
    EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
    EXPECT_NE(std::string(status.message()).find(cause), std::string::npos)
        << status;
    for (const Descriptor& query : good.entry_descriptors) {
      FindLandmark(index, query, 1'000);
    }
  };
  LandmarkIndexData damaged = good;
  damaged.list_begin[5] = std::uint64_t{1} << 60U;
  expect_damaged(damaged, "index list begin");
  damaged = good;
  damaged.list_begin.back() += 1;
  expect_damaged(damaged, "index list begin");
  damaged = good;
  damaged.list_begin.front() = 1;
  expect_damaged(damaged, "index list begin");
  damaged = good;
  damaged.entry_landmarks[7] = 500;
  expect_damaged(damaged, "index landmarks");
}

TEST(LandmarkIndex, ArraysMustFitTogether) {
  const LandmarkIndexData good = BuildLandmarkIndex(MakeLooks(500).map);
  EXPECT_TRUE(HasConsistentSizes(ViewOf(good)));
  const auto expect_unfit = [&](auto&& change) {
    LandmarkIndexData data = good;
    change(data);
    EXPECT_FALSE(HasConsistentSizes(ViewOf(data)));
  };
  expect_unfit([](auto& index) { index.branching += 1; });
  expect_unfit([](auto& index) { index.branching = 0; });
  expect_unfit([](auto& index) { index.branching = 1'000'000; });
  expect_unfit([](auto& index) { index.inner_words.pop_back(); });
  expect_unfit([](auto& index) { index.leaf_words.pop_back(); });
  expect_unfit([](auto& index) { index.list_begin.pop_back(); });
  expect_unfit([](auto& index) { index.list_begin.clear(); });
  expect_unfit([](auto& index) { index.entry_landmarks.pop_back(); });
  expect_unfit([](auto& index) { index.entry_descriptors.pop_back(); });
}

}  // namespace
}  // namespace groundlock::map
