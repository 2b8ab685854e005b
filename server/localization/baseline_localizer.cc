// SPDX-License-Identifier: Apache-2.0
#include "server/localization/baseline_localizer.h"

#include <algorithm>
#include <array>
#include <numeric>
#include <tuple>
#include <unordered_set>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "map_store/geometry/pose_ransac.h"
#include "server/localization/search/guided_matching.h"
#include "server/localization/state_fields.h"
#include "server/localization/state_message.h"

namespace groundlock::localization {
namespace {

constexpr std::string_view kStateName = "baseline";

using geometry::CameraModel;
using geometry::Rigid3;

// Rounds of refinement and of choosing the inliers anew. The set hardly changes
// after the second.
constexpr int kRefinementRounds = 2;
// A pose is worth completing with a quarter of the inliers that verify it; a
// dozen hardly ever agree by chance on six unknowns.
constexpr std::size_t kRoughDivisor = 4;
constexpr std::size_t kMinRoughInliers = 12;
// The best rough pose is completed once this many views have failed, and again
// once all have: the first that comes may be right in one corner only.
constexpr int kViewsBeforeCompletion = 8;
// First what a rough pose is off by, then what a refined one is.
constexpr std::array kGuidedRadii_px = {12.0, 8.0};
// Motion blur puts features farther off than the method's gate allows. Guided
// matches have been checked by their place already, so theirs is wider.
constexpr double kGuidedGateFactor = 1.5;
constexpr int kGuidedViews = 30;  // blurred frames need every landmark in sight
constexpr double kMinGuidedInlierShare = 0.4;

// Adds the time from construction to destruction to a stage of the report.
class StageTimer {
 public:
  explicit StageTimer(std::chrono::nanoseconds& stage)
      : stage_(stage), begin_(std::chrono::steady_clock::now()) {}
  StageTimer(const StageTimer&) = delete;
  StageTimer& operator=(const StageTimer&) = delete;
  ~StageTimer() { stage_ += std::chrono::steady_clock::now() - begin_; }

