// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/track_motion.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/track_pieces.h"
#include "map_store/build/internal/track_turn.h"

namespace groundlock::build::internal {
namespace {

// Focal lengths that starts are tried with, in the larger side: fields of view
// from 90 to 24 degrees. Neighbours differ by a fifth.
constexpr std::array<double, 9> kFocals = {
    0.5, 0.6, 0.72, 0.86, 1.03, 1.24, 1.49, 1.79, 2.4};
// How far apart the keyframes of a start may lie.
constexpr std::array<std::uint32_t, 5> kGaps = {4, 6, 9, 13, 19};
constexpr std::size_t kStarts = 5;
constexpr std::uint32_t kMaxStartImages = 10;
// What a try must hold of the keyframes, and what the better half of its tracks
// may be off by: their noise, in both axes.
constexpr double kHeldShare = 0.9;
constexpr double kMaxTrimmedCost_px2 = 2.0 * kTrackSigma_px * kTrackSigma_px;
// A lens so many of the prior's sigmas off is absurd: no camera that films is
// like that, but a start that went wrong is.
constexpr double kAbsurdSigmas = 4.0;
// Lenses no farther off must all allow a start that is to be believed.
constexpr double kPlausibleSigmas = 1.6;
// Starts that are carried on to the end, at most.
constexpr std::uint32_t kMaxTries = 3;
// Pieces that are begun behind turns.
constexpr int kMaxPieces = 8;
// All is adjusted when so much has been added.
constexpr double kGrowth = 1.3;
constexpr std::uint32_t kLocalImages = 6;
constexpr std::uint32_t kMinImages = 3;
constexpr std::uint32_t kMinForLens = 6;
// Errors of sights hang together: so many count as one.
constexpr double kSightsPerFact = 20.0;

struct Pair {
  std::uint32_t first = 0;
  std::uint32_t second = 0;
  double score = 0.0;
};

// The posed images that share most points with `image`, and itself.
std::vector<std::uint32_t> Neighbourhood(const TrackScene& scene,
                                         std::uint32_t image) {
  std::vector<std::uint32_t> shared(scene.num_images());
  for (const TrackScene::Point& point : scene.points) {
    if (!point.p_world) continue;
    const bool is_seen = std::any_of(
        point.sights.begin(), point.sights.end(), [&](const auto& sight) {
          return sight.image == image && sight.fits;
        });
    if (!is_seen) continue;
    for (const TrackScene::Sight& sight : point.sights) {
      if (sight.fits && scene.camera_from_world[sight.image]) {
        ++shared[sight.image];
      }
    }
  }
  std::vector<std::uint32_t> order(shared.size());
  for (std::uint32_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) {
    return shared[a] > shared[b];
  });
  std::vector<std::uint32_t> chosen;
  for (const std::uint32_t i : order) {
    if (shared[i] == 0 || chosen.size() == kLocalImages) break;
    chosen.push_back(i);
  }
  return chosen;
}

bool HasAbsurdLens(const TrackScene& scene) {
  if (scene.lens_is_known) return false;
  const LensPrior& prior = scene.prior;
  return std::abs(std::log(scene.lens.focal_px / prior.focal_px)) >
             kAbsurdSigmas * prior.focal_log_sigma ||
         std::abs(scene.lens.k) > kAbsurdSigmas * prior.k_sigma;
}

class Motion {
 public:
  Motion(const FeatureTracks& tracks, const MotionOptions& options)
      : tracks_(tracks), options_(options), blank_(tracks, options.camera) {}

  absl::StatusOr<TrackMotion> Run();

