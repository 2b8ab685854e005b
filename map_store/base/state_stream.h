// SPDX-License-Identifier: Apache-2.0
// Plain data as bytes and back: what a session knows, so that it can go on
// elsewhere. Little-endian, without padding; numbers to the last bit.
//
// A type lists its fields once, for both directions, so that what is written
// and what is read cannot differ:
//
//   template <typename Stream, base::StateOf<Route> T>  // const when written
//   void StateValue(Stream& stream, T& route) {
//     Field(stream, "route.length_m", route.length_m);
//     List(stream, "route.points", route.points, kMaxPoints);
//     if (route.length_m < 0.0) stream.Fail("is below 0");
//   }
//
// Bytes that are read come from strangers. A reader allocates no more than the
// bytes that are there account for and accepts no number that is not finite or
// beyond kLargestStateNumber; after its first failure, which names the field,
// it goes on with zeros.
// Whether values make sense together is the type's to check.
#ifndef GROUNDLOCK_MAP_STORE_BASE_STATE_STREAM_H_
#define GROUNDLOCK_MAP_STORE_BASE_STATE_STREAM_H_

#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::base {

static_assert(std::endian::native == std::endian::little,
              "numbers are copied as they lie");

// `Type`, or `const Type`.
template <typename T, typename Type>
concept StateOf = std::same_as<std::remove_const_t<T>, Type>;

// Metres, pixels, seconds, and what they are multiplied to stay below it, and
// products of several such numbers stay finite.
inline constexpr double kLargestStateNumber = 1e18;

template <typename T>
concept StateNumber = std::is_arithmetic_v<T> && !StateOf<T, bool>;

// Not thread-safe.
class StateWriter {
 public:
  static constexpr bool kReads = false;

  void Bytes(std::string_view bytes) { bytes_.append(bytes); }
  const std::string& bytes() const { return bytes_; }

  // What is written is right: these are for the reader, which has them, too.
  void Enter(std::string_view) {}
  void Fail(std::string_view) {}

 private:
  std::string bytes_;
};

// Not thread-safe. The bytes outlive it.
class StateReader {
 public:
  static constexpr bool kReads = true;

  explicit StateReader(std::string_view bytes) : bytes_(bytes) {}

  // The next `count` bytes, where they lie; none if so many are not there.
  std::string_view Bytes(std::size_t count) {
    if (count > bytes_.size()) {
      Fail("ends too early");
      return {};
    }
    const std::string_view taken = bytes_.substr(0, count);
    bytes_.remove_prefix(count);
    return taken;
  }
  std::size_t remaining() const { return bytes_.size(); }

  // What is read from here on belongs to the field.
  void Enter(std::string_view field) { field_ = field; }
  // The first failure counts.
  void Fail(std::string_view what) {
    if (!status_.ok()) return;
    status_ = absl::InvalidArgumentError(
        absl::StrCat(Abseil(field_), " ", Abseil(what)));
    bytes_ = {};
  }
  bool ok() const { return status_.ok(); }
  // kInvalidArgument: "FIELD WHAT".
  const absl::Status& status() const { return status_; }

 private:
  std::string_view bytes_;  // not read yet
  std::string_view field_ = "it";
  absl::Status status_;
};

template <typename Stream, StateNumber T>
void StateValue(Stream& stream, T& value) {
  if constexpr (Stream::kReads) {
    value = T{};
    const std::string_view raw = stream.Bytes(sizeof(T));
    if (raw.empty()) return;
    std::memcpy(&value, raw.data(), sizeof(T));
    if constexpr (std::is_floating_point_v<T>) {
      if (std::abs(value) <= kLargestStateNumber) return;
      value = T{};
      stream.Fail("is not finite, or beyond all bounds");
    }
  } else {
    char raw[sizeof(T)];
    std::memcpy(raw, &value, sizeof(T));
    stream.Bytes({raw, sizeof(T)});
  }
}

template <typename Stream, StateOf<bool> T>
void StateValue(Stream& stream, T& value) {
  std::uint8_t byte = value ? 1 : 0;
  StateValue(stream, byte);
  if constexpr (Stream::kReads) {
    if (byte > 1) stream.Fail("is neither true nor false");
    value = byte == 1;
  }
}

// A frame's time: never negative, and so near that differences of two do not
// overflow.
template <typename Stream, StateOf<std::chrono::nanoseconds> T>
void StateValue(Stream& stream, T& value) {
  std::int64_t count = value.count();
  StateValue(stream, count);
  if constexpr (Stream::kReads) {
    const bool is_time = count >= 0 && count <= (std::int64_t{1} << 62);
    if (!is_time) stream.Fail("is no time");
    value = std::chrono::nanoseconds(is_time ? count : 0);
  }
}

template <typename Stream, typename T, std::size_t kSize>
void StateValue(Stream& stream, std::array<T, kSize>& values) {
  for (T& value : values) StateValue(stream, value);
}
template <typename Stream, typename T, std::size_t kSize>
void StateValue(Stream& stream, const std::array<T, kSize>& values) {
  for (const T& value : values) StateValue(stream, value);
}

template <typename Stream, typename A, typename B>
void StateValue(Stream& stream, std::pair<A, B>& value) {
  StateValue(stream, value.first);
  StateValue(stream, value.second);
}
template <typename Stream, typename A, typename B>
void StateValue(Stream& stream, const std::pair<A, B>& value) {
  StateValue(stream, value.first);
  StateValue(stream, value.second);
}

template <typename Stream, typename T>
void StateValue(Stream& stream, const std::optional<T>& value) {
  const bool is_there = value.has_value();
  StateValue(stream, is_there);
  if (value) StateValue(stream, *value);
}
template <typename Stream, typename T>
void StateValue(Stream& stream, std::optional<T>& value) {
  bool is_there = false;
  StateValue(stream, is_there);
  value.reset();
  if (is_there) StateValue(stream, value.emplace(T()));
}

template <typename Stream, typename T>
void Field(Stream& stream, std::string_view field, T& value) {
  stream.Enter(field);
  if constexpr (Stream::kReads) {
    StateValue(stream, value);
  } else {
    StateValue(stream, std::as_const(value));
  }
}

// A container, of which a reader accepts no more than `most` elements. Each
// takes a byte at least.
template <typename Stream, typename Container>
void List(Stream& stream,
          std::string_view field,
          Container& values,
          std::size_t most) {
  stream.Enter(field);
  auto count = static_cast<std::uint32_t>(values.size());
  StateValue(stream, count);
  if constexpr (Stream::kReads) {
    values.clear();
    if (count > most) stream.Fail("has too many elements");
    for (; count > 0 && stream.ok(); --count) {
      values.emplace_back();
      StateValue(stream, values.back());
    }
  } else {
    for (const auto& value : values) StateValue(stream, value);
  }
}

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_STATE_STREAM_H_
