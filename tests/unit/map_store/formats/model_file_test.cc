// SPDX-License-Identifier: Apache-2.0
// What imports take is told before: files of nothing but the shortest records,
// imported in processes of their own.
#include "map_store/formats/internal/model_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>

#include "map_store/base/file.h"
#include "map_store/base/sanitizers.h"
#include "map_store/formats/formats.h"

namespace groundlock::formats::internal {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;

[[maybe_unused]] constexpr int kRecords = 100'000;

template <typename... Values>
std::string Bytes(const Values&... values) {
  std::string bytes;
  (bytes.append(reinterpret_cast<const char*>(&values), sizeof(values)), ...);
  return bytes;
}

using U8 = std::uint8_t;
using U32 = std::uint32_t;
using U64 = std::uint64_t;

class ModelFile : public ::testing::Test {
 protected:
  fs::path folder() const { return directory_.path(); }
  void Write(const std::string& name, const std::string& bytes) const {
    std::ofstream(folder() / name, std::ios::binary) << bytes;
  }
  static std::string Repeat(int count,
                            const std::function<std::string(int)>& record) {
    std::string bytes;
    for (int i = 0; i < count; ++i) bytes += record(i);
    return bytes;
  }
  // Of importing `path`, beyond what the process takes anyway.
  std::uint64_t PeakBytes(const fs::path& path) const {
    int ends[2];
    EXPECT_EQ(pipe(ends), 0);
    const pid_t child = fork();
    if (child == 0) {
      const auto peak = [] {
        rusage usage{};
        getrusage(RUSAGE_SELF, &usage);
        return static_cast<std::uint64_t>(usage.ru_maxrss) << 10;
      };
      // Mapped files count as memory of the process while they are looked at.
      const std::uint64_t before = peak();
      ImportOptions options;
      options.memory_bytes = std::uint64_t{1} << 40;
      std::vector<std::string> warnings;
      static_cast<void>(Import(path, options, &warnings));
      const std::uint64_t taken = peak() - before;
      if (write(ends[1], &taken, sizeof(taken)) < 0) _exit(1);
      _exit(0);
    }
    std::uint64_t taken = 0;
    EXPECT_EQ(read(ends[0], &taken, sizeof(taken)),
              static_cast<ssize_t>(sizeof(taken)));
    waitpid(child, nullptr, 0);
    close(ends[0]);
    close(ends[1]);
    return taken;
  }
  std::uint64_t Told(const std::string& name, ModelFileKind kind) const {
    const auto file = base::MappedFile::Open(folder() / name, 1ULL << 40);
    EXPECT_TRUE(file.ok()) << file.status();
    return MemoryToImport(file->bytes(), kind);
  }
  void ExpectTold(const fs::path& path, std::uint64_t told) const {
    const std::uint64_t peak = PeakBytes(path);
    std::printf("%s: takes %.1f MiB, told %.1f MiB\n",
                path.filename().c_str(),
                static_cast<double>(peak) / (1 << 20),
                static_cast<double>(told) / (1 << 20));
    EXPECT_LE(peak, told);
  }
  void WriteColmapBinary(int num_images, int num_points, int per_image) const {
    Write("cameras.bin",
          Bytes(U64{1}, U32{1}, U32{0}, U64{640}, U64{480}, 500., 320., 240.));
    Write("images.bin",
          Bytes(static_cast<U64>(num_images)) + Repeat(num_images, [&](int i) {
            std::string image =
                Bytes(static_cast<U32>(i), 1., 0., 0., 0., 0., 0., 0.) +
                Bytes(U32{1}) + std::to_string(i) + std::string(1, '\0') +
                Bytes(static_cast<U64>(per_image));
            for (int p = 0; p < per_image; ++p) {
              image += Bytes(1., 1., static_cast<U64>(p));
            }
            return image;
          }));
    Write("points3D.bin",
          Bytes(static_cast<U64>(num_points)) + Repeat(num_points, [&](int i) {
            std::string point = Bytes(static_cast<U64>(i), 1., 1., 1.);
            point += Bytes(U8{0}, U8{0}, U8{0}, 1.);
            point += Bytes(static_cast<U64>(i < per_image ? num_images : 0));
            for (int v = 0; i < per_image && v < num_images; ++v) {
              point += Bytes(static_cast<U32>(v), static_cast<U32>(i));
            }
            return point;
          }));
  }
  std::uint64_t ColmapBinaryTold() const {
    return Told("cameras.bin", ModelFileKind::kColmapCameras) +
           Told("images.bin", ModelFileKind::kColmapImages) +
           Told("points3D.bin", ModelFileKind::kColmapPoints);
  }

