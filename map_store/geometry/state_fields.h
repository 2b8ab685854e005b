// SPDX-License-Identifier: Apache-2.0
// Vectors, poses, boxes and lenses as fields of a state (state_stream.h), in
// whose namespace streams look for them.
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_STATE_FIELDS_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_STATE_FIELDS_H_

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <string_view>
#include <type_traits>
#include <utility>

#include "map_store/base/state_stream.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::base {

// A matrix whose size both sides know: a reader's has it already.
template <typename Stream, typename T>
requires std::is_base_of_v<Eigen::PlainObjectBase<std::remove_const_t<T>>,
                           std::remove_const_t<T>>
void StateValue(Stream& stream, T& matrix) {
  for (Eigen::Index i = 0; i < matrix.size(); ++i) {
    StateValue(stream, matrix.data()[i]);
  }
}

// A matrix that may be a covariance, as far as each two of its variables tell:
// symmetric and of no correlation beyond 1, to rounding.
template <typename Stream, typename T>
void Covariance(Stream& stream, std::string_view field, T& matrix) {
  Field(stream, field, matrix);
  if constexpr (Stream::kReads) {
    constexpr double kRounding = 1e-6;
    const auto& diagonal = matrix.diagonal();
    const double least = kRounding * diagonal.maxCoeff();
    bool is_one = diagonal.minCoeff() >= 0.0;
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
      for (Eigen::Index j = 0; j < i; ++j) {
        const double most = std::sqrt(std::max(0.0, matrix(i, i)) *
                                      std::max(0.0, matrix(j, j)));
        is_one = is_one && std::abs(matrix(i, j)) <= most + least &&
                 std::abs(matrix(i, j) - matrix(j, i)) <= least;
      }
    }
    if (is_one) return;
    matrix.setZero();
    stream.Fail("is no covariance");
  }
}

// Of unit length, as far as rounding lets it be.
template <typename Stream, StateOf<Eigen::Quaterniond> T>
void StateValue(Stream& stream, T& rotation) {
  StateValue(stream, rotation.coeffs());
  if constexpr (Stream::kReads) {
    if (std::abs(rotation.norm() - 1.0) < 1e-6) return;
    rotation.setIdentity();
    stream.Fail("is no unit quaternion");
  }
}

template <typename Stream, StateOf<geometry::Rigid3> T>
void StateValue(Stream& stream, T& rigid) {
  StateValue(stream, rigid.rotation);
  StateValue(stream, rigid.translation);
}

template <typename Stream, StateOf<geometry::Box2> T>
void StateValue(Stream& stream, T& box) {
  StateValue(stream, box.min_px);
  StateValue(stream, box.max_px);
}

template <typename Stream, StateOf<geometry::CameraModel> T>
void StateValue(Stream& stream, T& camera) {
  auto id = static_cast<std::uint8_t>(camera.id());
  auto width_px = static_cast<std::uint16_t>(camera.width_px());
  auto height_px = static_cast<std::uint16_t>(camera.height_px());
  StateValue(stream, id);
  StateValue(stream, width_px);
  StateValue(stream, height_px);
  if constexpr (Stream::kReads) {
    constexpr auto kLast =
        static_cast<std::uint8_t>(geometry::CameraModelId::kOpenCvFisheye);
    if (id > kLast) {
      stream.Fail("has no camera model");
      return;
    }
    const auto model = static_cast<geometry::CameraModelId>(id);
    std::array<double, geometry::CameraModel::kMaxParams> params{};
    const auto used = std::span(params).first(
        static_cast<std::size_t>(geometry::NumCameraModelParams(model)));
    for (double& param : used) StateValue(stream, param);
    auto made = geometry::CameraModel::Create(model, width_px, height_px, used);
    if (made.ok()) {
      camera = *std::move(made);
    } else {
      stream.Fail(Std(made.status().message()));
    }
  } else {
    for (const double& param : camera.params()) StateValue(stream, param);
  }
}

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_STATE_FIELDS_H_
