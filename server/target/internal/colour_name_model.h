// SPDX-License-Identifier: Apache-2.0
// Figures of the parametric colour naming model; see colour_names.h.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_COLOUR_NAME_MODEL_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_COLOUR_NAME_MODEL_H_

#include <array>

#include "server/target/colour_names.h"

namespace groundlock::target::internal {

inline constexpr int kChromaticNames = 8;
inline constexpr int kLightnessLevels = 6;

// One colour's surface over the (a, b) plane at one lightness level: a product
// of two sigmoids (slopes beta_x, beta_y along axes turned by alpha_x, alpha_y)
// and an elliptic sigmoid (slope beta_e, axes e_x, e_y turned by phi), all
// about (tx, ty).
struct ColourSurface {
  double tx, ty;
  double alpha_x, alpha_y;
  double beta_x, beta_y, beta_e;
  double e_x, e_y;
  double phi;
};

struct ChromaticName {
  ColourName name;
  std::array<ColourSurface, kLightnessLevels> level;
};

const std::array<ChromaticName, kChromaticNames>& ChromaticNames();

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_COLOUR_NAME_MODEL_H_
