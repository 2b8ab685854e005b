// SPDX-License-Identifier: Apache-2.0
// Traces: what the program sends to a collector, received over a real socket.
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http.hpp>
#include <list>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>

#include "groundlock/v1/tracking.grpc.pb.h"
#include "map_store/base/mutex.h"
#include "tests/integration/program.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

namespace asio = boost::asio;
namespace http = boost::beast::http;
using asio::ip::tcp;
using nlohmann::json;
using ::testing::HasSubstr;

// A collector that keeps what it is sent.
class Collector {
 public:
  // status: what it answers; 0 = it accepts and never answers.
  explicit Collector(unsigned status = 200)
      : status_(status), thread_([this] { Accept(); }) {}
  ~Collector() {
    boost::system::error_code ignored;
    // Wakes the thread.
    stopping_ = true;
    tcp::socket last(context_);
    last.connect(acceptor_.local_endpoint(), ignored);
    thread_.join();
  }
  std::string endpoint() const {
    return "http://127.0.0.1:" +
           std::to_string(acceptor_.local_endpoint().port());
  }
  int num_requests() const {
    base::MutexLock lock(&mutex_);
    return num_requests_;
  }
  std::vector<json> SpansNamed(const std::string& name) const {
    base::MutexLock lock(&mutex_);
    std::vector<json> found;
    for (const json& span : spans_) {
      if (span["name"] == name) found.push_back(span);
    }
    return found;
  }
  json resource() const {
    base::MutexLock lock(&mutex_);
    return resource_;
  }

 private:
  void Accept() {
    std::list<tcp::socket> kept;
    for (;;) {
      tcp::socket socket(context_);
      boost::system::error_code error;
      acceptor_.accept(socket, error);
      if (stopping_) return;
      if (error) continue;
      if (status_ == 0) {
        base::MutexLock lock(&mutex_);
        ++num_requests_;
        kept.push_back(std::move(socket));
      } else {
        Answer(std::move(socket));
      }
    }
  }
  void Answer(tcp::socket socket) {
    boost::beast::flat_buffer buffer;
    http::request<http::string_body> request;
    boost::system::error_code error;
    http::read(socket, buffer, request, error);
    if (error) return;
    EXPECT_EQ(request.method(), http::verb::post);
    EXPECT_EQ(request.target(), "/v1/traces");
    EXPECT_EQ(request[http::field::content_type], "application/json");
    {
      base::MutexLock lock(&mutex_);
      ++num_requests_;
      if (status_ == 200) Keep(json::parse(request.body(), nullptr, false));
    }
    http::response<http::string_body> response(
        static_cast<http::status>(status_), 11);
    response.body() = "{}";
    response.prepare_payload();
    http::write(socket, response, error);
  }
  void Keep(const json& body) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    ASSERT_TRUE(body.is_object());
    for (const json& resource : body["resourceSpans"]) {
      resource_ = resource["resource"];
      for (const json& scope : resource["scopeSpans"]) {
        for (const json& span : scope["spans"]) spans_.push_back(span);
      }
    }
  }

  const unsigned status_;
  asio::io_context context_;
  tcp::acceptor acceptor_{context_, tcp::endpoint(tcp::v4(), 0)};
  std::atomic<bool> stopping_{false};
  mutable base::Mutex mutex_;
  int num_requests_ ABSL_GUARDED_BY(mutex_) = 0;
  std::vector<json> spans_ ABSL_GUARDED_BY(mutex_);
  json resource_ ABSL_GUARDED_BY(mutex_);
  std::thread thread_;
};

std::vector<std::string> Arguments(const std::string& endpoint) {
  return {"--listen",
          "127.0.0.1:0",
          "--store",
          "@TMP@/store",
          "--metrics",
          "127.0.0.1:0",
          "--otlp-endpoint",
          endpoint,
          "--trace-sample",
          "1"};
}

std::string Text(const json& span, const std::string& key) {
  for (const json& attribute : span["attributes"]) {
    if (attribute["key"] == key) {
      return attribute["value"].begin().value().get<std::string>();
    }
  }
  return "";
}

