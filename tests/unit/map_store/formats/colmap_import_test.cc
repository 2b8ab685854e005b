// SPDX-License-Identifier: Apache-2.0
// COLMAP's model and database: what is wrong in a file must be said, and where.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>

#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>

#include "map_store/formats/formats.h"
#include "map_store/formats/internal/colmap_model.h"
#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;
using internal::ColmapModel;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;

std::string Message(const absl::Status& status) {
  return std::string(status.message());
}

// Little-endian bytes of numbers in a row.
template <typename... T>
std::string Bytes(T... values) {
  std::string out;
  const auto put = [&out](auto value) {
    char bytes[sizeof(value)];
    std::memcpy(bytes, &value, sizeof(value));
    out.append(bytes, sizeof(value));
  };
  (put(values), ...);
  return out;
}

using U8 = std::uint8_t;
using U32 = std::uint32_t;
using U64 = std::uint64_t;

std::string OneCamera(std::int32_t model) {
  return Bytes(U64{1}, U32{3}, model, U64{640}, U64{480}, 500., 320., 240.);
}

std::string ImageHead(double qw) {
  return Bytes(U64{1}, U32{9}, qw, 0., 0., 0., 1., 2., 3., U32{3}) + "a.jpg" +
         std::string(1, '\0');
}

TEST(ColmapBinary, ReadsTheSmallestModel) {
  ColmapModel model;
  ASSERT_TRUE(ParseColmapCamerasBinary(OneCamera(0), "c", &model).ok());
  const std::string image =
      ImageHead(2.0) + Bytes(U64{2}, 1., 2., ~U64{0}, 3., 4., U64{77});
  ASSERT_TRUE(ParseColmapImagesBinary(image, "i", &model).ok());
  const std::string point = Bytes(U64{1},
                                  U64{77},
                                  .1,
                                  .2,
                                  5.,
                                  U8{1},
                                  U8{2},
                                  U8{3},
                                  -1.,
                                  U64{1},
                                  U32{9},
                                  U32{1});
  ASSERT_TRUE(ParseColmapPointsBinary(point, "p", &model).ok());
  std::vector<std::string> warnings;
  const auto linked = LinkColmapModel(model, &warnings);
  ASSERT_TRUE(linked.ok()) << linked.status();
  EXPECT_TRUE(warnings.empty());
  const map::MapViewData& view = linked->data.views[0];
  ASSERT_EQ(view.keypoints_px.size(), 1U);
  EXPECT_EQ(view.keypoints_px[0], Eigen::Vector2f(3, 4));
  EXPECT_EQ(linked->origins[0].index[0], 1U);
  EXPECT_EQ(linked->origins[0].num_features, 2U);
  EXPECT_DOUBLE_EQ(view.camera_from_world.rotation.w(), 1.0);  // normalised
  EXPECT_EQ(linked->data.landmarks[0].error_px, 0.0F);  // -1 = not computed
  EXPECT_EQ(linked->data.landmarks[0].rgb[2], 3);
}

