// SPDX-License-Identifier: Apache-2.0
#include "client/cli/parse.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "client/cli/map_lens.h"
#include "map_store/base/file.h"

namespace groundlock::cli {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

std::string Message(const absl::Status& status) {
  return std::string(status.message());
}

TEST(ParseBox, ReadsCornerAndSize) {
  const auto box = ParseBox("373.5,-3,170,84.25");
  ASSERT_TRUE(box.ok()) << box.status();
  EXPECT_EQ(box->x(), 373.5);
  EXPECT_EQ(box->y(), -3.0);
  EXPECT_EQ(box->width(), 170.0);
  EXPECT_EQ(box->height(), 84.25);
}

TEST(ParseBox, RefusesWhatIsNoBoxAndQuotesIt) {
  for (const char* text : {"",
                           "1,2,3",
                           "1,2,3,4,5",
                           "1,2,3,x",
                           "1,2,,4",
                           "1,2,0,4",
                           "1,2,3,-4",
                           "nan,2,3,4",
                           "1,2,inf,4",
                           "1;2;3;4"}) {
    const auto box = ParseBox(text);
    ASSERT_FALSE(box.ok()) << text;
    EXPECT_EQ(box.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(Message(box.status()), HasSubstr(std::string("\"") + text));
    EXPECT_THAT(Message(box.status()), HasSubstr("X,Y,W,H"));
  }
}

TEST(ParseTarget, ReadsIdBoxAndFrame) {
  const auto target = ParseTarget("red-car:1,2,3,4@17");
  ASSERT_TRUE(target.ok()) << target.status();
  EXPECT_EQ(target->id, "red-car");
  EXPECT_EQ(target->box_px.width(), 3.0);
  EXPECT_EQ(target->frame, 17U);
  const auto without = ParseTarget("b:1,2,3,4");
  ASSERT_TRUE(without.ok()) << without.status();
  EXPECT_FALSE(without->frame.has_value());
}

TEST(ParseTarget, RefusesBadIdsBoxesAndFrames) {
  for (const char* text : {"1,2,3,4",
                           ":1,2,3,4",
                           "a b:1,2,3,4",
                           "a:1,2,3",
                           "a:1,2,3,4@",
                           "a:1,2,3,4@-1",
                           "a:1,2,3,4@x"}) {
    EXPECT_FALSE(ParseTarget(text).ok()) << text;
  }
}

const std::vector<std::string> kKinds = {"car", "van"};

TEST(ParseBody, ReadsKindAndSize) {
  const auto kind = ParseBody("van", kKinds);
  ASSERT_TRUE(kind.ok()) << kind.status();
  EXPECT_TRUE(kind->id.empty());
  EXPECT_EQ(kind->body.kind, "van");
  EXPECT_FALSE(kind->body.size_m.has_value());
  const auto both = ParseBody("red-car:car,4.4x1.8x1.5", kKinds);
  ASSERT_TRUE(both.ok()) << both.status();
  EXPECT_EQ(both->id, "red-car");
  EXPECT_EQ(both->body.kind, "car");
  EXPECT_EQ(both->body.size_m, Eigen::Vector3d(4.4, 1.8, 1.5));
  const auto size = ParseBody("0.9x0.5x0.35", kKinds);
  ASSERT_TRUE(size.ok()) << size.status();
  EXPECT_TRUE(size->body.kind.empty());
  EXPECT_EQ(size->body.size_m, Eigen::Vector3d(0.9, 0.5, 0.35));
}

TEST(ParseBody, RefusesWhatIsNeither) {
  for (const char* text : {"",
                           "tank",
                           "car,",
                           "car,van",
                           "a b:car",
                           ":car",
                           "4.4x1.8",
                           "4.4x1.8x0",
                           "4.4x1.8xnan",
                           "4.4x1.8x1.5x2",
                           "1x1x1,2x2x2",
                           "car,1x1x1,car"}) {
    EXPECT_FALSE(ParseBody(text, kKinds).ok()) << text;
  }
}

TEST(ParseFrameRange, LeavesOutItsEnd) {
  const auto range = ParseFrameRange("10:20");
  ASSERT_TRUE(range.ok());
  EXPECT_EQ(range->begin, 10U);
  EXPECT_EQ(range->end, 20U);
  EXPECT_EQ(ParseFrameRange(":5")->begin, 0U);
  EXPECT_EQ(ParseFrameRange("5:")->end, media::FrameRange{}.end);
  for (const char* text : {"", "5", "5:5", "6:5", "-1:5", "a:b", "1:2:3"}) {
    EXPECT_FALSE(ParseFrameRange(text).ok()) << text;
  }
}

TEST(ParseSize, ReadsWidthAndHeight) {
  EXPECT_EQ(ParseSize("1280x720")->width, 1280);
  EXPECT_EQ(ParseSize("1280x720")->height, 720);
  for (const char* text : {"", "1280", "0x720", "70000x1", "1280x-1", "axb"}) {
    EXPECT_FALSE(ParseSize(text).ok()) << text;
  }
}

TEST(SimilarityFromJson, ReadsEveryField) {
  // 90 degrees about z: x becomes y.
  const auto similarity = SimilarityFromJson(
      R"({"scale":2,"rotation_wxyz":[0.70710678,0,0,0.70710678],)"
      R"("translation":[1,2,3]})");
  ASSERT_TRUE(similarity.ok()) << similarity.status();
  const Eigen::Vector3d p =
      similarity->scale * (similarity->rotation * Eigen::Vector3d::UnitX()) +
      similarity->translation;
  // Written with eight digits and normalised on reading.
  EXPECT_LT((p - Eigen::Vector3d(1, 4, 3)).norm(), 1e-7);
}

TEST(SimilarityFromJson, NamesTheFieldAtFault) {
  const struct {
    const char* json;
    const char* field;
  } cases[] = {
      {"", "JSON"},
      {"[1]", "JSON"},
      {"{}", "scale"},
      {R"({"scale":"2"})", "scale"},
      {R"({"scale":0})", "scale"},
      {R"({"scale":1})", "rotation_wxyz"},
      {R"({"scale":1,"rotation_wxyz":[1,0,0]})", "rotation_wxyz"},
      {R"({"scale":1,"rotation_wxyz":[2,0,0,0]})", "rotation_wxyz"},
      {R"({"scale":1,"rotation_wxyz":[0,0,0,0]})", "rotation_wxyz"},
      {R"({"scale":1,"rotation_wxyz":[1,0,0,null]})", "rotation_wxyz"},
      {R"({"scale":1,"rotation_wxyz":[1,0,0,0]})", "translation"},
      {R"({"scale":1,"rotation_wxyz":[1,0,0,0],"translation":[1,2,"3"]})",
       "translation"},
      {R"({"scale":1,"rotation_wxyz":[1,0,0,0],"translation":[1e999,2,3]})",
       "JSON"},
  };
  for (const auto& c : cases) {
    const auto similarity = SimilarityFromJson(c.json);
    ASSERT_FALSE(similarity.ok()) << c.json;
    EXPECT_THAT(Message(similarity.status()), HasSubstr(c.field)) << c.json;
  }
}

TEST(ReadAlignment, NamesTheFile) {
  auto directory =
      base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  ASSERT_TRUE(directory.ok()) << directory.status();
  const std::filesystem::path path = directory->path() / "align.json";
  EXPECT_THAT(Message(ReadAlignment(path).status()), HasSubstr("align.json"));
  std::ofstream(path) << "{\"scale\": -1}";
  const absl::Status status = ReadAlignment(path).status();
  EXPECT_THAT(Message(status), HasSubstr("align.json"));
  EXPECT_THAT(Message(status), HasSubstr("scale"));
}

TEST(ReadCamera, NamesTheFileAndTheField) {
  auto directory =
      base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  ASSERT_TRUE(directory.ok()) << directory.status();
  const std::filesystem::path path = directory->path() / "camera.json";
  std::ofstream(path) << R"({"width":1280,"height":720,"params":[1,2,3]})";
  const absl::Status status = ReadCamera(path).status();
  EXPECT_THAT(Message(status), HasSubstr("camera.json"));
  EXPECT_THAT(Message(status), HasSubstr("model"));
}

geometry::CameraModel Lens(int width_px, int height_px, double focal_px) {
  return *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimpleRadial,
      width_px,
      height_px,
      std::vector<double>{focal_px, 0.5 * width_px, 0.5 * height_px, 0.0});
}

TEST(SeenLensWarning, SaysWhatTheFramesShow) {
  const geometry::CameraModel lens = Lens(1'280, 720, 1'000.0);
  const std::string focal = SeenLensWarning(lens, {1.25, 0.0});
  EXPECT_THAT(focal, HasSubstr("1000.0 px"));
  EXPECT_THAT(focal, HasSubstr("about 1250 px"));
  EXPECT_THAT(focal, Not(HasSubstr("distortion")));
  const std::string corner = SeenLensWarning(lens, {1.0, -0.03});
  EXPECT_THAT(corner, HasSubstr("corners 3 % too far out"));
  EXPECT_THAT(corner, Not(HasSubstr("about")));
  EXPECT_THAT(SeenLensWarning(lens, {0.8, 0.04}),
              HasSubstr("about 800 px, and its distortion leaves the corners 4 "
                        "% too far in"));
}

TEST(LensWarning, NamesBothLensesWhereTheyDiffer) {
  const geometry::CameraModel of_map = Lens(1'280, 720, 919.0);
  EXPECT_EQ(LensWarning(Lens(1'280, 720, 950.0), of_map), "");
  // The same picture scaled, and another picture.
  EXPECT_EQ(LensWarning(Lens(640, 360, 459.5), of_map), "");
  EXPECT_EQ(LensWarning(Lens(640, 480, 900.0), of_map), "");
  const std::string warning = LensWarning(Lens(1'280, 720, 1'300.0), of_map);
  EXPECT_THAT(warning, HasSubstr("1300.0"));
  EXPECT_THAT(warning, HasSubstr("919.0"));
}

}  // namespace
}  // namespace groundlock::cli
