// SPDX-License-Identifier: Apache-2.0
// Arbitrary bytes as what a session knows of its targets: they are refused, or
// the session goes on with them and knows the same when it is asked again. The
// first byte says how: 0 is followed by such bytes, all else by changes to one
// of some states that sessions have saved, so that the checks behind its first
// bytes are reached.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <utility>
#include <vector>

#include "server/ground/box_fit.h"
#include "server/tracking/tracking_session.h"

namespace {

using groundlock::geometry::Box2;
using groundlock::geometry::CameraModel;
using groundlock::geometry::Rigid3;
using groundlock::image::Frame;
using groundlock::tracking::SessionOptions;
using groundlock::tracking::TrackingSession;

void Require(bool holds) {
  if (!holds) std::abort();
}

CameraModel SmallCamera() {
  return *CameraModel::Create(
      groundlock::geometry::CameraModelId::kSimplePinhole,
      192,
      144,
      std::array{150.0, 96.0, 72.0});
}

// 2 m over the ground, a little down, and it goes to the right.
Rigid3 PoseAt(int frame) {
  Eigen::Matrix3d level;
  level << Eigen::Vector3d::UnitX(), -Eigen::Vector3d::UnitZ(),
      Eigen::Vector3d::UnitY();
  return {Eigen::Quaterniond(level) *
              Eigen::AngleAxisd(-0.3, Eigen::Vector3d::UnitX()),
          {0.03 * frame, 0.0, 2.0}};
}

class GivenPose : public groundlock::localization::Localizer {
 public:
  absl::StatusOr<groundlock::localization::LocalizationResult> Localize(
      const groundlock::localization::LocalizationRequest& request) override {
    groundlock::localization::LocalizationResult result;
    result.state = groundlock::localization::CameraState::kTracked;
    result.world_from_camera =
        PoseAt(static_cast<int>(request.frame->sequence));
    return result;
  }
  void Reset() override {}
};

Box2 BoxOf(double x_m, double y_m, int frame) {
  const CameraModel camera = SmallCamera();
  return *groundlock::ground::ProjectBodyHull(
      {&camera, PoseAt(frame), {}},
      groundlock::ground::UprightBox(
          {}, {x_m, y_m, 0.0}, Eigen::Vector3d::UnitX(), {1.0, 0.6, 0.6}));
}

// Squares of any brightness.
void Paint(cv::Mat& bgr, const Box2& box_px, std::uint64_t seed) {
  cv::Mat_<cv::Vec3b> squares(5, 7);
  cv::RNG random(seed);
  random.fill(squares, cv::RNG::UNIFORM, 0, 255);
  const cv::Rect at(static_cast<int>(box_px.x()),
                    static_cast<int>(box_px.y()),
                    static_cast<int>(box_px.width()),
                    static_cast<int>(box_px.height()));
  const cv::Rect seen = at & cv::Rect(cv::Point(), bgr.size());
  if (seen.empty()) return;
  cv::Mat painted;
  cv::resize(squares, painted, at.size(), 0.0, 0.0, cv::INTER_NEAREST);
  painted(seen - at.tl()).copyTo(bgr(seen));
}

// Two targets, of which one goes and is hidden for a while.
constexpr int kHidden = 18;
constexpr int kFrames = 30;
Box2 Going(int frame) { return BoxOf(-0.9 + 0.05 * frame, 4.0, frame); }
Box2 Standing(int frame) { return BoxOf(1.2, 5.0, frame); }

Frame Draw(int frame) {
  cv::Mat bgr(144, 192, CV_8UC3);
  cv::RNG random(7);
  random.fill(bgr, cv::RNG::UNIFORM, 90, 150);
  cv::GaussianBlur(bgr, bgr, {}, 1.5);
  if (frame < kHidden || frame > kHidden + 8) Paint(bgr, Going(frame), 1);
  Paint(bgr, Standing(frame), 2);
  Frame made = Frame::FromBgr(bgr);
  made.sequence = static_cast<std::uint64_t>(frame);
  made.capture_time = std::chrono::milliseconds(40 * frame);
  return made;
}

// A state that was saved, and what a session that takes it in is like.
struct Saved {
  std::string tracker;
  bool has_camera = false;
  int frame = 0;  // the next one
  std::string camera;
  std::string targets;

