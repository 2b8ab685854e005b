// SPDX-License-Identifier: Apache-2.0
#include "client/cli/verbs.h"

#include <CLI/CLI.hpp>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::cli {

void AddCommonOptions(CLI::App& verb, VerbContext& context) {
  CLI::Option* const server =
      verb.add_option("--server",
                      context.common.server,
                      "Server to talk to; without it the one at 127.0.0.1:" +
                          std::to_string(kDefaultPort) +
                          ", or, where none answers, one of the program's own")
          ->type_name("HOST:PORT");
  CLI::Option* const local =
      verb.add_flag("--local",
                    context.common.local,
                    "A server of the program's own, for as long as it runs; "
                    "maps are kept in the user's data folder")
          ->excludes(server);
  sdk::ClientTls& tls = context.common.tls;
  verb.add_flag("--tls",
                tls.enabled,
                "Encrypted, as grpcs://HOST:PORT is; also by --ca and --cert")
      ->excludes(local);
  verb.add_option("--ca",
                  tls.ca,
                  "Who issued the server's certificate, PEM; without it, whom "
                  "this machine trusts")
      ->type_name("FILE")
      ->excludes(local);
  verb.add_option("--cert",
                  tls.certificate,
                  "Certificate to show to a server that asks for one, PEM")
      ->type_name("FILE")
      ->excludes(local);
  verb.add_option("--key", tls.key, "Its private key, PEM")->type_name("FILE");
  verb.add_option("--tls-name",
                  tls.server_name,
                  "Name in the server's certificate, if it is not HOST");
  verb.add_option("--token-file",
                  context.common.token_file,
                  "File whose first line is the token that the server wants; "
                  "without it the environment's GROUNDLOCK_TOKEN is used")
      ->type_name("FILE");
  verb.add_flag(
      "--json", context.common.json, "Machine-readable output, one JSON value");
}

namespace {

// The server that was named, or the one that is there, or one of our own, which
// speaks no TLS.
absl::StatusOr<std::string> ChooseServer(const VerbContext& context,
                                         bool is_tls) {
  if (!context.common.server.empty()) return context.common.server;
  if (!context.common.local && (is_tls || LoopbackAnswers(kDefaultPort))) {
    return absl::StrCat("127.0.0.1:", kDefaultPort);
  }
  const bool ran = context.local_server.running();
  ASSIGN_OR_RETURN(std::string address, context.local_server.Start([&context] {
    return context.interrupt.interrupted();
  }));
  if (ran) return address;  // as was said then
  context.err << "groundlock: runs a server of its own for this command; maps "
                 "are in "
              << context.local_server.store().string() << '\n';
  return address;
}

}  // namespace

absl::StatusOr<std::unique_ptr<sdk::Client>> Connect(
    const VerbContext& context) {
  sdk::ClientOptions options;
  ASSIGN_OR_RETURN(options.token, sdk::FindToken(context.common.token_file));
  options.tls = context.common.tls;
  options.tls.enabled = options.tls.enabled || !options.tls.ca.empty() ||
                        !options.tls.certificate.empty();
  ASSIGN_OR_RETURN(const std::string server,
                   ChooseServer(context, options.tls.enabled));
  auto client = sdk::Client::Connect(server, options);
  if (client.status().code() == absl::StatusCode::kUnavailable) {
    return absl::UnavailableError(absl::StrCat(
        client.status().message(),
        " (is groundlock-server running there? --server HOST:PORT names "
        "another)"));
  }
  return client;
}

}  // namespace groundlock::cli
