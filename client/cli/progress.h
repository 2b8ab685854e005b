// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_CLI_PROGRESS_H_
#define GROUNDLOCK_CLIENT_CLI_PROGRESS_H_

#include <chrono>
#include <cstdint>
#include <optional>
#include <ostream>
#include <string>
#include <string_view>

namespace groundlock::cli {

// How far a verb has come: on a terminal a bar that is redrawn in place, else a
// plain line now and then, so that a log stays readable. Not thread-safe.
//
//   track  [#########---------]  50 %  96/192  7.9/s  0:12 left  tracked
class Progress {
 public:
  struct Options {
    std::string label;
    std::optional<std::uint64_t>
        total;  // unset = unknown: no bar, no time left
    std::string unit = "frames";
    bool counts = true;  // false: only the share, for totals that mean nothing
    bool terminal = false;
    int columns = 80;  // a terminal's width; the line is cut there
  };
  Progress(std::ostream& out, Options options);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  // `done` of the total; `note` is put at the end of the line.
  void Update(std::uint64_t done, std::string_view note = {});
  void ClearNote() { note_.clear(); }
  // Draws the last state and ends the line. Further updates do nothing.
  void Finish();

 private:
  using Clock = std::chrono::steady_clock;
  std::string Line(Clock::time_point now) const;

  std::ostream& out_;
  const Options options_;
  const Clock::time_point start_ = Clock::now();
  std::optional<Clock::time_point> drawn_;
  std::uint64_t drawn_done_ = 0;
  std::uint64_t done_ = 0;
  std::string note_;
  bool finished_ = false;
};

// Whether stderr is a terminal, and its width.
struct Terminal {
  bool is_terminal = false;
  int columns = 80;
};
Terminal StderrTerminal();

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_PROGRESS_H_
