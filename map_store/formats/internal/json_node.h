// SPDX-License-Identifier: Apache-2.0
// JSON that nobody vouches for: every access is checked, and errors name the
// file and the place, as in "sfm_data.json: structure[12].value.X".
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_JSON_NODE_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_JSON_NODE_H_

#include <Eigen/Core>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::formats::internal {

// Documents nest no deeper; text that does would cost memory to no end.
inline constexpr int kMaxJsonDepth = 24;

// kInvalidArgument with `file` and the byte at which the text is no JSON.
absl::StatusOr<nlohmann::json> ParseJson(std::string_view text,
                                         std::string_view file);

// A value and where it is. Its parent must outlive it: nodes live on the stack
// of whoever walks the document.
class JsonNode {
 public:
  JsonNode(const nlohmann::json& document, std::string_view file)
      : value_(&document), key_(file) {}

  const nlohmann::json& value() const { return *value_; }
  bool is_object() const { return value_->is_object(); }
  bool is_array() const { return value_->is_array(); }
  std::size_t size() const { return value_->size(); }

  // A field of an object; kInvalidArgument if it is none or has none.
  absl::StatusOr<JsonNode> Field(const char* key) const;
  bool Has(const char* key) const;
  // An element of an array, index < size().
  JsonNode Element(std::size_t index) const;
  // A node for a value of this object, as its iterator gives it.
  JsonNode Child(const std::string& key, const nlohmann::json& value) const;

  absl::Status CheckIsArray() const;
  absl::Status CheckIsObject() const;
  absl::StatusOr<std::string> String() const;
  absl::StatusOr<double> Number() const;  // finite
  absl::StatusOr<std::int64_t> Integer() const;
  // Array of exactly `count` finite numbers, stored in target.
  absl::Status Numbers(std::size_t count, double* target) const;

  // Shorthands for fields.
  absl::StatusOr<double> Number(const char* key) const;
  absl::StatusOr<double> NumberOr(const char* key, double otherwise) const;
  absl::StatusOr<std::int64_t> Integer(const char* key) const;
  absl::StatusOr<std::string> String(const char* key) const;
  absl::StatusOr<Eigen::Vector3d> Vector3(const char* key) const;

  // "file: a.b[3]".
  std::string Path() const;
  // kInvalidArgument "file: a.b[3]: <what>".
  absl::Status Error(std::string_view what) const;

 private:
  JsonNode(const nlohmann::json& value,
           const JsonNode* parent,
           std::string_view key,
           std::size_t index)
      : value_(&value), parent_(parent), key_(key), index_(index) {}

  const nlohmann::json* value_;
  const JsonNode* parent_ = nullptr;  // null = the document
  std::string_view key_;              // empty = an element; the document: file
  std::size_t index_ = 0;
};

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_JSON_NODE_H_
