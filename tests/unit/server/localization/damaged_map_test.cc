// SPDX-License-Identifier: Apache-2.0
// Bits of a map file that are not what they were: localisation stays within the
// file, and says so.
#include <gtest/gtest.h>

#include <chrono>
#include <cstring>
#include <filesystem>
#include <random>
#include <string>
#include <thread>

#include "map_store/base/file.h"
#include "map_store/map/internal/file_layout.h"
#include "server/localization/baseline_localizer.h"
#include "server/localization/fast_localizer.h"
#include "tests/support/rendered_place_test.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

namespace fs = std::filesystem;
using map::internal::FileHeader;

class DamagedMapTest : public test_support::RenderedPlaceTest {
 protected:
  void SetUp() override {
    auto directory =
        base::TemporaryDirectory::Create(fs::temp_directory_path());
    ASSERT_TRUE(directory.ok()) << directory.status();
    directory_.emplace(*std::move(directory));
    const fs::path path = directory_->path() / "whole.glmap";
    ASSERT_TRUE(map::WriteMapFile(map_->ToData(), path).ok());
    auto bytes = base::ReadFile(path, 1U << 30U);
    ASSERT_TRUE(bytes.ok()) << bytes.status();
    bytes_ = *std::move(bytes);
    std::memcpy(&header_, bytes_.data(), sizeof(header_));
    image_ = place_->Render(truth_);
  }

  // In the header or, more often, in any section, large or small.
  std::size_t AnyByte(std::mt19937_64& engine) const {
    const auto below = [&](std::size_t bound) {
      return std::uniform_int_distribution<std::size_t>(0, bound - 1)(engine);
    };
    while (true) {
      const std::size_t part = below(header_.sections.size() + 1);
      if (part == header_.sections.size()) return below(sizeof(FileHeader));
      const auto& section = header_.sections.at(part);
      const std::size_t size = section.count * section.element_bytes;
      if (size > 0) return section.offset + below(size);
    }
  }

  absl::StatusOr<std::shared_ptr<const map::Map>> Open(
      const std::string& bytes) const {
    const fs::path path = directory_->path() / "damaged.glmap";
    const absl::Status written = base::WriteFileAtomically(path, bytes);
    EXPECT_TRUE(written.ok()) << written;
    return map::Map::Open(path);
  }

  static absl::Status DamageOf(const map::Map& map) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(1);
    while (map.damage().ok() && std::chrono::steady_clock::now() < end) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return map.damage();
  }

  image::Frame FrameAt(int index) const {
    image::Frame frame;
    frame.sequence = static_cast<std::uint64_t>(index);
    frame.capture_time = index * std::chrono::milliseconds(40);
    frame.luma = image_;
    return frame;
  }

  std::optional<base::TemporaryDirectory> directory_;
  std::string bytes_;
  FileHeader header_;
  cv::Mat image_;
};

TEST_F(DamagedMapTest, FlippedBitsLeadNobodyOutsideAndAreTold) {
  constexpr int kFiles = 60;
  int opened = 0;
  int localised = 0;
  for (int file = 0; file < kFiles; ++file) {
    std::mt19937_64 engine(static_cast<std::uint64_t>(file));
    std::string bytes = bytes_;
    // One bit, or many.
    for (int i = file % 3 == 0 ? 1 : 40; i > 0; --i) {
      bytes[AnyByte(engine)] ^= static_cast<char>(1U << (engine() % 8));
    }
    const auto map = Open(bytes);
    if (!map.ok()) {
      EXPECT_TRUE(absl::IsDataLoss(map.status()) ||
                  absl::IsUnimplemented(map.status()))
          << map.status();
      continue;
    }
    ++opened;
    // Nobody compares checksums meanwhile: the code itself has to cope.
    LocalizerOptions options;
    FastLocalizer fast(*map, options, {});
    BaselineLocalizer baseline(*map, options);
    for (int index = 0; index < 3; ++index) {
      const image::Frame frame = FrameAt(index);
      for (Localizer* localizer :
           {static_cast<Localizer*>(&fast),
            static_cast<Localizer*>(index == 0 ? &baseline : nullptr)}) {
        if (localizer == nullptr) continue;
        const auto result = localizer->Localize({&frame, place_->camera(), {}});
        if (!result.ok()) {
          EXPECT_TRUE(absl::IsDataLoss(result.status())) << result.status();
        } else if (result->state == CameraState::kTracked) {
          ++localised;
        }
      }
    }
    (*map)->VerifyInBackground();
    EXPECT_TRUE(absl::IsDataLoss(DamageOf(**map))) << "file " << file;
    const image::Frame frame = FrameAt(3);
    const auto refused = fast.Localize({&frame, place_->camera(), {}});
    EXPECT_TRUE(absl::IsDataLoss(refused.status())) << refused.status();
  }
  // There was something to see.
  EXPECT_GT(opened, kFiles / 4);
  EXPECT_LT(opened, kFiles);
  EXPECT_GT(localised, 0);
}

TEST_F(DamagedMapTest, AWholeMapIsNotCalledDamaged) {
  const auto map = Open(bytes_);
  ASSERT_TRUE(map.ok()) << map.status();
  const auto localizer = CreateLocalizer("fast", *map, LocalizerOptions());
  ASSERT_TRUE(localizer.ok()) << localizer.status();
  for (int index = 0; index < 5; ++index) {
    const image::Frame frame = FrameAt(index);
    const auto result = (*localizer)->Localize({&frame, place_->camera(), {}});
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_EQ(result->state, CameraState::kTracked);
    EXPECT_LT(test_support::CenterError(*result->world_from_camera, truth_),
              0.03);
  }
  EXPECT_TRUE((*map)->damage().ok()) << (*map)->damage();
}

}  // namespace
}  // namespace groundlock::localization
