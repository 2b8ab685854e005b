// SPDX-License-Identifier: Apache-2.0
#include "server/service/session.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <stdexcept>
#include <thread>

#include "map_store/base/mutex.h"

namespace groundlock::service {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

// absl::Notification, but seen by the thread sanitizer.
class Event {
 public:
  void Notify() {
    base::MutexLock lock(&mutex_);
    happened_ = true;
  }
  void WaitForNotification() {
    base::MutexLock lock(&mutex_);
    mutex_.Await([this] { return happened_; });
  }

 private:
  base::Mutex mutex_;
  bool happened_ = false;
};

// Does what a test tells it to; records the frames that it sees.
class FakeCore final : public tracking::TrackingSession {
 public:
  using OnFrame = std::function<absl::Status(std::uint64_t sequence)>;
  FakeCore(OnFrame on_frame,
           std::vector<std::uint64_t>* seen,
           std::vector<std::uint64_t>* hurried,
           std::vector<std::int64_t>* inertial_ns)
      : on_frame_(std::move(on_frame)),
        seen_(seen),
        hurried_(hurried),
        inertial_ns_(inertial_ns) {}

  absl::Status SetTarget(const std::string& id,
                         const geometry::Box2& /*box_px*/,
                         std::optional<std::uint64_t> /*at*/,
                         const tracking::TargetBody& /*body*/) override {
    ids_.push_back(id);
    return absl::OkStatus();
  }
  absl::Status MoveTarget(const std::string& id,
                          const geometry::Box2& /*box_px*/) override {
    return absl::NotFoundError(id);
  }
  absl::Status DropTarget(const std::string& /*id*/) override {
    throw std::runtime_error("from a library");
  }
  std::vector<std::string> TargetIds() const override { return ids_; }
  void SetHurried(bool hurried) override { is_hurried_ = hurried; }
  absl::StatusOr<tracking::FrameResult> ProcessFrame(
      const image::Frame& frame,
      const std::optional<geometry::CameraModel>& /*camera*/,
      const tracking::SensorReadings& sensors,
      std::vector<absl::Status>* target_errors) override {
    seen_->push_back(frame.sequence);
    for (const auto& sample : sensors.inertial) {
      inertial_ns_->push_back(sample.time.count());
    }
    if (is_hurried_) hurried_->push_back(frame.sequence);
    if (absl::Status status = on_frame_(frame.sequence); !status.ok()) {
      return status;
    }
    target_errors->push_back(
        absl::InvalidArgumentError("target 'x': box outside the image"));
    return tracking::FrameResult();
  }

 private:
  const OnFrame on_frame_;
  std::vector<std::uint64_t>* const seen_;
  std::vector<std::uint64_t>* const hurried_;
  std::vector<std::int64_t>* const inertial_ns_;
  bool is_hurried_ = false;
  std::vector<std::string> ids_;
};

// A stream that takes answers as soon as they are there.
class FakeSink final : public FrameSink {
 public:
  void OnAnswers() override {
    base::MutexLock lock(&mutex_);
    ++news_;
  }
  void OnRoom() override {
    base::MutexLock lock(&mutex_);
    ++rooms_;
  }
  void OnEnd(const absl::Status& reason, bool drain) override {
    base::MutexLock lock(&mutex_);
    end_ = reason;
    drain_ = drain;
  }
  void WaitForRoom(int count) {
    base::MutexLock lock(&mutex_);
    mutex_.Await([&] { return rooms_ >= count; });
  }
  // Takes answers until there are `count` of them.
  std::vector<std::shared_ptr<const Answer>> Take(Session& session,
                                                  std::size_t count) {
    std::vector<std::shared_ptr<const Answer>> answers;
    while (answers.size() < count) {
      int before = 0;
      {
        base::MutexLock lock(&mutex_);
        before = news_;
      }
      while (auto answer = session.NextAnswer(this)) answers.push_back(answer);
      if (answers.size() >= count) break;
      base::MutexLock lock(&mutex_);
      mutex_.AwaitFor(std::chrono::seconds(1), [&] { return news_ != before; });
    }
    return answers;
  }
  absl::Status end() {
    base::MutexLock lock(&mutex_);
    return end_;
  }

