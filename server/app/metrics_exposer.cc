// SPDX-License-Identifier: Apache-2.0
#include "server/app/metrics_exposer.h"

#include <prometheus/collectable.h>
#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "map_store/base/http_page.h"
#include "map_store/base/single_metric.h"
#include "map_store/base/version.h"

namespace groundlock::app {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

ClientMetric Histogram(const char* label,
                       const char* value,
                       const service::DurationHistogram& histogram) {
  using service::DurationHistogram;
  ClientMetric metric;
  metric.label.push_back({label, value});
  std::uint64_t cumulative = 0;
  for (std::size_t i = 0; i <= DurationHistogram::kNumBounds; ++i) {
    cumulative += histogram.count(i);
    ClientMetric::Bucket bucket;
    bucket.cumulative_count = cumulative;
    bucket.upper_bound = i < DurationHistogram::kNumBounds
                             ? DurationHistogram::UpperBoundMs(i) * 1e-3
                             : std::numeric_limits<double>::infinity();
    metric.histogram.bucket.push_back(bucket);
  }
  metric.histogram.sample_count = cumulative;
  metric.histogram.sample_sum = histogram.sum_ms() * 1e-3;
  return metric;
}

ClientMetric Stage(const char* stage,
                   const service::DurationHistogram& histogram) {
  return Histogram("stage", stage, histogram);
}

ClientMetric Labelled(const char* label,
                      const char* value,
                      std::uint64_t count) {
  ClientMetric metric;
  metric.label.push_back({label, value});
  metric.counter.value = static_cast<double>(count);
  metric.gauge.value = metric.counter.value;
  return metric;
}

ClientMetric Refused(const char* why, const std::atomic<std::uint64_t>& calls) {
  return Labelled("why", why, calls.load());
}

// Of the store: its operations as the server sees them, whatever is behind.
void AddStore(const MeasuredStore& store, std::vector<MetricFamily>& families) {
  MetricFamily time{"groundlock_store_seconds",
                    "Time of the store's operations.",
                    MetricType::Histogram,
                    {}};
  MetricFamily failures{"groundlock_store_failures_total",
                        "Operations that the store could not do.",
                        MetricType::Counter,
                        {}};
  for (const MeasuredStore::Measured& one : store.operations()) {
    time.metric.push_back(Histogram("operation", one.name, one.time));
    failures.metric.push_back(
        Labelled("operation", one.name, one.failures.load()));
  }
  families.push_back(std::move(time));
  families.push_back(std::move(failures));
  const storage::StoreStats stats = store.Stats();
  const auto add = [&families](const char* name,
                               const char* help,
                               MetricType type,
                               std::uint64_t value) {
    families.push_back(
        base::SingleMetric(name, help, type, static_cast<double>(value)));
  };
  add("groundlock_maps_open",
      "Map versions that somebody works on.",
      MetricType::Gauge,
      stats.maps_open);
  families.push_back({"groundlock_cache_lookups_total",
                      "Maps of a database looked for in the local cache.",
                      MetricType::Counter,
                      {Labelled("result", "hit", stats.cache_hits),
                       Labelled("result", "miss", stats.cache_misses)}});
  add("groundlock_cache_removals_total",
      "Maps removed from the local cache to make room.",
      MetricType::Counter,
      stats.cache_removals);
  add("groundlock_cache_bytes",
      "Size of the local cache when it was last looked through.",
      MetricType::Gauge,
      stats.cache_bytes);
  families.push_back(
      {"groundlock_database_connections_total",
       "Connections to the database that were asked for.",
       MetricType::Counter,
       {Labelled("result", "made", stats.connections_made),
        Labelled("result", "failed", stats.connections_failed)}});
  add("groundlock_database_connections_in_use",
      "Connections to the database that work.",
      MetricType::Gauge,
      stats.connections_in_use);
  add("groundlock_database_away_total",
      "Attempts that ended because the database was away or busy.",
      MetricType::Counter,
      stats.database_away);
}

// Of traces; all zero where none are sent.
MetricFamily Spans(const service::Metrics& metrics,
                   const OtlpExporter* exporter) {
  const bool sends = exporter != nullptr && metrics.spans != nullptr;
  return {
      "groundlock_spans_total",
      "Spans of traces: sent, dropped as too many waited, or not taken by the "
      "collector.",
      MetricType::Counter,
      {Labelled("outcome", "sent", sends ? exporter->num_sent() : 0),
       Labelled("outcome", "dropped", sends ? metrics.spans->num_dropped() : 0),
       Labelled("outcome", "failed", sends ? exporter->num_failed() : 0)}};
}

// What waits for the threads of each queue, or what they have done.
template <typename Value>
MetricFamily Queues(const char* name,
                    const char* help,
                    MetricType type,
                    const service::QueueProgress& queues,
                    Value value) {
  MetricFamily family{name, help, type, {}};
  for (const auto& [queue, progress] : queues.Read()) {
    ClientMetric metric;
    metric.label.push_back({"queue", queue});
    metric.counter.value = value(progress);
    metric.gauge.value = metric.counter.value;
    family.metric.push_back(std::move(metric));
  }
  return family;
}

MetricFamily BuildInfo() {
  ClientMetric metric;
  metric.label.push_back({"version", base::Version()});
  metric.gauge.value = 1.0;
  return {"groundlock_build_info",
          "The program's version.",
          MetricType::Gauge,
          {metric}};
}

class Collector : public prometheus::Collectable {
 public:
  explicit Collector(const Measured& measured)
      : measured_(measured), metrics_(*measured.metrics) {}

