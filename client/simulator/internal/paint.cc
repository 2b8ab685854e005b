// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/paint.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

namespace groundlock::simulator {
namespace {

constexpr int kShift = 4;  // fractional bits of OpenCV's drawing functions

cv::Point Fixed(double x, double y) {
  return {cvRound(x * (1 << kShift)), cvRound(y * (1 << kShift))};
}

cv::Scalar RandomColor(cv::RNG& rng, int low, int high) {
  return {static_cast<double>(rng.uniform(low, high)),
          static_cast<double>(rng.uniform(low, high)),
          static_cast<double>(rng.uniform(low, high))};
}

cv::Scalar Shaded(const cv::Scalar& color, double factor) {
  return {color[0] * factor, color[1] * factor, color[2] * factor};
}

std::string RandomWord(cv::RNG& rng) {
  static constexpr char kLetters[] = "ABCDEFGHKLMNOPRSTUVXYZ23456789";
  std::string word;
  const int length = rng.uniform(2, 6);
  for (int i = 0; i < length; ++i) {
    word += kLetters[rng.uniform(0, static_cast<int>(sizeof(kLetters)) - 1)];
  }
  return word;
}

void Ellipse(cv::Mat& image,
             const cv::Point2d& center,
             double long_px,
             double short_px,
             double angle_deg,
             const cv::Scalar& color) {
  cv::ellipse(image,
              Fixed(center.x, center.y),
              Fixed(long_px, short_px),
              angle_deg,
              0,
              360,
              color,
              cv::FILLED,
              cv::LINE_AA,
              kShift);
}

void Polygon(cv::Mat& image,
             cv::RNG& rng,
             const cv::Point2d& center,
             double radius_px,
             int corners,
             const cv::Scalar& color) {
  std::vector<cv::Point> points;
  for (int i = 0; i < corners; ++i) {
    const double angle = CV_2PI * (i + rng.uniform(-0.35, 0.35)) / corners;
    const double r = radius_px * rng.uniform(0.5, 1.0);
    points.push_back(
        Fixed(center.x + r * std::cos(angle), center.y + r * std::sin(angle)));
  }
  cv::fillPoly(image,
               std::vector<std::vector<cv::Point>>{points},
               color,
               cv::LINE_AA,
               kShift);
}

// image *= 1 + gain * noise, per pixel.
void Modulate(cv::Mat& image, const cv::Mat& noise, float gain) {
  image.forEach<cv::Vec3b>([&](cv::Vec3b& pixel, const int* at) {
    const float factor = 1.0F + gain * noise.at<float>(at[0], at[1]);
    for (int c = 0; c < 3; ++c) {
      pixel[c] =
          cv::saturate_cast<uchar>(static_cast<float>(pixel[c]) * factor);
    }
  });
}

void Text(cv::Mat& image,
          cv::RNG& rng,
          const std::string& text,
          const cv::Point& at,
          double height_px,
          const cv::Scalar& color) {
  constexpr double kLetterHeight_px = 22.0;  // Hershey fonts at scale 1
  const std::array<int, 4> fonts = {cv::FONT_HERSHEY_SIMPLEX,
                                    cv::FONT_HERSHEY_DUPLEX,
                                    cv::FONT_HERSHEY_TRIPLEX,
                                    cv::FONT_HERSHEY_COMPLEX};
  const double scale = height_px / kLetterHeight_px;
  cv::putText(image,
              text,
              at,
              fonts[rng.uniform(0, 4)],
              scale,
              color,
              std::max(1, cvRound(scale * rng.uniform(1.5, 4.0))),
              cv::LINE_AA);
}

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

void PaintCracks(cv::Mat& image, cv::RNG& rng, int count, double px_per_m) {
  for (int i = 0; i < count; ++i) {
    cv::Point2d at(rng.uniform(0.0, 1.0) * image.cols,
                   rng.uniform(0.0, 1.0) * image.rows);
    double angle = rng.uniform(0.0, CV_2PI);
    const int steps = rng.uniform(10, 60);
    for (int s = 0; s < steps; ++s) {
      angle += rng.uniform(-0.6, 0.6);
      const double step = px_per_m * rng.uniform(0.03, 0.09);
      const cv::Point2d next(at.x + step * std::cos(angle),
                             at.y + step * std::sin(angle));
      cv::line(image,
               Fixed(at.x, at.y),
               Fixed(next.x, next.y),
               cv::Scalar::all(rng.uniform(30, 55)),
               rng.uniform(1, 3),
               cv::LINE_AA,
               kShift);
      at = next;
    }
  }
}

void PaintLitter(cv::Mat& image, cv::RNG& rng, double px_per_m, double area) {
  const std::array<cv::Scalar, 6> leaves = {cv::Scalar(30, 110, 180),
                                            cv::Scalar(25, 60, 110),
                                            cv::Scalar(40, 150, 190),
                                            cv::Scalar(30, 95, 70),
                                            cv::Scalar(35, 45, 75),
                                            cv::Scalar(60, 170, 160)};
  const int pebbles = cvRound(55 * area);
  for (int i = 0; i < pebbles; ++i) {
    const double size = px_per_m * 0.004 * std::exp(rng.uniform(0.0, 1.5));
    const int level =
        rng.uniform(0, 3) == 0 ? rng.uniform(35, 70) : rng.uniform(120, 215);
    Ellipse(image,
            {rng.uniform(0.0, 1.0) * image.cols,
             rng.uniform(0.0, 1.0) * image.rows},
            size,
            size * rng.uniform(0.5, 1.0),
            rng.uniform(0, 180),
            cv::Scalar(level * 0.94, level * 0.98, level));
  }
  const int count = cvRound(11 * area);
  for (int i = 0; i < count; ++i) {
    const double size = px_per_m * rng.uniform(0.015, 0.05);
    Ellipse(image,
            {rng.uniform(0.0, 1.0) * image.cols,
             rng.uniform(0.0, 1.0) * image.rows},
            size,
            size * rng.uniform(0.3, 0.6),
            rng.uniform(0, 180),
            Shaded(leaves[rng.uniform(0, 6)], rng.uniform(0.7, 1.2)));
  }
}

void PaintMarkings(cv::Mat& image, cv::RNG& rng, double px_per_m) {
  const cv::Scalar white(205, 210, 212);
  for (int i = 0; i < 14; ++i) {  // stripes
    const cv::Point2d at(rng.uniform(0.1, 0.9) * image.cols,
                         rng.uniform(0.1, 0.9) * image.rows);
    const double angle = rng.uniform(0, 2) * CV_PI / 2 + rng.uniform(-0.1, 0.1);
    const double length = px_per_m * rng.uniform(1.0, 4.0);
    cv::line(
        image,
        Fixed(at.x, at.y),
        Fixed(at.x + length * std::cos(angle), at.y + length * std::sin(angle)),
        white,
        cvRound(px_per_m * 0.09),
        cv::LINE_AA,
        kShift);
  }
  for (int i = 0; i < 26; ++i) {  // numbers and letters
    const bool yellow = rng.uniform(0, 3) == 0;
    Text(image,
         rng,
         RandomWord(rng),
         {cvRound(rng.uniform(0.05, 0.9) * image.cols),
          cvRound(rng.uniform(0.05, 0.95) * image.rows)},
         px_per_m * rng.uniform(0.25, 0.6),
         yellow ? cv::Scalar(60, 190, 215) : white);
  }
  for (int i = 0; i < 16; ++i) {  // manhole covers
    const cv::Point2d at(rng.uniform(0.05, 0.95) * image.cols,
                         rng.uniform(0.05, 0.95) * image.rows);
    const double r = px_per_m * rng.uniform(0.2, 0.34);
    Ellipse(image, at, r, r, 0, cv::Scalar(58, 62, 64));
    Ellipse(image, at, r * 0.88, r * 0.88, 0, cv::Scalar(84, 88, 92));
    for (int j = 0; j < 8; ++j) {
      Polygon(image,
              rng,
              {at.x + r * rng.uniform(-0.5, 0.5),
               at.y + r * rng.uniform(-0.5, 0.5)},
              r * 0.2,
              4,
              cv::Scalar::all(rng.uniform(45, 130)));
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

cv::Mat PaintGround(cv::RNG& rng, int side_px, float side_m) {
  const cv::Size size(side_px, side_px);
  const double px_per_m = side_px / side_m;
  const cv::Mat region = Noise(rng, size, 5, 5, 0.55F);
  const cv::Mat tone = Noise(rng, size, 12, 3, 0.8F);
  cv::Mat ground(size, CV_8UC3);
  ground.forEach<cv::Vec3b>([&](cv::Vec3b& pixel, const int* at) {
    // Asphalt where the region noise is low, sandy gravel where it is high.
    const float r = region.at<float>(at[0], at[1]);
    const float t = std::clamp((r - 0.15F) * 4.0F, 0.0F, 1.0F);
    const float level = 1.0F + 0.13F * tone.at<float>(at[0], at[1]);
    pixel[0] = cv::saturate_cast<uchar>(level * (108.0F + t * 6.0F));
    pixel[1] = cv::saturate_cast<uchar>(level * (110.0F + t * 28.0F));
    pixel[2] = cv::saturate_cast<uchar>(level * (111.0F + t * 44.0F));
  });
  for (int i = 0; i < 60; ++i) {  // repaired patches and stains
    const double level = rng.uniform(60, 135);
    Polygon(ground,
            rng,
            {rng.uniform(0.0, 1.0) * side_px, rng.uniform(0.0, 1.0) * side_px},
            px_per_m * rng.uniform(0.2, 1.2),
            rng.uniform(4, 9),
            cv::Scalar(level, level, level * 1.02));
  }
  PaintMarkings(ground, rng, px_per_m);
  PaintCracks(ground, rng, 150, px_per_m);
  Modulate(ground, Noise(rng, size, 96, 6, 0.85F), 0.34F);
  PaintLitter(ground, rng, px_per_m, side_m * side_m);
  return ground;
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
  Modulate(wall, Noise(rng, size, 10, 4, 0.8F), 0.16F);
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
