// SPDX-License-Identifier: Apache-2.0
// What a damaged map file must not do: lead anyone outside its arrays, or serve
// without a word.
#include <sys/mman.h>
#include <sys/resource.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <mutex>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/mutex.h"
#include "map_store/base/process.h"
#include "map_store/base/status.h"
#include "map_store/map/internal/file_layout.h"
#include "map_store/map/internal/mapped_file.h"
#include "map_store/map/map.h"

namespace groundlock::map {
namespace {

using internal::Damaged;
using internal::IsRange;

// The thread in the background rests so many times as long as it reads, but
// never so long that whoever closes the map notices.
constexpr int kRestFactor = 4;
constexpr std::chrono::milliseconds kLongestRest{20};

}  // namespace

// What is known of the file's state; filled in while it is used.
class Map::Integrity {
 public:
  enum class View : std::uint8_t { kUnknown, kWhole, kDamaged };

  explicit Integrity(std::size_t num_views)
      : views_(std::make_unique<std::atomic<View>[]>(num_views)) {}
  ~Integrity() {
    stop_.store(true, std::memory_order_relaxed);
    if (thread_.joinable()) thread_.join();
  }

  std::atomic<View>& view(std::size_t index) { return views_[index]; }

  // The first damage that is found stays.
  void Note(const absl::Status& damage) {
    const base::MutexLock lock(&mutex_);
    if (!damage_.ok()) return;
    damage_ = damage;
    is_damaged_.store(true, std::memory_order_release);
  }
  absl::Status damage() {
    if (!is_damaged_.load(std::memory_order_acquire)) return absl::OkStatus();
    const base::MutexLock lock(&mutex_);
    return damage_;
  }

  void Verify(const Map& map) {
    std::call_once(once_, [&] {
      thread_ = std::thread([this, &map] { VerifyGently(map); });
    });
  }

 private:
  void VerifyGently(const Map& map) {
    base::NameThisThread("gl-map-check");
#ifdef __linux__
    // On Linux this is the thread's own (nice(2)).
    static_cast<void>(
        setpriority(PRIO_PROCESS, 0, std::numeric_limits<int>::max()));
#endif
    auto began = std::chrono::steady_clock::now();
    const absl::Status status = map.VerifyChecksums([&] {
      const auto spent = std::chrono::steady_clock::now() - began;
      std::this_thread::sleep_for(std::min<std::chrono::nanoseconds>(
          kRestFactor * spent, kLongestRest));
      began = std::chrono::steady_clock::now();
      return !stop_.load(std::memory_order_relaxed);
    });
    if (absl::IsDataLoss(status)) Note(status);
  }