  std::vector<MetricFamily> Collect() const override {
    std::vector<MetricFamily> families = Own();
    if (measured_.store != nullptr) AddStore(*measured_.store, families);
    families.push_back(Spans(metrics_, measured_.exporter));
    return families;
  }

 private:
  std::vector<MetricFamily> Own() const {
    const auto counter = [](const char* name,
                            const char* help,
                            const std::atomic<std::uint64_t>& value) {
      return base::SingleMetric(
          name, help, MetricType::Counter, static_cast<double>(value.load()));
    };
    const auto gauge = [](const char* name,
                          const char* help,
                          const std::atomic<std::int64_t>& value) {
      return base::SingleMetric(
          name, help, MetricType::Gauge, static_cast<double>(value.load()));
    };
    return {
        counter("groundlock_frames_processed_total",
                "Frames answered by a result.",
                metrics_.frames_processed),
        counter("groundlock_frames_dropped_total",
                "Frames answered as dropped.",
                metrics_.frames_dropped),
        counter("groundlock_frames_failed_total",
                "Frames answered by an error.",
                metrics_.frames_failed),
        counter("groundlock_sessions_created_total",
                "Sessions created.",
                metrics_.sessions_created),
        counter("groundlock_sessions_expired_total",
                "Sessions ended because they were idle.",
                metrics_.sessions_expired),
        gauge("groundlock_sessions", "Sessions now.", metrics_.sessions),
        gauge("groundlock_streams", "Frame streams now.", metrics_.streams),
        gauge("groundlock_watchers", "Watchers now.", metrics_.watchers),
        gauge("groundlock_serving",
              "1 while new work is taken, else 0.",
              metrics_.serving),
        gauge("groundlock_stalled",
              "1 while work waits and none is finished, else 0.",
              metrics_.stalled),
        gauge("groundlock_connections",
              "Connections of clients now.",
              metrics_.connections),
        counter("groundlock_connections_refused_total",
                "Connections refused as there were too many.",
                metrics_.connections_over_limit),
        counter("groundlock_connections_ended_total",
                "Connections ended for messages that they had sent half.",
                metrics_.connections_ended),
        gauge("groundlock_calls", "Calls open now.", metrics_.calls),
        {"groundlock_calls_refused_total",
         "Calls refused for who makes them, or for how many there are.",
         MetricType::Counter,
         {Refused("unauthenticated", metrics_.calls_unauthenticated),
          Refused("denied", metrics_.calls_denied),
          Refused("quota", metrics_.over_quota),
          Refused("limit", metrics_.calls_over_limit)}},
        counter("groundlock_maps_imported_total",
                "Maps imported.",
                metrics_.maps_imported),
        counter("groundlock_map_imports_failed_total",
                "Imports that failed or broke off.",
                metrics_.map_imports_failed),
        gauge("groundlock_builds",
              "Maps being uploaded for a build, or built, now.",
              metrics_.builds),
        counter("groundlock_maps_built_total",
                "Maps built from videos and photos.",
                metrics_.maps_built),
        counter("groundlock_map_builds_failed_total",
                "Builds that failed or broke off.",
                metrics_.map_builds_failed),
        base::SingleMetric("groundlock_maps",
                           "Maps in the store when it was last tidied.",
                           MetricType::Gauge,
                           static_cast<double>(metrics_.maps.load())),
        base::SingleMetric("groundlock_map_versions",
                           "Their versions.",
                           MetricType::Gauge,
                           static_cast<double>(metrics_.map_versions.load())),
        base::SingleMetric(
            "groundlock_map_versions_in_use",
            "Old versions that stay as somebody has them open.",
            MetricType::Gauge,
            static_cast<double>(metrics_.map_versions_in_use.load())),
        counter("groundlock_map_versions_removed_total",
                "Old versions removed.",
                metrics_.map_versions_removed),
        counter("groundlock_images_localized_total",
                "Single images processed by Localize.",
                metrics_.images_localized),
        {"groundlock_stage_seconds",
         "Time of a frame's stages; queue: from arrival to the start.",
         MetricType::Histogram,
         {Stage("queue", metrics_.queue),
          Stage("decode", metrics_.decode),
          Stage("localize", metrics_.localize),
          Stage("track", metrics_.track),
          Stage("total", metrics_.total)}},
        Queues("groundlock_queue_waiting",
               "Pieces of work that no thread has begun.",
               MetricType::Gauge,
               metrics_.queues,
               [](const service::Progress& progress) {
                 return static_cast<double>(progress.waiting);
               }),
        Queues("groundlock_queue_done_total",
               "Pieces of work that are done.",
               MetricType::Counter,
               metrics_.queues,
               [](const service::Progress& progress) {
                 return static_cast<double>(progress.done);
               }),
        BuildInfo()};
  }

