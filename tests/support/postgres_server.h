// SPDX-License-Identifier: Apache-2.0
// A PostgreSQL server of one's own, in a temporary folder, reached through a
// socket in that folder only.
#ifndef GROUNDLOCK_TESTS_SUPPORT_POSTGRES_SERVER_H_
#define GROUNDLOCK_TESTS_SUPPORT_POSTGRES_SERVER_H_

#include <sys/types.h>

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/file.h"

namespace groundlock::test {

// Not thread-safe.
class PostgresServer {
 public:
  // kNotFound: no server programs of PostgreSQL on this machine, or run as root
  // without the user "postgres" that the package makes (the server refuses
  // root); the test should be skipped with the message.
  static absl::StatusOr<std::unique_ptr<PostgresServer>> Start();
  // One per program, stopped at its end.
  static absl::StatusOr<PostgresServer*> Shared();
  // Stops it at once; it also stops if this program is killed.
  ~PostgresServer();

  // Makes an empty database; its postgresql:// URL.
  absl::StatusOr<std::string> MakeDatabase();
  // As an administrator does it: sessions are broken off, data stays.
  absl::Status Stop();
  absl::Status StartAgain();

 private:
  explicit PostgresServer(base::TemporaryDirectory directory)
      : directory_(std::move(directory)) {}

  absl::Status Initialize();
  std::string Url(const std::string& database) const;
  std::vector<std::string> Command(const std::string& program) const;
  absl::StatusOr<pid_t> Spawn(const std::vector<std::string>& command) const;

  base::TemporaryDirectory directory_;
  std::string programs_;  // folder
  std::optional<std::pair<uid_t, gid_t>> user_;
  pid_t pid_ = 0;
  int num_databases_ = 0;
};

}  // namespace groundlock::test

#endif  // GROUNDLOCK_TESTS_SUPPORT_POSTGRES_SERVER_H_
