// SPDX-License-Identifier: Apache-2.0
// A server of the program's own, for a person who has started none.
#ifndef GROUNDLOCK_CLIENT_CLI_LOCAL_SERVER_H_
#define GROUNDLOCK_CLIENT_CLI_LOCAL_SERVER_H_

#include <sys/types.h>

#include <filesystem>
#include <functional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::cli {

// Where a person's own maps are: groundlock/ in $XDG_DATA_HOME, or in
// ~/.local/share. kFailedPrecondition if neither that nor $HOME is set.
absl::StatusOr<std::filesystem::path> UserDataFolder();

// Whether anything accepts connections on that port of the loopback address.
// A refusal is known at once, without gRPC's attempts to try again.
bool LoopbackAnswers(int port);

// groundlock-server as a child process that lives as long as this object, on a
// free port of the loopback address, with its maps in the user's data folder.
// Programs that run at the same time may each have one: they share the store.
// To be used from one thread, which must outlive the server: the kernel ends
// the server with the thread that started it.
class LocalServer {
 public:
  LocalServer() = default;
  ~LocalServer();  // asks it to end, and waits
  LocalServer(const LocalServer&) = delete;
  LocalServer& operator=(const LocalServer&) = delete;

  // Starts it, unless it runs already, and returns its HOST:PORT.
  //   is_cancelled  is asked several times a second while it starts.
  // kNotFound: there is no groundlock-server beside this program or in $PATH.
  // kUnavailable: it ended or took too long; names its log. kCancelled.
  absl::StatusOr<std::string> Start(const std::function<bool()>& is_cancelled);

  bool running() const { return child_ > 0; }
  const std::filesystem::path& store() const { return store_; }

 private:
  absl::Status Launch();
  absl::Status WaitForPort(const std::function<bool()>& is_cancelled);

  std::filesystem::path store_;
  std::filesystem::path log_;
  std::filesystem::path port_file_;
  std::string address_;
  pid_t child_ = -1;
};

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_LOCAL_SERVER_H_