  const Measured measured_;
  const service::Metrics& metrics_;
};

}  // namespace

struct MetricsExposer::Parts {
  std::shared_ptr<Collector> collector;
  std::unique_ptr<base::HttpPages> pages;
};

absl::StatusOr<std::unique_ptr<MetricsExposer>> MetricsExposer::Start(
    const std::string& address, const Measured& measured) {
  using base::HttpPage;
  auto parts = std::make_unique<Parts>();
  parts->collector = std::make_shared<Collector>(measured);
  constexpr char kPlain[] = "text/plain; charset=utf-8";
  auto pages = base::HttpPages::Start(
      address,
      {{"/metrics",
        "text/plain; version=0.0.4; charset=utf-8",
        [collector = parts->collector] {
          return HttpPage::Content{
              200,
              prometheus::TextSerializer().Serialize(collector->Collect())};
        }},
       {"/livez",
        kPlain,
        [] {
          return HttpPage::Content{200, "ok\n"};
        }},
       {"/readyz", kPlain, [metrics = measured.metrics] {
          if (metrics->serving != 0) return HttpPage::Content{200, "ok\n"};
          return HttpPage::Content{503,
                                   metrics->stalled != 0
                                       ? "work stands still: see the log\n"
                                       : "starting or stopping\n"};
        }}});
  if (!pages.ok()) {
    return absl::Status(pages.status().code(),
                        absl::StrCat("metrics: ", pages.status().message()));
  }
  parts->pages = *std::move(pages);
  return std::unique_ptr<MetricsExposer>(new MetricsExposer(std::move(parts)));
}

MetricsExposer::MetricsExposer(std::unique_ptr<Parts> parts)
    : parts_(std::move(parts)) {}

MetricsExposer::~MetricsExposer() = default;

int MetricsExposer::port() const { return parts_->pages->port(); }

}  // namespace groundlock::app
