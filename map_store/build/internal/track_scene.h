// SPDX-License-Identifier: Apache-2.0
// Cameras and points that tracks are explained by, while they are being found:
// the state, and the steps that a reconstruction is made of.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_SCENE_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_SCENE_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "map_store/build/internal/feature_tracks.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::build::internal {

// What one sight of a track is off by, 1 sigma: of Lucas-Kanade from keyframe
// to keyframe, as residuals of adjusted maps show it.
inline constexpr double kTrackSigma_px = 0.4;
// Cauchy's scale: beyond it a sight pulls less and less.
inline constexpr double kTrackRobust_px = 1.0;
// Sights that are farther off belong to something else.
inline constexpr double kTrackGate_px = 3.0;

// The lens while it is sought: f (px) and k of SIMPLE_RADIAL, the principal
// point in the middle. Pixels are taken from there.
struct RadialLens {
  double focal_px = 1.0;
  double k = 0.0;

  Eigen::Vector2d ImageFromCamera(const Eigen::Vector3d& p_camera) const;
  // Normalised plane (z = 1); undone by iteration, as good as k is small.
  Eigen::Vector2d NormalizedFromImage(const Eigen::Vector2d& pixel_px) const;
};

// What is believed of a lens before anything is measured, as a density: most
// cameras that film have a horizontal field of view between 40 and 90 degrees
// (f between 0.5 and 1.4 widths), and little distortion in a picture that is
// sold as one. An absurd lens so needs absurdly clear evidence.
struct LensPrior {
  double focal_px = 0.0;
  double focal_log_sigma = 0.35;
  double k_sigma = 0.1;
};

class TrackScene {
 public:
  struct Sight {
    std::uint32_t image = 0;
    Eigen::Vector2d pixel_px;  // from the principal point
    bool fits = true;
  };
  struct Point {
    std::optional<Eigen::Vector3d> p_world;
    std::vector<Sight> sights;
  };

  // `camera` known: pixels are taken through its lens at once, and the scene's
  // lens is a pinhole of its mean focal length. Else the lens is the prior's.
  TrackScene(const FeatureTracks& tracks,
             const std::optional<geometry::CameraModel>& camera);

  std::uint32_t num_images() const {
    return static_cast<std::uint32_t>(camera_from_world.size());
  }
  std::uint32_t CountPosed() const;
  std::uint32_t CountPoints() const;
  // Of points that are placed, in posed images.
  std::uint32_t CountSights() const;
  // Of points that are placed, in one image: what it hangs on by.
  std::uint32_t CountPlaced(std::uint32_t image) const;

  // What two images both see of the same tracks.
  void CommonSights(
      std::uint32_t first,
      std::uint32_t second,
      const std::function<void(const Sight&, const Sight&)>& take) const;
  // What an image sees of points that are placed.
  void PlacedSights(
      std::uint32_t image,
      const std::function<void(const Sight&, const Eigen::Vector3d&)>& take)
      const;
  bool IsSameTurn(std::uint32_t first, std::uint32_t second) const {
    return !turn_of.empty() && turn_of[first] == turn_of[second];
  }
  // Infinite behind the camera. The image must have a pose.
  double ErrorOf_px(const Sight& sight, const Eigen::Vector3d& p_world) const;
  // Also says which of the image's sights fit.
  void SetPose(std::uint32_t image, const geometry::Rigid3& pose);
  // Two images and the points that both see, from nothing; the first camera is
  // the world, the distance to the second 1. False: no motion explains them
  // with the parallax that a start needs.
  bool Start(std::uint32_t first, std::uint32_t second);
  // The pose of an image from the points it sees. False: too few agree.
  bool Resect(std::uint32_t image);
  // Points for tracks that have none, of those seen in `image` (all if unset).
  // With as many sights, of posed images, as asked for.
  void Triangulate(std::optional<std::uint32_t> image, int min_sights);
  // Takes out sights that do not fit, and points that too few sights hold, or
  // that open too small an angle to have a depth.
  void Filter(int min_sights);
  // Bundle adjustment: the poses of `images` (empty = all that have one, with
  // the first two's gauge free), all points they see, and the lens if asked.
  // Neighbours in time between which the camera turned on the spot are held
  // together, which points without depth do not do.
  struct Adjustment {
    std::vector<std::uint32_t> images;
    bool focal = false;
    bool distortion = false;
    int max_iterations = 20;
    int threads = 1;
    std::function<bool()> is_cancelled;
  };
  // From an image to the next one of its turn, both posed, at least one wanted.
  struct Turn {
    std::uint32_t first = 0;
    Eigen::Quaterniond next_from_first = Eigen::Quaterniond::Identity();
    double way_sigma = 0.0;  // world units
  };
  std::vector<Turn> Turns(const std::vector<bool>& is_wanted) const;
  // False: cancelled, or nothing usable came of it.
  bool Adjust(const Adjustment& adjustment);
  // What the tracks alone say of log f with everything else free: how far its
  // best value is from the present one, and 1 sigma of that: the jackknife's
  // over ten stretches of time and over nine parts of the picture, and what a
  // principal point away from the middle would change. nullopt if they do not
  // tell it.
  // Source: Efron & Tibshirani 1993, chapter 11; Cameron, Gelbach & Miller 2011
  // (errors that hang together in two ways).
  struct FocalEvidence {
    double log_step = 0.0;
    double log_sigma = 0.0;
  };
  std::optional<FocalEvidence> WeighFocal() const;
  // Adjusts everything with the lens free. Where the tracks hardly tell the
  // focal length, the prior has its share of it. Returns its 1 sigma, px;
  // nullopt if cancelled or nothing usable came of it.
  std::optional<double> SettleLens(const Adjustment& adjustment);

  // Mean over the better half of all tracks with at least three sights in posed
  // images, of a track's mean squared distance to what explains it best.
  // Compares lenses: a lens under which what moves by itself seems to stand
  // still gains nothing by it as long as that is less than half of all, and
  // every track counts, whatever its depth.
  // Source: Rousseeuw 1984 (least trimmed squares).
  double TrimmedCost_px2() const;
  // Sum over the points of how far their rays open, in the least angles that
  // give a depth; more than enough of it counts as enough.
  double Parallax() const;
  double MeanError_px() const;  // of sights that fit points

  RadialLens lens;
  LensPrior prior;
  bool lens_is_known = false;
  // Per image, the number of its turn (FindTurns); images of one turn open no
  // angle, whatever noise makes of their places. Empty: nothing turns.
  std::vector<std::uint32_t> turn_of;
  std::vector<std::optional<geometry::Rigid3>> camera_from_world;  // per image
  std::vector<Point> points;                                       // per track

 private:
  std::optional<Eigen::Vector3d> Intersect(
      std::span<const Sight* const> sights) const;
  double WidestAngle_rad(const Point& point) const;
  double MinAngle_rad() const;
  bool Place(Point& point, int min_sights) const;
  std::vector<const Sight*> PosedSights(const Point& point) const;

  double width_px_ = 0.0;  // the larger side
  // Per image: indices of the tracks that it sees.
  std::vector<std::vector<std::uint32_t>> tracks_of_;
};

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_SCENE_H_
