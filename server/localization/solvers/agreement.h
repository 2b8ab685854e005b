// SPDX-License-Identifier: Apache-2.0
// Whether a pose may be an accident: the one test by which poses are believed,
// whoever found them.
//
// A pose on which k things agree is believed if less than
// kFalseAlarmsPerFrame as good ones are expected among all that are looked at
// in a frame that shows nothing of the map (a contrario: the number of false
// alarms, NFA). What agrees by chance is binomial. Its share is known where
// things are looked for in a small region only; where they are looked for in a
// whole map, it is measured on the frame itself: its mirror image has the same
// texture, and shows nothing of the map. Matched in the same way, it is a
// decoy. Where neither shows the map, a place that agrees is as likely to be
// the one's as the other's, and where both agree (a facade that is nearly its
// own mirror image), either is as likely to be more like the map. A frame that
// was itself mirrored is told by the same: its decoy is better than it.
//
// Source: Desolneux, Moisan & Morel 2000, "Meaningful alignments"; Moisan &
// Stival 2004 (poses by sampling); Elias & Gygi 2007, "Target-decoy search
// strategy" (decoys). Thread-safe.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_AGREEMENT_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_AGREEMENT_H_

#include <Eigen/Core>
#include <span>

#include "map_store/geometry/camera_model.h"

namespace groundlock::localization {

inline constexpr double kFalseAlarmsPerFrame = 1e-5;
// A pose with fewer is sure by itself; another wants a second frame that finds
// the same (FastLocalizer). Not for chance, which has its bound above: poses at
// which a picture hangs elsewhere, or half of the matches are wrong, had 1e-5
// to 1e-7 (docs/benchmarks.md, Beyond the map's end).
inline constexpr double kFalseAlarmsOfSure = 1e-8;

// Places of the image in which something was found, of those in which it was
// looked for. What lies close together errs together (it is one texture, one
// thing that moves) and counts once.
struct Agreement {
  int agreeing = 0;
  int places = 0;
};

// What agrees with a pose, and how unlike it is to the landmark that it was
// matched to: squared distance of the descriptors.
struct Likeness {
  Eigen::Vector2d pixel_px;
  int squared_distance = 0;
};

// Number of squares of a fortieth of the image's longer side that hold one of
// the pixels.
int CountPlaces(std::span<const Eigen::Vector2d> pixels_px,
                const geometry::CameraModel& camera);

// Natural logarithm of the number of false alarms, where each place agrees by
// chance with probability `chance`, inside (0, 1).
double LogFalseAlarms(const Agreement& agreement, double chance);
// Of the places in which something agrees with the pose or with the decoy,
// those that are the pose's: only it agrees there, or it is more like the map.
// Where both are as like, nobody can tell: such places do not count.
//   decoy  in the frame itself, not in its mirror image.
Agreement AgreementOverDecoy(std::span<const Likeness> pose,
                             std::span<const Likeness> decoy,
                             const geometry::CameraModel& camera);
double LogFalseAlarmsOverDecoy(const Agreement& agreement);

// By how much they are fewer than a pose may have that is believed; negative if
// there are more.
double LogMargin(double log_false_alarms);
bool IsSure(double log_false_alarms);
inline bool IsBelieved(double log_false_alarms) {
  return LogMargin(log_false_alarms) >= 0.0;
}

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_AGREEMENT_H_
