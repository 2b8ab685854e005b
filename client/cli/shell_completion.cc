// SPDX-License-Identifier: Apache-2.0
#include "client/cli/shell_completion.h"

#include <CLI/CLI.hpp>
#include <memory>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"

namespace groundlock::cli {
namespace {

// A verb and the verbs above it: "groundlock map build".
struct Verb {
  std::string path;
  const CLI::App* app = nullptr;
};

bool IsVerb(const CLI::App* app) { return !app->get_name().empty(); }

void CollectVerbs(const CLI::App& app,
                  const std::string& path,
                  std::vector<Verb>& verbs) {
  verbs.push_back({path, &app});
  for (const CLI::App* below : app.get_subcommands(IsVerb)) {
    CollectVerbs(*below, path + " " + below->get_name(), verbs);
  }
}

std::vector<Verb> AllVerbs(const CLI::App& app) {
  std::vector<Verb> verbs;
  CollectVerbs(app, app.get_name(), verbs);
  return verbs;
}

std::vector<std::string> NamesBelow(const CLI::App& app) {
  std::vector<std::string> names;
  for (const CLI::App* below : app.get_subcommands(IsVerb)) {
    names.push_back(below->get_name());
  }
  return names;
}

// The verb's own options and those of its groups, which CLI11 keeps as
// subcommands without a name; each has a --help of its own.
std::vector<const CLI::Option*> Options(const CLI::App& app) {
  std::vector<const CLI::Option*> options;
  for (const CLI::Option* option : app.get_options()) options.push_back(option);
  for (const CLI::App* group :
       app.get_subcommands([](const CLI::App* a) { return !IsVerb(a); })) {
    for (const CLI::Option* option : group->get_options()) {
      if (option != group->get_help_ptr()) options.push_back(option);
    }
  }
  return options;
}

bool TakesValue(const CLI::Option& option) {
  return option.get_items_expected_max() > 0;
}

// "--out", "-h": as they are typed.
std::vector<std::string> Spellings(const CLI::Option& option) {
  std::vector<std::string> spellings;
  for (const std::string& name : option.get_snames()) {
    spellings.push_back("-" + name);
  }
  for (const std::string& name : option.get_lnames()) {
    spellings.push_back("--" + name);
  }
  return spellings;
}

// What may follow the verb: those below it, then its options.
std::vector<std::string> Words(const CLI::App& app) {
  std::vector<std::string> words = NamesBelow(app);
  for (const CLI::Option* option : Options(app)) {
    for (const std::string& word : Spellings(*option)) words.push_back(word);
  }
  return words;
}

// The case branches that bash and zsh share: a verb's path, and its words.
std::string WordCases(const CLI::App& app) {
  std::string cases;
  for (const Verb& verb : AllVerbs(app)) {
    absl::StrAppend(&cases,
                    "    \"",
                    verb.path,
                    "\") words=\"",
                    absl::StrJoin(Words(*verb.app), " "),
                    "\" below=\"",
                    absl::StrJoin(NamesBelow(*verb.app), " "),
                    "\" ;;\n");
  }
  return cases;
}

std::string SingleQuoted(const std::string& text) {
  return absl::StrCat("'", absl::StrReplaceAll(text, {{"'", "'\\''"}}), "'");
}

// A line of roff that begins with no macro.
std::string Roff(const std::string& text) {
  std::string escaped =
      absl::StrReplaceAll(text, {{"\\", "\\e"}, {"-", "\\-"}, {"\n", "\n\\&"}});
  return escaped.empty() ? escaped : "\\&" + escaped;
}

std::string RoffOptions(const CLI::App& app) {
  std::string page;
  for (const CLI::Option* option : Options(app)) {
    std::vector<std::string> names;
    for (const std::string& name : Spellings(*option)) {
      names.push_back("\\fB" + absl::StrReplaceAll(name, {{"-", "\\-"}}) +
                      "\\fR");
    }
    if (names.empty()) names.push_back("\\fI" + option->get_name() + "\\fR");
    const bool is_named = !Spellings(*option).empty();
    absl::StrAppend(
        &page,
        ".TP\n",
        absl::StrJoin(names, ", "),
        is_named && TakesValue(*option)
            ? " \\fI" +
                  absl::StrReplaceAll(option->get_type_name(), {{"-", "\\-"}}) +
                  "\\fR"
            : std::string(),
        "\n",
        Roff(option->get_description()),
        "\n");
  }
  return page;
}

}  // namespace

std::string BashCompletion(const CLI::App& app) {
  return absl::StrCat(
      "# bash completion for groundlock: made by `groundlock completion bash`\n"
      "_groundlock() {\n"
      "  local path=groundlock words below i\n"
      "  _groundlock_words \"$path\"\n"
      "  for ((i = 1; i < COMP_CWORD; ++i)); do\n"
      "    case \" $below \" in\n"
      "      *\" ${COMP_WORDS[i]} \"*)\n"
      "        path=\"$path ${COMP_WORDS[i]}\"\n"
      "        _groundlock_words \"$path\" ;;\n"
      "    esac\n"
      "  done\n"
      "  COMPREPLY=($(compgen -W \"$words\" -- "
      "\"${COMP_WORDS[COMP_CWORD]}\"))\n"
      "}\n"
      "_groundlock_words() {\n"
      "  case \"$1\" in\n",
      WordCases(app),
      "  esac\n"
      "}\n"
      "complete -o default -F _groundlock groundlock\n");
}

std::string ZshCompletion(const CLI::App& app) {
  return absl::StrCat(
      "#compdef groundlock\n"
      "# zsh completion for groundlock: made by `groundlock completion zsh`\n"
      "_groundlock_words() {\n"
      "  case \"$1\" in\n",
      WordCases(app),
      "  esac\n"
      "}\n"
      "_groundlock() {\n"
      "  local path_of_verb=groundlock words_typed=(\"${words[@]}\") words "
      "below i\n"
      "  _groundlock_words \"$path_of_verb\"\n"
      "  for ((i = 2; i < CURRENT; ++i)); do\n"
      "    case \" $below \" in\n"
      "      *\" ${words_typed[i]} \"*)\n"
      "        path_of_verb=\"$path_of_verb ${words_typed[i]}\"\n"
      "        _groundlock_words \"$path_of_verb\" ;;\n"
      "    esac\n"
      "  done\n"
      "  compadd -- ${=words}\n"
      "  [[ -n $below ]] || _files\n"
      "}\n"
      "_groundlock \"$@\"\n");
}

std::string FishCompletion(const CLI::App& app) {
  std::string script =
      "# fish completion for groundlock: made by `groundlock completion fish`\n"
      "# Whether the words typed so far, options left out, begin like that "
      "and\n"
      "# name no verb of the rest.\n"
      "function __groundlock_at\n"
      "  set -l typed (string match -v -- '-*' (commandline -opc))\n"
      "  set -l count (count (string split ' ' -- $argv[1]))\n"
      "  test (count $typed) -ge $count; or return 1\n"
      "  test \"$typed[1..$count]\" = \"$argv[1]\"; or return 1\n"
      "  for word in $typed[(math $count + 1)..-1]\n"
      "    contains -- $word $argv[2..-1]; and return 1\n"
      "  end\n"
      "  return 0\n"
      "end\n";
  for (const Verb& verb : AllVerbs(app)) {
    const std::string here = absl::StrCat(
        "complete -c groundlock -n ",
        SingleQuoted(absl::StrCat("__groundlock_at \"",
                                  verb.path,
                                  "\" ",
                                  absl::StrJoin(NamesBelow(*verb.app), " "))));
    // A file is nothing where a verb has to follow.
    if (!NamesBelow(*verb.app).empty()) absl::StrAppend(&script, here, " -f\n");
    for (const CLI::App* below : verb.app->get_subcommands(IsVerb)) {
      absl::StrAppend(&script,
                      here,
                      " -a ",
                      below->get_name(),
                      " -d ",
                      SingleQuoted(below->get_description()),
                      "\n");
    }
    for (const CLI::Option* option : Options(*verb.app)) {
      if (option->get_lnames().empty()) continue;
      absl::StrAppend(&script,
                      here,
                      " -l ",
                      option->get_lnames().front(),
                      TakesValue(*option) ? " -r" : "",
                      " -d ",
                      SingleQuoted(option->get_description()),
                      "\n");
    }
  }
  return script;
}

std::string ManualPage(const CLI::App& app, const std::string& version) {
  std::string page = absl::StrCat(
      ".\\\" Made by `groundlock completion man`.\n"
      ".TH GROUNDLOCK 1 \"\" \"groundlock ",
      absl::StrReplaceAll(version, {{"-", "\\-"}}),
      "\" \"User Commands\"\n"
      ".SH NAME\n"
      "groundlock \\- maps, tracking and simulation from the command line\n"
      ".SH SYNOPSIS\n"
      ".B groundlock\n"
      "\\fIVERB\\fR [\\fIOPTIONS\\fR]\n"
      ".SH DESCRIPTION\n",
      Roff(app.get_description()),
      "\n.SH OPTIONS\n",
      RoffOptions(app),
      ".SH VERBS\n");
  for (const Verb& verb : AllVerbs(app)) {
    // What only leads to other verbs has nothing to say of its own.
    if (verb.app == &app || !NamesBelow(*verb.app).empty()) continue;
    absl::StrAppend(&page,
                    ".SS \"",
                    absl::StrReplaceAll(verb.path, {{"-", "\\-"}}),
                    "\"\n",
                    Roff(verb.app->get_description()),
                    "\n",
                    RoffOptions(*verb.app));
  }
  absl::StrAppend(&page,
                  ".SH \"SEE ALSO\"\n"
                  "/usr/share/doc/groundlock/user_guide.md\n");
  return page;
}

void AddCompletionVerb(CLI::App& app, VerbContext& context) {
  CLI::App* verb = app.add_subcommand(
      "completion",
      "Print a completion script for a shell, or the manual page");
  auto what = std::make_shared<std::string>();
  verb->add_option("WHAT", *what, "bash, zsh, fish or man")
      ->required()
      ->check(CLI::IsMember({"bash", "zsh", "fish", "man"}));
  verb->callback([&app, what, &context] {
    context.run = [&app, what, &context] {
      if (*what == "bash") {
        context.out << BashCompletion(app);
      } else if (*what == "zsh") {
        context.out << ZshCompletion(app);
      } else if (*what == "fish") {
        context.out << FishCompletion(app);
      } else {
        context.out << ManualPage(app, context.version);
      }
      return absl::OkStatus();
    };
  });
}

}  // namespace groundlock::cli
