// SPDX-License-Identifier: Apache-2.0
// What of a photo's XMP packet is needed here: numbers by their names. It is
// no reader of XML: packets of cameras are often not well-formed, and what is
// asked for is an attribute or an element of text.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_XMP_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_XMP_H_

#include <optional>
#include <string_view>

namespace groundlock::formats::internal {

// The packet in the bytes of a JPEG, a part of them; empty if there is none
// before the picture, or the segment before it is cut off.
// Source: XMP specification part 3 (Adobe 2020), section 1.1.3.
std::string_view XmpPacket(std::string_view jpeg);

// The number of the first attribute (prefix:name="1.5") or element
// (<prefix:name>1.5</prefix:name>) of that name, as cameras write it: with a
// sign or without, or as a fraction a/b. nullopt if there is none or it is no
// finite number.
std::optional<double> XmpNumber(std::string_view packet, std::string_view name);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_XMP_H_
