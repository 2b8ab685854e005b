// SPDX-License-Identifier: Apache-2.0
// Videos and photos made to harm who decodes them, sent to the real program.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <string>
#include <thread>

#include "tests/integration/program.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::AnyOf;
using ::testing::HasSubstr;
using ::testing::Not;

std::string ReadProc(const fs::path& process, const char* name) {
  std::ifstream file(process / name);
  return {std::istreambuf_iterator<char>(file), {}};
}

// The process that decodes for `server`; empty if there is none now.
fs::path FindDecoder(pid_t server) {
  const std::string parent = "\nPPid:\t" + std::to_string(server) + "\n";
  std::error_code error;
  for (fs::directory_iterator entry("/proc", error), end;
       !error && entry != end;
       entry.increment(error)) {
    if (entry->path().filename().string().find_first_not_of("0123456789") !=
        std::string::npos) {
      continue;
    }
    if (ReadProc(entry->path(), "status").find(parent) != std::string::npos &&
        ReadProc(entry->path(), "cmdline").starts_with("groundlock-decoder")) {
      return entry->path();
    }
  }
  return {};
}

class HostileMedia : public ::testing::Test {
 protected:
  HostileMedia() {
    setenv("PGPASSWORD", "secret of the database", 1);
    server_ =
        std::make_unique<Program>(std::vector<std::string>{"--listen",
                                                           "127.0.0.1:0",
                                                           "--store",
                                                           "@TMP@/store",
                                                           "--metrics",
                                                           "127.0.0.1:0"});
    const int port = server_->PortAfter("listening on 127.0.0.1:");
    client_ = *ConnectTo("127.0.0.1:" + std::to_string(port));
  }
  fs::path folder() const { return server_->directory(); }

  fs::path MakeVideo(const std::string& name, int num_frames) const {
    const fs::path path = folder() / name;
    cv::VideoWriter writer(path.string(),
                           cv::CAP_FFMPEG,
                           cv::VideoWriter::fourcc('M', 'J', 'P', 'G'),
                           25.0,
                           cv::Size(640, 480));
    EXPECT_TRUE(writer.isOpened());
    cv::Mat picture(480, 640, CV_8UC3);
    cv::RNG(5).fill(picture, cv::RNG::UNIFORM, 0, 256);
    cv::GaussianBlur(picture, picture, cv::Size(9, 9), 3.0);
    for (int i = 0; i < num_frames; ++i) writer.write(picture);
    return path;
  }
  absl::Status BuildOfVideo(const fs::path& video) const {
    sdk::BuildRequest request;
    request.name = "hostile";
    request.files = {{video, video.filename().string()}};
    request.video_path = video.filename().string();
    return client_->BuildMap(request).status();
  }
  // Whatever was sent: the server serves on, and nothing is left of it.
  void ExpectServing() const {
    const auto maps = client_->ListMaps();
    ASSERT_TRUE(maps.ok()) << maps.status();
    EXPECT_TRUE(maps->empty());
    EXPECT_FALSE(server_->Exited());
    EXPECT_THAT(server_->Log(), Not(HasSubstr("secret")));
  }

  std::unique_ptr<Program> server_;
  std::unique_ptr<sdk::Client> client_;
};

TEST_F(HostileMedia, ADecoderThatCrashesIsOneFailedBuild) {
  const fs::path video = MakeVideo("long.avi", 1'500);
  absl::Status status;
  std::thread build([&] { status = BuildOfVideo(video); });
  fs::path decoder;
  EXPECT_TRUE(Eventually([&] {
    decoder = FindDecoder(server_->pid());
    return !decoder.empty();
  }));
  if (!decoder.empty()) {
    EXPECT_THAT(ReadProc(decoder, "environ"), Not(HasSubstr("secret")));
    // As if the video had made it overwrite itself.
    kill(std::stoi(decoder.filename()), SIGSEGV);
  }
  build.join();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
  EXPECT_THAT(std::string(status.message()),
              HasSubstr("its decoder was ended by signal 11"));
  ExpectServing();
}

// A playlist is a video whose frames lie in other files.
TEST_F(HostileMedia, APlaylistDoesNotReadTheServersFiles) {
  const fs::path secret = MakeVideo("of_others.avi", 30);
  const fs::path playlist = folder() / "video.mp4";
  std::ofstream(playlist) << "#EXTM3U\n#EXT-X-TARGETDURATION:5\n"
                             "#EXTINF:5.0,\n"
                          << secret.string() << "\n#EXT-X-ENDLIST\n";
  const absl::Status status = BuildOfVideo(playlist);
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
  EXPECT_THAT(std::string(status.message()),
              AnyOf(HasSubstr("cannot be read as a video"),
                    HasSubstr("holds no frame that can be read")));
  ExpectServing();
}

TEST_F(HostileMedia, DamagedFilesOfRareFormatsAreNamed) {
  std::vector<std::uint8_t> bytes;
  cv::imencode(".tiff", cv::Mat(100, 100, CV_8UC3, {1, 2, 3}), bytes);
  for (int i = 0; i < 4; ++i) {
    std::vector<std::uint8_t> image = bytes;
    if (i == 2) {
      // The directory of tags stays, what it points at is gone.
      std::fill(image.begin() + 8, image.begin() + 60, 0xFF);
    }
    std::ofstream(folder() / ("photo" + std::to_string(i) + ".tif"),
                  std::ios::binary)
        .write(reinterpret_cast<const char*>(image.data()),
               static_cast<std::streamsize>(image.size()));
  }
  sdk::BuildRequest request;
  request.name = "hostile";
  for (int i = 0; i < 4; ++i) {
    const std::string name = "photo" + std::to_string(i) + ".tif";
    request.files.push_back({folder() / name, name});
  }
  const absl::Status status = client_->BuildMap(request).status();
  EXPECT_FALSE(status.ok());
  ExpectServing();
}

}  // namespace
}  // namespace groundlock::test
