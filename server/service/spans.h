// SPDX-License-Identifier: Apache-2.0
// What the server did when and for how long, as spans of OpenTelemetry: one for
// each call, one for each sampled frame. A long stream is no span, which would
// end with it: its frames are, each linked to the call that made the session.
#ifndef GROUNDLOCK_SERVER_SERVICE_SPANS_H_
#define GROUNDLOCK_SERVER_SERVICE_SPANS_H_

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "map_store/base/mutex.h"

namespace groundlock::service {

// Zero: none.
struct SpanContext {
  std::uint64_t trace_high = 0;
  std::uint64_t trace_low = 0;
  std::uint64_t span = 0;
  bool valid() const { return span != 0 && (trace_high | trace_low) != 0; }
};

// Of W3C's header "traceparent", version 00; nullopt if it is anything else.
// Source: W3C Trace Context, section 3.2.
std::optional<SpanContext> ParseTraceParent(std::string_view header);

struct Span {
  using Value = std::variant<std::string, std::int64_t, double>;
  std::string name;
  SpanContext context;
  std::uint64_t parent = 0;  // in the same trace; 0 = none
  SpanContext link;
  bool is_call = false;  // else: what the server does of itself
  std::chrono::system_clock::time_point start;
  std::chrono::system_clock::time_point end;
  std::vector<std::pair<std::string, Value>> attributes;
  absl::Status status;
};

// Spans that wait to be sent. Bounded; never waits: what finds it full is
// dropped and counted. Thread-safe.
class SpanQueue {
 public:
  //   frame_share  of the frames that get a span, 0 to 1
  SpanQueue(double frame_share, std::size_t max_waiting)
      : frame_share_(frame_share), max_waiting_(max_waiting) {}

  // Whether this frame of the session gets spans: always the same answer.
  bool WantsFrame(const SpanContext& session, std::uint64_t sequence) const;
  // A new span's, within its parent's trace, or a new one.
  static SpanContext NewContext(const SpanContext& parent = {});
  void Add(Span span);

  // Waits until there are spans, for `patience` or until Close, and takes up to
  // `max` of them.
  std::vector<Span> Take(std::size_t max, std::chrono::nanoseconds patience);
  void Close();
  bool closed() const;

  std::uint64_t num_dropped() const { return num_dropped_; }

 private:
  const double frame_share_;
  const std::size_t max_waiting_;
  std::atomic<std::uint64_t> num_dropped_{0};
  mutable base::Mutex mutex_;
  std::deque<Span> waiting_ ABSL_GUARDED_BY(mutex_);
  bool closed_ ABSL_GUARDED_BY(mutex_) = false;
};

// The span of a call, from its admission to its answer. Thread-safe.
class CallSpan {
 public:
  //   queue  null: nobody wants it, and nothing is done
  //   parent  the client's span, if it tells of one
  CallSpan(SpanQueue* queue, std::string name, const SpanContext& parent);
  // A call that goes without an answer was cancelled.
  ~CallSpan();
  CallSpan(const CallSpan&) = delete;
  CallSpan& operator=(const CallSpan&) = delete;

  const SpanContext& context() const { return context_; }
  // The first one counts.
  //   attributes  that are not empty are told
  void End(const absl::Status& status,
           std::vector<std::pair<std::string, Span::Value>> attributes);

 private:
  SpanQueue* const queue_;
  const std::string name_;
  const std::uint64_t parent_;
  const SpanContext context_;
  const std::chrono::system_clock::time_point start_;
  std::atomic<bool> ended_{false};
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_SPANS_H_
