// SPDX-License-Identifier: Apache-2.0
// A thousand random truncations and byte flips of each format: an error or a
// map, never a crash.
#include <gtest/gtest.h>

#include <fstream>
#include <random>

#include "map_store/base/file.h"
#include "map_store/formats/formats.h"
#include "map_store/formats/internal/bundler_model.h"
#include "map_store/formats/internal/openmvg_model.h"
#include "map_store/formats/internal/opensfm_model.h"
#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;

constexpr int kRounds = 1'000;

std::string Damaged(const std::string& bytes, std::mt19937_64* generator) {
  const auto below = [&](std::size_t n) { return (*generator)() % n; };
  std::string result = bytes;
  if (below(3) == 0) result.resize(below(bytes.size()));
  const std::size_t flips = below(4) + (result.size() == bytes.size() ? 1 : 0);
  for (std::size_t i = 0; i < flips && !result.empty(); ++i) {
    result[below(result.size())] = static_cast<char>(below(256));
  }
  return result;
}

map::MapData SmallMap() {
  const auto camera = MakeCamera(geometry::CameraModelId::kSimpleRadial,
                                 {500, 320, 240, -0.05});
  return SyntheticMap({camera, camera}, 20);
}

struct Case {
  const char* name;
  ExportFormat format;
  const char* file;  // that is exported
};

class DamagedFiles : public ::testing::TestWithParam<Case> {};

TEST_P(DamagedFiles, AreRefusedOrReadButNeverCrash) {
  const base::TemporaryDirectory directory = MakeTestDirectory();
  const fs::path path = directory.path() / GetParam().file;
  ASSERT_TRUE(Export(SmallMap(), GetParam().format, path).ok());
  std::vector<fs::path> files;
  for (const auto& entry : fs::recursive_directory_iterator(directory.path())) {
    if (entry.is_regular_file()) files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  std::vector<std::string> contents;
  for (const fs::path& file : files) {
    contents.push_back(*base::ReadFile(file, 1 << 24));
  }
  std::mt19937_64 generator(11);
  int num_refused = 0;
  for (int i = 0; i < kRounds; ++i) {
    const std::size_t which = generator() % files.size();
    std::ofstream(files[which], std::ios::binary)
        << Damaged(contents[which], &generator);
    const auto data = Import(path, {}, nullptr);
    if (data.ok()) {
      EXPECT_TRUE(data->Validate().ok());
    } else {
      EXPECT_FALSE(data.status().message().empty());
      ++num_refused;
    }
    std::ofstream(files[which], std::ios::binary) << contents[which];
  }
  EXPECT_GT(num_refused, kRounds / 20);
}

INSTANTIATE_TEST_SUITE_P(
    All,
    DamagedFiles,
    ::testing::Values(Case{"Colmap", ExportFormat::kColmapBinary, "map"},
                      Case{"ColmapText", ExportFormat::kColmapText, "map"},
                      Case{"Nvm", ExportFormat::kNvm, "map.nvm"},
                      Case{"Groundlock", ExportFormat::kGroundlock, "m.glmap"}),
    [](const auto& param_info) { return param_info.param.name; });

// Parsers of formats that are only read, on small texts.
template <typename Parse>
void DamageText(const std::string& text, const Parse& parse) {
  ASSERT_TRUE(parse(text)) << "the sound text must be read";
  std::mt19937_64 generator(12);
  int num_refused = 0;
  for (int i = 0; i < kRounds; ++i) {
    if (!parse(Damaged(text, &generator))) ++num_refused;
  }
  EXPECT_GT(num_refused, kRounds / 20);
}

TEST(DamagedText, Bundler) {
  DamageText(
      "# Bundle file v0.3\n2 1\n"
      "500 0.1 -0.02\n1 0 0\n0 1 0\n0 0 1\n0 0 0\n"
      "510 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0\n"
      "0 0 -5\n10 20 30\n2 0 3 1.5 2.5 1 4 -100 3\n",
      [](const std::string& text) {
        return internal::ParseBundler(text, "bundle.out").ok();
      });
}

TEST(DamagedText, Keys) {
  std::string text = "1 128\n10.5 20.5 2 0.1\n";
  for (int i = 0; i < 128; ++i) text += std::to_string(i) + " ";
  DamageText(text, [](const std::string& damaged) {
    return internal::ParseKeyFile(damaged, "a.key").ok();
  });
}

TEST(DamagedText, OpenMvg) {
  DamageText(
      R"({"sfm_data_version":"0.3","root_path":"","views":[{"key":0,"value":)"
      R"({"ptr_wrapper":{"data":{"local_path":"/","filename":"a.jpg",)"
      R"("id_intrinsic":0,"id_pose":0}}}}],"intrinsics":[{"key":0,"value":)"
      R"({"polymorphic_id":2147483649,"polymorphic_name":"pinhole_brown_t2",)"
      R"("ptr_wrapper":{"data":{"width":640,"height":480,"focal_length":500,)"
      R"("principal_point":[320,240],"disto_t2":[0.1,0.01,0.001,0,0]}}}}],)"
      R"("extrinsics":[{"key":0,"value":{"rotation":[[1,0,0],[0,1,0],[0,0,1]],)"
      R"("center":[0,0,0]}}],"structure":[{"key":0,"value":{"X":[0,0,5],)"
      R"("observations":[{"key":0,"value":{"id_feat":0,"x":[1,2]}}]}}]})",
      [](const std::string& text) {
        return internal::ParseOpenMvg(text, "sfm_data.json").ok();
      });
}

TEST(DamagedText, OpenSfm) {
  constexpr char kTracks[] = "a.jpg\t7\t0\t0.1\t-0.1\t1\t2\t3\n";
  DamageText(
      R"([{"cameras":{"c":{"projection_type":"brown","width":640,"height":480,)"
      R"("focal_x":0.8,"focal_y":0.8,"c_x":0,"c_y":0,"k1":0.1,"k2":0,"k3":0.01,)"
      R"("p1":0,"p2":0}},"shots":{"a.jpg":{"rotation":[0.1,0,0],)"
      R"("translation":[0,0,1],"camera":"c"}},"points":{"7":{"color":[1,2,3],)"
      R"("coordinates":[0,0,5]}},"reference_lla":{"latitude":52,)"
      R"("longitude":13,"altitude":0}}])",
      [&](const std::string& text) {
        const auto model = internal::ParseOpenSfm(text, "reconstruction.json");
        if (!model.ok()) return false;
        (void)internal::ParseOpenSfmTracks(kTracks, "tracks.csv", *model);
        return true;
      });
}

}  // namespace
}  // namespace groundlock::formats
