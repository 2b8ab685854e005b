// SPDX-License-Identifier: Apache-2.0
// Reconstructions that Bundler and OpenSfM wrote, and one in OpenMVG's format:
// conventions, counts, errors.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "map_store/base/file.h"
#include "map_store/formats/formats.h"
#include "map_store/formats/internal/openmvg_model.h"
#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;

// The mean error of a bundle.out by the formulas of Bundler's manual, in its
// own coordinates: nothing here is shared with the importer.
double BundlerMeanErrorPx(const fs::path& path) {
  std::ifstream in(path);
  std::string comment;
  std::getline(in, comment);
  int num_cameras = 0;
  int num_points = 0;
  in >> num_cameras >> num_points;
  struct Camera {
    double f, k1, k2, r[9], t[3];
  };
  std::vector<Camera> cameras(static_cast<std::size_t>(num_cameras));
  for (Camera& c : cameras) {
    in >> c.f >> c.k1 >> c.k2;
    for (double& v : c.r) in >> v;
    for (double& v : c.t) in >> v;
  }
  double sum = 0.0;
  int count = 0;
  for (int i = 0; i < num_points; ++i) {
    double x[3];
    double colour = 0.0;
    int views = 0;
    in >> x[0] >> x[1] >> x[2] >> colour >> colour >> colour >> views;
    for (int j = 0; j < views; ++j) {
      std::size_t camera = 0;
      int key = 0;
      double u = 0.0;
      double v = 0.0;
      in >> camera >> key >> u >> v;
      const Camera& c = cameras[camera];
      double p[3];
      for (int row = 0; row < 3; ++row) {
        p[row] = c.t[row] + c.r[3 * row] * x[0] + c.r[3 * row + 1] * x[1] +
                 c.r[3 * row + 2] * x[2];
      }
      const double px = -p[0] / p[2];
      const double py = -p[1] / p[2];
      const double rr = px * px + py * py;
      const double scale = c.f * (1.0 + c.k1 * rr + c.k2 * rr * rr);
      sum += std::hypot(scale * px - u, scale * py - v);
      ++count;
    }
  }
  return sum / count;
}

TEST(Bundler, KermitHasItsCountsErrorAndDescriptors) {
  const fs::path folder = DataFolder() / "importers/bundler_kermit";
  const fs::path path = folder / "results.example/bundle.out";
  if (!fs::exists(path)) GTEST_SKIP() << path << " is not there";
  std::vector<std::string> warnings;
  const auto data = Import(path, {}, &warnings);
  ASSERT_TRUE(data.ok()) << data.status();
  // The file lists 11 cameras; two were not registered (f = 0).
  EXPECT_EQ(data->views.size(), 9U);
  EXPECT_EQ(data->cameras.size(), 9U);
  EXPECT_THAT(warnings, Contains(HasSubstr("registered 9 of the model's 11")));
  EXPECT_EQ(data->landmarks.size(), 634U);
  EXPECT_EQ(data->cameras[0].width_px(), 640);
  EXPECT_TRUE(data->has_descriptors());
  const auto reprojection = map::ComputeReprojection(*data);
  EXPECT_EQ(reprojection.num_behind_camera, 0U);
  EXPECT_NEAR(reprojection.mean_error_px / BundlerMeanErrorPx(path), 1.0, 0.01);
  // Bundler's keypoints are SIFT's: most are found again, to the pixel, only if
  // the axes and the pixels' centres are right.
  EXPECT_THAT(warnings, Contains(HasSubstr("computed descriptors from 9")));
  EXPECT_EQ(NumObservations(*data), 2039U);
  const auto upload = FindImportFiles(path, {});
  ASSERT_TRUE(upload.ok()) << upload.status();
  EXPECT_EQ(upload->files.size(), 12U);
  EXPECT_EQ(upload->images, "images");
}

// Images can take any time: an import whose client has gone is not worth it.
TEST(Bundler, AnImportEndsBeforeTheNextImageIfItIsTold) {
  const fs::path path =
      DataFolder() / "importers/bundler_kermit/results.example/bundle.out";
  if (!fs::exists(path)) GTEST_SKIP() << path << " is not there";
  int asked = 0;
  ImportOptions options;
  options.go_on = [&asked] { return ++asked < 3; };
  std::vector<std::string> warnings;
  EXPECT_EQ(Import(path, options, &warnings).status().code(),
            absl::StatusCode::kCancelled);
  EXPECT_EQ(asked, 3);
}

