// SPDX-License-Identifier: Apache-2.0
// One target's control logic (Robinson 2014, §3.1, §3.7): predict on the
// ground, look there in the image, believe or not, lift back to the ground.
#ifndef GROUNDLOCK_SERVER_TRACKING_TARGET_TRACK_H_
#define GROUNDLOCK_SERVER_TRACKING_TARGET_TRACK_H_

#include <Eigen/Core>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/image/frame.h"
#include "server/target/target_tracker.h"
#include "server/tracking/body_follower.h"
#include "server/tracking/earlier_frames.h"
#include "server/tracking/ground_target.h"
#include "server/tracking/hidden_spell.h"
#include "server/tracking/image_motion.h"
#include "server/tracking/known_lookalikes.h"
#include "server/tracking/motion_saliency.h"
#include "server/tracking/occlusion.h"
#include "server/tracking/other_targets.h"
#include "server/tracking/patch_memory.h"
#include "server/tracking/search_hypothesis.h"
#include "server/tracking/standing_landmarks.h"
#include "server/tracking/target_background.h"
#include "server/tracking/target_silhouette.h"
#include "server/tracking/tracker_picture.h"
#include "server/tracking/tracking_session.h"
#include "server/tracking/view_memory.h"
#include "server/tracking/view_turn.h"

namespace groundlock::tracking {

// What else there is in a frame.
struct Surroundings {
  // None of them is taken for this one.
  std::vector<SeenTarget> taken;
  // Others are not seen either: what is found may be one of them.
  bool others_are_unseen = false;
  // Other targets that were seen lately, those nearer to the camera as seen in
  // this frame.
  std::vector<ExpectedBody> bodies;
  // What the map knows; null: nothing.
  const StandingLandmarks* standing = nullptr;
  // Reasons about what hides a target at all.
  bool may_hide = false;
  // Places that a search looks at.
  int max_search_places = 0;
};

// Not thread-safe. `options` outlives it.
class TargetTrack {
 public:
  // Starts on the target in box_px of `frame`. Errors as
  // TargetTracker::Initialize.
  //   camera  null without a camera pose: the target gets its place on the
  //     ground in the first frame that has one and sees it.
  //   kind  nullopt: not told.
  static absl::StatusOr<std::unique_ptr<TargetTrack>> Start(
      const std::string& id,
      const image::Frame& frame,
      const CameraView* camera,
      const geometry::Box2& box_px,
      const SessionOptions& options,
      const std::optional<BodyKind>& kind);

  const std::string& id() const { return id_; }
  // The frame in which it was started: nothing to look for.
  TargetResult StartResult(const CameraView* camera) const;
  // Where it will be at `time`, without changing anything: the place that
  // localisation leaves out.
  std::optional<geometry::Box2> ExpectedBox(
      const CameraView* camera, std::chrono::nanoseconds time) const;
  // The same where the ground is known: the body that may hide others.
  std::optional<ExpectedBody> ExpectBody(const CameraView& camera,
                                         std::chrono::nanoseconds time) const;
  // Was it seen a moment ago: does it stand where it is expected?
  bool IsKnownToStand(std::chrono::nanoseconds time) const;
  // Where to look in the next frame.
  void Move(const geometry::Box2& box_px);
  absl::StatusOr<TargetResult> Process(const image::Frame& frame,
                                       const CameraView* camera,
                                       const Surroundings& surroundings);
  // Another target was dropped.
  void Forget(const std::string& id) { others_.Forget(id); }
  // Where it is, if it was seen in the last frame.
  std::optional<geometry::Box2> SeenBox() const;

 private:
  friend struct StateFields;

