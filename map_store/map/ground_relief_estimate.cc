// SPDX-License-Identifier: Apache-2.0
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>

#include "map_store/base/order_statistics.h"
#include "map_store/geometry/plane.h"
#include "map_store/map/ground_relief.h"
#include "map_store/map/internal/bspline.h"
#include "map_store/map/internal/ground_scene.h"
#include "map_store/map/map_data.h"

namespace groundlock::map {
namespace {

using Eigen::Vector2d;
using internal::Basis;
using internal::BasisAt;
using Sparse = Eigen::SparseMatrix<double>;
using Solver = Eigen::SimplicialLDLT<Sparse>;

constexpr std::size_t kMinReliefLandmarks = 100;
// More unknowns take seconds to solve for.
constexpr std::size_t kMaxEstimatedKnots = 2'500;
// Landmarks this many camera heights above or below the plane are no ground.
constexpr double kBand = 2.0;
// As many landmarks on the ground for each knot.
constexpr double kLandmarksPerKnot = 3.0;
constexpr int kReliefRounds = 4;  // of weighting, at each tolerance
// A landmark's height is good to its tolerance (ground_scene.h), and what is of
// the ground lies within so many of them of the surface at each level, and
// below it so many times as far: what lies low is of the ground although the
// surface may not be there yet.
constexpr std::array<double, 4> kTolerances = {16.0, 8.0, 4.0, 2.0};
constexpr double kForgiven = 3.0;
// In the end it scatters by so many.
constexpr std::array<double, 2> kScatters = {1.0, 0.5};
constexpr int kScatterRounds = 12;
// What stands on the ground may have landmarks at all heights of the band, so
// many times as densely as if it were spread evenly; of what is wrong, so much
// lies below the ground.
constexpr double kWallDensity = 5.0;
constexpr double kSeldomBelow = 0.1;
// Nothing drives or walks where it is steeper: tan 40 degrees.
constexpr double kSteepest = 0.84;
// Where less of what is seen is of the ground, it may as well be none of it.
constexpr double kLeastShareOnRelief = 0.1;
// What lies on a line, seen from above, is a wall; in steps of the grid.
constexpr double kLeastSpread = 0.15;
constexpr double kInverseRootTwoPi = 0.3989422804014327;
// Curvatures of the ground, 1 sigma, rad per camera height. At the levels, and
// those that are weighed in the end; the plane is the first one.
constexpr std::array<double, 4> kLevelCurvatures = {0.03, 0.06, 0.1, 0.2};
constexpr double kScatterCurvature = 0.3;
constexpr std::array<double, 6> kCurvatures = {
    1e-4, 0.01, 0.03, 0.1, 0.17, 0.3};
// Errors of neighbouring landmarks hang together: so many count as one.
constexpr double kDependent = 4.0;
// Where the height is not known to this share of the camera's, nobody knows it.
constexpr double kMaxSigmaShare = 0.1;
// The plane's own height and tilt are known to this, which keeps them finite:
// camera heights.
constexpr double kPlaneHeightSigma = 1.0;

struct GroundPoint {
  Vector2d p_plane;
  double height = 0.0;
  double tolerance = 0.0;
};

// A spline's fit to weighted heights.
class Fit {
 public:
  Fit(const GroundRelief& grid,
      const std::vector<GroundPoint>& points,
      double camera_height)
      : grid_(grid), points_(points), camera_height_(camera_height) {
    for (const GroundPoint& point : points) {
      const Vector2d t = (point.p_plane - grid.origin_plane) / grid.step;
      const Basis x = BasisAt(t.x());
      const Basis y = BasisAt(t.y());
      Row row;
      for (int j = 0; j < 3; ++j) {
        for (int i = 0; i < 3; ++i) {
          row.knots[3 * j + i] = static_cast<int>(
              (y.first + j) * static_cast<std::ptrdiff_t>(grid.columns) +
              x.first + i);
          row.values[3 * j + i] = x.value[i] * y.value[j];
          row.slopes[3 * j + i] =
              Vector2d(x.slope[i] * y.value[j], x.value[i] * y.slope[j]) /
              grid.step;
        }
      }
      rows_.push_back(row);
    }
    weights_.assign(points.size(), 0.0);
    belonging_.assign(points.size(), 0.5);
    next_belonging_ = belonging_;
    heights_.assign(points.size(), 0.0);  // the plane
    slopes_.assign(points.size(), 0.0);
    penalty_ = Penalty();
    penalty_.makeCompressed();
    for (const Row& row : rows_) {
      if (!entries_of_.contains(row.Middle())) {
        entries_of_[row.Middle()] = EntriesOf(row);
      }
    }
    solver_.analyzePattern(penalty_);
  }

