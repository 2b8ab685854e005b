// SPDX-License-Identifier: Apache-2.0
// What a target's track consists of, each part listed once for writing and
// reading (target_state_stream.h), and what must hold of it so that nobody is
// led astray by bytes that no session has written; what hides nothing is in
// state_values.h. For session_targets.cc.
//
// A member that is not here is scratch of one frame, or follows from the
// session's options; the header where it is declared says so.
#ifndef GROUNDLOCK_SERVER_TRACKING_STATE_FIELDS_H_
#define GROUNDLOCK_SERVER_TRACKING_STATE_FIELDS_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "map_store/base/state_stream.h"
#include "map_store/geometry/state_fields.h"
#include "server/image/colour_picture.h"
#include "server/tracking/standing_landmarks.h"
#include "server/tracking/state_values.h"
#include "server/tracking/target_state_stream.h"
#include "server/tracking/target_track.h"

namespace groundlock::tracking {

// For the types that keep to themselves what they consist of.
struct StateFields {
  // A hypothesis and a body on the ground are made by nobody else.
  static std::optional<SearchHypothesis> NewHypothesis() {
    return SearchHypothesis();
  }
  template <typename Stream>
  static std::optional<GroundTarget> NewGroundTarget(Stream& stream) {
    const geometry::CameraModel camera_model;
    CameraView camera;
    camera.view.camera = &camera_model;
    auto motion = motion::CreateMotionPredictor(stream.options().motion);
    if (!motion.ok()) {
      stream.Fail(base::Std(motion.status().message()));
      return std::nullopt;
    }
    GroundTarget target(
        stream.ground(), stream.ground()->reference_world(), camera, {});
    target.motion_ = *std::move(motion);
    return target;
  }

  template <typename Stream, base::StateOf<FollowedPoint> T>
  static void Of(Stream& stream, T& point) {
    Bounded(stream, "followed_point.variance", point.variance_, 0.0, 1e6);
    Field(stream, "followed_point.to_eye", point.to_eye_);
    Moment(stream, "followed_point.time", point.time_);
    OptionalMoment(stream, "followed_point.fit_time", point.fit_time_);
  }

  template <typename Stream, base::StateOf<OutlineScale> T>
  static void Of(Stream& stream, T& scale) {
    Bounded(stream, "outline.body_sigma", scale.body_sigma_, 0.0, 10.0);
    Bounded(stream, "outline.step", scale.step_s_, 0.0, 1e18);
    Field(stream, "outline.mean", scale.mean_);
    if (!(scale.mean_.cwiseAbs().maxCoeff() < 100.0)) {
      stream.Fail("is no logarithm of a ratio");
    }
    Covariance(stream, "outline.covariance", scale.covariance_);
  }

  template <typename Stream, base::StateOf<GroundTarget> T>
  static void Of(Stream& stream, T& body) {
    Field(stream, "body.ground_errors", body.ground_errors_);
    Field(stream, "body.tangent", body.last_tangent_world_);
    stream.Enter("body.motion");
    if constexpr (Stream::kReads) {
      body.motion_->RestoreState(stream);
    } else {
      body.motion_->SaveState(stream);
    }
    Field(stream, "body.way_per_height", body.way_per_height_);
    Field(stream, "body.way_per_height", body.start_way_per_height_);
    Field(stream, "body.way_from", body.way_from_m_);
    Field(stream, "body.way_per_height", body.way_from_per_height_);
    SizeField(stream, "body.size", body.size_m_);
    Field(stream, "body.shape", body.shape_);
    Field(stream, "body.kind", body.kind_);
    Field(stream, "body.kind_size", body.kind_size_);
    Covariance(stream, "body.size_covariance", body.log_size_covariance_);
    Bounded(
        stream, "body.times_measured", body.times_measured_, 0, kMostFrames);
    Of(stream, body.outline_scale_);
    Bounded(stream, "body.seen_ratio", body.seen_log_ratio_, -100.0, 100.0);
    auto center = static_cast<std::uint8_t>(body.center_);
    Field(stream, "body.center", center);
    if constexpr (Stream::kReads) {
      constexpr auto kLast = static_cast<std::uint8_t>(BoxCenter::kTexture);
      if (center > kLast) stream.Fail("is none");
      body.center_ = static_cast<BoxCenter>(std::min(center, kLast));
    }
    Field(stream, "body.texture", body.texture_object_);
    Of(stream, body.followed_point_);
    Angle(stream, "body.view", body.view_rad_);
    Angle(stream, "body.heading", body.heading_rad_);
    Field(stream, "body.heading_known", body.heading_known_);
    Field(stream, "body.has_left", body.has_left_);
    Field(stream, "body.fitted", body.fitted_);
    Angle(stream, "body.unturned", body.unturned_rad_);
    Bounded(stream, "body.heading_sigma", body.heading_sigma_rad_, 0.0, 1e3);
    Bounded(stream, "body.axis_sigma", body.axis_sigma_rad_, 0.0, 1e3);
    Field(stream, "body.turned_unseen", body.turned_unseen_);
    Moment(stream, "body.time", body.time_);
    Field(stream, "body.start_camera", body.start_camera_);
    Field(stream, "body.start_pose", body.start_world_from_camera_);
    BoxField(stream, "body.start_box", body.start_box_px_);
    Field(stream, "body.start_place", body.start_place_m_);
    Field(stream, "body.sighting", body.last_sighting_);
    Moment(stream, "body.sighting_time", body.last_sighting_time_);
  }