TEST(OpenSfm, BerlinHasItsCountsErrorAndPlace) {
  const fs::path path =
      DataFolder() / "importers/opensfm_berlin/reconstruction_example.json";
  if (!fs::exists(path)) GTEST_SKIP() << path << " is not there";
  std::vector<std::string> warnings;
  const auto data = Import(path, {}, &warnings);
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_EQ(data->views.size(), 3U);
  EXPECT_EQ(data->cameras.size(), 1U);
  EXPECT_EQ(data->landmarks.size(), 1430U);
  EXPECT_TRUE(data->has_descriptors());
  ASSERT_TRUE(data->origin.has_value());
  EXPECT_NEAR(data->origin->latitude_deg, 52.51896296, 1e-7);
  EXPECT_TRUE(data->metric);
  EXPECT_FALSE(data->in_world);
  // By the formulas of OpenSfM's documentation, from the text alone.
  const auto text = base::ReadFile(path, 1 << 24);
  ASSERT_TRUE(text.ok());
  const auto model = nlohmann::json::parse(*text)[0];
  const auto camera = model["cameras"].begin().value();
  std::ifstream tracks(path.parent_path() / "tracks_example.csv");
  std::string line;
  std::getline(tracks, line);
  double sum = 0.0;
  std::size_t count = 0;
  while (std::getline(tracks, line)) {
    std::istringstream fields(line);
    std::string image;
    std::string track;
    int feature = 0;
    double x = 0.0;
    double y = 0.0;
    std::getline(fields, image, '\t');
    std::getline(fields, track, '\t');
    fields >> feature >> x >> y;
    if (!model["shots"].contains(image) || !model["points"].contains(track)) {
      continue;
    }
    const auto vector = [](const nlohmann::json& v) {
      return Eigen::Vector3d(v[0], v[1], v[2]);
    };
    const auto& shot = model["shots"][image];
    const Eigen::Vector3d turn = vector(shot["rotation"]);
    const Eigen::Vector3d p =
        Eigen::AngleAxisd(turn.norm(), turn.normalized()) *
            vector(model["points"][track]["coordinates"]) +
        vector(shot["translation"]);
    const Eigen::Vector2d n = p.head<2>() / p.z();
    const double r2 = n.squaredNorm();
    const Eigen::Vector2d projected =
        camera["focal"].get<double>() *
        (1.0 +
         r2 * (camera["k1"].get<double>() + r2 * camera["k2"].get<double>())) *
        n;
    sum += 3264.0 * (projected - Eigen::Vector2d(x, y)).norm();
    ++count;
  }
  EXPECT_EQ(NumObservations(*data), count);
  const auto reprojection = map::ComputeReprojection(*data);
  EXPECT_NEAR(reprojection.mean_error_px / (sum / static_cast<double>(count)),
              1.0,
              0.01);
}

