// SPDX-License-Identifier: Apache-2.0
#include "map_store/decoding/image_reader.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/base/sanitizers.h"
#include "map_store/decoding/internal/decoder_process.h"

namespace groundlock::decoding {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class ImageReaderTest : public ::testing::Test {
 protected:
  static cv::Mat Pattern(int width_px, int height_px) {
    cv::Mat image(height_px, width_px, CV_8UC3);
    cv::RNG random(7);
    random.fill(image, cv::RNG::UNIFORM, 0, 256);
    return image;
  }
  fs::path Save(const std::string& name, const cv::Mat& image) const {
    const fs::path path = directory_.path() / name;
    EXPECT_TRUE(cv::imwrite(path.string(), image));
    return path;
  }
  fs::path SaveBytes(const std::string& name, const std::string& bytes) const {
    const fs::path path = directory_.path() / name;
    std::ofstream(path, std::ios::binary) << bytes;
    return path;
  }

 private:
  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
};

bool AreEqual(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() &&
         cv::norm(a, b, cv::NORM_INF) == 0.0;
}

std::string ReadProc(pid_t pid, const char* name) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/" + name);
  return {std::istreambuf_iterator<char>(file), {}};
}

TEST_F(ImageReaderTest, GivesThePixelsThatDecodingHereGives) {
  ImageReader reader;
  for (const char* name :
       {"a.png", "a.jpg", "a.tif", "a.bmp", "a.webp", "a.ppm"}) {
    const fs::path path = Save(name, Pattern(321, 123));
    const auto colour = reader.ReadColour(path);
    ASSERT_TRUE(colour.ok()) << colour.status();
    EXPECT_TRUE(
        AreEqual(*colour,
                 cv::imread(path.string(),
                            cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION)));
    const auto luma = reader.ReadLuma(path);
    ASSERT_TRUE(luma.ok()) << luma.status();
    EXPECT_TRUE(AreEqual(
        *luma,
        cv::imread(path.string(),
                   cv::IMREAD_GRAYSCALE | cv::IMREAD_IGNORE_ORIENTATION)));
  }
}

TEST_F(ImageReaderTest, DamageIsToldAndTheNextImageIsRead) {
  ImageReader reader;
  const fs::path good = Save("good.png", Pattern(64, 48));
  const std::string bytes = *base::ReadFile(good, 1 << 20);
  for (const std::size_t kept : {std::size_t{100}, bytes.size() / 2}) {
    const auto cut = reader.ReadColour(
        SaveBytes("cut.tif",
                  base::ReadFile(Save("whole.tif", Pattern(64, 48)), 1 << 20)
                      ->substr(0, kept)));
    EXPECT_FALSE(cut.ok());
    EXPECT_THAT(std::string(cut.status().message()), HasSubstr("cut.tif"));
  }
  EXPECT_THAT(
      std::string(
          reader.ReadColour(SaveBytes("a.png", "no image")).status().message()),
      HasSubstr("a.png"));
  EXPECT_EQ(reader.ReadColour("/no/such.png").status().code(),
            absl::StatusCode::kNotFound);
  EXPECT_TRUE(reader.ReadColour(good).ok());
}

