// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/json_node.h"

#include <cmath>

#include "map_store/base/status.h"

namespace groundlock::formats::internal {

using base::Abseil;
using nlohmann::json;

absl::StatusOr<json> ParseJson(std::string_view text, std::string_view file) {
  const auto error = [&](std::string_view what) {
    return absl::InvalidArgumentError(
        absl::StrCat(Abseil(file), ": ", Abseil(what)));
  };
  bool too_deep = false;
  const json::parser_callback_t limit_depth =
      [&](int depth, json::parse_event_t /*event*/, json& /*parsed*/) {
        too_deep = too_deep || depth > kMaxJsonDepth;
        return !too_deep;  // false: what follows is not kept
      };
  try {
    json document = json::parse(text.begin(), text.end(), limit_depth);
    if (too_deep) return error("is nested too deeply");
    return document;
  } catch (const json::exception& exception) {
    // Its message starts with "[json.exception.parse_error.101] ".
    std::string_view what = exception.what();
    const std::size_t end = what.find("] ");
    if (end != std::string_view::npos) what.remove_prefix(end + 2);
    return error(what.substr(0, 300));
  }
}

std::string JsonNode::Path() const {
  if (parent_ == nullptr) return absl::StrCat(Abseil(key_), ":");
  const std::string parent = parent_->Path();
  if (key_.empty()) return absl::StrCat(parent, "[", index_, "]");
  return absl::StrCat(
      parent, parent.back() == ':' ? " " : ".", Abseil(key_.substr(0, 80)));
}

absl::Status JsonNode::Error(std::string_view what) const {
  const std::string path = Path();
  return absl::InvalidArgumentError(
      absl::StrCat(path, path.back() == ':' ? " " : ": ", Abseil(what)));
}

bool JsonNode::Has(const char* key) const {
  return value_->is_object() && value_->contains(key);
}

absl::StatusOr<JsonNode> JsonNode::Field(const char* key) const {
  RETURN_IF_ERROR(CheckIsObject());
  const auto found = value_->find(key);
  if (found == value_->end()) {
    return Error(absl::StrCat("has no field \"", key, "\""));
  }
  return JsonNode(*found, this, key, 0);
}

JsonNode JsonNode::Element(std::size_t index) const {
  return JsonNode((*value_)[index], this, {}, index);
}

JsonNode JsonNode::Child(const std::string& key, const json& value) const {
  return JsonNode(value, this, key, 0);
}

absl::Status JsonNode::CheckIsArray() const {
  return value_->is_array() ? absl::OkStatus() : Error("is no array");
}

absl::Status JsonNode::CheckIsObject() const {
  return value_->is_object() ? absl::OkStatus() : Error("is no object");
}

absl::StatusOr<std::string> JsonNode::String() const {
  if (!value_->is_string()) return Error("is no text");
  return value_->get<std::string>();
}

absl::StatusOr<double> JsonNode::Number() const {
  if (!value_->is_number()) return Error("is no number");
  const double number = value_->get<double>();
  if (!std::isfinite(number)) return Error("is not a finite number");
  return number;
}

absl::StatusOr<std::int64_t> JsonNode::Integer() const {
  // Unsigned ones beyond 2^63 are no counts or ids of anything here.
  if (!value_->is_number_integer() ||
      (value_->is_number_unsigned() &&
       value_->get<std::uint64_t>() > static_cast<std::uint64_t>(INT64_MAX))) {
    return Error("is no whole number");
  }
  return value_->get<std::int64_t>();
}

absl::Status JsonNode::Numbers(std::size_t count, double* target) const {
  if (!value_->is_array() || value_->size() != count) {
    return Error(absl::StrCat("is no array of ", count, " numbers"));
  }
  for (std::size_t i = 0; i < count; ++i) {
    ASSIGN_OR_RETURN(target[i], Element(i).Number());
  }
  return absl::OkStatus();
}

absl::StatusOr<double> JsonNode::Number(const char* key) const {
  ASSIGN_OR_RETURN(const JsonNode field, Field(key));
  return field.Number();
}

absl::StatusOr<double> JsonNode::NumberOr(const char* key,
                                          double otherwise) const {
  if (!Has(key)) return otherwise;
  return Number(key);
}

absl::StatusOr<std::int64_t> JsonNode::Integer(const char* key) const {
  ASSIGN_OR_RETURN(const JsonNode field, Field(key));
  return field.Integer();
}

absl::StatusOr<std::string> JsonNode::String(const char* key) const {
  ASSIGN_OR_RETURN(const JsonNode field, Field(key));
  return field.String();
}

absl::StatusOr<Eigen::Vector3d> JsonNode::Vector3(const char* key) const {
  ASSIGN_OR_RETURN(const JsonNode field, Field(key));
  Eigen::Vector3d vector;
  RETURN_IF_ERROR(field.Numbers(3, vector.data()));
  return vector;
}

}  // namespace groundlock::formats::internal
