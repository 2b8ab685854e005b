// SPDX-License-Identifier: Apache-2.0
#include "server/target/model_trackers.h"

#include <filesystem>
#include <opencv2/video/tracking.hpp>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace groundlock::target {
namespace {

// The network is read when a target starts: what a file holds is known no
// earlier, and an exception ends in OpenCvTracker::Initialize.
template <typename Tracker, typename Params>
OpenCvStart StartNetwork(const Params& params) {
  return [params](const cv::Mat& frame, const cv::Rect2d& box) -> OpenCvUpdate {
    const cv::Ptr<Tracker> tracker = Tracker::create(params);
    tracker->init(frame, cv::Rect(box));
    return [tracker](const cv::Mat& image, cv::Rect2d& found) {
      cv::Rect result(found);
      if (!tracker->update(image, result)) return false;
      found = result;
      return true;
    };
  };
}

OpenCvStart StartGoturn(const std::vector<std::string>& paths) {
  cv::TrackerGOTURN::Params params;
  params.modelTxt = paths[0];
  params.modelBin = paths[1];
  return StartNetwork<cv::TrackerGOTURN>(params);
}

OpenCvStart StartDaSiamRpn(const std::vector<std::string>& paths) {
  cv::TrackerDaSiamRPN::Params params;
  params.model = paths[0];
  params.kernel_cls1 = paths[1];
  params.kernel_r1 = paths[2];
  return StartNetwork<cv::TrackerDaSiamRPN>(params);
}

}  // namespace

const std::vector<ModelTrackerKind>& ModelTrackerKinds() {
  static const std::vector<ModelTrackerKind> kinds = {
      {"goturn", {"goturn.prototxt", "goturn.caffemodel"}, StartGoturn},
      {"dasiamrpn",
       {"dasiamrpn_model.onnx",
        "dasiamrpn_kernel_cls1.onnx",
        "dasiamrpn_kernel_r1.onnx"},
       StartDaSiamRpn},
  };
  return kinds;
}

absl::StatusOr<OpenCvStart> StartModel(const ModelTrackerKind& kind,
                                       const std::string& folder) {
  if (folder.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat("tracker '",
                     kind.name,
                     "' needs a folder with its model: ",
                     absl::StrJoin(kind.files, ", ")));
  }
  std::vector<std::string> paths;
  for (const std::string& file : kind.files) {
    const std::filesystem::path path = std::filesystem::path(folder) / file;
    std::error_code error;
    if (!std::filesystem::is_regular_file(path, error)) {
      return absl::NotFoundError(absl::StrCat(
          "tracker '", kind.name, "': ", path.string(), " is not a file"));
    }
    paths.push_back(path.string());
  }
  return kind.start(paths);
}

}  // namespace groundlock::target
