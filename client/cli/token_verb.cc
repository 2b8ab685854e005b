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
  base::TokenEntry entry;
  bool json = false;
};

absl::Status RunTokenCreate(const TokenOptions& options, VerbContext& context) {
  const base::TokenEntry& entry = options.entry;
  ASSIGN_OR_RETURN(const std::string token,
                   base::CreateToken(options.file, entry));
  if (options.json) {
    nlohmann::json made = {{"name", entry.name},
                           {"tenant", entry.tenant},
                           {"scopes", entry.scopes}};
    if (token.empty()) {
      made["certificate"] = entry.credential;
    } else {
      made["token"] = token;
    }
    context.out << made << '\n';
    return absl::OkStatus();
  }
  if (token.empty()) {
    context.err << "groundlock: " << entry.name << " is let in with "
                << entry.credential << '\n';
    return absl::OkStatus();
  }
  context.err << "groundlock: the token of " << entry.name
              << ", shown this once:\n";
  context.out << token << '\n';
  return absl::OkStatus();
}

// What is no secret of it: the hash of a token stays in the file.
std::string Certificate(const base::TokenEntry& entry) {
  return entry.credential.starts_with("sha256:") ? "" : entry.credential;
}

absl::Status RunTokenList(const TokenOptions& options, VerbContext& context) {
  ASSIGN_OR_RETURN(const base::TokenFile file,
                   base::ReadTokenFile(options.file));
  if (options.json) {
    nlohmann::json list = nlohmann::json::array();
    for (const base::TokenEntry& entry : file.entries) {
      list.push_back({{"name", entry.name},
                      {"tenant", entry.tenant},
                      {"scopes", entry.scopes},
                      {"certificate", Certificate(entry)}});
    }
    context.out << list << '\n';
    return absl::OkStatus();
  }
  for (const base::TokenEntry& entry : file.entries) {
    const std::string certificate = Certificate(entry);
    context.out << entry.name << "  " << absl::StrJoin(entry.scopes, ",")
                << "  " << (certificate.empty() ? "token" : certificate)
                << (entry.tenant.empty() ? "" : "  tenant " + entry.tenant)
                << '\n';
  }
  return absl::OkStatus();
}

void AddTokenCreate(CLI::App* create,
                    const std::shared_ptr<TokenOptions>& options,
                    VerbContext& context) {
  base::TokenEntry& entry = options->entry;
  create->add_option("name", entry.name, "Who")->required();
  create
      ->add_option("--scopes",
                   entry.scopes,
                   "maps:read, maps:write, sessions:own, sessions:watch, "
                   "sessions:all, admin; with commas between them")
      ->delimiter(',')
      ->required();
  create->add_option("--tenant",
                     entry.tenant,
                     "Whose maps and sessions there are for them; without it "
                     "those of the tenant without a name");
  create->add_option("--certificate",
                     entry.credential,
                     "No token, but what their certificate says: cn:NAME, "
                     "dns:NAME, uri:URI or email:ADDRESS");
  const auto quota = [create](const char* name,
                              std::uint64_t& value,
                              const char* description) {
    create->add_option(name, value, description)
        ->transform(CLI::AsSizeValue(/*kb_is_1000=*/false));
  };
  quota("--sessions", entry.quotas.sessions, "At most so many at a time");
  quota("--frames-per-s", entry.quotas.frames_per_s, "At most so many");
  quota("--bytes-per-s",
        entry.quotas.bytes_per_s,
        "Of frames, images and uploads; also as 50MB");
  quota("--builds", entry.quotas.builds, "At most so many at a time");
  quota("--stored-bytes",
        entry.quotas.stored_bytes,
        "Of the tenant's maps; no more are added then");
  create->callback([options, &context] {
    context.run = [options, &context]() -> absl::Status {
      if (options->entry.credential.starts_with("sha256:")) {
        return absl::InvalidArgumentError(
            "--certificate: expected cn:, dns:, uri: or email:");
      }
      return RunTokenCreate(*options, context);
    };
  });
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
  create->add_flag("--json", options->json, "Machine-readable output");
  AddTokenCreate(create, options, context);
  CLI::App* const list = add("list", "Names, scopes and tenants");
  list->add_flag("--json", options->json, "Machine-readable output");
  list->callback([options, &context] {
    context.run = [options, &context] {
      return RunTokenList(*options, context);
    };
  });
  CLI::App* const revoke = add(
      "revoke", "Remove somebody: the server refuses them within two seconds");
  revoke->add_option("name", options->entry.name, "Who")->required();
  revoke->callback([options, &context] {
    context.run = [options] {
      return base::RevokeToken(options->file, options->entry.name);
    };
  });
}

}  // namespace groundlock::cli
