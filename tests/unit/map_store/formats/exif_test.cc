// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/exif.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <string>
#include <tuple>
#include <vector>

#include "tests/support/photo_xmp.h"
#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

// What a camera writes, in the order of a little endian TIFF's directories.
class ExifJpeg {
 public:
  void Text(std::uint16_t tag, const std::string& text) {
    Add(tag, 2, static_cast<std::uint32_t>(text.size()) + 1, text + '\0');
  }
  void Short(std::uint16_t tag, std::uint16_t value) {
    Add(tag, 3, 1, Bytes(value, 2) + Bytes(0, 2));
  }
  void Rational(std::uint16_t tag, std::uint32_t over, std::uint32_t under) {
    Add(tag, 5, 1, Bytes(over, 4) + Bytes(under, 4));
  }
  // What follows belongs to the part about the exposure.
  void Exposure() { in_exposure_ = true; }

  std::string Write() const {
    std::string tiff = "II*" + std::string(1, '\0') + Bytes(8, 4);
    // Directory, its values, and behind both the other directory.
    const std::size_t first = 2 + 12 * (main_.size() + 1) + 4;
    std::size_t values = 0;
    for (const Entry& entry : main_) values += Beside(entry);
    auto main = main_;
    main.push_back({0x8769, 4, 1, Bytes(8 + first + values, 4)});
    tiff += Directory(main, tiff.size());
    tiff += Directory(exposure_, tiff.size());
    const std::string body = std::string("Exif\0\0", 6) + tiff;
    std::string jpeg = "\xFF\xD8\xFF\xE1";
    jpeg += static_cast<char>((body.size() + 2) >> 8);
    jpeg += static_cast<char>((body.size() + 2) & 0xFF);
    return jpeg + body + "\xFF\xD9";
  }

 private:
  struct Entry {
    std::uint16_t tag;
    std::uint16_t type;
    std::uint32_t count;
    std::string value;
  };
  static std::string Bytes(std::size_t value, int count) {
    std::string bytes;
    for (int i = 0; i < count; ++i) {
      bytes += static_cast<char>((value >> (8 * i)) & 0xFF);
    }
    return bytes;
  }
  // The bytes of a value that has no room in its entry.
  static std::size_t Beside(const Entry& entry) {
    return entry.value.size() <= 4 ? 0 : entry.value.size();
  }
  static std::string Directory(const std::vector<Entry>& entries,
                               std::size_t begin) {
    std::string text = Bytes(entries.size(), 2);
    std::size_t next = begin + 2 + 12 * entries.size() + 4;
    std::string values;
    for (const Entry& entry : entries) {
      text +=
          Bytes(entry.tag, 2) + Bytes(entry.type, 2) + Bytes(entry.count, 4);
      if (Beside(entry) == 0) {
        text += entry.value + std::string(4 - entry.value.size(), '\0');
      } else {
        text += Bytes(next + values.size(), 4);
        values += entry.value;
      }
    }
    return text + Bytes(0, 4) + values;
  }
  void Add(std::uint16_t tag,
           std::uint16_t type,
           std::uint32_t count,
           const std::string& value) {
    (in_exposure_ ? exposure_ : main_).push_back({tag, type, count, value});
  }

  bool in_exposure_ = false;
  std::vector<Entry> main_;
  std::vector<Entry> exposure_;
};

constexpr std::uint16_t kMake = 0x010F;
constexpr std::uint16_t kModel = 0x0110;
constexpr std::uint16_t kFocalLength = 0x920A;
constexpr std::uint16_t kWidth = 0xA002;
constexpr std::uint16_t kHeight = 0xA003;
constexpr std::uint16_t kFocalPlaneX = 0xA20E;
constexpr std::uint16_t kFocalPlaneUnit = 0xA210;
constexpr std::uint16_t kFilmFocalLength = 0xA405;

ExifJpeg Camera() {
  ExifJpeg camera;
  camera.Text(kMake, "Maker");
  camera.Text(kModel, "One ");
  camera.Exposure();
  camera.Rational(kFocalLength, 43, 10);
  return camera;
}

