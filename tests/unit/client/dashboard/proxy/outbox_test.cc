// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/outbox.h"

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

namespace groundlock::dashboard {
namespace {

Buffer Text(const std::string& text) {
  return std::make_shared<const std::string>(text);
}

std::shared_ptr<const FrameBuffers> Frame(const std::string& session,
                                          std::uint64_t sequence,
                                          std::uint64_t skipped = 0) {
  auto frame = std::make_shared<FrameBuffers>();
  frame->session_id = session;
  frame->sequence = sequence;
  auto update = std::make_shared<pb::ServerMessage>();
  update->mutable_frame_update()->set_session_id(session);
  update->mutable_frame_update()->mutable_result()->set_sequence(sequence);
  update->mutable_frame_update()->set_skipped(skipped);
  frame->update_bytes = Encode(*update);
  frame->update = std::move(update);
  frame->image_bytes = Text(session + std::to_string(sequence));
  return frame;
}

pb::FrameUpdate Update(const Buffer& bytes) {
  pb::ServerMessage message;
  EXPECT_TRUE(message.ParseFromString(*bytes));
  return message.frame_update();
}

TEST(Outbox, RepliesGoFirstThenResultsThenImages) {
  Outbox outbox(10, 10);
  outbox.AddFrame(Frame("s", 1), true);
  ASSERT_TRUE(outbox.AddReply(Text("reply")));
  EXPECT_EQ(*outbox.Next(), "reply");
  EXPECT_EQ(Update(outbox.Next()).result().sequence(), 1U);
  EXPECT_EQ(*outbox.Next(), "s1");
  EXPECT_EQ(outbox.Next(), nullptr);
}

TEST(Outbox, ASlowViewerGetsAllResultsAndTheNewestImage) {
  Outbox outbox(10, 100);
  for (std::uint64_t i = 0; i < 50; ++i) outbox.AddFrame(Frame("s", i), true);
  for (std::uint64_t i = 0; i < 50; ++i) {
    EXPECT_EQ(Update(outbox.Next()).result().sequence(), i);
  }
  EXPECT_EQ(*outbox.Next(), "s49");
  EXPECT_EQ(outbox.Next(), nullptr);
  EXPECT_EQ(outbox.images_left_out(), 49U);
}

TEST(Outbox, ResultsThatFindNoRoomAreCounted) {
  Outbox outbox(10, 3);
  // The server has left out 2 before frame 1.
  for (std::uint64_t i = 0; i < 6; ++i) {
    outbox.AddFrame(Frame("s", i, i == 1 ? 2 : 0), false);
  }
  const pb::FrameUpdate first = Update(outbox.Next());
  EXPECT_EQ(first.result().sequence(), 3U);
  EXPECT_EQ(first.skipped(), 3U + 2U);
  EXPECT_EQ(Update(outbox.Next()).skipped(), 0U);
  EXPECT_EQ(outbox.results_left_out(), 3U);
}

TEST(Outbox, WhatASessionLosesIsToldInThatSession) {
  Outbox outbox(10, 2);
  outbox.AddFrame(Frame("a", 0), false);
  outbox.AddFrame(Frame("b", 0), false);
  outbox.AddFrame(Frame("a", 1), false);  // pushes out a's first
  EXPECT_EQ(Update(outbox.Next()).session_id(), "b");
  const pb::FrameUpdate update = Update(outbox.Next());
  EXPECT_EQ(update.session_id(), "a");
  EXPECT_EQ(update.skipped(), 1U);
}

TEST(Outbox, LongAnswersTakeTurnsWithImages) {
  Outbox outbox(10, 10);
  ASSERT_TRUE(outbox.AddParts({Text("p0"), Text("p1")}));
  ASSERT_TRUE(outbox.AddParts({Text("q0")}));
  outbox.AddFrame(Frame("s", 1), true);
  EXPECT_EQ(Update(outbox.Next()).result().sequence(), 1U);
  EXPECT_EQ(*outbox.Next(), "p0");
  EXPECT_EQ(*outbox.Next(), "s1");
  EXPECT_EQ(*outbox.Next(), "p1");
  EXPECT_EQ(*outbox.Next(), "q0");
  EXPECT_EQ(outbox.Next(), nullptr);
}

TEST(Outbox, SessionsImagesTakeTurns) {
  Outbox outbox(10, 10);
  outbox.AddFrame(Frame("a", 1), true);
  outbox.AddFrame(Frame("b", 1), true);
  outbox.Next();
  outbox.Next();
  EXPECT_EQ(*outbox.Next(), "a1");
  outbox.AddFrame(Frame("a", 2), true);
  outbox.Next();
  EXPECT_EQ(*outbox.Next(), "b1");
  EXPECT_EQ(*outbox.Next(), "a2");
}

TEST(Outbox, ImagesWaitForThoseThatTheViewerHasNotTaken) {
  Outbox outbox(10, 100);
  outbox.SetImageWindow("s", 2);
  for (std::uint64_t i = 0; i < 2; ++i) {
    outbox.AddFrame(Frame("s", i), true);
    outbox.Next();
    EXPECT_EQ(*outbox.Next(), "s" + std::to_string(i));
  }
  for (std::uint64_t i = 2; i < 5; ++i) {
    outbox.AddFrame(Frame("s", i), true);
    EXPECT_EQ(Update(outbox.Next()).result().sequence(), i) << "results go on";
    EXPECT_EQ(outbox.Next(), nullptr) << "two are on their way";
  }
  outbox.AddFrame(Frame("t", 7), true);
  outbox.Next();
  EXPECT_EQ(*outbox.Next(), "t7") << "another session has its own";
  EXPECT_FALSE(outbox.ImageTaken("s", 9)) << "was never sent";
  EXPECT_FALSE(outbox.ImageTaken("nobody", 0));
  EXPECT_EQ(outbox.Next(), nullptr);
  EXPECT_TRUE(outbox.ImageTaken("s", 1)) << "and 0 with it";
  EXPECT_EQ(*outbox.Next(), "s4") << "the newest";
  EXPECT_EQ(outbox.Next(), nullptr);
  // A source that starts anew.
  outbox.AddFrame(Frame("s", 0), true);
  outbox.Next();
  EXPECT_EQ(*outbox.Next(), "s0");
  EXPECT_TRUE(outbox.ImageTaken("s", 4));
  outbox.AddFrame(Frame("s", 1), true);
  outbox.Next();
  EXPECT_EQ(*outbox.Next(), "s1");
  outbox.AddFrame(Frame("s", 2), true);
  outbox.Next();
  EXPECT_EQ(outbox.Next(), nullptr);
  outbox.SetImageWindow("s", 0);
  EXPECT_EQ(*outbox.Next(), "s2");
}

TEST(Outbox, ResultsThatWaitKeepNoImages) {
  Outbox outbox(10, 100);
  std::vector<std::weak_ptr<const std::string>> images;
  for (std::uint64_t i = 0; i < 5; ++i) {
    const auto frame = Frame("s", i);
    images.push_back(frame->image_bytes);
    outbox.AddFrame(frame, true);
  }
  for (std::size_t i = 0; i < 4; ++i) EXPECT_TRUE(images[i].expired()) << i;
  EXPECT_FALSE(images[4].expired()) << "the newest waits itself";
}

TEST(Outbox, WhoDoesNotListenIsFoundOut) {
  Outbox outbox(2, 10);
  EXPECT_TRUE(outbox.AddReply(Text("1")));
  EXPECT_TRUE(outbox.AddReply(Text("2")));
  EXPECT_FALSE(outbox.AddReply(Text("3")));
  bool room = true;
  for (int i = 0; i < 100 && room; ++i) room = outbox.AddParts({Text("p")});
  EXPECT_FALSE(room);
}

TEST(Outbox, ForgetsASession) {
  Outbox outbox(10, 10);
  outbox.AddFrame(Frame("a", 1), true);
  outbox.AddFrame(Frame("b", 2), false);
  outbox.Forget("a");
  EXPECT_EQ(Update(outbox.Next()).session_id(), "b");
  EXPECT_EQ(outbox.Next(), nullptr);
}

}  // namespace
}  // namespace groundlock::dashboard
