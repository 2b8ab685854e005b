// SPDX-License-Identifier: Apache-2.0
// groundlock evaluate, on a yard that is rendered for it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/integration/command_line.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;

class EvaluateVerb : public ::testing::Test {
 protected:
  TestServer server_;
  CommandLine command_{server_.address()};
};

TEST_F(EvaluateVerb, MeasuresASequenceAgainstItsTruth) {
  const std::string yard = (command_.path() / "yard").string();
  for (const char* sequence : {"mapping", "srun"}) {
    const CommandLine local("");
    std::vector<std::string> arguments = {
        "simulate", "yard", sequence, "--out", yard, "--size", "480x270"};
    if (std::string(sequence) == "srun") {
      arguments.insert(arguments.end(), {"--frames", "24"});
    }
    ASSERT_EQ(local.Run(arguments), 0) << local.Read("err");
  }
  const std::string out = (command_.path() / "report").string();
  ASSERT_EQ(command_.Run({"evaluate", yard, "--out", out, "--frames", "0:6"}),
            0)
      << command_.Read("err");
  const auto json =
      nlohmann::json::parse(command_.Read("report/evaluation.json"));
  ASSERT_EQ(json["runs"].size(), 2U);
  EXPECT_EQ(json["runs"][0]["configuration"], "baseline+act");
  EXPECT_EQ(json["runs"][1]["configuration"], "defaults");
  for (const auto& run : json["runs"]) {
    EXPECT_EQ(run["experiment"], "srun");
    EXPECT_EQ(run["frames"], 6);
    // Small pictures, six frames: far looser than what it is good for.
    EXPECT_GE(run["camera"]["tracked_share"].get<double>(), 0.5) << run;
    EXPECT_LT(run["camera"]["position_error_m"]["median"].get<double>(), 0.2);
    EXPECT_GT(run["target"]["mean_overlap"].get<double>(), 0.3);
  }
  EXPECT_TRUE(fs::exists(fs::path(out) / "srun_defaults.csv"));
  const std::string html = command_.Read("report/report.html");
  EXPECT_THAT(html, HasSubstr("S-run"));
  EXPECT_THAT(html, HasSubstr("data:image/jpeg;base64,"));
  EXPECT_THAT(html, HasSubstr("124.7 ms"));
  // The map was there for the evaluation alone; now one of the user's own.
  ASSERT_EQ(command_.Run({"map", "list"}), 0);
  EXPECT_THAT(command_.Read("out"), Not(HasSubstr("evaluation")));
  ASSERT_EQ(command_.Run({"map",
                          "import",
                          "mine",
                          yard + "/map",
                          "--align",
                          yard + "/align.json"}),
            0)
      << command_.Read("err");
  ASSERT_EQ(command_.Run({"evaluate",
                          "--video",
                          yard + "/srun.mp4",
                          "--truth",
                          yard + "/srun_truth.csv",
                          "--map",
                          "mine",
                          "--configuration",
                          "defaults",
                          "--frames",
                          "0:3",
                          "--json",
                          "--out",
                          out}),
            0)
      << command_.Read("err");
  EXPECT_EQ(nlohmann::json::parse(command_.Read("out"))["runs"].size(), 1U);
  ASSERT_EQ(command_.Run({"map", "list"}), 0);
  EXPECT_THAT(command_.Read("out"), HasSubstr("mine"));
}

TEST_F(EvaluateVerb, NamesWhatIsMissingOrWrong) {
  const std::string out = (command_.path() / "report").string();
  const std::string folder = command_.path().string();
  const auto expect = [&](std::vector<std::string> arguments,
                          const std::string& message) {
    arguments.insert(arguments.begin(), "evaluate");
    arguments.insert(arguments.end(), {"--out", out});
    EXPECT_NE(command_.Run(arguments), 0) << message;
    EXPECT_THAT(command_.Read("err"), HasSubstr(message));
  };
  expect({folder}, "no NAME.mp4 with a NAME_truth.csv");
  expect({folder, "--experiment", "srun"}, "--experiment srun");
  expect({folder + "/nowhere"}, "nowhere");
  expect({folder, "--configuration", "act"}, "--configuration \"act\"");
  expect({folder, "--frames", "9:3"}, "--frames");
  expect({"--video", "a.mp4"}, "--video, --truth and --map go together");
  expect({"--video", "a.mp4", "--truth", "t.csv", "--map", "none"}, "none");
}

}  // namespace
}  // namespace groundlock::test
