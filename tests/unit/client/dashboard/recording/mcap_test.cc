// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "client/dashboard/recording/internal/mcap_records.h"
#include "client/dashboard/recording/mcap_reader.h"
#include "client/dashboard/recording/mcap_writer.h"
#include "map_store/base/file.h"

namespace groundlock::recording {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

namespace fs = std::filesystem;

class Mcap : public ::testing::Test {
 protected:
  std::string Bytes() { return *base::ReadFile(path_, 1 << 24); }
  void Overwrite(const std::string& bytes) {
    std::ofstream(path_, std::ios::binary) << bytes;
  }
  // Three chunks of two topics; finished unless told otherwise.
  void WriteSample(bool finish) {
    McapWriterOptions options;
    options.chunk_bytes = 200;
    auto writer = McapWriter::Create(path_, options);
    ASSERT_TRUE(writer.ok()) << writer.status();
    const auto a = (*writer)->AddChannel("/a", "pkg.A", "schema of A");
    const auto b = (*writer)->AddChannel("/b", "pkg.B", "schema of B");
    ASSERT_TRUE(a.ok() && b.ok());
    for (int i = 0; i < 6; ++i) {
      ASSERT_TRUE((*writer)
                      ->Write(*a, 100 + i, 1000 + i, "a" + std::to_string(i))
                      .ok());
      ASSERT_TRUE(
          (*writer)->Write(*b, 100 + i, 1000 + i, std::string(60, 'b')).ok());
    }
    if (finish) {
      ASSERT_TRUE((*writer)->Finish().ok());
    }
    // Otherwise it goes as if killed: the chunk begun is lost.
  }
  std::vector<std::string> Read(std::string_view topic) {
    std::vector<std::string> data;
    auto reader = McapReader::Open(path_);
    EXPECT_TRUE(reader.ok()) << reader.status();
    if (!reader.ok()) return data;
    const absl::Status status =
        (*reader)->Read([topic](std::string_view t) { return t == topic; },
                        [&data](const McapMessage& message) {
                          data.emplace_back(message.data);
                          return true;
                        });
    EXPECT_TRUE(status.ok()) << status;
    return data;
  }

  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path path_ = directory_.path() / "sample.mcap";
};

TEST_F(Mcap, HoldsWhatWasWritten) {
  WriteSample(/*finish=*/true);
  const auto reader = McapReader::Open(path_);
  ASSERT_TRUE(reader.ok()) << reader.status();
  EXPECT_TRUE((*reader)->complete());
  EXPECT_EQ((*reader)->num_messages("/a"), 6U);
  EXPECT_EQ((*reader)->num_messages("/b"), 6U);
  EXPECT_EQ((*reader)->num_messages("/c"), 0U);
  EXPECT_EQ((*reader)->start_time_ns(), 100U);
  EXPECT_EQ((*reader)->end_time_ns(), 105U);
  EXPECT_GE((*reader)->summary().chunks.size(), 3U);
  EXPECT_EQ((*reader)->summary().schemas[1].data, "schema of B");
  EXPECT_THAT(Read("/a"), ElementsAre("a0", "a1", "a2", "a3", "a4", "a5"));
  std::uint64_t publish = 1000;
  ASSERT_TRUE((*reader)
                  ->Read([](std::string_view) { return true; },
                         [&publish](const McapMessage& message) {
                           EXPECT_EQ(message.schema,
                                     message.topic == "/a" ? "pkg.A" : "pkg.B");
                           EXPECT_EQ(message.publish_time_ns, publish);
                           if (message.topic == "/b") ++publish;
                           return publish < 1003;
                         })
                  .ok());
  EXPECT_EQ(publish, 1003U) << "reading stops when it is told to";
}

// The bytes themselves, by the specification rather than by our own reader.
TEST_F(Mcap, HasTheLayoutOfTheSpecification) {
  WriteSample(/*finish=*/true);
  const std::string bytes = Bytes();
  const std::string magic("\x89MCAP0\r\n", 8);
  EXPECT_EQ(bytes.substr(0, 8), magic);
  EXPECT_EQ(bytes.substr(bytes.size() - 8), magic);
  EXPECT_EQ(bytes[8], 0x01) << "the header comes first";
  // Footer: opcode, length 20, summary start, offset start, checksum.
  const std::string footer = bytes.substr(bytes.size() - 8 - 29, 29);
  EXPECT_EQ(footer[0], 0x02);
  EXPECT_EQ(footer.substr(1, 8), std::string("\x14\0\0\0\0\0\0\0", 8));
  const auto u64 = [](const std::string& text) {
    std::uint64_t value = 0;
    for (int i = 7; i >= 0; --i) {
      value = value << 8 | static_cast<unsigned char>(text[i]);
    }
    return value;
  };
  const std::uint64_t summary = u64(footer.substr(9, 8));
  const std::uint64_t offsets = u64(footer.substr(17, 8));
  EXPECT_EQ(bytes[summary], 0x03) << "schemas open the summary";
  EXPECT_EQ(bytes[offsets], 0x0E) << "then where its groups are";
  EXPECT_EQ(bytes[summary - 13], 0x0F) << "the data section is closed";
  const std::string covered =
      bytes.substr(summary, bytes.size() - 12 - summary);
  EXPECT_EQ(internal::Crc32(covered),
            u64(bytes.substr(bytes.size() - 12, 4) + std::string(4, '\0')));
  // The standard's check value.
  EXPECT_EQ(internal::Crc32("123456789"), 0xCBF43926U);
}

TEST_F(Mcap, AFileThatWasInterruptedIsReadUpToItsLastChunk) {
  WriteSample(/*finish=*/false);
  {
    const auto reader = McapReader::Open(path_);
    ASSERT_TRUE(reader.ok()) << reader.status();
    EXPECT_FALSE((*reader)->complete());
    EXPECT_EQ((*reader)->num_messages("/a"), Read("/a").size());
  }
  const auto before = Read("/a");
  ASSERT_GE(before.size(), 4U);
  ASSERT_TRUE(RepairMcap(path_).ok());
  EXPECT_TRUE((*McapReader::Open(path_))->complete());
  EXPECT_EQ(Read("/a"), before);
  const std::string repaired = Bytes();
  ASSERT_TRUE(RepairMcap(path_).ok());
  EXPECT_EQ(Bytes(), repaired) << "a whole file is left alone";
}

TEST_F(Mcap, AFileCutAnywhereIsReadOrRefusedButRepairsToWhatWasRead) {
  WriteSample(/*finish=*/true);
  const std::string whole = Bytes();
  const auto all = Read("/a");
  for (std::size_t size = 0; size < whole.size(); size += 7) {
    Overwrite(whole.substr(0, size));
    const auto reader = McapReader::Open(path_);
    if (size < 8) {
      EXPECT_EQ(reader.status().code(), absl::StatusCode::kDataLoss);
      continue;
    }
    ASSERT_TRUE(reader.ok()) << size << " " << reader.status();
    const auto part = Read("/a");
    EXPECT_TRUE(std::equal(part.begin(), part.end(), all.begin())) << size;
    ASSERT_TRUE(RepairMcap(path_).ok()) << size;
    EXPECT_EQ(Read("/a"), part) << size;
    EXPECT_TRUE((*McapReader::Open(path_))->complete()) << size;
  }
}

TEST_F(Mcap, DamageIsNoticedAndNamed) {
  WriteSample(/*finish=*/true);
  std::string bytes = Bytes();
  std::uint64_t chunk = 0;
  {
    const auto reader = McapReader::Open(path_);
    chunk = (*reader)->summary().chunks[1].chunk_offset;
  }
  bytes[chunk + 70] = static_cast<char>(bytes[chunk + 70] ^ 0x5A);
  Overwrite(bytes);
  const auto reader = McapReader::Open(path_);
  ASSERT_TRUE(reader.ok());
  const absl::Status status =
      (*reader)->Read([](std::string_view) { return true; },
                      [](const McapMessage&) { return true; });
  EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(std::string(status.message()),
              HasSubstr("at byte " + std::to_string(chunk)));
  // In the index.
  bytes[bytes.size() - 40] = static_cast<char>(bytes[bytes.size() - 40] ^ 1);
  Overwrite(bytes);
  EXPECT_EQ(McapReader::Open(path_).status().code(),
            absl::StatusCode::kDataLoss);
}

TEST_F(Mcap, TheLimitOfAFileLeavesRoomForItsIndex) {
  McapWriterOptions options;
  options.max_file_bytes = 3 << 20;
  auto writer = McapWriter::Create(path_, options);
  ASSERT_TRUE(writer.ok());
  const auto channel = (*writer)->AddChannel("/a", "pkg.A", "s");
  std::string noise(100'000, '\0');
  std::uint32_t state = 1;
  absl::Status status;
  int written = 0;
  while (status.ok() && written < 100) {
    // Different each time: zstd finds repetitions.
    for (char& c : noise) {
      c = static_cast<char>((state = state * 1664525 + 1013904223) >> 24);
    }
    status = (*writer)->Write(*channel, written, written, noise);
    if (status.ok()) ++written;
  }
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_GT(written, 10);
  ASSERT_TRUE((*writer)->Finish().ok());
  EXPECT_LE(fs::file_size(path_), options.max_file_bytes);
  EXPECT_EQ(Read("/a").size(), static_cast<std::size_t>(written));
}

TEST_F(Mcap, RefusesWhatItCannotDo) {
  EXPECT_EQ(McapReader::Open(path_).status().code(),
            absl::StatusCode::kNotFound);
  Overwrite("something else altogether");
  EXPECT_EQ(McapReader::Open(path_).status().code(),
            absl::StatusCode::kDataLoss);
  EXPECT_EQ(McapWriter::Create(path_, {}).status().code(),
            absl::StatusCode::kAlreadyExists);
  fs::remove(path_);
  auto writer = McapWriter::Create(path_, {});
  ASSERT_TRUE(writer.ok());
  EXPECT_EQ((*writer)->Write(3, 0, 0, "x").code(),
            absl::StatusCode::kInvalidArgument);
  McapWriterOptions options;
  options.chunk_bytes = 0;
  EXPECT_FALSE(options.Validate().ok());
}

}  // namespace
}  // namespace groundlock::recording
