// SPDX-License-Identifier: Apache-2.0
// From verified matches to the map and its report.
#include <algorithm>
#include <array>
#include <set>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/map_build.h"
#include "map_store/build/internal/map_filter.h"
#include "map_store/build/internal/names_list.h"
#include "map_store/build/internal/sub_models.h"
#include "map_store/build/internal/upright_edges.h"
#include "map_store/formats/colmap_database.h"
#include "map_store/formats/formats.h"
#include "map_store/formats/photo_readings.h"

namespace groundlock::build::internal {
namespace {

namespace fs = std::filesystem;

constexpr double kMaxError_px = 4.0;  // as COLMAP's mapper filters
constexpr std::size_t kMinObservations = 10;
// Below this share of registered images, a more lenient mapper is tried.
constexpr double kPoorlyRegistered = 0.5;

absl::Status EmptyFolder(const fs::path& folder) {
  std::error_code error;
  fs::remove_all(folder, error);
  fs::create_directories(folder, error);
  if (!error) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("cannot create ", folder.string(), ": ", error.message()));
}

}  // namespace

absl::Status MapBuild::TooFewRegistered(std::size_t num_registered) const {
  std::string message = absl::StrCat("no map: only ",
                                     num_registered,
                                     " of ",
                                     report_.images.size(),
                                     " images could be put together. ");
  int neighbours = 0;
  int flat = 0;
  if (const auto pairs = formats::ReadColmapVerifiedPairs(database_);
      pairs.ok()) {
    for (const formats::ColmapVerifiedPair& pair : *pairs) {
      if (pair.image2 != pair.image1 + 1 || pair.num_inliers == 0) continue;
      ++neighbours;
      flat += pair.is_planar_or_rotation ? 1 : 0;
    }
  }
  if (neighbours > 0 && 2 * flat > neighbours) {
    absl::StrAppend(
        &message,
        "The camera only turned on the spot, or filmed one flat surface: "
        "walk sideways, past things at different distances.");
  } else if (3 * neighbours < static_cast<int>(report_.images.size())) {
    absl::StrAppend(
        &message,
        "Neighbouring images have too little in common: film more slowly, "
        "so that they overlap by two thirds, and where there is texture.");
  } else {
    absl::StrAppend(
        &message,
        "Film sideways through the place in one walk, in good light, and "
        "give the lens with --camera if you know it.");
  }
  return absl::FailedPreconditionError(message);
}

absl::Status MapBuild::RunMapper() {
  const fs::path sparse = folder_ / "sparse";
  return Stage("mapping", "", [&]() -> absl::Status {
    Colmap::MapperOptions mapper;
    mapper.fix_lens = options_.camera.has_value();
    mapper.num_images = report_.images.size();
    std::size_t best = 0;
    for (const bool lenient : {false, true}) {
      const fs::path output = folder_ / (lenient ? "sparse_lenient" : "sparse");
      RETURN_IF_ERROR(EmptyFolder(output));
      mapper.lenient = lenient;
      const absl::Status status =
          MakeColmap().RunMapper(database_, images_, output, mapper);
      if (status.code() == absl::StatusCode::kCancelled ||
          status.code() == absl::StatusCode::kNotFound) {
        return status;
      }
      // COLMAP exits with an error when it found no model; others repeat.
      ASSIGN_OR_RETURN(const std::vector<SubModel> models,
                       ReadSubModels(output));
      if (models.empty()) {
        if (lenient) break;
        continue;
      }
      const std::size_t size = models[ChooseSubModel(models)].images.size();
      if (lenient && size > best) {
        std::error_code error;
        fs::remove_all(sparse, error);
        fs::rename(output, sparse, error);
      }
      best = std::max(best, size);
      if (static_cast<double>(best) >=
          kPoorlyRegistered * static_cast<double>(report_.images.size())) {
        break;
      }
    }
    return best >= kMinImages ? absl::OkStatus() : TooFewRegistered(best);
  });
}

absl::Status MapBuild::RefineModel() {
  ASSIGN_OR_RETURN(const std::vector<SubModel> models,
                   ReadSubModels(folder_ / "sparse"));
  if (models.empty()) {
    return absl::DataLossError(absl::StrCat(
        folder_.string(), ": the mapper's models are gone; remove the folder"));
  }
  const std::size_t chosen = ChooseSubModel(models);
  std::vector<std::string> names;
  for (const ImageReport& image : report_.images) names.push_back(image.name);
  report_.warnings = DescribeGaps(names, models, chosen);
  model_images_ = models[chosen].images;
  return Stage("refining", absl::StrCat(chosen), [&]() -> absl::Status {
    const fs::path refined = folder_ / "refined";
    RETURN_IF_ERROR(EmptyFolder(refined));
    return MakeColmap().Adjust(
        models[chosen].path, refined, options_.camera.has_value());
  });
}

