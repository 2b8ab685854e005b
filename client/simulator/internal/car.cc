// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <span>

#include "client/simulator/internal/scene_model.h"

namespace groundlock::simulator {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr float kHalfLength_m = kCarLength_m / 2;
constexpr float kHalfWidth_m = kCarWidth_m / 2;
constexpr float kTrack_m = 0.015F;  // how far the wheels stand out of the body
constexpr float kDecal_m = 0.002F;  // decals lie this far above the body
constexpr int kWheelSegments = 18;

// Linear blue, green, red.
const Vector3f kRed(0.02F, 0.05F, 0.62F);
const Vector3f kWhite(0.75F, 0.78F, 0.8F);
const Vector3f kGlass(0.035F, 0.03F, 0.025F);
const Vector3f kRubber(0.014F, 0.014F, 0.014F);
const Vector3f kRim(0.55F, 0.55F, 0.55F);
const Vector3f kYellow(0.03F, 0.5F, 0.75F);

void Add(std::vector<CarFace>& faces,
         const Vector3f& a,
         const Vector3f& b,
         const Vector3f& c,
         const Vector3f& d,
         const Vector3f& color,
         float gloss,
         const Vector3f& outwards) {
  Vector3f normal = (b - a).cross(c - a).normalized();
  if (normal.dot(outwards) < 0.0F) normal = -normal;
  faces.push_back({{a, b, c, d}, normal, color, gloss});
}

// A prism across the car: the profile (x, z), convex, between y = -/+ half
// widths that shrink from `bottom` to `top` with the height.
void AddPrism(std::vector<CarFace>& faces,
              std::span<const Vector2f> profile,
              float half_width_low,
              float half_width_high,
              std::span<const Vector3f> colors,
              const Vector3f& side_color,
              float gloss) {
  float low = profile[0].y();
  float high = low;
  Vector2f middle = Vector2f::Zero();
  for (const Vector2f& p : profile) {
    low = std::min(low, p.y());
    high = std::max(high, p.y());
    middle += p / static_cast<float>(profile.size());
  }
  const auto at = [&](const Vector2f& p, float side) {
    const float f = (p.y() - low) / (high - low);
    const float half = half_width_low + f * (half_width_high - half_width_low);
    return Vector3f(p.x(), side * half, p.y());
  };
  const Vector3f center(middle.x(), 0, middle.y());
  const Vector3f left_middle = at(middle, 1);
  const Vector3f right_middle = at(middle, -1);
  for (std::size_t i = 0; i < profile.size(); ++i) {
    const Vector2f& p = profile[i];
    const Vector2f& q = profile[(i + 1) % profile.size()];
    Add(faces,
        at(p, -1),
        at(q, -1),
        at(q, 1),
        at(p, 1),
        colors[i],
        gloss,
        (at(p, -1) + at(q, 1)) / 2 - center);
    Add(faces,
        left_middle,
        at(p, 1),
        at(q, 1),
        at(q, 1),
        side_color,
        gloss,
        Vector3f::UnitY());
    Add(faces,
        right_middle,
        at(p, -1),
        at(q, -1),
        at(q, -1),
        side_color,
        gloss,
        -Vector3f::UnitY());
  }
}

void AddWheel(std::vector<CarFace>& faces, float x, float side) {
  constexpr float kRadius_m = 0.085F;
  constexpr float kThick_m = 0.09F;
  const float outer = side * kHalfWidth_m;
  const float inner = side * (kHalfWidth_m - kThick_m);
  const auto rim = [&](float angle, float radius, float y) {
    return Vector3f(
        x + radius * std::cos(angle), y, kRadius_m + radius * std::sin(angle));
  };
  for (int i = 0; i < kWheelSegments; ++i) {
    const float a =
        2 * std::numbers::pi_v<float> * static_cast<float>(i) / kWheelSegments;
    const float b = 2 * std::numbers::pi_v<float> * static_cast<float>(i + 1) /
                    kWheelSegments;
    const Vector3f out(std::cos((a + b) / 2), 0, std::sin((a + b) / 2));
    Add(faces,
        rim(a, kRadius_m, inner),
        rim(b, kRadius_m, inner),
        rim(b, kRadius_m, outer),
        rim(a, kRadius_m, outer),
        kRubber,
        0.0F,
        out);
    const Vector3f axis(0, side, 0);
    Add(faces,
        rim(a, kRadius_m, outer),
        rim(b, kRadius_m, outer),
        rim(b, 0.055F, outer),
        rim(a, 0.055F, outer),
        kRubber,
        0.0F,
        axis);
    Add(faces,
        Vector3f(x, outer, kRadius_m),
        rim(a, 0.055F, outer),
        rim(b, 0.055F, outer),
        rim(b, 0.055F, outer),
        i % 3 == 0 ? kRubber : kRim,
        0.2F,
        axis);
  }
}

// A flat decal on a plane through `at`.
void AddDecal(std::vector<CarFace>& faces,
              const Vector3f& at,
              const Vector3f& u,
              const Vector3f& v,
              const Vector3f& outwards,
              const Vector3f& color) {
  const Vector3f lift = at + outwards.normalized() * kDecal_m;
  Add(faces, lift, lift + u, lift + u + v, lift + v, color, 0.15F, outwards);
}

void AddDecals(std::vector<CarFace>& faces, float body_half) {
  for (const float side : {-1.0F, 1.0F}) {
    const Vector3f out(0, side, 0);
    // Stripe and a number plate between the wheels.
    AddDecal(faces,
             {-0.2F, side * body_half, 0.105F},
             {0.36F, 0, 0},
             {0, 0, 0.028F},
             out,
             kWhite);
    AddDecal(faces,
             {-0.06F, side * body_half, 0.14F},
             {0.13F, 0, 0},
             {0, 0, 0.045F},
             out,
             kYellow);
    // Lamps.
    AddDecal(faces,
             {kHalfLength_m, side * 0.13F, 0.12F},
             {0, side * 0.07F, 0},
             {0, 0, 0.035F},
             Vector3f::UnitX(),
             kWhite);
    AddDecal(faces,
             {-kHalfLength_m, side * 0.13F, 0.13F},
             {0, side * 0.08F, 0},
             {0, 0, 0.03F},
             -Vector3f::UnitX(),
             kYellow);
    // Two racing stripes over the bonnet.
    AddDecal(faces,
             {0.2F, side * 0.06F, 0.2085F},
             {0.23F, 0, -0.0295F},
             {0, side * 0.05F, 0},
             Vector3f::UnitZ(),
             kWhite);
  }
  AddDecal(faces,
           {-0.2F, -0.06F, 0.349F - kDecal_m},
           {0.22F, 0, 0},
           {0, 0.12F, 0},
           Vector3f::UnitZ(),
           kWhite);
}

}  // namespace

