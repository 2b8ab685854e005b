// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <limits>
#include <set>

#include "absl/strings/str_cat.h"
#include "map_store/base/order_statistics.h"
#include "map_store/base/status.h"
#include "map_store/build/grow.h"
#include "map_store/build/internal/bundle_adjustment.h"
#include "map_store/build/internal/landmark_matching.h"
#include "map_store/build/internal/map_filter.h"
#include "map_store/build/internal/similarity_ransac.h"
#include "map_store/map/landmark_index.h"

namespace groundlock::build {
namespace {

using internal::ObservationId;

constexpr double kRatioTest = 0.85;
constexpr double kMaxMergedError_px = 4.0;
// Of a landmark; the look from further sides.
constexpr std::size_t kDescriptorsTried = 3;
constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();

// Landmarks of the second map and those of the first that look like them.
struct Candidate {
  std::uint32_t second = 0;
  std::uint32_t first = 0;
};

std::vector<Candidate> FindCandidates(const map::MapData& first,
                                      const map::MapData& second) {
  const map::LandmarkIndexData index = map::BuildLandmarkIndex(first, 2);
  const auto observations = internal::ObservationsByLandmark(second);
  std::vector<map::Descriptor> queries;
  std::vector<std::uint32_t> landmark_of;
  for (std::uint32_t i = 0; i < observations.size(); ++i) {
    const auto& seen = observations[i];
    const std::size_t count = std::min(kDescriptorsTried, seen.size());
    for (std::size_t k = 0; k < count; ++k) {
      const ObservationId& id = seen[k * seen.size() / count];
      queries.push_back(second.views[id.view].descriptors[id.feature]);
      landmark_of.push_back(i);
    }
  }
  // A landmark that finds several keeps the nearest.
  std::vector<internal::LandmarkMatch> best(observations.size(), {0, kNone, 0});
  for (const internal::LandmarkMatch& match :
       internal::MatchToLandmarks(queries, map::ViewOf(index), kRatioTest)) {
    internal::LandmarkMatch& known = best[landmark_of[match.query]];
    if (known.landmark == kNone ||
        match.squared_distance < known.squared_distance) {
      known = match;
    }
  }
  std::vector<Candidate> candidates;
  for (std::uint32_t i = 0; i < best.size(); ++i) {
    if (best[i].landmark != kNone) candidates.push_back({i, best[i].landmark});
  }
  return candidates;
}

// How far `p_world` projects from where the landmark was seen, in the first and
// the last of its views: the worse of the two.
double ErrorPx(const map::MapData& data,
               const std::vector<ObservationId>& seen,
               const Eigen::Vector3d& p_world) {
  double worst = 0.0;
  for (const ObservationId& id : {seen.front(), seen.back()}) {
    const map::MapViewData& view = data.views[id.view];
    const auto pixel = data.cameras[view.camera].ImageFromCamera(
        view.camera_from_world * p_world);
    if (!pixel) return std::numeric_limits<double>::infinity();
    worst = std::max(
        worst, (*pixel - view.keypoints_px[id.feature].cast<double>()).norm());
  }
  return worst;
}

// Adds `second`, whose world has become that of `first`; landmark i becomes
// fused[i] of the first map, or a new one.
void Append(const map::MapData& second,
            const std::vector<std::uint32_t>& fused,
            map::MapData* first) {
  std::vector<std::uint32_t> renumbered = fused;
  for (std::size_t i = 0; i < second.landmarks.size(); ++i) {
    if (renumbered[i] != kNone) continue;
    renumbered[i] = static_cast<std::uint32_t>(first->landmarks.size());
    first->landmarks.push_back(second.landmarks[i]);
  }
  const auto first_camera = static_cast<std::uint32_t>(first->cameras.size());
  first->cameras.insert(
      first->cameras.end(), second.cameras.begin(), second.cameras.end());
  std::set<std::string> names;
  for (const map::MapViewData& view : first->views) names.insert(view.name);
  for (map::MapViewData view : second.views) {
    while (!names.insert(view.name).second) view.name = "2_" + view.name;
    view.camera += first_camera;
    for (std::uint32_t& landmark : view.landmarks) {
      landmark = renumbered[landmark];
    }
    first->views.push_back(std::move(view));
  }
}

}  // namespace

absl::StatusOr<MergeReport> MergeMaps(const map::MapData& second,
                                      const MergeOptions& options,
                                      const ProgressCallback& progress,
                                      map::MapData* first) {
  const auto alive = [&progress](const char* stage) {
    return !progress || progress({stage, 0.0, ""})
               ? absl::OkStatus()
               : absl::CancelledError("cancelled");
  };
  RETURN_IF_ERROR(alive("matching"));
  if (!first->has_descriptors() || !second.has_descriptors()) {
    return absl::FailedPreconditionError(
        "a map without descriptors cannot be merged: nothing tells which of "
        "its landmarks are the other map's");
  }
  const std::vector<Candidate> candidates = FindCandidates(*first, second);
  const auto observations = internal::ObservationsByLandmark(*first);
  std::vector<internal::PointPair> pairs;
  for (const Candidate& candidate : candidates) {
    pairs.push_back({second.landmarks[candidate.second].p_world,
                     first->landmarks[candidate.first].p_world});
  }
  internal::SimilarityRansacOptions ransac;
  ransac.max_error = options.max_error_px;
  ransac.min_inliers = options.min_common_landmarks;
  ransac.seed = options.seed;
  const auto error = [&](std::size_t i, const Eigen::Vector3d& p_world) {
    return ErrorPx(*first, observations[candidates[i].first], p_world);
  };
  const auto found = internal::EstimateSimilarityRansac(pairs, error, ransac);
  if (!found) {
    return absl::FailedPreconditionError(absl::StrCat(
        "the maps have too little in common: ",
        pairs.size(),
        " landmarks look alike, but fewer than ",
        options.min_common_landmarks,
        " lie where one similarity puts them. Maps to be merged have to show "
        "the same place in part, from similar sides"));
  }
  MergeReport report;
  report.first_from_second = found->target_from_source;
  report.num_candidates = static_cast<int>(candidates.size());
  report.num_common_landmarks = found->num_inliers;
  std::vector<std::uint32_t> fused(second.landmarks.size(), kNone);
  std::vector<double> errors;
  std::vector<double> distances;
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    if (!found->is_inlier[i]) continue;
    fused[candidates[i].second] = candidates[i].first;
    const Eigen::Vector3d moved = found->target_from_source * pairs[i].p_source;
    errors.push_back(error(i, moved));
    distances.push_back((moved - pairs[i].p_target).norm());
  }
  report.median_error_px = base::Median(errors);
  report.median_distance = base::Median(distances);

  RETURN_IF_ERROR(alive("adjusting"));
  const std::size_t num_old_views = first->views.size();
  const std::size_t num_old_landmarks = first->landmarks.size();
  map::MapData moved = second;
  moved.Transform(found->target_from_source);
  Append(moved, fused, first);
  std::vector<internal::PosePrior> priors(first->views.size());
  for (std::size_t v = 0; v < num_old_views; ++v) priors[v].is_fixed = true;
  internal::AdjustmentOptions adjustment;
  adjustment.threads = options.threads;
  adjustment.landmark_is_fixed.resize(first->landmarks.size());
  std::fill_n(adjustment.landmark_is_fixed.begin(), num_old_landmarks, true);
  adjustment.is_cancelled = [&alive] { return !alive("adjusting").ok(); };
  RETURN_IF_ERROR(internal::AdjustMap(priors, adjustment, first));
  internal::FilterMap(2, kMaxMergedError_px, first);
  return report;
}

}  // namespace groundlock::build
