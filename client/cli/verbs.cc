// SPDX-License-Identifier: Apache-2.0
#include "client/cli/verbs.h"

#include <CLI/CLI.hpp>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::cli {

void AddCommonOptions(CLI::App& verb, VerbContext& context) {
  verb.add_option("--server", context.common.server, "Server to talk to")
      ->type_name("HOST:PORT")
      ->capture_default_str();
  verb.add_flag(
      "--json", context.common.json, "Machine-readable output, one JSON value");
}

absl::StatusOr<std::unique_ptr<sdk::Client>> Connect(
    const VerbContext& context) {
  auto client = sdk::Client::Connect(context.common.server);
  if (client.status().code() == absl::StatusCode::kUnavailable) {
    return absl::UnavailableError(absl::StrCat(
        client.status().message(),
        " (is groundlock-server running there? --server HOST:PORT names "
        "another)"));
  }
  return client;
}

}  // namespace groundlock::cli
