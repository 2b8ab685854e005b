// SPDX-License-Identifier: Apache-2.0
// Lets the thread sanitizer see how Debian's gRPC and abseil hand things from
// thread to thread: both are built without it, abseil waits on futexes and gRPC
// passes completions through queues without locks, of which it knows nothing.
// The program's definitions come before those of the libraries, tell what is
// handed over, and go on to the library's own:
//   - a lock hands over what was done before it was released (absl::Mutex),
//   - a batch of a call hands over to whoever is told of its completion,
//   - all callbacks of a call hand over to the last one,
// What a status holds is not looked at when it is let go (absl::Status).
// Linked into tests that are built with the thread sanitizer, only into these.
#include <dlfcn.h>
#include <grpc/grpc.h>
#include <grpcpp/support/server_callback.h>
#include <link.h>
#include <sanitizer/tsan_interface.h>

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <mutex>
#include <unordered_map>

#include "absl/status/status.h"
#include "absl/synchronization/mutex.h"

extern "C" {
void AnnotateIgnoreReadsBegin(const char* file, int line);
void AnnotateIgnoreReadsEnd(const char* file, int line);
void AnnotateIgnoreWritesBegin(const char* file, int line);
void AnnotateIgnoreWritesEnd(const char* file, int line);
}

namespace {

// The library's own function of the name, as it is mangled there.
template <typename Function>
Function* Library(const char* mangled) {
  void* found = dlsym(RTLD_NEXT, mangled);
  if (found == nullptr) std::abort();
  return reinterpret_cast<Function*>(found);
}

using RunFunctor = void(grpc_completion_queue_functor*, int);

// Whether the address lies in a program's or library's code.
bool IsCode(const void* address) {
  const auto holds = [](dl_phdr_info* info, std::size_t, void* data) {
    const auto at = reinterpret_cast<std::uintptr_t>(data);
    for (int i = 0; i < info->dlpi_phnum; ++i) {
      const ElfW(Phdr)& segment = info->dlpi_phdr[i];
      const std::uintptr_t begin = info->dlpi_addr + segment.p_vaddr;
      if (segment.p_type == PT_LOAD && (segment.p_flags & PF_X) != 0 &&
          at >= begin && at < begin + segment.p_memsz) {
        return 1;
      }
    }
    return 0;
  };
  return dl_iterate_phdr(holds, const_cast<void*>(address)) != 0;
}

// What a functor ran before RunSeen was put in its place.
class Replaced {
 public:
  static Replaced& Instance() {
    static auto* const replaced = new Replaced;
    return *replaced;
  }
  void Replace(grpc_completion_queue_functor* functor, RunFunctor* run) {
    const std::lock_guard lock(mutex_);
    if (functor->functor_run == run) return;
    runs_[functor] = functor->functor_run;
    functor->functor_run = run;
  }
  RunFunctor* Find(grpc_completion_queue_functor* functor) {
    const std::lock_guard lock(mutex_);
    return runs_.at(functor);
  }

 private:
  std::mutex mutex_;
  std::unordered_map<grpc_completion_queue_functor*, RunFunctor*> runs_;
};

void RunSeen(grpc_completion_queue_functor* functor, int ok) {
  __tsan_acquire(functor);
  Replaced::Instance().Find(functor)(functor, ok);
}

}  // namespace

extern "C" {

// `tag` is a functor where a callback is told of the completion: its first word
// is the address of a function. Else it is an object with a table of such.
grpc_call_error grpc_call_start_batch(grpc_call* call,
                                      const grpc_op* ops,
                                      size_t nops,
                                      void* tag,
                                      void* reserved) {
  static auto* const library =
      Library<decltype(grpc_call_start_batch)>("grpc_call_start_batch");
  if (tag != nullptr && IsCode(*static_cast<void**>(tag))) {
    Replaced::Instance().Replace(
        static_cast<grpc_completion_queue_functor*>(tag), RunSeen);
  }
  __tsan_release(tag);
  return library(call, ops, nops, tag, reserved);
}

grpc_event grpc_completion_queue_pluck(grpc_completion_queue* queue,
                                       void* tag,
                                       gpr_timespec deadline,
                                       void* reserved) {
  static auto* const library = Library<decltype(grpc_completion_queue_pluck)>(
      "grpc_completion_queue_pluck");
  const grpc_event event = library(queue, tag, deadline, reserved);
  if (event.type == GRPC_OP_COMPLETE) __tsan_acquire(event.tag);
  return event;
}

}  // extern "C"