  template <typename Stream, base::StateOf<TrackerPicture> T>
  static void Of(Stream& stream, T& picture) {
    Bounded(stream,
            "picture.halvings",
            picture.halvings_,
            0,
            image::ColourPicture::kMaxHalvings);
    Field(stream, "picture.turn", picture.turn_);
    // What follows tells of a turned one only, which the next frame may ask of
    // if it is of the same time.
    if (!picture.IsTurned()) return;
    Field(stream, "picture.middle", picture.middle_px_);
    Field(stream, "picture.middle", picture.picture_middle_px_);
    Field(stream, "picture.axes", picture.frame_from_picture_);
    Field(stream, "picture.axes", picture.picture_from_frame_);
    Bounded(stream, "picture.coarser", picture.coarser_, 1e-3, 1e3);
    ImageField(stream, "picture.pixels", picture.picture_, CV_8UC3);
    if (picture.picture_.empty()) stream.Fail("are missing");
    Moment(stream, "picture.time", picture.drawn_);
  }

  template <typename Stream, base::StateOf<ViewTurn> T>
  static void Of(Stream& stream, T& turn) {
    Field(stream, "turn.view", turn.now_);
    Field(stream, "turn.learnt", turn.learnt_);
    Field(stream, "turn.usual_lean", turn.usual_lean_rad_);
    Field(stream, "turn.is_turned", turn.is_turned_);
    Angle(stream, "turn.angle", turn.turn_rad_);
    if (turn.learnt_ && turn.learnt_->is_upright && !turn.usual_lean_rad_) {
      stream.Fail("is upright, and leans as nobody knows");
    }
  }
  template <typename Stream, base::StateOf<ViewTurn::Learnt> T>
  static void Of(Stream& stream, T& learnt) {
    StateValue(stream, learnt.px_per_m);
    StateValue(stream, learnt.extent_m2);
    StateValue(stream, learnt.is_upright);
  }