std::vector<CarFace> BuildCar() {
  std::vector<CarFace> faces;
  const float body_half = kHalfWidth_m - kTrack_m;
  const float l = kHalfLength_m;
  const std::vector<Vector2f> body = {{-l, 0.06F},
                                      {l, 0.06F},
                                      {l, 0.165F},
                                      {0.43F, 0.179F},
                                      {0.2F, 0.2085F},
                                      {-0.38F, 0.215F},
                                      {-l, 0.195F}};
  const std::vector<Vector3f> body_colors = {
      kRubber, kRed, kRed, kRed, kRed, kRed, kRed};
  AddPrism(faces, body, body_half, body_half, body_colors, kRed, 0.25F);
  const std::vector<Vector2f> cabin = {
      {-0.36F, 0.21F}, {0.2F, 0.208F}, {0.05F, 0.335F}, {-0.25F, 0.335F}};
  const std::vector<Vector3f> cabin_colors = {kRed, kGlass, kRed, kGlass};
  AddPrism(faces, cabin, body_half - 0.02F, 0.15F, cabin_colors, kGlass, 0.6F);
  const std::vector<Vector2f> roof = {{-0.26F, 0.33F},
                                      {0.06F, 0.33F},
                                      {0.04F, kCarHeight_m - 0.003F},
                                      {-0.24F, kCarHeight_m - 0.003F}};
  const std::vector<Vector3f> roof_colors(4, kRed);
  AddPrism(faces, roof, 0.165F, 0.155F, roof_colors, kRed, 0.25F);
  for (const float x : {-0.28F, 0.28F}) {
    AddWheel(faces, x, -1.0F);
    AddWheel(faces, x, 1.0F);
  }
  AddDecals(faces, body_half);
  return faces;
}

}  // namespace groundlock::simulator
