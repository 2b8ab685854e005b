// SPDX-License-Identifier: Apache-2.0
// What the 2D trackers know, each part listed once for writing and reading
// (map_store/base/state_stream.h), and within which bounds numbers must be so
// that nobody is led astray by bytes that no tracker has written. For the
// trackers' own sources.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_STATE_FIELDS_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_STATE_FIELDS_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <span>
#include <string_view>

#include "map_store/base/state_stream.h"
#include "map_store/geometry/state_fields.h"
#include "server/target/act_tracker.h"
#include "server/target/dcf_tracker.h"
#include "server/target/internal/input_check.h"

namespace groundlock::target::internal {

// Of what filters have learnt, whose products then stay finite.
inline constexpr double kLargestLearnt = 1e6;

// As many numbers as both sides know, none of them out of bounds.
template <typename Stream, typename T>
void Numbers(Stream& stream,
             std::string_view field,
             std::span<T> numbers,
             double least,
             double most) {
  stream.Enter(field);
  if constexpr (Stream::kReads) {
    const std::string_view raw = stream.Bytes(numbers.size_bytes());
    if (raw.size() < numbers.size_bytes()) return;
    std::memcpy(numbers.data(), raw.data(), raw.size());
    const bool are_within =
        std::all_of(numbers.begin(), numbers.end(), [&](const T& number) {
          return number >= least && number <= most;
        });
    if (are_within) return;
    std::fill(numbers.begin(), numbers.end(), T{});
    stream.Fail("is out of bounds");
  } else {
    stream.Bytes(
        {reinterpret_cast<const char*>(numbers.data()), numbers.size_bytes()});
  }
}
template <typename Stream, typename Container>
requires requires(Container& container) { container.data(); }
void Numbers(Stream& stream,
             std::string_view field,
             Container& container,
             double least,
             double most) {
  Numbers(
      stream,
      field,
      std::span(container.data(), static_cast<std::size_t>(container.size())),
      least,
      most);
}
// A matrix of CV_32F that has its size already.
template <typename Stream, base::StateOf<cv::Mat> T>
void Numbers(Stream& stream,
             std::string_view field,
             T& matrix,
             double least,
             double most) {
  Numbers(stream,
          field,
          std::span(matrix.template ptr<float>(), matrix.total()),
          least,
          most);
}

template <typename Stream, typename T>
void Number(Stream& stream,
            std::string_view field,
            T& number,
            double least,
            double most) {
  Field(stream, field, number);
  if (!(number >= least && number <= most)) stream.Fail("is out of bounds");
}

// A box that a tracker may look at.
template <typename Stream, typename T>
void TrackerBox(Stream& stream, std::string_view field, T& box_px) {
  Field(stream, field, box_px);
  if constexpr (base::StateOf<T, geometry::Box2>) {
    if (!IsUsable(box_px)) stream.Fail("is no box");
  } else {
    if (box_px && !IsUsable(*box_px)) stream.Fail("is no box");
  }
}

// Which one of those that are kept it is, of 255 none.
template <typename Stream, typename Kept>
void WhichKept(Stream& stream,
               std::string_view field,
               std::span<const Appearance* const> kept,
               const Kept*& one) {
  constexpr std::uint8_t kNone = 255;
  std::uint8_t index = kNone;
  if constexpr (!Stream::kReads) {
    const auto found = std::find(kept.begin(), kept.end(), one);
    if (found != kept.end()) {
      index = static_cast<std::uint8_t>(found - kept.begin());
    }
  }
  Field(stream, field, index);
  if constexpr (Stream::kReads) {
    one =
        index < kept.size() ? dynamic_cast<const Kept*>(kept[index]) : nullptr;
    if (index != kNone && one == nullptr) stream.Fail("is not kept");
  }
}

// For the types that keep to themselves what they consist of.
struct StateFields {
  template <typename Stream, base::StateOf<DcfSignals> T>
  static void Of(Stream& stream, T& signals) {
    stream.Enter("tracker.signals");
    StateValue(stream, signals.peak);
    StateValue(stream, signals.usual_peak);
    StateValue(stream, signals.sharpness);
    StateValue(stream, signals.sidelobe);
    StateValue(stream, signals.colour);
    StateValue(stream, signals.expected_colour);
    StateValue(stream, signals.around_colour);
    StateValue(stream, signals.excess_colour);
    StateValue(stream, signals.usual_excess);
  }

