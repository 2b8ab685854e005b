// SPDX-License-Identifier: Apache-2.0
// What the cage costs: the processor time of decoding a video, and photos, in
// caged processes (map_store/decoding) and within this one, in turns.
//   caged_decoding_benchmark VIDEO [--frames N] [--rounds N]
// The photos are the video's first frames as JPEG.
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <optional>
#include <string>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/decoding/decoder.h"
#include "map_store/decoding/image_reader.h"
#include "map_store/decoding/video_reader.h"
#include "map_store/features/open_cv_setup.h"

namespace {

using groundlock::decoding::ImageReader;
using groundlock::decoding::VideoReader;

constexpr int kPhotos = 30;

double Seconds(const timeval& time) {
  return static_cast<double>(time.tv_sec) +
         1e-6 * static_cast<double>(time.tv_usec);
}

// Of this process and of its children that have ended, s.
double CpuSeconds() {
  double total = 0.0;
  for (const int who : {RUSAGE_SELF, RUSAGE_CHILDREN}) {
    rusage usage{};
    getrusage(who, &usage);
    total += Seconds(usage.ru_utime) + Seconds(usage.ru_stime);
  }
  return total;
}

[[noreturn]] void Die(const std::string& why) {
  std::fprintf(stderr, "%s\n", why.c_str());
  std::exit(EXIT_FAILURE);
}

// Each returns how many it has decoded.
int CagedVideo(const std::string& path, int max) {
  auto video = VideoReader::Open(path);
  if (!video.ok()) Die(video.status().ToString());
  int count = 0;
  for (; count < max; ++count) {
    const auto luma = video->NextLuma();
    if (!luma.ok()) Die(luma.status().ToString());
    if (luma->empty()) break;
  }
  return count;
}

// As the caged process does it.
int OpenVideo(const std::string& path, int max) {
  cv::VideoCapture video(path, cv::CAP_FFMPEG);
  cv::Mat frame;
  cv::Mat luma;
  int count = 0;
  for (; count < max && video.read(frame) && !frame.empty(); ++count) {
    cv::cvtColor(frame, luma, cv::COLOR_BGR2GRAY);
  }
  return count;
}

int CagedPhotos(const std::vector<std::string>& photos) {
  ImageReader reader;
  for (const std::string& photo : photos) {
    const auto image = reader.ReadColour(photo);
    if (!image.ok()) Die(image.status().ToString());
  }
  return static_cast<int>(photos.size());
}

int OpenPhotos(const std::vector<std::string>& photos) {
  for (const std::string& photo : photos) {
    if (cv::imread(photo, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION)
            .empty()) {
      Die(photo + ": cannot be read");
    }
  }
  return static_cast<int>(photos.size());
}

// Milliseconds of processor time for each of what `work` decodes.
template <typename Work>
double Measure(const Work& work) {
  const double before = CpuSeconds();
  const int count = work();
  if (count == 0) Die("nothing was decoded");
  return 1e3 * (CpuSeconds() - before) / count;
}

template <typename Caged, typename Open>
void Compare(const char* what,
             int rounds,
             const Caged& caged,
             const Open& open) {
  std::vector<double> ratios;
  for (int i = 0; i < rounds; ++i) {
    const double apart = Measure(caged);
    const double within = Measure(open);
    ratios.push_back(apart / within);
    std::printf("%-7s %8.3f %8.3f %7.2f\n", what, apart, within, ratios.back());
  }
  std::sort(ratios.begin(), ratios.end());
  std::printf("%-7s median ratio %.2f\n", what, ratios[ratios.size() / 2]);
}

}  // namespace

int main(int argc, char** argv) {
  groundlock::features::SetUpOpenCv();
  if (const auto status = groundlock::decoding::RunDecoderIfAsked(argc, argv)) {
    return *status;
  }
  CLI::App app("What the cage of strangers' media costs");
  std::string video;
  int frames = 300;
  int rounds = 5;
  app.add_option("video", video)->required()->check(CLI::ExistingFile);
  app.add_option("--frames", frames)->check(CLI::Range(1, 1'000'000));
  app.add_option("--rounds", rounds)->check(CLI::Range(1, 1'000));
  CLI11_PARSE(app, argc, argv);

  const auto folder = groundlock::base::TemporaryDirectory::Create(
      std::filesystem::temp_directory_path());
  if (!folder.ok()) Die(folder.status().ToString());
  std::vector<std::string> photos;
  cv::VideoCapture capture(video, cv::CAP_FFMPEG);
  cv::Mat frame;
  while (static_cast<int>(photos.size()) < kPhotos && capture.read(frame)) {
    photos.push_back(
        (folder->path() / (std::to_string(photos.size()) + ".jpg")).string());
    if (!cv::imwrite(photos.back(), frame)) Die("cannot write a photo");
  }
  if (photos.empty()) Die(video + ": cannot be read as a video");
  std::printf(
      "%dx%d\nms      in cages   within   ratio\n", frame.cols, frame.rows);
  Compare(
      "video",
      rounds,
      [&] { return CagedVideo(video, frames); },
      [&] { return OpenVideo(video, frames); });
  Compare(
      "photos",
      rounds,
      [&] { return CagedPhotos(photos); },
      [&] { return OpenPhotos(photos); });
  return EXIT_SUCCESS;
}