TEST_F(ImageReaderTest, ManyThreadsReadAtATime) {
  ImageReader reader;
  const fs::path path = Save("a.png", Pattern(640, 480));
  const cv::Mat expected = cv::imread(path.string());
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&] {
      for (int i = 0; i < 5; ++i) {
        const auto image = reader.ReadColour(path);
        ASSERT_TRUE(image.ok()) << image.status();
        EXPECT_TRUE(AreEqual(*image, expected));
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

#if !defined(GROUNDLOCK_HAS_SHADOW)
TEST_F(ImageReaderTest, AMemoryBombIsOneFailedImage) {
  // Of 300 KB, which decode to 307 MB.
  const fs::path bomb =
      Save("bomb.png", cv::Mat::zeros(10'000, 10'240, CV_8UC3));
  ASSERT_LT(fs::file_size(bomb), 1U << 20);
  const fs::path small = Save("small.png", Pattern(64, 48));
  // What a decoder takes before it has seen anything, and some more.
  const auto idle = internal::DecoderProcess::Start({});
  ASSERT_TRUE(idle.ok()) << idle.status();
  EXPECT_FALSE((*idle)->Ask(internal::Command::kDecodeLuma, "x").ok());
  std::uint64_t pages = 0;
  std::istringstream(ReadProc((*idle)->pid(), "statm")) >> pages;
  ASSERT_GT(pages, 0U);
  DecoderOptions options;
  options.memory_bytes = pages * 4'096 + (std::uint64_t{150} << 20);
  ImageReader reader(options);
  EXPECT_TRUE(reader.ReadColour(small).ok());
  const auto image = reader.ReadColour(bomb);
  EXPECT_EQ(image.status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(std::string(image.status().message()),
              AllOf(HasSubstr("bomb.png"), HasSubstr("memory")));
  EXPECT_TRUE(reader.ReadColour(small).ok());
}
#endif

TEST_F(ImageReaderTest, ACrashAndAHangAreOneFailedImageEach) {
  // One that is killed is heard of however long its end takes.
  auto decoder = internal::DecoderProcess::Start({});
  ASSERT_TRUE(decoder.ok()) << decoder.status();
  // As if a picture had made it overwrite itself.
  kill((*decoder)->pid(), SIGSEGV);
  const auto crashed =
      (*decoder)->Ask(internal::Command::kDecodeLuma, "picture");
  EXPECT_EQ(crashed.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(crashed.status().message()),
              HasSubstr("ended by signal 11"));
  EXPECT_FALSE((*decoder)->is_alive());
  EXPECT_FALSE((*decoder)->Ask(internal::Command::kDecodeLuma).ok());

  DecoderOptions options;
  options.silence = std::chrono::milliseconds(300);
  decoder = internal::DecoderProcess::Start(options);
  ASSERT_TRUE(decoder.ok()) << decoder.status();
  kill((*decoder)->pid(), SIGSTOP);
  const auto hung = (*decoder)->Ask(internal::Command::kDecodeLuma, "picture");
  EXPECT_EQ(hung.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(hung.status().message()),
              HasSubstr("gave no answer for 0.3 s"));
  EXPECT_FALSE((*decoder)->is_alive());
}

TEST_F(ImageReaderTest, ADecoderIsCagedAndKnowsNoPasswords) {
  setenv("PGPASSWORD", "secret", 1);
  // What a careless library leaves open for children: where a video would be.
  const int left_open = open("/proc/self/status", O_RDONLY);
  EXPECT_GE(dup2(left_open, internal::kMediaFile), 0);
  const auto decoder = internal::DecoderProcess::Start({});
  ASSERT_TRUE(decoder.ok()) << decoder.status();
  // Once it has answered, it is in.
  EXPECT_FALSE((*decoder)->Ask(internal::Command::kDecodeLuma, "x").ok());
  ASSERT_TRUE((*decoder)->is_alive());
  const pid_t pid = (*decoder)->pid();
  EXPECT_THAT(ReadProc(pid, "cmdline"), HasSubstr("groundlock-decoder"));
  EXPECT_THAT(ReadProc(pid, "environ"),
              AllOf(HasSubstr("MALLOC_ARENA_MAX"), Not(HasSubstr("secret"))));
  EXPECT_THAT(ReadProc(pid, "status"),
              AllOf(HasSubstr("Seccomp:\t2"), HasSubstr("NoNewPrivs:\t1")));
  EXPECT_THAT(ReadProc(pid, "limits"),
              AllOf(HasSubstr("Max file size             0"),
                    HasSubstr("Max core file size        0"),
                    HasSubstr("Max open files            16")));
  // Its own end of the socket, and nothing of ours.
  std::vector<std::string> open_files;
  for (const auto& entry :
       fs::directory_iterator("/proc/" + std::to_string(pid) + "/fd")) {
    open_files.push_back(entry.path().filename());
  }
  EXPECT_THAT(open_files, ::testing::UnorderedElementsAre("0", "1", "2", "3"));
  EXPECT_EQ(fs::read_symlink("/proc/" + std::to_string(pid) + "/fd/3"),
            "/dev/null");
}

TEST_F(ImageReaderTest, ADecoderEndsWithWhoeverAskedIt) {
  // Even if it hangs: what notices is a thread of its own.
  pid_t decoder_pid = 0;
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  const pid_t asker = fork();
  if (asker == 0) {
    auto decoder = internal::DecoderProcess::Start({});
    if (decoder.ok()) {
      static_cast<void>((*decoder)->Ask(internal::Command::kDecodeLuma, "x"));
      decoder_pid = (*decoder)->pid();
    }
    if (write(ends[1], &decoder_pid, sizeof(decoder_pid)) < 0) _exit(1);
    _exit(0);  // nothing is tidied up
  }
  ASSERT_EQ(read(ends[0], &decoder_pid, sizeof(decoder_pid)),
            static_cast<ssize_t>(sizeof(decoder_pid)));
  ASSERT_GT(decoder_pid, 0);
  waitpid(asker, nullptr, 0);
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  const auto is_gone = [&] {
    const std::string status = ReadProc(decoder_pid, "status");
    return status.empty() || status.find("State:\tZ") != std::string::npos;
  };
  while (!is_gone() && std::chrono::steady_clock::now() < end) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  EXPECT_TRUE(is_gone());
  close(ends[0]);
  close(ends[1]);
}

}  // namespace
}  // namespace groundlock::decoding
