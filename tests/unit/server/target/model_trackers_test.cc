// SPDX-License-Identifier: Apache-2.0
// What can be told of trackers whose models are not at hand: that they say so.
#include "server/target/model_trackers.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <opencv2/core.hpp>

#include "server/target/target_tracker.h"

namespace groundlock::target {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class ModelTrackers : public ::testing::TestWithParam<ModelTrackerKind> {
 protected:
  void SetUp() override {
    folder_ = fs::path(::testing::TempDir()) /
              ("models_" + GetParam().name + std::to_string(::getpid()));
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }

  fs::path folder_;
};

TEST_P(ModelTrackers, WithoutAFolderSaysWhatItNeeds) {
  const auto tracker = CreateTargetTracker({GetParam().name, ""});
  EXPECT_EQ(tracker.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(tracker.status().message()),
              HasSubstr(GetParam().files[0]));
}

TEST_P(ModelTrackers, NamesTheFileThatIsNotThere) {
  const std::vector<std::string>& files = GetParam().files;
  for (std::size_t i = 0; i < files.size(); ++i) {
    const auto tracker =
        CreateTargetTracker({GetParam().name, folder_.string()});
    EXPECT_EQ(tracker.status().code(), absl::StatusCode::kNotFound);
    EXPECT_THAT(std::string(tracker.status().message()), HasSubstr(files[i]));
    std::ofstream(folder_ / files[i]) << "no model\n";
  }
}

TEST_P(ModelTrackers, AFileThatIsNoModelIsToldWhenATargetStarts) {
  for (const std::string& file : GetParam().files) {
    std::ofstream(folder_ / file) << "no model\n";
  }
  const auto tracker = CreateTargetTracker({GetParam().name, folder_.string()});
  ASSERT_TRUE(tracker.ok()) << tracker.status();
  const cv::Mat image(120, 160, CV_8UC3, cv::Scalar::all(90));
  const absl::Status started =
      (*tracker)->Initialize(image, geometry::Box2::FromXywh(60, 40, 40, 30));
  EXPECT_EQ(started.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(started.message()), HasSubstr(GetParam().name));
  EXPECT_FALSE((*tracker)->Detect(image, false).ok());
}

INSTANTIATE_TEST_SUITE_P(All,
                         ModelTrackers,
                         ::testing::ValuesIn(ModelTrackerKinds()),
                         [](const auto& kind) { return kind.param.name; });

}  // namespace
}  // namespace groundlock::target
