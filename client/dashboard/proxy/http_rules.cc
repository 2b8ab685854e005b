// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/http_rules.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::dashboard {
namespace {

constexpr std::size_t kMaxSegments = 32;
constexpr std::size_t kMaxUploadSegments = 16;

int HexDigit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

bool IsControl(char c) {
  return static_cast<unsigned char>(c) < 0x20 || c == '\x7f';
}

absl::StatusOr<std::string> Decode(std::string_view text) {
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    char c = text[i];
    if (c == '%') {
      const int high = i + 2 < text.size() ? HexDigit(text[i + 1]) : -1;
      const int low = i + 2 < text.size() ? HexDigit(text[i + 2]) : -1;
      if (high < 0 || low < 0) {
        return absl::InvalidArgumentError("target: a broken % escape");
      }
      c = static_cast<char>(16 * high + low);
      i += 2;
    }
    if (IsControl(c)) {
      return absl::InvalidArgumentError("target: a control character");
    }
    out.push_back(c);
  }
  return out;
}

std::string_view Trim(std::string_view text) {
  const auto is_blank = [](char c) { return c == ' ' || c == '\t'; };
  while (!text.empty() && is_blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_blank(text.back())) text.remove_suffix(1);
  return text;
}

// Takes what is in front of the next `separator` off the front of *text.
std::string_view TakePart(std::string_view* text, char separator) {
  const std::size_t end = std::min(text->find(separator), text->size());
  const std::string_view part = text->substr(0, end);
  text->remove_prefix(std::min(end + 1, text->size()));
  return part;
}

std::optional<std::uint64_t> ParseNumber(std::string_view text) {
  std::uint64_t value = 0;
  const auto result =
      std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || result.ec != std::errc() ||
      result.ptr != text.data() + text.size()) {
    return std::nullopt;
  }
  return value;
}

bool Equal(std::string_view a, std::string_view b) {
  return absl::EqualsIgnoreCase(base::Abseil(a), base::Abseil(b));
}

// "host" of "host:port" and "[::1]:port".
std::string_view HostName(std::string_view host) {
  if (!host.empty() && host.front() == '[') {
    return host.substr(0, std::min(host.find(']'), host.size() - 1) + 1);
  }
  return host.substr(0, std::min(host.find(':'), host.size()));
}

// What follows "scheme://".
std::string_view HostOfOrigin(std::string_view origin) {
  const std::size_t at = origin.find("://");
  return at == std::string_view::npos ? std::string_view()
                                      : origin.substr(at + 3);
}

bool IsIpAddress(std::string_view name) {
  if (!name.empty() && name.front() == '[') return true;
  int dots = 0;
  for (const char c : name) {
    if (c == '.') {
      ++dots;
    } else if (c < '0' || c > '9') {
      return false;
    }
  }
  return dots == 3;
}

}  // namespace

absl::StatusOr<Target> ParseTarget(std::string_view target) {
  Target result;
  if (target.empty() || target.front() != '/') {
    return absl::InvalidArgumentError("target: not an absolute path");
  }
  std::string_view query;
  if (const std::size_t mark = target.find('?');
      mark != std::string_view::npos) {
    query = target.substr(mark + 1);
    target = target.substr(0, mark);
  }
  target.remove_prefix(1);
  for (bool more = true; more;) {
    more = target.find('/') != std::string_view::npos;
    ASSIGN_OR_RETURN(std::string segment, Decode(TakePart(&target, '/')));
    if (segment == "." || segment == ".." ||
        segment.find('/') != std::string::npos) {
      return absl::InvalidArgumentError("target: leaves its folder");
    }
    result.path.push_back(std::move(segment));
    if (result.path.size() > kMaxSegments) {
      return absl::InvalidArgumentError("target: too many parts");
    }
  }
  while (!query.empty()) {
    std::string_view pair = TakePart(&query, '&');
    ASSIGN_OR_RETURN(std::string name, Decode(TakePart(&pair, '=')));
    ASSIGN_OR_RETURN(result.query[std::move(name)], Decode(pair));
    if (result.query.size() > kMaxSegments) {
      return absl::InvalidArgumentError("target: too many parts");
    }
  }
  return result;
}

std::optional<std::string> CookieValue(std::string_view header,
                                       std::string_view name) {
  while (!header.empty()) {
    std::string_view pair = Trim(TakePart(&header, ';'));
    if (TakePart(&pair, '=') == name) return std::string(pair);
  }
  return std::nullopt;
}

