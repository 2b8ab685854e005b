// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/sequences.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "client/simulator/internal/camera_paths.h"
#include "map_store/base/mix_seed.h"

namespace groundlock::simulator {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Rigid3;

constexpr double kEyeHeight_m = 1.6;  // Robinson 2014, §4.1: hand-held

// The car passes behind a container and is wholly hidden for about 1.2 s.
Drive Occlusion(const Shake& shake) {
  constexpr double kDuration_s = 5.5;
  const auto car = [](double t) {
    return Vector2d(-2.95 + 1.1 * t, 1.75 + 0.1 * std::sin(0.9 * t));
  };
  const auto camera = [shake, car](double t) {
    const Vector3d eye(0.35 - 0.06 * t, -4.9 + 0.03 * t, kEyeHeight_m);
    const Vector2d p = car(t);
    return shake.Apply(eye, {0.62 * p.x(), 2.2, 0.25}, t);
  };
  return {kDuration_s, camera, CarOnPath(car)};
}

// The car drives an S towards a camera that backs away.
Drive SRun(const Shake& shake) {
  constexpr double kDuration_s = 4.0;
  const auto car = [](double t) {
    return Vector2d(-6.6 + 0.75 * std::sin(1.7 * t), 6.6 - 1.5 * t);
  };
  const auto camera = [shake, car](double t) {
    const Vector2d p = car(t);
    const Vector3d eye(
        -6.5 + 0.1 * std::sin(0.8 * t), 2.5 - 1.45 * t, kEyeHeight_m);
    return shake.Apply(
        eye, {-6.55 + 0.6 * (p.x() + 6.55), p.y() + 1.2, 0.3}, t);
  };
  return {kDuration_s, camera, CarOnPath(car)};
}

// The car drives away from 3 m to 20 m; the camera stays.
Drive Scale(const Shake& shake) {
  constexpr double kDuration_s = 5.0;
  const auto car = [](double t) {
    // Speeds up over the first second.
    const double s = t < 1.0 ? 0.5 * t * t : t - 0.5;
    return Vector2d(7.45 + 0.2 * std::sin(0.5 * t),
                    -8.3 + 3.8 * std::max(0.0, s));
  };
  const auto still_heading = [car](double t) { return car(std::max(t, 0.05)); };
  const auto camera = [shake, car](double t) {
    const double y = std::min(car(t).y() + 2.0, 3.0);
    return shake.Apply({7.3, -11.2, kEyeHeight_m}, {7.4, y, 0.35}, t);
  };
  Drive drive{kDuration_s, camera, CarOnPath(still_heading)};
  const auto position = car;
  const auto on_path = drive.world_from_car;
  drive.world_from_car = [on_path, position](double t) {
    Rigid3 pose = on_path(std::max(t, 0.06));
    pose.translation.head<2>() = position(t);
    return pose;
  };
  return drive;
}

// The camera pans away from a parked car and comes back from another side.
Drive OutOfView(const Shake& shake) {
  constexpr double kDuration_s = 7.0;
  const Vector3d parked(3.6, -7.2, 0.0);
  const auto camera = [shake, parked](double t) {
    const double away = Step(0.7, 3.0, t) * (1.0 - Step(3.8, 6.4, t));
    const double walk = Step(1.2, 5.4, t);
    const Vector3d eye =
        Mix({5.2, -11.3, kEyeHeight_m}, {2.2, -11.2, kEyeHeight_m}, walk);
    const Vector3d at_car = parked + Vector3d(0.0, 0.4, 0.3);
    // Up and to the left on the way out, level on the way back.
    const Vector3d beside(
        parked.x() - 9.0, parked.y() + 5.0, 1.2 + 0.8 * (1.0 - walk));
    return shake.Apply(eye, Mix(at_car, beside, away), t);
  };
  const Rigid3 pose = CarParked(parked, -2.79);
  return {kDuration_s, camera, [pose](double) { return pose; }};
}

// The car drives a round, so that it is seen from all sides, goes behind a
// container, turns there unseen for six seconds, and comes back: the side that
// it then shows is not the one last seen.
Drive Return(const Shake& shake) {
  constexpr double kDuration_s = 24.0;
  constexpr double kSpeed_m_s = 0.65;
  constexpr double kRound_m = 0.8;  // radius
  constexpr double kTurn_m = 0.25;
  const Vector2d center(-2.3, 1.4);
  const Vector2d turn(0.15, center.y() + kRound_m - kTurn_m);
  const double rounds_m = 2.0 * std::numbers::pi * kRound_m;
  const double there_m = turn.x() - center.x();
  const double turn_m = std::numbers::pi * kTurn_m;
  const auto at = [=](double way_m) -> Vector2d {
    if (way_m < rounds_m) {  // clockwise, to the top
      const double angle =
          0.5 * std::numbers::pi + (rounds_m - way_m) / kRound_m;
      return center + kRound_m * Vector2d(std::cos(angle), std::sin(angle));
    }
    way_m -= rounds_m;
    if (way_m < there_m) return {center.x() + way_m, turn.y() + kTurn_m};
    way_m -= there_m;
    if (way_m < turn_m) {
      const double angle = 0.5 * std::numbers::pi - way_m / kTurn_m;
      return turn + kTurn_m * Vector2d(std::cos(angle), std::sin(angle));
    }
    return {turn.x() - (way_m - turn_m), turn.y() - kTurn_m};
  };
  const double hidden_s = (rounds_m + there_m) / kSpeed_m_s;
  const double again_s = hidden_s + 6.0;
  const auto car = [=](double t) {
    return at(kSpeed_m_s *
                  (std::min(t, hidden_s) + std::max(t - again_s, 0.0)) +
              turn_m * Step(hidden_s, again_s, t));
  };
  const auto camera = [shake](double t) {
    return shake.Apply({-0.7, -3.9, kEyeHeight_m}, {-1.6, 1.2, 0.2}, t);
  };
  return {kDuration_s, camera, CarOnPath(car)};
}

// The camera goes round a parked car, looks away while it goes half of the way
// back, and sees the car again from a side that was not the last one seen.
Drive Around(const Shake& shake) {
  constexpr double kDuration_s = 18.0;
  const Vector3d parked(3.6, -7.2, 0.0);
  const auto camera = [shake, parked](double t) {
    constexpr double kRadius_m = 3.4;
    const double angle =
        -1.7 + 3.4 * Step(0.0, 10.0, t) - 1.8 * Step(11.0, 16.0, t);
    const Vector3d out(std::cos(angle), std::sin(angle), 0.0);
    const Vector3d across(-out.y(), out.x(), 0.0);
    const double away = Step(10.2, 11.6, t) * (1.0 - Step(15.0, 16.6, t));
    const Vector3d eye =
        parked + kRadius_m * out + kEyeHeight_m * Vector3d::UnitZ();
    const Vector3d at_car = parked + Vector3d(0.0, 0.0, 0.3);
    const Vector3d beside = parked + 6.0 * across + Vector3d(0.0, 0.0, 1.2);
    return shake.Apply(eye, Mix(at_car, beside, away), t);
  };
  const Rigid3 pose = CarParked(parked, -2.79);
  return {kDuration_s, camera, [pose](double) { return pose; }};
}

// The camera walks past a parked car, from 15 m to 3 m and a little on.
Drive Parked(const Shake& shake, double heading_deg) {
  constexpr double kDuration_s = 10.5;
  const Vector3d parked(-5.3, -5.0, 0.0);
  const auto camera = [shake, parked](double t) {
    const Vector3d eye(parked.x() - 3.0, 9.5 - 1.45 * t, kEyeHeight_m);
    return shake.Apply(eye, parked + Vector3d(0.0, 0.0, 0.3), t);
  };
  const Rigid3 pose = CarParked(parked, heading_deg * std::numbers::pi / 180.0);
  return {kDuration_s, camera, [pose](double) { return pose; }};
}

// Two cars that look the same come towards each other and pass, one close
// before the other; from a camera that is held low, so that it hides the other.
Drive Crossing(const Shake& shake) {
  constexpr double kDuration_s = 6.0;
  constexpr double kApart_m = 0.8;
  const auto way = [](double t) { return 0.65 * (t - 0.5 * kDuration_s); };
  const auto car = [way](double t) -> Vector2d {
    return {-6.3 + way(t), 0.4 + kApart_m + 0.1 * std::sin(0.9 * t)};
  };
  const auto other = [way](double t) -> Vector2d {
    return {-6.1 - way(t), 0.4 + 0.1 * std::sin(0.9 * t)};
  };
  const auto camera = [shake](double t) {
    constexpr double kHeight_m = 0.75;
    return shake.Apply({-6.3 + 0.05 * t, -5.2, kHeight_m}, {-6.2, 0.6, 0.2}, t);
  };
  return {kDuration_s, camera, CarOnPath(car), {CarOnPath(other)}};
}

// Where a car comes by, and where it heads there.
struct Station {
  Vector2d at;
  double heading_deg = 0.0;
};

// Drives to where it stands for a while, and off from there.
struct QuartetCar {
  Station from;
  Station stand;
  Station to;
  double start_s = 0.0;
  double stop_s = 0.0;
  double go_s = 0.0;
  double end_s = 0.0;
  double off = 1.0;  // negative: backs, by that share of the way it came
};

// Smoothly over the stations: ways 0, 1 and 2.
Vector2d Along(const QuartetCar& car, double way) {
  const Station& a = way < 1.0 ? car.from : car.stand;
  const Station& b = way < 1.0 ? car.stand : car.to;
  const double apart_m = (b.at - a.at).norm();
  const auto slope = [&](const Station& station) -> Vector2d {
    const double heading = station.heading_deg * std::numbers::pi / 180.0;
    return apart_m * Vector2d(std::cos(heading), std::sin(heading));
  };
  const double s = way < 1.0 ? way : way - 1.0;
  const double r = 1.0 - s;
  return (1.0 + 2.0 * s) * r * r * a.at + s * r * r * slope(a) +
         (1.0 + 2.0 * r) * s * s * b.at - r * s * s * slope(b);
}

// Four cars that look the same come together and cross each other's ways, in
// five of the six pairs so that they change sides in the picture; stand beside
// each other, two of them partly behind others; and part, three onwards and one
// back. Which is which, only their ways tell. The camera is held rather low, so
// that near ones hide most of far ones that they pass.
Drive Quartet(const Shake& shake) {
  constexpr double kDuration_s = 18.0;
  const Vector2d middle(-7.4, 0.8);
  // About the middle. No two come nearer than a metre.
  const std::vector<QuartetCar> cars = {{{{-1.15, -0.15}, 10.0},
                                         {{1.2, 0.9}, 95.0},
                                         {{-0.5, 2.65}, 125.0},
                                         0.4,
                                         6.2,
                                         10.8,
                                         16.0},
                                        {{{1.05, -1.2}, 70.0},
                                         {{-0.6, 1.2}, 125.0},
                                         {{-2.6, 3.45}, 200.0},
                                         2.8,
                                         8.2,
                                         11.4,
                                         17.6},
                                        {{{-0.25, 1.65}, -110.0},
                                         {{-0.6, -0.7}, -30.0},
                                         {{1.2, -0.7}, 25.0},
                                         1.0,
                                         6.0,
                                         12.2,
                                         16.2},
                                        {{{1.9, 2.4}, 180.0},
                                         {{-1.25, 0.25}, 180.0},
                                         {{-2.1, 0.25}, 180.0},
                                         0.4,
                                         7.6,
                                         10.8,
                                         17.4,
                                         -0.9}};
  const auto on_path = [&](const QuartetCar& car) {
    return CarOnPath(
        [car, middle](double way) -> Vector2d {
          return middle + Along(car, way);
        },
        [car](double t) {
          return Step(car.start_s, car.stop_s, t) +
                 car.off * Step(car.go_s, car.end_s, t);
        });
  };
  const auto camera = [shake, middle](double t) {
    constexpr double kHeight_m = 1.2;
    const Vector2d eye = middle + Vector2d(-0.45 + 0.05 * t, -8.6);
    const Vector2d ahead = middle + Vector2d(-0.2, 0.8);
    return shake.Apply(
        {eye.x(), eye.y(), kHeight_m}, {ahead.x(), ahead.y(), 0.25}, t);
  };
  return {kDuration_s,
          camera,
          on_path(cars[0]),
          {on_path(cars[1]), on_path(cars[2]), on_path(cars[3])}};
}

// Laps of two cars and a camera that end where they began, so that the sequence
// may be shown again and again: one car goes round the container, which hides
// it for a while, the other drives small rounds beside it, and once a lap the
// camera looks away from both.
constexpr double kLap_s = 16.0;
Drive Laps(const Shake& shake) {
  const auto car = [](double t) -> Vector2d {
    const double angle =
        -0.5 * std::numbers::pi - 0.6 + 2 * std::numbers::pi * t / kLap_s;
    return {2.6 * std::cos(angle), 0.35 + 1.5 * std::sin(angle)};
  };
  const auto other = [](double t) -> Vector2d {
    constexpr double kRounds = 3.0;
    const double angle =
        std::numbers::pi + kRounds * 2 * std::numbers::pi * t / kLap_s;
    return {-3.1 + 0.6 * std::cos(angle), 2.8 + 0.6 * std::sin(angle)};
  };
  const auto camera = [shake, car](double t) {
    const double lap_s = t - kLap_s * std::floor(t / kLap_s);
    const double away = Step(2.4, 3.6, lap_s) * (1.0 - Step(4.8, 6.2, lap_s));
    const double sway = std::sin(2 * std::numbers::pi * t / kLap_s);
    const Vector3d eye(0.3 + 0.4 * sway, -4.9, kEyeHeight_m);
    const Vector3d at_car(0.5 * car(t).x() - 0.3, 1.4, 0.25);
    return shake.Apply(eye, Mix(at_car, {-7.5, -1.0, 0.9}, away), t);
  };
  return {kLap_s, camera, CarOnPath(car), {CarOnPath(other)}};
}

// Parked cars are seen from any side; none stands along or across the walk.
struct ParkedHeading {
  std::string_view sequence;
  double heading_deg = 0.0;
};
constexpr std::array<ParkedHeading, 4> kParkedHeadings = {
    {{"parked20", 20.0},
     {"parked65", 65.0},
     {"parked110", 110.0},
     {"parked155", 155.0}}};

// The camera whips to one side, to the other and back, up to 380 deg/s, and
// rests in between: in a frame, things are smeared over up to 90 pixels.
Drive Pan(const Shake& shake) {
  constexpr double kDuration_s = 6.0;
  const auto camera = [shake](double t) {
    const double turn_rad = 0.7 * Step(0.8, 1.2, t) - 1.4 * Step(1.8, 2.2, t) +
                            1.4 * Step(2.9, 3.35, t) - 0.7 * Step(4.1, 4.6, t);
    const Vector3d eye(0.3 - 0.05 * t, -4.6, kEyeHeight_m);
    const Vector3d ahead(
        6.5 * std::sin(turn_rad), 6.5 * std::cos(turn_rad), -1.2);
    return shake.Apply(eye, eye + ahead, t);
  };
  const Rigid3 pose = CarParked({-0.4, 0.2, 0.0}, 0.4);
  return {kDuration_s, camera, [pose](double) { return pose; }};
}

// With cars that stand on level ground.
std::optional<Drive> LevelDrive(std::string_view sequence,
                                const Terrain& terrain,
                                std::uint64_t seed) {
  const auto shake = [&](std::uint64_t number, double period_s = 0.0) {
    return Shake(terrain, base::MixSeed(seed, number), period_s);
  };
  if (sequence == "occlusion") return Occlusion(shake(11));
  if (sequence == "srun") return SRun(shake(12));
  if (sequence == "scale") return Scale(shake(13));
  if (sequence == "outofview") return OutOfView(shake(14));
  if (sequence == "return") return Return(shake(15));
  if (sequence == "around") return Around(shake(16));
  if (sequence == "crossing") return Crossing(shake(17));
  if (sequence == "quartet") return Quartet(shake(25));
  if (sequence == "laps") return Laps(shake(18, kLap_s));
  if (sequence == "pan") return Pan(shake(19));
  for (const ParkedHeading& parked : kParkedHeadings) {
    if (sequence == parked.sequence) {
      return Parked(shake(19), parked.heading_deg);
    }
  }
  return std::nullopt;
}

}  // namespace

