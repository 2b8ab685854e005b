// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/address_places.h"

#include <cstddef>

namespace groundlock::dashboard {

std::string NetworkOf(const asio::ip::address& address) {
  constexpr std::size_t kNetworkBytes = 8;
  if (address.is_v4()) return address.to_string();
  const asio::ip::address_v6 v6 = address.to_v6();
  if (v6.is_v4_mapped()) {
    return asio::ip::make_address_v4(asio::ip::v4_mapped, v6).to_string();
  }
  auto bytes = v6.to_bytes();
  for (std::size_t i = kNetworkBytes; i < bytes.size(); ++i) bytes[i] = 0;
  return asio::ip::address_v6(bytes).to_string();
}

AddressPlaces::Place AddressPlaces::Take(const std::string& network) const {
  {
    base::MutexLock lock(&counts_->mutex);
    int& count = counts_->networks[network];
    if (max_ > 0 && count >= max_) return nullptr;
    ++count;
  }
  return Place(counts_.get(), [counts = counts_, network](void* /*counts*/) {
    base::MutexLock lock(&counts->mutex);
    const auto found = counts->networks.find(network);
    if (--found->second == 0) counts->networks.erase(found);
  });
}

}  // namespace groundlock::dashboard
