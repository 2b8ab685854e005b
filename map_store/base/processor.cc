// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/processor.h"

#include <cstdlib>
#include <string_view>

namespace groundlock::base {
namespace {

// In rising order: each has what those before it have.
enum class Instructions { kBaseline, kAvx2, kAvx512 };

Instructions OfTheProcessor() {
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx2") == 0) return Instructions::kBaseline;
  if (__builtin_cpu_supports("avx512f") != 0 &&
      __builtin_cpu_supports("avx512bw") != 0 &&
      __builtin_cpu_supports("avx512vnni") != 0) {
    return Instructions::kAvx512;
  }
  return Instructions::kAvx2;
#else
  return Instructions::kBaseline;
#endif
}

Instructions Bound() {
  const char* const bound = std::getenv("GROUNDLOCK_INSTRUCTIONS");
  const std::string_view name = bound == nullptr ? "" : bound;
  if (name == "baseline") return Instructions::kBaseline;
  if (name == "avx2") return Instructions::kAvx2;
  return Instructions::kAvx512;
}

bool MayUse(Instructions wanted) {
  static const Instructions of_the_processor = OfTheProcessor();
  static const Instructions bound = Bound();
  return wanted <= of_the_processor && wanted <= bound;
}

}  // namespace

bool MayUseAvx2() { return MayUse(Instructions::kAvx2); }
bool MayUseAvx512() { return MayUse(Instructions::kAvx512); }

}  // namespace groundlock::base