  template <typename Stream, base::StateOf<PatchSampler> T>
  static void Of(Stream& stream, T& sampler) {
    // The patch alone: colours are looked up by its values.
    for (auto& plane : sampler.planes_) {
      Numbers(stream, "tracker.patch", plane, 0.0, 255.0);
    }
  }

  //   has_patch  the patch that it last responded to is asked of once more.
  template <typename Stream, base::StateOf<DcfFilter> T>
  static void Of(Stream& stream, T& filter, bool has_patch) {
    Numbers(stream,
            "tracker.filter",
            filter.filter_,
            -kLargestLearnt,
            kLargestLearnt);
    double sigma_cells = filter.output_sigma_cells_;
    Number(stream, "tracker.output_sigma", sigma_cells, 0.1, 1e3);
    if constexpr (Stream::kReads) {
      if (stream.ok()) filter.SetOutput(sigma_cells);
    }
    if (!has_patch) return;
    Numbers(stream,
            "tracker.sample",
            filter.sample_,
            -kLargestLearnt,
            kLargestLearnt);
  }

  template <typename Stream, base::StateOf<ColourHistogram> T>
  static void Of(Stream& stream, T& colours) {
    // Sums of shares, to rounding.
    Numbers(stream, "tracker.target_colours", colours.target_, 0.0, 1.1);
    Numbers(stream, "tracker.around_colours", colours.around_, 0.0, 1.1);
    Numbers(stream, "tracker.colours", colours.probability_, 0.0, 1.0);
    Number(stream, "tracker.expected_colour", colours.expected_, 0.0, 1.1);
    Number(stream, "tracker.around_colour", colours.expected_around_, 0.0, 1.1);
  }

  template <typename Stream, base::StateOf<ColourOutline> T>
  static void Of(Stream& stream, T& outline) {
    // Shares of a box, and logarithms of such.
    constexpr double kMost = 10.0;
    Numbers(stream, "tracker.outline", outline.usual_, -kMost, kMost);
    Numbers(stream, "tracker.outline_variance", outline.variance_, 0.0, kMost);
    Numbers(
        stream, "tracker.outline_surprise", outline.surprise_, -kMost, kMost);
  }

  template <typename Stream, base::StateOf<ScaleFilter> T>
  static void Of(Stream& stream, T& scale) {
    Numbers(stream,
            "tracker.scale",
            scale.numerator_,
            -kLargestLearnt,
            kLargestLearnt);
    Numbers(stream,
            "tracker.scale_energy",
            scale.denominator_,
            0.0,
            kLargestLearnt);
  }

  template <typename Stream, typename T>
  requires base::StateOf<T, DcfTracker::KeptAppearance>
  static void Of(Stream& stream, T& kept) {
    Numbers(stream,
            "appearance.filter",
            kept.filter,
            -kLargestLearnt,
            kLargestLearnt);
    Number(stream,
           "appearance.sharpness",
           kept.recent_sharpness,
           0.0,
           kLargestLearnt);
  }

