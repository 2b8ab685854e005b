// SPDX-License-Identifier: Apache-2.0
// The ground model and the motion filter alone: true camera poses and true 2D
// boxes of a rendered sequence in, results CSV out. What it is off by is the
// geometry's error; track_with_truth adds the 2D tracker's.
//   usage: lift_truth_boxes CAMERA.json TRUTH.csv RESULTS.csv
#include <fstream>
#include <iostream>
#include <optional>

#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/geometry/camera_model.h"
#include "server/tracking/ground_target.h"
#include "tests/eval/sequence_csv.h"

namespace groundlock::eval {
namespace {

// The visible box is the whole target's only if nothing hides a part of it.
constexpr double kSeenFraction = 0.98;

absl::Status Run(const char* camera_path,
                 const char* truth_path,
                 const char* results_path) {
  ASSIGN_OR_RETURN(const std::string json,
                   base::ReadFile(camera_path, 1 << 20));
  ASSIGN_OR_RETURN(const geometry::CameraModel camera,
                   geometry::CameraModelFromJson(json));
  ASSIGN_OR_RETURN(const std::vector<TruthRow> truth, ReadTruth(truth_path));
  std::ofstream out(results_path);
  WriteResultsHeader(out);
  std::optional<tracking::GroundTarget> target;
  for (const TruthRow& row : truth) {
    const tracking::CameraView view{
        {&camera, row.world_from_camera, {}}, geometry::Matrix6d::Zero(), true};
    const bool seen = row.visible_box_px && row.seen_fraction > kSeenFraction;
    tracking::FrameResult result;
    result.sequence = static_cast<std::uint64_t>(row.frame);
    result.capture_time = row.time;
    result.camera.state = localization::CameraState::kTracked;
    result.camera.world_from_camera = row.world_from_camera;
    tracking::TargetResult cells;
    cells.id = "1";
    if (!target) {
      if (!seen) continue;
      ASSIGN_OR_RETURN(
          target,
          tracking::GroundTarget::Create(view,
                                         *row.visible_box_px,
                                         row.time,
                                         tracking::BoxCenter::kOutline,
                                         {}));
    } else {
      target->Predict(row.time);
      if (seen) {
        const auto sighting = target->Lift(view, *row.visible_box_px);
        if (sighting) target->Update(view, *sighting);
        cells.confidence = sighting ? 1.0 : 0.0;
      }
    }
    cells.state = seen ? tracking::TargetState::kTracked
                       : tracking::TargetState::kPredicted;
    cells.box_px = target->Project(view);
    cells.box_world = target->box();
    result.targets.push_back(cells);
    WriteResults(out, result);
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock::eval

int main(int argc, char** argv) {
  if (argc != 4) {
    std::cerr << "usage: lift_truth_boxes CAMERA.json TRUTH.csv RESULTS.csv\n";
    return 2;
  }
  const absl::Status status = groundlock::eval::Run(argv[1], argv[2], argv[3]);
  if (!status.ok()) std::cerr << status << '\n';
  return status.ok() ? 0 : 1;
}
