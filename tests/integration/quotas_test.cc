// SPDX-License-Identifier: Apache-2.0
// How much each caller may use, and that it is refused with the quota's name.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <string>
#include <variant>

#include "groundlock/v1/maps.grpc.pb.h"
#include "map_store/base/token_file.h"
#include "tests/integration/raw_call.h"
#include "tests/integration/test_server.h"
#include "tests/integration/text_model.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class QuotasTest : public ::testing::Test {
 protected:
  void Add(const std::string& name, const base::Quotas& quotas) {
    tokens_[name] =
        *base::CreateToken(file_, {name, "", {"admin"}, "", quotas});
  }
  std::unique_ptr<sdk::Client> Connect(const std::string& name) {
    if (server_ == nullptr) {
      service::ServerOptions options;
      options.token_file = file_.string();
      options.maps.max_concurrent_builds = 4;
      server_ = std::make_unique<TestServer>(options);
    }
    sdk::ClientOptions options;
    options.token = tokens_.at(name);
    return *ConnectTo(server_->address(), options);
  }
  void ExpectOver(const absl::Status& status, const std::string& quota) {
    EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted) << status;
    EXPECT_THAT(status.ToString(), HasSubstr("quota " + quota));
    EXPECT_EQ(server_->metrics().over_quota, ++refused_);
  }

  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path file_ = directory_.path() / "tokens";
  std::map<std::string, std::string> tokens_;
  std::unique_ptr<TestServer> server_;
  std::uint64_t refused_ = 0;
};

TEST_F(QuotasTest, SessionsAreCountedPerOwner) {
  base::Quotas two;
  two.sessions = 2;
  Add("few", two);
  Add("many", {});
  const auto few = Connect("few");
  const auto many = Connect("many");
  ASSERT_TRUE(few->CreateSession(Spec("a")).ok());
  ASSERT_TRUE(few->CreateSession(Spec("b")).ok());
  for (const char* id : {"x", "y", "z"}) {
    EXPECT_TRUE(many->CreateSession(Spec(id)).ok());
  }
  ExpectOver(few->CreateSession(Spec("c")).status(), "sessions");
  // What fails takes no room, and what ends gives it back, whoever ends it.
  EXPECT_TRUE(many->DeleteSession("a").ok());
  EXPECT_EQ(few->CreateSession(Spec("b")).status().code(),
            absl::StatusCode::kAlreadyExists);
  EXPECT_TRUE(few->CreateSession(Spec("c")).ok());
  ExpectOver(few->CreateSession(Spec("d")).status(), "sessions");
  // One who may have more from now on need not come again.
  std::string text = *base::ReadFile(file_, 1 << 20);
  text.replace(text.find("sessions=2"), 10, "sessions=3");
  // Another file in its place: one that is being written is half a file.
  const fs::path next = file_.string() + ".next";
  std::ofstream(next) << text;
  fs::permissions(next, fs::perms::owner_read | fs::perms::owner_write);
  fs::rename(next, file_);
  EXPECT_TRUE(Eventually([&] {
    const absl::Status made = few->CreateSession(Spec("d")).status();
    if (!made.ok()) {
      EXPECT_EQ(made.code(), absl::StatusCode::kResourceExhausted) << made;
      ++refused_;
    }
    return made.ok();
  }));
  ExpectOver(few->CreateSession(Spec("e")).status(), "sessions");
}

TEST_F(QuotasTest, FramesBeyondTheRateAreAnsweredSo) {
  base::Quotas slow;
  slow.frames_per_s = 5;
  Add("slow", slow);
  const auto client = Connect("slow");
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok()) << stream.status();
  constexpr int kFrames = 60;
  int tracked = 0;
  int refused = 0;
  const auto begin = std::chrono::steady_clock::now();
  for (std::uint64_t i = 0; i < kFrames; ++i) {
    ASSERT_TRUE((*stream)->Send(SquareFrame(i, 40, 40)).ok());
    const auto reply = (*stream)->Next();
    ASSERT_TRUE(reply.ok() && reply->has_value()) << reply.status();
    if (const auto* error = std::get_if<sdk::FrameError>(&**reply)) {
      EXPECT_EQ(error->sequence, i);
      EXPECT_EQ(error->status.code(), absl::StatusCode::kResourceExhausted);
      EXPECT_THAT(error->status.ToString(), HasSubstr("quota frames-per-s: "));
      ++refused;
    } else {
      ++tracked;
    }
  }
  const std::chrono::duration<double> took =
      std::chrono::steady_clock::now() - begin;
  EXPECT_EQ(tracked + refused, kFrames);
  EXPECT_GE(tracked, 5) << "a second's worth at once";
  EXPECT_LE(tracked, 5 + 5 * took.count() + 1);
  EXPECT_EQ(server_->metrics().over_quota, static_cast<unsigned>(refused));
}