TEST(ColmapBinary, NamesTheCameraWhoseModelIsUnknown) {
  for (const int id : {-1, 6, 10, 1'000}) {
    ColmapModel model;
    const absl::Status status =
        ParseColmapCamerasBinary(OneCamera(id), "cameras.bin", &model);
    EXPECT_EQ(status.code(), absl::StatusCode::kUnimplemented);
    EXPECT_THAT(Message(status),
                AllOf(HasSubstr("cameras.bin"),
                      HasSubstr("camera 3"),
                      HasSubstr(absl::StrCat("model ", id))));
  }
  ColmapModel model;
  EXPECT_THAT(
      Message(ParseColmapCamerasBinary(OneCamera(10), "cameras.bin", &model)),
      HasSubstr("THIN_PRISM_FISHEYE"));
}

TEST(ColmapBinary, SaysThatATextFileIsText) {
  const std::string text = "# Camera list with one line of data per camera:\n";
  ColmapModel model;
  for (const auto parse : {internal::ParseColmapCamerasBinary,
                           internal::ParseColmapImagesBinary,
                           internal::ParseColmapPointsBinary}) {
    const absl::Status status = parse(text, "x.bin", &model);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(Message(status), HasSubstr("x.bin: this is text"));
  }
}

TEST(ColmapBinary, ChecksCountsBeforeAllocating) {
  ColmapModel model;
  const U64 huge = U64{1} << 61;
  EXPECT_THAT(Message(ParseColmapCamerasBinary(Bytes(huge), "c", &model)),
              HasSubstr("announced, but only 0 bytes follow"));
  EXPECT_THAT(Message(ParseColmapImagesBinary(Bytes(huge), "i", &model)),
              HasSubstr("announced"));
  EXPECT_THAT(Message(ParseColmapPointsBinary(Bytes(huge), "p", &model)),
              HasSubstr("announced"));
  EXPECT_THAT(Message(ParseColmapImagesBinary(
                  ImageHead(1.0) + Bytes(huge), "i", &model)),
              AllOf(HasSubstr("a.jpg"), HasSubstr("announced")));
  const std::string point =
      Bytes(U64{1}, U64{7}, 1., 1., 1., U8{0}, U8{0}, U8{0}, 0., huge);
  EXPECT_THAT(Message(ParseColmapPointsBinary(point, "p", &model)),
              AllOf(HasSubstr("point 7"), HasSubstr("announced")));
}

TEST(ColmapBinary, EveryTruncationIsAnError) {
  const std::string image = ImageHead(1.0) + Bytes(U64{1}, 1., 2., ~U64{0});
  for (std::size_t size = 0; size < image.size(); ++size) {
    ColmapModel model;
    EXPECT_FALSE(
        ParseColmapImagesBinary(image.substr(0, size), "i", &model).ok())
        << size;
  }
  ColmapModel model;
  EXPECT_THAT(Message(ParseColmapImagesBinary(image + "x", "i", &model)),
              HasSubstr("left after the last item"));
}

TEST(ColmapBinary, RefusesNumbersThatAreNone) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  ColmapModel model;
  EXPECT_THAT(Message(ParseColmapImagesBinary(
                  ImageHead(0.0) + Bytes(U64{0}), "i", &model)),
              AllOf(HasSubstr("a.jpg"), HasSubstr("no quaternion")));
  EXPECT_THAT(Message(ParseColmapImagesBinary(
                  ImageHead(nan) + Bytes(U64{0}), "i", &model)),
              HasSubstr("not finite"));
  EXPECT_THAT(
      Message(ParseColmapImagesBinary(
          ImageHead(1.0) + Bytes(U64{1}, nan, 1., U64{1}), "i", &model)),
      HasSubstr("2D point 0 is not finite"));
  EXPECT_THAT(
      Message(ParseColmapPointsBinary(
          Bytes(U64{1}, U64{7}, nan, 1., 1., U8{0}, U8{0}, U8{0}, 0., U64{0}),
          "p",
          &model)),
      HasSubstr("point 7: position is not finite"));
  EXPECT_THAT(
      Message(ParseColmapCamerasBinary(
          Bytes(U64{1}, U32{3}, 0, U64{640}, U64{1} << 40, 500., 320., 240.),
          "c",
          &model)),
      HasSubstr("camera 3: size"));
  EXPECT_THAT(Message(ParseColmapCamerasBinary(
                  Bytes(U64{1}, U32{3}, 0, U64{640}, U64{480}, nan, 320., 240.),
                  "c",
                  &model)),
              HasSubstr("camera 3"));
}

constexpr char kCameras[] =
    "# comment\n1 SIMPLE_RADIAL 640 480 500 320 240 0\n";
constexpr char kImages[] =
    "# comment\n"
    "1 1 0 0 0 0 0 0 1 a b.jpg\r\n"
    "10.5 20.5 5 30 40 -1 50 60 6\r\n"
    "\n"
    "2 1 0 0 0 1 0 0 1 empty.jpg\n"
    "\n"
    "3 1 0 0 0 2 0 0 1 c.jpg\n"
    "1 2 5";
constexpr char kPoints[] =
    "5 1 2 3 10 20 30 0.5 1 0 3 0\n"
    "6 1e-1 +2 3 10 20 30 -1 1 2\n";