  // Weights by how far each point is from the surface as it is (Geman &
  // McClure), more forgiving where it lies below.
  void WeighByDistance(double num_tolerances) {
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const double tolerance = points_[i].tolerance;
      const double above = points_[i].height - heights_[i];
      const double may =
          tolerance * num_tolerances * (above < 0.0 ? kForgiven : 1.0);
      const double root = 1.0 / (1.0 + above * above / (may * may));
      weights_[i] = root * root / (tolerance * tolerance);
    }
  }

  // Weights by how likely each point is to be of the surface as it is: a
  // mixture, in each neighbourhood, of points that scatter about it and of
  // others that stand anywhere above it (walls, whatever stands on the ground)
  // or, seldom, lie below.
  //   num_tolerances  by which those of the surface scatter, 1 sigma
  void WeighByLikelihood(double num_tolerances) {
    std::vector<Neighbourhood> cells(grid_.knots.size());
    for (std::size_t i = 0; i < points_.size(); ++i) {
      Neighbourhood& cell = cells[rows_[i].Middle()];
      cell.count += 1.0;
      cell.belonging += belonging_[i];
      cell.sum += belonging_[i] * points_[i].p_plane;
      cell.squares +=
          belonging_[i] * points_[i].p_plane * points_[i].p_plane.transpose();
    }
    const std::vector<Neighbourhood> about = Gathered(cells);
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const Neighbourhood& near = about[rows_[i].Middle()];
      const double tolerance = points_[i].tolerance;
      const double above = points_[i].height - heights_[i];
      const double sigma = tolerance * num_tolerances;
      double share = near.belonging / near.count;
      if (slopes_[i] > kSteepest || share < kLeastShareOnRelief ||
          near.LeastSpread() < kLeastSpread * grid_.step) {
        share = 0.0;
      }
      const double on = share * kInverseRootTwoPi / sigma *
                        std::exp(-0.5 * above * above / (sigma * sigma));
      const double beside = (1.0 - share) * kWallDensity /
                            (kBand * camera_height_) *
                            (above < 0.0 ? kSeldomBelow : 1.0);
      next_belonging_[i] = on / std::max(on + beside, 1e-300);
      weights_[i] = next_belonging_[i] / (tolerance * tolerance);
    }
    belonging_.swap(next_belonging_);
  }

