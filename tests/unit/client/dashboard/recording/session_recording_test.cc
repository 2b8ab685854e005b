// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/recording/session_recording.h"

#include <google/protobuf/descriptor.pb.h>
#include <google/protobuf/dynamic_message.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include "client/dashboard/recording/internal/mcap_records.h"
#include "client/dashboard/recording/mcap_reader.h"
#include "foxglove/compressed_image.pb.h"
#include "map_store/base/file.h"

namespace groundlock::recording {
namespace {

namespace pb = ::groundlock::v1;
namespace fs = std::filesystem;

std::shared_ptr<pb::WatchSessionResponse> Update(std::uint64_t sequence,
                                                 std::size_t image_bytes) {
  auto update = std::make_shared<pb::WatchSessionResponse>();
  update->mutable_result()->set_sequence(sequence);
  update->mutable_result()->set_capture_time_ns(
      static_cast<std::int64_t>(sequence) * 40'000'000);
  if (image_bytes > 0) {
    update->mutable_image()->set_encoding(pb::IMAGE_ENCODING_JPEG);
    update->mutable_image()->set_data(std::string(image_bytes, 'j'));
  }
  return update;
}

class SessionRecordingTest : public ::testing::Test {
 protected:
  std::unique_ptr<SessionRecording> Start(
      const SessionRecordingOptions& options = {}) {
    pb::Session session;
    session.set_session_id("drive");
    session.set_map_name("yard");
    pb::MapInfo map;
    map.set_name("yard");
    map.set_version(3);
    auto recording = SessionRecording::Create(path_, session, map, options);
    EXPECT_TRUE(recording.ok()) << recording.status();
    return *std::move(recording);
  }

  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path path_ = directory_.path() / "drive.mcap";
};

TEST_F(SessionRecordingTest, KeepsResultsImagesSessionAndMap) {
  auto recording = Start();
  for (std::uint64_t i = 0; i < 50; ++i) recording->Add(Update(i, 2'000));
  auto points = std::make_shared<pb::GetPointCloudResponse>();
  points->set_total_points(7);
  recording->AddPoints(points);
  ASSERT_TRUE(recording->Finish().ok());
  EXPECT_EQ(recording->state().frames, 50U);
  EXPECT_EQ(recording->state().left_out, 0U);
  EXPECT_EQ(recording->state().file_bytes, fs::file_size(path_));

  const auto description = DescribeRecording(path_);
  ASSERT_TRUE(description.ok()) << description.status();
  EXPECT_TRUE(description->complete);
  EXPECT_EQ(description->session.session_id(), "drive");
  ASSERT_TRUE(description->map.has_value());
  EXPECT_EQ(description->map->version(), 3U);
  EXPECT_EQ(description->frames, 50U);

  std::vector<std::uint64_t> sequences;
  ASSERT_TRUE(ReadResults(path_, [&](const pb::FrameResult& result) {
                sequences.push_back(result.sequence());
                return true;
              }).ok());
  ASSERT_EQ(sequences.size(), 50U);
  EXPECT_EQ(sequences.back(), 49U);

  int images = 0;
  const auto reader = McapReader::Open(path_);
  ASSERT_TRUE(
      (*reader)
          ->Read([](std::string_view t) { return t == "/session/image"; },
                 [&images](const McapMessage& message) {
                   foxglove::CompressedImage image;
                   EXPECT_TRUE(
                       image.ParseFromString(std::string(message.data)));
                   EXPECT_EQ(image.format(), "jpeg");
                   EXPECT_EQ(image.frame_id(), "drive");
                   EXPECT_EQ(image.data().size(), 2'000U);
                   EXPECT_EQ(message.publish_time_ns, 40'000'000ULL * images);
                   EXPECT_EQ(message.schema, "foxglove.CompressedImage");
                   ++images;
                   return true;
                 })
          .ok());
  EXPECT_EQ(images, 50);
  // For the reference implementation to read.
  if (const char* copy = std::getenv("GROUNDLOCK_RECORDING_COPY")) {
    fs::copy_file(path_, copy, fs::copy_options::overwrite_existing);
  }
}

// A reader without our sources: types made from the schema in the file alone.
TEST_F(SessionRecordingTest, ItsSchemasAreEnoughToReadIt) {
  auto recording = Start();
  recording->Add(Update(11, 0));
  ASSERT_TRUE(recording->Finish().ok());
  const auto reader = McapReader::Open(path_);
  ASSERT_TRUE(reader.ok());
  std::string schema;
  for (const auto& one : (*reader)->summary().schemas) {
    EXPECT_EQ(one.encoding, "protobuf");
    if (one.name == "groundlock.v1.FrameResult") schema = one.data;
  }
  google::protobuf::FileDescriptorSet set;
  ASSERT_TRUE(set.ParseFromString(schema));
  google::protobuf::DescriptorPool pool;
  for (const auto& file : set.file()) {
    ASSERT_NE(pool.BuildFile(file), nullptr) << file.name();
  }
  const auto* type = pool.FindMessageTypeByName("groundlock.v1.FrameResult");
  ASSERT_NE(type, nullptr);
  google::protobuf::DynamicMessageFactory factory(&pool);
  const std::unique_ptr<google::protobuf::Message> message(
      factory.GetPrototype(type)->New());
  ASSERT_TRUE(
      (*reader)
          ->Read([](std::string_view t) { return t == "/session/result"; },
                 [&](const McapMessage& one) {
                   EXPECT_TRUE(message->ParseFromString(std::string(one.data)));
                   return true;
                 })
          .ok());
  EXPECT_EQ(message->GetReflection()->GetUInt64(
                *message, type->FindFieldByName("sequence")),
            11U);
}

TEST_F(SessionRecordingTest, ASlowDiskCostsImagesAndNotMemory) {
  SessionRecordingOptions options;
  options.max_waiting_bytes = 10'000;
  auto recording = Start(options);
  // No image fits, all results do.
  for (std::uint64_t i = 0; i < 20; ++i) recording->Add(Update(i, 20'000));
  ASSERT_TRUE(recording->Finish().ok());
  EXPECT_EQ(recording->state().left_out, 20U);
  EXPECT_EQ(DescribeRecording(path_)->frames, 20U);
}

TEST_F(SessionRecordingTest, TheLimitEndsTheRecordingAndKeepsTheFileReadable) {
  SessionRecordingOptions options;
  options.mcap.max_file_bytes = 2 << 20;
  auto recording = Start(options);
  for (std::uint64_t i = 0; i < 20; ++i) recording->Add(Update(i, 100'000));
  EXPECT_EQ(recording->Finish().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(recording->state().status.code(),
            absl::StatusCode::kResourceExhausted);
  const auto description = DescribeRecording(path_);
  ASSERT_TRUE(description.ok()) << description.status();
  EXPECT_TRUE(description->complete);
  EXPECT_GT(description->frames, 5U);
}

}  // namespace
}  // namespace groundlock::recording
