// SPDX-License-Identifier: Apache-2.0
#include "server/localization/baseline_localizer.h"

#include <algorithm>
#include <numeric>
#include <tuple>
#include <unordered_set>
#include <utility>

#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "server/localization/pose_ransac.h"

namespace groundlock::localization {
namespace {

using geometry::CameraModel;
using geometry::Rigid3;

// Rounds of refinement and of choosing the inliers anew. The set hardly changes
// after the second.
constexpr int kRefinementRounds = 2;

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

Correspondences BaselineLocalizer::MatchView(
    const map::MapView& view,
    const SiftFeatures& features,
    const DescriptorSet& descriptors) const {
  std::vector<DescriptorMatch> matches =
      MatchDescriptors(descriptors,
                       DescriptorSet(map_->DescriptorsOf(view)),
                       options_.ratio_test);
  std::sort(matches.begin(), matches.end(), [](const auto& a, const auto& b) {
    return std::tuple(a.squared_distance, a.query, a.reference) <
           std::tuple(b.squared_distance, b.query, b.reference);
  });
  const std::span<const map::Feature> view_features = map_->FeaturesOf(view);
  // By landmark, not by reference: a view may hold two features of one
  // landmark. SIFT also gives one point several orientations, each a query of
  // its own.
  std::unordered_set<std::uint32_t> used;
  Correspondences correspondences;
  for (const DescriptorMatch& match : matches) {
    const std::uint32_t index = view_features[match.reference].landmark;
    if (!used.insert(index).second) continue;
    const map::Landmark& landmark = map_->landmarks()[index];
    if (landmark.num_observations <
        static_cast<std::uint32_t>(options_.min_landmark_views)) {
      continue;
    }
    correspondences.landmarks.push_back(index);
    correspondences.p_world.push_back(landmark.Position());
    correspondences.pixel_px.push_back(features.keypoints_px[match.query]);
  }
  return correspondences;
}

std::optional<BaselineLocalizer::VerifiedPose> BaselineLocalizer::EstimatePose(
    const CameraModel& camera,
    const Correspondences& correspondences,
    std::uint64_t seed,
    LocalizationReport& report) const {
  const std::size_t min_inliers = options_.min_inliers;
  if (correspondences.size() < min_inliers) return std::nullopt;
  const auto find_inliers = [&](const Rigid3& camera_from_world) {
    return FindInliers(camera,
                       camera_from_world,
                       correspondences.p_world,
                       correspondences.pixel_px,
                       options_.max_error_px);
  };
  VerifiedPose verified;
  {
    const StageTimer timer(report.ransac_time);
    auto ransac =
        EstimatePoseRansac(camera,
                           correspondences.p_world,
                           correspondences.pixel_px,
                           {.max_error_px = options_.max_error_px,
                            .confidence = options_.ransac_confidence,
                            .max_iterations = options_.ransac_max_iterations,
                            .seed = seed});
    if (!ransac.ok()) return std::nullopt;
    report.ransac_iterations += ransac->iterations;
    verified.pose.world_from_camera = ransac->camera_from_world.Inverse();
    verified.inliers = std::move(ransac->inliers);
  }
  // The pose of three points alone is rough: refinement wins inliers. Less than
  // half of the number that is asked for is hopeless, though.
  if (verified.inliers.size() < min_inliers / 2) return std::nullopt;
  const StageTimer timer(report.refinement_time);
  for (int round = 0; round < kRefinementRounds; ++round) {
    const auto refined =
        RefinePose(camera,
                   Select(correspondences.p_world, verified.inliers),
                   Select(correspondences.pixel_px, verified.inliers),
                   verified.pose.world_from_camera,
                   {.loss_scale_px = 0.5 * options_.max_error_px});
    if (!refined.ok()) return std::nullopt;
    verified.pose = *refined;
    verified.inliers = find_inliers(refined->world_from_camera.Inverse());
  }
  if (verified.inliers.size() < min_inliers) return std::nullopt;
  return verified;
}

void BaselineLocalizer::Accept(const VerifiedPose& verified,
                               const Correspondences& correspondences,
                               std::chrono::nanoseconds time,
                               LocalizationResult& result) {
  result.num_inliers = static_cast<int>(verified.inliers.size());
  result.mean_reprojection_error_px = verified.pose.mean_error_px;
  result.inliers.reserve(verified.inliers.size());
  for (const int index : verified.inliers) {
    result.inliers.push_back(
        {correspondences.landmarks[index], correspondences.pixel_px[index]});
  }
  state_.Succeed(time,
                 verified.pose.world_from_camera,
                 verified.pose.covariance,
                 MedianDepth(verified.pose.world_from_camera,
                             Select(correspondences.p_world, verified.inliers)),
                 result);
}

absl::StatusOr<LocalizationResult> BaselineLocalizer::Localize(
    const LocalizationRequest& request) {
  RETURN_IF_ERROR(ValidateRequest(request));
  const image::Frame& frame = *request.frame;
  LocalizationResult result;
  LocalizationReport& report = result.report;
  SiftFeatures features;
  {
    const StageTimer timer(report.features_time);
    ASSIGN_OR_RETURN(
        features,
        ExtractSift(frame.luma,
                    request.masks_px,
                    {.max_features = options_.max_features,
                     .contrast_threshold = options_.sift_contrast_threshold}));
    report.num_features = static_cast<int>(features.keypoints_px.size());
  }
  const DescriptorSet descriptors(features.descriptors);
  const auto last_pose = state_.last_world_from_camera();
  std::vector<std::uint32_t> order = OrderViews(
      *map_,
      last_pose ? std::optional(last_pose->translation) : std::nullopt,
      last_view_);
  if (options_.max_views > 0 &&
      order.size() > static_cast<std::size_t>(options_.max_views)) {
    order.resize(options_.max_views);
  }
  const std::uint64_t frame_seed = base::MixSeed(options_.seed, frame.sequence);
  for (const std::uint32_t view : order) {
    ++report.views_tried;
    Correspondences correspondences;
    {
      const StageTimer timer(report.matching_time);
      correspondences = MatchView(map_->view(view), features, descriptors);
    }
    report.num_matches = static_cast<int>(correspondences.size());
    const auto verified = EstimatePose(request.camera,
                                       correspondences,
                                       base::MixSeed(frame_seed, view),
                                       report);
    if (!verified) continue;
    last_view_ = view;
    Accept(*verified, correspondences, frame.capture_time, result);
    return result;
  }
  state_.Fail(frame.capture_time, result);
  return result;
}

}  // namespace groundlock::localization
