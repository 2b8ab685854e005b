// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/process.h"

#ifdef __linux__
#include <pthread.h>
#endif

namespace groundlock::base {

#ifdef __linux__
void NameThisThread(const std::string& name) {
  constexpr std::size_t kMaxCharacters = 15;
  pthread_setname_np(pthread_self(), name.substr(0, kMaxCharacters).c_str());
}
#else
void NameThisThread(const std::string&) {}
#endif

}  // namespace groundlock::base
