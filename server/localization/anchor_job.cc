// SPDX-License-Identifier: Apache-2.0
#include "server/localization/anchor_job.h"

#include <utility>

namespace groundlock::localization {

std::optional<FoundAnchor> SeekAnchor(const map::Map& map,
                                      const AnchorTask& task) {
  const auto anchor = FindAnchor(map, task.request, task.options);
  if (!anchor) return std::nullopt;
  auto pose = RefineAnchorPose(map,
                               task.request.camera,
                               anchor->inliers,
                               anchor->pose.world_from_camera);
  if (!pose) return std::nullopt;
  FoundAnchor found;
  for (std::size_t i = 0; i < anchor->inliers.size(); ++i) {
    if (pose->pose.is_inlier[i] != 0) {
      found.inliers.push_back(anchor->inliers[i]);
    }
  }
  found.pose = *std::move(pose);
  return found;
}

bool RenewAnchorJob(AnchorTask task,
                    const image::Frame& frame,
                    std::uint64_t frame_index,
                    AnchorJob& job) {
  const base::MutexLock lock(&job.mutex);
  if (!job.waiting) return false;
  job.frame_index = frame_index;
  job.capture_time = frame.capture_time;
  job.camera = task.request.camera;
  job.pyramid = frame.Pyramid();
  job.waiting = std::move(task);
  return true;
}

void WithdrawAnchorJob(AnchorJob& job) {
  const base::MutexLock lock(&job.mutex);
  job.waiting.reset();
}

std::shared_ptr<AnchorJob> StartAnchorJob(
    std::shared_ptr<const map::Map> map,
    AnchorTask task,
    const image::Frame& frame,
    std::uint64_t frame_index,
    Urgency urgency,
    const BackgroundRunner& run_in_background) {
  auto job = std::make_shared<AnchorJob>();
  job->frame_index = frame_index;
  job->capture_time = frame.capture_time;
  job->camera = task.request.camera;
  job->pyramid = frame.Pyramid();
  {
    const base::MutexLock lock(&job->mutex);
    job->waiting = std::move(task);
  }
  // The task alone holds the promise: if it is dropped unrun (a pool that shuts
  // down), the promise breaks and nobody waits for it forever.
  auto promise = std::make_shared<std::promise<void>>();
  job->done = promise->get_future();
  auto seek = [job, promise = std::move(promise), map = std::move(map)] {
    std::optional<AnchorTask> taken;
    {
      const base::MutexLock lock(&job->mutex);
      taken = std::exchange(job->waiting, std::nullopt);
    }
    if (taken) job->found = SeekAnchor(*map, *taken);
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
