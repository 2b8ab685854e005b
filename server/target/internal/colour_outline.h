// SPDX-License-Identifier: Apache-2.0
// Where a target's outline lies, as its colours tell.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_COLOUR_OUTLINE_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_COLOUR_OUTLINE_H_

#include <Eigen/Core>

#include "map_store/geometry/box.h"
#include "server/target/internal/colour_histogram.h"

namespace groundlock::target::internal {

// A correlation filter that learns what it finds creeps along with whatever is
// in its box; it does not see how the box's shape changes, either. Colours are
// a witness of both that forgets slowly: of all boxes near the tracker's, the
// one whose content is most likely the target's, and the rest its
// surroundings', by the histograms of both (regions against regions: S. Zhu, A.
// Yuille, "Region competition", PAMI 1996, on rectangles).
//
// That box is not the drawn one: a shadow, or a face that looks like the road,
// may be part of what was drawn. So only changes of where it lies relative to
// the tracker's box count, and each of them as much as it is known: four
// steady-state Kalman filters of random walks (centre along both axes, size,
// aspect), with the greater of the variance that the evidence's curvature tells
// and of that which was seen. Where the surroundings have the target's colours
// nothing is corrected.
//
// Not thread-safe.
class ColourOutline {
 public:
  // `box_samples`, in samples of the patch that `colours` last looked at
  // (ColourHistogram::LookForBoxes), is as it was drawn. Forgets everything.
  void Start(const ColourHistogram& colours, const geometry::Box2& box_samples);
  // The tracker's box corrected; what it was off by is learnt by the next
  // Learn.
  geometry::Box2 Correct(const ColourHistogram& colours,
                         const geometry::Box2& box_samples);
  // The last corrected box is the target's.
  void Learn();

 private:
  friend struct StateFields;

  // How a box lies relative to another one: along x and y, in sizes of that
  // one; the logarithm of the size's ratio, and half of that of the aspects'.
  using Offset = Eigen::Vector4d;

  static geometry::Box2 Moved(const geometry::Box2& box, const Offset& offset);
  // The likeliest box near `box_samples`, and how well each of the four is
  // known.
  static Offset LikeliestOffset(const ColourHistogram& colours,
                                const geometry::Box2& box_samples,
                                Offset& variance);

  Offset usual_ = Offset::Zero();     // of the likeliest box
  Offset variance_ = Offset::Zero();  // about that
  Offset surprise_ = Offset::Zero();  // of the last box that was corrected
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_COLOUR_OUTLINE_H_
