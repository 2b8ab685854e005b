// SPDX-License-Identifier: Apache-2.0
#include "tests/support/line_plot.h"

#include <array>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"

namespace groundlock::test_support {
namespace {

constexpr double kWidth = 640.0;
constexpr double kHeight = 440.0;
constexpr double kLeft = 62.0;
constexpr double kRight = 16.0;
constexpr double kTop = 34.0;
constexpr double kBottom = 50.0;
constexpr int kTicks = 5;
constexpr double kLegendRow = 18.0;
constexpr double kLegendWidth = 190.0;

// Okabe and Ito's colours, which people with any colour vision tell apart.
constexpr std::array<const char*, 8> kColours = {"#d55e00",
                                                 "#0072b2",
                                                 "#009e73",
                                                 "#cc79a7",
                                                 "#e69f00",
                                                 "#56b4e9",
                                                 "#000000",
                                                 "#999999"};

std::string Escape(const std::string& text) {
  return absl::StrReplaceAll(text,
                             {{"&", "&amp;"}, {"<", "&lt;"}, {">", "&gt;"}});
}

std::string Text(double x,
                 double y,
                 const std::string& anchor,
                 const std::string& text,
                 const std::string& extra = "") {
  return absl::StrFormat(
      "<text x='%.1f' y='%.1f' text-anchor='%s'%s>%s</text>\n",
      x,
      y,
      anchor,
      extra,
      Escape(text));
}

std::string Line(const Eigen::Vector2d& a,
                 const Eigen::Vector2d& b,
                 const std::string& style) {
  return absl::StrFormat("<line x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f' %s/>\n",
                         a.x(),
                         a.y(),
                         b.x(),
                         b.y(),
                         style);
}

}  // namespace

std::string ToSvg(const LinePlot& plot) {
  const Eigen::Vector2d extent = plot.max - plot.min;
  const auto place = [&](const Eigen::Vector2d& p) {
    const Eigen::Vector2d share = (p - plot.min).cwiseQuotient(extent);
    return Eigen::Vector2d(
        kLeft + share.x() * (kWidth - kLeft - kRight),
        kHeight - kBottom - share.y() * (kHeight - kTop - kBottom));
  };
  std::string svg = absl::StrFormat(
      "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 %.0f %.0f' "
      "width='%.0f' height='%.0f' font-family='sans-serif' font-size='12'>\n"
      "<rect width='100%%' height='100%%' fill='#ffffff'/>\n",
      kWidth,
      kHeight,
      kWidth,
      kHeight);
  svg += Text(0.5 * kWidth, 20, "middle", plot.title, " font-size='15'");
  for (int i = 0; i <= kTicks; ++i) {
    const Eigen::Vector2d at =
        plot.min + extent * (static_cast<double>(i) / kTicks);
    const Eigen::Vector2d below = place({at.x(), plot.min.y()});
    const Eigen::Vector2d beside = place({plot.min.x(), at.y()});
    const std::string grid = "stroke='#dddddd'";
    svg += Line(below, place({at.x(), plot.max.y()}), grid);
    svg += Line(beside, place({plot.max.x(), at.y()}), grid);
    svg += Text(below.x(), below.y() + 16, "middle", absl::StrCat(at.x()));
    svg += Text(beside.x() - 6, beside.y() + 4, "end", absl::StrCat(at.y()));
  }
  svg += Text(
      0.5 * (kLeft + kWidth - kRight), kHeight - 12, "middle", plot.x_label);
  const double middle = 0.5 * (kTop + kHeight - kBottom);
  svg += Text(16,
              middle,
              "middle",
              plot.y_label,
              absl::StrFormat(" transform='rotate(-90 16 %.1f)'", middle));
  if (plot.diagonal) {
    svg += Line(place(plot.min),
                place(plot.max),
                "stroke='#555555' stroke-dasharray='4 4'");
  }
  const double legend_x =
      plot.legend_at_left ? kLeft + 12 : kWidth - kRight - kLegendWidth;
  const double legend_height =
      kLegendRow * static_cast<double>(plot.lines.size()) + 8;
  const double legend_y =
      plot.legend_at_top ? kTop + 8 : kHeight - kBottom - legend_height - 8;
  std::string legend = absl::StrFormat(
      "<rect x='%.1f' y='%.1f' width='%.1f' height='%.1f' fill='#ffffff' "
      "fill-opacity='0.8'/>\n",
      legend_x - 6,
      legend_y,
      kLegendWidth,
      legend_height);
  for (std::size_t i = 0; i < plot.lines.size(); ++i) {
    const PlotLine& line = plot.lines[i];
    const std::string colour = kColours[i % kColours.size()];
    const std::string dash =
        i < kColours.size() ? "" : " stroke-dasharray='6 3'";
    std::string points;
    for (const Eigen::Vector2d& point : line.points) {
      const Eigen::Vector2d at = place(point);
      absl::StrAppendFormat(&points, "%.1f,%.1f ", at.x(), at.y());
      if (line.markers) {
        absl::StrAppendFormat(&svg,
                              "<circle cx='%.1f' cy='%.1f' r='3' fill='%s'/>\n",
                              at.x(),
                              at.y(),
                              colour);
      }
    }
    absl::StrAppendFormat(&svg,
                          "<polyline points='%s' fill='none' stroke='%s' "
                          "stroke-width='2'%s/>\n",
                          points,
                          colour,
                          dash);
    const double y = legend_y + kLegendRow * (static_cast<double>(i) + 1.0);
    legend +=
        Line({legend_x, y - 4},
             {legend_x + 22, y - 4},
             absl::StrCat("stroke='", colour, "' stroke-width='2'", dash));
    legend += Text(legend_x + 28, y, "start", line.label);
  }
  return absl::StrCat(svg, legend, "</svg>\n");
}

absl::Status WriteSvg(const LinePlot& plot, const std::filesystem::path& path) {
  std::ofstream file(path);
  file << ToSvg(plot);
  file.close();
  if (!file) {
    return absl::UnavailableError(
        absl::StrCat(path.string(), ": cannot be written"));
  }
  return absl::OkStatus();
}

}  // namespace groundlock::test_support
