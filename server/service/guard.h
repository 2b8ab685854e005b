// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_SERVER_SERVICE_GUARD_H_
#define GROUNDLOCK_SERVER_SERVICE_GUARD_H_

#include <exception>
#include <new>
#include <utility>

#include "absl/status/status.h"

namespace groundlock::service {

// No exception of third-party code leaves a handler.
template <typename Work>
absl::Status Guard(Work&& work) {
  try {
    return std::forward<Work>(work)();
  } catch (const std::bad_alloc&) {
    return absl::ResourceExhaustedError("out of memory");
  } catch (const std::exception& error) {
    return absl::InternalError(error.what());
  }
}

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_GUARD_H_
