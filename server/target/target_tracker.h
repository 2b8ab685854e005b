// SPDX-License-Identifier: Apache-2.0
// 2D trackers of one target in the image, behind one small interface.
#ifndef GROUNDLOCK_SERVER_TARGET_TARGET_TRACKER_H_
#define GROUNDLOCK_SERVER_TARGET_TARGET_TRACKER_H_

#include <limits>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/state_stream.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/convex_polygon.h"

namespace groundlock::target {

struct TargetObservation {
  geometry::Box2 box_px;
  // In [0, 1]: how sure the tracker is that the box holds the target. 0.5
  // divides seen from unseen; the headers of the trackers say how it is made.
  double confidence = 0.0;
  // The same if nothing but its looks says that the target is there, as for a
  // place that a search looks at. nullopt: the tracker knows no better than
  // `confidence`.
  std::optional<double> recognition = std::nullopt;
};

// What a tracker has learnt of its target's looks, kept for later. Of use to
// that tracker alone, until it is initialised anew.
class Appearance {
 public:
  virtual ~Appearance() = default;
};

// One per target; not thread-safe. Images are CV_8UC3 BGR or CV_8UC1 and may
// change size between calls. Boxes use continuous pixels (first pixel's centre
// at (0.5, 0.5)), may be of sub-pixel size and reach outside the image.
//
// The way of a frame: Place (if the 3D model knows better where the target is
// and how large), Detect, then Learn if the caller believes the detection.
// A 2D-only user calls Detect and Learn.
class TargetTracker {
 public:
  virtual ~TargetTracker() = default;

  // Starts on a new target. kInvalidArgument: empty image, box not finite, of
  // no size, or entirely outside the image.
  virtual absl::Status Initialize(const cv::Mat& image,
                                  const geometry::Box2& box_px) = 0;
  // Sets where to look next, and how large the target looks there.
  virtual void Place(const geometry::Box2& box_px) = 0;
  // Says, for the next Detect alone, where the target's centre is expected and
  // how well that is known: of several places that look like the target, it
  // then takes the likeliest. Trackers that see but one place ignore it.
  virtual void Expect(const Eigen::Vector2d& /*center_px*/,
                      const Eigen::Matrix2d& /*covariance_px2*/) {}
  // Says, for the next Detect alone, in which parts of the image no pixel is
  // the target's: they show what stands before it, or beside it. Trackers that
  // cannot leave a part out ignore it.
  virtual void LeaveOut(std::span<const geometry::ConvexPolygon> /*parts_px*/) {
  }
  // How far from the centre of `box_px`, along either axis, Detect finds a
  // target when it is placed there. Pixels.
  virtual Eigen::Vector2d Reach(const geometry::Box2& box_px) const {
    return 0.25 * box_px.size_px();
  }
  // Looks for the target near the current box and moves the box to it. Does not
  // learn. With `fixed_size` the box keeps its size (the ground model sets it).
  virtual absl::StatusOr<TargetObservation> Detect(const cv::Mat& image,
                                                   bool fixed_size) = 0;
  // How probably each pixel of a CV_8UC3 image is the target's, and not its
  // surroundings', by nothing but its colour: CV_32F, of the image's size.
  // Empty: the tracker cannot tell.
  virtual cv::Mat TellByColour(const cv::Mat& /*bgr*/) const { return {}; }
  // Does Detect follow how large the target looks, unless it is told the size?
  virtual bool SeesSize() const { return false; }
  // By what factor the target looks larger in `image`, the one last given to
  // Detect, than it would if `box_px` were about it as the first box was; the
  // next Learn learns how large it looks, too. For detections with a fixed
  // size; reads what DetectBox says, as long as `box_px` is not twice the box
  // found. nullopt: it cannot tell.
  virtual std::optional<double> MeasureGrowth(
      const cv::Mat& /*image*/, const geometry::Box2& /*box_px*/) {
    return std::nullopt;
  }
  // The part of an image outside which the next Detect reads no pixel, if the
  // box is `box_px` when it is called, and the same of the next Learn. May
  // reach outside the image. By default all of it; a tracker that says less
  // spares its caller the colours of the rest.
  virtual geometry::Box2 DetectBox(const geometry::Box2& /*box_px*/) const {
    return Everything();
  }
  virtual geometry::Box2 LearnBox(const geometry::Box2& /*box_px*/) const {
    return Everything();
  }
  // How many times an image may be halved before a target of `box_px` is seen
  // less well. Such an image, and boxes in its pixels, may be given to one
  // frame's Place, Expect, Detect and Learn, and others to the next. 0: the
  // tracker wants all images alike.
  virtual int Halvings(const geometry::Box2& /*box_px*/) const { return 0; }
  // Adapts the appearance model to what the current box holds in `image`, which
  // must be the one last given to Detect.
  virtual void Learn(const cv::Mat& image) = 0;

