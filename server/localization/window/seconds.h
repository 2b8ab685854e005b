// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_WINDOW_SECONDS_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_WINDOW_SECONDS_H_

#include <chrono>

namespace groundlock::localization {

inline double Seconds(std::chrono::nanoseconds duration) {
  return std::chrono::duration<double>(duration).count();
}

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_WINDOW_SECONDS_H_
