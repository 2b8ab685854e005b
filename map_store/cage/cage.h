// SPDX-License-Identifier: Apache-2.0
// What a process that deals with strangers' bytes may still do.
#ifndef GROUNDLOCK_MAP_STORE_CAGE_CAGE_H_
#define GROUNDLOCK_MAP_STORE_CAGE_CAGE_H_

#include <sys/resource.h>

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"

struct sock_filter;  // <linux/filter.h>

namespace groundlock::cage {

// Of one process; nullopt = what this process has. None of them is raised.
struct Limits {
  std::optional<std::uint64_t> memory_bytes;  // of address space
  std::optional<std::uint64_t> cpu_s;         // all threads together
  std::optional<std::uint64_t> open_files;
  std::optional<std::uint64_t> file_bytes;  // of a file that is written
};

enum class Kind {
  // A program of others, which reads and writes files: no sockets, no looking
  // into other processes.
  kProgram,
  // Code that only reckons: memory, threads of its own, reading and writing
  // what is open. Opening a file raises SIGSYS, which the process may answer in
  // the kernel's place; everything else fails with EPERM.
  kDecoder,
};

// Resource limits and a seccomp filter, prepared before they are needed: a
// child may enter between fork and exec, where nothing may be allocated.
// There is no way out, neither by exec nor for what is started inside.
class Cage {
 public:
  // kUnimplemented on architectures without a filter; kInternal.
  static absl::StatusOr<Cage> Create(Kind kind, const Limits& limits);
  Cage(Cage&&) noexcept;
  Cage& operator=(Cage&&) noexcept;
  ~Cage();

  // All threads of this process, or none: 0, or errno. No core dumps, no new
  // privileges, the limits, the filter. Safe between fork and exec, and after
  // it. Address space is not limited under the sanitizers, whose shadows take
  // more than there is.
  int Enter() const;

 private:
  Cage();
  std::vector<std::pair<int, rlimit>> limits_;
  std::vector<sock_filter> filter_;
};

// Of this process's environment, what says where libraries and temporary files
// are and how text and threads are dealt with: no passwords, no addresses.
std::vector<std::string> CleanEnvironment();

// "was ended by signal 11 (Segmentation fault)" or "failed with exit status 3",
// from what waitpid gives.
std::string HowItEnded(int wait_status);

}  // namespace groundlock::cage

#endif  // GROUNDLOCK_MAP_STORE_CAGE_CAGE_H_
