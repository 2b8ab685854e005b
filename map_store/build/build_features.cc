// SPDX-License-Identifier: Apache-2.0
// From a video or photos to matched and verified features.
#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <span>
#include <string>
#include <system_error>
#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/image_features.h"
#include "map_store/build/internal/image_pairs.h"
#include "map_store/build/internal/map_build.h"
#include "map_store/decoding/image_reader.h"
#include "map_store/formats/colmap_database.h"
#include "map_store/formats/exif.h"

namespace groundlock::build::internal {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr double kGuessedFocal = 1.2;  // of the larger side, as COLMAP guesses
constexpr double kRatioTest = 0.8;     // Lowe 2004
constexpr std::size_t kMinMatches = 30;
constexpr std::uint64_t kMaxJsonBytes = 64 << 20;

}  // namespace

absl::Status MapBuild::FindFeatures() {
  ASSIGN_OR_RETURN(const std::vector<fs::path> files, ListImages(images_));
  const bool own = options_.features == FeatureKind::kGroundlock;
  const absl::Status extracted = Stage(
      "features",
      absl::StrCat(own, " 2 ", options_.max_features),
      [&]() -> absl::Status {
        // Sharpness is measured in any case; few features then suffice.
        ImageFeatureOptions extraction;
        extraction.max_features = own ? options_.max_features : 1;
        extraction.threads = options_.threads;
        ASSIGN_OR_RETURN(
            const std::vector<ImageFeatures> features,
            ExtractFeatures(
                files, extraction, CountProgress(files.size(), "images")));
        // One lens for all images of one size that do not say otherwise.
        std::map<std::tuple<int, int, std::string>, std::uint32_t>
            cameras_by_look;
        std::vector<formats::ColmapDatabaseCamera> cameras;
        std::vector<formats::ColmapDatabaseImage> images;
        json facts = json::array();
        for (const ImageFeatures& image : features) {
          formats::PhotoLens written;
          if (own && !options_.camera) {
            ASSIGN_OR_RETURN(const std::string head,
                             formats::ReadExifHead(images_ / image.name));
            written =
                formats::LensFromExif(head, image.width_px, image.height_px);
          }
          const auto [it, is_new] = cameras_by_look.emplace(
              std::make_tuple(image.width_px, image.height_px, written.camera),
              static_cast<std::uint32_t>(cameras.size()));
          if (is_new && options_.camera) {
            if (image.width_px != options_.camera->width_px() ||
                image.height_px != options_.camera->height_px()) {
              return absl::InvalidArgumentError(
                  absl::StrCat(image.name,
                               ": ",
                               image.width_px,
                               "x",
                               image.height_px,
                               ", but the camera's images are ",
                               options_.camera->width_px(),
                               "x",
                               options_.camera->height_px()));
            }
            cameras.push_back({*options_.camera, true});
          } else if (is_new) {
            const double focal = written.focal_px.value_or(
                kGuessedFocal * std::max(image.width_px, image.height_px));
            ASSIGN_OR_RETURN(const geometry::CameraModel guess,
                             geometry::CameraModel::Create(
                                 geometry::CameraModelId::kSimpleRadial,
                                 image.width_px,
                                 image.height_px,
                                 std::vector<double>{focal,
                                                     0.5 * image.width_px,
                                                     0.5 * image.height_px,
                                                     0.0}));
            cameras.push_back({guess, written.focal_px.has_value()});
          }
          images.push_back(
              {image.name, it->second, image.keypoints_px, image.descriptors});
          facts.push_back({{"name", image.name},
                           {"features", image.keypoints_px.size()},
                           {"sharpness", image.sharpness}});
        }
        RETURN_IF_ERROR(
            base::WriteFileAtomically(folder_ / "features.json", facts.dump()));
        if (own)
          return formats::CreateColmapDatabase(database_, cameras, images);
        if (cameras.size() > 1) {
          return absl::InvalidArgumentError(
              "images of different sizes: COLMAP's features need one lens; use "
              "the default features");
        }
        std::error_code error;
        fs::remove(database_, error);
        return MakeColmap().ExtractFeatures(
            database_, images_, options_.camera, options_.max_features);
      });
  RETURN_IF_ERROR(extracted);
  return ReadFeatureFacts();
}

