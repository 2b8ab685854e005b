// SPDX-License-Identifier: Apache-2.0
// An anchor (anchoring.h) that is sought in the background.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ANCHOR_JOB_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ANCHOR_JOB_H_

#include <future>
#include <memory>
#include <optional>

#include "absl/base/thread_annotations.h"
#include "map_store/base/mutex.h"
#include "map_store/map/map.h"
#include "server/localization/localizer.h"
#include "server/localization/search/anchor_pose.h"
#include "server/localization/search/anchoring.h"
#include "server/localization/search/lens_check.h"

namespace groundlock::localization {

struct AnchorTask {
  AnchorRequest request;
  AnchorOptions options;
  // Where nothing is found, whether there is by a lens of so many times the
  // focal length (LensCheck::NextProbe).
  std::optional<double> probe_focal_ratio = std::nullopt;
};

struct FoundAnchor {
  AnchorPose pose;
  std::vector<LandmarkMatch> inliers;
  bool is_where_expected = false;  // Anchor::used_prior
  bool is_sure = false;            // agreement.h
};

struct SoughtAnchor {
  std::optional<FoundAnchor> found;
  std::optional<LensMeasurement> lens;  // also where it was found by a probe
};

// Thread-safe; deterministic by the request's seed.
SoughtAnchor SeekAnchor(const map::Map& map, const AnchorTask& task);

// Shared with the background task, which outlives the localizer if the session
// ends first. What it is about can be asked for again: nothing is lost with it.
struct AnchorJob {
  std::shared_ptr<const map::Map> map;
  // What is to be sought, until somebody takes it: the background task, or
  // whoever waits for it.
  base::Mutex mutex;
  std::optional<AnchorTask> waiting ABSL_GUARDED_BY(mutex);

  // Written by the seeker, read once the job is finished.
  SoughtAnchor sought;
  std::future<void> done;  // of the background task
};

// While the job waits for its thread, a newer frame takes the place of its own:
// the shorter is the way from it to the present. False if it is under way.
bool RenewAnchorJob(const AnchorTask& task, AnchorJob& job);

// Nobody waits for it any more: if it is not under way, it is not done at all.
void WithdrawAnchorJob(AnchorJob& job);

// Whether it was sought, or withdrawn, and `sought` can be read.
bool IsFinished(const AnchorJob& job);

// Returns once it is. What is not under way yet is sought by the caller itself,
// whose turn it then is: nobody waits in a queue behind others, or for a thread
// of lower priority.
void FinishAnchorJob(AnchorJob& job);

// Seeks an anchor by `run_in_background`, or at once if that is empty.
std::shared_ptr<AnchorJob> StartAnchorJob(
    std::shared_ptr<const map::Map> map,
    AnchorTask task,
    Urgency urgency,
    const BackgroundRunner& run_in_background);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ANCHOR_JOB_H_
