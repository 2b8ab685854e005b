// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/file_layout.h"

#include <xxhash.h>

#include <algorithm>
#include <memory>

#include "absl/strings/str_cat.h"

namespace groundlock::map::internal {

const char* SectionName(SectionId id) {
  switch (id) {
    case SectionId::kMeta:
      return "meta";
    case SectionId::kStrings:
      return "strings";
    case SectionId::kCameras:
      return "cameras";
    case SectionId::kViews:
      return "views";
    case SectionId::kLandmarks:
      return "landmarks";
    case SectionId::kFeatures:
      return "features";
    case SectionId::kObservations:
      return "observations";
    case SectionId::kDescriptors:
      return "descriptors";
    case SectionId::kIndexInnerWords:
      return "index inner words";
    case SectionId::kIndexLeafWords:
      return "index leaf words";
    case SectionId::kIndexListBegin:
      return "index list begin";
    case SectionId::kIndexLandmarks:
      return "index landmarks";
    case SectionId::kIndexDescriptors:
      return "index descriptors";
    case SectionId::kGroundRelief:
      return "ground relief";
  }
  return "unknown";
}

std::uint32_t NumSections(std::uint32_t format_version) {
  return format_version < 4 ? 13 : kNumSections;
}

std::uint32_t SectionElementBytes(SectionId id, std::uint32_t format_version) {
  switch (id) {
    case SectionId::kMeta:
      if (format_version == 1) return kMetaBytesVersion1;
      if (format_version == 2) return kMetaBytesVersion2;
      if (format_version == 3) return kMetaBytesVersion3;
      if (format_version == 4) return kMetaBytesVersion4;
      return format_version == 5 ? kMetaBytesVersion5 : sizeof(MetaRecord);
    case SectionId::kStrings:
      return 1;
    case SectionId::kCameras:
      return sizeof(CameraRecord);
    case SectionId::kViews:
      return sizeof(ViewRecord);
    case SectionId::kLandmarks:
      return sizeof(Landmark);
    case SectionId::kFeatures:
      return sizeof(Feature);
    case SectionId::kObservations:
      return sizeof(std::uint64_t);
    case SectionId::kIndexLandmarks:
      return sizeof(std::uint32_t);
    case SectionId::kIndexListBegin:
      return sizeof(std::uint64_t);
    case SectionId::kDescriptors:
    case SectionId::kIndexInnerWords:
    case SectionId::kIndexLeafWords:
    case SectionId::kIndexDescriptors:
      return sizeof(Descriptor);
    case SectionId::kGroundRelief:
      return sizeof(GroundRelief::Knot);
  }
  return 0;
}

Hash128 HashBytes(const void* data, std::size_t bytes) {
  const XXH128_hash_t hash = XXH3_128bits(data, bytes);
  return {hash.low64, hash.high64};
}

std::optional<Hash128> HashBytes(const void* data,
                                 std::size_t bytes,
                                 const std::function<bool()>& go_on) {
  constexpr std::size_t kPartBytes = std::size_t{4} << 20;
  const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(
      XXH3_createState(), &XXH3_freeState);
  XXH3_128bits_reset(state.get());
  const auto* at = static_cast<const std::byte*>(data);
  for (std::size_t done = 0; done < bytes;) {
    const std::size_t part = std::min(kPartBytes, bytes - done);
    XXH3_128bits_update(state.get(), at + done, part);
    done += part;
    if (!go_on()) return std::nullopt;
  }
  const XXH128_hash_t hash = XXH3_128bits_digest(state.get());
  return Hash128{hash.low64, hash.high64};
}

Hash128 HashHeader(const FileHeader& header) {
  FileHeader without = header;
  without.content_hash = {};
  // Of an older version's header: it ends with the last of its sections.
  const std::size_t absent = kNumSections - NumSections(header.format_version);
  return HashBytes(&without, sizeof(without) - absent * sizeof(SectionRecord));
}

std::string HexOf(const Hash128& hash) {
  return absl::StrCat(absl::Hex(hash.high, absl::kZeroPad16),
                      absl::Hex(hash.low, absl::kZeroPad16));
}

}  // namespace groundlock::map::internal
