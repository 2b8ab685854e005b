// SPDX-License-Identifier: Apache-2.0
// Renders yards with ground truth: the demo's and the tests' input.
//
// A scene is a walled yard with props and one remote-controlled car; a
// sequence is a camera path (and the car's drive) through it. The camera is
// hand-held, its lens distortion (SIMPLE_RADIAL) is built into the rays, motion
// blur, vignetting, exposure changes and sensor noise are rendered. The
// sequences follow the experiments of Robinson 2014, ch. 4.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_SIMULATOR_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_SIMULATOR_H_

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"

namespace groundlock::simulator {

struct SimulationOptions {
  std::string scene = "yard";
  std::string sequence = "occlusion";
  std::filesystem::path output;  // folder; made if absent
  int width_px = 1'280;          // the focal length scales with it
  int height_px = 720;
  double fps = 24.0;
  int frames = 0;             // 0 = the sequence's own length
  int samples_per_pixel = 4;  // also the number of moments in the shutter
  int threads = 0;            // 0 = all cores; does not change the output
  std::uint64_t seed = 1;     // textures, layout details, shake and noise

  // kInvalidArgument naming the field, the value and the known values.
  absl::Status Validate() const;
};

struct SimulationProgress {
  std::string_view stage;  // "textures", "frames", "features", "landmarks", ...
  double fraction = 0.0;   // of this stage, 0 to 1
};
// Called from the calling thread; false cancels (Simulate: kCancelled).
using ProgressCallback = std::function<bool(const SimulationProgress&)>;

struct SimulationReport {
  int frames = 0;
  std::vector<std::filesystem::path> files;  // written, in order of writing
  double render_s = 0.0;                     // wall time of rendering
  double total_s = 0.0;

  // Sequences with a target: the first frame where it is wholly seen, its box
  // of seen surface there (what a user would draw), and how many frames it is
  // fully hidden behind other objects or not in the image.
  std::optional<int> init_frame;
  std::optional<geometry::Box2> init_box;
  int hidden_frames = 0;
  int unseen_frames = 0;

  // The sequence "mapping": its map.
  std::size_t num_features = 0;
  std::size_t num_landmarks = 0;
  std::size_t num_observations = 0;
  double mean_reprojection_error_px = 0.0;
};

// "yard"; "hills": the same on ground with slopes of up to 20 degrees;
// "aerial": the yard as a drone films it, rolling and from above.
std::vector<std::string> SceneNames();
// "mapping" first, then the sequences with a target; empty for an unknown
// scene.
std::vector<std::string> SequenceNames(std::string_view scene);

// Renders one sequence into options.output:
//   camera.json             the lens
//   SEQUENCE.mp4            H.264, crf 16
//   SEQUENCE_truth.csv      camera and target per frame, one header line
//   SEQUENCE_imu.csv        what an inertial measurement unit on the camera
//                           says, as EuRoC's imu0/data.csv; frame 0 is at 0 ns
//   imu.json                that unit
//   SEQUENCE_init_box.txt   X,Y,W,H of the target in the first frame, if it is
//                           seen there
//   SEQUENCE_other_truth.csv, SEQUENCE_other_init_box.txt
//                           the same of a second car, where there is one; of
//                           further ones, SEQUENCE_other2_truth.csv and so on
// and for "mapping", instead of the video and the box:
//   mapping/NNNN.jpg        the views, without target and motion blur
//   map/sparse/0/*.bin      COLMAP model in an arbitrary frame and scale,
//   map/database.db         triangulated from SIFT matches, with descriptors
//   align.json              from the model's frame to metres, z up
//   terrain.asc, .prj       the ground's true heights as an elevation model of
//                           the place that origin.txt names, over the ellipsoid
//   origin.txt              LATITUDE,LONGITUDE,HEIGHT of the world's origin: a
//                           yard has none, so it is the same for all
// Same options, same output. Errors: Validate's; kCancelled; kUnavailable and
// others when a file cannot be written.
absl::StatusOr<SimulationReport> Simulate(const SimulationOptions& options,
                                          const ProgressCallback& progress);

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_SIMULATOR_H_
