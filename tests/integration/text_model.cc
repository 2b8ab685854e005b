// SPDX-License-Identifier: Apache-2.0
#include "tests/integration/text_model.h"

#include <fstream>
#include <random>
#include <sstream>

namespace groundlock::test {

std::vector<std::pair<std::string, std::string>> TextModel() {
  std::mt19937_64 generator(7);
  std::uniform_real_distribution<double> place(-2.0, 2.0);
  std::normal_distribution<double> bump(0.0, 0.005);
  std::ostringstream cameras;
  std::ostringstream images;
  std::ostringstream points;
  cameras << "# cameras\n1 SIMPLE_PINHOLE 640 480 300 320 240\n";
  std::vector<std::string> features(kTextModelViews);
  for (int i = 0; i < kTextModelPoints; ++i) {
    const double x = place(generator);
    const double y = place(generator);
    const double z = bump(generator);
    points << i + 1 << ' ' << x << ' ' << y << ' ' << z << " 10 20 30 0.1";
    for (int v = 0; v < kTextModelViews; ++v) {
      // Turned half about x: camera x = world x, camera y = -y, depth 5 - z.
      const double depth = 5.0 - z;
      std::ostringstream feature;
      feature << 320 + 300 * (x - 0.2 * v) / depth << ' '
              << 240 - 300 * y / depth << ' ' << i + 1 << ' ';
      features[v] += feature.str();
      points << ' ' << v + 1 << ' ' << i;
    }
    points << '\n';
  }
  for (int v = 0; v < kTextModelViews; ++v) {
    // t = -R C with C = (0.2 v, 0, 5).
    images << v + 1 << " 0 1 0 0 " << -0.2 * v << " 0 5 1 image" << v
           << ".png\n"
           << features[v] << '\n';
  }
  return {{"cameras.txt", cameras.str()},
          {"images.txt", images.str()},
          {"points3D.txt", points.str()}};
}

sdk::ImportRequest WriteForImport(
    const std::filesystem::path& directory,
    const std::string& name,
    const std::vector<std::pair<std::string, std::string>>& files) {
  sdk::ImportRequest request;
  request.name = name;
  request.model_path = ".";
  const std::filesystem::path folder = directory / name;
  std::filesystem::create_directories(folder);
  for (const auto& [path, content] : files) {
    std::ofstream(folder / path, std::ios::binary) << content;
    request.files.push_back({folder / path, path});
  }
  return request;
}

}  // namespace groundlock::test