  // The surface under these weights. False if there is none.
  //   curvature  1 sigma, rad per camera height
  bool Solve(double curvature) {
    // A second difference is the curvature times the step squared.
    const double sigma = curvature / camera_height_ * grid_.step * grid_.step;
    const double ridge_sigma = kPlaneHeightSigma * camera_height_;
    const double ridge = 1.0 / (ridge_sigma * ridge_sigma *
                                static_cast<double>(grid_.knots.size()));
    prior_ = penalty_ / (sigma * sigma);
    for (Eigen::Index i = 0; i < prior_.rows(); ++i) {
      prior_.coeffRef(i, i) += ridge;
    }
    information_ = prior_;
    double* const values = information_.valuePtr();
    Eigen::VectorXd right = Eigen::VectorXd::Zero(prior_.rows());
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      const Row& row = rows_[i];
      const Entries& entries = entries_of_.at(row.Middle());
      std::size_t next = 0;
      for (std::size_t a = 0; a < 9; ++a) {
        const double weighted = weights_[i] * row.values[a];
        right[row.knots[a]] += weighted * points_[i].height;
        for (std::size_t b = 0; b <= a; ++b) {
          values[entries[next++]] += weighted * row.values[b];
        }
      }
    }
    solver_.factorize(information_);
    if (solver_.info() != Eigen::Success) return false;
    coefficients_ = solver_.solve(right);
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      heights_[i] = 0.0;
      Vector2d slope = Vector2d::Zero();
      for (int a = 0; a < 9; ++a) {
        const double coefficient = coefficients_[rows_[i].knots[a]];
        heights_[i] += rows_[i].values[a] * coefficient;
        slope += rows_[i].slopes[a] * coefficient;
      }
      slopes_[i] = slope.norm();
    }
    return coefficients_.allFinite();
  }

  // Log of the evidence for the curvature last solved for, up to a constant of
  // the weights.
  double LogEvidence() const {
    double misfit = coefficients_.dot(prior_.selfadjointView<Eigen::Lower>() *
                                      coefficients_);
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      const double d = points_[i].height - heights_[i];
      misfit += weights_[i] * d * d;
    }
    const Solver prior(prior_);
    return 0.5 * (prior.vectorD().array().log().sum() -
                  solver_.vectorD().array().log().sum() - misfit);
  }

  // The noise is as large as it is found to be; neighbours do not count each.
  void Temper() {
    double sum = 0.0;
    double count = 0.0;
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      const double unit = points_[i].tolerance * points_[i].tolerance;
      const double d = points_[i].height - heights_[i];
      sum += weights_[i] * d * d;
      count += weights_[i] * unit;
    }
    const double factor = std::max(sum / count, 1e-4) * kDependent;
    for (double& weight : weights_) weight /= factor;
  }

  // Whether the surface leaves the plane by no more than what its landmarks'
  // heights are good for: it may as well be their common error.
  bool IsWithinTolerance() const {
    double heights = 0.0;
    double tolerances = 0.0;
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      const double tolerance = points_[i].tolerance;
      heights += belonging_[i] * heights_[i] * heights_[i];
      tolerances += belonging_[i] * tolerance * tolerance;
    }
    return heights <= tolerances;
  }

  const Eigen::VectorXd& coefficients() const { return coefficients_; }

  // 1 sigma of the height in the middle of a knot.
  double SigmaAt(std::size_t column, std::size_t row) const {
    constexpr std::array<double, 3> kMiddle = {0.125, 0.75, 0.125};
    Eigen::VectorXd b = Eigen::VectorXd::Zero(coefficients_.size());
    for (std::size_t j = 0; j < 3; ++j) {
      for (std::size_t i = 0; i < 3; ++i) {
        b[static_cast<Eigen::Index>((row + j - 1) * grid_.columns + column + i -
                                    1)] = kMiddle[i] * kMiddle[j];
      }
    }
    return std::sqrt(std::max(0.0, b.dot(solver_.solve(b))));
  }

 private:
  using Entries = std::array<std::size_t, 45>;
  struct Row {
    std::array<int, 9> knots{};
    std::array<double, 9> values{};
    std::array<Vector2d, 9> slopes;
    std::size_t Middle() const { return static_cast<std::size_t>(knots[4]); }
  };
  // Of points about a knot.
  struct Neighbourhood {
    double count = 0.0;
    double belonging = 0.0;
    // Of places, by how likely they belong.
    Vector2d sum = Vector2d::Zero();
    Eigen::Matrix2d squares = Eigen::Matrix2d::Zero();

    // Standard deviation of their places along the direction in which it is
    // least.
    double LeastSpread() const {
      if (!(belonging > 0.0)) return 0.0;
      const Vector2d mean = sum / belonging;
      const Eigen::Matrix2d covariance =
          squares / belonging - mean * mean.transpose();
      const double half = 0.5 * covariance.trace();
      const double root =
          std::sqrt(std::max(0.0, half * half - covariance.determinant()));
      return std::sqrt(std::max(0.0, half - root));
    }
  };

  // Each with the eight around it.
  std::vector<Neighbourhood> Gathered(
      const std::vector<Neighbourhood>& cells) const {
    const auto columns = static_cast<std::ptrdiff_t>(grid_.columns);
    const auto rows = static_cast<std::ptrdiff_t>(grid_.rows());
    std::vector<Neighbourhood> about(cells.size());
    for (std::ptrdiff_t y = 1; y + 1 < rows; ++y) {
      for (std::ptrdiff_t x = 1; x + 1 < columns; ++x) {
        Neighbourhood& sum = about[static_cast<std::size_t>(y * columns + x)];
        for (const std::ptrdiff_t dy : {-1, 0, 1}) {
          for (const std::ptrdiff_t dx : {-1, 0, 1}) {
            const Neighbourhood& cell =
                cells[static_cast<std::size_t>((y + dy) * columns + x + dx)];
            sum.count += cell.count;
            sum.belonging += cell.belonging;
            sum.sum += cell.sum;
            sum.squares += cell.squares;
          }
        }
      }
    }
    return about;
  }

  // Squares of second differences along both axes and across (a thin plate).
  Sparse Penalty() const {
    const auto columns = static_cast<int>(grid_.columns);
    const auto rows = static_cast<int>(grid_.rows());
    std::vector<Eigen::Triplet<double>> entries;
    int next = 0;
    const auto add = [&](std::initializer_list<std::pair<int, double>> terms) {
      for (const auto& [knot, value] : terms) {
        entries.emplace_back(next, knot, value);
      }
      ++next;
    };
    for (int y = 0; y < rows; ++y) {
      for (int x = 0; x < columns; ++x) {
        const int at = y * columns + x;
        if (x + 2 < columns) add({{at, 1.0}, {at + 1, -2.0}, {at + 2, 1.0}});
        if (y + 2 < rows) {
          add({{at, 1.0}, {at + columns, -2.0}, {at + 2 * columns, 1.0}});
        }
        if (x + 1 < columns && y + 1 < rows) {
          const double root = std::sqrt(2.0);
          add({{at, root},
               {at + 1, -root},
               {at + columns, -root},
               {at + columns + 1, root}});
        }
      }
    }
    Sparse differences(next, columns * rows);
    differences.setFromTriplets(entries.begin(), entries.end());
    // With room for what the points add: two knots each way.
    entries.clear();
    for (int y = 0; y < rows; ++y) {
      for (int x = 0; x < columns; ++x) {
        for (int v = std::max(0, y - 2); v <= y; ++v) {
          for (int u = std::max(0, x - 2); u < std::min(columns, x + 3); ++u) {
            const int at = y * columns + x;
            const int other = v * columns + u;
            if (other <= at) entries.emplace_back(at, other, 0.0);
          }
        }
      }
    }
    Sparse pattern(columns * rows, columns * rows);
    pattern.setFromTriplets(entries.begin(), entries.end());
    const Sparse square = differences.transpose() * differences;
    return pattern + Sparse(square.triangularView<Eigen::Lower>());
  }

  // Where the products of a point's nine splines lie among the values of a
  // matrix of the penalty's pattern: those on and below the diagonal.
  Entries EntriesOf(const Row& row) {
    Entries entries{};
    std::size_t next = 0;
    for (std::size_t a = 0; a < 9; ++a) {
      for (std::size_t b = 0; b <= a; ++b) {
        entries[next++] = static_cast<std::size_t>(
            &penalty_.coeffRef(row.knots[a], row.knots[b]) -
            penalty_.valuePtr());
      }
    }
    return entries;
  }

  const GroundRelief& grid_;
  const std::vector<GroundPoint>& points_;
  const double camera_height_;
  std::vector<Row> rows_;
  std::vector<double> weights_;
  // How likely each is to be of the surface.
  std::vector<double> belonging_;
  std::vector<double> next_belonging_;
  std::vector<double> heights_;  // of the surface at each point
  std::vector<double> slopes_;
  Sparse penalty_;  // lower part, as the following ones
  Sparse prior_;
  Sparse information_;
  std::map<std::size_t, Entries> entries_of_;  // by the knot in the middle
  Solver solver_;
  Eigen::VectorXd coefficients_;
};