 private:
  std::chrono::nanoseconds& stage_;
  std::chrono::steady_clock::time_point begin_;
};

template <typename T>
std::vector<T> Select(const std::vector<T>& values,
                      const std::vector<int>& indices) {
  std::vector<T> selected;
  selected.reserve(indices.size());
  for (const int index : indices) selected.push_back(values[index]);
  return selected;
}

double MedianDepth(const Rigid3& world_from_camera,
                   std::vector<Eigen::Vector3d> p_world) {
  if (p_world.empty()) return 0.0;
  const auto depth = [&](const Eigen::Vector3d& p) {
    return (p - world_from_camera.translation).squaredNorm();
  };
  const auto middle = p_world.begin() + p_world.size() / 2;
  std::nth_element(
      p_world.begin(),
      middle,
      p_world.end(),
      [&](const auto& a, const auto& b) { return depth(a) < depth(b); });
  return std::sqrt(depth(*middle));
}

}  // namespace

std::vector<std::uint32_t> OrderViews(
    const map::Map& map,
    const std::optional<Eigen::Vector3d>& center_world,
    std::optional<std::uint32_t> last_view) {
  std::vector<double> cost(map.num_views());
  for (std::size_t i = 0; i < cost.size(); ++i) {
    const map::MapView& view = map.view(i);
    cost[i] = center_world ? (view.center_world - *center_world).squaredNorm()
                           : -1.0 * view.num_features;
  }
  std::vector<std::uint32_t> order(cost.size());
  std::iota(order.begin(), order.end(), 0U);
  std::sort(order.begin(), order.end(), [&](auto a, auto b) {
    return std::tuple(a != last_view, cost[a], a) <
           std::tuple(b != last_view, cost[b], b);
  });
  return order;
}

BaselineLocalizer::BaselineLocalizer(std::shared_ptr<const map::Map> map,
                                     const LocalizerOptions& options)
    : map_(std::move(map)),
      options_(options),
      state_(options.lost_after, HoldModel{}) {}

void BaselineLocalizer::Reset() {
  state_.Reset();
  last_view_.reset();
}

std::string BaselineLocalizer::Save() const {
  StateMessageWriter writer;
  StateValue(writer, state_);
  Field(writer, "last_view", last_view_);
  return writer.Message(kStateName, *map_);
}

absl::Status BaselineLocalizer::Restore(std::string_view state) {
  StateMessageReader reader(state);
  RETURN_IF_ERROR(reader.Open(kStateName, *map_));
  CameraStateMachine machine = state_;
  std::optional<std::uint32_t> last_view;
  StateValue(reader, machine);
  Field(reader, "last_view", last_view);
  if (last_view && *last_view >= map_->num_views()) {
    reader.Fail("is no view of the map");
  }
  RETURN_IF_ERROR(reader.Close());
  state_ = std::move(machine);
  last_view_ = last_view;
  return absl::OkStatus();
}

std::vector<LandmarkCandidate> MakeUnique(
    std::vector<LandmarkCandidate> candidates) {
  std::sort(candidates.begin(), candidates.end());
  std::unordered_set<std::uint32_t> landmarks;
  std::unordered_set<std::uint32_t> features;
  std::erase_if(candidates, [&](const LandmarkCandidate& candidate) {
    if (landmarks.contains(candidate.landmark) ||
        features.contains(candidate.feature)) {
      return true;
    }
    landmarks.insert(candidate.landmark);
    features.insert(candidate.feature);
    return false;
  });
  return candidates;
}

std::vector<LandmarkCandidate> BaselineLocalizer::MatchView(
    const map::MapView& view,
    const features::DescriptorSet& descriptors) const {
  const std::span<const map::Feature> view_features = map_->FeaturesOf(view);
  std::vector<LandmarkCandidate> candidates;
  for (const features::DescriptorMatch& match : features::MatchDescriptors(
           descriptors,
           features::DescriptorSet(map_->DescriptorsOf(view)),
           options_.ratio_test)) {
    const std::uint32_t landmark = view_features[match.reference].landmark;
    if (map_->landmarks()[landmark].num_observations >=
        static_cast<std::uint32_t>(options_.min_landmark_views)) {
      candidates.push_back({.squared_distance = match.squared_distance,
                            .feature = match.query,
                            .landmark = landmark});
    }
  }
  return MakeUnique(std::move(candidates));
}

Correspondences BaselineLocalizer::MakeCorrespondences(
    std::span<const LandmarkCandidate> candidates,
    const features::SiftFeatures& features) const {
  Correspondences correspondences;
  for (const LandmarkCandidate& candidate : candidates) {
    correspondences.landmarks.push_back(candidate.landmark);
    correspondences.p_world.push_back(
        map_->landmarks()[candidate.landmark].Position());
    correspondences.pixel_px.push_back(
        features.keypoints_px[candidate.feature]);
  }
  return correspondences;
}

bool BaselineLocalizer::Refine(const CameraModel& camera,
                               double max_error_px,
                               std::size_t min_inliers,
                               Estimate& estimate) const {
  const Correspondences& correspondences = estimate.correspondences;
  for (int round = 0; round < kRefinementRounds; ++round) {
    const auto refined =
        RefinePose(camera,
                   Select(correspondences.p_world, estimate.inliers),
                   Select(correspondences.pixel_px, estimate.inliers),
                   estimate.pose.world_from_camera,
                   {.loss_scale_px = 0.5 * max_error_px});
    if (!refined.ok()) return false;
    estimate.pose = *refined;
    estimate.inliers =
        geometry::FindInliers(camera,
                              refined->world_from_camera.Inverse(),
                              correspondences.p_world,
                              correspondences.pixel_px,
                              max_error_px);
  }
  return estimate.inliers.size() >= min_inliers;
}

std::optional<BaselineLocalizer::Estimate> BaselineLocalizer::EstimatePose(
    const CameraModel& camera,
    Correspondences correspondences,
    std::size_t min_inliers,
    std::uint64_t seed,
    LocalizationReport& report) const {
  report.num_matches = static_cast<int>(correspondences.size());
  if (correspondences.size() < min_inliers) return std::nullopt;
  Estimate estimate{
      .correspondences = std::move(correspondences), .pose = {}, .inliers = {}};
  {
    const StageTimer timer(report.ransac_time);
    auto ransac = geometry::EstimatePoseRansac(
        camera,
        estimate.correspondences.p_world,
        estimate.correspondences.pixel_px,
        {.max_error_px = options_.max_error_px,
         .confidence = options_.ransac_confidence,
         .max_iterations = options_.ransac_max_iterations,
         .seed = seed});
    if (!ransac.ok()) return std::nullopt;
    report.ransac_iterations += ransac->iterations;
    estimate.pose.world_from_camera = ransac->camera_from_world.Inverse();
    estimate.inliers = std::move(ransac->inliers);
  }
  // The pose of three points alone is rough: refinement wins inliers. Less than
  // half of the number that is asked for is hopeless, though.
  if (estimate.inliers.size() < min_inliers / 2) return std::nullopt;
  const StageTimer timer(report.refinement_time);
  if (!Refine(camera, options_.max_error_px, min_inliers, estimate)) {
    return std::nullopt;
  }
  return estimate;
}

std::optional<BaselineLocalizer::Estimate> BaselineLocalizer::Complete(
    const CameraModel& camera,
    const features::SiftFeatures& features,
    const Estimate& rough,
    LocalizationReport& report) const {
  Estimate estimate = rough;
  for (const double radius_px : kGuidedRadii_px) {
    estimate.correspondences = {};
    {
      const StageTimer timer(report.matching_time);
      for (const LandmarkMatch& match :
           MatchGuided(*map_,
                       features,
                       camera,
                       estimate.pose.world_from_camera,
                       {.radius_px = radius_px,
                       .max_views = kGuidedViews,
                       .min_landmark_views = options_.min_landmark_views})) {
        estimate.correspondences.landmarks.push_back(match.landmark);
        estimate.correspondences.p_world.push_back(
            map_->landmarks()[match.landmark].Position());
        estimate.correspondences.pixel_px.push_back(match.pixel_px);
      }
    }
    report.num_matches = static_cast<int>(estimate.correspondences.size());
    const StageTimer timer(report.refinement_time);
    estimate.inliers =
        geometry::FindInliers(camera,
                              estimate.pose.world_from_camera.Inverse(),
                              estimate.correspondences.p_world,
                              estimate.correspondences.pixel_px,
                              0.5 * radius_px);
    if (!Refine(camera,
                kGuidedGateFactor * options_.max_error_px,
                rough.inliers.size(),
                estimate)) {
      return std::nullopt;
    }
  }
  // A pose that is right in one corner only gathers matches there, and chance
  // ones elsewhere: of these one in seven passes the gate (3 px of 8, squared).
  const double inlier_share =
      static_cast<double>(estimate.inliers.size()) /
      static_cast<double>(estimate.correspondences.size());
  if (estimate.inliers.size() <
          static_cast<std::size_t>(options_.min_inliers) ||
      inlier_share < kMinGuidedInlierShare) {
    return std::nullopt;
  }
  return estimate;
}

void BaselineLocalizer::Accept(const Estimate& estimate,
                               std::chrono::nanoseconds time,
                               LocalizationResult& result) {
  const Correspondences& correspondences = estimate.correspondences;
  result.num_inliers = static_cast<int>(estimate.inliers.size());
  result.mean_reprojection_error_px = estimate.pose.mean_error_px;
  result.inliers.reserve(estimate.inliers.size());
  for (const int index : estimate.inliers) {
    result.inliers.push_back(
        {correspondences.landmarks[index], correspondences.pixel_px[index]});
  }
  state_.Succeed(time,
                 estimate.pose.world_from_camera,
                 estimate.pose.covariance,
                 MedianDepth(estimate.pose.world_from_camera,
                             Select(correspondences.p_world, estimate.inliers)),
                 result);
}

absl::StatusOr<LocalizationResult> BaselineLocalizer::Localize(
    const LocalizationRequest& request) {
  RETURN_IF_ERROR(ValidateRequest(request));
  RETURN_IF_ERROR(base::Annotate(map_->damage(), "the map is damaged"));
  const image::Frame& frame = *request.frame;
  std::optional<Eigen::Vector3d> near_world;
  if (const auto& last = state_.last()) {
    near_world = last->world_from_camera.translation;
  }
  if (request.prior) {
    ASSIGN_OR_RETURN(const PosePrior prior,
                     PlaceInWorld(*map_, *request.prior));
    if (prior.position_world) near_world = prior.position_world;
  }
  LocalizationResult result;
  LocalizationReport& report = result.report;
  features::SiftFeatures features;
  {
    const StageTimer timer(report.features_time);
    ASSIGN_OR_RETURN(
        features,
        features::ExtractSift(
            frame.luma,
            request.masks_px,
            {.max_features = options_.max_features,
             .contrast_threshold = options_.sift_contrast_threshold}));
    report.num_features = static_cast<int>(features.keypoints_px.size());
  }
  const features::DescriptorSet descriptors(features.descriptors);
  std::vector<std::uint32_t> order = OrderViews(*map_, near_world, last_view_);
  const std::uint64_t frame_seed = base::MixSeed(options_.seed, frame.sequence);
  const std::size_t min_inliers = options_.min_inliers;
  const std::size_t min_rough_inliers =
      std::max(min_inliers / kRoughDivisor, kMinRoughInliers);
  std::optional<Estimate> best_rough;
  std::uint32_t best_rough_view = 0;
  const auto accept = [&](const Estimate& estimate, std::uint32_t view) {
    last_view_ = view;
    Accept(estimate, frame.capture_time, result);
  };
  for (const std::uint32_t view : order) {
    ++report.views_tried;
    std::vector<LandmarkCandidate> candidates;
    {
      const StageTimer timer(report.matching_time);
      candidates = MatchView(map_->view(view), descriptors);
    }
    auto estimate = EstimatePose(request.camera,
                                 MakeCorrespondences(candidates, features),
                                 std::min(min_rough_inliers, min_inliers),
                                 base::MixSeed(frame_seed, view),
                                 report);
    if (estimate && estimate->inliers.size() >= min_inliers) {
      accept(*estimate, view);
      return result;
    }
    if (estimate && (!best_rough ||
                     estimate->inliers.size() > best_rough->inliers.size())) {
      best_rough = std::move(estimate);
      best_rough_view = view;
    }
    const bool is_time_to_complete =
        report.views_tried == kViewsBeforeCompletion ||
        report.views_tried == static_cast<int>(order.size());
    if (!best_rough || !is_time_to_complete) continue;
    const auto completed =
        Complete(request.camera, features, *best_rough, report);
    if (completed) {
      accept(*completed, best_rough_view);
      return result;
    }
  }
  state_.Fail(frame.capture_time, std::nullopt, result);
  return result;
}

}  // namespace groundlock::localization