absl::StatusOr<ByteRange> ParseRange(std::string_view header,
                                     std::uint64_t size) {
  const ByteRange whole{0, size, false};
  constexpr std::string_view kUnit = "bytes=";
  if (header.substr(0, kUnit.size()) != kUnit ||
      header.find(',') != std::string_view::npos) {
    return whole;
  }
  std::string_view rest = header.substr(kUnit.size());
  if (rest.find('-') == std::string_view::npos) return whole;
  const std::string_view first = Trim(TakePart(&rest, '-'));
  const std::string_view last = Trim(rest);
  if (first.empty()) {  // the last so many bytes
    const auto count = ParseNumber(last);
    if (!count.has_value()) return whole;
    if (*count == 0 || size == 0) return absl::OutOfRangeError("empty range");
    return ByteRange{size - std::min(*count, size), size, true};
  }
  const auto begin = ParseNumber(first);
  if (!begin.has_value()) return whole;
  std::uint64_t end = size;
  if (!last.empty()) {
    const auto inclusive = ParseNumber(last);
    if (!inclusive.has_value() || *inclusive < *begin) return whole;
    if (*inclusive < size) end = *inclusive + 1;
  }
  if (*begin >= size) return absl::OutOfRangeError("range behind the end");
  return ByteRange{*begin, end, true};
}

bool OriginAllowed(std::string_view origin,
                   std::string_view host,
                   const std::vector<std::string>& allowed) {
  if (origin.empty()) return true;  // not sent by a browser's page
  if (!host.empty() && Equal(HostOfOrigin(origin), host)) return true;
  return std::any_of(allowed.begin(), allowed.end(), [&](const auto& one) {
    return Equal(one, origin);
  });
}

bool HostAllowed(std::string_view host,
                 const std::vector<std::string>& allowed) {
  const std::string_view name = HostName(host);
  if (IsIpAddress(name) || Equal(name, "localhost")) return true;
  return std::any_of(allowed.begin(), allowed.end(), [&](const auto& one) {
    return !name.empty() && Equal(HostName(HostOfOrigin(one)), name);
  });
}

absl::Status ValidateUploadPath(const std::vector<std::string>& segments) {
  if (segments.empty() || segments.size() > kMaxUploadSegments) {
    return absl::InvalidArgumentError("path: expected 1 to 16 parts");
  }
  for (const std::string& segment : segments) {
    if (segment.empty() || segment.size() > 255 || segment.front() == '.' ||
        segment.find('\\') != std::string::npos ||
        std::any_of(segment.begin(), segment.end(), IsControl)) {
      return absl::InvalidArgumentError(
          absl::StrCat("path: \"", segment, "\" is no name for a file here"));
    }
  }
  return absl::OkStatus();
}

absl::Status ValidateName(std::string_view name, std::string_view field) {
  const auto known = [](char c) {
    return absl::ascii_isalnum(static_cast<unsigned char>(c)) || c == '.' ||
           c == '_' || c == '-';
  };
  if (name.empty() || name.size() > 64 || name.front() == '.' ||
      name.front() == '-' || !std::all_of(name.begin(), name.end(), known)) {
    return absl::InvalidArgumentError(
        absl::StrCat(base::Abseil(field),
                     ": expected 1 to 64 of [A-Za-z0-9._-], not starting with "
                     ". or -"));
  }
  return absl::OkStatus();
}

std::string_view MimeType(std::string_view path) {
  constexpr std::array<std::pair<std::string_view, std::string_view>, 16>
      kTypes = {{{".html", "text/html; charset=utf-8"},
                 {".js", "text/javascript; charset=utf-8"},
                 {".mjs", "text/javascript; charset=utf-8"},
                 {".css", "text/css; charset=utf-8"},
                 {".json", "application/json"},
                 {".map", "application/json"},
                 {".webmanifest", "application/manifest+json"},
                 {".svg", "image/svg+xml"},
                 {".png", "image/png"},
                 {".jpg", "image/jpeg"},
                 {".ico", "image/x-icon"},
                 {".woff2", "font/woff2"},
                 {".wasm", "application/wasm"},
                 {".txt", "text/plain; charset=utf-8"},
                 {".csv", "text/csv; charset=utf-8"},
                 {".mcap", "application/octet-stream"}}};
  for (const auto& [extension, type] : kTypes) {
    if (path.ends_with(extension)) return type;
  }
  return "application/octet-stream";
}

bool AcceptsGzip(std::string_view header) {
  while (!header.empty()) {
    std::string_view coding = TakePart(&header, ',');
    if (!Equal(Trim(TakePart(&coding, ';')), "gzip")) continue;
    const std::string_view weight = Trim(coding);
    return weight.substr(0, 3) != "q=0" ||
           weight.find_first_of("123456789") != std::string_view::npos;
  }
  return false;
}

}  // namespace groundlock::dashboard