  template <typename Stream, base::StateOf<ImageMotion> T>
  static void Of(Stream& stream, T& motion) {
    Field(stream, "image_motion.in_image", motion.in_image_);
    Field(stream, "image_motion.on_background", motion.on_background_);
    Field(stream, "image_motion.looks", motion.looks_);
    Field(stream,
          "image_motion.background_since_look",
          motion.background_since_look_);
    Moment(stream, "image_motion.looked", motion.looked_);
    Field(stream, "image_motion.background_known", motion.background_known_);
    Field(stream, "image_motion.camera_way", motion.camera_way_px_);
    Bounded(stream,
            "image_motion.usual_change",
            motion.usual_change_px2_,
            0.0,
            1e18);
    Bounded(stream,
            "image_motion.unusual_change",
            motion.unusual_change_px2_,
            0.0,
            1e18);
    Field(stream, "image_motion.usual_place", motion.usual_px_);
    Bounded(stream,
            "image_motion.usual_spread",
            motion.usual_spread_px2_,
            0.0,
            1e18);
    Bounded(stream, "image_motion.way", motion.way_px2_, 0.0, 1e18);
    Bounded(stream, "image_motion.side", motion.side_px_, 1e-6, 1e9);
    Bounded(stream, "image_motion.step", motion.step_s_, 1e-9, 1e12);
    Moment(stream, "image_motion.time", motion.time_);
  }
  template <typename Stream, base::StateOf<ImageMotion::Model> T>
  static void Of(Stream& stream, T& model) {
    StateValue(stream, model.last_px);
    StateValue(stream, model.velocity_px_s);
    StateValue(stream, model.innovation_px2);
    StateValue(stream, model.steps);
    StateValue(stream, model.life_s);
    if (!(model.innovation_px2 >= 0.0 && model.steps >= 0 &&
          model.steps <= kMostFrames && model.life_s > 1e-3)) {
      stream.Fail("is no model");
    }
  }

  template <typename Stream, base::StateOf<BackgroundMotion> T>
  static void Of(Stream& stream, T& motion) {
    PyramidField(stream, "background.image", motion.last_pyramid_);
  }

  template <typename Stream, base::StateOf<TargetBackground> T>
  static void Of(Stream& stream, T& background) {
    Of(stream, background.image_);
    Field(stream, "background.view", background.last_view_);
    Field(stream, "background.motion", background.motion_);
    Field(stream, "background.is_known", background.is_known_);
  }
  template <typename Stream, base::StateOf<TargetBackground::View> T>
  static void Of(Stream& stream, T& view) {
    StateValue(stream, view.camera);
    StateValue(stream, view.world_from_camera);
    StateValue(stream, view.reset_count);
  }

  template <typename Stream, base::StateOf<MotionSaliency> T>
  static void Of(Stream& stream, T& saliency) {
    List(stream, "saliency.pictures", saliency.pictures_, kMostPictures);
    List(stream, "saliency.long_ago", saliency.long_ago_, kMostPictures);
    Field(stream, "saliency.first", saliency.first_);
    Field(stream, "saliency.first_box", saliency.first_box_px_);
    Field(stream, "saliency.trace", saliency.trace_);
    Moment(stream, "saliency.time", saliency.time_);
    Moment(stream, "saliency.learnt", saliency.learnt_);
    Bounded(stream, "saliency.share", saliency.share_, 0.0, 1e3);
    Field(stream, "saliency.offset", saliency.offset_sides_);
  }
  template <typename Stream, base::StateOf<MotionSaliency::Trace> T>
  static void Of(Stream& stream, T& trace) {
    StateValue(stream, trace.spot);
    Moment(stream, "saliency.found", trace.found);
  }