// Comes last, when all other callbacks of the call have returned. They count
// down here, or in the library's own copy of the same inline function, which
// the sanitizer cannot see.
void grpc::internal::ServerCallbackCall::ScheduleOnDone(bool inline_ondone) {
  static auto* const library = Library<void(ServerCallbackCall*, bool)>(
      "_ZN4grpc8internal18ServerCallbackCall14ScheduleOnDoneEb");
  callbacks_outstanding_.load(std::memory_order_acquire);
  __tsan_acquire(this);
  library(this, inline_ondone);
}

// The library calls OnCancel on a thread of its own and counts down there.
void grpc::internal::ServerCallbackCall::CallOnCancel(ServerReactor* reactor) {
  static auto* const library =
      Library<void(ServerCallbackCall*, ServerReactor*)>(
          "_ZN4grpc8internal18ServerCallbackCall12CallOnCancelEPNS0_"
          "13ServerReactorE");
  // Stands in for the reactor in this one call, after which the library does
  // not touch it again.
  class Seen : public ServerReactor {
   public:
    Seen(ServerCallbackCall* call, ServerReactor* reactor)
        : call_(call), reactor_(reactor) {}
    void OnDone() override { std::abort(); }
    void OnCancel() override {
      reactor_->OnCancel();
      __tsan_release(call_);
      delete this;
    }
    bool InternalInlineable() override {
      return reactor_->InternalInlineable();
    }

   private:
    ServerCallbackCall* const call_;
    ServerReactor* const reactor_;
  };
  library(this, new Seen(this, reactor));
}

namespace absl {
ABSL_NAMESPACE_BEGIN

void Mutex::Lock() {
  static auto* const library =
      Library<void(Mutex*)>("_ZN4absl7debian35Mutex4LockEv");
  library(this);
  __tsan_acquire(this);
}

bool Mutex::TryLock() {
  static auto* const library =
      Library<bool(Mutex*)>("_ZN4absl7debian35Mutex7TryLockEv");
  const bool locked = library(this);
  if (locked) __tsan_acquire(this);
  return locked;
}

void Mutex::Unlock() {
  static auto* const library =
      Library<void(Mutex*)>("_ZN4absl7debian35Mutex6UnlockEv");
  __tsan_release(this);
  library(this);
}

void Mutex::ReaderLock() {
  static auto* const library =
      Library<void(Mutex*)>("_ZN4absl7debian35Mutex10ReaderLockEv");
  library(this);
  __tsan_acquire(this);
}

void Mutex::ReaderUnlock() {
  static auto* const library =
      Library<void(Mutex*)>("_ZN4absl7debian35Mutex12ReaderUnlockEv");
  __tsan_release(this);
  library(this);
}

void CondVar::Wait(Mutex* mutex) {
  static auto* const library = Library<void(CondVar*, Mutex*)>(
      "_ZN4absl7debian37CondVar4WaitEPNS0_5MutexE");
  __tsan_release(mutex);
  library(this, mutex);
  __tsan_acquire(mutex);
}

bool CondVar::WaitWithTimeout(Mutex* mutex, Duration timeout) {
  static auto* const library = Library<bool(CondVar*, Mutex*, Duration)>(
      "_ZN4absl7debian37CondVar15WaitWithTimeoutEPNS0_5MutexENS0_8DurationE");
  __tsan_release(mutex);
  const bool late = library(this, mutex, timeout);
  __tsan_acquire(mutex);
  return late;
}

bool CondVar::WaitWithDeadline(Mutex* mutex, Time deadline) {
  static auto* const library = Library<bool(CondVar*, Mutex*, Time)>(
      "_ZN4absl7debian37CondVar16WaitWithDeadlineEPNS0_5MutexENS0_4TimeE");
  __tsan_release(mutex);
  const bool late = library(this, mutex, deadline);
  __tsan_acquire(mutex);
  return late;
}

// The last holder seems to delete what another one still reads, and what gRPC
// wrote on another thread: the references are counted where the sanitizer
// cannot see it, and the destructors of what a status holds may be this
// program's.
void Status::UnrefNonInlined(std::uintptr_t rep) {
  static auto* const library = Library<void(std::uintptr_t)>(
      "_ZN4absl7debian36Status15UnrefNonInlinedEm");
  AnnotateIgnoreReadsBegin(__FILE__, __LINE__);
  AnnotateIgnoreWritesBegin(__FILE__, __LINE__);
  library(rep);
  AnnotateIgnoreWritesEnd(__FILE__, __LINE__);
  AnnotateIgnoreReadsEnd(__FILE__, __LINE__);
}

ABSL_NAMESPACE_END
}  // namespace absl
