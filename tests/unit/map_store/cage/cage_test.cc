// SPDX-License-Identifier: Apache-2.0
// Processes that enter the cage and then try what it forbids.
#include "map_store/cage/cage.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/ptrace.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <functional>
#include <future>
#include <thread>

#include "map_store/base/sanitizers.h"

namespace groundlock::cage {
namespace {

using ::testing::Contains;
using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr int kNoCage = 99;

// What `action` returns in a process of its own inside the cage; as waitpid
// says it.
int Inside(Kind kind,
           const Limits& limits,
           const std::function<int()>& action) {
  const auto cage = Cage::Create(kind, limits);
  EXPECT_TRUE(cage.ok()) << cage.status();
  const pid_t child = fork();
  if (child == 0) {
    if (!cage.ok() || cage->Enter() != 0) _exit(kNoCage);
    _exit(action());
  }
  int status = -1;
  EXPECT_EQ(waitpid(child, &status, 0), child);
  return status;
}

// The exit status: 0 if the call fails with `error`, else what it says.
int Expect(long result, int error) {
  if (result >= 0) return 98;
  return errno == error ? 0 : errno;
}

int TryToConnect(int error) {
  const int tcp = Expect(socket(AF_INET, SOCK_STREAM, 0), error);
  const int udp = Expect(socket(AF_INET6, SOCK_DGRAM, 0), error);
  const int local = Expect(socket(AF_UNIX, SOCK_STREAM, 0), error);
  const int raw = Expect(socket(AF_NETLINK, SOCK_RAW, 0), error);
  const int ring = Expect(syscall(SYS_io_uring_setup, 1, nullptr), error);
  return tcp | udp | local | raw | ring;
}

TEST(Cage, NeitherKindHasSockets) {
  EXPECT_EQ(Inside(Kind::kDecoder, {}, [] { return TryToConnect(EPERM); }), 0);
  EXPECT_EQ(Inside(Kind::kProgram, {}, [] { return TryToConnect(EACCES); }), 0);
}

TEST(Cage, ADecoderReachesNoFilesAndNoOtherProcesses) {
  const pid_t parent = getpid();
  EXPECT_EQ(
      Inside(Kind::kDecoder,
             {},
             [&] {
               char* const argv[] = {nullptr};
               iovec piece{};
               return Expect(syscall(SYS_open, "/etc/passwd", O_RDONLY),
                             EPERM) |
                      Expect(unlink("/tmp/none"), EPERM) |
                      Expect(execve("/bin/true", argv, argv), EPERM) |
                      Expect(kill(parent, 0), EPERM) |
                      Expect(ptrace(PTRACE_ATTACH, parent, 0, 0), EPERM) |
                      Expect(process_vm_readv(parent, &piece, 1, &piece, 1, 0),
                             EPERM) |
                      Expect(syscall(SYS_fork), EPERM) |
                      Expect(syscall(SYS_clone, SIGCHLD, 0, 0, 0, 0), EPERM);
             }),
      0);
}

TEST(Cage, ADecoderMakesNoCode) {
  EXPECT_EQ(Inside(Kind::kDecoder,
                   {},
                   [] {
                     const auto map = [](int protection) {
                       return mmap(nullptr,
                                   4'096,
                                   protection,
                                   MAP_PRIVATE | MAP_ANONYMOUS,
                                   -1,
                                   0);
                     };
                     void* const page = map(PROT_READ | PROT_WRITE);
                     if (page == MAP_FAILED) return 1;
                     if (map(PROT_READ | PROT_EXEC) != MAP_FAILED) return 2;
                     return Expect(mprotect(page, 4'096, PROT_EXEC), EPERM);
                   }),
            0);
}

TEST(Cage, OpeningAFileIsASignal) {
  const int status = Inside(Kind::kDecoder, {}, [] {
    open("/etc/passwd", O_RDONLY);
    return 0;
  });
  ASSERT_TRUE(WIFSIGNALED(status)) << status;
  EXPECT_EQ(WTERMSIG(status), SIGSYS);
  EXPECT_THAT(HowItEnded(status), HasSubstr("signal 31 (Bad system call)"));
}

TEST(Cage, AProgramLooksIntoNobody) {
  const pid_t parent = getpid();
  EXPECT_EQ(
      Inside(Kind::kProgram,
             {},
             [&] {
               iovec piece{};
               return Expect(ptrace(PTRACE_ATTACH, parent, 0, 0), EACCES) |
                      Expect(process_vm_readv(parent, &piece, 1, &piece, 1, 0),
                             EACCES) |
                      (open("/dev/null", O_RDONLY) >= 0 ? 0 : 97);
             }),
      0);
}

TEST(Cage, MemoryFilesAndTimeAreBounded) {
#if !defined(GROUNDLOCK_HAS_SHADOW)
  EXPECT_EQ(Inside(Kind::kProgram,
                   {.memory_bytes = std::uint64_t{1} << 30,
                    .cpu_s = std::nullopt,
                    .open_files = std::nullopt,
                    .file_bytes = std::nullopt},
                   [] {
                     // A pointer that the compiler cannot do without.
                     void* volatile memory = std::malloc(std::size_t{2} << 30);
                     return memory == nullptr ? 0 : 1;
                   }),
            0);
#endif
  EXPECT_EQ(Inside(Kind::kProgram,
                   {.memory_bytes = std::nullopt,
                    .cpu_s = std::nullopt,
                    .open_files = 3,
                    .file_bytes = std::nullopt},
                   [] { return Expect(open("/dev/null", O_RDONLY), EMFILE); }),
            0);
  const int spinning = Inside(Kind::kDecoder,
                              {.memory_bytes = std::nullopt,
                               .cpu_s = 1,
                               .open_files = std::nullopt,
                               .file_bytes = std::nullopt},
                              [] {
                                for (;;) getpid();
                                return 0;
                              });
  ASSERT_TRUE(WIFSIGNALED(spinning)) << spinning;
}

TEST(Cage, AFileThatGrowsTooLargeEndsItsWriter) {
  char name[] = "/tmp/groundlock_cage_XXXXXX";
  const int file = mkstemp(name);
  ASSERT_GE(file, 0);
  const int status = Inside(Kind::kProgram,
                            {.memory_bytes = std::nullopt,
                             .cpu_s = std::nullopt,
                             .open_files = std::nullopt,
                             .file_bytes = 4},
                            [&] {
                              const ssize_t first = write(file, "1234", 4);
                              return write(file, "5", 1) + first == 4 ? 1 : 2;
                            });
  EXPECT_TRUE(WIFSIGNALED(status) && WTERMSIG(status) == SIGXFSZ) << status;
  close(file);
  unlink(name);
}

TEST(Cage, HoldsThreadsThatWereThereBefore) {
  const auto cage = Cage::Create(Kind::kProgram, {});
  ASSERT_TRUE(cage.ok()) << cage.status();
  const pid_t child = fork();
  if (child == 0) {
    std::promise<void> entered;
    std::promise<int> tried;
    std::thread other([&] {
      entered.get_future().wait();
      tried.set_value(TryToConnect(EACCES));
    });
    const bool is_in = cage->Enter() == 0;
    entered.set_value();
    const int result = tried.get_future().get();
    other.join();
    _exit(is_in ? result : kNoCage);
  }
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
}

TEST(Cage, TheEnvironmentHoldsNoSecrets) {
  setenv("PGPASSWORD", "secret", 1);
  setenv("GROUNDLOCK_STORE", "postgresql://user:secret@host/", 1);
  setenv("LC_TIME", "C", 1);
  const std::vector<std::string> environment = CleanEnvironment();
  EXPECT_THAT(environment, Each(Not(HasSubstr("secret"))));
  EXPECT_THAT(environment, Contains("LC_TIME=C"));
}

}  // namespace
}  // namespace groundlock::cage
