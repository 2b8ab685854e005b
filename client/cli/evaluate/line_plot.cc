// SPDX-License-Identifier: Apache-2.0
#include "client/cli/evaluate/line_plot.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"

namespace groundlock::cli {
namespace {

using Eigen::Vector2d;

constexpr double kLeft = 62.0;
constexpr double kRight = 16.0;
constexpr double kBottom = 46.0;
constexpr double kTitle = 30.0;
constexpr double kLegendRow = 18.0;
constexpr double kLegendWidth = 190.0;
constexpr double kCharacter = 6.4;  // mean width of 12 px sans-serif
constexpr int kMaxTicks = 7;

constexpr std::array<const char*, 8> kColours = {"#d55e00",
                                                 "#0072b2",
                                                 "#009e73",
                                                 "#cc79a7",
                                                 "#e69f00",
                                                 "#56b4e9",
                                                 "#000000",
                                                 "#999999"};

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
      EscapeMarkup(text));
}

std::string Line(const Vector2d& a,
                 const Vector2d& b,
                 const std::string& style) {
  return absl::StrFormat("<line x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f' %s/>\n",
                         a.x(),
                         a.y(),
                         b.x(),
                         b.y(),
                         style);
}

// 1, 2 or 5 times a power of ten: at most kMaxTicks of them in the extent.
double TickStep(double extent) {
  const double least = extent / kMaxTicks;
  const double power = std::pow(10.0, std::floor(std::log10(least)));
  for (const double factor : {1.0, 2.0, 5.0}) {
    if (factor * power >= least * (1.0 - 1e-9)) return factor * power;
  }
  return 10.0 * power;
}

class Drawing {
 public:
  explicit Drawing(const LinePlot& plot) : plot_(plot) {
    width_ = plot.width_px;
    height_ = plot.height_px;
    if (plot.legend == LinePlot::Legend::kAbove) PlaceLegendAbove();
    top_ = kTitle + kLegendRow * legend_rows_ + 4.0;
    min_ = plot.min;
    // Axes without an extent have no scale.
    max_ = plot.max.cwiseMax(plot.min + Vector2d::Constant(1e-9));
    if (plot.same_scale) WidenAxes();
  }

  std::string Draw() {
    std::string svg = absl::StrFormat(
        "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 %.0f %.0f' "
        "width='%.0f' height='%.0f' font-family='sans-serif' "
        "font-size='12'>\n<rect width='100%%' height='100%%' "
        "fill='#ffffff'/>\n",
        width_,
        height_,
        width_,
        height_);
    svg += Text(0.5 * width_, 20, "middle", plot_.title, " font-size='14'");
    svg += Bands() + Axes();
    // An inner picture cuts off what lies beyond the axes.
    absl::StrAppendFormat(&svg,
                          "<svg x='%.1f' y='%.1f' width='%.1f' height='%.1f' "
                          "viewBox='%.1f %.1f %.1f %.1f'>\n",
                          kLeft,
                          top_,
                          PlotWidth(),
                          PlotHeight(),
                          kLeft,
                          top_,
                          PlotWidth(),
                          PlotHeight());
    if (plot_.diagonal) {
      svg += Line(
          Place(min_), Place(max_), "stroke='#555555' stroke-dasharray='4 4'");
    }
    for (std::size_t i = 0; i < plot_.lines.size(); ++i) svg += Curve(i);
    return absl::StrCat(svg, "</svg>\n", Legend(), "</svg>\n");
  }

 private:
  double PlotWidth() const { return width_ - kLeft - kRight; }
  double PlotHeight() const { return height_ - top_ - kBottom; }
  Vector2d Place(const Vector2d& p) const {
    const Vector2d share = (p - min_).cwiseQuotient(max_ - min_);
    return {kLeft + share.x() * PlotWidth(),
            height_ - kBottom - share.y() * PlotHeight()};
  }

  void WidenAxes() {
    const Vector2d size(PlotWidth(), PlotHeight());
    const Vector2d extent = max_ - min_;
    const double unit = extent.cwiseQuotient(size).maxCoeff();
    const Vector2d more = 0.5 * (unit * size - extent);
    min_ -= more;
    max_ += more;
  }

  std::string Bands() const {
    std::string svg;
    for (const PlotBand& band : plot_.bands) {
      const double left = Place({std::max(band.from, min_.x()), min_.y()}).x();
      const double right = Place({std::min(band.to, max_.x()), min_.y()}).x();
      if (right <= left) continue;
      absl::StrAppendFormat(&svg,
                            "<rect x='%.1f' y='%.1f' width='%.1f' "
                            "height='%.1f' fill='#eeeeee'/>\n",
                            left,
                            top_,
                            right - left,
                            PlotHeight());
      svg += Text(0.5 * (left + right),
                  top_ + 14,
                  "middle",
                  band.label,
                  " fill='#666666'");
    }
    return svg;
  }

