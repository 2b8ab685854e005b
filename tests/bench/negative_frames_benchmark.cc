// SPDX-License-Identifier: Apache-2.0
// Frames in which no pose may be reported as TRACKED: of another place (also
// blurred, or with most of it black), mirrored frames of the same place, black
// frames, noise; in two maps in turn. One half of them is given to a fresh
// localiser, the other to one that has just found the camera in a frame of the
// place: what it follows, and the anchors that it seeks around where the camera
// was, must not find it there either. Exits with 1 if one of them is TRACKED,
// with 77 without data.
//   negative_frames_benchmark [--count N] [--first I]
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <map>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <string>
#include <vector>

#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "server/localization/localizer.h"
#include "tests/support/recorded_data.h"

namespace groundlock::bench {
namespace {

constexpr int kSkipped = 77;

struct Arguments {
  std::string localizer = "fast";
  int count = 1'000;
  int first = 0;
};

// A map, frames that were taken in it, and frames that were not.
struct Place {
  std::string name;
  std::shared_ptr<const map::Map> map;
  geometry::CameraModel camera;
  std::vector<cv::Mat> own;
  std::vector<cv::Mat> foreign;
  // What localizers know that have found the camera in some of its own frames.
  std::vector<std::string> known;
};

std::vector<std::filesystem::path> ListImages(
    const std::filesystem::path& folder, std::size_t stride) {
  std::vector<std::filesystem::path> paths;
  if (!std::filesystem::is_directory(folder)) return paths;
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(folder)) {
    if (entry.path().extension() == ".jpg") paths.push_back(entry.path());
  }
  std::sort(paths.begin(), paths.end());
  std::vector<std::filesystem::path> chosen;
  for (std::size_t i = 0; i < paths.size(); i += stride) {
    chosen.push_back(paths[i]);
  }
  return chosen;
}

// Gray, at most of the size that a camera has here.
void Append(const cv::Mat& image, std::vector<cv::Mat>& images) {
  if (image.empty()) return;
  cv::Mat gray = image;
  if (image.channels() == 3) cv::cvtColor(image, gray, cv::COLOR_BGR2GRAY);
  const double scale = 1280.0 / std::max(gray.cols, gray.rows);
  if (scale < 1.0) {
    cv::resize(gray, gray, {}, scale, scale, cv::INTER_AREA);
  }
  images.push_back(gray);
}

absl::StatusOr<std::vector<Place>> LoadPlaces() {
  const std::filesystem::path data = test_support::DataFolder();
  std::vector<cv::Mat> elsewhere;  // in neither map
  for (const auto& [folder, stride] :
       std::map<std::string, std::size_t>{{"sot", 24},
                                          {"caliterra/images", 2},
                                          {"strecha", 2},
                                          {"importers", 2}}) {
    for (const auto& path : ListImages(data / folder, stride)) {
      Append(cv::imread(path.string(), cv::IMREAD_GRAYSCALE), elsewhere);
    }
  }
  std::vector<Place> places(2);
  for (const auto& [place, name, stride] : {std::tuple(0, "srun", 6),
                                            std::tuple(0, "scale", 8),
                                            std::tuple(0, "outofview", 9),
                                            std::tuple(0, "occlusion", 12),
                                            std::tuple(1, "plaza", 9)}) {
    ASSIGN_OR_RETURN(const auto sequence, test_support::FindSequence(name));
    if (places[place].map == nullptr) {
      places[place].name = place == 0 ? "lot" : "plaza";
      ASSIGN_OR_RETURN(
          places[place].map,
          test_support::ImportMap(sequence.reconstruction, sequence.align));
      ASSIGN_OR_RETURN(places[place].camera,
                       test_support::ReadCamera(sequence.camera));
    }
    ASSIGN_OR_RETURN(const auto frames,
                     test_support::ReadFrames(sequence.video, stride));
    for (const auto& [index, frame] : frames) Append(frame, places[place].own);
  }
  for (int i = 0; i < 2; ++i) {
    places[i].foreign = places[1 - i].own;
    places[i].foreign.insert(
        places[i].foreign.end(), elsewhere.begin(), elsewhere.end());
  }
  return places;
}

// A part of the image, perhaps mirrored, in another light, at `size_px`.
cv::Mat Vary(const cv::Mat& image, cv::Size size_px, std::mt19937_64& engine) {
  const auto uniform = [&](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(engine);
  };
  const double share = uniform(0.6, 1.0);
  const cv::Size part(static_cast<int>(share * image.cols),
                      static_cast<int>(share * image.rows));
  const cv::Point corner(
      static_cast<int>(uniform(0, image.cols - part.width)),
      static_cast<int>(uniform(0, image.rows - part.height)));
  cv::Mat out;
  cv::resize(image(cv::Rect(corner, part)), out, size_px, 0, 0, cv::INTER_AREA);
  if (engine() % 2 == 0) cv::flip(out, out, 1);
  out.convertTo(out, CV_8U, uniform(0.6, 1.4), uniform(-20, 20));
  return out;
}

cv::Mat Noise(cv::Size size_px, std::mt19937_64& engine) {
  cv::RNG rng(engine());
  cv::Mat noise(size_px, CV_8UC1);
  rng.fill(
      noise, cv::RNG::NORMAL, rng.uniform(60.0, 190.0), rng.uniform(5.0, 90.0));
  const double sigma = rng.uniform(0.0, 6.0);
  if (sigma > 1.0) {
    cv::GaussianBlur(noise, noise, {}, sigma);
    cv::normalize(noise, noise, 0, 255, cv::NORM_MINMAX);
  }
  return noise;
}

struct Negative {
  std::string kind;
  cv::Mat luma;
};

Negative MakeNegative(const Place& place, int index) {
  std::mt19937_64 engine(base::MixSeed(7, static_cast<std::uint64_t>(index)));
  const cv::Size size_px(place.camera.width_px(), place.camera.height_px());
  const auto draw = [&](const std::vector<cv::Mat>& images) {
    return images[engine() % images.size()];
  };
  switch (index % 10) {
    case 0: {
      // Black, or some other level, with a sensor's noise.
      cv::Mat flat(size_px, CV_8UC1, cv::Scalar(engine() % 4 ? 0 : 128));
      cv::Mat noise(size_px, CV_8UC1);
      cv::RNG(engine()).fill(
          noise, cv::RNG::NORMAL, 0.0, static_cast<double>(engine() % 4));
      return {"black", flat + noise};
    }
    case 1:
      return {"noise", Noise(size_px, engine)};
    case 2:
    case 3:
    case 4: {
      // Left for right, or upside down: no camera sees that.
      cv::Mat mirrored;
      cv::flip(draw(place.own), mirrored, index % 10 == 4 ? 0 : 1);
      std::uniform_real_distribution<double> gain(0.7, 1.3);
      mirrored.convertTo(mirrored, CV_8U, gain(engine), 0.0);
      return {"mirrored", mirrored};
    }
    case 5: {
      cv::Mat blurred = Vary(draw(place.foreign), size_px, engine);
      cv::GaussianBlur(blurred, blurred, {}, 3.0 + engine() % 9);
      return {"elsewhere, blurred", blurred};
    }
    case 6: {
      cv::Mat part = Vary(draw(place.foreign), size_px, engine);
      const int keep =
          size_px.width / 8 + static_cast<int>(engine() % (size_px.width / 3));
      part.colRange(keep, size_px.width).setTo(0);
      return {"elsewhere, mostly black", part};
    }
    default:
      return {"elsewhere", Vary(draw(place.foreign), size_px, engine)};
  }
}

struct Tally {
  int tried = 0;
  int tracked = 0;
  double milliseconds = 0.0;
  double most_ms = 0.0;
};

// So many own frames of a place come before frames that are not.
constexpr std::size_t kFramesBefore = 12;

absl::Status FindOwnFrames(const std::string& localizer_name, Place& place) {
  for (std::size_t i = 0; i < kFramesBefore; ++i) {
    image::Frame frame;
    frame.luma = place.own[i * place.own.size() / kFramesBefore];
    ASSIGN_OR_RETURN(
        const auto localizer,
        localization::CreateLocalizer(localizer_name, place.map, {}));
    ASSIGN_OR_RETURN(const auto result,
                     localizer->Localize({&frame, place.camera, {}}));
    if (result.state == localization::CameraState::kTracked) {
      place.known.push_back(localizer->Save());
    }
  }
  if (place.known.empty()) {
    return absl::InternalError("no own frame is found in " + place.name);
  }
  return absl::OkStatus();
}

absl::StatusOr<int> Run(const Arguments& arguments) {
  ASSIGN_OR_RETURN(std::vector<Place> places, LoadPlaces());
  for (Place& place : places) {
    RETURN_IF_ERROR(FindOwnFrames(arguments.localizer, place));
  }
  std::map<std::string, Tally> tallies;
  for (int index = arguments.first; index < arguments.first + arguments.count;
       ++index) {
    const Place& place = places[(index / 10) % places.size()];
    const Negative negative = MakeNegative(place, index);
    image::Frame frame;
    frame.luma = negative.luma;
    frame.sequence = static_cast<std::uint64_t>(index);
    // After the one before, where there is one.
    frame.capture_time = std::chrono::milliseconds(40);
    localization::LocalizerOptions options;
    options.seed = static_cast<std::uint64_t>(index);
    ASSIGN_OR_RETURN(
        const auto localizer,
        localization::CreateLocalizer(arguments.localizer, place.map, options));
    const auto turn = static_cast<std::size_t>(index) / (10 * places.size());
    const bool is_followed = turn % 2 == 1;
    if (is_followed) {
      RETURN_IF_ERROR(
          localizer->Restore(place.known[turn / 2 % place.known.size()]));
    }
    const double start = test_support::ThreadCpuSeconds();
    ASSIGN_OR_RETURN(const auto result,
                     localizer->Localize({&frame, place.camera, {}}));
    const double ms = 1e3 * (test_support::ThreadCpuSeconds() - start);
    const std::string before = is_followed ? ", after an own frame" : "";
    for (Tally* tally : {&tallies[negative.kind + before], &tallies["all"]}) {
      ++tally->tried;
      tally->milliseconds += ms;
      tally->most_ms = std::max(tally->most_ms, ms);
      tally->tracked += result.state == localization::CameraState::kTracked;
    }
    if (result.state == localization::CameraState::kTracked) {
      std::printf("TRACKED: %d, %s%s in %s, %d inliers\n",
                  index,
                  negative.kind.c_str(),
                  before.c_str(),
                  place.name.c_str(),
                  result.num_inliers);
      std::fflush(stdout);
    }
  }
  for (const auto& [kind, tally] : tallies) {
    std::printf("%-40s tried %6d  TRACKED %d  CPU mean %6.1f ms, most %6.1f\n",
                kind.c_str(),
                tally.tried,
                tally.tracked,
                tally.milliseconds / tally.tried,
                tally.most_ms);
  }
  return tallies["all"].tracked;
}

}  // namespace
}  // namespace groundlock::bench

int main(int argc, char** argv) {
  groundlock::bench::Arguments arguments;
  CLI::App app("Gives a localiser frames that it must not find in its map");
  app.add_option("--localizer", arguments.localizer);
  app.add_option("--count", arguments.count)->check(CLI::PositiveNumber);
  app.add_option("--first", arguments.first, "to go on where one stopped");
  CLI11_PARSE(app, argc, argv);
  groundlock::features::SetUpOpenCv();
  const auto tracked = groundlock::bench::Run(arguments);
  if (tracked.status().code() == absl::StatusCode::kNotFound) {
    std::printf("skipped: %s\n", tracked.status().ToString().c_str());
    return groundlock::bench::kSkipped;
  }
  if (!tracked.ok()) {
    std::fprintf(stderr, "%s\n", tracked.status().ToString().c_str());
    return 2;
  }
  return *tracked == 0 ? 0 : 1;
}
