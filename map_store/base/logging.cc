// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/logging.h"

#include <spdlog/pattern_formatter.h>
#include <spdlog/spdlog.h>

#include <memory>

#include "absl/strings/str_format.h"

namespace groundlock::base {
namespace {

class EscapedText final : public spdlog::custom_flag_formatter {
 public:
  explicit EscapedText(LogFormat format) : format_(format) {}
  void format(const spdlog::details::log_msg& message,
              const std::tm& /*time*/,
              spdlog::memory_buf_t& out) override {
    const std::string text =
        EscapeForLog({message.payload.data(), message.payload.size()}, format_);
    out.append(text.data(), text.data() + text.size());
  }
  std::unique_ptr<custom_flag_formatter> clone() const override {
    return std::make_unique<EscapedText>(format_);
  }

 private:
  const LogFormat format_;
};

// Of the thread that logs, which is the one that formats: ,"name":"value"...
thread_local std::string fields_of_thread;

class Fields final : public spdlog::custom_flag_formatter {
 public:
  void format(const spdlog::details::log_msg& /*message*/,
              const std::tm& /*time*/,
              spdlog::memory_buf_t& out) override {
    out.append(fields_of_thread.data(),
               fields_of_thread.data() + fields_of_thread.size());
  }
  std::unique_ptr<custom_flag_formatter> clone() const override {
    return std::make_unique<Fields>();
  }
};

}  // namespace

LogFields::LogFields(std::initializer_list<Field> fields)
    : size_before_(fields_of_thread.size()) {
  for (const auto& [name, value] : fields) {
    // Quotes in values are escaped: this is found in names alone.
    const std::string key = absl::StrFormat(",\"%s\":\"", std::string(name));
    if (value.empty() || fields_of_thread.find(key) != std::string::npos) {
      continue;
    }
    fields_of_thread += key;
    fields_of_thread += EscapeForLog(value, LogFormat::kJson);
    fields_of_thread += '"';
  }
}

LogFields::~LogFields() { fields_of_thread.resize(size_before_); }

std::string EscapeForLog(std::string_view text, LogFormat format) {
  const bool json = format == LogFormat::kJson;
  std::string escaped;
  escaped.reserve(text.size());
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (c == '\n') {
      escaped += "\\n";
    } else if (c == '\r') {
      escaped += "\\r";
    } else if (c == '\t') {
      escaped += "\\t";
    } else if (byte < 0x20 || byte == 0x7F) {
      escaped += json ? absl::StrFormat("\\u00%02x", byte)
                      : absl::StrFormat("\\x%02x", byte);
    } else if (json && (c == '"' || c == '\\')) {
      escaped += {'\\', c};
    } else {
      escaped += c;
    }
  }
  return escaped;
}

void SetUpLogging(const std::string& level, LogFormat format) {
  auto formatter = std::make_unique<spdlog::pattern_formatter>(
      format == LogFormat::kJson ? spdlog::pattern_time_type::utc
                                 : spdlog::pattern_time_type::local);
  formatter->add_flag<EscapedText>('*', format).add_flag<Fields>('&');
  formatter->set_pattern(
      format == LogFormat::kJson
          ? R"({"time":"%Y-%m-%dT%H:%M:%S.%eZ","level":"%l","text":"%*"%&})"
          : "[%Y-%m-%d %H:%M:%S.%e] [%^%l%$] %*");
  spdlog::set_formatter(std::move(formatter));
  spdlog::set_level(spdlog::level::from_str(level));
  // Whoever reads the log through a pipe waits for lines, not for buffers.
  spdlog::flush_on(spdlog::level::info);
}

}  // namespace groundlock::base
