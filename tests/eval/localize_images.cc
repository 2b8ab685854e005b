// SPDX-License-Identifier: Apache-2.0
// Localises single images in a reconstruction, each without a prior, and prints
// one CSV row for each. Times are of the image alone, from its bytes to its
// pose; importing the reconstruction is reported to stderr.
//   localize_images RECONSTRUCTION CAMERA.json IMAGE…
#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <opencv2/core/utility.hpp>
#include <string>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "map_store/formats/formats.h"
#include "server/localization/localizer.h"
#include "tests/support/recorded_data.h"

namespace groundlock::eval {
namespace {

constexpr std::size_t kMaxImageBytes = 64 << 20;

struct Arguments {
  std::string reconstruction;
  std::string camera;
  std::string localizer = "fast";
  std::vector<std::string> images;
};

absl::Status Run(const Arguments& arguments) {
  using Clock = std::chrono::steady_clock;
  const auto milliseconds = [](Clock::duration duration) {
    return std::chrono::duration<double, std::milli>(duration).count();
  };
  const Clock::time_point begin = Clock::now();
  // Not aligned: poses in the reconstruction's own coordinates compare.
  std::vector<std::string> warnings;
  ASSIGN_OR_RETURN(const map::MapData data,
                   formats::Import(arguments.reconstruction, {}, &warnings));
  ASSIGN_OR_RETURN(const auto map, test_support::WriteAndOpen(data));
  std::fprintf(stderr, "import: %.0f ms\n", milliseconds(Clock::now() - begin));
  ASSIGN_OR_RETURN(const auto camera,
                   test_support::ReadCamera(arguments.camera));
  std::printf("image,tracked,x,y,z,qw,qx,qy,qz,inliers,ms,cpu_ms\n");
  for (const std::string& path : arguments.images) {
    ASSIGN_OR_RETURN(const std::string bytes,
                     base::ReadFile(path, kMaxImageBytes));
    const Clock::time_point start = Clock::now();
    const double cpu_start = test_support::ThreadCpuSeconds();
    ASSIGN_OR_RETURN(
        const auto frame,
        image::DecodeImage(
            {.bytes = {reinterpret_cast<const std::uint8_t*>(bytes.data()),
                       bytes.size()}},
            {}));
    ASSIGN_OR_RETURN(const auto localizer,
                     localization::CreateLocalizer(
                         arguments.localizer, map, {.is_single_frame = true}));
    ASSIGN_OR_RETURN(const auto result,
                     localizer->Localize({&frame, camera, {}}));
    const double cpu_ms = 1e3 * (test_support::ThreadCpuSeconds() - cpu_start);
    const double ms = milliseconds(Clock::now() - start);
    const bool tracked = result.state == localization::CameraState::kTracked;
    const geometry::Rigid3 pose =
        result.world_from_camera.value_or(geometry::Rigid3());
    const Eigen::Vector3d& p = pose.translation;
    const Eigen::Quaterniond& q = pose.rotation;
    std::printf("%s,%d,%.9g,%.9g,%.9g,%.12g,%.12g,%.12g,%.12g,%d,%.2f,%.2f\n",
                path.c_str(),
                tracked ? 1 : 0,
                p.x(),
                p.y(),
                p.z(),
                q.w(),
                q.x(),
                q.y(),
                q.z(),
                result.num_inliers,
                ms,
                cpu_ms);
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock::eval

int main(int argc, char** argv) {
  groundlock::eval::Arguments arguments;
  CLI::App app("Localises single images in a reconstruction");
  app.add_option("reconstruction", arguments.reconstruction)->required();
  app.add_option("camera", arguments.camera, "camera.json")->required();
  app.add_option("images", arguments.images)->required();
  app.add_option("--localizer", arguments.localizer);
  CLI11_PARSE(app, argc, argv);
  groundlock::features::SetUpOpenCv();
  const absl::Status status = groundlock::eval::Run(arguments);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
