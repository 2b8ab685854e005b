// SPDX-License-Identifier: Apache-2.0
// How many of something one address has, so that nobody has all.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_ADDRESS_PLACES_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_ADDRESS_PLACES_H_

#include <map>
#include <memory>
#include <string>

#include "absl/base/thread_annotations.h"
#include "client/dashboard/proxy/asio.h"
#include "map_store/base/mutex.h"

namespace groundlock::dashboard {

// What clients of one subscriber have in common: an IPv4 address, or an IPv6
// network of 64 bits.
std::string NetworkOf(const asio::ip::address& address);

// Thread-safe. Places may outlive it.
class AddressPlaces {
 public:
  // Somebody's, for as long as it exists; null = there is none.
  using Place = std::shared_ptr<void>;

  // max: of one network; 0 = no limit.
  explicit AddressPlaces(int max)
      : max_(max), counts_(std::make_shared<Counts>()) {}
  Place Take(const std::string& network) const;

 private:
  struct Counts {
    base::Mutex mutex;
    std::map<std::string, int> networks ABSL_GUARDED_BY(mutex);
  };
  const int max_;
  const std::shared_ptr<Counts> counts_;
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_ADDRESS_PLACES_H_
