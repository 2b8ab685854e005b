// SPDX-License-Identifier: Apache-2.0
#include <zlib.h>

#include <algorithm>

#include "map_store/base/status.h"
#include "map_store/formats/internal/bundler_model.h"

namespace groundlock::formats::internal {

absl::StatusOr<std::string> Gunzip(std::string_view bytes,
                                   std::uint64_t max_bytes,
                                   std::string_view file) {
  z_stream stream{};
  constexpr int kGzipOnly = 16;
  if (inflateInit2(&stream, MAX_WBITS + kGzipOnly) != Z_OK) {
    return absl::ResourceExhaustedError("no memory to unpack with");
  }
  std::string result;
  std::string block(std::size_t{1} << 18, '\0');
  int status = Z_OK;
  while (status == Z_OK && result.size() <= max_bytes) {
    if (stream.avail_in == 0) {
      const std::size_t size =
          std::min<std::size_t>(bytes.size(), std::size_t{1} << 20);
      if (size == 0) break;  // the end is missing
      stream.next_in =
          reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
      stream.avail_in = static_cast<uInt>(size);
      bytes.remove_prefix(size);
    }
    stream.next_out = reinterpret_cast<Bytef*>(block.data());
    stream.avail_out = static_cast<uInt>(block.size());
    status = inflate(&stream, Z_NO_FLUSH);
    result.append(block, 0, block.size() - stream.avail_out);
  }
  inflateEnd(&stream);
  if (result.size() > max_bytes) {
    return absl::ResourceExhaustedError(absl::StrCat(
        base::Abseil(file), ": unpacks to more than ", max_bytes, " bytes"));
  }
  if (status != Z_STREAM_END) {
    return absl::InvalidArgumentError(
        absl::StrCat(base::Abseil(file), ": damaged or not gzip"));
  }
  return result;
}

}  // namespace groundlock::formats::internal
