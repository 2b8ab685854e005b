// SPDX-License-Identifier: Apache-2.0
// A program of ours as a child, and what it costs.
#ifndef GROUNDLOCK_TESTS_BENCH_CHILD_PROGRAM_H_
#define GROUNDLOCK_TESTS_BENCH_CHILD_PROGRAM_H_

#include <sys/types.h>

#include <filesystem>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace groundlock::bench {

// Ended with this object; its output goes to a file. Not thread-safe.
class ChildProgram {
 public:
  ChildProgram(std::vector<std::string> arguments,
               const std::filesystem::path& log);
  ~ChildProgram();
  ChildProgram(const ChildProgram&) = delete;
  ChildProgram& operator=(const ChildProgram&) = delete;

  // 0: it ended well.
  int Wait();
  // Of all its threads, since its start.
  double CpuSeconds() const;
  double ResidentMib() const;
  int NumThreads() const;
  int NumOpenFiles() const;

 private:
  pid_t pid_ = 0;
};

// What a program has written to its --port-file; waits for half a minute.
absl::StatusOr<std::string> PortIn(const std::filesystem::path& file);

}  // namespace groundlock::bench

#endif  // GROUNDLOCK_TESTS_BENCH_CHILD_PROGRAM_H_