 private:
  base::Mutex mutex_;
  int news_ = 0;
  int rooms_ = 0;
  absl::Status end_;
  bool drain_ = false;
};

FrameJob Job(std::uint64_t sequence) {
  FrameJob job;
  job.sequence = sequence;
  job.encoding = image::Encoding::kRawGray8;
  job.bytes = "0123";
  job.width_px = 2;
  job.height_px = 2;
  job.received = std::chrono::steady_clock::now();
  return job;
}

std::vector<std::uint64_t> Sequences(
    const std::vector<std::shared_ptr<const Answer>>& answers) {
  std::vector<std::uint64_t> sequences;
  for (const auto& answer : answers) sequences.push_back(answer->sequence);
  return sequences;
}

class SessionTest : public ::testing::Test {
 protected:
  std::shared_ptr<Session> Make(FakeCore::OnFrame on_frame, bool live = false) {
    SessionSpec spec;
    spec.id = "s";
    spec.live = live;
    return Session::Create(
        spec,
        nullptr,
        std::make_unique<FakeCore>(
            std::move(on_frame), &seen_, &hurried_, &inertial_ns_),
        limits_,
        &pool_,
        &metrics_,
        memory_);
  }
  static absl::Status Fine(std::uint64_t /*sequence*/) {
    return absl::OkStatus();
  }

