// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/paint.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "client/simulator/internal/brush.h"

namespace groundlock::simulator {
namespace {

// A poster: colour blocks, random polygons, discs and words.
void Poster(cv::Mat& image, cv::RNG& rng, const cv::Rect& where) {
  const cv::Rect clipped = where & cv::Rect({}, image.size());
  if (clipped.width < 8 || clipped.height < 8) return;
  cv::Mat poster = image(clipped);
  poster.setTo(RandomColor(rng, 60, 240));
  const double size = std::min(poster.cols, poster.rows);
  for (int i = 0; i < 9; ++i) {
    const cv::Point2d at(rng.uniform(0.0, 1.0) * poster.cols,
                         rng.uniform(0.0, 1.0) * poster.rows);
    const double r = size * rng.uniform(0.06, 0.45);
    if (i % 3 == 0) {
      Ellipse(poster,
              at,
              r,
              r * rng.uniform(0.3, 1.0),
              rng.uniform(0, 180),
              RandomColor(rng, 20, 250));
    } else {
      Polygon(poster, rng, at, r, rng.uniform(3, 7), RandomColor(rng, 20, 250));
    }
  }
  for (int i = 0; i < 3; ++i) {
    Text(poster,
         rng,
         RandomWord(rng),
         {rng.uniform(0, std::max(1, poster.cols / 3)),
          cvRound(poster.rows * (0.3 + 0.3 * i))},
         size * rng.uniform(0.08, 0.25),
         RandomColor(rng, 0, 255));
  }
  cv::rectangle(poster, cv::Rect({}, poster.size()), cv::Scalar::all(30), 2);
}

void PaintWindow(cv::Mat& image, cv::RNG& rng, const cv::Rect& where) {
  cv::rectangle(image, where, cv::Scalar(190, 205, 210), cv::FILLED);
  const int frame = std::max(2, where.width / 14);
  const int columns = rng.uniform(1, 4);
  const int rows = rng.uniform(2, 4);
  for (int i = 0; i < columns; ++i) {
    for (int j = 0; j < rows; ++j) {
      const cv::Rect pane(where.x + frame + i * where.width / columns,
                          where.y + frame + j * where.height / rows,
                          where.width / columns - 2 * frame,
                          where.height / rows - 2 * frame);
      const int glass = rng.uniform(25, 80);
      cv::rectangle(
          image, pane, cv::Scalar(glass * 1.3, glass * 1.1, glass), cv::FILLED);
      if (pane.width > 4 && pane.height > 4) {
        // Curtains, plants and reflections: no two panes are alike.
        cv::Mat inside = image(pane & cv::Rect({}, image.size()));
        for (int k = 0; k < 3; ++k) {
          Polygon(inside,
                  rng,
                  {rng.uniform(0.0, 1.0) * pane.width,
                   rng.uniform(0.3, 1.0) * pane.height},
                  pane.width * rng.uniform(0.15, 0.5),
                  4,
                  RandomColor(rng, 20, 170));
        }
      }
    }
  }
  cv::rectangle(image,
                cv::Rect(where.x - frame,
                         where.y + where.height,
                         where.width + 2 * frame,
                         2 * frame),
                cv::Scalar(150, 155, 160),
                cv::FILLED);
}

void PaintCourses(cv::Mat& image,
                  cv::RNG& rng,
                  double length_px,
                  double height_px,
                  const cv::Scalar& color,
                  double spread) {
  image.setTo(Shaded(color, 0.72));  // the joints
  const int joint = std::max(1, cvRound(height_px * 0.1));
  int row = 0;
  for (double y = 0; y < image.rows; y += height_px, ++row) {
    double x = -rng.uniform(0.0, length_px);
    while (x < image.cols) {
      const double length = length_px * rng.uniform(0.8, 1.25);
      const cv::Scalar tint = Shaded(color, 1.0 + rng.uniform(-spread, spread));
      cv::rectangle(image,
                    cv::Rect(cvRound(x),
                             cvRound(y),
                             std::max(1, cvRound(length) - joint),
                             std::max(1, cvRound(height_px) - joint)),
                    tint,
                    cv::FILLED);
      x += length;
    }
  }
}

}  // namespace

cv::Mat Noise(
    cv::RNG& rng, cv::Size size, int cells, int octaves, float decay) {
  cv::Mat sum = cv::Mat::zeros(size, CV_32F);
  const double longer = std::max(size.width, size.height);
  float amplitude = 1.0F;
  float total = 0.0F;
  for (int i = 0; i < octaves; ++i, cells *= 2, amplitude *= decay) {
    const cv::Size grid(std::max(2, cvRound(cells * size.width / longer)),
                        std::max(2, cvRound(cells * size.height / longer)));
    cv::Mat values(grid, CV_32F);
    rng.fill(values, cv::RNG::UNIFORM, -1.0, 1.0);
    cv::Mat octave;
    cv::resize(values,
               octave,
               size,
               0,
               0,
               grid.width < size.width ? cv::INTER_CUBIC : cv::INTER_NEAREST);
    cv::scaleAdd(octave, amplitude, sum, sum);
    total += amplitude * amplitude;
  }
  // Uniform values have variance 1/3 (less after interpolation): unit range at
  // about two standard deviations.
  sum *= 1.0F / std::sqrt(total);
  return sum;
}

cv::Mat PaintFacade(cv::RNG& rng, Facade style, cv::Size size, float px_per_m) {
  cv::Mat wall(size, CV_8UC3);
  const double m = px_per_m;
  switch (style) {
    case Facade::kBrick:
      PaintCourses(
          wall, rng, 0.26 * m, 0.09 * m, cv::Scalar(72, 88, 150), 0.22);
      break;
    case Facade::kPlaster:
      wall.setTo(cv::Scalar(150, 186, 205));
      break;
    case Facade::kBlocks:
      PaintCourses(
          wall, rng, 0.7 * m, 0.35 * m, cv::Scalar(150, 158, 160), 0.12);
      break;
    case Facade::kPlanks:
      PaintCourses(wall, rng, 2.4 * m, 0.16 * m, cv::Scalar(90, 125, 150), 0.2);
      break;
  }
  Modulate(wall, Noise(rng, size, 10, 4, 0.8F), 0.08F);
  const double height_m = size.height / m;
  const double width_m = size.width / m;
  double x_m = rng.uniform(0.6, 1.4);
  while (x_m < width_m - 2.0) {
    const double w = rng.uniform(0.8, 1.5);
    const int kind = rng.uniform(0, 5);
    if (kind <= 2) {
      PaintWindow(wall,
                  rng,
                  {cvRound(x_m * m),
                   cvRound((height_m - rng.uniform(2.7, 3.3)) * m),
                   cvRound(w * m),
                   cvRound(rng.uniform(1.1, 1.6) * m)});
    } else if (kind == 3) {
      const cv::Rect door(cvRound(x_m * m),
                          cvRound((height_m - 2.1) * m),
                          cvRound(w * m),
                          cvRound(2.1 * m));
      cv::rectangle(wall, door, RandomColor(rng, 40, 140), cv::FILLED);
      cv::rectangle(wall, door, cv::Scalar::all(35), 4);
      Poster(wall,
             rng,
             {door.x + door.width / 4,
              door.y + door.height / 5,
              door.width / 2,
              door.height / 3});
    } else {
      Poster(wall,
             rng,
             {cvRound(x_m * m),
              cvRound((height_m - rng.uniform(1.9, 2.6)) * m),
              cvRound(w * m),
              cvRound(rng.uniform(0.9, 1.4) * m)});
    }
    Poster(wall,
           rng,
           {cvRound((x_m + rng.uniform(0.0, 0.6)) * m),
            cvRound((height_m - rng.uniform(0.8, 1.1)) * m),
            cvRound(rng.uniform(0.3, 0.7) * m),
            cvRound(rng.uniform(0.3, 0.6) * m)});
    x_m += w + rng.uniform(0.3, 1.0);
  }
  for (int i = 0; i < cvRound(width_m / 4); ++i) {  // pipes
    const int x = rng.uniform(0, size.width);
    cv::line(wall,
             {x, 0},
             {x, size.height},
             cv::Scalar(95, 100, 98),
             cvRound(0.08 * m));
  }
  PaintCracks(wall, rng, cvRound(width_m), m);
  Modulate(wall, Noise(rng, size, cvRound(8 * width_m / 3), 6, 0.85F), 0.24F);
  return wall;
}

cv::Mat PaintProp(cv::RNG& rng,
                  Prop style,
                  cv::Size size,
                  float px_per_m,
                  const cv::Scalar& color_bgr) {
  cv::Mat face(size, CV_8UC3, color_bgr);
  const double m = px_per_m;
  const int shorter = std::min(size.width, size.height);
  const auto place = [&](double low, double high) {
    const int w = cvRound(shorter * rng.uniform(low, high));
    const int h = cvRound(shorter * rng.uniform(low, high));
    return cv::Rect(rng.uniform(0, std::max(1, size.width - w)),
                    rng.uniform(0, std::max(1, size.height - h)),
                    w,
                    h);
  };
  switch (style) {
    case Prop::kCrate:
      PaintCourses(face, rng, 5.0 * m, 0.13 * m, color_bgr, 0.25);
      cv::rectangle(
          face, cv::Rect({}, size), Shaded(color_bgr, 0.6), cvRound(0.12 * m));
      Poster(face, rng, place(0.25, 0.45));
      break;
    case Prop::kPoster:
      Poster(face, rng, cv::Rect({}, size));
      break;
    case Prop::kMetal:
      for (double x = 0.0; x < size.width; x += 0.16 * m) {  // ribs
        cv::rectangle(face,
                      cv::Rect(cvRound(x), 0, cvRound(0.07 * m), size.height),
                      Shaded(color_bgr, rng.uniform(0.68, 0.82)),
                      cv::FILLED);
      }
      cv::rectangle(face,
                    cv::Rect(0, 0, size.width, cvRound(0.07 * m)),
                    Shaded(color_bgr, 0.55),
                    cv::FILLED);
      Poster(face, rng, place(0.3, 0.4));
      Text(face,
           rng,
           RandomWord(rng),
           {cvRound(0.1 * m), size.height - cvRound(0.12 * m)},
           0.2 * m,
           cv::Scalar(225, 230, 230));
      break;
    case Prop::kStone:
      PaintCourses(face, rng, 0.35 * m, 0.18 * m, color_bgr, 0.2);
      break;
    case Prop::kBarrel:
      for (int i = 0; i < 4; ++i) {
        cv::rectangle(face,
                      cv::Rect(0,
                               cvRound(size.height * i / 3.3),
                               size.width,
                               std::max(2, cvRound(0.03 * m))),
                      Shaded(color_bgr, 0.6),
                      cv::FILLED);
      }
      for (int i = 0; i < 4; ++i) Poster(face, rng, place(0.25, 0.5));
      break;
  }
  for (int i = 0; i < cvRound(18.0 * size.area() / (m * m)) + 5;
       ++i) {  // rust, dirt
    Polygon(face,
            rng,
            {rng.uniform(0.0, 1.0) * size.width,
             rng.uniform(0.0, 1.0) * size.height},
            m * rng.uniform(0.01, 0.07),
            rng.uniform(3, 7),
            Shaded(RandomColor(rng, 40, 130), rng.uniform(0.6, 1.2)));
  }
  Modulate(face, Noise(rng, size, 8, 6, 0.85F), 0.25F);
  return face;
}

}  // namespace groundlock::simulator