  struct Look {
    target::TargetObservation observation;
    double looks = 0.0;  // its confidence, wherever it was predicted
    std::optional<GroundSighting> sighting;
    bool believed = false;
    bool another = false;  // it is rather something else
    // As points of its body say, or its silhouette, not its looks.
    bool by_body = false;
    bool at_mover = false;   // where what moves says, instead of elsewhere
    bool by_motion = false;  // that alone says it, not its looks
    // How much its motion in the image speaks for it (MotionRatio).
    double motion_ratio = 1.0;
    bool elsewhere = false;  // far from any prediction: the motion starts anew
  };
  // What stands between the camera and the target.
  struct Hiding {
    // Other targets for which this one may be taken.
    std::vector<geometry::Box2> others_px;
    // Where no pixel is this one's: bodies of others that stand before it, or
    // beside it.
    std::vector<geometry::ConvexPolygon> left_out_px;
    geometry::Box2 outline_px;
    // Share of the body that is hidden: by targets, and by them and what the
    // map knows.
    double by_targets = 0.0;
    double share = 0.0;
  };
  // One frame, and what is known of it before the target is looked for.
  struct Now {
    const image::Frame& frame;
    const CameraView* camera;  // null: the target is looked for in the image
    const Surroundings& around;
    Hiding hiding = {};  // where the target is expected
  };
  // The next one of the places of a kind that a search goes through, by turns.
  struct SearchTurns {
    std::size_t vanished = 0;  // where it may come out of what hides it
    std::size_t near = 0;      // within the prediction's covariance
    std::size_t image = 0;     // all over the image
    std::size_t likely = 0;    // of these, where the colours are the target's
  };
  // A target that is hidden by more than this share is seen only by a tracker
  // that is sure.
  static constexpr double kMostlyHidden = 0.7;
  // Unseen for longer, a target may be anywhere: what looks like it must not
  // have been there before.
  static constexpr std::chrono::milliseconds kAbsent{500};
  // Share of a box inside the image below which the target is out of view.
  static constexpr double kInViewShare = 0.5;
  // And above which its appearance is learnt: what lies outside is made up by
  // repeating the image's edge.
  static constexpr double kLearnShare = 0.9;

  TargetTrack(std::string id, const SessionOptions& options);

