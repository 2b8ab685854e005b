// SPDX-License-Identifier: Apache-2.0
// Somebody with a token that is good for little calls everything with
// everything in it. The others' sessions go on as if nothing had happened, and
// nothing of theirs comes out.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <filesystem>
#include <map>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_replace.h"
#include "map_store/base/token_file.h"
#include "tests/integration/raw_call.h"
#include "tests/integration/test_server.h"
#include "tests/integration/text_model.h"
#include "tests/support/random_message.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;

// tests/bench/attacker_benchmark makes 10,000, and looks at times.
constexpr int kCalls = 1'500;

// Whoever is attacked: what comes of the frames of a session in which a square
// is marked and followed; at least 40 of them, as long as there are to be more.
std::vector<geometry::Box2> Follow(sdk::Client& client,
                                   const std::string& session,
                                   const std::atomic<bool>& more) {
  std::vector<geometry::Box2> boxes;
  EXPECT_TRUE(client.CreateSession(Spec(session)).ok());
  EXPECT_TRUE(client
                  .SetTarget(session,
                             "square",
                             geometry::Box2::FromXywh(20, 40, 24, 24))
                  .ok());
  auto stream = client.Track(session);
  EXPECT_TRUE(stream.ok()) << stream.status();
  if (!stream.ok()) return boxes;
  for (std::uint64_t i = 0; i < 40 || more; ++i) {
    const int phase = static_cast<int>(i % 40);
    const int x = 20 + (phase < 20 ? phase : 40 - phase);
    EXPECT_TRUE((*stream)->Send(SquareFrame(i, x, 40)).ok());
    const auto reply = (*stream)->Next();
    EXPECT_TRUE(reply.ok() && reply->has_value()) << reply.status();
    if (!reply.ok() || !reply->has_value()) break;
    const auto* result = std::get_if<sdk::FrameResult>(&**reply);
    EXPECT_NE(result, nullptr);
    if (result == nullptr) break;
    EXPECT_EQ(result->sequence, i);
    EXPECT_EQ(result->targets.size(), 1U);
    if (result->targets.empty()) break;
    boxes.push_back(result->targets[0].box_px.value_or(geometry::Box2()));
  }
  return boxes;
}

TEST(ScriptedAttacker, GetsNothingAndHarmsNobody) {
  const auto directory =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path file = directory.path() / "tokens";
  const std::string victim_token =
      *base::CreateToken(file, {"the-victim", "acme", {"admin"}, ""});
  // One in the same tenant, and one in another that may do more.
  const std::string attackers[] = {
      *base::CreateToken(file, {"insider", "acme", {"sessions:own"}, ""}),
      *base::CreateToken(
          file, {"outsider", "rival", {"maps:write", "sessions:all"}, ""})};
  service::ServerOptions options;
  options.token_file = file.string();
  options.client_silence = std::chrono::seconds(30);
  TestServer server(options);
  sdk::ClientOptions client_options;
  client_options.token = victim_token;
  const auto victim = *ConnectTo(server.address(), client_options);
  auto files = TextModel();
  for (auto& [name, text] : files) {
    text = absl::StrReplaceAll(text, {{"image", "secret-view"}});
  }
  ASSERT_TRUE(
      victim->ImportMap(WriteForImport(directory.path(), "yard", files)).ok());
  std::atomic<bool> attacked{false};
  const auto alone = Follow(*victim, "drive-before", attacked);
  attacked = true;
  std::vector<geometry::Box2> boxes;
  std::thread streaming([&] { boxes = Follow(*victim, "drive", attacked); });

  test_support::RandomMessages random(
      1, {"drive", "yard", "square", "acme@yard", "acme@drive", "0"});
  const auto methods = EveryMethod();
  const auto channel = RawChannel(server.address());
  std::map<grpc::StatusCode, int> answers;
  for (int i = 0; i < kCalls; ++i) {
    const auto* method = methods[random.Below(methods.size())];
    const auto request = NewMessage(*method->input_type());
    std::vector<std::string> messages;
    for (std::size_t m = random.Below(4) + 1; m > 0; --m) {
      messages.push_back(random.Bytes(*request));
    }
    const RawAnswer answer = CallRaw(channel,
                                     PathOf(*method),
                                     "Bearer " + attackers[i % 2],
                                     messages,
                                     /*max_answers=*/3,
                                     std::chrono::milliseconds(500));
    ++answers[answer.status.error_code()];
    for (const std::string& message : answer.messages) {
      EXPECT_FALSE(absl::StrContains(message, "secret-view")) << method->name();
      EXPECT_FALSE(absl::StrContains(message, "the-victim")) << method->name();
    }
    EXPECT_FALSE(
        absl::StrContains(answer.status.error_message(), "the-victim"));
  }
  attacked = false;
  streaming.join();
  // The calls got somewhere: into what checks fields, and into what does not
  // find what it is asked for.
  EXPECT_GT(answers[grpc::StatusCode::INVALID_ARGUMENT], kCalls / 50);
  EXPECT_GT(answers[grpc::StatusCode::NOT_FOUND], kCalls / 50);
  EXPECT_GT(answers[grpc::StatusCode::PERMISSION_DENIED], kCalls / 50);
  EXPECT_EQ(answers[grpc::StatusCode::UNAVAILABLE], 0);
  EXPECT_EQ(answers[grpc::StatusCode::UNAUTHENTICATED], 0);
  // What was tracked is what would have been without them.
  ASSERT_GE(boxes.size(), alone.size());
  for (std::size_t i = 0; i < alone.size(); ++i) {
    EXPECT_EQ(boxes[i].x(), alone[i].x()) << i;
    EXPECT_EQ(boxes[i].y(), alone[i].y()) << i;
  }
  EXPECT_EQ(victim->GetMap("yard", 0)->version, 1U);
  EXPECT_EQ(victim->ListMaps()->size(), 1U);
  EXPECT_TRUE(victim->GetSession("drive").ok());
  EXPECT_TRUE(victim->GetSession("drive-before").ok());
}

}  // namespace
}  // namespace groundlock::test