  template <typename Stream, base::StateOf<BodyFollower> T>
  static void Of(Stream& stream, T& body) {
    PyramidField(stream, "points.image", body.last_pyramid_);
    Field(stream, "points.view", body.last_view_);
    Field(stream, "points.outline", body.last_outline_px_);
    if (body.last_pyramid_ != nullptr &&
        !(body.last_view_ && body.last_outline_px_.width() > 1e-6 &&
          body.last_outline_px_.height() > 1e-6)) {
      stream.Fail("are of no view");
    }
    OptionalMoment(stream, "points.last_hidden", body.last_hidden_);
    List(stream, "points.views", body.views_, kMostBodyViews);
    List(stream, "points", body.points_, kMostBodyPoints);
    if constexpr (Stream::kReads) {
      for (const auto& point : body.points_) {
        std::size_t end = body.views_.size();
        for (auto seen = point.observations.rbegin();
             seen != point.observations.rend();
             ++seen) {
          if (seen->view >= end) stream.Fail("were seen in no view");
          end = seen->view;
        }
      }
    }
    Field(stream, "points.moves", body.moves_);
    Field(stream, "points.is_over", body.is_over_);
    Field(stream, "points.viewed_from", body.viewed_from_m_);
    Field(stream, "points.told_from", body.told_from_m_);
  }
  template <typename Stream, base::StateOf<BodyFollower::Point> T>
  static void Of(Stream& stream, T& point) {
    StateValue(stream, point.pixel_px);
    StateValue(stream, point.followed);
    StateValue(stream, point.is_known);
    StateValue(stream, point.moves);
    StateValue(stream, point.p_body);
    StateValue(stream, point.expected_way_px);
    StateValue(stream, point.way_px);
    StateValue(stream, point.at_rest);
    List(stream, "points.observations", point.observations, kMostSightings);
    StateValue(stream, point.place);
    if (point.at_rest && !point.place) stream.Fail("rest nowhere");
    bool has_look = !point.look.empty();
    StateValue(stream, has_look);
    if (!has_look) return;
    if constexpr (Stream::kReads) {
      constexpr int kSide_px = image::LumaPyramid::kWindowPx;
      point.look = stream.ReadPixels(cv::Size(kSide_px, kSide_px), CV_8UC1);
    } else {
      stream.WritePixels(point.look);
    }
  }
  template <typename Stream, base::StateOf<BodyFollower::View> T>
  static void Of(Stream& stream, T& view) {
    StateValue(stream, view.camera);
    StateValue(stream, view.camera_from_world);
    StateValue(stream, view.world_from_body);
    StateValue(stream, view.side_m);
    StateValue(stream, view.heading_known);
    StateValue(stream, view.ground_world);
    StateValue(stream, view.ground_sigmas);
    StateValue(stream, view.silhouette);
    if (!(view.side_m > 0.0 && view.ground_sigmas.minCoeff() >= 0.0)) {
      stream.Fail("are of no body");
    }
  }

  template <typename Stream, base::StateOf<RecentOutlines> T>
  static void Of(Stream& stream, T& outlines) {
    List(stream, "silhouette.recent", outlines.recent_, kMostRecent);
  }
  template <typename Stream, base::StateOf<RecentOutlines::Recent> T>
  static void Of(Stream& stream, T& recent) {
    StateValue(stream, recent.sure_m);
    for (int edge = 0; edge < 4; ++edge) {
      Endless(stream, recent.possible_m[edge]);
    }
    StateValue(stream, recent.px_per_m);
    if (!(recent.px_per_m > 0.0)) stream.Fail("are of no size");
    Moment(stream, "silhouette.recent", recent.time);
  }

  template <typename Stream, base::StateOf<MovingSilhouette> T>
  static void Of(Stream& stream, T& silhouette) {
    List(stream, "silhouette.pictures", silhouette.pictures_, kMostPictures);
  }
  template <typename Stream, base::StateOf<MovingSilhouette::Picture> T>
  static void Of(Stream& stream, T& picture) {
    ImageField(stream, "silhouette.picture", picture.bgr, CV_8UC3);
    if (picture.bgr.empty()) stream.Fail("is missing");
    StateValue(stream, picture.origin_px);
    ScaleField(stream, "silhouette.scale", picture.scale);
    StateValue(stream, picture.camera);
    StateValue(stream, picture.world_from_camera);
    StateValue(stream, picture.blind_px);
    StateValue(stream, picture.shaded_px);
    StateValue(stream, picture.p_world);
    Moment(stream, "silhouette.time", picture.time);
    StateValue(stream, picture.reset_count);
  }

  template <typename Stream, base::StateOf<TargetSilhouette> T>
  static void Of(Stream& stream, T& silhouette) {
    Of(stream, silhouette.pictures_);
    Bounded(stream,
            "silhouette.times_beside",
            silhouette.times_beside_,
            0,
            kMostFrames);
    Moment(stream, "silhouette.asked", silhouette.asked_);
    Moment(stream, "silhouette.taught", silhouette.taught_);
    Of(stream, silhouette.recent_);
    Field(stream, "silhouette.by_body", silhouette.by_body_);
  }

