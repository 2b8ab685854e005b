// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/colmap.h"

#include <algorithm>
#include <cstdio>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "map_store/base/status.h"
#include "map_store/cage/child_process.h"

namespace groundlock::build::internal {
namespace {

namespace fs = std::filesystem;

std::string Flag(bool value) { return value ? "1" : "0"; }

std::string Threads(int threads) {
  return absl::StrCat(threads > 0
                          ? threads
                          : static_cast<int>(std::max(
                                1U, std::thread::hardware_concurrency())));
}

void Append(
    std::vector<std::string>* arguments,
    std::initializer_list<std::pair<const char*, std::string>> options) {
  for (const auto& [name, value] : options) {
    arguments->push_back(absl::StrCat("--", name));
    arguments->push_back(value);
  }
}

}  // namespace

absl::Status Colmap::Run(
    std::vector<std::string> arguments,
    const std::function<void(std::string_view, double*, std::string*)>& on_line)
    const {
  arguments.insert(arguments.begin(), options_.program);
  double fraction = 0.0;
  std::string note;
  const absl::Status status = cage::RunChildProcess(
      {.arguments = std::move(arguments),
       .log = options_.log,
       .niceness = options_.niceness,
       .memory_bytes = options_.memory_bytes,
       .on_line =
           [&](std::string_view line) { on_line(line, &fraction, &note); },
       .is_cancelled =
           [&] {
             return options_.progress && !options_.progress(fraction, note);
           }});
  if (status.code() == absl::StatusCode::kNotFound) {
    return absl::NotFoundError(absl::StrCat(
        status.message(),
        ": install COLMAP (on Debian: apt-get install colmap), or name its "
        "program"));
  }
  return status;
}

absl::Status Colmap::ExtractFeatures(
    const fs::path& database,
    const fs::path& images,
    const std::optional<geometry::CameraModel>& camera,
    int max_features) const {
  std::vector<std::string> arguments = {"feature_extractor"};
  Append(&arguments,
         {{"database_path", database.string()},
          {"image_path", images.string()},
          {"ImageReader.single_camera", "1"},
          {"SiftExtraction.use_gpu", "0"},
          {"SiftExtraction.num_threads", Threads(options_.threads)},
          {"SiftExtraction.max_num_features", absl::StrCat(max_features)}});
  if (camera) {
    Append(&arguments,
           {{"ImageReader.camera_model",
             std::string(geometry::CameraModelName(camera->id()))},
            {"ImageReader.camera_params",
             absl::StrJoin(
                 camera->params(), ",", [](std::string* out, double value) {
                   char text[32];
                   std::snprintf(text, sizeof(text), "%.17g", value);
                   out->append(text);
                 })}});
  }
  return Run(std::move(arguments),
             [](std::string_view line, double* fraction, std::string* note) {
               int done = 0;
               int total = 0;
               if (std::sscanf(std::string(line).c_str(),
                               "Processed file [%d/%d]",
                               &done,
                               &total) == 2 &&
                   total > 0) {
                 *fraction = static_cast<double>(done) / total;
                 *note = absl::StrCat(done, " of ", total, " images");
               }
             });
}

absl::Status Colmap::VerifyMatches(const fs::path& database,
                                   const fs::path& pair_list) const {
  std::vector<std::string> arguments = {"matches_importer"};
  Append(&arguments,
         {{"database_path", database.string()},
          {"match_list_path", pair_list.string()},
          {"match_type", "pairs"},
          {"SiftMatching.use_gpu", "0"},
          {"SiftMatching.num_threads", Threads(options_.threads)},
          // Matches are mutual and pass the ratio test: where fewer than a
          // third are right, images show different places, and looking longer
          // costs most of the time.
          {"SiftMatching.min_inlier_ratio", "0.35"},
          {"SiftMatching.max_num_trials", "2000"}});
  return Run(std::move(arguments),
             [](std::string_view line, double* fraction, std::string*) {
               int block = 0;
               int blocks = 0;
               if (std::sscanf(std::string(line).c_str(),
                               "Matching block [%d/%d]",
                               &block,
                               &blocks) == 2 &&
                   blocks > 0) {
                 *fraction = static_cast<double>(block - 1) / blocks;
               }
             });
}

absl::Status Colmap::RunMapper(const fs::path& database,
                               const fs::path& images,
                               const fs::path& output,
                               const MapperOptions& mapper) const {
  std::vector<std::string> arguments = {"mapper"};
  Append(&arguments,
         {{"database_path", database.string()},
          {"image_path", images.string()},
          {"output_path", output.string()},
          {"Mapper.num_threads", Threads(options_.threads)},
          {"Mapper.min_model_size", "3"},
          {"Mapper.ba_refine_focal_length", Flag(!mapper.fix_lens)},
          {"Mapper.ba_refine_extra_params", Flag(!mapper.fix_lens)},
          {"Mapper.ba_refine_principal_point", "0"},
          // Fewer adjustments of everything, each ended when it gains nothing
          // more (COLMAP's 0 iterates on): the last one, outside, decides.
          {"Mapper.ba_global_function_tolerance", "1e-5"},
          {"Mapper.ba_local_function_tolerance", "1e-5"},
          {"Mapper.ba_global_images_ratio", "1.3"},
          {"Mapper.ba_global_points_ratio", "1.3"},
          {"Mapper.ba_global_max_refinements", "3"}});
  if (mapper.lenient) {
    Append(&arguments,
           {{"Mapper.init_min_num_inliers", "50"},
            {"Mapper.init_min_tri_angle", "6"},
            {"Mapper.abs_pose_min_num_inliers", "20"},
            {"Mapper.abs_pose_min_inlier_ratio", "0.15"}});
  }
  const std::size_t total = std::max<std::size_t>(1, mapper.num_images);
  return Run(
      std::move(arguments),
      [total](std::string_view line, double* fraction, std::string* note) {
        int image = 0;
        int registered = 0;
        if (std::sscanf(std::string(line).c_str(),
                        "Registering image #%d (%d)",
                        &image,
                        &registered) == 2) {
          *fraction = std::min(
              1.0,
              static_cast<double>(registered) / static_cast<double>(total));
          *note = absl::StrCat(registered, " of ", total, " images");
        }
      });
}

absl::Status Colmap::Adjust(const fs::path& input,
                            const fs::path& output,
                            bool fix_lens) const {
  std::vector<std::string> arguments = {"bundle_adjuster"};
  Append(&arguments,
         {{"input_path", input.string()},
          {"output_path", output.string()},
          {"BundleAdjustment.max_num_iterations", "30"},
          {"BundleAdjustment.function_tolerance", "1e-6"},
          {"BundleAdjustment.refine_focal_length", Flag(!fix_lens)},
          {"BundleAdjustment.refine_extra_params", Flag(!fix_lens)},
          {"BundleAdjustment.refine_principal_point", "0"}});
  return Run(std::move(arguments),
             [](std::string_view, double*, std::string*) {});
}

}  // namespace groundlock::build::internal
