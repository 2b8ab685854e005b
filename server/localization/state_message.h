// SPDX-License-Identifier: Apache-2.0
// The message that a localizer's state is carried in (Localizer::Save): says
// of which localizer and which map it is, holds each image once, and then the
// fields (map_store/base/state_stream.h).
//
//   bytes  what
//   8      "GLCAMERA"
//   2      version of the format
//   1      length of the localizer's name, then the name
//   32     the map's content hash
//   1      number of images; of each 2 + 2 bytes width and height, and its
//          pixels: 8-bit luma, row by row
//   …      fields
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_STATE_MESSAGE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_STATE_MESSAGE_H_

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "absl/status/status.h"
#include "map_store/base/state_stream.h"
#include "map_store/geometry/state_fields.h"
#include "map_store/map/map.h"
#include "server/image/luma_pyramid.h"

namespace groundlock::localization {

// The fields, and the images that they name. Not thread-safe.
class StateMessageWriter : public base::StateWriter {
 public:
  std::uint8_t IndexOf(
      const std::shared_ptr<const image::LumaPyramid>& pyramid);
  std::string Message(std::string_view localizer, const map::Map& map) const;

 private:
  std::vector<std::shared_ptr<const image::LumaPyramid>> pyramids_;
};

// Reads what stands before the fields first. Not thread-safe.
class StateMessageReader : public base::StateReader {
 public:
  explicit StateMessageReader(std::string_view message)
      : StateReader(message) {}

  // To be called before anything else. kInvalidArgument: no such message, or a
  // damaged one; kUnimplemented: of another version; kFailedPrecondition: of
  // another localizer or map.
  absl::Status Open(std::string_view localizer, const map::Map& map);
  // Of an index that a field holds; fails where there is none.
  std::shared_ptr<const image::LumaPyramid> PyramidAt(std::uint8_t index);
  // All was read, and was right. kInvalidArgument names the field.
  absl::Status Close();

 private:
  void ReadImage();

  std::vector<std::shared_ptr<const image::LumaPyramid>> pyramids_;
};

// An image, of which the message holds the first level; or none.
template <typename Stream,
          base::StateOf<std::shared_ptr<const image::LumaPyramid>> T>
void StateValue(Stream& stream, T& pyramid) {
  constexpr std::uint8_t kNone = 255;
  std::uint8_t index = kNone;
  if constexpr (!Stream::kReads) {
    if (pyramid != nullptr) index = stream.IndexOf(pyramid);
  }
  StateValue(stream, index);
  if constexpr (Stream::kReads) {
    pyramid = nullptr;
    if (index != kNone) pyramid = stream.PyramidAt(index);
  }
}

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_STATE_MESSAGE_H_