  static bool IsInView(const geometry::Box2& box_px,
                       cv::Size size,
                       double share);
  // By how much the target is turned in the image now. What hardly depends on
  // it, because the image tells the target's outline, is not turned.
  void FollowTurn(const CameraView* camera);
  // Carries what is known of the image along with the background, where its
  // motion is asked for at all.
  void FollowBackground(const Now& now, bool from_ground);
  // Does what moves tell anything of the target? Of what is no rigid body parts
  // move by themselves.
  bool AsksForMotion(bool from_ground) const;
  // Where the ground model predicts the target.
  absl::StatusOr<Look> LookFromGround(const Now& now);
  // Where it was last seen in the image, or moved to.
  absl::StatusOr<Look> LookInImage(const Now& now);
  // One look of that, from where `box_px` is.
  //   expects  of several places that look like it, the predicted is taken.
  //   doubted  it was seen a moment ago: its looks count as if followed.
  absl::StatusOr<Look> LookInImageAt(const Now& now,
                                     const geometry::Box2& box_px,
                                     const ImageMotion::Prediction& predicted,
                                     bool expects,
                                     bool doubted);
  // A second look at what was found off the middle of a first one: believed
  // only where the motion foretold it.
  absl::StatusOr<Look> LookNearPrediction(
      const Now& now,
      const Look& found,
      const ImageMotion::Prediction& predicted,
      bool doubted);
  // Is another target there? What moves there may be either.
  static bool MeetsAnother(const Now& now, const geometry::Box2& box_px);
  // Would it look about as large there as where it is taken to be?
  bool LooksAsLarge(const CameraView& camera,
                    const GroundSighting& sighting) const;
  // What moves against the background where a target that moves is expected:
  // instead of `found`, if that has stayed with the background or is none.
  absl::StatusOr<Look> LookAtMover(const Now& now,
                                   const Look& found,
                                   const ImageMotion::Prediction& predicted);
  // Looks where the ground predicts it: without what others are, with it, and
  // without what was found instead.
  absl::StatusOr<Look> LookAt(const Now& now,
                              const geometry::Box2& box_px,
                              double min_confidence);
  // One of these looks.
  absl::StatusOr<Look> LookPast(
      const Now& now,
      const geometry::Box2& box_px,
      double min_confidence,
      std::span<const geometry::ConvexPolygon> left_out_px);
  // Looks at a place of a search: seen, or worth a hypothesis.
  absl::StatusOr<Look> LookFor(const Now& now,
                               const geometry::Box2& box_px,
                               double min_confidence);
  // Is what was found there where the target would be if it went on as it did
  // in the image?
  bool GoesOnInImage(const geometry::Box2& found_px) const;
  // The target's outline while it is seen; else the ground does.
  bool ImageTellsOutline() const;
  // Of what the tracker finds from there.
  double ReachArea_px2(const geometry::Box2& box_px) const;
  // Does a prediction leave open in which of several reaches the target is?
  // Then it is no witness for what is found there.
  bool IsVague(const geometry::Box2& predicted_px,
               const Eigen::Matrix2d& covariance_px2) const;
  // Was it found where such a prediction has it that is a witness?
  bool IsForetold(const CameraView& camera, const Look& look) const;
  // A second look, from where the first one found it, at what no prediction
  // bears out: it must be sure and, if the target was unseen, is a hypothesis
  // first.
  absl::StatusOr<Look> LookAgain(const Now& now, const Look& found);
  // Takes what was seen for a hypothesis, not to be believed yet, if it is sure
  // enough for one.
  void Suppose(Look& look);
  // That what is looked at is the target: by its looks alone while nothing
  // follows it.
  double SurenessOf(const target::TargetObservation& observation) const;
  SearchHypothesis::Sight SightOf(const Look& look) const;
  // What a target that is found by searching needs.
  double SureConfidence() const;
  SearchHypothesis::Bounds SearchBounds() const;
  // Other places: within the prediction's covariance and, after a while, all
  // over the image, some in each frame.
  //   predicted  nullopt: nowhere in the image, like behind the camera.
  //   beside_px  where it was just found, but not where it was predicted.
  absl::StatusOr<Look> Search(
      const Now& now,
      const std::optional<ImageMotion::Prediction>& predicted,
      const std::optional<geometry::Box2>& beside_px);
  std::vector<geometry::Box2> NextPlaces(
      const Now& now,
      const std::optional<ImageMotion::Prediction>& predicted,
      const std::optional<geometry::Box2>& beside_px);
  // Where, about these places of the image, something on the ground has its
  // size and its colours; empty: nothing tells.
  std::vector<Eigen::Vector2d> LikelyOnGround(
      const Now& now, std::span<const Eigen::Vector2d> places_px) const;
  // That place, as large as the target would look there, if that is another
  // size.
  geometry::Box2 AsLargeThere(const Now& now,
                              const geometry::Box2& box_px) const;
  absl::StatusOr<Look> FollowHypothesis(const Now& now);
  // May what is found be less sure? Only where the ground says how large it is
  // there, and whether it moves, and where it can be no other target.
  bool MayBeUnsure(const Now& now) const;
  // Did it look the same there while the target was elsewhere?
  absl::StatusOr<bool> WasThereBefore(const Now& now, const Look& look);
  // Was that told of what stands there a moment ago?
  bool IsKnownLookalike(const Look& look) const;
  // Whether the target can have come so far since it was last seen.
  bool IsReachable(const GroundSighting& sighting) const;
  // Places the tracker at `box_px` and has it look there, in as few pixels as
  // do.
  //   expected  null: nothing is known of where in its reach the target is.
  //   left_out_px  no pixel there is the target's.
  absl::StatusOr<target::TargetObservation> Detect(
      const image::Frame& frame,
      const geometry::Box2& box_px,
      const ImageMotion::Prediction* expected,
      bool fixed_size,
      std::span<const geometry::ConvexPolygon> left_out_px = {});
  // What stands before the target where it is taken to be now.
  Hiding FindHiding(const CameraView* camera, const Surroundings& around) const;
  // Is what was found rather another target, or something that stands before
  // this one?
  bool IsAnother(const Now& now, const Look& look) const;
  // Is it rather another target?
  bool IsAnotherTarget(const Now& now, const Look& look) const;
  // What was found far behind would stand behind what the map knows.
  bool IsBehindMap(const Now& now, const Look& look) const;
  // Is it seen as a whole, as far as is known, where it was just found? Of
  // anything else a part would be learnt that is not the target.
  bool IsWhole(const Now& now);
  // Measures the silhouette of a body that goes along the ground, if all of it
  // is expected to be seen.
  void MeasureSilhouette(const Now& now);
  // Remembers how the ground looks while the target is away.
  void KeepGroundWithout(const Now& now);
  // A look that takes a silhouette for the target's, if it may be.
  std::optional<Look> LookBySilhouette(const Now& now,
                                       const ground::SeenOutline& silhouette,
                                       GroundTarget::Whereabouts whereabouts,
                                       const Look& look);
  // Where the silhouette stands, although looks follow what is beside it and
  // has turned out to be the ground.
  std::optional<Look> LookBeside(const Now& now, const Look& look);
  // Where the silhouette of a body that was just seen says that it is, if looks
  // do not tell.
  std::optional<Look> LookAtSilhouette(const Now& now, const Look& look);
  // What an unseen target may look like by now.
  void RecallViews(const CameraView* camera);
  // Keeps what it looks like from where it is seen now.
  void RememberView(const CameraView& camera, double confidence);
  // Has the tracker learn the box that it has just found.
  void Learn(const image::Frame& frame, const geometry::Box2& box_px);
  // Tells the ground model how much larger the target looks, of which a 2D
  // tracker knows by itself.
  void FollowGrowth(const image::Frame& frame, const CameraView& camera);
  // Points of a target that has not moved since it was marked: follows them
  // into this frame, and looks for more where it was found.
  void FollowBody(const Now& now);
  void LearnBody(const image::Frame& frame, const CameraView& camera);
  // Do its points say that it is where it was?
  bool RestsByPoints() const;
  // What its points say that `look` missed: it is where it was, whatever it
  // looks like by now.
  std::optional<Look> LookAtRest(const CameraView& camera, const Look& look);
  // Where points of a body that moves say that it is.
  std::optional<Look> LookInMotion(const CameraView& camera, const Look& look);
  // Where patches of it are seen again, if looks do not tell.
  std::optional<Look> LookAtPatches(const Now& now, const Look& look);
  // Keeps what its patches look like from where it is seen now.
  void RememberPatches(const image::Frame& frame,
                       const CameraView& camera,
                       double confidence);
  void PlaceTracker(const geometry::Box2& box_px);
  // Goes where an unseen target looks most like itself.
  void FollowDoubted(const image::Frame& frame, const Look& look);
  void Believe(const Now& now, const Look& look);
  // What it looks like where it is seen now, as a whole.
  void LearnLooks(const Now& now, double confidence);
  // The ground model takes in what was seen; returns whether it began in this
  // frame.
  bool UpdateGround(const Now& now, const Look& look, bool was_current);
  TargetResult MakeResult(const CameraView* camera, double confidence) const;

