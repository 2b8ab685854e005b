// SPDX-License-Identifier: Apache-2.0
#include "client/cli/evaluate_trackers.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "client/cli/evaluate/one_pass.h"
#include "client/cli/evaluate/tracker_report.h"
#include "client/cli/track_run.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

constexpr const char* kFollowed = "target";

absl::StatusOr<std::vector<OnePassSequence>> SequencesOf(
    const TrackersRequest& request) {
  ASSIGN_OR_RETURN(std::vector<OnePassSequence> sequences,
                   ReadOnePassSequences(request.folder));
  if (request.only.empty()) return sequences;
  for (const std::string& name : request.only) {
    if (std::none_of(sequences.begin(), sequences.end(), [&](const auto& s) {
          return s.name == name;
        })) {
      return absl::NotFoundError(absl::StrCat("--experiment ",
                                              name,
                                              ": there is no such sequence in ",
                                              request.folder.string()));
    }
  }
  std::erase_if(sequences, [&](const OnePassSequence& sequence) {
    return std::find(request.only.begin(), request.only.end(), sequence.name) ==
           request.only.end();
  });
  return sequences;
}

// From the first frame that shows the target to the last with a truth.
absl::StatusOr<TrackerRun> FollowOnce(const OnePassSequence& sequence,
                                      const std::string& tracker,
                                      const TrackersRequest& request,
                                      VerbContext& context) {
  const std::vector<geometry::Box2>& truth_px = sequence.truth_px;
  const auto marked =
      std::find_if(truth_px.begin(), truth_px.end(), [](const auto& box) {
        return box.IsFinite();
      });
  const auto first = static_cast<std::uint64_t>(sequence.first_frame +
                                                (marked - truth_px.begin()));
  const std::vector<geometry::Box2> rated_px(marked, truth_px.end());

  TrackOptions options;
  options.input = sequence.video.empty()
                      ? sequence.images.front().parent_path().string()
                      : sequence.video.string();
  options.source.frames = {first, first + rated_px.size()};
  options.source.fps = sequence.frames_per_second;
  options.session.tracker = tracker;
  options.session.seed = request.seed;
  options.targets.push_back({kFollowed, *marked, first});
  options.results =
      (request.out / absl::StrCat(sequence.name, "_", tracker, ".csv"))
          .string();
  geometry::Box2 none;
  none.min_px.setConstant(std::nan(""));
  none.max_px.setConstant(std::nan(""));
  std::vector<geometry::Box2> found_px(rated_px.size(), none);
  std::vector<double> times_ms;
  options.observer = [&](const sdk::FrameResult& result,
                         const cv::Mat&,
                         const geometry::CameraModel&) {
    const std::uint64_t i = result.sequence - first;
    if (i >= found_px.size()) return;
    times_ms.push_back(result.times.track_ms);
    if (!result.targets.empty() && result.targets[0].box_px) {
      found_px[i] = *result.targets[0].box_px;
    }
  };
  context.err << sequence.name << ", " << tracker << '\n';
  RETURN_IF_ERROR(
      base::Annotate(TrackRun(options, context).Run(), sequence.name));
  if (times_ms.size() != rated_px.size()) {
    context.err << "warning: " << sequence.name << ": the truth has "
                << rated_px.size() << " frames, " << times_ms.size()
                << " of them were answered\n";
  }
  TrackerRun run;
  run.sequence = sequence.name;
  run.frames = times_ms.size();
  run.rated = std::count_if(rated_px.begin(),
                            rated_px.end(),
                            [](const auto& box) { return box.IsFinite(); });
  run.score = Rate(found_px, rated_px);
  run.track_ms = SpreadOf(times_ms);
  return run;
}

}  // namespace

absl::Status EvaluateTrackers(const TrackersRequest& request,
                              VerbContext& context) {
  ASSIGN_OR_RETURN(const std::vector<OnePassSequence> sequences,
                   SequencesOf(request));
  TrackerComparison comparison;
  comparison.version = context.version;
  comparison.machine = request.machine;
  comparison.data = std::filesystem::absolute(request.folder / "")
                        .lexically_normal()
                        .parent_path()
                        .filename()
                        .string();
  std::vector<std::string> trackers = request.trackers;
  if (trackers.empty()) {
    trackers.assign(std::begin(kComparedTrackers), std::end(kComparedTrackers));
  }
  for (const std::string& name : trackers) {
    comparison.trackers.push_back({name, {}});
  }
  for (const OnePassSequence& sequence : sequences) {
    comparison.sequences.push_back(sequence.name);
    for (MeasuredTracker& tracker : comparison.trackers) {
      ASSIGN_OR_RETURN(TrackerRun run,
                       FollowOnce(sequence, tracker.name, request, context));
      tracker.runs.push_back(std::move(run));
    }
  }
  const std::string json = TrackerReportJson(comparison);
  const std::filesystem::path page = request.out / "trackers.html";
  const std::filesystem::path data = request.out / "trackers.json";
  RETURN_IF_ERROR(base::WriteFileAtomically(data, json));
  RETURN_IF_ERROR(
      base::WriteFileAtomically(page, TrackerReportHtml(comparison)));
  if (context.common.json) {
    context.out << json << '\n';
  } else {
    context.out << TrackerReportText(comparison) << "wrote " << page.string()
                << " and " << data.string() << '\n';
  }
  return absl::OkStatus();
}

}  // namespace groundlock::cli