 private:
  absl::Status Progress(double fraction, const std::string& what) {
    if (options_.progress && !options_.progress(fraction, what)) {
      return absl::CancelledError("cancelled");
    }
    return absl::OkStatus();
  }
  // Of the images that are wanted.
  std::vector<Pair> RankPairs(
      const std::function<bool(std::uint32_t, std::uint32_t)>& is_wanted);
  // The lens that was given, else the scene's.
  absl::StatusOr<geometry::CameraModel> CameraOf(const TrackScene& scene) const;
  // A start with its images between, the focal length as it is.
  std::optional<TrackScene> Begin(const Pair& pair,
                                  const RadialLens& lens) const;
  // Takes out the pairs that begin with some lenses only.
  // What a turn parted: begins anew among the images that have no pose, and
  // joins what that gives.
  absl::Status JoinPieces(TrackMotion& motion);
  absl::StatusOr<RadialLens> AgreeOnLens(std::vector<Pair>& pairs);

  const FeatureTracks& tracks_;
  const MotionOptions& options_;
  TrackScene blank_;
  double fraction_ = 0.0;
};

std::vector<Pair> Motion::RankPairs(
    const std::function<bool(std::uint32_t, std::uint32_t)>& is_wanted) {
  std::vector<Pair> pairs;
  const std::uint32_t count = blank_.num_images();
  const std::uint32_t stride = std::max<std::uint32_t>(1, count / 20);
  TrackScene scene = blank_;
  for (std::uint32_t first = 0; first < count; first += stride) {
    Pair best;
    for (const std::uint32_t gap : kGaps) {
      const std::uint32_t second = std::min(first + gap, count - 1);
      if (second < first + 2) break;
      if (!is_wanted(first, second)) continue;
      if (!scene.Start(first, second)) continue;
      const double score = scene.Parallax();
      if (score <= best.score) continue;
      // Under a lens that is not the camera's a turn on the spot seems to show
      // depth, and all of it.
      const auto turn = FitTurn(scene, first, second, scene.lens_is_known);
      if (turn && turn->ExplainsTheTracks()) continue;
      best = {first, second, score};
    }
    if (best.score > 0.0) pairs.push_back(best);
  }
  std::stable_sort(
      pairs.begin(), pairs.end(), [](const Pair& a, const Pair& b) {
        return a.score > b.score;
      });
  // Of different stretches.
  std::vector<Pair> chosen;
  for (const Pair& pair : pairs) {
    const bool overlaps =
        std::any_of(chosen.begin(), chosen.end(), [&](const Pair& other) {
          return pair.first < other.second && other.first < pair.second;
        });
    if (!overlaps) chosen.push_back(pair);
    if (chosen.size() == kStarts) break;
  }
  return chosen;
}

std::optional<TrackScene> Motion::Begin(const Pair& pair,
                                        const RadialLens& lens) const {
  TrackScene scene = blank_;
  if (!options_.camera) scene.lens = lens;
  if (!scene.Start(pair.first, pair.second)) return std::nullopt;
  TrackScene::Adjustment adjustment;
  adjustment.threads = options_.threads;
  adjustment.max_iterations = 10;
  if (!scene.Adjust(adjustment)) return std::nullopt;
  scene.Filter(2);
  const std::uint32_t stride = std::max<std::uint32_t>(
      1, (pair.second - pair.first + kMaxStartImages - 1) / kMaxStartImages);
  for (std::uint32_t i = pair.first + stride; i < pair.second; i += stride) {
    scene.Resect(i);
  }
  if (scene.CountPosed() < kMinImages) return std::nullopt;
  adjustment.distortion = true;
  for (int round = 0; round < 2; ++round) {
    scene.Triangulate(std::nullopt, 3);
    if (!scene.Adjust(adjustment)) return std::nullopt;
    scene.Filter(3);
  }
  scene.Triangulate(std::nullopt, 3);
  return scene;
}

// The focal length that explains all starts together best: a single stretch
// may tell little about it, or something wrong (a rolling shutter, a
// stabiliser).
absl::StatusOr<RadialLens> Motion::AgreeOnLens(std::vector<Pair>& pairs) {
  struct Weighed {
    Pair pair;
    std::array<double, kFocals.size()> cost{};
    std::array<double, kFocals.size()> k{};
    double sights = 0.0;
    bool is_sound = true;
  };
  const double side_px = std::max(tracks_.width_px, tracks_.height_px);
  const LensPrior& prior = blank_.prior;
  const auto sigmas_off = [&](std::size_t f) {
    return std::log(kFocals[f] * side_px / prior.focal_px) /
           prior.focal_log_sigma;
  };
  std::vector<Weighed> weighed;
  for (std::size_t p = 0; p < pairs.size(); ++p) {
    Weighed& one = weighed.emplace_back(Weighed{pairs[p]});
    one.cost.fill(kTrackGate_px * kTrackGate_px);
    for (std::size_t f = 0; f < kFocals.size(); ++f) {
      const auto scene = Begin(pairs[p], {kFocals[f] * side_px, 0.0});
      if (scene) {
        one.cost[f] = scene->TrimmedCost_px2();
        one.k[f] = scene->lens.k;
        one.sights =
            std::max(one.sights, static_cast<double>(scene->CountSights()));
      } else if (std::abs(sigmas_off(f)) < kPlausibleSigmas) {
        one.is_sound = false;
      }
      fraction_ = 0.3 * static_cast<double>(p * kFocals.size() + f + 1) /
                  static_cast<double>(pairs.size() * kFocals.size());
      RETURN_IF_ERROR(Progress(fraction_, "looking for the lens"));
    }
  }
  // Most of a turn on the spot and a little of a way: with the right lens too
  // little depth to begin with, with a wrong one plenty of it.
  if (std::any_of(weighed.begin(), weighed.end(), [](const Weighed& one) {
        return one.is_sound;
      })) {
    std::erase_if(weighed, [](const Weighed& one) { return !one.is_sound; });
  }
  pairs.clear();
  std::array<double, kFocals.size()> costs{};
  std::array<double, kFocals.size()> ks{};
  for (const Weighed& one : weighed) {
    pairs.push_back(one.pair);
    for (std::size_t f = 0; f < kFocals.size(); ++f) {
      // Of errors whose size is unknown: log likelihood is -n / 2 log(sum).
      costs[f] += one.sights / kSightsPerFact * std::log(one.cost[f]);
      ks[f] += one.k[f] / static_cast<double>(weighed.size());
    }
  }
  for (std::size_t f = 0; f < kFocals.size(); ++f) {
    costs[f] += 0.5 * sigmas_off(f) * sigmas_off(f);
  }
  const auto best = static_cast<std::size_t>(
      std::min_element(costs.begin(), costs.end()) - costs.begin());
  double log_focal = std::log(kFocals[best]);
  // Between the grid's points by a parabola.
  if (best > 0 && best + 1 < kFocals.size()) {
    const double before = log_focal - std::log(kFocals[best - 1]);
    const double after = std::log(kFocals[best + 1]) - log_focal;
    const double rise_before = (costs[best - 1] - costs[best]) / before;
    const double rise_after = (costs[best + 1] - costs[best]) / after;
    const double curvature = rise_before + rise_after;
    if (curvature > 0.0) {
      log_focal += std::clamp(
          0.5 * (rise_before * after - rise_after * before) / curvature,
          -0.5 * before,
          0.5 * after);
    }
  }
  return RadialLens{std::exp(log_focal) * side_px, ks[best]};
}

absl::StatusOr<geometry::CameraModel> Motion::CameraOf(
    const TrackScene& scene) const {
  if (options_.camera) return *options_.camera;
  return geometry::CameraModel::Create(
      geometry::CameraModelId::kSimpleRadial,
      tracks_.width_px,
      tracks_.height_px,
      std::array<double, 4>{scene.lens.focal_px,
                            0.5 * tracks_.width_px,
                            0.5 * tracks_.height_px,
                            scene.lens.k});
}

absl::Status Motion::JoinPieces(TrackMotion& motion) {
  TrackScene& scene = motion.scene;
  std::vector<Pair> pairs;
  for (int round = 0; round < kMaxPieces; ++round) {
    if (scene.CountPosed() == scene.num_images()) break;
    if (round == 0) {
      blank_.lens = scene.lens;
      pairs = RankPairs([&scene](std::uint32_t first, std::uint32_t second) {
        return !scene.camera_from_world[first] &&
               !scene.camera_from_world[second];
      });
    }
    const auto next =
        std::find_if(pairs.begin(), pairs.end(), [&scene](const Pair& pair) {
          return !scene.camera_from_world[pair.first] &&
                 !scene.camera_from_world[pair.second];
        });
    if (next == pairs.end()) break;
    const Pair pair = *next;
    pairs.erase(next);
    std::optional<TrackScene> piece = Begin(pair, scene.lens);
    if (!piece) continue;
    const bool lens_is_known = piece->lens_is_known;
    piece->lens = scene.lens;
    piece->lens_is_known = true;
    RETURN_IF_ERROR(GrowScene(
        options_.threads,
        [this](const std::string& what) {
          return Progress(fraction_, what).ok();
        },
        *piece));
    ASSIGN_OR_RETURN(const geometry::CameraModel camera, CameraOf(scene));
    piece->lens_is_known = lens_is_known;
    const auto joint = FindJoint(scene, *piece, camera);
    if (!joint) continue;
    const std::uint32_t posed = scene.CountPosed();
    AddPiece(*piece, joint->whole_from_piece, scene);
    if (joint->is_by_ground) {
      motion.notes.push_back(absl::StrFormat(
          "%u keyframes hang on the others by a turn on the spot alone; their "
          "scale is that of the camera's height over the ground, to %.0f %%",
          scene.CountPosed() - posed,
          100.0 * joint->scale_log_sigma));
    }
    RETURN_IF_ERROR(GrowScene(
        options_.threads,
        [this](const std::string& what) {
          return Progress(fraction_, what).ok();
        },
        scene));
  }
  return absl::OkStatus();
}

absl::StatusOr<TrackMotion> Motion::Run() {
  RETURN_IF_ERROR(Progress(0.0, "looking for a start"));
  const auto turn = options_.camera ? std::nullopt : LensOfTurns(blank_);
  if (turn) {
    blank_.lens = turn->lens;
    blank_.prior.focal_px = turn->lens.focal_px;
    blank_.prior.focal_log_sigma = turn->focal_log_sigma;
  }
  blank_.turn_of = FindTurns(blank_);
  std::vector<Pair> pairs =
      RankPairs([](std::uint32_t, std::uint32_t) { return true; });
  RadialLens lens = blank_.lens;
  if (!options_.camera && !turn) {
    ASSIGN_OR_RETURN(lens, AgreeOnLens(pairs));
  }
  std::optional<TrackScene> best;
  MotionTry best_try;
  std::uint32_t tries = 0;
  std::uint32_t num_absurd = 0;
  for (const Pair& pair : pairs) {
    std::optional<TrackScene> scene = Begin(pair, lens);
    if (!scene) continue;
    ++tries;
    RETURN_IF_ERROR(GrowScene(
        options_.threads,
        [this](const std::string& what) {
          return Progress(fraction_, what).ok();
        },
        *scene));
    fraction_ = std::min(0.9, 0.3 + 0.2 * tries);
    if (HasAbsurdLens(*scene)) {
      ++num_absurd;
    } else {
      const MotionTry this_try{
          scene->CountPosed(), scene->num_images(), scene->TrimmedCost_px2()};
      if (!best || this_try.IsBetterThan(best_try)) {
        best = std::move(scene);
        best_try = this_try;
      }
    }
    if (tries == kMaxTries || (best && best_try.IsGoodEnough())) break;
  }
  if (!best || best->CountPosed() < kMinImages) {
    return absl::FailedPreconditionError(
        num_absurd > 0
            ? "only a lens that no camera has explains the keyframes"
            : "no two keyframes open enough parallax over enough points");
  }
  TrackMotion motion{*std::move(best), {}, std::nullopt, tries, {}};
  if (num_absurd > 0) {
    motion.notes.push_back(absl::StrCat(
        num_absurd,
        num_absurd == 1 ? " start" : " starts",
        " of ",
        tries,
        " led to a lens that no camera has; the map begins with another pair "
        "of keyframes instead"));
  }
  RETURN_IF_ERROR(JoinPieces(motion));
  if (options_.camera) {
    motion.camera = *options_.camera;
    return motion;
  }
  TrackScene::Adjustment adjustment;
  adjustment.threads = options_.threads;
  adjustment.is_cancelled = [this] { return !Progress(fraction_, "").ok(); };
  motion.focal_sigma_px = motion.scene.SettleLens(adjustment);
  if (!motion.focal_sigma_px) return absl::CancelledError("cancelled");
  if (HasAbsurdLens(motion.scene)) {
    return absl::FailedPreconditionError(
        "only a lens that no camera has explains the keyframes");
  }
  ASSIGN_OR_RETURN(motion.camera, CameraOf(motion.scene));
  return motion;
}

}  // namespace

