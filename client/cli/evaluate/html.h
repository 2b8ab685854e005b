// SPDX-License-Identifier: Apache-2.0
// The frame of the reports' pages.
#ifndef GROUNDLOCK_CLIENT_CLI_EVALUATE_HTML_H_
#define GROUNDLOCK_CLIENT_CLI_EVALUATE_HTML_H_

#include <string>

#include "client/cli/evaluate/line_plot.h"

namespace groundlock::cli {

// One page with everything in it: no script, no font, no address. `body` is
// HTML.
std::string HtmlPage(const std::string& title, const std::string& body);
// A plot with the words below it, which are escaped.
std::string HtmlFigure(const LinePlot& plot, const std::string& caption);
// A number, or a dash where there is none.
std::string NumberText(double value, int decimals);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_EVALUATE_HTML_H_
