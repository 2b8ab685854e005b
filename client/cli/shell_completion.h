// SPDX-License-Identifier: Apache-2.0
// Completion scripts and the manual page, from the options as they are.
#ifndef GROUNDLOCK_CLIENT_CLI_SHELL_COMPLETION_H_
#define GROUNDLOCK_CLIENT_CLI_SHELL_COMPLETION_H_

#include <CLI/App.hpp>
#include <string>

#include "client/cli/verbs.h"

namespace groundlock::cli {

// Scripts for the shells of these names, of all verbs of `app` and their
// options. File names are offered wherever no option begins.
std::string BashCompletion(const CLI::App& app);
std::string ZshCompletion(const CLI::App& app);
std::string FishCompletion(const CLI::App& app);

// The manual page in section 1, as roff (man macros).
std::string ManualPage(const CLI::App& app, const std::string& version);

// groundlock completion bash|zsh|fish|man; describes what `app` has by the time
// that it runs.
void AddCompletionVerb(CLI::App& app, VerbContext& context);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_SHELL_COMPLETION_H_