absl::Status MapBuild::ReadFeatureFacts() {
  ASSIGN_OR_RETURN(const std::string content,
                   base::ReadFile(folder_ / "features.json", kMaxJsonBytes));
  const json facts = json::parse(content, nullptr, false);
  std::vector<double> sharpness;
  for (const json& fact : facts.is_array() ? facts : json::array()) {
    ImageReport image;
    image.name = fact.value("name", "");
    image.num_features = fact.value("features", 0);
    image.sharpness = fact.value("sharpness", 0.0);
    sharpness.push_back(image.sharpness);
    report_.images.push_back(std::move(image));
  }
  // Photos are compared with their neighbours here, frames were when chosen.
  std::set<std::string> blurred;
  if (!options_.video.empty()) {
    ASSIGN_OR_RETURN(const std::string text,
                     base::ReadFile(frames_file_, kMaxJsonBytes));
    const json frames = json::parse(text, nullptr, false);
    if (!frames.is_object()) {
      return absl::DataLossError(
          absl::StrCat(frames_file_.string(), ": not what a build wrote"));
    }
    for (const json& name : frames.value("blurred", json::array())) {
      if (name.is_string()) blurred.insert(name.get<std::string>());
    }
    num_left_out_ = frames.value("left_out", std::size_t{0});
  }
  constexpr std::ptrdiff_t kNeighbours = 7;
  const auto count = static_cast<std::ptrdiff_t>(sharpness.size());
  for (std::ptrdiff_t i = 0; i < count; ++i) {
    ImageReport& image = report_.images[static_cast<std::size_t>(i)];
    std::vector<double> near(
        sharpness.begin() + std::max<std::ptrdiff_t>(0, i - kNeighbours),
        sharpness.begin() + std::min(count, i + kNeighbours + 1));
    std::sort(near.begin(), near.end());
    image.is_blurred = blurred.count(image.name) > 0 ||
                       image.sharpness < options_.keyframes.blurred_below *
                                             near[near.size() / 2];
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<ImageFeatures>> MapBuild::ReadImageFeatures() const {
  ASSIGN_OR_RETURN(const std::vector<formats::ColmapDatabaseImage> images,
                   formats::ReadColmapFeatures(database_));
  std::vector<ImageFeatures> features;
  decoding::ImageReader reader;
  for (const formats::ColmapDatabaseImage& image : images) {
    ImageFeatures& target = features.emplace_back();
    target.name = image.name;
    target.keypoints_px = image.keypoints_px;
    target.descriptors = image.descriptors;
    ASSIGN_OR_RETURN(const cv::Mat bgr,
                     reader.ReadColour(images_ / image.name));
    target.width_px = bgr.cols;
    target.height_px = bgr.rows;
    for (const Eigen::Vector2f& p : image.keypoints_px) {
      const auto& pixel = bgr.at<cv::Vec3b>(
          std::clamp(static_cast<int>(p.y()), 0, bgr.rows - 1),
          std::clamp(static_cast<int>(p.x()), 0, bgr.cols - 1));
      target.rgb.push_back({pixel[2], pixel[1], pixel[0]});
    }
  }
  return features;
}

absl::Status MapBuild::MatchImages() {
  const absl::Status matched =
      Stage("matching", absl::StrCat(options_.seed), [&]() -> absl::Status {
        ASSIGN_OR_RETURN(const std::vector<formats::ColmapDatabaseImage> images,
                         formats::ReadColmapFeatures(database_));
        std::vector<std::span<const map::Descriptor>> descriptors;
        for (const formats::ColmapDatabaseImage& image : images) {
          descriptors.emplace_back(image.descriptors);
        }
        PairOptions choice;
        choice.seed = options_.seed;
        const std::vector<ImagePair> pairs = ChoosePairs(descriptors, choice);
        ASSIGN_OR_RETURN(const std::vector<PairMatches> matches,
                         MatchPairs(descriptors,
                                    pairs,
                                    kRatioTest,
                                    kMinMatches,
                                    options_.threads,
                                    CountProgress(pairs.size(), "pairs")));
        std::vector<formats::ColmapPairMatches> stored;
        std::string list;
        for (const PairMatches& match : matches) {
          if (match.features.empty()) continue;
          stored.push_back(
              {match.pair.first, match.pair.second, match.features});
          absl::StrAppend(&list,
                          images[match.pair.first].name,
                          " ",
                          images[match.pair.second].name,
                          "\n");
        }
        if (stored.empty()) return TooFewRegistered(0);
        RETURN_IF_ERROR(formats::AddColmapMatches(database_, stored));
        return base::WriteFileAtomically(pairs_file(), list);
      });
  RETURN_IF_ERROR(matched);
  return Stage("verifying", "", [&] {
    return MakeColmap().VerifyMatches(database_, pairs_file());
  });
}

}  // namespace groundlock::build::internal
