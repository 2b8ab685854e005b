// SPDX-License-Identifier: Apache-2.0
#include "tests/support/allocation_counter.h"

#include <malloc.h>

#include <atomic>
#include <cerrno>
#include <cstddef>

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__) && \
    defined(__GLIBC__)
#define GROUNDLOCK_COUNTS_ALLOCATIONS 1
#else
#define GROUNDLOCK_COUNTS_ALLOCATIONS 0
#endif

namespace {

std::atomic<std::uint64_t> allocations{0};

}  // namespace

#if GROUNDLOCK_COUNTS_ALLOCATIONS
// glibc lets a program replace these, and keeps its own under other names.
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* block, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);

void* malloc(std::size_t size) {
  allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}

void* calloc(std::size_t count, std::size_t size) {
  allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_calloc(count, size);
}

void* realloc(void* block, std::size_t size) {
  allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_realloc(block, size);
}

void* aligned_alloc(std::size_t alignment, std::size_t size) {
  allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_memalign(alignment, size);
}

int posix_memalign(void** block, std::size_t alignment, std::size_t size) {
  allocations.fetch_add(1, std::memory_order_relaxed);
  *block = __libc_memalign(alignment, size);
  return *block != nullptr ? 0 : ENOMEM;
}
}  // extern "C"
#endif

namespace groundlock::test_support {

bool AllocationsAreCounted() { return GROUNDLOCK_COUNTS_ALLOCATIONS != 0; }

std::uint64_t AllocationCount() {
  return allocations.load(std::memory_order_relaxed);
}

std::uint64_t HeapBytesInUse() {
  const struct mallinfo2 info = ::mallinfo2();
  return info.uordblks + info.hblkhd;
}

}  // namespace groundlock::test_support
