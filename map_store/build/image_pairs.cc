// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/image_pairs.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/image_features.h"
#include "map_store/features/descriptor_matching.h"

namespace groundlock::build::internal {
namespace {

using Descriptors = std::span<const map::Descriptor>;
using MatrixXfRow =
    Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr int kWords = 48;
constexpr std::size_t kTrainingDescriptors = 20'000;
constexpr int kRounds = 8;
// Of an image: the others say nothing new about what it shows.
constexpr std::size_t kDescribedFeatures = 2'000;
constexpr std::size_t kFirstQuadratic = 16;

MatrixXfRow ToMatrix(std::span<const map::Descriptor* const> descriptors) {
  MatrixXfRow matrix(static_cast<Eigen::Index>(descriptors.size()), 128);
  for (std::size_t i = 0; i < descriptors.size(); ++i) {
    for (int d = 0; d < 128; ++d) {
      matrix(static_cast<Eigen::Index>(i), d) = (*descriptors[i])[d];
    }
  }
  return matrix;
}

// The nearest word of each row.
std::vector<int> Assign(const MatrixXfRow& rows, const MatrixXfRow& words) {
  const Eigen::VectorXf half_lengths = 0.5F * words.rowwise().squaredNorm();
  const MatrixXfRow scores =
      (rows * words.transpose()).rowwise() - half_lengths.transpose();
  std::vector<int> nearest(static_cast<std::size_t>(rows.rows()));
  for (Eigen::Index i = 0; i < rows.rows(); ++i) {
    scores.row(i).maxCoeff(&nearest[static_cast<std::size_t>(i)]);
  }
  return nearest;
}

MatrixXfRow TrainWords(std::span<const Descriptors> images,
                       std::uint64_t seed) {
  std::size_t total = 0;
  for (const Descriptors& image : images) total += image.size();
  std::mt19937_64 engine(base::MixSeed(seed, 0x766c6164));
  std::vector<const map::Descriptor*> sample;
  const double share =
      std::min(1.0,
               static_cast<double>(kTrainingDescriptors) /
                   static_cast<double>(std::max<std::size_t>(total, 1)));
  for (const Descriptors& image : images) {
    for (const map::Descriptor& descriptor : image) {
      const double draw = static_cast<double>(engine() >> 11) * 0x1p-53;
      if (draw < share) sample.push_back(&descriptor);
    }
  }
  const MatrixXfRow rows = ToMatrix(sample);
  const auto num_words = std::min<Eigen::Index>(kWords, rows.rows());
  MatrixXfRow words(num_words, 128);
  for (Eigen::Index w = 0; w < num_words; ++w) {
    words.row(w) = rows.row(w * rows.rows() / num_words);
  }
  for (int round = 0; round < kRounds && num_words > 0; ++round) {
    const std::vector<int> nearest = Assign(rows, words);
    MatrixXfRow sums = MatrixXfRow::Zero(num_words, 128);
    std::vector<int> counts(static_cast<std::size_t>(num_words));
    for (std::size_t i = 0; i < nearest.size(); ++i) {
      sums.row(nearest[i]) += rows.row(static_cast<Eigen::Index>(i));
      ++counts[static_cast<std::size_t>(nearest[i])];
    }
    for (Eigen::Index w = 0; w < num_words; ++w) {
      const int count = counts[static_cast<std::size_t>(w)];
      if (count > 0) words.row(w) = sums.row(w) / static_cast<float>(count);
    }
  }
  return words;
}

}  // namespace

std::vector<Eigen::VectorXf> DescribeImages(std::span<const Descriptors> images,
                                            std::uint64_t seed) {
  const MatrixXfRow words = TrainWords(images, seed);
  std::vector<Eigen::VectorXf> vectors;
  for (const Descriptors& image : images) {
    // An even subsample: detectors may sort by position or by strength.
    std::vector<const map::Descriptor*> chosen;
    const std::size_t count = std::min(image.size(), kDescribedFeatures);
    for (std::size_t i = 0; i < count; ++i) {
      chosen.push_back(&image[i * image.size() / count]);
    }
    MatrixXfRow residuals = MatrixXfRow::Zero(words.rows(), 128);
    if (count > 0 && words.rows() > 0) {
      const MatrixXfRow rows = ToMatrix(chosen);
      const std::vector<int> nearest = Assign(rows, words);
      for (std::size_t i = 0; i < nearest.size(); ++i) {
        residuals.row(nearest[i]) +=
            rows.row(static_cast<Eigen::Index>(i)) - words.row(nearest[i]);
      }
    }
    for (Eigen::Index w = 0; w < residuals.rows(); ++w) {
      const float length = residuals.row(w).norm();
      if (length > 0.0F) residuals.row(w) /= length;
    }
    Eigen::VectorXf vector =
        Eigen::Map<const Eigen::VectorXf>(residuals.data(), residuals.size());
    if (vector.squaredNorm() > 0.0F) vector.normalize();
    vectors.push_back(std::move(vector));
  }
  return vectors;
}

std::vector<ImagePair> ChoosePairs(std::span<const Descriptors> images,
                                   const PairOptions& options) {
  std::vector<ImagePair> pairs;
  const auto add = [&pairs](std::size_t a, std::size_t b) {
    if (a == b) return;
    pairs.push_back({static_cast<std::uint32_t>(std::min(a, b)),
                     static_cast<std::uint32_t>(std::max(a, b))});
  };
  if (images.size() <= options.exhaustive_up_to) {
    for (std::size_t i = 0; i < images.size(); ++i) {
      for (std::size_t j = i + 1; j < images.size(); ++j) add(i, j);
    }
    return pairs;
  }
  for (std::size_t i = 0; i < images.size(); ++i) {
    for (std::size_t step = 1; step <= options.overlap; ++step) {
      if (i + step < images.size()) add(i, i + step);
    }
    for (std::size_t step = kFirstQuadratic; i + step < images.size();
         step *= 2) {
      add(i, i + step);
    }
  }
  const std::vector<Eigen::VectorXf> vectors =
      DescribeImages(images, options.seed);
  for (std::size_t i = 0; i < images.size(); ++i) {
    std::vector<std::pair<float, std::size_t>> alike;
    for (std::size_t j = 0; j < images.size(); ++j) {
      // Neighbours are pairs already; loops are what is looked for.
      const std::size_t apart = i > j ? i - j : j - i;
      if (apart > options.overlap)
        alike.emplace_back(-vectors[i].dot(vectors[j]), j);
    }
    const std::size_t count = std::min(options.similar, alike.size());
    std::partial_sort(alike.begin(),
                      alike.begin() + static_cast<std::ptrdiff_t>(count),
                      alike.end());
    for (std::size_t k = 0; k < count; ++k) add(i, alike[k].second);
  }
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  return pairs;
}

absl::StatusOr<std::vector<PairMatches>> MatchPairs(
    std::span<const Descriptors> descriptors,
    std::span<const ImagePair> pairs,
    double ratio,
    std::size_t min_matches,
    int threads,
    const std::function<bool(std::size_t)>& progress) {
  std::vector<features::DescriptorSet> sets(descriptors.size());
  for (std::size_t i = 0; i < descriptors.size(); ++i) {
    sets[i] = features::DescriptorSet(descriptors[i]);
  }
  std::vector<PairMatches> results(pairs.size());
  RETURN_IF_ERROR(ForEachInParallel(
      pairs.size(),
      threads,
      [&](std::size_t i) {
        const ImagePair pair = pairs[i];
        results[i].pair = pair;
        const auto forward = features::MatchDescriptors(
            sets[pair.first], sets[pair.second], ratio);
        if (forward.size() < min_matches) return absl::OkStatus();
        // Only what was matched is matched back.
        std::vector<map::Descriptor> matched;
        for (const features::DescriptorMatch& match : forward) {
          matched.push_back(descriptors[pair.second][match.reference]);
        }
        const auto back = features::MatchDescriptors(
            features::DescriptorSet(matched), sets[pair.first], 1.0);
        auto& kept = results[i].features;
        for (const features::DescriptorMatch& match : back) {
          const features::DescriptorMatch& way = forward[match.query];
          if (match.reference == way.query) {
            kept.push_back({way.query, way.reference});
          }
        }
        if (kept.size() < min_matches) kept.clear();
        return absl::OkStatus();
      },
      progress));
  return results;
}

}  // namespace groundlock::build::internal