  template <typename Stream, base::StateOf<PatchMemory> T>
  static void Of(Stream& stream, T& patches) {
    List(stream, "patches", patches.pictures_, kMostPictures);
    Angle(stream, "patches.unturned", patches.unturned_rad_);
  }
  template <typename Stream, base::StateOf<PatchMemory::Picture> T>
  static void Of(Stream& stream, T& picture) {
    ImageField(stream, "patches.picture", picture.luma, CV_8UC1);
    if (picture.luma.empty()) stream.Fail("is missing");
    StateValue(stream, picture.origin_px);
    ScaleField(stream, "patches.scale", picture.scale);
    StateValue(stream, picture.side_px);
    List(stream, "patches.corners", picture.corners, kMostBodyPoints);
    StateValue(stream, picture.picture_from_face);
    StateValue(stream, picture.camera);
    StateValue(stream, picture.world_from_camera);
    StateValue(stream, picture.direction_body);
    Moment(stream, "patches.time", picture.time);
    StateValue(stream, picture.reset_count);
  }
  template <typename Stream, base::StateOf<PatchMemory::Corner> T>
  static void Of(Stream& stream, T& corner) {
    StateValue(stream, corner.picture_px);
    StateValue(stream, corner.share);
    StateValue(stream, corner.face);
    if (corner.face < 0 || corner.face > 5) stream.Fail("are on no face");
  }

  //   tracker  of which the appearances are.
  template <typename Stream, base::StateOf<ViewMemory> T>
  static void Of(Stream& stream,
                 T& views,
                 const target::TargetTracker& tracker) {
    auto count = static_cast<std::uint32_t>(views.sectors_.size());
    Field(stream, "views", count);
    // As the options have it.
    if (count != views.sectors_.size()) stream.Fail("are of another number");
    for (auto& sector : views.sectors_) {
      bool has_appearance = sector.appearance != nullptr;
      Field(stream, "views.appearance", has_appearance);
      if (has_appearance) {
        if constexpr (Stream::kReads) {
          sector.appearance = tracker.RestoreAppearance(stream);
          if (sector.appearance == nullptr) stream.Fail("is none");
        } else {
          tracker.SaveAppearance(stream, *sector.appearance);
        }
      }
      Angle(stream, "views.angle", sector.view_rad);
      Angle(stream, "views.off_middle", sector.off_middle_rad);
      Moment(stream, "views.time", sector.time);
    }
    Bounded(stream,
            "views.sector",
            views.sector_,
            -1,
            static_cast<int>(views.sectors_.size()) - 1);
    Field(stream, "views.turn", views.turn_);
  }

  template <typename Stream, base::StateOf<EarlierFrames> T>
  static void Of(Stream& stream, T& frames) {
    List(stream, "earlier_frames", frames.frames_, kMostPictures);
  }
  template <typename Stream, base::StateOf<EarlierFrames::Earlier> T>
  static void Of(Stream& stream, T& earlier) {
    // Its luma follows from its colours.
    if constexpr (Stream::kReads) {
      cv::Mat bgr;
      ImageField(stream, "earlier_frames.picture", bgr, CV_8UC3);
      if (bgr.empty()) {
        stream.Fail("is missing");
      } else {
        earlier.frame = image::Frame::FromBgr(bgr);
      }
    } else {
      ImageField(
          stream, "earlier_frames.picture", earlier.frame.Bgr(), CV_8UC3);
    }
    StateValue(stream, earlier.frame.sequence);
    Moment(stream, "earlier_frames.time", earlier.frame.capture_time);
    ScaleField(stream, "earlier_frames.scale", earlier.scale);
    StateValue(stream, earlier.camera);
    StateValue(stream, earlier.world_from_camera);
    StateValue(stream, earlier.reset_count);
    BoxField(stream, "earlier_frames.target", earlier.target_px);
  }

  template <typename Stream, base::StateOf<KnownLookalikes> T>
  static void Of(Stream& stream, T& lookalikes) {
    List(stream, "lookalikes", lookalikes.known_, kMostLookalikes);
  }
  template <typename Stream, base::StateOf<KnownLookalikes::Lookalike> T>
  static void Of(Stream& stream, T& lookalike) {
    StateValue(stream, lookalike.place_m);
    Moment(stream, "lookalikes", lookalike.told);
  }

