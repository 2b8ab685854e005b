// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "map_store/base/file.h"
#include "map_store/build/posed.h"

namespace groundlock::build {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class PosesFile : public ::testing::Test {
 protected:
  absl::StatusOr<std::vector<PosedImage>> Read(const std::string& name,
                                               const std::string& text) const {
    std::ofstream(directory_.path() / name) << text;
    return ReadPoses(directory_.path() / name);
  }
  void ExpectError(const std::string& name,
                   const std::string& text,
                   const std::string& words) const {
    const auto poses = Read(name, text);
    ASSERT_FALSE(poses.ok()) << text;
    EXPECT_THAT(std::string(poses.status().message()), HasSubstr(words));
  }

 private:
  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
};

TEST_F(PosesFile, CsvColumnsMayStandInAnyOrder) {
  const auto poses = Read("p.csv",
                          "# a comment\n"
                          "qw,qx,qy,qz,sigma,name,x,y,z\n"
                          "0.6,0,0.8,0,9,a.jpg,1,2,-3.5\n\n"
                          "1, 0, 0, 0, 9, b.jpg, 0, 0, 0\r\n");
  ASSERT_TRUE(poses.ok()) << poses.status();
  ASSERT_EQ(poses->size(), 2U);
  EXPECT_EQ((*poses)[0].name, "a.jpg");
  EXPECT_EQ((*poses)[0].world_from_camera.translation,
            Eigen::Vector3d(1, 2, -3.5));
  EXPECT_NEAR((*poses)[0].world_from_camera.rotation.y(), 0.8, 1e-12);
  EXPECT_EQ((*poses)[1].name, "b.jpg");
}

TEST_F(PosesFile, JsonMayCarryTheLens) {
  const auto poses = Read(
      "p.json",
      R"([{"image":"a.jpg","width":640,"height":480,"model":"SIMPLE_PINHOLE",
           "params":[500,320,240],"centre_m":[1,2,3],
           "world_from_camera_wxyz":[1,0,0,0]},
          {"image":"b.jpg","centre_m":[0,0,0],
           "world_from_camera_wxyz":[0,1,0,0]}])");
  ASSERT_TRUE(poses.ok()) << poses.status();
  ASSERT_EQ(poses->size(), 2U);
  ASSERT_TRUE((*poses)[0].camera.has_value());
  EXPECT_EQ((*poses)[0].camera->width_px(), 640);
  EXPECT_FALSE((*poses)[1].camera.has_value());
}

TEST_F(PosesFile, ALensIsFlatHoweverDeepTheInput) {
  constexpr int kDepth = 1'000'000;
  const std::string deep = std::string(kDepth, '[') + std::string(kDepth, ']');
  const std::string pose =
      R"([{"image":"a.jpg","centre_m":[0,0,0],)"
      R"("world_from_camera_wxyz":[1,0,0,0],"model":"PINHOLE","params":)";
  ExpectError("p.json", pose + deep + "}]", "entry 0: params: neither");
}

TEST_F(PosesFile, ErrorsNameTheLineAndTheField) {
  const std::string header = "name,x,y,z,qw,qx,qy,qz\n";
  ExpectError("p.csv", "name,x,y,z,qw,qx,qy\n", "'qz'");
  ExpectError("p.csv", "x,y,z,qw,qx,qy,qz\n", "'name'");
  ExpectError("p.csv", header + "a,1,2,3,1,0,0\n", "line 2: 7 columns");
  ExpectError("p.csv", header + "a,1,two,3,1,0,0,0\n", "line 2: column 'y'");
  ExpectError("p.csv", header + "a,1,2,3,1,1,0,0\n", "unit length");
  ExpectError("p.csv", header + "a,nan,2,3,1,0,0,0\n", "not finite");
  ExpectError("p.csv", header, "no poses");
  ExpectError("p.json", "{}", "array");
  ExpectError("p.json", R"([{"image":"a"}])", "entry 0: centre_m");
  ExpectError("p.json",
              R"([{"image":"a","centre_m":[0,0,"x"],
                   "world_from_camera_wxyz":[1,0,0,0]}])",
              "centre_m");
}

}  // namespace
}  // namespace groundlock::build
