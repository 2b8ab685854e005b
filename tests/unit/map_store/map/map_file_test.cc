// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstring>

#include "map_store/base/file.h"
#include "map_store/map/internal/file_layout.h"
#include "map_store/map/map.h"
#include "tests/unit/map_store/map/synthetic_map.h"
#include "tests/unit/map_store/map/yard_map.h"

namespace groundlock::map {
namespace {

namespace fs = std::filesystem;
using internal::FileHeader;
using internal::SectionId;
using testing::HasSubstr;

class MapFileTest : public testing::Test {
 protected:
  void SetUp() override {
    auto made = base::TemporaryDirectory::Create(fs::temp_directory_path());
    ASSERT_TRUE(made.ok()) << made.status();
    directory_.emplace(*std::move(made));
    path_ = directory_->path() / "m.glmap";
    const absl::Status written = WriteMapFile(data_, path_);
    ASSERT_TRUE(written.ok()) << written;
    bytes_ = *base::ReadFile(path_, 1U << 28U);
  }

  FileHeader Header() const {
    FileHeader header;
    std::memcpy(&header, bytes_.data(), sizeof(header));
    return header;
  }
  // Puts a header into bytes_, with a checksum that fits.
  void SetHeader(FileHeader header) {
    header.content_hash = internal::HashHeader(header);
    std::memcpy(bytes_.data(), &header, sizeof(header));
  }
  // Overwrites an element of a section and makes the checksums fit.
  template <typename T>
  void SetElement(SectionId id, std::size_t index, const T& value) {
    FileHeader header = Header();
    auto& section = header.sections.at(static_cast<std::uint32_t>(id) - 1);
    ASSERT_LT(index, section.count);
    std::memcpy(
        bytes_.data() + section.offset + index * sizeof(T), &value, sizeof(T));
    section.checksum = internal::HashBytes(
        bytes_.data() + section.offset, section.count * section.element_bytes);
    SetHeader(header);
  }
  template <typename T>
  T Element(SectionId id, std::size_t index) const {
    T value;
    std::memcpy(
        &value,
        bytes_.data() +
            Header().sections.at(static_cast<std::uint32_t>(id) - 1).offset +
            index * sizeof(T),
        sizeof(T));
    return value;
  }
  absl::StatusOr<std::shared_ptr<const Map>> OpenBytes() {
    const fs::path path = directory_->path() / "changed.glmap";
    EXPECT_TRUE(base::WriteFileAtomically(path, bytes_).ok());
    return Map::Open(path);
  }