  template <typename Stream, base::StateOf<SearchHypothesis> T>
  static void Of(Stream& stream, T& hypothesis) {
    BoxField(stream, "hypothesis.box", hypothesis.box_px_);
    Field(stream, "hypothesis.evidence", hypothesis.evidence_);
    Field(stream, "hypothesis.is_sure", hypothesis.is_sure_);
    Field(stream, "hypothesis.sighting", hypothesis.first_sighting_);
    Field(stream, "hypothesis.has_moved", hypothesis.has_moved_);
    Bounded(stream, "hypothesis.looks", hypothesis.looks_, 0, kMostFrames);
  }

  template <typename Stream, base::StateOf<OtherTargets> T>
  static void Of(Stream& stream, T& others) {
    std::vector<std::pair<std::string, bool>> known(others.goes_with_.begin(),
                                                    others.goes_with_.end());
    List(stream, "others", known, kMostOthers);
    if constexpr (Stream::kReads) {
      others.goes_with_.clear();
      for (auto& [id, goes_with] : known) {
        if (!others.goes_with_.empty() &&
            id <= others.goes_with_.rbegin()->first) {
          stream.Fail("are not in order");
          break;
        }
        others.goes_with_.emplace(std::move(id), goes_with);
      }
    }
  }

  template <typename Stream, base::StateOf<HiddenSpell> T>
  static void Of(Stream& stream, T& hidden) {
    OptionalMoment(stream, "hidden.last", hidden.last_hidden_);
    OptionalMoment(stream, "hidden.seen_since", hidden.seen_since_);
    Field(stream, "hidden.vanished_behind", hidden.vanished_behind_);
  }

  template <typename Stream, base::StateOf<TargetTrack::SearchTurns> T>
  static void Of(Stream& stream, T& turns) {
    StateValue(stream, turns.vanished);
    StateValue(stream, turns.near);
    StateValue(stream, turns.image);
    StateValue(stream, turns.likely);
  }

  template <typename Stream, base::StateOf<TargetTrack> T>
  static void Of(Stream& stream, T& track) {
    Field(stream, "told_kind", track.told_kind_);
    Of(stream, track.views_, *track.tracker_);
    stream.Enter("tracker");
    if constexpr (Stream::kReads) {
      if (stream.ok()) {
        track.tracker_->RestoreState(stream, track.views_.All());
      }
    } else {
      track.tracker_->SaveState(stream, track.views_.All());
    }
    Recalled(stream, track);
    Of(stream, track.picture_);
    Of(stream, track.view_turn_);
    Field(stream, "patch_turn", track.turn_);
    Moment(stream, "last_learnt", track.last_learnt_);
    bool has_ground = track.ground_.has_value();
    Field(stream, "ground", has_ground);
    if constexpr (Stream::kReads) {
      if (has_ground) track.ground_ = NewGroundTarget(stream);
    }
    if (track.ground_) Of(stream, *track.ground_);
    Field(stream, "ground_current", track.ground_current_);
    if (track.ground_current_ && !has_ground) stream.Fail("is of no ground");
    BoxField(stream, "box", track.box_px_);
    Field(stream, "moved", track.moved_);
    Moment(stream, "time", track.time_);
    Moment(stream, "last_seen", track.last_seen_);
    Bounded(stream, "frames_seen", track.frames_seen_, 0, kMostFrames);
    Field(stream, "evidence", track.evidence_);
    Of(stream, track.image_motion_);
    Of(stream, track.background_);
    Of(stream, track.saliency_);
    Moment(stream, "last_recognized", track.last_recognized_);
    OptionalMoment(stream, "last_met_another", track.last_met_another_);
    Field(stream, "looks_in_image", track.looks_in_image_);
    Of(stream, track.body_);
    Of(stream, track.silhouette_);
    Of(stream, track.patches_);
    Of(stream, track.earlier_frames_);
    Of(stream, track.lookalikes_);
    bool has_hypothesis = track.hypothesis_.has_value();
    Field(stream, "hypothesis", has_hypothesis);
    if constexpr (Stream::kReads) {
      if (has_hypothesis) track.hypothesis_ = NewHypothesis();
    }
    if (track.hypothesis_) Of(stream, *track.hypothesis_);
    Of(stream, track.others_);
    Of(stream, track.hidden_);
    Field(stream, "search_turns", track.turns_);
  }

