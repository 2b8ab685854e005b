// SPDX-License-Identifier: Apache-2.0
// gRPC's health checking, as load balancers ask for it.
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/impl/codegen/proto_utils.h>
#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <optional>
#include <string>

#include "grpc/health/v1/health.pb.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

namespace health = grpc::health::v1;
using health::HealthCheckResponse;

// One call, Check or Watch, step by step.
class HealthCall {
 public:
  HealthCall(const std::string& address,
             const std::string& method,
             const std::string& service)
      : stub_(
            grpc::CreateChannel(address, grpc::InsecureChannelCredentials())) {
    context_.set_deadline(std::chrono::system_clock::now() +
                          std::chrono::minutes(2));
    call_ = stub_.PrepareCall(
        &context_, "/grpc.health.v1.Health/" + method, &queue_);
    call_->StartCall(this);
    EXPECT_TRUE(Done());
    health::HealthCheckRequest request;
    request.set_service(service);
    call_->WriteLast(request, grpc::WriteOptions(), this);
    EXPECT_TRUE(Done());
  }
  ~HealthCall() {
    if (ended_) return;
    context_.TryCancel();
    End();
  }

  // nullopt: there are no more.
  std::optional<HealthCheckResponse::ServingStatus> Next() {
    HealthCheckResponse response;
    call_->Read(&response, this);
    if (!Done()) return std::nullopt;
    return response.status();
  }
  grpc::StatusCode End() {
    ended_ = true;
    grpc::Status status;
    call_->Finish(&status, this);
    Done();
    return status.error_code();
  }

 private:
  bool Done() {
    void* tag = nullptr;
    bool ok = false;
    return queue_.Next(&tag, &ok) && ok;
  }

  grpc::TemplatedGenericStub<health::HealthCheckRequest, HealthCheckResponse>
      stub_;
  grpc::CompletionQueue queue_;
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientAsyncReaderWriter<health::HealthCheckRequest,
                                                HealthCheckResponse>>
      call_;
  bool ended_ = false;
};

TEST(Health, ServesAsAWholeAndByService) {
  TestServer server;
  for (const char* service :
       {"", "groundlock.v1.TrackingService", "groundlock.v1.MapService"}) {
    HealthCall check(server.address(), "Check", service);
    EXPECT_EQ(check.Next(), HealthCheckResponse::SERVING) << service;
    EXPECT_EQ(check.Next(), std::nullopt);
    EXPECT_EQ(check.End(), grpc::StatusCode::OK);
  }
  HealthCall other(server.address(), "Check", "no.such.Service");
  EXPECT_EQ(other.Next(), std::nullopt);
  EXPECT_EQ(other.End(), grpc::StatusCode::NOT_FOUND);
}

TEST(Health, WhoWatchesIsToldThatItEndsAndLetGo) {
  TestServer server;
  HealthCall watch(server.address(), "Watch", "");
  EXPECT_EQ(watch.Next(), HealthCheckResponse::SERVING);
  // Nobody waits for those that watch.
  server.server().Shutdown(std::chrono::hours(1));
  EXPECT_EQ(watch.Next(), HealthCheckResponse::NOT_SERVING);
  EXPECT_EQ(watch.Next(), std::nullopt);
  EXPECT_EQ(watch.End(), grpc::StatusCode::UNAVAILABLE);
}

TEST(Health, AServiceThatIsNotThereIsWatchedAllTheSame) {
  TestServer server;
  {
    HealthCall watch(server.address(), "Watch", "no.such.Service");
    EXPECT_EQ(watch.Next(), HealthCheckResponse::SERVICE_UNKNOWN);
    EXPECT_EQ(server.metrics().calls, 1);
  }
  EXPECT_TRUE(Eventually([&] { return server.metrics().calls == 0; }))
      << "who goes is forgotten";
}

}  // namespace
}  // namespace groundlock::test
