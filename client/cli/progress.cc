// SPDX-License-Identifier: Apache-2.0
#include "client/cli/progress.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

constexpr auto kRedrawEvery = std::chrono::milliseconds(100);
constexpr auto kLogEvery = std::chrono::seconds(5);
constexpr int kBarCells = 24;

std::string Duration(double seconds) {
  const auto whole = static_cast<std::int64_t>(std::llround(seconds));
  if (whole >= 3600) {
    return absl::StrFormat(
        "%d:%02d:%02d", whole / 3600, whole / 60 % 60, whole % 60);
  }
  return absl::StrFormat("%d:%02d", whole / 60, whole % 60);
}

}  // namespace

Progress::Progress(std::ostream& out, Options options)
    : out_(out), options_(std::move(options)) {}

Progress::~Progress() { Finish(); }

void Progress::Update(std::uint64_t done, std::string_view note) {
  if (finished_) return;
  done_ = done;
  note_ = note;
  const Clock::time_point now = Clock::now();
  if (options_.terminal) {
    if (drawn_ && now - *drawn_ < kRedrawEvery) return;
    // The line is cut to the width, so that it never wraps and stays in place.
    out_ << '\r' << Line(now) << "\033[K" << std::flush;
  } else {
    if (now - drawn_.value_or(start_) < kLogEvery) return;
    out_ << Line(now) << '\n' << std::flush;
  }
  drawn_ = now;
  drawn_done_ = done;
}

void Progress::Finish() {
  if (finished_) return;
  finished_ = true;
  if (done_ == 0 && !drawn_) return;
  if (options_.terminal) {
    out_ << '\r' << Line(Clock::now()) << "\033[K\n" << std::flush;
  } else if (!drawn_ || drawn_done_ != done_) {
    out_ << Line(Clock::now()) << '\n' << std::flush;
  }
}

std::string Progress::Line(Clock::time_point now) const {
  const double elapsed_s = std::chrono::duration<double>(now - start_).count();
  const double rate = elapsed_s > 0.0 ? done_ / elapsed_s : 0.0;
  std::string line = options_.label;
  if (options_.total && *options_.total > 0) {
    const double share =
        std::min(1.0, static_cast<double>(done_) / *options_.total);
    if (options_.terminal) {
      const int full = static_cast<int>(share * kBarCells);
      absl::StrAppend(&line,
                      "  [",
                      std::string(full, '#'),
                      std::string(kBarCells - full, '-'),
                      "]");
    }
    absl::StrAppendFormat(&line, "  %3d %%", static_cast<int>(share * 100));
    if (options_.counts) {
      absl::StrAppendFormat(&line, "  %d/%d", done_, *options_.total);
    }
  } else {
    absl::StrAppend(&line, "  ", done_);
  }
  if (options_.counts) absl::StrAppend(&line, " ", options_.unit);
  if (options_.counts && rate > 0.0)
    absl::StrAppendFormat(&line, "  %.1f/s", rate);
  if (options_.total && rate > 0.0 && done_ < *options_.total) {
    absl::StrAppend(
        &line, "  ", Duration((*options_.total - done_) / rate), " left");
  } else {
    absl::StrAppend(&line, "  ", Duration(elapsed_s));
  }
  if (!note_.empty()) absl::StrAppend(&line, "  ", note_);
  if (options_.terminal &&
      line.size() >= static_cast<size_t>(options_.columns)) {
    line.resize(std::max(1, options_.columns - 1));
  }
  return line;
}

Terminal StderrTerminal() {
  Terminal terminal;
  terminal.is_terminal = isatty(STDERR_FILENO) == 1;
  winsize size{};
  if (ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0) {
    terminal.columns = size.ws_col;
  }
  return terminal;
}

}  // namespace groundlock::cli
