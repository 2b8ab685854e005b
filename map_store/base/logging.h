// SPDX-License-Identifier: Apache-2.0
// How programs log: one line per message, whatever is in it.
#ifndef GROUNDLOCK_MAP_STORE_BASE_LOGGING_H_
#define GROUNDLOCK_MAP_STORE_BASE_LOGGING_H_

#include <cstddef>
#include <initializer_list>
#include <string>
#include <string_view>
#include <utility>

namespace groundlock::base {

enum class LogFormat {
  kText,  // [time] [level] text
  kJson,  // {"time":"...","level":"...","text":"..."}, UTC; then LogFields
};

// For main(), as it holds for the whole process. level: as spdlog names it.
// Names that strangers chose reach the log: control characters are written as
// \n, \t or \x1b, so that nobody adds lines, or colours, of their own. Every
// line is written out at once.
void SetUpLogging(const std::string& level, LogFormat format);

// The text as the log shows it.
std::string EscapeForLog(std::string_view text, LogFormat format);

// What this thread is about, as fields of their own in the JSON lines that it
// writes while the object lives; within another one those are added which it
// has not. Fields without a value are left out. Names are ours, values may be
// strangers'. To be destroyed in the thread, and in the reverse order, in which
// it was made.
class LogFields {
 public:
  using Field = std::pair<std::string_view, std::string_view>;
  explicit LogFields(std::initializer_list<Field> fields);
  ~LogFields();
  LogFields(const LogFields&) = delete;
  LogFields& operator=(const LogFields&) = delete;

 private:
  std::size_t size_before_;
};

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_LOGGING_H_
