// SPDX-License-Identifier: Apache-2.0
// One page over HTTP, on a thread of its own.
#ifndef GROUNDLOCK_SERVER_APP_HTTP_PAGE_H_
#define GROUNDLOCK_SERVER_APP_HTTP_PAGE_H_

#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"

namespace groundlock::app {

// Serves until destroyed. Thread-safe.
class HttpPage {
 public:
  // `text` makes the page anew for each request, on the page's thread.
  //   address  host:port; port 0 = a free one
  //   path     "/metrics"
  // kInvalidArgument: no host:port; kUnavailable: it cannot be bound.
  static absl::StatusOr<std::unique_ptr<HttpPage>> Start(
      const std::string& address,
      const std::string& path,
      const std::string& content_type,
      std::function<std::string()> text);
  ~HttpPage();
  HttpPage(const HttpPage&) = delete;
  HttpPage& operator=(const HttpPage&) = delete;

  int port() const;

 private:
  struct Parts;
  explicit HttpPage(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace groundlock::app

#endif  // GROUNDLOCK_SERVER_APP_HTTP_PAGE_H_