bool MotionTry::HoldsEnough() const {
  return num_posed >= kHeldShare * num_images;
}

bool MotionTry::IsGoodEnough() const {
  return HoldsEnough() && trimmed_cost_px2 < kMaxTrimmedCost_px2;
}

bool MotionTry::IsBetterThan(const MotionTry& other) const {
  if (HoldsEnough() && other.HoldsEnough()) {
    return trimmed_cost_px2 < other.trimmed_cost_px2;
  }
  return num_posed > other.num_posed;
}

absl::Status GrowScene(int threads,
                       const std::function<bool(const std::string&)>& progress,
                       TrackScene& scene) {
  std::vector<bool> has_failed(scene.num_images());
  std::uint32_t adjusted_at = scene.CountPosed();
  while (true) {
    // The one that hangs on by most points comes next.
    std::uint32_t next = 0;
    std::uint32_t most = 0;
    for (std::uint32_t i = 0; i < scene.num_images(); ++i) {
      if (scene.camera_from_world[i] || has_failed[i]) continue;
      const std::uint32_t placed = scene.CountPlaced(i);
      if (placed > most) {
        most = placed;
        next = i;
      }
    }
    const bool is_over = most == 0;
    const std::uint32_t posed = scene.CountPosed();
    if (is_over || posed >= kGrowth * adjusted_at) {
      for (int round = 0; round < (is_over ? 2 : 1); ++round) {
        TrackScene::Adjustment all;
        all.threads = threads;
        all.is_cancelled = [&progress] { return !progress(""); };
        // While parts are missing the lens would take up what they lack.
        all.focal = is_over && posed >= kMinForLens;
        all.distortion = all.focal;
        scene.Adjust(all);
        scene.Filter(3);
        scene.Triangulate(std::nullopt, 3);
      }
      if (posed > adjusted_at) {
        std::fill(has_failed.begin(), has_failed.end(), false);
      }
      if (is_over && posed == adjusted_at) {
        // What has no depth leads on as far as the camera only turns.
        bool has_turned = false;
        for (std::uint32_t i = 0; i < scene.num_images(); ++i) {
          if (!scene.camera_from_world[i]) has_turned |= PlaceByTurn(i, scene);
        }
        if (!has_turned) return absl::OkStatus();
        continue;
      }
      adjusted_at = posed;
      continue;
    }
    if (!PlaceImage(next, scene)) {
      has_failed[next] = true;
      continue;
    }
    scene.Triangulate(next, 3);
    TrackScene::Adjustment local;
    local.images = Neighbourhood(scene, next);
    local.max_iterations = 8;
    local.threads = threads;
    scene.Adjust(local);
    if (!progress(
            absl::StrCat(posed + 1, " of ", scene.num_images(), " images"))) {
      return absl::CancelledError("cancelled");
    }
  }
}

absl::StatusOr<TrackMotion> ReconstructMotion(const FeatureTracks& tracks,
                                              const MotionOptions& options) {
  return Motion(tracks, options).Run();
}

}  // namespace groundlock::build::internal
