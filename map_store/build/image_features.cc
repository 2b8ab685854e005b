// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/image_features.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <opencv2/imgproc.hpp>
#include <system_error>
#include <thread>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/build/keyframes.h"
#include "map_store/decoding/image_reader.h"
#include "map_store/features/sift_features.h"

namespace groundlock::build::internal {
namespace {

namespace fs = std::filesystem;

constexpr auto kProgressInterval = std::chrono::milliseconds(200);

bool HasImageExtension(const fs::path& path) {
  const std::string extension =
      absl::AsciiStrToLower(path.extension().string());
  for (const char* known : {".jpg",
                            ".jpeg",
                            ".png",
                            ".bmp",
                            ".tif",
                            ".tiff",
                            ".webp",
                            ".ppm",
                            ".pgm"}) {
    if (extension == known) return true;
  }
  return false;
}

absl::StatusOr<ImageFeatures> FeaturesOf(const fs::path& path,
                                         const ImageFeatureOptions& options,
                                         decoding::ImageReader& reader) {
  ASSIGN_OR_RETURN(const cv::Mat colour, reader.ReadColour(path));
  ImageFeatures result;
  result.name = path.filename().string();
  result.width_px = colour.cols;
  result.height_px = colour.rows;
  cv::Mat luma;
  cv::cvtColor(colour, luma, cv::COLOR_BGR2GRAY);
  result.sharpness = Sharpness(luma);
  double scale_x = 1.0;
  double scale_y = 1.0;
  const int size_px = std::max(luma.cols, luma.rows);
  if (size_px > options.max_size_px) {
    const double shrink = static_cast<double>(options.max_size_px) / size_px;
    cv::Mat small;
    cv::resize(luma, small, cv::Size(), shrink, shrink, cv::INTER_AREA);
    scale_x = static_cast<double>(luma.cols) / small.cols;
    scale_y = static_cast<double>(luma.rows) / small.rows;
    luma = small;
  }
  features::SiftOptions sift;
  sift.max_features = options.max_features;
  ASSIGN_OR_RETURN(features::SiftFeatures found,
                   features::ExtractSift(luma, {}, sift));
  result.descriptors = std::move(found.descriptors);
  for (const Eigen::Vector2d& keypoint : found.keypoints_px) {
    const double x = keypoint.x() * scale_x;
    const double y = keypoint.y() * scale_y;
    result.keypoints_px.emplace_back(static_cast<float>(x),
                                     static_cast<float>(y));
    const cv::Vec3b& bgr = colour.at<cv::Vec3b>(
        std::clamp(static_cast<int>(y), 0, colour.rows - 1),
        std::clamp(static_cast<int>(x), 0, colour.cols - 1));
    result.rgb.push_back({bgr[2], bgr[1], bgr[0]});
  }
  return result;
}

}  // namespace

absl::StatusOr<std::vector<fs::path>> ListImages(const fs::path& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) {
    return absl::NotFoundError(
        absl::StrCat(folder.string(), ": no such folder"));
  }
  std::vector<fs::path> images;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    std::error_code ignored;
    if (entry->is_regular_file(ignored) && HasImageExtension(entry->path())) {
      images.push_back(entry->path());
    }
  }
  if (images.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(folder.string(), ": no images in this folder"));
  }
  std::sort(images.begin(), images.end());
  return images;
}

absl::Status ForEachInParallel(
    std::size_t count,
    int threads,
    const std::function<absl::Status(std::size_t)>& task,
    const std::function<bool(std::size_t)>& progress) {
  const std::size_t num_threads = std::min<std::size_t>(
      count,
      threads > 0 ? static_cast<std::size_t>(threads)
                  : std::max(1U, std::thread::hardware_concurrency()));
  std::atomic<std::size_t> next{0};
  std::atomic<bool> stop{false};
  std::mutex mutex;
  std::condition_variable changed;
  std::size_t finished = 0;           // guarded by mutex
  std::size_t working = num_threads;  // guarded by mutex
  std::size_t failed_index = count;   // guarded by mutex
  absl::Status failure;               // guarded by mutex
  const auto work = [&] {
    while (!stop) {
      const std::size_t index = next++;
      if (index >= count) break;
      absl::Status status = task(index);
      const std::lock_guard lock(mutex);
      ++finished;
      if (!status.ok()) {
        stop = true;
        if (index < failed_index) {
          failed_index = index;
          failure = std::move(status);
        }
      }
    }
    const std::lock_guard lock(mutex);
    --working;
    changed.notify_one();
  };
  std::vector<std::thread> workers;
  for (std::size_t i = 0; i < num_threads; ++i) workers.emplace_back(work);
  bool cancelled = false;
  for (;;) {
    std::unique_lock lock(mutex);
    changed.wait_for(lock, kProgressInterval, [&] { return working == 0; });
    const std::size_t done = finished;
    const bool ended = working == 0;
    lock.unlock();
    if (!cancelled && progress && !progress(done)) cancelled = stop = true;
    if (ended) break;
  }
  for (std::thread& worker : workers) worker.join();
  if (!failure.ok()) return failure;
  return cancelled ? absl::CancelledError("cancelled") : absl::OkStatus();
}

absl::StatusOr<std::vector<ImageFeatures>> ExtractFeatures(
    std::span<const fs::path> images,
    const ImageFeatureOptions& options,
    const std::function<bool(std::size_t)>& progress) {
  std::vector<ImageFeatures> features(images.size());
  decoding::ImageReader reader;
  RETURN_IF_ERROR(ForEachInParallel(
      images.size(),
      options.threads,
      [&](std::size_t i) {
        auto found = FeaturesOf(images[i], options, reader);
        if (!found.ok()) return found.status();
        features[i] = *std::move(found);
        return absl::OkStatus();
      },
      progress));
  return features;
}

}  // namespace groundlock::build::internal
