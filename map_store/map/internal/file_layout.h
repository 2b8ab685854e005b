// SPDX-License-Identifier: Apache-2.0
// The bytes of a map file; docs/map_file.md describes them for others.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_FILE_LAYOUT_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_FILE_LAYOUT_H_

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <type_traits>

#include "map_store/map/map.h"

namespace groundlock::map::internal {

static_assert(std::endian::native == std::endian::little,
              "map files are little-endian and used where they lie");

// Line ends and a byte above 127 reveal a file that went through a text-mode
// or 7-bit transfer (the idea of PNG's signature).
inline constexpr std::array<std::uint8_t, 8> kMagic = {
    0x8E, 'G', 'L', 'M', 'A', 'P', '\r', '\n'};
// Version 2 added the origin to the meta record, version 3 how sure the ground
// is, version 4 its relief, version 5 who told it; older ones are still read.
inline constexpr std::uint32_t kFormatVersion = 6;
inline constexpr std::uint32_t kOldestFormatVersion = 1;
inline constexpr std::uint64_t kPageBytes = 4096;
inline constexpr std::size_t kMaxNameBytes = 4096;  // a path's limit on Linux
inline constexpr std::size_t kMaxSourceFormatBytes = 64;

enum class SectionId : std::uint32_t {
  kMeta = 1,          // one MetaRecord
  kStrings = 2,       // bytes: names of views, source format
  kCameras = 3,       // CameraRecord
  kViews = 4,         // ViewRecord
  kLandmarks = 5,     // Landmark
  kFeatures = 6,      // Feature, grouped by view
  kObservations = 7,  // uint64: indices of features, grouped by landmark
  kDescriptors = 8,   // Descriptor, one per feature, or none
  // The landmark index (landmark_index.h); empty without descriptors.
  kIndexInnerWords = 9,    // Descriptor, B of them
  kIndexLeafWords = 10,    // Descriptor, B^2 of them, grouped by inner word
  kIndexListBegin = 11,    // uint64, B^2 + 1: first entry of each leaf's list
  kIndexLandmarks = 12,    // uint32, one per entry
  kIndexDescriptors = 13,  // Descriptor, one per entry
  // Since version 4.
  kGroundRelief = 14,  // GroundRelief::Knot, row by row; none: a plane
};
inline constexpr std::uint32_t kNumSections = 14;
// In files of the given version.
std::uint32_t NumSections(std::uint32_t format_version);

const char* SectionName(SectionId id);
// In files of the given version.
std::uint32_t SectionElementBytes(SectionId id, std::uint32_t format_version);

struct Hash128 {
  std::uint64_t low = 0;
  std::uint64_t high = 0;
  friend bool operator==(const Hash128&, const Hash128&) = default;
};

struct SectionRecord {
  SectionId id{};
  std::uint32_t element_bytes = 0;
  std::uint64_t offset = 0;  // a multiple of kPageBytes
  std::uint64_t count = 0;   // of elements
  Hash128 checksum;          // XXH3-128 of the count * element_bytes bytes
};

// The first page of the file; the rest of the page is zero.
struct FileHeader {
  std::array<std::uint8_t, 8> magic = kMagic;
  std::uint32_t format_version = kFormatVersion;
  std::uint32_t num_sections = kNumSections;
  std::uint64_t file_bytes = 0;
  // XXH3-128 of the header with this field zero. It covers the checksums of all
  // sections and so all content: it is the map's content hash.
  Hash128 content_hash;
  std::array<SectionRecord, kNumSections> sections;
};

struct MetaRecord {
  double scale = 1.0;  // world_from_source
  std::array<double, 4> rotation_xyzw{};
  std::array<double, 3> translation{};
  std::array<double, 3> ground_normal{};
  double ground_d = 0.0;
  double mean_reprojection_error_px = 0.0;
  std::uint64_t source_format_offset = 0;  // into kStrings
  std::uint32_t source_format_bytes = 0;
  std::uint32_t metric = 0;  // 0 or 1
  // Since version 2. All zero without an origin.
  double origin_latitude_deg = 0.0;
  double origin_longitude_deg = 0.0;
  double origin_height_m = 0.0;
  std::uint64_t has_origin = 0;  // 0 or 1
  // Since version 3.
  double ground_sigma_rad = 0.0;   // 0 = not stated
  std::uint64_t ground_state = 0;  // GroundState
  // Since version 4: the grid of kGroundRelief (ground_relief.h).
  std::array<double, 2> relief_origin{};
  double relief_step = 0.0;
  std::uint64_t relief_columns = 0;
  // Since version 5: it was given (MapData::given_relief), 0 or 1.
  std::uint64_t relief_is_given = 0;
  // Since version 6: MapData::ground_height_sigma; 0 = not stated.
  double ground_height_sigma = 0.0;
};
inline constexpr std::uint32_t kMetaBytesVersion1 = 120;
inline constexpr std::uint32_t kMetaBytesVersion2 = 152;
inline constexpr std::uint32_t kMetaBytesVersion3 = 168;
inline constexpr std::uint32_t kMetaBytesVersion4 = 200;
inline constexpr std::uint32_t kMetaBytesVersion5 = 208;

struct CameraRecord {
  std::uint32_t model = 0;  // CameraModelId
  std::uint32_t width_px = 0;
  std::uint32_t height_px = 0;
  std::uint32_t reserved = 0;
  std::array<double, geometry::CameraModel::kMaxParams> params{};
};

struct ViewRecord {
  std::array<double, 4> rotation_xyzw{};  // camera_from_world
  std::array<double, 3> translation{};
  std::uint64_t name_offset = 0;  // into kStrings
  std::uint64_t first_feature = 0;
  std::uint32_t name_bytes = 0;
  std::uint32_t num_features = 0;
  std::uint32_t camera = 0;
  std::uint32_t reserved = 0;
};

static_assert(sizeof(SectionRecord) == 40 && sizeof(Hash128) == 16);
static_assert(sizeof(FileHeader) == 40 + 40 * kNumSections);
static_assert(sizeof(FileHeader) <= kPageBytes);
static_assert(sizeof(MetaRecord) == 216);
static_assert(offsetof(MetaRecord, origin_latitude_deg) == kMetaBytesVersion1);
static_assert(offsetof(MetaRecord, ground_sigma_rad) == kMetaBytesVersion2);
static_assert(offsetof(MetaRecord, relief_origin) == kMetaBytesVersion3);
static_assert(offsetof(MetaRecord, relief_is_given) == kMetaBytesVersion4);
static_assert(offsetof(MetaRecord, ground_height_sigma) == kMetaBytesVersion5);
static_assert(sizeof(CameraRecord) == 80);
static_assert(sizeof(ViewRecord) == 88);
static_assert(sizeof(Landmark) == 48);
static_assert(sizeof(Feature) == 16);
static_assert(sizeof(Descriptor) == 128);
static_assert(sizeof(GroundRelief::Knot) == 8);
static_assert(std::is_trivially_copyable_v<FileHeader> &&
              std::is_trivially_copyable_v<MetaRecord> &&
              std::is_trivially_copyable_v<CameraRecord> &&
              std::is_trivially_copyable_v<ViewRecord>);

Hash128 HashBytes(const void* data, std::size_t bytes);
// The same in parts of some MiB; nullopt once `go_on`, which is asked after
// each, says no.
std::optional<Hash128> HashBytes(const void* data,
                                 std::size_t bytes,
                                 const std::function<bool()>& go_on);
// The header's content_hash, whatever the field holds now.
Hash128 HashHeader(const FileHeader& header);
// 32 lower-case hex digits, the canonical (big-endian) form of XXH3-128.
std::string HexOf(const Hash128& hash);

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_FILE_LAYOUT_H_