  std::string id_;
  const SessionOptions* options_;
  std::optional<BodyKind> told_kind_;
  std::unique_ptr<target::TargetTracker> tracker_;
  TrackerPicture picture_;  // in which it last looked
  ViewTurn view_turn_;
  PatchTurn turn_;
  std::chrono::nanoseconds last_learnt_{0};
  std::optional<GroundTarget> ground_;
  bool ground_current_ = false;  // the ground model has the last sighting
  geometry::Box2 box_px_;        // last seen or placed
  bool moved_ = false;           // box_px_ was set from outside
  std::chrono::nanoseconds time_{0};
  std::chrono::nanoseconds last_seen_{0};
  int frames_seen_ = 0;  // in a row, up to the last frame
  // Unseen: the log-odds, above the threshold's, that it is back where it was
  // predicted; summed over the frames in a row that say so.
  double evidence_ = 0.0;
  ImageMotion image_motion_;
  TargetBackground background_;
  MotionSaliency saliency_;
  std::chrono::nanoseconds last_recognized_{0};  // seen by its looks
  std::optional<std::chrono::nanoseconds> last_met_another_;
  bool looks_in_image_ = false;  // unseen: where it was in the picture
  BodyFollower body_;
  TargetSilhouette silhouette_;
  PatchMemory patches_;
  ViewMemory views_;
  // What an unseen target may look like by now.
  std::vector<const target::Appearance*> recalled_;
  EarlierFrames earlier_frames_;
  KnownLookalikes lookalikes_;
  std::optional<SearchHypothesis> hypothesis_;
  OtherTargets others_;
  HiddenSpell hidden_;
  SearchTurns turns_;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_TARGET_TRACK_H_
