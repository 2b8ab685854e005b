// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/address_places.h"

#include <gtest/gtest.h>

#include <vector>

namespace groundlock::dashboard {
namespace {

std::string Network(const char* address) {
  return NetworkOf(asio::ip::make_address(address));
}

TEST(AddressPlaces, NetworksAreAddressesOrThose64BitsWide) {
  EXPECT_NE(Network("192.0.2.1"), Network("192.0.2.2"));
  EXPECT_EQ(Network("::ffff:192.0.2.1"), Network("192.0.2.1"));
  EXPECT_EQ(Network("2001:db8:0:1::1"), Network("2001:db8:0:1:ffff::2"));
  EXPECT_NE(Network("2001:db8:0:1::1"), Network("2001:db8:0:2::1"));
}

TEST(AddressPlaces, EachNetworkHasItsOwn) {
  std::vector<AddressPlaces::Place> taken;
  {
    const AddressPlaces places(2);
    taken = {places.Take("a"), places.Take("a"), places.Take("b")};
    for (const auto& place : taken) EXPECT_NE(place, nullptr);
    EXPECT_EQ(places.Take("a"), nullptr);
    EXPECT_NE(places.Take("b"), nullptr);
    taken.erase(taken.begin());
    EXPECT_NE(places.Take("a"), nullptr);
  }
  taken.clear();  // after those who gave them
}

TEST(AddressPlaces, WithoutALimitThereIsNone) {
  const AddressPlaces places(0);
  std::vector<AddressPlaces::Place> taken;
  for (int i = 0; i < 100; ++i) {
    taken.push_back(places.Take("a"));
    EXPECT_NE(taken.back(), nullptr);
  }
}

}  // namespace
}  // namespace groundlock::dashboard
