// SPDX-License-Identifier: Apache-2.0
// How programs log: one line per message, whatever is in it.
#ifndef GROUNDLOCK_MAP_STORE_BASE_LOGGING_H_
#define GROUNDLOCK_MAP_STORE_BASE_LOGGING_H_

#include <string>
#include <string_view>

namespace groundlock::base {

enum class LogFormat {
  kText,  // [time] [level] text
  kJson,  // {"time":"...","level":"...","text":"..."}, UTC
};

// For main(), as it holds for the whole process. level: as spdlog names it.
// Names that strangers chose reach the log: control characters are written as
// \n, \t or \x1b, so that nobody adds lines, or colours, of their own. Every
// line is written out at once.
void SetUpLogging(const std::string& level, LogFormat format);

// The text as the log shows it.
std::string EscapeForLog(std::string_view text, LogFormat format);

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_LOGGING_H_