std::vector<std::string> YardSequenceNames() {
  std::vector<std::string> names = {std::string(kMapping),
                                    "occlusion",
                                    "srun",
                                    "scale",
                                    "outofview",
                                    "return",
                                    "around",
                                    "crossing",
                                    "quartet",
                                    "laps",
                                    "pan"};
  for (const ParkedHeading& parked : kParkedHeadings) {
    names.emplace_back(parked.sequence);
  }
  return names;
}

std::optional<Drive> YardDrive(std::string_view sequence,
                               const Terrain& terrain,
                               std::uint64_t seed) {
  std::optional<Drive> drive = LevelDrive(sequence, terrain, seed);
  if (!drive || terrain.is_level()) return drive;
  const auto stand = [&terrain](std::function<Rigid3(double)>& car) {
    car = [terrain, level = car](double t_s) {
      return terrain.Stand(level(t_s));
    };
  };
  stand(drive->world_from_car);
  for (auto& other : drive->world_from_other_cars) stand(other);
  return drive;
}

std::vector<Rigid3> YardMappingViews(const Terrain& terrain,
                                     std::uint64_t seed) {
  const Shake shake(terrain, base::MixSeed(seed, 10));
  std::vector<Rigid3> views;
  const auto add = [&](double x, double y, double to_x, double to_y) {
    const double t_s = 0.37 * static_cast<double>(views.size());
    const double height_m = kEyeHeight_m + 0.12 * shake.At(2, 3.0 * t_s);
    views.push_back(shake.Apply({x, y, height_m}, {to_x, to_y, 0.5}, t_s));
  };
  for (int i = 0; i < 8; ++i) {  // before the drive of "occlusion"
    const double f = i / 7.0 - 0.5;
    add(4.4 * f, -5.1 + 0.5 * (i % 2), 2.6 * f, 2.2);
  }
  for (int i = 0; i < 7; ++i) {  // along "srun"
    add(-6.5 + 0.6 * ((i % 3) - 1), 2.7 - 1.15 * i, -6.5, 7.2 - 1.15 * i);
  }
  for (int i = 0; i < 5; ++i) {  // along "scale"
    add(7.3 + 0.5 * ((i % 3) - 1), -11.3 + 0.9 * i, 7.4, -1.0 + 1.5 * i);
  }
  for (int i = 0; i < 10; ++i) {  // around the parked car of "outofview"
    const double f = i / 9.0;
    const double turn = f * 1.35;
    const double x = 5.4 - 3.4 * f;
    add(x,
        -11.4 + 0.3 * (i % 2),
        x - 5.0 * std::sin(turn) - 0.6,
        -11.2 + 5.0 * std::cos(turn));
  }
  for (int i = 0; i < 3; ++i) {  // where "outofview" comes back to the car
    add(1.9 + 0.6 * i, -11.1 - 0.2 * (i % 2), 3.2 + 0.2 * i, -6.8);
  }
  constexpr int kRound = 24;
  for (int i = 0; i < kRound; ++i) {  // around the yard, looking inwards
    const double angle = 2 * std::numbers::pi * i / kRound;
    const Vector2d out(std::cos(angle), std::sin(angle));
    add(9.3 * out.x(), 9.3 * out.y(), -3.0 * out.x(), -3.0 * out.y());
  }
  return views;
}

}  // namespace groundlock::simulator
