// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/process.h"

#ifdef __linux__
#include <pthread.h>
#endif
#ifdef __GLIBC__
#include <malloc.h>
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

void KeepFreedMemory() {
#ifdef __GLIBC__
  // A colour image of 1280 x 720 is 2.6 MiB.
  constexpr int kMaxKeptBlock = 4 << 20;
  constexpr int kMaxKept = 48 << 20;
  mallopt(M_MMAP_THRESHOLD, kMaxKeptBlock);
  mallopt(M_TRIM_THRESHOLD, kMaxKept);
#endif
}

}  // namespace groundlock::base