// Knots about the points, with a margin that lets each lie within the splines.
GroundRelief GridFor(const std::vector<GroundPoint>& points) {
  std::array<double, 2> low{};
  std::array<double, 2> side{};
  for (int axis = 0; axis < 2; ++axis) {
    std::vector<double> values;
    values.reserve(points.size());
    for (const GroundPoint& point : points) {
      values.push_back(point.p_plane(axis));
    }
    low.at(axis) = *std::min_element(values.begin(), values.end());
    side.at(axis) =
        *std::max_element(values.begin(), values.end()) - low.at(axis);
  }
  GroundRelief grid;
  const double area = std::max(side[0] * side[1], 1e-12);
  // Landmarks on a line have no area.
  grid.step = std::max(
      std::sqrt(area * kLandmarksPerKnot / static_cast<double>(points.size())),
      std::max(side[0], side[1]) / static_cast<double>(kMaxEstimatedKnots));
  const auto knots = [&](int axis) {
    return static_cast<std::size_t>(std::ceil(side.at(axis) / grid.step)) + 3;
  };
  while (knots(0) * knots(1) > kMaxEstimatedKnots) grid.step *= 1.1;
  grid.columns = knots(0);
  grid.knots.resize(grid.columns * knots(1));
  grid.origin_plane = {low[0] - grid.step, low[1] - grid.step};
  return grid;
}

