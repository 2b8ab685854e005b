// SPDX-License-Identifier: Apache-2.0
// The eleven basic colour names of a pixel: how probable it is that a person
// calls its colour black, blue, ... yellow. Closed form after R. Benavente,
// M. Vanrell, R. Baldrich, "Parametric fuzzy sets for automatic color naming",
// J. Opt. Soc. Am. A 25(10), 2008 (the TSE model), in place of the learnt table
// of van de Weijer et al. 2009 that Danelljan et al. 2014 use.
#ifndef GROUNDLOCK_SERVER_TARGET_COLOUR_NAMES_H_
#define GROUNDLOCK_SERVER_TARGET_COLOUR_NAMES_H_

#include <array>
#include <cstdint>
#include <vector>

namespace groundlock::target {

enum class ColourName {
  kBlack,
  kBlue,
  kBrown,
  kGrey,
  kGreen,
  kOrange,
  kPink,
  kPurple,
  kRed,
  kWhite,
  kYellow,
};
inline constexpr int kColourNames = 11;

// Probabilities, indexed by ColourName; they sum to 1.
using ColourNameVector = std::array<float, kColourNames>;

// Evaluates the model for one sRGB colour, components in [0, 255].
ColourNameVector NameColour(double red, double green, double blue);

// The model at the centres of 32 x 32 x 32 cells of sRGB, as coarse as the
// learnt table is. Immutable; thread-safe.
class ColourNameTable {
 public:
  // The one table of the process: a constant, computed on first use (about
  // 20 ms).
  static const ColourNameTable& Get();

  // Of the components' first bits.
  static constexpr int kBits = 5;

  const ColourNameVector& At(std::uint8_t red,
                             std::uint8_t green,
                             std::uint8_t blue) const {
    constexpr int kLeft = 8 - kBits;
    return At(((((red >> kLeft) << kBits) | (green >> kLeft)) << kBits) |
              (blue >> kLeft));
  }
  // `cell`: the first bits of red, green and blue, one after the other.
  const ColourNameVector& At(int cell) const { return cells_[cell].names; }

 private:
  ColourNameTable();

  // In a cache line of its own: a look-up waits for one.
  struct alignas(64) Cell {
    ColourNameVector names;
  };
  std::vector<Cell> cells_;
};

}  // namespace groundlock::target

#endif  // GROUNDLOCK_SERVER_TARGET_COLOUR_NAMES_H_