absl::Status MapBuild::FinishMap() {
  return Stage(
      "finishing",
      absl::StrCat("3 ", options_.min_views),
      [&]() -> absl::Status {
        formats::ImportOptions import;
        import.format = formats::Format::kColmap;
        import.database = database_;
        std::vector<std::string> warnings;
        ASSIGN_OR_RETURN(
            map::MapData data,
            formats::Import(folder_ / "refined", import, &warnings));
        std::vector<VerifiedPair> verified;
        ASSIGN_OR_RETURN(const auto pairs,
                         formats::ReadColmapVerifiedPairs(database_));
        for (const formats::ColmapVerifiedPair& pair : pairs) {
          if (pair.image2 >= report_.images.size()) continue;
          verified.push_back({report_.images[pair.image1].name,
                              report_.images[pair.image2].name,
                              pair.num_inliers});
        }
        DropMisplacedViews(verified, &data);
        FilterMap(options_.min_views, kMaxError_px, &data);
        DropEmptyViews(kMinObservations, &data);
        if (data.views.size() < kMinImages)
          return TooFewRegistered(data.views.size());
        std::error_code error;
        fs::remove_all(folder_ / "map", error);
        RETURN_IF_ERROR(formats::Export(
            data, formats::ExportFormat::kColmapBinary, folder_ / "map"));
        return KeepUpReadings(data);
      });
}

// They lie beside the model, which says nothing of its images but where they
// were taken.
absl::Status MapBuild::KeepUpReadings(const map::MapData& data) const {
  map::UpReadings readings;
  if (options_.video.empty()) {
    ASSIGN_OR_RETURN(readings.photos, formats::ReadPhotoReadings(images_));
  }
  readings.edges = FindUprightEdges(data, images_);
  return base::WriteFileAtomically(
      folder_ / "map" / formats::kPhotoReadingsFile,
      formats::UpReadingsToJson(readings));
}

absl::StatusOr<int> MapBuild::CountPhotosWithGps() const {
  ASSIGN_OR_RETURN(
      const map::UpReadings readings,
      formats::ReadUpReadings(folder_ / "map" / formats::kPhotoReadingsFile));
  std::set<std::string> with_gps;
  for (const map::PhotoReading& reading : readings.photos) {
    if (reading.p_local_m) with_gps.insert(reading.image);
  }
  return static_cast<int>(std::count_if(report_.images.begin(),
                                        report_.images.end(),
                                        [&with_gps](const ImageReport& image) {
                                          return image.is_registered &&
                                                 with_gps.count(image.name) > 0;
                                        }));
}

absl::Status MapBuild::WriteReportFiles() {
  std::vector<std::string> warnings;
  ASSIGN_OR_RETURN(const map::MapData data,
                   formats::Import(folder_ / "map", {}, &warnings));
  DescribeMap(data, options_.seed, &report_);
  ASSIGN_OR_RETURN(report_.num_with_gps, CountPhotosWithGps());
  if (!options_.video.empty()) {
    SubModel model;
    for (const map::MapViewData& view : data.views) {
      model.images.push_back(view.name);
    }
    std::vector<std::string> names;
    for (const ImageReport& image : report_.images) names.push_back(image.name);
    report_.warnings = DescribeGaps(names, std::array{model}, 0);
    report_.warnings.insert(
        report_.warnings.end(), notes_.begin(), notes_.end());
    if (num_left_out_ > 0) {
      report_.warnings.push_back(
          absl::StrCat("the video is long: ",
                       num_left_out_,
                       " of its ",
                       num_left_out_ + report_.images.size(),
                       " frames that show something new were left out, evenly; "
                       "--max-images 0 takes all, and takes longer"));
    }
  }
  std::vector<std::string> taken_out;
  for (const ImageReport& image : report_.images) {
    if (!image.is_registered &&
        std::find(model_images_.begin(), model_images_.end(), image.name) !=
            model_images_.end()) {
      taken_out.push_back(image.name);
    }
  }
  if (!taken_out.empty()) {
    report_.warnings.push_back(
        absl::StrCat(taken_out.size(),
                     " images were taken out again (",
                     NamesList(taken_out),
                     "): they saw too little, or were put where another place "
                     "looks the same"));
  }
  for (std::string& weakness : FindWeaknesses(data, report_)) {
    report_.warnings.push_back(std::move(weakness));
  }
  const fs::path& input =
      options_.video.empty() ? options_.images : options_.video;
  return WriteReport(report_,
                     data,
                     options_.seed,
                     input.has_filename()
                         ? input.filename().string()
                         : input.parent_path().filename().string(),
                     folder_);
}

}  // namespace groundlock::build::internal
