// SPDX-License-Identifier: Apache-2.0
// What COLMAP's own programs make of an export, and we of what they write.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>

#include "map_store/base/file.h"
#include "map_store/formats/formats.h"
#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;

bool Succeeds(const std::string& command) {
  return std::system(("QT_QPA_PLATFORM=offscreen " + command).c_str()) == 0;
}

#define SKIP_WITHOUT_COLMAP()                                    \
  if (std::system("command -v colmap > /dev/null 2>&1") != 0) {  \
    GTEST_SKIP() << "colmap is not installed (deploy/setup.sh)"; \
  }

void ExpectSame(const map::MapData& a, const map::MapData& b) {
  ASSERT_EQ(a.cameras.size(), b.cameras.size());
  ASSERT_EQ(a.views.size(), b.views.size());
  ASSERT_EQ(a.landmarks.size(), b.landmarks.size());
  EXPECT_EQ(NumObservations(a), NumObservations(b));
  for (std::size_t i = 0; i < a.cameras.size(); ++i) {
    EXPECT_EQ(a.cameras[i], b.cameras[i]) << i;
  }
  for (std::size_t i = 0; i < a.views.size(); ++i) {
    EXPECT_EQ(a.views[i].name, b.views[i].name);
    EXPECT_LT((a.views[i].camera_from_world.Matrix3x4() -
               b.views[i].camera_from_world.Matrix3x4())
                  .norm(),
              1e-9);
    EXPECT_EQ(a.views[i].landmarks, b.views[i].landmarks);
  }
  for (std::size_t i = 0; i < a.landmarks.size(); ++i) {
    EXPECT_LT((a.landmarks[i].p_world - b.landmarks[i].p_world).norm(), 1e-9);
    EXPECT_EQ(a.landmarks[i].rgb, b.landmarks[i].rgb);
  }
}

TEST(ColmapRoundTrip, ItsConverterAndAnalyzerKeepTheNumbers) {
  SKIP_WITHOUT_COLMAP();
  const base::TemporaryDirectory directory = MakeTestDirectory();
  const std::string root = directory.path().string();
  map::MapData original = SyntheticMap(AllCameraModels());
  // COLMAP reads a name up to the first blank.
  for (map::MapViewData& view : original.views) {
    std::replace(view.name.begin(), view.name.end(), ' ', '_');
  }
  ASSERT_TRUE(
      Export(original, ExportFormat::kColmapBinary, root + "/binary").ok());
  // Through our own importer first, which leaves out what nobody observes.
  const auto ours = Import(root + "/binary", {}, nullptr);
  ASSERT_TRUE(ours.ok()) << ours.status();
  fs::create_directory(root + "/text");
  fs::create_directory(root + "/back");
  ASSERT_TRUE(Succeeds("colmap model_converter --input_path '" + root +
                       "/binary' --output_path '" + root +
                       "/text' --output_type TXT > /dev/null 2>&1"));
  ASSERT_TRUE(Succeeds("colmap model_converter --input_path '" + root +
                       "/text' --output_path '" + root +
                       "/back' --output_type BIN > /dev/null 2>&1"));
  for (const char* folder : {"/text", "/back"}) {
    const auto theirs = Import(root + folder, {}, nullptr);
    ASSERT_TRUE(theirs.ok()) << folder << ": " << theirs.status();
    ExpectSame(*ours, *theirs);
  }

  ASSERT_TRUE(Succeeds("colmap model_analyzer --path '" + root +
                       "/binary' > '" + root + "/analysis' 2>&1"));
  const auto analysis = base::ReadFile(root + "/analysis", 1 << 20);
  ASSERT_TRUE(analysis.ok());
  const auto number = [&](const std::string& what) {
    const std::size_t at = analysis->find("\n" + what + ": ");
    if (at == std::string::npos) return -1.0;
    return std::atof(analysis->c_str() + at + what.size() + 3);
  };
  EXPECT_EQ(number("Registered images"),
            static_cast<double>(ours->views.size()));
  EXPECT_EQ(number("Points"), static_cast<double>(ours->landmarks.size()));
  EXPECT_EQ(number("Observations"),
            static_cast<double>(NumObservations(*ours)));
  double stored_px = 0.0;
  for (const auto& landmark : ours->landmarks) stored_px += landmark.error_px;
  stored_px /= static_cast<double>(ours->landmarks.size());
  EXPECT_NEAR(number("Mean reprojection error"), stored_px, 1e-5) << *analysis;
}

}  // namespace
}  // namespace groundlock::formats
