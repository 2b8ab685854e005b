// SPDX-License-Identifier: Apache-2.0
// What users write for the command line: align.json, control points, points of
// a map, camera.json, priors.csv, inertial
// samples and their unit, boxes, targets and ranges. The first byte
// chooses.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "client/cli/control_points.h"
#include "client/cli/imu.h"
#include "client/cli/parse.h"
#include "client/cli/priors.h"
#include "map_store/geometry/camera_model.h"

namespace {

using namespace groundlock::cli;  // NOLINT: a fuzzer's main

void CheckCamera(std::string_view input) {
  const auto camera = groundlock::geometry::CameraModelFromJson(input);
  if (!camera.ok()) return;
  // Usable, and itself again.
  (void)camera->ImageFromCamera({0.1, -0.2, 1.0});
  const auto again = groundlock::geometry::CameraModelFromJson(
      groundlock::geometry::CameraModelToJson(*camera));
  if (!again.ok() || again->id() != camera->id() ||
      again->width_px() != camera->width_px()) {
    __builtin_trap();
  }
}

void CheckPriors(std::string_view input) {
  const auto priors = PriorsFromCsv(input);
  if (!priors.ok()) return;
  for (const auto& [frame, prior] : *priors) {
    if (prior.position_world && (!prior.position_world->allFinite() ||
                                 !(prior.position_sigma_m > 0.0))) {
      __builtin_trap();
    }
    if (prior.position_arm_camera_m &&
        (!prior.position_arm_camera_m->allFinite() ||
         !(prior.position_sigma_m > 0.0))) {
      __builtin_trap();
    }
  }
}

void CheckInertial(std::string_view input) {
  if (const auto samples = InertialFromCsv(input); samples.ok()) {
    for (const auto& sample : *samples) {
      if (!sample.angular_rate_rad_s.allFinite()) __builtin_trap();
    }
  }
  const auto imu = ImuFromJson(input);
  if (imu.ok() && std::abs(imu->imu_from_camera.norm() - 1.0) > 1e-6) {
    __builtin_trap();
  }
}

void CheckArguments(std::string_view input) {
  CheckInertial(input);
  (void)ParseBox(input);
  (void)ParseTarget(input);
  (void)ParseBody(input, {"car", "van"});
  (void)ParseFrameRange(input);
  const auto size = ParseSize(input);
  if (size.ok() && (size->width < 1 || size->height < 1)) __builtin_trap();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  if (size == 0) return 0;
  const std::string_view input(reinterpret_cast<const char*>(data) + 1,
                               size - 1);
  switch (data[0] % 7) {
    case 0: {
      const auto similarity = SimilarityFromJson(input);
      if (similarity.ok() &&
          (!similarity->IsFinite() || !(similarity->scale > 0.0))) {
        __builtin_trap();
      }
      break;
    }
    case 1:
      (void)ControlPointsFromJson(input);
      break;
    case 2:
      (void)ParseMapPoint(input);
      break;
    case 3: {
      (void)ParseGeodetic(input);
      groundlock::sdk::AlignRequest request;
      (void)ParseGround(input, &request);
      break;
    }
    case 4:
      CheckCamera(input);
      break;
    case 5:
      CheckPriors(input);
      break;
    default:
      CheckArguments(input);
  }
  return 0;
}
