// SPDX-License-Identifier: Apache-2.0
#include "map_store/cage/cage.h"

#include <fcntl.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sched.h>
#include <seccomp.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <memory>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/sanitizers.h"
#include "map_store/base/status.h"

namespace groundlock::cage {
namespace {

using base::kHasShadow;

using Filter =
    std::unique_ptr<std::remove_pointer_t<scmp_filter_ctx>, void (*)(void*)>;

// Rules of a filter under construction; the first failure is kept.
class Rules {
 public:
  explicit Rules(std::uint32_t otherwise)
      : filter_(seccomp_init(otherwise), seccomp_release) {
    if (filter_ == nullptr) {
      error_ = ENOMEM;
      return;
    }
    // Calls by another convention (32 bits, x32) have numbers of their own.
    Keep(seccomp_attr_set(
        filter_.get(), SCMP_FLTATR_ACT_BADARCH, SCMP_ACT_ERRNO(EACCES)));
  }
  void Add(std::uint32_t action,
           const char* call,
           std::initializer_list<scmp_arg_cmp> when = {}) {
    if (filter_ == nullptr) return;
    const int number = seccomp_syscall_resolve_name(call);
    // Negative: of other architectures, or newer than the library.
    if (number < 0) return;
    Keep(seccomp_rule_add_array(filter_.get(),
                                action,
                                number,
                                static_cast<unsigned>(when.size()),
                                std::data(when)));
  }
  absl::StatusOr<std::vector<sock_filter>> Finish() const;

 private:
  void Keep(int result) {
    if (result < 0 && error_ == 0) error_ = -result;
  }
  Filter filter_;
  int error_ = 0;
};

// The library writes a program to a file only.
absl::StatusOr<std::vector<sock_filter>> Rules::Finish() const {
  if (error_ != 0) return absl::ErrnoToStatus(error_, "seccomp filter");
  const int file = memfd_create("filter", MFD_CLOEXEC);
  if (file < 0) return absl::ErrnoToStatus(errno, "seccomp filter");
  std::vector<sock_filter> program;
  int error = -seccomp_export_bpf(filter_.get(), file);
  const off_t size = lseek(file, 0, SEEK_END);
  if (error == 0 && size > 0) {
    program.resize(static_cast<std::size_t>(size) / sizeof(sock_filter));
    if (pread(file, program.data(), static_cast<std::size_t>(size), 0) !=
        size) {
      error = EIO;
    }
  }
  close(file);
  if (error != 0) return absl::ErrnoToStatus(error, "seccomp filter");
  return program;
}

// A program of others needs files, threads and children; who it talks to and
// whom it looks into is no concern of any that decodes or reckons.
absl::StatusOr<std::vector<sock_filter>> ProgramFilter() {
  Rules rules(SCMP_ACT_ALLOW);
  for (const char* call : {"socket",
                           "socketpair",
                           "io_uring_setup",
                           "ptrace",
                           "process_vm_readv",
                           "process_vm_writev",
                           "pidfd_getfd",
                           "bpf",
                           "perf_event_open",
                           "userfaultfd",
                           "add_key",
                           "request_key",
                           "keyctl",
                           "mount",
                           "umount2",
                           "pivot_root",
                           "chroot",
                           "unshare",
                           "setns"}) {
    rules.Add(SCMP_ACT_ERRNO(EACCES), call);
  }
  return rules.Finish();
}

absl::StatusOr<std::vector<sock_filter>> DecoderFilter() {
  Rules rules(SCMP_ACT_ERRNO(EPERM));
  for (const char* call : {"read",
                           "readv",
                           "pread64",
                           "write",
                           "writev",
                           "close",
                           "dup",
                           "lseek",
                           "fstat",
                           "poll",
                           "ppoll",
                           "brk",
                           "munmap",
                           "mremap",
                           "madvise",
                           "futex",
                           "set_robust_list",
                           "rseq",
                           "rt_sigaction",
                           "rt_sigprocmask",
                           "rt_sigreturn",
                           "sigaltstack",
                           "restart_syscall",
                           "exit",
                           "exit_group",
                           "getpid",
                           "gettid",
                           "getuid",
                           "geteuid",
                           "sched_yield",
                           "sched_getaffinity",
                           "clock_gettime",
                           "clock_getres",
                           "clock_nanosleep",
                           "nanosleep",
                           "gettimeofday",
                           "getrandom",
                           "getrusage",
                           "sysinfo",
                           "uname"}) {
    rules.Add(SCMP_ACT_ALLOW, call);
  }
  // Memory that is executed was there before.
  for (const char* call : {"mmap", "mprotect"}) {
    rules.Add(
        SCMP_ACT_ALLOW, call, {SCMP_A2(SCMP_CMP_MASKED_EQ, PROT_EXEC, 0)});
  }
  // What is open may be looked at; no path.
  rules.Add(SCMP_ACT_ALLOW,
            "newfstatat",
            {SCMP_A3(SCMP_CMP_MASKED_EQ, AT_EMPTY_PATH, AT_EMPTY_PATH)});
  // Threads of its own. The flags of clone3 lie in memory, where no filter
  // sees them; told that there is none, the C library takes clone.
  rules.Add(SCMP_ACT_ALLOW,
            "clone",
            {SCMP_A0(SCMP_CMP_MASKED_EQ, CLONE_THREAD, CLONE_THREAD)});
  rules.Add(SCMP_ACT_ERRNO(ENOSYS), "clone3");
  rules.Add(SCMP_ACT_ALLOW,
            "prlimit64",
            {SCMP_A2(SCMP_CMP_EQ, 0, 0)});  // asking only
  rules.Add(SCMP_ACT_TRAP, "openat");
  // The sanitizers try memory through a pipe.
  if (kHasShadow) {
    rules.Add(SCMP_ACT_ALLOW, "pipe");
    rules.Add(SCMP_ACT_ALLOW, "pipe2");
  }
  return rules.Finish();
}

}  // namespace

Cage::Cage() = default;
Cage::Cage(Cage&&) noexcept = default;
Cage& Cage::operator=(Cage&&) noexcept = default;
Cage::~Cage() = default;

absl::StatusOr<Cage> Cage::Create(Kind kind, const Limits& limits) {
  Cage cage;
  const auto limit = [&cage](int resource, std::optional<std::uint64_t> most) {
    if (!most) return;
    rlimit now{};
    getrlimit(static_cast<__rlimit_resource_t>(resource), &now);
    const rlim_t lowest = std::min<rlim_t>(*most, now.rlim_max);
    cage.limits_.emplace_back(resource, rlimit{lowest, lowest});
  };
  limit(RLIMIT_CORE, 0);
  limit(RLIMIT_CPU, limits.cpu_s);
  limit(RLIMIT_NOFILE, limits.open_files);
  limit(RLIMIT_FSIZE, limits.file_bytes);
  if (!kHasShadow) limit(RLIMIT_AS, limits.memory_bytes);
  ASSIGN_OR_RETURN(cage.filter_,
                   kind == Kind::kProgram ? ProgramFilter() : DecoderFilter());
  return cage;
}

int Cage::Enter() const {
  for (const auto& [resource, value] : limits_) {
    if (setrlimit(static_cast<__rlimit_resource_t>(resource), &value) != 0) {
      return errno;
    }
  }
  if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) return errno;
  const sock_fprog program{static_cast<unsigned short>(filter_.size()),
                           const_cast<sock_filter*>(filter_.data())};
  const long result = syscall(SYS_seccomp,
                              SECCOMP_SET_MODE_FILTER,
                              SECCOMP_FILTER_FLAG_TSYNC,
                              &program);
  if (result < 0) return errno;
  return result == 0 ? 0 : EBUSY;  // the thread that cannot follow
}

