// SPDX-License-Identifier: Apache-2.0
// The program's verbs. Each Add… function describes one to CLI11; parsing then
// leaves the chosen verb's work in VerbContext::run.
#ifndef GROUNDLOCK_CLIENT_CLI_VERBS_H_
#define GROUNDLOCK_CLIENT_CLI_VERBS_H_

#include <CLI/App.hpp>
#include <functional>
#include <memory>
#include <ostream>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cli/interrupt.h"
#include "client/cli/local_server.h"
#include "client/sdk/client.h"

namespace groundlock::cli {

// Where servers listen unless told otherwise.
inline constexpr int kDefaultPort = 50'551;

struct CommonOptions {
  std::string server;      // empty = the default port here, or one of our own
  bool local = false;      // one of our own in any case
  std::string token_file;  // empty = GROUNDLOCK_TOKEN, if set
  sdk::ClientTls tls;
  bool json = false;  // machine-readable output on `out`
};

struct VerbContext {
  Interrupt& interrupt;
  LocalServer& local_server;
  std::ostream& out;  // results
  std::ostream& err;  // progress, warnings
  CommonOptions common;
  std::function<absl::Status()> run;
  std::string version = {};  // of the program
};

void AddMapVerbs(CLI::App& app, VerbContext& context);
// Below "map".
void AddMapAlignVerb(CLI::App& map, VerbContext& context);
void AddMapCheckVerb(CLI::App& map, VerbContext& context);
// groundlock map build, below the verb `map`.
void AddMapBuildVerb(CLI::App& map, VerbContext& context);
// groundlock map extend | merge, likewise.
void AddMapGrowVerbs(CLI::App& map, VerbContext& context);
void AddTrackVerb(CLI::App& app, VerbContext& context);
void AddLocalizeVerb(CLI::App& app, VerbContext& context);
void AddEvaluateVerb(CLI::App& app, VerbContext& context);
void AddSimulateVerb(CLI::App& app, VerbContext& context);
void AddTokenVerb(CLI::App& app, VerbContext& context);

// --server, --local, --token-file and --json.
void AddCommonOptions(CLI::App& verb, VerbContext& context);

// Connects to --server; errors say how to start one. If none is named and none
// answers on the default port, one of the program's own runs for as long as the
// program does, and a line on `err` says so.
absl::StatusOr<std::unique_ptr<sdk::Client>> Connect(
    const VerbContext& context);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_VERBS_H_