TEST(ColmapText, ReadsEmptyLinesNamesWithBlanksAndCarriageReturns) {
  ColmapModel model;
  ASSERT_TRUE(ParseColmapCamerasText(kCameras, "c", &model).ok());
  ASSERT_TRUE(ParseColmapImagesText(kImages, "i", &model).ok());
  ASSERT_TRUE(ParseColmapPointsText(kPoints, "p", &model).ok());
  std::vector<std::string> warnings;
  const auto linked = LinkColmapModel(model, &warnings);
  ASSERT_TRUE(linked.ok()) << linked.status();
  EXPECT_TRUE(warnings.empty());
  ASSERT_EQ(linked->data.views.size(), 3U);
  EXPECT_EQ(linked->data.views[0].name, "a b.jpg");
  EXPECT_EQ(linked->origins[0].index, (std::vector<U32>{0, 2}));
  EXPECT_TRUE(linked->data.views[1].landmarks.empty());
  EXPECT_EQ(linked->data.views[2].landmarks, std::vector<U32>{0});
  EXPECT_DOUBLE_EQ(linked->data.landmarks[1].p_world.x(), 0.1);
}

TEST(ColmapText, ErrorsGiveTheLine) {
  struct Case {
    decltype(&internal::ParseColmapCamerasText) parse;
    const char* text;
    const char* message;
  };
  const Case cases[] = {
      {internal::ParseColmapCamerasText,
       "#\n1 FOV 6 4 1 2 3\n",
       "f:2: camera 1"},
      {internal::ParseColmapCamerasText,
       "1 PINHOLE 6 x 1 2 3 4",
       "f:1: camera 1"},
      {internal::ParseColmapCamerasText,
       "1 PINHOLE 6 4 1 2 3",
       "f:1: camera 1"},
      {internal::ParseColmapCamerasText, "1 PINHOLE 6 4 1 2 3 inf", "f:1"},
      {internal::ParseColmapCamerasText, "1 PINHOLE -6 4 1 2 3 4", "f:1"},
      {internal::ParseColmapImagesText,
       "1 0 0 0 0 1 1 1 1 a\n\n",
       "no quaternion"},
      {internal::ParseColmapImagesText,
       "1 1 0 0 0 1 1 1 1 \n\n",
       "name is empty"},
      {internal::ParseColmapImagesText,
       "1 1 0 0 nan 1 1 1 1 a\n",
       "bad quaternion"},
      {internal::ParseColmapImagesText,
       "\n1 1 0 0 0 1 1 1 1 a\n1 2",
       "f:3: image a"},
      {internal::ParseColmapImagesText,
       "1 1 0 0 0 1 1 1 1 a\n1 2 -5",
       "2D point 0"},
      {internal::ParseColmapPointsText, "5 1 2 3 256 0 0 1", "bad colour"},
      {internal::ParseColmapPointsText, "5 1 2 3 25 0 0 1 7", "observation 0"},
      {internal::ParseColmapPointsText,
       "99999999999999999999 1",
       "no point id"},
  };
  for (const Case& c : cases) {
    ColmapModel model;
    const absl::Status status = c.parse(c.text, "f", &model);
    EXPECT_FALSE(status.ok()) << c.text;
    EXPECT_THAT(Message(status), HasSubstr(c.message)) << c.text;
  }
}

TEST(ColmapLink, RefusesDuplicateAndDanglingIds) {
  const auto link = [](const std::string& cameras,
                       const std::string& images,
                       const std::string& points) {
    ColmapModel model;
    EXPECT_TRUE(ParseColmapCamerasText(cameras, "c", &model).ok());
    EXPECT_TRUE(ParseColmapImagesText(images, "i", &model).ok());
    EXPECT_TRUE(ParseColmapPointsText(points, "p", &model).ok());
    std::vector<std::string> warnings;
    return Message(LinkColmapModel(model, &warnings).status());
  };
  const std::string twice = std::string(kCameras) + kCameras;
  EXPECT_THAT(link(twice, kImages, kPoints),
              HasSubstr("camera 1 is there more"));
  EXPECT_THAT(link("", kImages, kPoints), HasSubstr("a b.jpg: camera 1"));
  EXPECT_THAT(link(kCameras, kImages, ""), HasSubstr("observes point 5"));
  EXPECT_THAT(link(kCameras, kImages, std::string(kPoints) + kPoints),
              HasSubstr("point 5 is there more"));
  EXPECT_THAT(link(kCameras, kImages, "5 1 2 3 0 0 0 1 1 3\n"),
              HasSubstr("2D point 3 of image 1"));
  EXPECT_THAT(link(kCameras, kImages, "5 1 2 3 0 0 0 1 4 0\n"),
              HasSubstr("image 4"));
}

