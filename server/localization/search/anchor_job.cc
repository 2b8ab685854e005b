// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/anchor_job.h"

#include <chrono>
#include <cmath>
#include <utility>

#include "server/localization/solvers/agreement.h"

namespace groundlock::localization {

namespace {

// As if the lens had another focal length: enough of it to be found at all.
std::optional<LensMeasurement> ProbeLens(const map::Map& map,
                                         const AnchorTask& task,
                                         double focal_ratio) {
  const auto camera = WithFocalRatio(task.request.camera, focal_ratio);
  if (!camera) return std::nullopt;
  AnchorRequest request = task.request;
  request.camera = *camera;
  const auto anchor = FindAnchor(map, request, task.options);
  if (!anchor) return std::nullopt;
  auto lens = MeasureLens(
      map, *camera, anchor->lens_matches, anchor->pose.world_from_camera);
  if (lens) lens->log_focal += std::log(focal_ratio);
  return lens;
}

}  // namespace

SoughtAnchor SeekAnchor(const map::Map& map, const AnchorTask& task) {
  SoughtAnchor sought;
  const auto anchor = FindAnchor(map, task.request, task.options);
  if (!anchor) {
    if (task.probe_focal_ratio) {
      sought.lens = ProbeLens(map, task, *task.probe_focal_ratio);
    }
    return sought;
  }
  auto pose = RefineAnchorPose(map,
                               task.request.camera,
                               anchor->inliers,
                               anchor->pose.world_from_camera);
  if (!pose) return sought;
  sought.lens = MeasureLens(map,
                            task.request.camera,
                            anchor->lens_matches,
                            pose->pose.world_from_camera);
  FoundAnchor& found = sought.found.emplace();
  found.is_where_expected = anchor->used_prior;
  found.is_sure = IsSure(anchor->log_false_alarms);
  for (std::size_t i = 0; i < anchor->inliers.size(); ++i) {
    if (pose->pose.is_inlier[i] != 0) {
      found.inliers.push_back(anchor->inliers[i]);
    }
  }
  found.pose = *std::move(pose);
  return sought;
}

namespace {

// True if it was the caller's to seek.
bool SeekIfWaiting(AnchorJob& job) {
  std::optional<AnchorTask> taken;
  {
    const base::MutexLock lock(&job.mutex);
    taken = std::exchange(job.waiting, std::nullopt);
  }
  if (!taken) return false;
  job.sought = SeekAnchor(*job.map, *taken);
  return true;
}

}  // namespace

bool RenewAnchorJob(const AnchorTask& task, AnchorJob& job) {
  const base::MutexLock lock(&job.mutex);
  if (!job.waiting) return false;
  job.waiting = task;
  return true;
}

void WithdrawAnchorJob(AnchorJob& job) {
  const base::MutexLock lock(&job.mutex);
  job.waiting.reset();
}

bool IsFinished(const AnchorJob& job) {
  return job.done.wait_for(std::chrono::seconds(0)) ==
         std::future_status::ready;
}

void FinishAnchorJob(AnchorJob& job) {
  if (!SeekIfWaiting(job)) job.done.wait();
}

std::shared_ptr<AnchorJob> StartAnchorJob(
    std::shared_ptr<const map::Map> map,
    AnchorTask task,
    Urgency urgency,
    const BackgroundRunner& run_in_background) {
  auto job = std::make_shared<AnchorJob>();
  job->map = std::move(map);
  {
    const base::MutexLock lock(&job->mutex);
    job->waiting = std::move(task);
  }
  // The task alone holds the promise: if it is dropped unrun (a pool that shuts
  // down), the promise breaks and nobody waits for it forever.
  auto promise = std::make_shared<std::promise<void>>();
  job->done = promise->get_future();
  auto seek = [job, promise = std::move(promise)] {
    SeekIfWaiting(*job);
    promise->set_value();
  };
  if (run_in_background) {
    run_in_background(urgency, std::move(seek));
  } else {
    seek();
  }
  return job;
}

}  // namespace groundlock::localization