  std::string Axes() const {
    std::string svg;
    const std::string grid = "stroke='#d8d8d8'";
    for (const int axis : {0, 1}) {
      const double step = TickStep(max_[axis] - min_[axis]);
      const auto first = static_cast<int>(std::ceil(min_[axis] / step - 1e-9));
      const auto last = static_cast<int>(std::floor(max_[axis] / step + 1e-9));
      for (int i = first; i <= last; ++i) {
        Vector2d from = min_;
        Vector2d to = max_;
        from[axis] = to[axis] = i * step;
        const Vector2d at = Place(from);
        svg += Line(at, Place(to), grid);
        const std::string value = absl::StrFormat("%.6g", i * step);
        svg += axis == 0 ? Text(at.x(), at.y() + 16, "middle", value)
                         : Text(at.x() - 6, at.y() + 4, "end", value);
      }
    }
    svg += Line(Place(min_), Place({max_.x(), min_.y()}), "stroke='#555555'");
    svg += Line(Place(min_), Place({min_.x(), max_.y()}), "stroke='#555555'");
    svg +=
        Text(kLeft + 0.5 * PlotWidth(), height_ - 10, "middle", plot_.x_label);
    const double middle = top_ + 0.5 * PlotHeight();
    svg += Text(16,
                middle,
                "middle",
                plot_.y_label,
                absl::StrFormat(" transform='rotate(-90 16 %.1f)'", middle));
    return svg;
  }

  std::string Style(std::size_t i) const {
    const PlotLine& line = plot_.lines[i];
    return absl::StrCat(
        "stroke='",
        Colour(i),
        "' stroke-width='",
        line.dashed ? "1.3" : "1.8",
        line.dashed || i >= kColours.size() ? "' stroke-dasharray='6 4'" : "'");
  }
  std::string Colour(std::size_t i) const {
    return plot_.lines[i].colour.empty() ? PlotColour(i)
                                         : plot_.lines[i].colour;
  }

  std::string Curve(std::size_t i) const {
    const PlotLine& line = plot_.lines[i];
    std::string svg;
    std::string points;
    const auto end_piece = [&] {
      if (line.line && !points.empty()) {
        absl::StrAppend(&svg,
                        "<polyline points='",
                        points,
                        "' fill='none' ",
                        Style(i),
                        "/>\n");
      }
      points.clear();
    };
    for (const Vector2d& point : line.points) {
      if (!point.allFinite()) {
        end_piece();
        continue;
      }
      const Vector2d at = Place(point);
      absl::StrAppendFormat(&points, "%.1f,%.1f ", at.x(), at.y());
      if (!line.markers) continue;
      absl::StrAppendFormat(&svg,
                            "<circle cx='%.1f' cy='%.1f' r='2.5' fill='%s'/>\n",
                            at.x(),
                            at.y(),
                            Colour(i));
    }
    end_piece();
    return svg;
  }

  // Where each label stands, in rows from the left.
  void PlaceLegendAbove() {
    double x = kLeft;
    for (const PlotLine& line : plot_.lines) {
      if (line.label.empty()) {
        places_.emplace_back(0.0, 0.0);
        continue;
      }
      const double wide =
          44.0 + kCharacter * static_cast<double>(line.label.size());
      if (legend_rows_ == 0) legend_rows_ = 1;
      if (x > kLeft && x + wide > width_ - kRight) {
        x = kLeft;
        ++legend_rows_;
      }
      places_.emplace_back(x, kTitle + kLegendRow * legend_rows_ - 6.0);
      x += wide;
    }
  }

  std::string Legend() {
    std::string svg;
    if (plot_.legend != LinePlot::Legend::kAbove) {
      const bool left = plot_.legend == LinePlot::Legend::kLeft;
      const double x = left ? kLeft + 12 : width_ - kRight - kLegendWidth;
      absl::StrAppendFormat(
          &svg,
          "<rect x='%.1f' y='%.1f' width='%.1f' height='%.1f' fill='#ffffff' "
          "fill-opacity='0.8'/>\n",
          x - 6,
          top_ + 8,
          kLegendWidth,
          kLegendRow * static_cast<double>(plot_.lines.size()) + 8);
      for (std::size_t i = 0; i < plot_.lines.size(); ++i) {
        places_.emplace_back(
            x, top_ + 8 + kLegendRow * (static_cast<double>(i) + 1.0));
      }
    }
    for (std::size_t i = 0; i < plot_.lines.size(); ++i) {
      const PlotLine& line = plot_.lines[i];
      if (line.label.empty()) continue;
      const Vector2d& at = places_[i];
      if (line.line) {
        svg += Line({at.x(), at.y() - 4}, {at.x() + 22, at.y() - 4}, Style(i));
      }
      if (line.markers) {
        absl::StrAppendFormat(
            &svg,
            "<circle cx='%.1f' cy='%.1f' r='2.5' fill='%s'/>\n",
            at.x() + 11,
            at.y() - 4,
            Colour(i));
      }
      svg += Text(at.x() + 28, at.y(), "start", line.label);
    }
    return svg;
  }

  const LinePlot& plot_;
  double width_ = 0.0, height_ = 0.0, top_ = 0.0;
  Vector2d min_, max_;
  int legend_rows_ = 0;
  std::vector<Vector2d> places_;  // of the legend's labels
};

}  // namespace

const char* PlotColour(std::size_t i) { return kColours[i % kColours.size()]; }

std::string EscapeMarkup(const std::string& text) {
  return absl::StrReplaceAll(text,
                             {{"&", "&amp;"},
                              {"<", "&lt;"},
                              {">", "&gt;"},
                              {"\"", "&quot;"},
                              {"'", "&#39;"}});
}

std::string ToSvg(const LinePlot& plot) { return Drawing(plot).Draw(); }

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

}  // namespace groundlock::cli
