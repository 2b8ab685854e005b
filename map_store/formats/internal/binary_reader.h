// SPDX-License-Identifier: Apache-2.0
// Reads little-endian records out of bytes that nobody vouches for.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_BINARY_READER_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_BINARY_READER_H_

#include <bit>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <type_traits>

#include "absl/status/status.h"

namespace groundlock::formats::internal {

static_assert(std::endian::native == std::endian::little,
              "the readers copy little-endian numbers as they lie");

// Failure is sticky: past the end every Read returns zero and ok() is false, so
// a record is read without a branch per field and checked once. Counts must go
// through CheckCount before anything is allocated for them.
class BinaryReader {
 public:
  // `file` names the bytes in messages; both outlive the reader.
  BinaryReader(std::string_view bytes, std::string_view file)
      : bytes_(bytes), file_(file) {}

  bool ok() const { return ok_; }
  std::size_t offset() const { return offset_; }
  std::size_t remaining() const { return bytes_.size() - offset_; }

  template <typename T>
  T Read() {
    static_assert(std::is_arithmetic_v<T>);
    T value{};
    if (!ok_ || remaining() < sizeof(T)) {
      ok_ = false;
      return value;
    }
    std::memcpy(&value, bytes_.data() + offset_, sizeof(T));
    offset_ += sizeof(T);
    return value;
  }

  // The next `size` bytes, without a copy.
  std::string_view ReadBytes(std::size_t size) {
    if (!ok_ || remaining() < size) {
      ok_ = false;
      return {};
    }
    const std::string_view result = bytes_.substr(offset_, size);
    offset_ += size;
    return result;
  }

  // Text up to a NUL, which is consumed, of at most max_size bytes.
  std::string_view ReadCString(std::size_t max_size);

  // kInvalidArgument if `count` items of at least min_item_bytes each cannot
  // lie in what remains.
  absl::Status CheckCount(std::uint64_t count,
                          std::size_t min_item_bytes,
                          std::string_view what) const;

  // "<file>: byte <offset>: <what>".
  absl::Status Error(std::string_view what) const;
  // kInvalidArgument that the file ends inside `what`, if a Read failed.
  absl::Status CheckOk(std::string_view what) const;
  // kInvalidArgument if bytes are left over.
  absl::Status CheckAtEnd() const;

 private:
  std::string_view bytes_;
  std::string_view file_;
  std::size_t offset_ = 0;
  bool ok_ = true;
};

// True if the bytes start as text does; a binary COLMAP file starts with a
// small 64-bit count, hence with NUL bytes.
bool LooksLikeText(std::string_view bytes);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_BINARY_READER_H_
