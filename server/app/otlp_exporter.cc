// SPDX-License-Identifier: Apache-2.0
#include "server/app/otlp_exporter.h"

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/http.hpp>
#include <chrono>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/status.h"
#include "map_store/base/version.h"
#include "spdlog/spdlog.h"

namespace groundlock::app {
namespace {

namespace asio = boost::asio;
namespace http = boost::beast::http;
using asio::ip::tcp;
using nlohmann::json;
using service::Span;
using service::SpanContext;

constexpr std::size_t kBatch = 512;
constexpr std::chrono::seconds kPatience{1};
// Of one request, from connecting to its answer; what the server waits for at
// its end.
constexpr std::chrono::seconds kTimeout{2};
constexpr int kTries = 3;
constexpr std::uint64_t kMaxAnswerBytes = 64 << 10;
constexpr std::chrono::minutes kWarnInterval{1};

// Numbers of the specification (SpanKind, StatusCode).
constexpr int kInternal = 1;
constexpr int kServer = 2;
constexpr int kError = 2;

std::string TraceId(const SpanContext& context) {
  return absl::StrFormat("%016x%016x", context.trace_high, context.trace_low);
}

std::string SpanId(std::uint64_t id) { return absl::StrFormat("%016x", id); }

// 64-bit numbers are strings in JSON of protobuf.
std::string Nanoseconds(std::chrono::system_clock::time_point time) {
  return absl::StrCat(std::chrono::duration_cast<std::chrono::nanoseconds>(
                          time.time_since_epoch())
                          .count());
}

json Attribute(const std::string& key, const Span::Value& value) {
  json typed;
  if (const auto* text = std::get_if<std::string>(&value)) {
    typed["stringValue"] = *text;
  } else if (const auto* integer = std::get_if<std::int64_t>(&value)) {
    typed["intValue"] = absl::StrCat(*integer);
  } else {
    typed["doubleValue"] = std::get<double>(value);
  }
  return {{"key", key}, {"value", std::move(typed)}};
}

json ToJson(const Span& span) {
  json out{{"traceId", TraceId(span.context)},
           {"spanId", SpanId(span.context.span)},
           {"name", span.name},
           {"kind", span.is_call ? kServer : kInternal},
           {"startTimeUnixNano", Nanoseconds(span.start)},
           {"endTimeUnixNano", Nanoseconds(span.end)}};
  if (span.parent != 0) out["parentSpanId"] = SpanId(span.parent);
  if (span.link.valid()) {
    out["links"] = json::array({{{"traceId", TraceId(span.link)},
                                 {"spanId", SpanId(span.link.span)}}});
  }
  for (const auto& [key, value] : span.attributes) {
    out["attributes"].push_back(Attribute(key, value));
  }
  if (!span.status.ok()) {
    out["status"] = {{"code", kError},
                     {"message", std::string(span.status.message())}};
  }
  return out;
}

// One exchange, from its connection to its end.
class Exchange {
 public:
  Exchange(asio::io_context& context, const std::string& host)
      : resolver_(context), stream_(context) {
    parser_.body_limit(kMaxAnswerBytes);
    request_.method(http::verb::post);
    request_.version(11);
    request_.set(http::field::host, host);
    request_.set(http::field::content_type, "application/json");
    request_.keep_alive(false);
  }

  void Run(const std::string& host,
           const std::string& port,
           const std::string& path,
           const std::string& body) {
    request_.target(path);
    request_.body() = body;
    request_.prepare_payload();
    stream_.expires_after(kTimeout);
    resolver_.async_resolve(
        host, port, [this](const auto& error, const auto& found) {
          if (!Take(error)) return;
          stream_.async_connect(found, [this](const auto& failed, const auto&) {
            if (Take(failed)) Write();
          });
        });
  }
  const boost::system::error_code& error() const { return error_; }
  bool answered() const { return answered_; }
  int status() const { return static_cast<int>(parser_.get().result_int()); }

 private:
  bool Take(const boost::system::error_code& error) {
    error_ = error;
    return !error;
  }
  void Write() {
    http::async_write(stream_, request_, [this](const auto& error, auto) {
      if (Take(error)) Read();
    });
  }
  void Read() {
    http::async_read(stream_, buffer_, parser_, [this](const auto& e, auto) {
      answered_ = Take(e);
    });
  }

