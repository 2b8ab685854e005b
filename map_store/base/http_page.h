// SPDX-License-Identifier: Apache-2.0
// A few small pages over HTTP, on a thread of their own.
#ifndef GROUNDLOCK_MAP_STORE_BASE_HTTP_PAGE_H_
#define GROUNDLOCK_MAP_STORE_BASE_HTTP_PAGE_H_

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace groundlock::base {

struct HttpPage {
  std::string path;  // "/metrics"
  std::string content_type;
  struct Content {
    int status = 200;
    std::string text;
  };
  // Makes the page anew for each request, on the server's thread.
  std::function<Content()> content;
};

// Serves until destroyed. Thread-safe.
class HttpPages {
 public:
  //   address  host:port; port 0 = a free one
  // kInvalidArgument: no host:port; kUnavailable: it cannot be bound.
  static absl::StatusOr<std::unique_ptr<HttpPages>> Start(
      const std::string& address, std::vector<HttpPage> pages);
  ~HttpPages();
  HttpPages(const HttpPages&) = delete;
  HttpPages& operator=(const HttpPages&) = delete;

  int port() const;

 private:
  struct Parts;
  explicit HttpPages(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_HTTP_PAGE_H_