TEST(PhotoLens, FromTheFilmsFocalLength) {
  ExifJpeg camera = Camera();
  camera.Short(kFilmFocalLength, 26);
  const PhotoLens lens = LensFromExif(camera.Write(), 4'000, 3'000);
  EXPECT_EQ(lens.camera, "Maker One 4.3 mm (26 mm)");
  ASSERT_TRUE(lens.focal_px.has_value());
  EXPECT_NEAR(*lens.focal_px, 26.0 * 5'000.0 / 43.2666, 0.1);
  // The same photo made smaller, as mail programs do.
  EXPECT_NEAR(*LensFromExif(camera.Write(), 400, 300).focal_px,
              *lens.focal_px / 10.0,
              1e-6);
}

TEST(PhotoLens, FromThePitchOfThePixels) {
  // 10,000 pixels an inch on 4,000: a sensor of 10.16 mm.
  ExifJpeg camera = Camera();
  camera.Short(kWidth, 4'000);
  camera.Short(kHeight, 3'000);
  camera.Rational(kFocalPlaneX, 10'000, 1);
  camera.Short(kFocalPlaneUnit, 2);
  const double expected_px = 4.3 * 10'000.0 / 25.4;
  const auto focal_px = [](const ExifJpeg& jpeg, int width, int height) {
    return LensFromExif(jpeg.Write(), width, height).focal_px;
  };
  EXPECT_NEAR(focal_px(camera, 4'000, 3'000).value(), expected_px, 1e-6);
  EXPECT_NEAR(focal_px(camera, 2'000, 1'500).value(), expected_px / 2.0, 1e-6);
  // Of a part of the picture, nobody knows which.
  EXPECT_FALSE(focal_px(camera, 2'000, 2'000).has_value());
  // The finer one of two that agree, else what users read on their camera.
  ExifJpeg agreeing = camera;
  agreeing.Short(kFilmFocalLength, 15);
  EXPECT_NEAR(focal_px(agreeing, 4'000, 3'000).value(), expected_px, 1e-6);
  ExifJpeg other = camera;
  other.Short(kFilmFocalLength, 50);
  EXPECT_NEAR(
      focal_px(other, 4'000, 3'000).value(), 50.0 * 5'000.0 / 43.2666, 0.1);
}

TEST(PhotoLens, NothingWrittenOrNonsense) {
  EXPECT_EQ(LensFromExif("\xFF\xD8\xFF\xE1 no", 100, 100).camera, "");
  EXPECT_FALSE(LensFromExif("", 100, 100).focal_px.has_value());
  EXPECT_FALSE(LensFromExif(Camera().Write(), 100, 100).focal_px.has_value());
  ExifJpeg camera = Camera();
  camera.Short(kFilmFocalLength, 60'000);
  EXPECT_FALSE(LensFromExif(camera.Write(), 100, 100).focal_px.has_value());
  const std::string whole = camera.Write();
  for (std::size_t size = 0; size < whole.size(); ++size) {
    LensFromExif(whole.substr(0, size), 100, 100);
  }
}

TEST(PhotoLens, OfAPhone) {
  const auto folder = DataFolder() / "importers/opensfm_berlin/images";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << folder;
  const auto head = ReadExifHead(folder / "01.jpg");
  ASSERT_TRUE(head.ok()) << head.status();
  const PhotoLens lens = LensFromExif(*head, 3'264, 2'448);
  // OpenSfM, whose example this is, takes 35 mm of film for the width alone:
  // 35 / 36 of the larger side, 4 % less.
  ASSERT_TRUE(lens.focal_px.has_value());
  EXPECT_NEAR(*lens.focal_px / 3'264.0, 35.0 / 36.0, 0.05);
}

using test_support::DjiPacket;
using test_support::EmptyJpeg;
using test_support::WithSegment;
using test_support::XmpPacketWith;
using test_support::XmpSegment;

// Two digits behind the point are written: 1e-4 rad.
constexpr double kWritten = 2e-4;

std::string JpegWith(const std::string& packet) {
  return WithSegment(EmptyJpeg(), XmpSegment(packet));
}

TEST(PhotoAttitude, OfDji) {
  // Level, straight down, half down, rolled to the right: the horizon then
  // falls to the left, and up leans there.
  for (const auto& [pitch_deg, roll_deg, up] :
       {std::tuple(0.0, 0.0, Eigen::Vector3d(0.0, -1.0, 0.0)),
        std::tuple(-90.0, 0.0, Eigen::Vector3d(0.0, 0.0, -1.0)),
        std::tuple(-90.0, 180.0, Eigen::Vector3d(0.0, 0.0, -1.0)),
        std::tuple(-45.0, 0.0, Eigen::Vector3d(0.0, -M_SQRT1_2, -M_SQRT1_2)),
        std::tuple(0.0, 30.0, Eigen::Vector3d(-0.5, -std::sqrt(0.75), 0.0))}) {
    const auto found = UpFromAttitude(JpegWith(DjiPacket(pitch_deg, roll_deg)));
    ASSERT_TRUE(found.has_value()) << pitch_deg;
    EXPECT_LT((*found - up).norm(), kWritten) << pitch_deg << " " << roll_deg;
  }
  const Eigen::Vector3d up = Eigen::Vector3d(0.1, -0.8, -0.4).normalized();
  EXPECT_LT((UpFromAttitude(JpegWith(DjiPacket(up))).value() - up).norm(),
            kWritten);
}

TEST(PhotoAttitude, AsElementsAndFractions) {
  const std::string packet =
      "<rdf:Description xmlns:drone-parrot=\"http://www.parrot.com\">"
      "<drone-parrot:CameraRollDegree>0</drone-parrot:CameraRollDegree>"
      "<drone-parrot:CameraPitchDegree> -181/2\n"
      "</drone-parrot:CameraPitchDegree></rdf:Description>";
  const auto up = UpFromAttitude(JpegWith(packet));
  ASSERT_TRUE(up.has_value());
  EXPECT_NEAR(up->y(), std::sin(0.5 * M_PI / 180.0), 1e-9);
}

TEST(PhotoAttitude, OfPix4dByWhoWritesIt) {
  const std::string angles =
      "xmlns:Camera='http://pix4d.com/camera/1.0/' Camera:Yaw=\"12\" "
      "Camera:Pitch=\"60.0\" Camera:Roll = '10.0'";
  const auto photo = [](const char* maker, const std::string& attributes) {
    ExifJpeg camera;
    camera.Text(kMake, maker);
    return WithSegment(camera.Write(), XmpSegment(XmpPacketWith(attributes)));
  };
  // 60 degrees up from straight down.
  const auto parrot = UpFromAttitude(photo("Parrot", angles));
  ASSERT_TRUE(parrot.has_value());
  EXPECT_NEAR(parrot->y(), -std::sqrt(0.75), 1e-9);
  EXPECT_LT(parrot->x(), 0.0);
  EXPECT_LT(parrot->z(), 0.0);
  const auto sensefly = UpFromAttitude(photo("senseFly", angles));
  ASSERT_TRUE(sensefly.has_value());
  EXPECT_NEAR(sensefly->x(), -parrot->x(), 1e-12);
  // Others may mean something else by these names.
  EXPECT_FALSE(UpFromAttitude(photo("Maker", angles)).has_value());
  EXPECT_FALSE(UpFromAttitude(photo("Parrot",
                                    "xmlns:Camera='http://other' "
                                    "Camera:Pitch=\"60\" Camera:Roll=\"0\""))
                   .has_value());
}

TEST(PhotoAttitude, NothingWrittenOrNonsense) {
  EXPECT_FALSE(UpFromAttitude("").has_value());
  EXPECT_FALSE(UpFromAttitude(EmptyJpeg()).has_value());
  EXPECT_FALSE(UpFromAttitude(Camera().Write()).has_value());
  for (const char* attributes :
       {"drone-dji:GimbalPitchDegree=\"-90\"",
        "drone-dji:GimbalPitchDegree=\"nan\" drone-dji:GimbalRollDegree=\"0\"",
        "drone-dji:GimbalPitchDegree=\"900\" drone-dji:GimbalRollDegree=\"0\"",
        "drone-dji:GimbalPitchDegree=\"-9x\" drone-dji:GimbalRollDegree=\"0\"",
        "drone-dji:GimbalPitchDegree=\"1/0\" drone-dji:GimbalRollDegree=\"0\"",
        "a-drone-dji:GimbalPitchDegree=\"1\" drone-dji:GimbalRollDegree=\"0\"",
        "drone-dji:GimbalPitchDegree= drone-dji:GimbalRollDegree=\"0\""}) {
    EXPECT_FALSE(
        UpFromAttitude(JpegWith(XmpPacketWith(attributes))).has_value())
        << attributes;
  }
  // Wherever a file ends; and a packet behind the picture is none of it.
  const std::string whole = JpegWith(DjiPacket(-90.0, 0.0));
  for (std::size_t size = 0; size + 2 < whole.size(); ++size) {
    EXPECT_FALSE(UpFromAttitude(whole.substr(0, size)).has_value()) << size;
  }
  EXPECT_FALSE(UpFromAttitude(EmptyJpeg() + XmpSegment(DjiPacket(0.0, 0.0)))
                   .has_value());
}

TEST(PhotoPositions, OfADroneFlight) {
  const auto folder = DataFolder() / "caliterra/images";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << folder;
  const auto photos = ReadPhotoPositions(folder);
  ASSERT_TRUE(photos.ok()) << photos.status();
  ASSERT_EQ(photos->size(), 40U);
  // One flight over one field: all within some hundred metres.
  for (const PhotoPosition& photo : *photos) {
    const Eigen::Vector3d p =
        geometry::WorldFromGeodetic((*photos)[0].position, photo.position);
    EXPECT_LT(p.norm(), 1'000.0) << photo.image;
  }
}

TEST(PhotoPositions, FromText) {
  const auto photos = ParsePhotoPositions(
      "# image,latitude,longitude,height\na, b.jpg,52.5,-13.25,80\n", "g.csv");
  ASSERT_TRUE(photos.ok()) << photos.status();
  ASSERT_EQ(photos->size(), 1U);
  EXPECT_EQ((*photos)[0].image, "a, b.jpg");
  EXPECT_EQ((*photos)[0].position,
            (geometry::GeodeticPosition{52.5, -13.25, 80.0}));
  const auto wrong = ParsePhotoPositions("\na.jpg,95,0,0\n", "g.csv");
  EXPECT_EQ(wrong.status().message(),
            "g.csv:2: latitude_deg: 95 is out of range");
  EXPECT_FALSE(GpsFromExif("\xFF\xD8\xFF\xE1 no").has_value());
}

}  // namespace
}  // namespace groundlock::formats