  template <typename Stream, base::StateOf<DcfTracker> T>
  static void Of(Stream& stream,
                 T& tracker,
                 std::span<const Appearance* const> kept) {
    TrackerBox(stream, "tracker.box", tracker.box_px_);
    Numbers(stream, "tracker.search", tracker.search_sizes_, 1e-6, 1e6);
    // The patch of the last Detect is there to be learnt.
    TrackerBox(stream, "tracker.looked", tracker.looked_px_);
    const bool has_patch = tracker.looked_px_.has_value();
    Of(stream, tracker.filter_, has_patch);
    if (has_patch) Of(stream, tracker.sampler_);
    Of(stream, tracker.colours_);
    Of(stream, tracker.outline_);
    Of(stream, tracker.scale_filter_);
    Of(stream, tracker.growth_filter_);
    TrackerBox(stream, "tracker.scale_box", tracker.scale_box_px_);
    Field(stream, "tracker.measures_growth", tracker.measures_growth_);
    Field(stream, "tracker.fitted_outline", tracker.fitted_outline_);
    Of(stream, tracker.signals_);
    Number(stream,
           "tracker.sharpness",
           tracker.recent_sharpness_,
           -kLargestLearnt,
           kLargestLearnt);
    Field(stream, "tracker.usual_peak", tracker.usual_peak_);
    Field(stream, "tracker.usual_excess", tracker.usual_excess_);
    Number(stream, "tracker.usual_frames", tracker.usual_frames_, 0, 1'000);
    const DcfTracker::KeptAppearance* decided = tracker.decided_;
    WhichKept(stream, "tracker.decided", kept, decided);
    if constexpr (Stream::kReads) {
      tracker.decided_ = decided;
      tracker.initialized_ = true;
    }
  }

  template <typename Stream, base::StateOf<ActFilter> T>
  static void Of(Stream& stream, T& filter) {
    if constexpr (Stream::kReads) {
      const int cells = filter.cells_;
      filter.learnt_names_.resize(cells * cells, kColourNames);
      filter.learnt_intensity_.resize(cells * cells);
      filter.numerator_ = cv::Mat::zeros(cells, cells, CV_32F);
      filter.denominator_ = cv::Mat::zeros(cells, cells, CV_32F);
    }
    // Shares, of unit axes.
    constexpr double kMost = 10.0;
    Numbers(stream, "tracker.names", filter.learnt_names_, -kMost, kMost);
    Numbers(
        stream, "tracker.intensity", filter.learnt_intensity_, -kMost, kMost);
    Numbers(stream, "tracker.projection", filter.projection_, -kMost, kMost);
    Numbers(stream,
            "tracker.covariance",
            filter.smoothed_covariance_,
            -kLargestLearnt,
            kLargestLearnt);
    // Of spectra over as many cells as there are, and products of them.
    constexpr double kMostSpectrum = 1e9;
    Numbers(stream,
            "tracker.numerator",
            filter.numerator_,
            -kMostSpectrum,
            kMostSpectrum);
    Numbers(stream,
            "tracker.denominator",
            filter.denominator_,
            0.0,
            kMostSpectrum * kLargestLearnt);
    if constexpr (Stream::kReads) {
      filter.Project(filter.learnt_names_,
                     filter.learnt_intensity_,
                     filter.model_features_);
    }
  }

  template <typename Stream, base::StateOf<ActTracker> T>
  static void Of(Stream& stream, T& tracker) {
    TrackerBox(stream, "tracker.box", tracker.box_px_);
    Of(stream, tracker.filter_);
    Field(stream, "tracker.peak", tracker.peak_);
    Field(stream, "tracker.recent_peak", tracker.recent_peak_);
    if constexpr (Stream::kReads) tracker.initialized_ = true;
  }

  // Of another tracker than DcfTracker: null.
  static const DcfTracker::KeptAppearance* AsKept(const Appearance& kept) {
    return dynamic_cast<const DcfTracker::KeptAppearance*>(&kept);
  }
  static std::unique_ptr<DcfTracker::KeptAppearance> MakeKept(
      const DcfTracker& tracker) {
    auto kept = std::make_unique<DcfTracker::KeptAppearance>();
    kept->filter.resize(tracker.filter_.filter().size());
    return kept;
  }
};

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_STATE_FIELDS_H_