TEST(ColmapLink, WarnsIfTracksAndImagesDisagree) {
  ColmapModel model;
  ASSERT_TRUE(ParseColmapCamerasText(kCameras, "c", &model).ok());
  ASSERT_TRUE(ParseColmapImagesText(kImages, "i", &model).ok());
  ASSERT_TRUE(ParseColmapPointsText(
                  "5 1 2 3 0 0 0 1 1 0\n6 1 2 3 0 0 0 1 1 2\n", "p", &model)
                  .ok());
  std::vector<std::string> warnings;
  ASSERT_TRUE(LinkColmapModel(model, &warnings).ok());
  EXPECT_THAT(warnings, Contains(HasSubstr("contradicts itself")));
}

// An exported model and its database, to be damaged.
class ColmapDatabase : public ::testing::Test {
 protected:
  void SetUp() override {
    model_ = directory_.path() / "model";
    database_ = model_ / "database.db";
    data_ = SyntheticMap(AllCameraModels());
    ASSERT_TRUE(Export(data_, ExportFormat::kColmapBinary, model_).ok());
  }
  void Sql(const std::string& sql) {
    sqlite3* db = nullptr;
    ASSERT_EQ(sqlite3_open(database_.c_str(), &db), SQLITE_OK);
    ASSERT_EQ(sqlite3_exec(db, sql.c_str(), nullptr, nullptr, nullptr),
              SQLITE_OK)
        << sqlite3_errmsg(db);
    sqlite3_close(db);
  }
  absl::StatusOr<map::MapData> ImportModel() {
    warnings_.clear();
    return Import(model_, {}, &warnings_);
  }

  base::TemporaryDirectory directory_ = MakeTestDirectory();
  fs::path model_;
  fs::path database_;
  map::MapData data_;
  std::vector<std::string> warnings_;
};

TEST_F(ColmapDatabase, FindsImagesByNameNotById) {
  Sql("UPDATE keypoints SET image_id = image_id + 100;"
      "UPDATE descriptors SET image_id = image_id + 100;"
      "UPDATE images SET image_id = image_id + 100;");
  const auto back = ImportModel();
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_TRUE(warnings_.empty());
  EXPECT_EQ(back->views[2].descriptors, data_.views[2].descriptors);
}

TEST_F(ColmapDatabase, AcceptsFourAndSixColumnsOfKeypoints) {
  for (const int columns : {4, 6}) {
    Sql(absl::StrCat("UPDATE keypoints SET cols = ",
                     columns,
                     ", data = zeroblob(rows * 4 * ",
                     columns,
                     ")"));
    const auto back = ImportModel();
    ASSERT_TRUE(back.ok()) << back.status();
    EXPECT_EQ(back->views[1].descriptors, data_.views[1].descriptors);
  }
}

TEST_F(ColmapDatabase, LeavesOutTheFeaturesOfAnImageThatDoesNotMatch) {
  Sql("UPDATE keypoints SET rows = 1, data = zeroblob(8) WHERE image_id = 2");
  const auto back = ImportModel();
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_THAT(warnings_,
              Contains(AllOf(HasSubstr("left out"), HasSubstr("view 1.jpg"))));
  EXPECT_TRUE(back->views[1].landmarks.empty());
  EXPECT_EQ(back->views[2].descriptors, data_.views[2].descriptors);
  EXPECT_TRUE(back->Validate().ok());
}

TEST_F(ColmapDatabase, OfAnotherModelIsAnErrorIfAskedFor) {
  Sql("UPDATE images SET name = 'x' || name");
  const auto without = ImportModel();
  ASSERT_TRUE(without.ok()) << without.status();
  EXPECT_FALSE(without->has_descriptors());
  EXPECT_THAT(warnings_, Contains(HasSubstr("no descriptors")));
  ImportOptions options;
  options.database = database_;
  const auto with = Import(model_, options, &warnings_);
  EXPECT_EQ(with.status().code(), absl::StatusCode::kFailedPrecondition);
}

TEST_F(ColmapDatabase, DamageIsNamed) {
  Sql("UPDATE descriptors SET rows = 1000000 WHERE image_id = 3");
  EXPECT_THAT(Message(ImportModel().status()),
              AllOf(HasSubstr("view 2.jpg"), HasSubstr("descriptors")));
  Sql("UPDATE descriptors SET rows = -1 WHERE image_id = 3");
  EXPECT_FALSE(ImportModel().ok());
  Sql("DROP TABLE descriptors");
  EXPECT_THAT(Message(ImportModel().status()),
              HasSubstr("no table descriptors"));
  std::ofstream(database_, std::ios::trunc) << "this is no database at all";
  EXPECT_EQ(ImportModel().status().code(), absl::StatusCode::kInvalidArgument);
}

