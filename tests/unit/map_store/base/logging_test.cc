// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/logging.h"

#include <gtest/gtest.h>
#include <spdlog/sinks/ostream_sink.h>
#include <spdlog/spdlog.h>

#include <memory>
#include <sstream>

namespace groundlock::base {
namespace {

std::string Logged(LogFormat format, const std::string& name) {
  std::ostringstream out;
  spdlog::set_default_logger(std::make_shared<spdlog::logger>(
      "", std::make_shared<spdlog::sinks::ostream_sink_mt>(out)));
  SetUpLogging("info", format);
  spdlog::info("map '{}': deleted", name);
  spdlog::debug("not at this level");
  return out.str();
}

TEST(Logging, ANameCannotAddALine) {
  const std::string line =
      Logged(LogFormat::kText,
             "yard\n[2026-01-01 00:00:00.000] [info] \x1b[31mforged");
  EXPECT_EQ(line.find('\n'), line.size() - 1) << line;
  EXPECT_EQ(line.find('\x1b'), std::string::npos);
  EXPECT_NE(
      line.find(
          R"([info] map 'yard\n[2026-01-01 00:00:00.000] [info] \x1b[31mforged': deleted)"),
      std::string::npos)
      << line;
}

TEST(Logging, JsonStaysOneObjectPerLine) {
  const std::string line = Logged(LogFormat::kJson,
                                  "a\"b\\c\r\n\x01"
                                  "d");
  EXPECT_EQ(line.find('\n'), line.size() - 1) << line;
  EXPECT_NE(
      line.find(
          R"("level":"info","text":"map 'a\"b\\c\r\n\u0001d': deleted"})"),
      std::string::npos)
      << line;
  EXPECT_EQ(line.substr(0, 9), R"({"time":")");
}

TEST(Logging, FieldsStandBesideTheTextWhileTheyHold) {
  std::string within;
  {
    const LogFields call({{"request_id", "5f-3e"}, {"tenant", ""}});
    const LogFields session({{"request_id", "again"}, {"session", "a\"b\n"}});
    within = Logged(LogFormat::kJson, "yard");
    EXPECT_EQ(Logged(LogFormat::kText, "yard").find("5f-3e"),
              std::string::npos);
  }
  EXPECT_NE(
      within.find(
          R"("text":"map 'yard': deleted","request_id":"5f-3e","session":"a\"b\n"})"),
      std::string::npos)
      << within;
  EXPECT_NE(Logged(LogFormat::kJson, "yard").find(R"(deleted"})"),
            std::string::npos);
}

}  // namespace
}  // namespace groundlock::base
