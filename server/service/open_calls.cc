// SPDX-License-Identifier: Apache-2.0
#include "server/service/open_calls.h"

#include <arpa/inet.h>

#include <algorithm>
#include <cstddef>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::service {
namespace {

constexpr int kMostStreams = 1'000;
constexpr int kUnknownShare = 8;

// Of "%5B2001:db8::1%25eth0%5D:40000", as gRPC escapes it, or with brackets.
std::string_view Ipv6AddressIn(std::string_view rest) {
  for (const std::string_view open : {"%5B", "%5b", "["}) {
    if (!rest.starts_with(open)) continue;
    rest.remove_prefix(open.size());
    // What comes after an address: its scope, or the bracket.
    return rest.substr(0, rest.find_first_of("%]"));
  }
  return {};
}

}  // namespace

int CallLimits::StreamsPerConnection() const {
  const int most =
      max_calls_per_address > 0 ? max_calls_per_address : max_calls;
  return std::clamp((std::min(most, max_calls) + 1) / 2, 1, kMostStreams);
}

std::string NetworkOf(std::string_view peer) {
  constexpr std::string_view kIpv4 = "ipv4:";
  constexpr std::string_view kIpv6 = "ipv6:";
  constexpr std::size_t kNetworkBytes = 8;
  const std::string without_port(peer.substr(0, peer.rfind(':')));
  if (peer.starts_with(kIpv4)) return without_port;
  if (!peer.starts_with(kIpv6)) return "";
  const std::string text(Ipv6AddressIn(peer.substr(kIpv6.size())));
  in6_addr address{};
  if (inet_pton(AF_INET6, text.c_str(), &address) != 1) return without_port;
  return "ipv6:" +
         absl::BytesToHexString(absl::string_view(
             reinterpret_cast<const char*>(address.s6_addr), kNetworkBytes));
}

OpenCalls::OpenCalls(const CallLimits& limits,
                     std::atomic<std::int64_t>* open,
                     std::atomic<std::uint64_t>* refused)
    : limits_(limits),
      open_(open),
      refused_(refused),
      counts_(std::make_shared<Counts>()) {}

absl::StatusOr<OpenCalls::Call> OpenCalls::Enter(std::string_view peer) const {
  return EnterAs(peer, /*is_unknown=*/false);
}

absl::StatusOr<OpenCalls::Call> OpenCalls::EnterUnknown(
    std::string_view peer) const {
  return EnterAs(peer, /*is_unknown=*/true);
}

absl::StatusOr<OpenCalls::Call> OpenCalls::EnterAs(std::string_view peer,
                                                   bool is_unknown) const {
  std::string network = NetworkOf(peer);
  if (absl::Status status = Count(*counts_, limits_, network, is_unknown);
      !status.ok()) {
    ++*refused_;
    return status;
  }
  ++*open_;
  // A pointer to something, so that a call is told from none.
  return Call(counts_.get(),
              [counts = counts_,
               open = open_,
               network = std::move(network),
               is_unknown](void* /*counts*/) {
                Leave(*counts, network, is_unknown);
                --*open;
              });
}

absl::Status OpenCalls::Count(Counts& counts,
                              const CallLimits& limits,
                              const std::string& network,
                              bool is_unknown) {
  base::MutexLock lock(&counts.mutex);
  const int most_unknown = std::max(1, limits.max_calls / kUnknownShare);
  if (is_unknown && counts.unknown >= most_unknown) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "the server has ",
        most_unknown,
        " calls open of callers that it does not know, all it may"));
  }
  if (counts.total >= limits.max_calls) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "the server has ", limits.max_calls, " calls open, all it may"));
  }
  if (!network.empty()) {
    const auto of_network = counts.networks.try_emplace(network).first;
    if (limits.max_calls_per_address > 0 &&
        of_network->second >= limits.max_calls_per_address) {
      return absl::ResourceExhaustedError(
          absl::StrCat("your address has ",
                       limits.max_calls_per_address,
                       " calls open, all it may"));
    }
    ++of_network->second;
  }
  ++counts.total;
  if (is_unknown) ++counts.unknown;
  return absl::OkStatus();
}

void OpenCalls::Leave(Counts& counts,
                      const std::string& network,
                      bool is_unknown) {
  base::MutexLock lock(&counts.mutex);
  --counts.total;
  if (is_unknown) --counts.unknown;
  if (network.empty()) return;
  const auto of_network = counts.networks.find(network);
  if (--of_network->second == 0) counts.networks.erase(of_network);
}

}  // namespace groundlock::service
