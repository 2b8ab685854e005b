// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/dashboard_metrics.h"

#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include <vector>

#include "absl/strings/str_cat.h"
#include "client/dashboard/proxy/core.h"
#include "map_store/base/single_metric.h"

namespace groundlock::dashboard {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

}  // namespace

std::string MetricsText(const Core& core) {
  std::vector<MetricFamily> families;
  const auto gauge = [&families](
                         const char* name, const char* help, double value) {
    families.push_back(
        base::SingleMetric(name, help, MetricType::Gauge, value));
  };
  const auto counter = [&families](const char* name,
                                   const char* help,
                                   const std::atomic<std::uint64_t>& value) {
    families.push_back(base::SingleMetric(
        name, help, MetricType::Counter, static_cast<double>(value.load())));
  };
  const DashboardCounters& counters = core.counters;
  gauge(
      "groundlock_dashboard_server_connected",
      "1 while the Groundlock server answers, else 0.",
      core.catalogue->server_state().state() == pb::ServerState::STATE_CONNECTED
          ? 1.0
          : 0.0);
  gauge("groundlock_dashboard_connections",
        "HTTP connections now.",
        core.connections);
  gauge("groundlock_dashboard_viewers",
        "Pages that are connected now.",
        static_cast<double>(core.audience.size()));
  gauge("groundlock_dashboard_feeds",
        "Sessions that are watched for pages now.",
        static_cast<double>(core.feeds->size()));
  gauge("groundlock_dashboard_sources",
        "Sessions that are fed by the dashboard now.",
        static_cast<double>(core.runs->num_working()));
  gauge("groundlock_dashboard_map_jobs",
        "Imports and builds of maps under way for pages.",
        static_cast<double>(core.jobs->num_working()));
  MetricFamily answers{"groundlock_dashboard_answers_total",
                       "Answers to HTTP requests, by their status.",
                       MetricType::Counter,
                       {}};
  for (std::size_t i = 1; i < counters.answers.size(); ++i) {
    ClientMetric metric;
    metric.label.push_back({"status", absl::StrCat(i, "xx")});
    metric.counter.value = static_cast<double>(counters.answers[i].load());
    answers.metric.push_back(metric);
  }
  families.push_back(std::move(answers));
  counter("groundlock_dashboard_messages_sent_total",
          "Messages sent to pages.",
          counters.messages_sent);
  counter("groundlock_dashboard_bytes_sent_total",
          "Their bytes.",
          counters.bytes_sent);
  counter("groundlock_dashboard_results_left_out_total",
          "Results that pages were too slow for.",
          counters.results_left_out);
  counter("groundlock_dashboard_images_left_out_total",
          "Images that pages were too slow for.",
          counters.images_left_out);
  counter("groundlock_dashboard_viewers_stalled_total",
          "Pages that took nothing and were disconnected.",
          counters.viewers_stalled);
  return prometheus::TextSerializer().Serialize(families);
}

}  // namespace groundlock::dashboard
