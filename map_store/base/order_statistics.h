// SPDX-License-Identifier: Apache-2.0
// Medians and quantiles of values in no order. Thread-safe.
#ifndef GROUNDLOCK_MAP_STORE_BASE_ORDER_STATISTICS_H_
#define GROUNDLOCK_MAP_STORE_BASE_ORDER_STATISTICS_H_

#include <algorithm>
#include <cstddef>
#include <vector>

namespace groundlock::base {

// The value above which lies 1 - share of the others, 0 <= share <= 1; one of
// the values. 0 if there are none.
inline double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(
                           share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

// The upper one of the two in the middle if their number is even.
inline double Median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle =
      values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_ORDER_STATISTICS_H_
