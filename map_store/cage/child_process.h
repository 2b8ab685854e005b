// SPDX-License-Identifier: Apache-2.0
// Programs of others as child processes, without a shell.
#ifndef GROUNDLOCK_MAP_STORE_CAGE_CHILD_PROCESS_H_
#define GROUNDLOCK_MAP_STORE_CAGE_CHILD_PROCESS_H_

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"

namespace groundlock::cage {

struct ChildProcessOptions {
  // The program, looked for in $PATH unless it has a '/', and its arguments.
  std::vector<std::string> arguments;
  // What it prints is appended here.
  std::filesystem::path log;
  int niceness = 0;  // added to ours
  // Address space that each of its processes may take; 0 = as much as the
  // machine has memory, at least 4 GiB.
  std::uint64_t memory_bytes = 0;
  // Called with each line that it prints, without the line's end.
  std::function<void(std::string_view line)> on_line;
  // Asked several times a second; true ends the child.
  std::function<bool()> is_cancelled;
};

// Runs the program to its end, in a process group of its own. When cancelled,
// the group is asked to end (SIGTERM), two seconds later killed; if this
// process dies, the kernel kills the child.
//
// What it reads comes from strangers, so it runs in a cage (cage.h) and gets no
// more than it needs: of our environment what says where programs, libraries
// and temporary files are and how text and threads are dealt with, no
// passwords; no sockets; no privileges that we do not have; bounded memory and
// files. How long it runs is bounded by who cancels.
// kNotFound if there is no such program; kFailedPrecondition: a kernel without
// seccomp; kCancelled; kInternal says how it ended and quotes the last lines
// that it printed.
absl::Status RunChildProcess(const ChildProcessOptions& options);

}  // namespace groundlock::cage

#endif  // GROUNDLOCK_MAP_STORE_CAGE_CHILD_PROCESS_H_
