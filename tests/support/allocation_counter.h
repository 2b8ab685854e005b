// SPDX-License-Identifier: Apache-2.0
// How often the process asks for memory.
#ifndef GROUNDLOCK_TESTS_SUPPORT_ALLOCATION_COUNTER_H_
#define GROUNDLOCK_TESTS_SUPPORT_ALLOCATION_COUNTER_H_

#include <cstdint>

namespace groundlock::test_support {

// A program that links this library has its malloc, calloc, realloc,
// posix_memalign and aligned_alloc counted, whoever calls them: operator new,
// Eigen and OpenCV's matrices all end there. Sanitizers bring allocators of
// their own; under them nothing is counted.
bool AllocationsAreCounted();

// Calls so far, of all threads. Thread-safe.
std::uint64_t AllocationCount();

// Bytes in use on the heap. Thread-safe.
std::uint64_t HeapBytesInUse();

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_ALLOCATION_COUNTER_H_
