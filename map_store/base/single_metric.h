// SPDX-License-Identifier: Apache-2.0
// A metric of one value, without labels, for a Prometheus endpoint.
#ifndef GROUNDLOCK_MAP_STORE_BASE_SINGLE_METRIC_H_
#define GROUNDLOCK_MAP_STORE_BASE_SINGLE_METRIC_H_

#include <prometheus/metric_family.h>

namespace groundlock::base {

// type: a counter or a gauge.
inline prometheus::MetricFamily SingleMetric(const char* name,
                                             const char* help,
                                             prometheus::MetricType type,
                                             double value) {
  prometheus::ClientMetric metric;
  metric.counter.value = value;
  metric.gauge.value = value;
  return {name, help, type, {metric}};
}

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_SINGLE_METRIC_H_