// Landmarks within kBand of the plane that most of them lie beside.
std::vector<GroundPoint> LowPoints(const internal::GroundScene& scene,
                                   const geometry::Plane& ground,
                                   double camera_height) {
  const geometry::PlaneAxes axes(ground);
  std::vector<GroundPoint> points;
  for (std::size_t i = 0; i < scene.points.size(); ++i) {
    const double height = ground.SignedDistance(scene.points[i]);
    if (std::abs(height) > kBand * camera_height) continue;
    points.push_back(
        {axes.FromWorld(scene.points[i]), height, scene.tolerances[i]});
  }
  if (points.size() < kMinReliefLandmarks) return {};
  // The few that lie far beyond the others would stretch the grid.
  for (int axis = 0; axis < 2; ++axis) {
    std::vector<double> values;
    values.reserve(points.size());
    for (const GroundPoint& point : points) {
      values.push_back(point.p_plane(axis));
    }
    const double low = base::Quantile(values, 0.01);
    const double high = base::Quantile(values, 0.99);
    std::erase_if(points, [&](const GroundPoint& point) {
      return point.p_plane(axis) < low || point.p_plane(axis) > high;
    });
  }
  return points;
}

}  // namespace

GroundRelief EstimateGroundRelief(const MapData& data) {
  if (data.ground_state == GroundState::kUnknown || data.views.empty()) {
    return {};
  }
  const internal::GroundScene scene = internal::MakeGroundScene(data, 0);
  std::vector<double> camera_heights;
  for (const Eigen::Vector3d& center : scene.centers) {
    camera_heights.push_back(data.ground.SignedDistance(center));
  }
  const double camera_height = base::Median(std::move(camera_heights));
  if (!(camera_height > 0.0)) return {};
  const std::vector<GroundPoint> points =
      LowPoints(scene, data.ground, camera_height);
  if (points.size() < kMinReliefLandmarks) return {};

  GroundRelief relief = GridFor(points);
  Fit fit(relief, points, camera_height);
  for (std::size_t level = 0; level < kTolerances.size(); ++level) {
    for (int round = 0; round < kReliefRounds; ++round) {
      fit.WeighByDistance(kTolerances[level]);
      if (!fit.Solve(kLevelCurvatures[level])) return {};
    }
  }
  for (const double scatter : kScatters) {
    for (int round = 0; round < kScatterRounds; ++round) {
      fit.WeighByLikelihood(scatter);
      if (!fit.Solve(kScatterCurvature)) return {};
    }
  }
  fit.Temper();
  double best = -std::numeric_limits<double>::infinity();
  double best_curvature = kCurvatures.front();
  for (const double curvature : kCurvatures) {
    if (!fit.Solve(curvature)) return {};
    const double evidence = fit.LogEvidence();
    if (!(evidence > best)) continue;
    best = evidence;
    best_curvature = curvature;
  }
  if (best_curvature == kCurvatures.front()) return {};
  if (!fit.Solve(best_curvature) || fit.IsWithinTolerance()) return {};
  for (std::size_t row = 0; row < relief.rows(); ++row) {
    for (std::size_t column = 0; column < relief.columns; ++column) {
      const std::size_t i = row * relief.columns + column;
      GroundRelief::Knot& knot = relief.knots[i];
      knot.coefficient =
          static_cast<float>(fit.coefficients()[static_cast<Eigen::Index>(i)]);
      knot.sigma = std::numeric_limits<float>::infinity();
      if (row == 0 || column == 0 || row + 1 == relief.rows() ||
          column + 1 == relief.columns) {
        continue;  // outside where heights are asked for
      }
      const double sigma = fit.SigmaAt(column, row);
      if (sigma < kMaxSigmaShare * camera_height) {
        knot.sigma = static_cast<float>(sigma);
      }
    }
  }
  return relief;
}

}  // namespace groundlock::map
