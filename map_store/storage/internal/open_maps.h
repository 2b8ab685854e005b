// SPDX-License-Identifier: Apache-2.0
// Which maps a store has open, so that each is mapped once.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_OPEN_MAPS_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_OPEN_MAPS_H_

#include <algorithm>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "map_store/base/mutex.h"
#include "map_store/map/map.h"

namespace groundlock::storage::internal {

// A map that keeps `guard` (a lock, a pin) for as long as anybody holds the
// map, and a little longer.
template <typename Guard>
std::shared_ptr<const map::Map> WithGuard(Guard guard,
                                          std::shared_ptr<const map::Map> map) {
  struct Guarded {
    Guard guard;  // goes after the map
    std::shared_ptr<const map::Map> map;
  };
  auto guarded =
      std::make_shared<Guarded>(Guarded{std::move(guard), std::move(map)});
  return {guarded, guarded->map.get()};
}

// Thread-safe.
class OpenMaps {
 public:
  // Null if nobody holds it.
  std::shared_ptr<const map::Map> Find(const std::string& key) const {
    base::MutexLock lock(&mutex_);
    const auto found = maps_.find(key);
    return found == maps_.end() ? nullptr : found->second.lock();
  }
  // Returns the one that is there already if another thread was faster.
  std::shared_ptr<const map::Map> Add(const std::string& key,
                                      std::shared_ptr<const map::Map> map) {
    base::MutexLock lock(&mutex_);
    std::erase_if(maps_,
                  [](const auto& item) { return item.second.expired(); });
    auto& entry = maps_[key];
    if (auto earlier = entry.lock()) return earlier;
    entry = map;
    return map;
  }
  // That somebody holds.
  std::uint64_t size() const {
    base::MutexLock lock(&mutex_);
    return static_cast<std::uint64_t>(
        std::count_if(maps_.begin(), maps_.end(), [](const auto& item) {
          return !item.second.expired();
        }));
  }

 private:
  mutable base::Mutex mutex_;
  std::map<std::string, std::weak_ptr<const map::Map>> maps_
      ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_OPEN_MAPS_H_
