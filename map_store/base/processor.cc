// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/processor.h"

#include <cstdlib>
#include <string_view>

#if defined(__aarch64__)
#include <sys/auxv.h>
#endif

namespace groundlock::base {
namespace {

// In rising order: each has what those before it have.
enum class Instructions { kBaseline, kAvx2, kByteProducts };

Instructions OfTheProcessor() {
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx2") == 0) return Instructions::kBaseline;
  if (__builtin_cpu_supports("avx512f") != 0 &&
      __builtin_cpu_supports("avx512bw") != 0 &&
      __builtin_cpu_supports("avx512vnni") != 0) {
    return Instructions::kByteProducts;
  }
  return Instructions::kAvx2;
#elif defined(__aarch64__)
  return (getauxval(AT_HWCAP) & HWCAP_ASIMDDP) != 0
             ? Instructions::kByteProducts
             : Instructions::kBaseline;
#else
  return Instructions::kBaseline;
#endif
}

Instructions Bound() {
  const char* const bound = std::getenv("GROUNDLOCK_INSTRUCTIONS");
  const std::string_view name = bound == nullptr ? "" : bound;
  if (name == "baseline") return Instructions::kBaseline;
  if (name == "avx2") return Instructions::kAvx2;
  return Instructions::kByteProducts;
}

bool MayUse(Instructions wanted) {
  static const Instructions of_the_processor = OfTheProcessor();
  static const Instructions bound = Bound();
  return wanted <= of_the_processor && wanted <= bound;
}

}  // namespace

bool MayUseAvx2() { return MayUse(Instructions::kAvx2); }
bool MayUseByteProducts() { return MayUse(Instructions::kByteProducts); }

}  // namespace groundlock::base
