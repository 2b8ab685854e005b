// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/loopback.h"

#include <arpa/inet.h>
#include <netinet/in.h>

#include <string>

namespace groundlock::base {

bool IsLoopback(std::string_view address) {
  if (address.starts_with("unix:")) return true;
  std::string_view host = address.substr(0, address.rfind(':'));
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  }
  // As a number: 127.example.com is anybody's.
  in_addr number{};
  if (inet_pton(AF_INET, std::string(host).c_str(), &number) == 1) {
    return ntohl(number.s_addr) >> IN_CLASSA_NSHIFT == IN_LOOPBACKNET;
  }
  return host == "localhost" || host == "::1";
}

}  // namespace groundlock::base
