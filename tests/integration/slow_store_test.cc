// SPDX-License-Identifier: Apache-2.0
// A store that takes its time: a database far away, a map of gigabytes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <future>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "groundlock/v1/tracking.pb.h"
#include "tests/integration/raw_call.h"
#include "tests/integration/test_server.h"
#include "tests/integration/text_model.h"

namespace groundlock::test {
namespace {

using ::testing::HasSubstr;

// Whoever opens a map waits at a gate.
class StoreThatWaits final : public storage::Store {
 public:
  StoreThatWaits(std::unique_ptr<storage::Store> store, Gate* gate)
      : store_(std::move(store)), gate_(gate) {}

  std::string Description() const override { return store_->Description(); }
  using Store::Publish;
  absl::StatusOr<storage::MapVersion> Publish(
      std::string_view name,
      const map::MapData& data,
      const std::function<absl::Status()>& ready) override {
    return store_->Publish(name, data, ready);
  }
  absl::StatusOr<std::vector<storage::MapVersion>> List() override {
    return store_->List();
  }
  absl::StatusOr<std::vector<storage::MapVersion>> ListVersions(
      std::string_view name) override {
    return store_->ListVersions(name);
  }
  absl::StatusOr<storage::MapVersion> Get(std::string_view name,
                                          std::uint64_t version) override {
    return store_->Get(name, version);
  }
  absl::StatusOr<std::shared_ptr<const map::Map>> Open(
      std::string_view name, std::uint64_t version) override {
    gate_->Pass();
    return store_->Open(name, version);
  }
  absl::Status Check(std::string_view name, std::uint64_t version) override {
    return store_->Check(name, version);
  }
  absl::Status Delete(std::string_view name) override {
    return store_->Delete(name);
  }
  absl::StatusOr<storage::GarbageReport> CollectGarbage(
      std::uint64_t keep_newest) override {
    return store_->CollectGarbage(keep_newest);
  }

 private:
  const std::unique_ptr<storage::Store> store_;
  Gate* const gate_;
};

TestServer::WrapStore Waiting(Gate* gate) {
  return [gate](std::unique_ptr<storage::Store> store) {
    return std::make_unique<StoreThatWaits>(std::move(store), gate);
  };
}

void ImportYard(const TestServer& server) {
  const auto directory =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  ASSERT_TRUE(
      server.Connect()
          ->ImportMap(WriteForImport(directory.path(), "yard", TextModel()))
          .ok());
}

TEST(SlowStore, MapsThatTakeTheirTimeHoldUpNobodyElse) {
  Gate gate;
  Gate frames;
  frames.OpenForGood();
  TestServer server({}, GatedCores(&frames), Waiting(&gate));
  ImportYard(server);
  std::vector<std::future<absl::Status>> on_maps;
  // More than there are threads for it.
  for (int i = 0; i < 6; ++i) {
    on_maps.push_back(std::async(std::launch::async, [&server, i] {
      sdk::SessionSpec spec = Spec("on-map-" + std::to_string(i));
      spec.map_name = "yard";
      return server.Connect()->CreateSession(spec).status();
    }));
  }
  ASSERT_TRUE(Eventually([&] { return gate.waiting() == 4; }));
  const auto client = server.Connect();
  EXPECT_EQ(client->ListMaps()->size(), 1U);
  ASSERT_TRUE(client->CreateSession(Spec("without")).ok());
  auto stream = client->Track("without");
  ASSERT_TRUE(stream.ok()) << stream.status();
  ASSERT_TRUE((*stream)->Send(SquareFrame(0, 10, 10)).ok());
  EXPECT_TRUE((*stream)->Next().ok());
  EXPECT_EQ(gate.waiting(), 4);
  gate.OpenForGood();
  for (auto& status : on_maps) EXPECT_TRUE(status.get().ok());
}

TEST(SlowStore, ImagesThatWaitToBeLocalizedAreBounded) {
  Gate gate;
  service::ServerOptions options;
  options.max_waiting_image_bytes = 1 << 20;
  TestServer server(options, nullptr, Waiting(&gate));
  ImportYard(server);
  v1::LocalizeRequest request;
  request.set_map_name("yard");
  request.mutable_image()->set_data(std::string(600'000, 'x'));
  const auto localize = [&server, message = request.SerializeAsString()] {
    return CallRaw(RawChannel(server.address()),
                   "/groundlock.v1.TrackingService/Localize",
                   "",
                   {message})
        .status;
  };
  auto first = std::async(std::launch::async, localize);
  ASSERT_TRUE(Eventually([&] { return gate.waiting() == 1; }));
  const grpc::Status second = localize();
  EXPECT_EQ(second.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(second.error_message(), HasSubstr("too many images wait"));
  gate.OpenForGood();
  EXPECT_EQ(first.get().error_code(), grpc::StatusCode::FAILED_PRECONDITION)
      << "it came to its map, which has no descriptors";
  EXPECT_EQ(localize().error_code(), grpc::StatusCode::FAILED_PRECONDITION)
      << "there is room again";
}

}  // namespace
}  // namespace groundlock::test