 private:
  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
};

#if !defined(GROUNDLOCK_HAS_SHADOW)
TEST_F(ModelFile, ColmapsBinaryModelTakesWhatIsTold) {
  WriteColmapBinary(kRecords, 1, 1);
  ExpectTold(folder(), ColmapBinaryTold());
  WriteColmapBinary(1, kRecords, 1);
  ExpectTold(folder(), ColmapBinaryTold());
  WriteColmapBinary(4, kRecords, kRecords);
  ExpectTold(folder(), ColmapBinaryTold());
}

TEST_F(ModelFile, ColmapsTextTakesWhatIsTold) {
  Write("cameras.txt", "1 SIMPLE_PINHOLE 640 480 500 320 240\n");
  Write("images.txt",
        "0 1 0 0 0 0 0 0 1 a\n1 1 0\n" + Repeat(kRecords, [](int i) {
          return std::to_string(i + 1) + " 1 0 0 0 0 0 0 1 " +
                 std::to_string(i) + "\n\n";
        }));
  Write("points3D.txt", Repeat(kRecords, [](int i) {
          return std::to_string(i) + " 1 1 1 0 0 0 0\n";
        }));
  ExpectTold(folder(),
             Told("cameras.txt", ModelFileKind::kText) +
                 Told("images.txt", ModelFileKind::kText) +
                 Told("points3D.txt", ModelFileKind::kText));
}

TEST_F(ModelFile, NvmTakesWhatIsTold) {
  // Each camera's image is looked for.
  constexpr int kCameras = kRecords / 10;
  Write("a.nvm",
        "NVM_V3\n\n" + std::to_string(kCameras) + "\n" +
            Repeat(kCameras,
                   [](int i) {
                     return std::to_string(i) + " 1 1 0 0 0 0 0 0 0 0\n";
                   }) +
            "\n" + std::to_string(kRecords) + "\n" +
            Repeat(kRecords, [](int i) {
              return "0 0 9 0 0 0 1 " + std::to_string(i) + " 0 1 1\n";
            }));
  ExpectTold(folder() / "a.nvm", Told("a.nvm", ModelFileKind::kTextOfFeatures));
}

TEST_F(ModelFile, JsonTakesWhatIsTold) {
  Write("sfm_data.json",
        R"({"sfm_data_version":"0.3","views":[)" +
            Repeat(4 * kRecords, [](int) { return std::string("[],"); }) +
            "[]]}");
  ExpectTold(folder() / "sfm_data.json",
             Told("sfm_data.json", ModelFileKind::kJson));
}
#endif

TEST_F(ModelFile, WhatTakesMoreIsRefusedByName) {
  WriteColmapBinary(100, 1, 1);
  ImportOptions options;
  options.memory_bytes = 64 << 10;
  std::vector<std::string> warnings;
  const auto refused = Import(folder(), options, &warnings);
  EXPECT_EQ(refused.status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(std::string(refused.status().message()),
              AllOf(HasSubstr("images.bin"), HasSubstr("GiB of memory")));
  options.memory_bytes = 1 << 20;
  EXPECT_NE(Import(folder(), options, &warnings).status().code(),
            absl::StatusCode::kResourceExhausted);
}

TEST_F(ModelFile, AMappedFileIsItsBytes) {
  Write("empty", "");
  Write("some", "some bytes");
  EXPECT_EQ(base::MappedFile::Open(folder() / "empty", 10)->bytes(), "");
  auto some = base::MappedFile::Open(folder() / "some", 10);
  ASSERT_TRUE(some.ok()) << some.status();
  const base::MappedFile moved = *std::move(some);
  EXPECT_EQ(moved.bytes(), "some bytes");
  EXPECT_EQ(base::MappedFile::Open(folder() / "some", 9).status().code(),
            absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(base::MappedFile::Open(folder() / "none", 9).status().code(),
            absl::StatusCode::kNotFound);
  EXPECT_EQ(base::MappedFile::Open(folder(), 9).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace groundlock::formats::internal