std::vector<std::string> CleanEnvironment() {
  constexpr std::array<std::string_view, 7> kNames = {
      "PATH", "HOME", "USER", "TMPDIR", "LANG", "TZ", "LD_LIBRARY_PATH"};
  constexpr std::array<std::string_view, 9> kPrefixes = {"LC_",
                                                         "QT_",
                                                         "OMP_",
                                                         "OPENBLAS_",
                                                         "OPENCV_",
                                                         "MKL_",
                                                         "CUDA_",
                                                         "MALLOC_",
                                                         "COLMAP_"};
  std::vector<std::string> environment;
  for (char** entry = environ; *entry != nullptr; ++entry) {
    const std::string_view text = *entry;
    const std::string_view name = text.substr(0, text.find('='));
    const bool passes =
        std::find(kNames.begin(), kNames.end(), name) != kNames.end() ||
        std::any_of(kPrefixes.begin(), kPrefixes.end(), [&](auto prefix) {
          return name.starts_with(prefix);
        });
    if (passes) environment.emplace_back(text);
  }
  return environment;
}

std::string HowItEnded(int wait_status) {
  if (WIFEXITED(wait_status)) {
    return absl::StrCat("failed with exit status ", WEXITSTATUS(wait_status));
  }
  const int signal = WTERMSIG(wait_status);
  const char* name = sigdescr_np(signal);
  return absl::StrCat("was ended by signal ",
                      signal,
                      " (",
                      name == nullptr ? "unknown" : name,
                      ")");
}

}  // namespace groundlock::cage
