// SPDX-License-Identifier: Apache-2.0
#include "server/service/spans.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "map_store/base/mix_seed.h"

namespace groundlock::service {
namespace {

// Of ids, never 0.
std::uint64_t NewId() {
  static const std::uint64_t seed = [] {
    std::random_device device;
    return (std::uint64_t{device()} << 32U) | device();
  }();
  static std::atomic<std::uint64_t> number{0};
  return std::max<std::uint64_t>(1, base::MixSeed(seed, ++number));
}

// Lower-case hexadecimal digits alone, as the source wants them.
std::optional<std::uint64_t> ParseHex(std::string_view digits) {
  std::uint64_t value = 0;
  for (const char c : digits) {
    std::uint64_t digit = 0;
    if (c >= '0' && c <= '9') {
      digit = static_cast<std::uint64_t>(c - '0');
    } else if (c >= 'a' && c <= 'f') {
      digit = static_cast<std::uint64_t>(c - 'a') + 10;
    } else {
      return std::nullopt;
    }
    value = (value << 4U) | digit;
  }
  return value;
}

}  // namespace

std::optional<SpanContext> ParseTraceParent(std::string_view header) {
  // 00-TTTTTTTTTTTTTTTTTTTTTTTTTTTTTTTT-SSSSSSSSSSSSSSSS-FF
  if (header.size() != 55 || !header.starts_with("00-") || header[35] != '-' ||
      header[52] != '-' || !ParseHex(header.substr(53)).has_value()) {
    return std::nullopt;
  }
  const auto high = ParseHex(header.substr(3, 16));
  const auto low = ParseHex(header.substr(19, 16));
  const auto span = ParseHex(header.substr(36, 16));
  if (!high || !low || !span) return std::nullopt;
  const SpanContext context{*high, *low, *span};
  return context.valid() ? std::optional(context) : std::nullopt;
}

bool SpanQueue::WantsFrame(const SpanContext& session,
                           std::uint64_t sequence) const {
  if (frame_share_ <= 0.0) return false;
  // 53 bits: as many as a double has.
  const double drawn = std::ldexp(
      static_cast<double>(base::MixSeed(session.span, sequence) >> 11U), -53);
  return drawn < frame_share_;
}

SpanContext SpanQueue::NewContext(const SpanContext& parent) {
  if (parent.valid()) return {parent.trace_high, parent.trace_low, NewId()};
  return {NewId(), NewId(), NewId()};
}

void SpanQueue::Add(Span span) {
  base::MutexLock lock(&mutex_);
  if (waiting_.size() >= max_waiting_ || closed_) {
    ++num_dropped_;
    return;
  }
  waiting_.push_back(std::move(span));
}

std::vector<Span> SpanQueue::Take(std::size_t max,
                                  std::chrono::nanoseconds patience) {
  std::vector<Span> spans;
  base::MutexLock lock(&mutex_);
  mutex_.AwaitFor(patience, [this, max] {
    mutex_.AssertHeld();
    return closed_ || waiting_.size() >= max;
  });
  while (!waiting_.empty() && spans.size() < max) {
    spans.push_back(std::move(waiting_.front()));
    waiting_.pop_front();
  }
  return spans;
}

void SpanQueue::Close() {
  base::MutexLock lock(&mutex_);
  closed_ = true;
}

bool SpanQueue::closed() const {
  base::MutexLock lock(&mutex_);
  return closed_;
}

CallSpan::CallSpan(SpanQueue* queue,
                   std::string name,
                   const SpanContext& parent)
    : queue_(queue),
      name_(std::move(name)),
      parent_(parent.valid() ? parent.span : 0),
      context_(queue == nullptr ? SpanContext()
                                : SpanQueue::NewContext(parent)),
      start_(std::chrono::system_clock::now()) {}

CallSpan::~CallSpan() {
  End(absl::CancelledError("the call ended without an answer"), {});
}

void CallSpan::End(
    const absl::Status& status,
    std::vector<std::pair<std::string, Span::Value>> attributes) {
  if (queue_ == nullptr || ended_.exchange(true)) return;
  Span span;
  span.name = name_;
  span.context = context_;
  span.parent = parent_;
  span.is_call = true;
  span.start = start_;
  span.end = std::chrono::system_clock::now();
  std::erase_if(attributes, [](const auto& attribute) {
    const auto* text = std::get_if<std::string>(&attribute.second);
    return text != nullptr && text->empty();
  });
  span.attributes = std::move(attributes);
  span.status = status;
  queue_->Add(std::move(span));
}

}  // namespace groundlock::service