  MapData data_ = testing_map::MakeMapData();
  std::optional<base::TemporaryDirectory> directory_;
  fs::path path_;
  std::string bytes_;
};

TEST_F(MapFileTest, HoldsWhatWasWritten) {
  const auto opened = Map::Open(path_);
  ASSERT_TRUE(opened.ok()) << opened.status();
  const Map& map = **opened;
  EXPECT_TRUE(map.Verify().ok()) << map.Verify();
  EXPECT_EQ(map.info().source_format, "synthetic");
  EXPECT_TRUE(map.info().metric);
  EXPECT_TRUE(map.info().has_descriptors);
  EXPECT_EQ(map.info().file_bytes, fs::file_size(path_));
  EXPECT_EQ(map.info().content_hash.size(), 32U);
  EXPECT_NEAR(map.info().mean_reprojection_error_px,
              ComputeReprojection(data_).mean_error_px,
              1e-12);
  ASSERT_EQ(map.num_views(), data_.views.size());
  // One landmark of the data is not observed.
  ASSERT_EQ(map.landmarks().size(), data_.landmarks.size() - 1);
  std::size_t feature = 0;
  for (std::size_t v = 0; v < map.num_views(); ++v) {
    const MapViewData& expected = data_.views[v];
    const MapView& view = map.view(v);
    EXPECT_EQ(view.name, expected.name);
    EXPECT_EQ(map.camera(view.camera), data_.cameras[expected.camera]);
    EXPECT_LT(
        (view.center_world - expected.camera_from_world.Inverse().translation)
            .norm(),
        1e-12);
    ASSERT_EQ(map.FeaturesOf(view).size(), expected.keypoints_px.size());
    for (std::size_t i = 0; i < expected.keypoints_px.size(); ++i, ++feature) {
      EXPECT_EQ(map.FeaturesOf(view)[i].x_px, expected.keypoints_px[i].x());
      EXPECT_EQ(map.FeaturesOf(view)[i].view, v);
      EXPECT_EQ(map.DescriptorsOf(view)[i], expected.descriptors[i]);
      EXPECT_EQ(&map.FeaturesOf(view)[i], &map.features()[feature]);
      const Landmark& landmark =
          map.landmarks()[map.features()[feature].landmark];
      EXPECT_EQ(landmark.Position(),
                data_.landmarks[expected.landmarks[i]].p_world);
      EXPECT_THAT(map.ObservationsOf(landmark), testing::Contains(feature));
    }
  }
}

TEST_F(MapFileTest, DataRoundTripKeepsTheContentHash) {
  const auto first = Map::Open(path_);
  ASSERT_TRUE(first.ok());
  const MapData back = (*first)->ToData();
  const fs::path again = directory_->path() / "again.glmap";
  ASSERT_TRUE(WriteMapFile(back, again).ok());
  EXPECT_EQ((*Map::Open(again))->info().content_hash,
            (*first)->info().content_hash);
  MapData changed = back;
  changed.landmarks[0].p_world.x() += 1e-9;
  ASSERT_TRUE(WriteMapFile(changed, again).ok());
  EXPECT_NE((*Map::Open(again))->info().content_hash,
            (*first)->info().content_hash);
}

TEST_F(MapFileTest, HoldsTheGroundsRelief) {
  EXPECT_TRUE((*Map::Open(path_))->ground_relief().empty());
  const MapData yard = testing_map::Yard(testing_map::Hills);
  ASSERT_TRUE(WriteMapFile(yard, path_).ok());
  bytes_ = *base::ReadFile(path_, 1U << 28U);
  const auto map = Map::Open(path_);
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE((*map)->Verify().ok()) << (*map)->Verify();
  const GroundRelief expected = EstimateGroundRelief(yard);
  const GroundRelief& relief = (*map)->ground_relief();
  ASSERT_EQ(relief.knots.size(), expected.knots.size());
  EXPECT_EQ(relief.columns, expected.columns);
  EXPECT_EQ(relief.At({3.0, 4.0})->height, expected.At({3.0, 4.0})->height);
  const fs::path again = directory_->path() / "again.glmap";
  ASSERT_TRUE(WriteMapFile((*map)->ToData(), again).ok());
  EXPECT_EQ((*Map::Open(again))->info().content_hash,
            (*map)->info().content_hash);

  auto knot = Element<GroundRelief::Knot>(SectionId::kGroundRelief, 7);
  knot.coefficient = std::numeric_limits<float>::infinity();
  SetElement(SectionId::kGroundRelief, 7, knot);
  EXPECT_THAT(std::string(OpenBytes().status().message()),
              HasSubstr("ground relief"));
}

// Version 5 ended its meta record before the sigma of the ground's height,
// version 4 before saying who told the relief.
TEST_F(MapFileTest, ReadsTheVersionsBefore) {
  data_.ground_sigma_rad = 0.01;
  data_.ground_height_sigma = 0.03;
  ASSERT_TRUE(WriteMapFile(data_, path_).ok());
  bytes_ = *base::ReadFile(path_, 1U << 28U);
  EXPECT_EQ((*OpenBytes())->info().ground_height_sigma, 0.03);
  FileHeader header = Header();
  header.format_version = 5;
  internal::SectionRecord& meta = header.sections.at(0);
  meta.element_bytes = internal::kMetaBytesVersion5;
  meta.checksum =
      internal::HashBytes(bytes_.data() + meta.offset, meta.element_bytes);
  SetHeader(header);
  ASSERT_TRUE(OpenBytes().ok()) << OpenBytes().status();
  EXPECT_EQ((*OpenBytes())->info().ground_height_sigma, 0.0);
  EXPECT_EQ((*OpenBytes())->info().ground_sigma_rad, 0.01);

  header.format_version = 4;
  meta.element_bytes = internal::kMetaBytesVersion4;
  meta.checksum =
      internal::HashBytes(bytes_.data() + meta.offset, meta.element_bytes);
  SetHeader(header);
  const auto map = OpenBytes();
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE((*map)->Verify().ok()) << (*map)->Verify();
  EXPECT_FALSE((*map)->info().ground_relief_given);
}

// Version 3 ended its meta record, and its sections, before the relief.
TEST_F(MapFileTest, ReadsAnOlderVersion) {
  FileHeader header = Header();
  header.format_version = 3;
  header.num_sections = internal::NumSections(3);
  header.sections.at(header.num_sections) = {};
  internal::SectionRecord& meta = header.sections.at(0);
  meta.element_bytes = internal::kMetaBytesVersion3;
  meta.checksum =
      internal::HashBytes(bytes_.data() + meta.offset, meta.element_bytes);
  SetHeader(header);
  const auto map = OpenBytes();
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE((*map)->Verify().ok()) << (*map)->Verify();
  EXPECT_TRUE((*map)->ground_relief().empty());
  EXPECT_EQ((*map)->num_views(), data_.views.size());
}

TEST_F(MapFileTest, WorksWithoutDescriptorsAndEmpty) {
  for (MapViewData& view : data_.views) view.descriptors.clear();
  ASSERT_TRUE(WriteMapFile(data_, path_).ok());
  auto map = Map::Open(path_);
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE((*map)->Verify().ok()) << (*map)->Verify();
  EXPECT_FALSE((*map)->info().has_descriptors);
  EXPECT_TRUE((*map)->DescriptorsOf((*map)->view(0)).empty());
  EXPECT_FALSE((*map)->ToData().has_descriptors());

  ASSERT_TRUE(WriteMapFile(MapData{}, path_).ok());
  map = Map::Open(path_);
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE((*map)->Verify().ok()) << (*map)->Verify();
  EXPECT_EQ((*map)->num_views(), 0U);
}

TEST_F(MapFileTest, MappingOutlivesTheFile) {
  const auto map = Map::Open(path_);
  ASSERT_TRUE(map.ok());
  fs::remove(path_);
  EXPECT_TRUE((*map)->Verify().ok());
}

TEST_F(MapFileTest, NamesWhatIsWrongWithTheFile) {
  EXPECT_EQ(Map::Open(directory_->path() / "none").status().code(),
            absl::StatusCode::kNotFound);
  EXPECT_EQ(Map::Open(directory_->path()).status().code(),
            absl::StatusCode::kInvalidArgument);
  const fs::path pipe = directory_->path() / "pipe";
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  EXPECT_EQ(Map::Open(pipe).status().code(),
            absl::StatusCode::kInvalidArgument);
  bytes_.assign(10'000, 'x');
  EXPECT_EQ(OpenBytes().status().code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(std::string(OpenBytes().status().message()),
              HasSubstr("not a Groundlock map"));
  bytes_.clear();
  EXPECT_EQ(OpenBytes().status().code(), absl::StatusCode::kDataLoss);
}

TEST_F(MapFileTest, RefusesEveryTruncation) {
  const std::string whole = bytes_;
  for (std::size_t size = 0; size < whole.size(); size += 2'731) {
    bytes_ = whole.substr(0, size);
    EXPECT_EQ(OpenBytes().status().code(), absl::StatusCode::kDataLoss) << size;
  }
  bytes_ = whole + "x";
  EXPECT_EQ(OpenBytes().status().code(), absl::StatusCode::kDataLoss);
}

TEST_F(MapFileTest, RefusesANewerVersion) {
  FileHeader header = Header();
  header.format_version = internal::kFormatVersion + 1;
  SetHeader(header);
  const absl::Status status = OpenBytes().status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnimplemented);
  EXPECT_THAT(std::string(status.message()), HasSubstr("version"));
}

TEST_F(MapFileTest, OpenRefusesAChangedHeader) {
  for (std::size_t i = 0; i < sizeof(FileHeader); i += 3) {
    std::string& byte = bytes_;
    byte[i] = static_cast<char>(byte[i] ^ 0x10);
    EXPECT_FALSE(OpenBytes().ok()) << i;
    byte[i] = static_cast<char>(byte[i] ^ 0x10);
  }
}

TEST_F(MapFileTest, VerifyFindsAChangedByteInEverySection) {
  for (const internal::SectionRecord& section : Header().sections) {
    if (section.count == 0) continue;
    const std::size_t at =
        section.offset + section.count * section.element_bytes / 2;
    bytes_[at] = static_cast<char>(bytes_[at] ^ 1);
    const auto map = OpenBytes();
    bytes_[at] = static_cast<char>(bytes_[at] ^ 1);
    if (!map.ok()) continue;  // found on opening already
    EXPECT_EQ((*map)->Verify().code(), absl::StatusCode::kDataLoss);
    EXPECT_THAT(std::string((*map)->Verify().message()),
                HasSubstr(internal::SectionName(section.id)));
  }
}

TEST_F(MapFileTest, RefusesSectionsOutsideTheFile) {
  const std::string whole = bytes_;
  for (std::uint32_t i = 0; i < internal::kNumSections; ++i) {
    for (int change = 0; change < 4; ++change) {
      bytes_ = whole;
      FileHeader header = Header();
      internal::SectionRecord& section = header.sections.at(i);
      if (change == 0) section.offset = header.file_bytes + 4096;
      if (change == 1) section.count = ~std::uint64_t{0} / 2;
      if (change == 2) section.offset += 1;
      if (change == 3) section.element_bytes = 0;
      SetHeader(header);
      EXPECT_EQ(OpenBytes().status().code(), absl::StatusCode::kDataLoss)
          << i << ' ' << change;
    }
  }
}

// Checksums fit, indices do not: found on opening where opening uses them, by
// Verify elsewhere.
TEST_F(MapFileTest, FindsIndicesOutOfRange) {
  const std::string whole = bytes_;
  auto view = Element<internal::ViewRecord>(SectionId::kViews, 1);
  view.camera = 77;
  SetElement(SectionId::kViews, 1, view);
  EXPECT_THAT(std::string(OpenBytes().status().message()), HasSubstr("view 1"));

  bytes_ = whole;
  view = Element<internal::ViewRecord>(SectionId::kViews, 1);
  view.name_offset = ~std::uint64_t{0};
  SetElement(SectionId::kViews, 1, view);
  EXPECT_FALSE(OpenBytes().ok());

  bytes_ = whole;
  view = Element<internal::ViewRecord>(SectionId::kViews, 1);
  view.first_feature -= 1;
  SetElement(SectionId::kViews, 1, view);
  EXPECT_FALSE(OpenBytes().ok());

  bytes_ = whole;
  auto feature = Element<Feature>(SectionId::kFeatures, 3);
  feature.landmark = 1'000'000;
  SetElement(SectionId::kFeatures, 3, feature);
  auto map = OpenBytes();
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_EQ((*map)->Verify().code(), absl::StatusCode::kDataLoss);

  bytes_ = whole;
  auto landmark = Element<Landmark>(SectionId::kLandmarks, 2);
  landmark.first_observation = ~std::uint64_t{0} - 1;
  SetElement(SectionId::kLandmarks, 2, landmark);
  map = OpenBytes();
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_EQ((*map)->Verify().code(), absl::StatusCode::kDataLoss);
  EXPECT_TRUE((*map)->ObservationsOf((*map)->landmarks()[2]).empty());
}

TEST_F(MapFileTest, RefusesInvalidData) {
  const auto message = [this](auto change) {
    MapData data = data_;
    change(data);
    const absl::Status status =
        WriteMapFile(data, directory_->path() / "bad.glmap");
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    return std::string(status.message());
  };
  EXPECT_THAT(message([](MapData& d) { d.views[2].camera = 9; }),
              HasSubstr("view 2"));
  EXPECT_THAT(message([](MapData& d) { d.views[1].landmarks[4] = 99'999; }),
              HasSubstr("feature 4"));
  EXPECT_THAT(message([](MapData& d) { d.views[1].descriptors.pop_back(); }),
              HasSubstr("descriptors"));
  EXPECT_THAT(message([](MapData& d) { d.views[1].landmarks.pop_back(); }),
              HasSubstr("landmarks"));
  EXPECT_THAT(message([](MapData& d) { d.landmarks[5].p_world.y() = NAN; }),
              HasSubstr("landmark 5"));
  EXPECT_THAT(message([](MapData& d) { d.views[0].keypoints_px[0].x() = NAN; }),
              HasSubstr("feature 0"));
  EXPECT_THAT(message([](MapData& d) {
                d.views[0].camera_from_world.rotation.coeffs() *= 2.0;
              }),
              HasSubstr("quaternion"));
  EXPECT_THAT(message([](MapData& d) { d.world_from_source.scale = 0.0; }),
              HasSubstr("world_from_source"));
  EXPECT_FALSE(fs::exists(directory_->path() / "bad.glmap"));
}

}  // namespace
}  // namespace groundlock::map
