// SPDX-License-Identifier: Apache-2.0
// groundlock: maps, tracking and simulation from the command line.
#include <CLI/CLI.hpp>
#include <iostream>

#include "client/cli/interrupt.h"
#include "client/cli/local_server.h"
#include "client/cli/shell_completion.h"
#include "client/cli/verbs.h"
#include "client/media/video_source.h"
#include "map_store/base/version.h"
#include "map_store/decoding/decoder.h"
#include "map_store/features/open_cv_setup.h"

int main(int argc, char** argv) {
  using namespace groundlock::cli;
  groundlock::features::SetUpOpenCv();
  // What decodes media for a map is this program, too.
  if (const auto status = groundlock::decoding::RunDecoderIfAsked(argc, argv)) {
    return *status;
  }
  // Before anything else: threads started later inherit its signal mask.
  Interrupt interrupt;
  groundlock::media::QuietMediaLibraries();
  LocalServer local_server;

  CLI::App app(
      "Groundlock keeps a lock on things that move on the ground, seen from a "
      "camera that moves too.",
      "groundlock");
  app.set_version_flag("--version", groundlock::base::Version());
  app.require_subcommand(1);
  VerbContext context{.interrupt = interrupt,
                      .local_server = local_server,
                      .out = std::cout,
                      .err = std::cerr,
                      .common = {},
                      .run = nullptr,
                      .version = groundlock::base::Version()};
  AddMapVerbs(app, context);
  AddTrackVerb(app, context);
  AddLocalizeVerb(app, context);
  AddEvaluateVerb(app, context);
  AddSimulateVerb(app, context);
  AddTokenVerb(app, context);
  AddCompletionVerb(app, context);
  CLI11_PARSE(app, argc, argv);

  const absl::Status status = context.run();
  std::cout.flush();
  if (!status.ok()) {
    std::cerr << "groundlock: "
              << (status.message().empty()
                      ? absl::StatusCodeToString(status.code())
                      : std::string(status.message()))
              << '\n';
    return interrupt.interrupted() ? 130 : 1;
  }
  if (!std::cout) {
    std::cerr << "groundlock: standard output cannot be written\n";
    return 1;
  }
  return 0;
}