TEST_F(ColmapDatabase, IsNotAskedThroughAView) {
  Sql("ALTER TABLE keypoints RENAME TO k2;"
      "CREATE VIEW keypoints AS WITH RECURSIVE r(i) AS (SELECT 1 UNION ALL "
      "SELECT i + 1 FROM r) SELECT i AS image_id, 1 AS rows, 2 AS cols, x'00' "
      "AS data FROM r");
  EXPECT_THAT(Message(ImportModel().status()), HasSubstr("no table keypoints"));
}

TEST_F(ColmapDatabase, IsNotAskedForColumnsThatAreComputed) {
  Sql("CREATE TABLE k2 (image_id INTEGER, rows INTEGER, cols INTEGER, data "
      "BLOB "
      "AS (replace(hex(zeroblob(1000)), '0', 'aaaa')));"
      "INSERT INTO k2 SELECT image_id, rows, cols FROM keypoints;"
      "DROP TABLE keypoints; ALTER TABLE k2 RENAME TO keypoints");
  EXPECT_THAT(Message(ImportModel().status()), HasSubstr("no table keypoints"));
}

// Of a table's b-tree (sqlite.org/fileformat2.html, section 1.6): one whose
// children are all the same page.
std::string PageOfOneChild(std::size_t page_bytes, std::uint32_t child) {
  constexpr std::size_t kChildren = 200;
  const auto big_endian = [](std::uint32_t value, int bytes) {
    std::string out;
    for (int shift = 8 * (bytes - 1); shift >= 0; shift -= 8) {
      out.push_back(static_cast<char>(value >> shift));
    }
    return out;
  };
  const std::string cell = big_endian(child, 4) + '\1';
  const std::size_t content = page_bytes - kChildren * cell.size();
  std::string page = '\5' + big_endian(0, 2) + big_endian(kChildren, 2) +
                     big_endian(static_cast<std::uint32_t>(content), 2) + '\0' +
                     big_endian(child, 4);
  for (std::size_t i = 0; i < kChildren; ++i) {
    page +=
        big_endian(static_cast<std::uint32_t>(content + i * cell.size()), 2);
  }
  page.resize(content, '\0');
  for (std::size_t i = 0; i < kChildren; ++i) page += cell;
  return page;
}

// 200 to the eighth leaves in a file of some kilobytes.
TEST_F(ColmapDatabase, ATreeWhoseBranchesGrowTogetherIsNotWalked) {
  Sql("CREATE TABLE i2 (image_id INTEGER, name TEXT);"
      "INSERT INTO i2 SELECT image_id, 'x' || name FROM images;"
      "DROP TABLE images; ALTER TABLE i2 RENAME TO images; VACUUM");
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open(database_.c_str(), &db), SQLITE_OK);
  sqlite3_stmt* query = nullptr;
  ASSERT_EQ(sqlite3_prepare_v2(db,
                               "SELECT rootpage, page_size FROM sqlite_master, "
                               "pragma_page_size WHERE name = 'images'",
                               -1,
                               &query,
                               nullptr),
            SQLITE_OK);
  ASSERT_EQ(sqlite3_step(query), SQLITE_ROW);
  const auto root = static_cast<std::size_t>(sqlite3_column_int64(query, 0));
  const auto page = static_cast<std::size_t>(sqlite3_column_int64(query, 1));
  sqlite3_finalize(query);
  sqlite3_close(db);
  std::ifstream in(database_, std::ios::binary);
  std::string file((std::istreambuf_iterator<char>(in)), {});
  in.close();
  const std::string leaf = file.substr((root - 1) * page, page);
  auto next = static_cast<std::uint32_t>(file.size() / page + 1);
  file.replace((root - 1) * page, page, PageOfOneChild(page, next));
  for (int level = 0; level < 7; ++level) {
    file += PageOfOneChild(page, ++next);
  }
  file += leaf;
  // The header's count of pages, big-endian.
  for (std::size_t i = 0; i < 4; ++i) {
    file[28 + i] = static_cast<char>(next >> (24 - 8 * i));
  }
  std::ofstream(database_, std::ios::binary | std::ios::trunc) << file;
  const auto imported = ImportModel();
  EXPECT_EQ(imported.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(Message(imported.status()), HasSubstr("takes more work"));
}

}  // namespace
}  // namespace groundlock::formats