// A map of ours, as OpenMVG would write it.
std::string AsOpenMvg(const map::MapData& data) {
  using nlohmann::json;
  json views = json::array();
  json extrinsics = json::array();
  for (std::size_t i = 0; i < data.views.size(); ++i) {
    const auto world_from_camera = data.views[i].camera_from_world.Inverse();
    const Eigen::Matrix3d r =
        data.views[i].camera_from_world.rotation.toRotationMatrix();
    const auto& c = world_from_camera.translation;
    views.push_back({{"key", i},
                     {"value",
                      {{"polymorphic_id", 1073741824},
                       {"ptr_wrapper",
                        {{"id", 2147483649U + i},
                         {"data",
                          {{"local_path", ""},
                           {"filename", data.views[i].name},
                           {"width", 640},
                           {"height", 480},
                           {"id_view", i},
                           {"id_intrinsic", 0},
                           {"id_pose", i}}}}}}}});
    extrinsics.push_back({{"key", i},
                          {"value",
                           {{"rotation",
                             {{r(0, 0), r(0, 1), r(0, 2)},
                              {r(1, 0), r(1, 1), r(1, 2)},
                              {r(2, 0), r(2, 1), r(2, 2)}}},
                            {"center", {c.x(), c.y(), c.z()}}}}});
  }
  const auto k = data.cameras[0].params();
  // OpenMVG's first pixel's centre is (0, 0).
  json intrinsics =
      json::array({{{"key", 0},
                    {"value",
                     {{"polymorphic_id", 2147483649U},
                      {"polymorphic_name", "pinhole_radial_k3"},
                      {"ptr_wrapper",
                       {{"id", 2147483660U},
                        {"data",
                         {{"width", 640},
                          {"height", 480},
                          {"focal_length", k[0]},
                          {"principal_point", {k[1] - 0.5, k[2] - 0.5}},
                          {"disto_k3", {k[3], 0.0, 0.0}}}}}}}}}});
  std::vector<json> seen(data.landmarks.size(), json::array());
  for (std::size_t v = 0; v < data.views.size(); ++v) {
    const auto& view = data.views[v];
    for (std::size_t i = 0; i < view.landmarks.size(); ++i) {
      seen[view.landmarks[i]].push_back(
          {{"key", v},
           {"value",
            {{"id_feat", i},
             {"x",
              {view.keypoints_px[i].x() - 0.5F,
               view.keypoints_px[i].y() - 0.5F}}}}});
    }
  }
  json structure = json::array();
  for (std::size_t i = 0; i < data.landmarks.size(); ++i) {
    const auto& p = data.landmarks[i].p_world;
    structure.push_back(
        {{"key", i},
         {"value", {{"X", {p.x(), p.y(), p.z()}}, {"observations", seen[i]}}}});
  }
  return json{{"sfm_data_version", "0.3"},
              {"root_path", "/nowhere"},
              {"views", views},
              {"intrinsics", intrinsics},
              {"extrinsics", extrinsics},
              {"structure", structure},
              {"control_points", json::array()}}
      .dump();
}

TEST(OpenMvg, ReadsPosesPointsAndFeatures) {
  const auto camera = MakeCamera(geometry::CameraModelId::kSimpleRadial,
                                 {500, 320, 240, -0.05});
  map::MapData original = SyntheticMap({camera, camera, camera});
  original.cameras = {camera};
  for (auto& view : original.views) view.camera = 0;
  const base::TemporaryDirectory directory = MakeTestDirectory();
  std::ofstream(directory.path() / "sfm_data.json") << AsOpenMvg(original);
  for (const auto& view : original.views) {
    const std::string stem = fs::path(view.name).stem().string();
    std::ofstream feat(directory.path() / (stem + ".feat"));
    std::ofstream desc(directory.path() / (stem + ".desc"), std::ios::binary);
    const std::uint64_t count = view.descriptors.size();
    desc.write(reinterpret_cast<const char*>(&count), sizeof(count));
    for (std::size_t i = 0; i < count; ++i) {
      feat << view.keypoints_px[i].x() - 0.5F << ' '
           << view.keypoints_px[i].y() - 0.5F << " 2 0\n";
      // The permutation is its own inverse.
      const auto raw = internal::ReorderOpenMvgDescriptor(view.descriptors[i]);
      desc.write(reinterpret_cast<const char*>(raw.data()), 128);
    }
  }
  std::vector<std::string> warnings;
  const auto data = Import(directory.path(), {}, &warnings);
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_TRUE(warnings.empty()) << warnings[0];
  ASSERT_EQ(data->views.size(), 3U);
  EXPECT_EQ(NumObservations(*data), NumObservations(original));
  EXPECT_LT(map::ComputeReprojection(*data).mean_error_px, 1e-3);
  EXPECT_EQ(data->cameras[0].id(), geometry::CameraModelId::kSimpleRadial);
  EXPECT_EQ(data->views[1].descriptors, original.views[1].descriptors);
}

TEST(OpenMvg, SaysWhatIsMissing) {
  EXPECT_THAT(std::string(internal::ParseOpenMvg(
                              R"({"sfm_data_version":"0.3","views":[]})", "f")
                              .status()
                              .message()),
              HasSubstr("holds no reconstruction"));
  EXPECT_FALSE(internal::ParseOpenMvg(std::string(100'000, '['), "f").ok());
}

}  // namespace
}  // namespace groundlock::formats