  // Keeps the appearance model as it is now in `kept`: null, or an earlier one
  // that is overwritten. Trackers that cannot leave it as it is.
  virtual void Keep(std::unique_ptr<Appearance>& /*kept*/) const {}
  // Says, for the next Detect alone, how else the target may look: each not
  // null, and there until the Detect after that or Adopt. Of these and the
  // present model, the one that is surest says where the target is.
  virtual void Recall(std::span<const Appearance* const> /*others*/) {}
  // Makes the appearance that was surest in the last Detect the model.
  virtual void Adopt() {}

  // Whether all that it knows can be had as plain data: only then the functions
  // below may be called. OpenCV's trackers keep theirs to themselves.
  virtual bool IsCarried() const { return false; }
  // What the results of the calls that follow depend on, of a tracker that was
  // initialised, between two frames.
  //   kept  those that it may have been told to Recall.
  virtual void SaveState(base::StateWriter& /*writer*/,
                         std::span<const Appearance* const> /*kept*/) const {}
  // Goes on from there: a tracker that was made with the same options. Where
  // the reader fails, this tracker is of no use any more.
  //   kept  the same ones, in the same order.
  virtual void RestoreState(base::StateReader& /*reader*/,
                            std::span<const Appearance* const> /*kept*/) {}
  // One that Keep has made; null where the reader fails.
  virtual void SaveAppearance(base::StateWriter& /*writer*/,
                              const Appearance& /*kept*/) const {}
  virtual std::unique_ptr<Appearance> RestoreAppearance(
      base::StateReader& /*reader*/) const {
    return nullptr;
  }

 private:
  static geometry::Box2 Everything() {
    constexpr double kAll = std::numeric_limits<double>::infinity();
    return {Eigen::Vector2d(-kAll, -kAll), Eigen::Vector2d(kAll, kAll)};
  }
};

struct TargetTrackerOptions {
  std::string name = "act";
  // Folder with the models of the trackers that need some; empty: there are
  // none.
  std::string models = "";
};

// Names: "act" (the thesis' adaptive colour tracker), "dcf" (a background-aware
// correlation filter on gradients and colour names), "kcf", "csrt", "mosse",
// "mil", "tld" (OpenCV's, for comparison: they learn inside Detect and cannot
// be told not to); and OpenCV's networks, which read files from
// options.models: "goturn" (goturn.prototxt, goturn.caffemodel), "dasiamrpn"
// (dasiamrpn_model.onnx, dasiamrpn_kernel_cls1.onnx,
// dasiamrpn_kernel_r1.onnx). kInvalidArgument lists the names;
// kFailedPrecondition: a model is needed and there is no folder; kNotFound: a
// model's file is not there. A file that is no model is told by Initialize.
absl::StatusOr<std::unique_ptr<TargetTracker>> CreateTargetTracker(
    const TargetTrackerOptions& options);
// Those that need no model; those that do; both.
std::vector<std::string> TargetTrackerNames();
std::vector<std::string> ModelTrackerNames();
std::vector<std::string> AllTrackerNames();

}  // namespace groundlock::target

#endif  // GROUNDLOCK_SERVER_TARGET_TARGET_TRACKER_H_