TEST_F(QuotasTest, UploadsAreHeldBackNotRefused) {
  base::Quotas thin;
  thin.bytes_per_s = 10'000;
  Add("thin", thin);
  const auto client = Connect("thin");
  const auto request = WriteForImport(directory_.path(), "yard", TextModel());
  std::uint64_t bytes = 0;
  for (const auto& file : request.files) bytes += fs::file_size(file.path);
  ASSERT_GT(bytes, 3 * thin.bytes_per_s) << "or this shows nothing";
  const auto begin = std::chrono::steady_clock::now();
  const auto imported = client->ImportMap(request);
  ASSERT_TRUE(imported.ok()) << imported.status();
  const std::chrono::duration<double> took =
      std::chrono::steady_clock::now() - begin;
  // The first second's worth, and the last chunk, need not be waited for.
  EXPECT_GT(took.count(), 0.5);
  EXPECT_EQ(server_->metrics().over_quota, 0U);
}

TEST_F(QuotasTest, StoredBytesAreTheTenants) {
  base::Quotas little;
  little.stored_bytes = 1;
  Add("little", little);
  Add("other", {});
  const auto client = Connect("little");
  const auto request = WriteForImport(directory_.path(), "yard", TextModel());
  ASSERT_TRUE(client->ImportMap(request).ok());
  ExpectOver(client->ImportMap(request).status(), "stored-bytes");
  // Before it has sent a file.
  const auto stub = v1::MapService::NewStub(RawChannel(server_->address()));
  grpc::ClientContext context;
  context.AddMetadata("authorization", "Bearer " + tokens_["little"]);
  v1::ImportMapResponse response;
  const auto import = stub->ImportMap(&context, &response);
  v1::ImportMapRequest header;
  header.mutable_header()->set_name("yard");
  ASSERT_TRUE(import->Write(header));
  EXPECT_THAT(import->Finish().error_message(), HasSubstr("quota stored-"));
  ++refused_;
  EXPECT_TRUE(Connect("other")->ImportMap(request).ok());
  ASSERT_TRUE(client->DeleteMap("yard").ok());
  EXPECT_TRUE(client->ImportMap(request).ok());
}

TEST_F(QuotasTest, BuildsAreCountedFromTheirFirstByteOn) {
  base::Quotas one;
  one.builds = 1;
  Add("one", one);
  Connect("one");
  const auto stub = v1::MapService::NewStub(RawChannel(server_->address()));
  const auto begin = [&](grpc::ClientContext* context) {
    context->AddMetadata("authorization", "Bearer " + tokens_["one"]);
    return stub->BuildMap(context);
  };
  grpc::ClientContext first_context;
  const auto first = begin(&first_context);
  v1::BuildMapRequest header;
  header.mutable_header()->set_name("yard");
  ASSERT_TRUE(first->Write(header));
  // It has its place before what it sends has one; a second build that comes
  // before it would take the place, and the first be refused.
  ASSERT_TRUE(Eventually([&] { return !fs::is_empty(server_->scratch()); }));
  const auto refusal = [&] {
    grpc::ClientContext context;
    const auto second = begin(&context);
    second->WritesDone();
    v1::BuildMapResponse response;
    while (second->Read(&response)) {
    }
    return second->Finish();
  };
  EXPECT_THAT(refusal().error_message(), HasSubstr("quota builds"));
  first_context.TryCancel();
  v1::BuildMapResponse response;
  while (first->Read(&response)) {
  }
  first->Finish();
  EXPECT_TRUE(Eventually([&] {
    return refusal().error_message().find("quota") == std::string::npos;
  }));
}

}  // namespace
}  // namespace groundlock::test
