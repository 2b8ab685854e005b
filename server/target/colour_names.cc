// SPDX-License-Identifier: Apache-2.0
#include "server/target/colour_names.h"

#include <algorithm>
#include <cmath>

#include "server/target/internal/colour_name_model.h"

namespace groundlock::target {
namespace {

using internal::ColourSurface;

struct Lab {
  double l, a, b;
};

double Sigmoid(double slope, double x) {
  return 1.0 / (1.0 + std::exp(-slope * x));
}

double LinearFromSrgb(double value) {
  const double v = value / 255.0;
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}

double LabRoot(double t) {
  constexpr double kLinearBelow = 216.0 / 24389.0;  // CIE 15:2004
  return t > kLinearBelow ? std::cbrt(t) : (24389.0 / 27.0 * t + 16.0) / 116.0;
}

Lab LabFromSrgb(double red, double green, double blue) {
  const double r = LinearFromSrgb(red);
  const double g = LinearFromSrgb(green);
  const double b = LinearFromSrgb(blue);
  // sRGB primaries, D65.
  const double x = 0.412424 * r + 0.357579 * g + 0.180464 * b;
  const double y = 0.212656 * r + 0.715158 * g + 0.0721856 * b;
  const double z = 0.0193324 * r + 0.119193 * g + 0.950444 * b;
  const double fx = LabRoot(x / 0.9505);
  const double fy = LabRoot(y);
  const double fz = LabRoot(z / 1.0891);
  return {116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)};
}

int LightnessLevel(double lightness) {
  constexpr std::array<double, 5> kUpperBounds = {31, 42, 51, 66, 76};
  return static_cast<int>(
      std::lower_bound(kUpperBounds.begin(), kUpperBounds.end(), lightness) -
      kUpperBounds.begin());
}

double Membership(const ColourSurface& s, const Lab& colour) {
  if (s.beta_e == 0.0) return 0.0;
  const double x = colour.a - s.tx;
  const double y = colour.b - s.ty;
  const double u = x * std::cos(s.alpha_y) + y * std::sin(s.alpha_y);
  const double v = -x * std::sin(s.alpha_x) + y * std::cos(s.alpha_x);
  const double along = (x * std::cos(s.phi) + y * std::sin(s.phi)) / s.e_x;
  const double across = (-x * std::sin(s.phi) + y * std::cos(s.phi)) / s.e_y;
  return Sigmoid(s.beta_y, u) * Sigmoid(s.beta_x, v) *
         Sigmoid(s.beta_e, along * along + across * across - 1.0);
}

}  // namespace

ColourNameVector NameColour(double red, double green, double blue) {
  const Lab colour = LabFromSrgb(red, green, blue);
  const int level = LightnessLevel(colour.l);
  std::array<double, kColourNames> p = {};
  double chromatic = 0.0;
  for (const internal::ChromaticName& name : internal::ChromaticNames()) {
    const double membership = Membership(name.level[level], colour);
    p[static_cast<int>(name.name)] = membership;
    chromatic += membership;
  }
  // What no chromatic colour claims is shared by lightness: the two crossings
  // black-grey and grey-white and their slopes are those of the paper.
  constexpr double kBlackGrey = 28.28252201;
  constexpr double kBlackGreySlope = 0.71423449;
  constexpr double kGreyWhite = 79.64930057;
  constexpr double kGreyWhiteSlope = 0.30674052;
  const double rest = std::max(0.0, 1.0 - chromatic);
  const double not_black = Sigmoid(kBlackGreySlope, colour.l - kBlackGrey);
  const double white = Sigmoid(kGreyWhiteSlope, colour.l - kGreyWhite);
  p[static_cast<int>(ColourName::kBlack)] = rest * (1.0 - not_black);
  p[static_cast<int>(ColourName::kGrey)] = rest * not_black * (1.0 - white);
  p[static_cast<int>(ColourName::kWhite)] = rest * white;

  double sum = 0.0;
  for (const double value : p) sum += value;
  ColourNameVector normalised;
  for (int i = 0; i < kColourNames; ++i) {
    normalised[i] = static_cast<float>(p[i] / sum);
  }
  return normalised;
}

ColourNameTable::ColourNameTable() {
  cells_.reserve(32 * 32 * 32);
  for (int red = 0; red < 32; ++red) {
    for (int green = 0; green < 32; ++green) {
      for (int blue = 0; blue < 32; ++blue) {
        cells_.push_back(
            {NameColour(8.0 * red + 3.5, 8.0 * green + 3.5, 8.0 * blue + 3.5)});
      }
    }
  }
}

const ColourNameTable& ColourNameTable::Get() {
  static const ColourNameTable table;
  return table;
}

}  // namespace groundlock::target
