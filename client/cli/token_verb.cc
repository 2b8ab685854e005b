// SPDX-License-Identifier: Apache-2.0
// groundlock token: who may call a server. Works on the server's file, on the
// machine where that lies.
#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>

#include "absl/strings/str_join.h"
#include "client/cli/verbs.h"
#include "map_store/base/status.h"
#include "map_store/base/token_file.h"

namespace groundlock::cli {
namespace {

struct TokenOptions {
  std::string file;
  std::string name;
  std::vector<std::string> scopes = {"admin"};
  bool json = false;
};

absl::Status RunTokenCreate(const TokenOptions& options, VerbContext& context) {
  ASSIGN_OR_RETURN(
      const std::string token,
      base::CreateToken(options.file, options.name, options.scopes));
  if (options.json) {
    context.out << nlohmann::json{{"name", options.name},
                                  {"scopes", options.scopes},
                                  {"token", token}}
                << '\n';
    return absl::OkStatus();
  }
  context.err << "groundlock: the token of " << options.name
              << ", shown this once:\n";
  context.out << token << '\n';
  return absl::OkStatus();
}

absl::Status RunTokenList(const TokenOptions& options, VerbContext& context) {
  ASSIGN_OR_RETURN(const std::vector<base::TokenEntry> entries,
                   base::ReadTokenFile(options.file));
  if (options.json) {
    nlohmann::json list = nlohmann::json::array();
    for (const base::TokenEntry& entry : entries) {
      list.push_back({{"name", entry.name}, {"scopes", entry.scopes}});
    }
    context.out << list << '\n';
    return absl::OkStatus();
  }
  for (const base::TokenEntry& entry : entries) {
    context.out << entry.name << "  " << absl::StrJoin(entry.scopes, ",")
                << '\n';
  }
  return absl::OkStatus();
}

}  // namespace

void AddTokenVerb(CLI::App& app, VerbContext& context) {
  CLI::App* const verb =
      app.add_subcommand("token", "Who may call a server, and what for");
  verb->require_subcommand(1);
  const auto options = std::make_shared<TokenOptions>();
  const auto add = [&](const char* name, const char* description) {
    CLI::App* const sub = verb->add_subcommand(name, description);
    sub->add_option("--file", options->file, "The server's --token-file")
        ->required()
        ->type_name("FILE");
    return sub;
  };
  CLI::App* const create =
      add("create", "Add somebody, and print the token, which is not kept");
  create->add_option("name", options->name, "Who")->required();
  create
      ->add_option("--scopes",
                   options->scopes,
                   "maps:read, maps:write, sessions:watch, sessions:all, "
                   "admin; with commas between them")
      ->delimiter(',')
      ->capture_default_str();
  create->add_flag("--json", options->json, "Machine-readable output");
  create->callback([options, &context] {
    context.run = [options, &context] {
      return RunTokenCreate(*options, context);
    };
  });
  CLI::App* const list = add("list", "Names and scopes");
  list->add_flag("--json", options->json, "Machine-readable output");
  list->callback([options, &context] {
    context.run = [options, &context] {
      return RunTokenList(*options, context);
    };
  });
  CLI::App* const revoke =
      add("revoke", "Remove somebody: the server refuses the token from then");
  revoke->add_option("name", options->name, "Who")->required();
  revoke->callback([options, &context] {
    context.run = [options] {
      return base::RevokeToken(options->file, options->name);
    };
  });
}

}  // namespace groundlock::cli
