// SPDX-License-Identifier: Apache-2.0
// Which instructions the kernels may use beyond those that every machine of the
// architecture has. Results are the same to the bit with any of them.
#ifndef GROUNDLOCK_MAP_STORE_BASE_PROCESSOR_H_
#define GROUNDLOCK_MAP_STORE_BASE_PROCESSOR_H_

namespace groundlock::base {

// Both answer from what the processor has, bounded by the environment variable
// GROUNDLOCK_INSTRUCTIONS ("baseline" or "avx2"), which tests use to take the
// narrower paths. It is read once, at the first call; an unknown value
// bounds nothing. Thread-safe.
bool MayUseAvx2();  // never on arm64
// Those that multiply bytes and add them up by fours: AVX-512's VNNI (with the
// foundation, bytes and words), arm64's dot products (from Armv8.4 on always).
bool MayUseByteProducts();

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_PROCESSOR_H_
