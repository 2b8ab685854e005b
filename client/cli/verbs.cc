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
  verb.add_option("--token-file",
                  context.common.token_file,
                  "File whose first line is the token that the server wants; "
                  "without it the environment's GROUNDLOCK_TOKEN is used")
      ->type_name("FILE");
  verb.add_flag(
      "--json", context.common.json, "Machine-readable output, one JSON value");
}

absl::StatusOr<std::unique_ptr<sdk::Client>> Connect(
    const VerbContext& context) {
  sdk::ClientOptions options;
  ASSIGN_OR_RETURN(options.token, sdk::FindToken(context.common.token_file));
  auto client = sdk::Client::Connect(context.common.server, options);
  if (client.status().code() == absl::StatusCode::kUnavailable) {
    return absl::UnavailableError(absl::StrCat(
        client.status().message(),
        " (is groundlock-server running there? --server HOST:PORT names "
        "another)"));
  }
  return client;
}

}  // namespace groundlock::cli