  const std::unique_ptr<std::atomic<View>[]> views_;
  std::atomic<bool> is_damaged_{false};
  base::Mutex mutex_;
  absl::Status damage_ ABSL_GUARDED_BY(mutex_);
  std::once_flag once_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

Map::Map() = default;

Map::~Map() {
  integrity_.reset();  // nobody reads any more
  if (mapping_ != nullptr) {
    munmap(const_cast<std::byte*>(mapping_), mapping_bytes_);
  }
}

void Map::BeginIntegrity() {
  integrity_ = std::make_unique<Integrity>(views_.size());
}

void Map::VerifyInBackground() const { integrity_->Verify(*this); }

absl::Status Map::damage() const { return integrity_->damage(); }

bool Map::IsViewWhole(const MapView& view) const {
  const auto index = static_cast<std::size_t>(&view - views_.data());
  std::atomic<Integrity::View>& state = integrity_->view(index);
  // Two threads may look at the same time, and find the same.
  Integrity::View known = state.load(std::memory_order_acquire);
  if (known == Integrity::View::kUnknown) {
    const absl::Status status = CheckFeatures(index);
    if (!status.ok()) integrity_->Note(status);
    known = status.ok() ? Integrity::View::kWhole : Integrity::View::kDamaged;
    state.store(known, std::memory_order_release);
  }
  return known == Integrity::View::kWhole;
}

absl::Status Map::CheckFeatures(std::size_t index) const {
  const MapView& view = views_[index];
  for (std::uint64_t i = 0; i < view.num_features; ++i) {
    const Feature& feature = features_[view.first_feature + i];
    if (feature.view != index) {
      return Damaged(absl::StrCat(
          "section 'views': features of view ", index, " belong to another"));
    }
    if (feature.landmark >= landmarks_.size() || !std::isfinite(feature.x_px) ||
        !std::isfinite(feature.y_px)) {
      return Damaged(absl::StrCat("section 'features': feature ",
                                  view.first_feature + i,
                                  " is out of range"));
    }
    if (!landmarks_[feature.landmark].Position().allFinite()) {
      return Damaged(absl::StrCat("section 'landmarks': landmark ",
                                  feature.landmark,
                                  " is out of range"));
    }
  }
  return absl::OkStatus();
}

std::span<const Feature> Map::FeaturesOf(const MapView& view) const {
  if (!IsViewWhole(view)) return {};
  return features_.subspan(view.first_feature, view.num_features);
}

std::span<const Descriptor> Map::DescriptorsOf(const MapView& view) const {
  if (descriptors_.empty() || !IsViewWhole(view)) return {};
  return descriptors_.subspan(view.first_feature, view.num_features);
}

std::span<const std::uint64_t> Map::ObservationsOf(
    const Landmark& landmark) const {
  if (!IsRange(landmark.first_observation,
               landmark.num_observations,
               observations_.size())) {
    integrity_->Note(Damaged("section 'landmarks': observations out of range"));
    return {};
  }
  const auto observations = observations_.subspan(landmark.first_observation,
                                                  landmark.num_observations);
  // Whoever asks for them looks at the features next: this reads them first.
  const bool is_whole = std::all_of(
      observations.begin(), observations.end(), [&](std::uint64_t feature) {
        return feature < features_.size() &&
               features_[feature].view < views_.size() &&
               features_[feature].landmark < landmarks_.size();
      });
  if (is_whole) return observations;
  integrity_->Note(Damaged("section 'observations': out of range"));
  return {};
}

absl::Status Map::Verify() const {
  RETURN_IF_ERROR(VerifyChecksums([] { return true; }));
  return VerifyIndices();
}

absl::Status Map::VerifyChecksums(const std::function<bool()>& go_on) const {
  ASSIGN_OR_RETURN(const internal::FileHeader header,
                   internal::ReadHeader({mapping_, mapping_bytes_}));
  for (std::uint32_t i = 0; i < header.num_sections; ++i) {
    const internal::SectionRecord& section = header.sections.at(i);
    const auto hash = internal::HashBytes(mapping_ + section.offset,
                                          section.count * section.element_bytes,
                                          go_on);
    if (!hash) return absl::CancelledError("the map is being closed");
    if (*hash != section.checksum) {
      return Damaged(absl::StrCat("section '",
                                  internal::SectionName(section.id),
                                  "' is damaged: checksum differs"));
    }
  }
  return absl::OkStatus();
}

// Checksums only say that the bytes are those that were written; a file made
// to look right must not lead anyone outside its arrays either.
absl::Status Map::VerifyIndices() const {
  for (std::size_t v = 0; v < views_.size(); ++v) {
    if (views_[v].name.size() > internal::kMaxNameBytes ||
        views_[v].name.find('\0') != std::string_view::npos) {
      return Damaged(
          absl::StrCat("section 'views': view ", v, " has no proper name"));
    }
    RETURN_IF_ERROR(CheckFeatures(v));
  }
  // Of no view.
  for (std::size_t i = 0; i < features_.size(); ++i) {
    if (features_[i].landmark >= landmarks_.size() ||
        features_[i].view >= views_.size()) {
      return Damaged(
          absl::StrCat("section 'features': feature ", i, " is out of range"));
    }
  }
  for (std::size_t i = 0; i < landmarks_.size(); ++i) {
    const Landmark& landmark = landmarks_[i];
    if (!landmark.Position().allFinite() || !(landmark.error_px >= 0.0F) ||
        !std::isfinite(landmark.error_px) ||
        !IsRange(landmark.first_observation,
                 landmark.num_observations,
                 observations_.size())) {
      return Damaged(absl::StrCat(
          "section 'landmarks': landmark ", i, " is out of range"));
    }
    const auto observations = observations_.subspan(landmark.first_observation,
                                                    landmark.num_observations);
    for (const std::uint64_t observation : observations) {
      if (observation >= features_.size() ||
          features_[observation].landmark != i) {
        return Damaged(absl::StrCat(
            "section 'observations': landmark ", i, " has one of another"));
      }
    }
  }
  return VerifyIndex(landmark_index_, landmarks_.size());
}

}  // namespace groundlock::map