  SessionLimits limits_;
  std::shared_ptr<FrameMemory::Share> memory_;  // null = as much as they want
  Metrics metrics_;
  std::vector<std::uint64_t> seen_;        // the strand's, then ours
  std::vector<std::uint64_t> hurried_;     // those of them that came late
  std::vector<std::int64_t> inertial_ns_;  // of all frames seen
  WorkerPool pool_{2};
};

TEST_F(SessionTest, EveryFrameIsAnsweredOnceAndInOrder) {
  limits_.lossless_queue_frames = 2;
  limits_.max_unread_answers = 1'000;  // the test does not wait for these
  limits_.kept_answers = 2'000;
  const auto session = Make(Fine);
  const auto sink = std::make_shared<FakeSink>();
  EXPECT_EQ(*session->Attach(sink, std::nullopt), 0U);
  std::thread sender([&] {
    int rooms = 0;
    for (std::uint64_t k = 0; k < 300; ++k) {
      FrameJob job = Job(k);
      for (;;) {
        const auto accepted = session->Offer(sink.get(), job);
        ASSERT_TRUE(accepted.ok()) << accepted.status();
        if (*accepted) break;
        sink->WaitForRoom(++rooms);
      }
    }
  });
  const auto answers = sink->Take(*session, 300);
  sender.join();
  for (std::uint64_t k = 0; k < 300; ++k) {
    ASSERT_EQ(answers[k]->sequence, k);
    ASSERT_TRUE(std::holds_alternative<FrameOutcome>(answers[k]->content));
  }
  EXPECT_TRUE(session->Drained(sink.get()));
  EXPECT_EQ(session->Describe().frames_processed, 300U);
}

TEST_F(SessionTest, LiveDropsTheOldestWaitingFrames) {
  limits_.live_queue_frames = 1;
  Event started;
  Event go;
  const auto session = Make(
      [&](std::uint64_t sequence) {
        if (sequence == 0) {
          started.Notify();
          go.WaitForNotification();
        }
        return absl::OkStatus();
      },
      /*live=*/true);
  const auto sink = std::make_shared<FakeSink>();
  ASSERT_TRUE(session->Attach(sink, std::nullopt).ok());
  FrameJob first = Job(0);
  ASSERT_TRUE(*session->Offer(sink.get(), first));
  started.WaitForNotification();
  for (std::uint64_t k = 1; k < 5; ++k) {
    FrameJob job = Job(k);
    // The last ones were sent before.
    job.sensors.inertial = {{std::chrono::nanoseconds(10 * k), {}, {}},
                            {std::chrono::nanoseconds(10 * k + 5), {}, {}},
                            {std::chrono::nanoseconds(10 * k + 10), {}, {}}};
    ASSERT_TRUE(*session->Offer(sink.get(), job));
  }
  EXPECT_EQ(session->NextAnswer(sink.get()), nullptr)
      << "no answer overtakes that of the frame in work";
  go.Notify();
  const auto answers = sink->Take(*session, 5);
  EXPECT_THAT(Sequences(answers), ElementsAre(0, 1, 2, 3, 4));
  EXPECT_EQ(std::get<DropReason>(answers[1]->content), DropReason::kOverload);
  EXPECT_THAT(seen_, ElementsAre(0, 4));
  // How the camera turned on the way is known all the same.
  EXPECT_THAT(inertial_ns_, ElementsAre(10, 15, 20, 25, 30, 35, 40, 45, 50));
}

TEST_F(SessionTest, LiveFramesThatWaitedAreHurriedAndSomeAfterThem) {
  constexpr std::uint64_t kFrames = 12;
  for (const bool live : {true, false}) {
    const auto session = Make(Fine, live);
    const auto sink = std::make_shared<FakeSink>();
    ASSERT_TRUE(session->Attach(sink, std::nullopt).ok());
    for (std::uint64_t k = 0; k < kFrames; ++k) {
      FrameJob job = Job(k);
      // Frames 1 and 2 waited for a second; the others are said to come from
      // the future, so that a slow machine does not make them late.
      const auto away = std::chrono::hours(k == 1 || k == 2 ? 0 : 1);
      job.received += away - std::chrono::seconds(1);
      ASSERT_TRUE(*session->Offer(sink.get(), job));
      sink->Take(*session, 1);
    }
  }
  EXPECT_EQ(seen_.size(), 2 * kFrames);
  EXPECT_THAT(hurried_, ElementsAre(1, 2, 3, 4, 5, 6, 7, 8));
}

TEST_F(SessionTest, AnswersAreKeptAndSentAgain) {
  const auto session = Make(Fine);
  const auto first = std::make_shared<FakeSink>();
  ASSERT_TRUE(session->Attach(first, std::nullopt).ok());
  for (std::uint64_t k = 0; k < 6; ++k) {
    FrameJob job = Job(2 * k);
    ASSERT_TRUE(*session->Offer(first.get(), job));
  }
  ASSERT_EQ(first->Take(*session, 6).size(), 6U);
  const auto second = std::make_shared<FakeSink>();
  EXPECT_EQ(*session->Attach(second, 5), 11U);
  EXPECT_TRUE(absl::IsAborted(first->end()));
  EXPECT_THAT(Sequences(second->Take(*session, 3)), ElementsAre(6, 8, 10));
  EXPECT_EQ(session->NextAnswer(first.get()), nullptr);
  FrameJob late = Job(20);
  EXPECT_TRUE(absl::IsAborted(session->Offer(first.get(), late).status()));
  // Without a wish: what has not been taken yet, and that is nothing.
  const auto third = std::make_shared<FakeSink>();
  ASSERT_TRUE(session->Attach(third, std::nullopt).ok());
  EXPECT_EQ(session->NextAnswer(third.get()), nullptr);
}

TEST_F(SessionTest, AClientThatDoesNotReadIsHeldBack) {
  limits_.max_unread_answers = 4;
  const auto session = Make(Fine);
  const auto sink = std::make_shared<FakeSink>();
  ASSERT_TRUE(session->Attach(sink, std::nullopt).ok());
  for (std::uint64_t k = 0; k < 4; ++k) {
    FrameJob job = Job(k);
    ASSERT_TRUE(*session->Offer(sink.get(), job));
  }
  FrameJob job = Job(4);
  EXPECT_FALSE(*session->Offer(sink.get(), job));
  EXPECT_EQ(job.bytes, "0123") << "a frame that is not taken stays whole";
  ASSERT_EQ(sink->Take(*session, 4).size(), 4U);
  EXPECT_TRUE(*session->Offer(sink.get(), job));
}

// Frames that are done are counted out of the queue with all that came with
// them.
TEST_F(SessionTest, FramesWithSensorsTakeNoRoomFromLaterOnes) {
  limits_.max_queued_bytes = 1'000;
  Event started;
  Event go;
  const auto session = Make([&](std::uint64_t sequence) {
    if (sequence == 10) {
      started.Notify();
      go.WaitForNotification();
    }
    return absl::OkStatus();
  });
  const auto sink = std::make_shared<FakeSink>();
  ASSERT_TRUE(session->Attach(sink, std::nullopt).ok());
  for (std::uint64_t k = 0; k < 10; ++k) {
    FrameJob job = Job(k);
    for (int i = 0; i < 5; ++i) {
      job.sensors.inertial.push_back(
          {std::chrono::nanoseconds(10 * k + i), {}, {}});
    }
    ASSERT_TRUE(*session->Offer(sink.get(), job));
    sink->Take(*session, 1);
  }
  FrameJob in_work = Job(10);
  ASSERT_TRUE(*session->Offer(sink.get(), in_work));
  started.WaitForNotification();
  for (std::uint64_t k = 11; k < 15; ++k) {
    FrameJob job = Job(k);
    EXPECT_TRUE(*session->Offer(sink.get(), job)) << k;
  }
  go.Notify();
  EXPECT_EQ(sink->Take(*session, 5).size(), 5U);
}

TEST_F(SessionTest, HoldsNoMoreThanItMayAndLittleWhereMemoryIsScarce) {
  Event started;
  Event go;
  const auto memory = FrameMemory::Create(/*bytes=*/80, /*max_sessions=*/10);
  memory_ = memory->NewShare();
  const auto session = Make([&](std::uint64_t sequence) {
    if (sequence == 0) {
      started.Notify();
      go.WaitForNotification();
    }
    return absl::OkStatus();
  });
  const auto sink = std::make_shared<FakeSink>();
  ASSERT_TRUE(session->Attach(sink, std::nullopt).ok());
  const auto offer = [&](std::uint64_t sequence) {
    FrameJob job = Job(sequence);
    EXPECT_TRUE(session->Hold(job).ok());
    return *session->Offer(sink.get(), job);
  };
  EXPECT_TRUE(offer(0));
  started.WaitForNotification();
  EXPECT_TRUE(offer(1));
  EXPECT_TRUE(offer(2));
  auto others = memory->TakeCommon(25);
  ASSERT_NE(others, nullptr);
  EXPECT_FALSE(offer(3)) << "one may wait, and more do";
  FrameJob large = Job(3);
  large.bytes = std::string(60, ' ');
  EXPECT_TRUE(absl::IsResourceExhausted(session->Hold(large)));
  EXPECT_EQ(session->HoldForWatcher(60), nullptr);
  go.Notify();
  EXPECT_EQ(sink->Take(*session, 3).size(), 3U);
  others = nullptr;
  // What was held goes with its frame.
  while (memory->TakeCommon(40) == nullptr) std::this_thread::yield();
}

TEST_F(SessionTest, FailuresAreAnswersToo) {
  const auto session = Make([](std::uint64_t sequence) -> absl::Status {
    if (sequence == 1) throw std::runtime_error("from a library");
    if (sequence == 2) return absl::InvalidArgumentError("time runs backwards");
    return absl::OkStatus();
  });
  const auto sink = std::make_shared<FakeSink>();
  ASSERT_TRUE(session->Attach(sink, std::nullopt).ok());
  for (std::uint64_t k = 0; k < 4; ++k) {
    FrameJob job = Job(k);
    if (k == 3) job.bytes = "012";
    ASSERT_TRUE(*session->Offer(sink.get(), job));
  }
  const auto answers = sink->Take(*session, 4);
  const auto& outcome = std::get<FrameOutcome>(answers[0]->content);
  ASSERT_EQ(outcome.target_faults.size(), 1U);
  EXPECT_EQ(outcome.target_faults[0].target_id, "x");
  EXPECT_EQ(outcome.target_faults[0].message, "box outside the image");
  EXPECT_THAT(std::get<absl::Status>(answers[1]->content).ToString(),
              HasSubstr("frame 1: from a library"));
  EXPECT_THAT(std::get<absl::Status>(answers[2]->content).ToString(),
              HasSubstr("frame 2: time runs backwards"));
  EXPECT_TRUE(
      absl::IsInvalidArgument(std::get<absl::Status>(answers[3]->content)));
  FrameJob again = Job(3);
  EXPECT_THAT(session->Offer(sink.get(), again).status().ToString(),
              HasSubstr("frame.sequence: 3 is not above 3"));
  EXPECT_EQ(session->Describe().frames_failed, 3U);
}

TEST_F(SessionTest, TargetsAreSetOnTheStrand) {
  const auto session = Make(Fine);
  const auto run = [&](auto operation) {
    Event over;
    absl::Status status;
    operation([&](const absl::Status& result) {
      status = result;
      over.Notify();
    });
    over.WaitForNotification();
    return status;
  };
  const auto box = geometry::Box2::FromXywh(0, 0, 1, 1);
  EXPECT_TRUE(run([&](Session::Done done) {
                session->SetTarget("t", box, 5, {}, std::move(done));
              }).ok());
  EXPECT_THAT(session->Describe().target_ids, ElementsAre("t"));
  EXPECT_TRUE(absl::IsNotFound(run([&](Session::Done done) {
    session->MoveTarget("u", box, std::move(done));
  })));
  EXPECT_TRUE(absl::IsInternal(run(
      [&](Session::Done done) { session->DropTarget("t", std::move(done)); })));
  const auto sink = std::make_shared<FakeSink>();
  ASSERT_TRUE(session->Attach(sink, std::nullopt).ok());
  FrameJob job = Job(5);
  ASSERT_TRUE(*session->Offer(sink.get(), job));
  sink->Take(*session, 1);
  EXPECT_TRUE(absl::IsFailedPrecondition(run([&](Session::Done done) {
    session->SetTarget("t", box, 5, {}, std::move(done));
  })));
  session->Close(absl::NotFoundError("deleted"));
  EXPECT_TRUE(absl::IsNotFound(run([&](Session::Done done) {
    session->SetTarget("t", box, 9, {}, std::move(done));
  })));
  EXPECT_TRUE(absl::IsNotFound(sink->end()));
}

// Whoever waits for a target operation hears of it once, however the session
// ends while a frame is in work.
TEST_F(SessionTest, EveryTargetOperationIsAnsweredOnceInEveryEnding) {
  enum class Ending { kClose, kDrain, kDrainThenClose, kLetGo };
  for (const Ending ending : {Ending::kClose,
                              Ending::kDrain,
                              Ending::kDrainThenClose,
                              Ending::kLetGo}) {
    for (int round = 0; round < 20; ++round) {
      // The worker's as well: that the session has gone, seen below, hands
      // nothing over.
      const auto started = std::make_shared<Event>();
      const auto go = std::make_shared<Event>();
      auto session = Make([started, go](std::uint64_t) {
        started->Notify();
        go->WaitForNotification();
        return absl::OkStatus();
      });
      const auto sink = std::make_shared<FakeSink>();
      ASSERT_TRUE(session->Attach(sink, std::nullopt).ok());
      FrameJob job = Job(0);
      ASSERT_TRUE(*session->Offer(sink.get(), job));
      started->WaitForNotification();
      constexpr int kOperations = 3;
      std::atomic<int> answers{0};
      std::atomic<int> refusals{0};
      const auto done = [&](const absl::Status& status) {
        if (!status.ok()) ++refusals;
        ++answers;
      };
      const auto box = geometry::Box2::FromXywh(0, 0, 1, 1);
      session->SetTarget("t", box, std::nullopt, {}, done);
      session->SetTarget("u", box, 7, {}, done);
      session->MoveTarget("t", box, done);
      if (ending == Ending::kLetGo) {
        session = nullptr;
      } else {
        if (ending != Ending::kClose) session->Drain();
        if (ending != Ending::kDrain) {
          session->Close(absl::NotFoundError("deleted"));
        }
        EXPECT_EQ(answers, kOperations) << "while the frame is in work";
      }
      go->Notify();
      while (answers < kOperations) std::this_thread::yield();
      const std::weak_ptr<Session> left = std::exchange(session, nullptr);
      // Until the worker has let the session go, which might answer again.
      while (!left.expired()) std::this_thread::yield();
      EXPECT_EQ(answers, kOperations);
      EXPECT_EQ(refusals, kOperations);
    }
  }
}

// Operations that come while the session ends: run, or refused, but answered.
TEST_F(SessionTest, OperationsThatMeetTheEndAreAnsweredToo) {
  for (int round = 0; round < 200; ++round) {
    const auto session = Make(Fine);
    std::atomic<int> answers{0};
    constexpr int kOperations = 50;
    std::thread client([&] {
      for (int i = 0; i < kOperations; ++i) {
        session->SetTarget("t",
                           geometry::Box2::FromXywh(0, 0, 1, 1),
                           std::nullopt,
                           {},
                           [&](const absl::Status&) { ++answers; });
      }
    });
    if (round % 2 == 0) session->Drain();
    session->Close(absl::NotFoundError("deleted"));
    client.join();
    while (answers < kOperations) std::this_thread::yield();
    EXPECT_EQ(answers, kOperations);
  }
}

TEST_F(SessionTest, DrainingAnswersWhatWaits) {
  Event started;
  Event go;
  const auto session = Make([&](std::uint64_t) {
    started.Notify();
    go.WaitForNotification();
    return absl::OkStatus();
  });
  const auto sink = std::make_shared<FakeSink>();
  ASSERT_TRUE(session->Attach(sink, std::nullopt).ok());
  for (std::uint64_t k = 0; k < 3; ++k) {
    FrameJob job = Job(k);
    ASSERT_TRUE(*session->Offer(sink.get(), job));
    if (k == 0) started.WaitForNotification();
  }
  session->Drain();
  EXPECT_TRUE(absl::IsUnavailable(sink->end()));
  FrameJob late = Job(9);
  EXPECT_TRUE(absl::IsUnavailable(session->Offer(sink.get(), late).status()));
  EXPECT_FALSE(session->Drained(sink.get()));
  go.Notify();
  const auto answers = sink->Take(*session, 3);
  EXPECT_TRUE(std::holds_alternative<FrameOutcome>(answers[0]->content));
  EXPECT_EQ(std::get<DropReason>(answers[1]->content), DropReason::kShutdown);
  EXPECT_EQ(std::get<DropReason>(answers[2]->content), DropReason::kShutdown);
  EXPECT_TRUE(session->Drained(sink.get()));
}

}  // namespace
}  // namespace groundlock::service