  tcp::resolver resolver_;
  boost::beast::tcp_stream stream_;
  http::request<http::string_body> request_;
  boost::beast::flat_buffer buffer_;
  http::response_parser<http::string_body> parser_;
  boost::system::error_code error_;
  bool answered_ = false;
};

}  // namespace

std::string OtlpJson(std::span<const Span> spans, const std::string& instance) {
  json list = json::array();
  for (const Span& span : spans) list.push_back(ToJson(span));
  const json body{
      {"resourceSpans",
       json::array(
           {{{"resource",
              {{"attributes",
                json::array(
                    {Attribute("service.name",
                               std::string("groundlock-server")),
                     Attribute("service.version", std::string(base::Version())),
                     Attribute("service.instance.id", instance)})}}},
             {"scopeSpans",
              json::array({{{"scope", {{"name", "groundlock"}}},
                            {"spans", std::move(list)}}})}}})}};
  // Names that clients chose may be no UTF-8.
  return body.dump(-1, ' ', false, json::error_handler_t::replace);
}

absl::StatusOr<OtlpExporter::Endpoint> OtlpExporter::Parse(
    const std::string& text) {
  constexpr std::string_view kScheme = "http://";
  const auto refuse = [&text](const char* why) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--otlp-endpoint: '", text, "': ", why, "; http://HOST[:PORT][/PATH]"));
  };
  if (text.starts_with("https://")) {
    return refuse("there is no TLS to collectors: run one beside the server");
  }
  if (!text.starts_with(kScheme)) return refuse("no http:// address");
  std::string rest = text.substr(kScheme.size());
  Endpoint endpoint;
  if (const std::size_t slash = rest.find('/'); slash != std::string::npos) {
    // An address as that of all signals: those of traces are below it.
    if (slash + 1 < rest.size()) endpoint.path = rest.substr(slash);
    rest.resize(slash);
  }
  const std::size_t colon = rest.rfind(':');
  if (colon != std::string::npos &&
      rest.find(']', colon) == std::string::npos) {
    int port = 0;
    endpoint.port = rest.substr(colon + 1);
    if (!absl::SimpleAtoi(endpoint.port, &port) || port < 1 || port > 65'535) {
      return refuse("no port");
    }
    rest.resize(colon);
  }
  if (rest.size() > 2 && rest.front() == '[' && rest.back() == ']') {
    rest = rest.substr(1, rest.size() - 2);
  }
  if (rest.empty()) return refuse("no host");
  for (const char c : absl::StrCat(rest, endpoint.path)) {
    if (c <= ' ' || c > '~') return refuse("not printable");
  }
  endpoint.host = std::move(rest);
  return endpoint;
}

absl::StatusOr<std::unique_ptr<OtlpExporter>> OtlpExporter::Start(
    const std::string& endpoint,
    const std::string& instance,
    service::SpanQueue* queue) {
  ASSIGN_OR_RETURN(Endpoint parsed, Parse(endpoint));
  return std::unique_ptr<OtlpExporter>(
      new OtlpExporter(std::move(parsed), instance, queue));
}

OtlpExporter::OtlpExporter(Endpoint endpoint,
                           std::string instance,
                           service::SpanQueue* queue)
    : endpoint_(std::move(endpoint)),
      instance_(std::move(instance)),
      queue_(queue),
      thread_([this] { Work(); }) {}

OtlpExporter::~OtlpExporter() {
  queue_->Close();
  thread_.join();
}

absl::Status OtlpExporter::Send(const std::string& body) const {
  asio::io_context context{1};
  Exchange exchange(context, endpoint_.host);
  exchange.Run(endpoint_.host, endpoint_.port, endpoint_.path, body);
  // The resolver does not know the stream's limit.
  context.run_for(kTimeout + std::chrono::milliseconds(500));
  if (!exchange.answered()) {
    return absl::UnavailableError(exchange.error() ? exchange.error().message()
                                                   : "no answer in time");
  }
  const int status = exchange.status();
  if (status >= 200 && status < 300) return absl::OkStatus();
  const std::string told = absl::StrCat("HTTP status ", status);
  const bool again =
      status == 429 || status == 502 || status == 503 || status == 504;
  return again ? absl::UnavailableError(told)
               : absl::FailedPreconditionError(told);
}

void OtlpExporter::Work() {
  auto next_warning = std::chrono::steady_clock::time_point::min();
  for (;;) {
    const bool last = queue_->closed();
    const std::vector<Span> spans = queue_->Take(kBatch, kPatience);
    if (spans.empty()) {
      if (last) return;
      continue;
    }
    const std::string body = OtlpJson(spans, instance_);
    absl::Status status = Send(body);
    for (int i = 1; i < kTries && absl::IsUnavailable(status); ++i) {
      if (queue_->closed()) break;
      std::this_thread::sleep_for(i * std::chrono::milliseconds(200));
      status = Send(body);
    }
    if (status.ok()) {
      num_sent_ += spans.size();
      continue;
    }
    num_failed_ += spans.size();
    const auto now = std::chrono::steady_clock::now();
    if (now >= next_warning) {
      next_warning = now + kWarnInterval;
      spdlog::warn("traces: the collector at {}:{} does not take them: {}",
                   endpoint_.host,
                   endpoint_.port,
                   status.ToString());
    }
    // At the end nobody waits for a collector that is away.
    if (queue_->closed()) return;
  }
}

}  // namespace groundlock::app