TEST(Traces, CallsAndFramesArriveAsSpansOfTheirOwn) {
  const Collector collector;
  Program program(Arguments(collector.endpoint()));
  const int port = program.PortAfter("listening on 127\\.0\\.0\\.1:");
  ASSERT_GT(port, 0) << program.Log();
  const std::string address = "127.0.0.1:" + std::to_string(port);
  auto client = ConnectTo(address);
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->CreateSession(Spec("drive")).ok());
  auto stream = (*client)->Track("drive");
  ASSERT_TRUE(stream.ok());
  for (std::uint64_t i = 0; i < 3; ++i) {
    ASSERT_TRUE((*stream)->Send(SquareFrame(i, 10, 10)).ok());
    ASSERT_TRUE((*stream)->Next().ok());
  }
  EXPECT_FALSE((*client)->DeleteMap("nowhere").ok());

  // The stream is still open, and is told of all the same.
  ASSERT_TRUE(Eventually([&] {
    return collector.SpansNamed("frame").size() == 3 &&
           collector.SpansNamed("Track").size() == 1 &&
           collector.SpansNamed("DeleteMap").size() == 1;
  })) << program.Log();
  const std::vector<json> created = collector.SpansNamed("CreateSession");
  ASSERT_EQ(created.size(), 1U);
  EXPECT_EQ(created[0]["kind"], 2);
  EXPECT_EQ(Text(created[0], "groundlock.session"), "drive");
  EXPECT_FALSE(created[0].contains("status"));
  std::set<std::string> sequences;
  std::set<std::string> traces{created[0]["traceId"]};
  for (const json& frame : collector.SpansNamed("frame")) {
    ASSERT_EQ(frame["links"].size(), 1U);
    EXPECT_EQ(frame["links"][0]["traceId"], created[0]["traceId"]);
    EXPECT_EQ(frame["links"][0]["spanId"], created[0]["spanId"]);
    EXPECT_EQ(Text(frame, "groundlock.session"), "drive");
    EXPECT_LE(std::stoull(frame["startTimeUnixNano"].get<std::string>()),
              std::stoull(frame["endTimeUnixNano"].get<std::string>()));
    sequences.insert(Text(frame, "groundlock.sequence"));
    traces.insert(frame["traceId"]);
    EXPECT_EQ(frame["traceId"].get<std::string>().size(), 32U);
    EXPECT_EQ(frame["spanId"].get<std::string>().size(), 16U);
  }
  EXPECT_EQ(sequences, (std::set<std::string>{"0", "1", "2"}));
  EXPECT_EQ(traces.size(), 4U) << "a trace for each";
  for (const char* stage : {"queue", "decode", "localize", "track"}) {
    EXPECT_EQ(collector.SpansNamed(stage).size(), 3U) << stage;
  }
  const json failed = collector.SpansNamed("DeleteMap")[0];
  EXPECT_EQ(failed["status"]["code"], 2);
  EXPECT_EQ(Text(failed, "groundlock.map"), "nowhere");
  EXPECT_THAT(collector.resource().dump(), HasSubstr("groundlock-server"));

  // A client's trace goes on in the server.
  const auto stub = v1::TrackingService::NewStub(
      grpc::CreateChannel(address, grpc::InsecureChannelCredentials()));
  grpc::ClientContext context;
  context.AddMetadata(
      "traceparent", "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01");
  v1::GetCallerResponse caller;
  ASSERT_TRUE(stub->GetCaller(&context, {}, &caller).ok());
  ASSERT_TRUE(
      Eventually([&] { return !collector.SpansNamed("GetCaller").empty(); }));
  bool joined = false;
  for (const json& span : collector.SpansNamed("GetCaller")) {
    joined |= span["traceId"] == "0af7651916cd43dd8448eb211c80319c" &&
              span["parentSpanId"] == "b7ad6b7169203331";
  }
  EXPECT_TRUE(joined);
  // What waits when the server ends is sent all the same.
  ASSERT_TRUE((*client)->DeleteSession("drive").ok());
  program.Signal(SIGTERM);
  EXPECT_EQ(program.Wait(), 0) << program.Log();
  EXPECT_EQ(collector.SpansNamed("DeleteSession").size(), 1U);
  stream->reset();
}

TEST(Traces, ACollectorThatIsNotWellHoldsUpNothing) {
  for (const unsigned status : {0U, 503U, 400U}) {
    const Collector collector(status);
    Program program(Arguments(collector.endpoint()));
    const int port = program.PortAfter("listening on 127\\.0\\.0\\.1:");
    ASSERT_GT(port, 0) << program.Log();
    auto client = ConnectTo("127.0.0.1:" + std::to_string(port));
    ASSERT_TRUE(client.ok()) << client.status();
    ASSERT_TRUE((*client)->CreateSession(Spec("drive")).ok());
    auto stream = (*client)->Track("drive");
    ASSERT_TRUE(stream.ok());
    std::uint64_t sequence = 0;
    const auto frame = [&] {
      ASSERT_TRUE((*stream)->Send(SquareFrame(sequence++, 10, 10)).ok());
      ASSERT_TRUE((*stream)->Next().ok());
    };
    ASSERT_NO_FATAL_FAILURE(frame());
    ASSERT_TRUE(Eventually([&] { return collector.num_requests() > 0; }));
    // While it is asked, or after.
    for (int i = 0; i < 100; ++i) ASSERT_NO_FATAL_FAILURE(frame());
    EXPECT_TRUE(Eventually([&] {
      return program.Log().find("does not take them") != std::string::npos;
    })) << program.Log();
    program.Signal(SIGTERM);
    EXPECT_EQ(program.Wait(), 0) << program.Log();
    EXPECT_THAT(program.Log(), HasSubstr("stopped"));
    stream->reset();
  }
}

TEST(Traces, AnEndpointThatIsNoneIsNamed) {
  for (const char* endpoint : {"https://127.0.0.1:4318",
                               "127.0.0.1:4318",
                               "http://",
                               "http://host:0",
                               "http://host:99999",
                               "http://host\n:1"}) {
    Program program(Arguments(endpoint));
    EXPECT_EQ(program.Wait(), 1) << endpoint;
    EXPECT_THAT(program.Log(), HasSubstr("--otlp-endpoint")) << endpoint;
  }
}

}  // namespace
}  // namespace groundlock::test
