// SPDX-License-Identifier: Apache-2.0
// groundlock evaluate, on a yard that is rendered for it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "client/cli/evaluate/truth_csv.h"
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

// A sequence by the name of one of which figures are published.
TEST_F(EvaluateVerb, ComparesTrackersWithThosePublished) {
  const std::string yard = (command_.path() / "yard").string();
  const CommandLine local("");
  ASSERT_EQ(local.Run({"simulate",
                       "yard",
                       "srun",
                       "--out",
                       yard,
                       "--size",
                       "480x270",
                       "--frames",
                       "12"}),
            0)
      << local.Read("err");
  // Pixels of such truths count from 1; the first two frames do not show it.
  const auto rows = cli::ReadTruth(fs::path(yard) / "srun_truth.csv");
  ASSERT_TRUE(rows.ok()) << rows.status();
  const fs::path data = command_.path() / "flights";
  fs::create_directories(data);
  fs::rename(fs::path(yard) / "srun.mp4", data / "car10.mp4");
  std::ofstream truth(data / "car10.txt");
  for (const cli::TruthRow& row : *rows) {
    if (row.frame < 2 || !row.visible_box_px) {
      truth << "NaN,NaN,NaN,NaN\n";
      continue;
    }
    const geometry::Box2& box = *row.visible_box_px;
    truth << box.x() + 1.0 << ',' << box.y() + 1.0 << ',' << box.width() << ','
          << box.height() << '\n';
  }
  truth.close();
  const std::string out = (command_.path() / "report").string();
  ASSERT_EQ(command_.Run({"evaluate",
                          "--trackers",
                          data.string(),
                          "--tracker",
                          "dcf",
                          "--tracker",
                          "kcf",
                          "--out",
                          out}),
            0)
      << command_.Read("err");
  EXPECT_THAT(command_.Read("out"), HasSubstr("AutoTrack"));
  const auto json =
      nlohmann::json::parse(command_.Read("report/trackers.json"));
  ASSERT_EQ(json["runs"].size(), 2U);
  EXPECT_EQ(json["runs"][0]["tracker"], "dcf");
  EXPECT_EQ(json["runs"][0]["rated_frames"], 10);
  EXPECT_GT(json["runs"][0]["auc"].get<double>(), 0.6);
  EXPECT_GT(json["runs"][0]["precision_20px"].get<double>(), 0.9);
  bool published = false;
  for (const auto& line : json["table"]) {
    if (line["tracker"] != "ARCF") continue;
    published = true;
    EXPECT_FALSE(line["measured"].get<bool>());
    EXPECT_EQ(line["sequences"]["car10"]["auc"], 0.808);
  }
  EXPECT_TRUE(published);
  const std::string html = command_.Read("report/trackers.html");
  for (const char* text : {"Struck", "EDFT", "TLD", "0.639", "ARCF", "<svg"}) {
    EXPECT_THAT(html, HasSubstr(text));
  }
  EXPECT_TRUE(fs::exists(fs::path(out) / "car10_kcf.csv"));

  // What is wrong in such a folder is named.
  std::ofstream(data / "car10.txt") << "1,2,3,4\n1,2,3\n";
  EXPECT_NE(
      command_.Run({"evaluate", "--trackers", data.string(), "--out", out}), 0);
  EXPECT_THAT(command_.Read("err"), HasSubstr("car10.txt: line 2: expected"));
  EXPECT_NE(command_.Run({"evaluate", "--trackers", "--out", out}), 0);
  EXPECT_THAT(command_.Read("err"), HasSubstr("FOLDER is missing"));
  EXPECT_NE(command_.Run({"evaluate", yard, "--tracker", "dcf"}), 0);
  EXPECT_THAT(command_.Read("err"), HasSubstr("--trackers"));
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
