// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/uploads.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <string>

#include "client/dashboard/proxy/sources.h"
#include "map_store/base/file.h"

namespace groundlock::dashboard {
namespace {

namespace fs = std::filesystem;

class UploadsTest : public ::testing::Test {
 protected:
  std::unique_ptr<Uploads> Open() {
    auto uploads = Uploads::Open(directory_.path() / "uploads", limits_);
    EXPECT_TRUE(uploads.ok()) << uploads.status();
    return *std::move(uploads);
  }
  static absl::Status Put(Uploads& uploads,
                          const std::string& id,
                          const std::vector<std::string>& path,
                          const std::string& bytes) {
    auto file = uploads.OpenFile(id, path, bytes.size());
    if (!file.ok()) return file.status();
    if (const absl::Status s = (*file)->Write(bytes); !s.ok()) return s;
    return (*file)->Commit();
  }

  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  UploadLimits limits_;
};

TEST_F(UploadsTest, KeepsFilesUntilTheyAreRemoved) {
  std::string id;
  {
    const auto uploads = Open();
    const auto upload =
        uploads->Create(UploadKind::kMap, "my yard", "somebody");
    ASSERT_TRUE(upload.ok()) << upload.status();
    id = upload->id;
    ASSERT_TRUE(Put(*uploads, id, {"sparse", "images.bin"}, "0123").ok());
    EXPECT_EQ(Put(*uploads, id, {"sparse", "images.bin"}, "x").code(),
              absl::StatusCode::kAlreadyExists);
    EXPECT_EQ(Put(*uploads, id, {"..", "x"}, "x").code(),
              absl::StatusCode::kInvalidArgument);
    EXPECT_EQ(Put(*uploads, "nobody", {"x"}, "x").code(),
              absl::StatusCode::kNotFound);
  }
  const auto uploads = Open();  // after a restart
  const auto upload = uploads->Find(id);
  ASSERT_TRUE(upload.ok());
  EXPECT_EQ(upload->name, "my yard");
  EXPECT_EQ(upload->owner, "somebody");
  EXPECT_EQ(upload->kind, UploadKind::kMap);
  EXPECT_EQ(upload->bytes, 4U);
  EXPECT_EQ(upload->num_files, 1U);
  EXPECT_EQ(*base::ReadFile(upload->folder / "sparse" / "images.bin", 100),
            "0123");
  ASSERT_TRUE(uploads->Remove(id).ok());
  EXPECT_FALSE(fs::exists(upload->folder));
  EXPECT_EQ(uploads->Remove(id).code(), absl::StatusCode::kNotFound);
}

TEST_F(UploadsTest, AFileThatBreaksOffLeavesNothing) {
  const auto uploads = Open();
  const auto upload = *uploads->Create(UploadKind::kVideo, "drive", "somebody");
  {
    auto file = uploads->OpenFile(upload.id, {"a.mp4"}, 100);
    ASSERT_TRUE(file.ok());
    ASSERT_TRUE((*file)->Write("0123").ok());
    EXPECT_EQ(uploads->OpenFile(upload.id, {"a.mp4"}, 1).status().code(),
              absl::StatusCode::kAlreadyExists);
  }
  EXPECT_TRUE(fs::is_empty(upload.folder));
  EXPECT_TRUE(Put(*uploads, upload.id, {"a.mp4"}, "again").ok());
}

TEST_F(UploadsTest, LimitsHoldWhateverWasAnnounced) {
  limits_.max_video_bytes = 10;
  limits_.max_total_bytes = 15;
  limits_.max_uploads = 2;
  const auto uploads = Open();
  const auto one = *uploads->Create(UploadKind::kVideo, "one", "somebody");
  const auto two = *uploads->Create(UploadKind::kVideo, "two", "somebody");
  EXPECT_EQ(
      uploads->Create(UploadKind::kVideo, "three", "somebody").status().code(),
      absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(uploads->OpenFile(one.id, {"a"}, 11).status().code(),
            absl::StatusCode::kResourceExhausted);
  {
    auto file = *uploads->OpenFile(one.id, {"a"}, 0);
    ASSERT_TRUE(file->Write("0123456789").ok());
    EXPECT_EQ(file->Write("x").code(), absl::StatusCode::kResourceExhausted);
    ASSERT_TRUE(file->Commit().ok());
  }
  EXPECT_EQ(Put(*uploads, one.id, {"b"}, "x").code(),
            absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(Put(*uploads, two.id, {"a"}, "0123456789").code(),
            absl::StatusCode::kResourceExhausted)
      << "all uploads together";
  ASSERT_TRUE(uploads->Remove(one.id).ok());
  EXPECT_TRUE(Put(*uploads, two.id, {"a"}, "0123456789").ok());
}

TEST_F(UploadsTest, SourcesAreWhatIsThereAndNothingElse) {
  const fs::path folder = directory_.path() / "videos";
  fs::create_directories(folder / "photos");
  const auto write = [](const fs::path& path, const std::string& text) {
    ASSERT_TRUE(base::WriteFileAtomically(path, text).ok());
  };
  write(folder / "drive.mp4", "video");
  write(folder / "drive.camera.json",
        R"({"width":640,"height":480,"model":"SIMPLE_PINHOLE",)"
        R"("params":[500,320,240]})");
  write(folder / "notes.txt", "no video");
  write(folder / "photos" / "1.jpg", "photo");
  const auto uploads = Open();
  const auto upload = *uploads->Create(UploadKind::kVideo, "walk", "somebody");
  const Sources sources(
      folder, {{"gate", "rtsp://camera/1", ""}}, uploads.get());
  EXPECT_EQ(sources.List().size(), 3U) << "an upload without a video is none";
  ASSERT_TRUE(Put(*uploads, upload.id, {"walk.mp4"}, "video").ok());

  const auto drive = sources.Find("file:drive.mp4");
  ASSERT_TRUE(drive.ok()) << drive.status();
  EXPECT_EQ(drive->input, (folder / "drive.mp4").string());
  EXPECT_EQ(drive->source.camera().width_px(), 640);
  EXPECT_EQ(drive->source.camera().params(0), 500.0);
  EXPECT_EQ(sources.Find("file:photos")->source.kind(),
            pb::Source::KIND_FOLDER);
  EXPECT_EQ(sources.Find("stream:gate")->input, "rtsp://camera/1");
  EXPECT_EQ(sources.Find("upload:" + upload.id)->source.name(), "walk");
  for (const char* id : {"file:../drive.mp4",
                         "file:notes.txt",
                         "file:/etc/passwd",
                         "rtsp://elsewhere/1",
                         ""}) {
    EXPECT_EQ(sources.Find(id).status().code(), absl::StatusCode::kNotFound)
        << id;
  }
}

}  // namespace
}  // namespace groundlock::dashboard