  std::unique_ptr<TrackingSession> Session() const {
    SessionOptions options;
    options.tracker.name = tracker;
    std::unique_ptr<groundlock::localization::Localizer> localizer;
    if (has_camera) localizer = std::make_unique<GivenPose>();
    auto session =
        TrackingSession::Create(std::move(localizer),
                                groundlock::ground::MakePlaneSurface({}),
                                SmallCamera(),
                                options);
    Require(session.ok());
    return *std::move(session);
  }
  std::unique_ptr<TrackingSession> WithCamera() const {
    auto session = Session();
    Require(session->RestoreCamera(camera).ok());
    return session;
  }
};

struct States {
  States() {
    for (int i = 0; i < kFrames + 2; ++i) frames.push_back(Draw(i));
    Tell("dcf", true, /*with_others=*/true, {kHidden + 6});
    Tell("dcf", true, /*with_others=*/false, {12, kFrames});
    Tell("dcf", false, /*with_others=*/false, {12});
    Tell("act", true, /*with_others=*/false, {12});
  }
  void Tell(const std::string& tracker,
            bool has_camera,
            bool with_others,
            const std::vector<int>& cuts) {
    Saved told{tracker, has_camera, 0, {}, {}};
    const auto session = told.Session();
    Require(session->SetTarget("going", Going(0), {}).ok());
    if (with_others) {
      Require(
          session->SetTarget("standing", Standing(2), 2, {.kind = "car"}).ok());
      Require(session->SetTarget("later", Standing(0), 1'000).ok());
    }
    for (int i = 0; i <= kFrames; ++i) {
      if (std::find(cuts.begin(), cuts.end(), i) != cuts.end()) {
        told.frame = i;
        told.camera = session->SaveCamera();
        told.targets = *session->SaveTargets();
        all.push_back(told);
      }
      Require(session->ProcessFrame(FrameAt(i), {}, nullptr).ok());
    }
  }
  const Frame& FrameAt(int frame) const {
    return frames[static_cast<std::size_t>(frame)];
  }

  std::vector<Frame> frames;
  std::vector<Saved> all;
};

std::string MakeInput(const Saved& saved,
                      const std::uint8_t* data,
                      std::size_t size) {
  if (data[0] == 0) {
    return std::string(reinterpret_cast<const char*>(data) + 1, size - 1);
  }
  std::string bytes = saved.targets;
  // Three bytes each: where, in parts of it or, every second one, from the end,
  // before which filters and images lie; what.
  for (std::size_t i = 1; i + 2 < size; i += 3) {
    const std::size_t place = data[i] << 8 | data[i + 1];
    const std::size_t at = i % 2 == 1 ? bytes.size() - 1 - place % bytes.size()
                                      : place * bytes.size() / 65'536;
    bytes[at] = static_cast<char>(data[i + 2]);
  }
  if (size % 3 == 0) bytes.resize(bytes.size() - data[size - 1]);
  return bytes;
}

// They are made before the first input, whose time they would exceed.
const States* states = nullptr;

}  // namespace

extern "C" int LLVMFuzzerInitialize(int*, char***) {
  states = new States();
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  if (size == 0) return 0;
  const Saved& saved = states->all[data[0] % states->all.size()];
  const std::string bytes = MakeInput(saved, data, size);
  const auto session = saved.WithCamera();
  // What costs more is tried with few, of which nothing is cut off.
  if (!session->RestoreTargets(bytes).ok() || size % 6 != 1 ||
      data[size - 1] % 8 != 0) {
    return 0;
  }
  const auto again = session->SaveTargets();
  Require(again.ok());
  const auto other = saved.WithCamera();
  Require(other->RestoreTargets(*again).ok() &&
          *other->SaveTargets() == *again);
  // Now and then a second frame: they cost the most.
  for (int i = saved.frame; i <= saved.frame + (size % 4 == 0 ? 1 : 0); ++i) {
    Require(session->ProcessFrame(states->FrameAt(i), {}, nullptr).ok());
  }
  return 0;
}
