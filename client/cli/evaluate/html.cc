// SPDX-License-Identifier: Apache-2.0
#include "client/cli/evaluate/html.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace groundlock::cli {
namespace {

constexpr const char* kStyle = R"css(
body { font: 15px/1.5 system-ui, sans-serif; color: #1b1b1b; background: #fff;
  max-width: 1320px; margin: 2em auto; padding: 0 1.2em; }
h1 { font-size: 1.7em; margin-bottom: .2em; }
h2 { font-size: 1.3em; margin-top: 2.2em; border-bottom: 1px solid #ccc; }
h3 { font-size: 1.05em; margin-bottom: .4em; }
p, li { max-width: 60em; }
table { border-collapse: collapse; margin: .8em 0; font-size: 14px; }
th, td { padding: .3em .8em; border-bottom: 1px solid #ddd; text-align: left;
  vertical-align: top; }
th { background: #f3f3f3; }
td.n { white-space: nowrap; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
td.worse::after { content: " (short of the thesis)"; color: #a33; }
tr.published td { color: #555; }
tr.first td { border-top: 2px solid #999; }
.grid { display: grid; gap: 1em;
  grid-template-columns: repeat(auto-fit, minmax(520px, 1fr)); }
figure { margin: 0; }
figure svg, figure img { width: 100%; height: auto; display: block; }
figure img { border-radius: 3px; }
figcaption { font-size: 13px; color: #555; padding: .2em 0 0 .3em; }
.meta { color: #555; }
@media print { .grid { grid-template-columns: 1fr 1fr; } }
)css";

}  // namespace

std::string HtmlPage(const std::string& title, const std::string& body) {
  const std::string escaped = EscapeMarkup(title);
  return absl::StrCat(
      "<!doctype html>\n<html lang='en'>\n<head><meta charset='utf-8'>\n"
      "<meta name='viewport' content='width=device-width'>\n<title>",
      escaped,
      "</title>\n<style>",
      kStyle,
      "</style></head>\n<body>\n<h1>",
      escaped,
      "</h1>\n",
      body,
      "</body>\n</html>\n");
}

std::string HtmlFigure(const LinePlot& plot, const std::string& caption) {
  return absl::StrCat("<figure>",
                      ToSvg(plot),
                      "<figcaption>",
                      EscapeMarkup(caption),
                      "</figcaption></figure>\n");
}

std::string NumberText(double value, int decimals) {
  return std::isfinite(value) ? absl::StrFormat("%.*f", decimals, value) : "-";
}

}  // namespace groundlock::cli