  // In the session's order, each under its name.
  static void Save(TargetStateWriter& writer, const TargetTrack& track) {
    Field(writer, "id", track.id_);
    Of(writer, track);
  }
  // Null where the reader fails.
  static std::unique_ptr<TargetTrack> Restore(TargetStateReader& reader) {
    std::string id;
    Field(reader, "id", id);
    auto tracker = target::CreateTargetTracker(reader.options().tracker);
    if (!tracker.ok() || !(*tracker)->IsCarried()) {
      reader.Fail("is followed by a tracker that keeps its state to itself");
    }
    if (!reader.ok()) return nullptr;
    std::unique_ptr<TargetTrack> track(
        new TargetTrack(std::move(id), reader.options()));
    track->tracker_ = *std::move(tracker);
    Of(reader, *track);
    if (!reader.ok()) return nullptr;
    return track;
  }
  static const target::TargetTracker& TrackerOf(const TargetTrack& track) {
    return *track.tracker_;
  }

  template <typename Stream, base::StateOf<StandingLandmarks> T>
  static void Of(Stream& stream, T& standing) {
    for (auto* region : {&standing.known_, &standing.growing_}) {
      Of(stream, *region, standing);
    }
  }

 private:
  template <typename Stream, typename T>
  static void Angle(Stream& stream, std::string_view field, T& angle_rad) {
    Bounded(stream, field, angle_rad, -kMostAngle_rad, kMostAngle_rad);
  }

  template <typename Stream, typename T>
  static void OptionalMoment(Stream& stream, std::string_view field, T& time) {
    Field(stream, field, time);
    if constexpr (Stream::kReads) {
      if (time && *time > stream.last_time()) stream.Fail("is to come");
    }
  }

  // Which of the views that are kept are recalled, by sectors.
  template <typename Stream, typename T>
  static void Recalled(Stream& stream, T& track) {
    auto& sectors = track.views_.sectors_;
    std::vector<std::uint8_t> numbers;
    if constexpr (!Stream::kReads) {
      for (const target::Appearance* recalled : track.recalled_) {
        const auto found =
            std::find_if(sectors.begin(), sectors.end(), [&](auto& sector) {
              return sector.appearance.get() == recalled;
            });
        numbers.push_back(static_cast<std::uint8_t>(found - sectors.begin()));
      }
    }
    List(stream, "views.recalled", numbers, sectors.size());
    if constexpr (Stream::kReads) {
      for (const std::uint8_t number : numbers) {
        if (number >= sectors.size() || sectors[number].appearance == nullptr) {
          stream.Fail("are not kept");
          break;
        }
        track.recalled_.push_back(sectors[number].appearance.get());
      }
    }
  }

  // Landmarks by their numbers in the map, which has their places.
  template <typename Stream,
            base::StateOf<StandingLandmarks::Region> T,
            typename Standing>
  static void Of(Stream& stream, T& region, Standing& standing) {
    const auto landmarks = standing.map_->landmarks();
    Field(stream, "standing.middle", region.middle_world);
    Bounded(stream, "standing.radius", region.radius_m, 0.0, 1e18);
    Field(stream, "standing.next", region.next);
    if (region.next > landmarks.size()) stream.Fail("is not in the map");
    Bounded(stream,
            "standing.stride",
            region.stride,
            std::size_t{1},
            static_cast<std::size_t>(kMostCounts));
    Field(stream, "standing.found", region.found);
    std::vector<std::uint32_t> numbers;
    for (const auto& point : region.points) numbers.push_back(point.landmark);
    List(stream, "standing.landmarks", numbers, StandingLandmarks::kMaxKept);
    if constexpr (Stream::kReads) {
      region.points.clear();
      for (const std::uint32_t number : numbers) {
        if (number >= landmarks.size()) {
          stream.Fail("are not in the map");
          break;
        }
        const Eigen::Vector3d p_region =
            landmarks[number].Position() - region.middle_world;
        region.points.push_back({p_region.cast<float>(), number});
      }
    }
  }
};

template <typename Stream, typename T>
requires requires(Stream& stream, T& value) { StateFields::Of(stream, value); }
void StateValue(Stream& stream, T& value) { StateFields::Of(stream, value); }

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_STATE_FIELDS_H_
