// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_BASE_LOOPBACK_H_
#define GROUNDLOCK_MAP_STORE_BASE_LOOPBACK_H_

#include <string_view>

namespace groundlock::base {

// Whether only this machine reaches a server at the address HOST:PORT (or
// unix:PATH). Names other than localhost are not resolved, and are anybody's.
bool IsLoopback(std::string_view address);

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_LOOPBACK_H_
