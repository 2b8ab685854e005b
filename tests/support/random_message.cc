// SPDX-License-Identifier: Apache-2.0
#include "tests/support/random_message.h"

#include <google/protobuf/descriptor.h>

#include <limits>

namespace groundlock::test_support {

using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::Reflection;

std::string RandomMessages::Noise(std::size_t max_bytes) {
  std::string bytes(Below(max_bytes + 1), '\0');
  for (char& byte : bytes) byte = static_cast<char>(Below(256));
  return bytes;
}

std::string RandomMessages::Text() {
  if (!names_.empty() && Below(2) == 0) return names_[Below(names_.size())];
  // Texts in messages must be UTF-8; bytes of noise would not even be sent.
  std::string text(Below(4) == 0 ? Below(2'000) : Below(20), 'x');
  for (char& letter : text) letter = static_cast<char>(Below(127) + 1);
  return text;
}

double RandomMessages::Number() {
  const double numbers[] = {0.0,
                            -0.0,
                            1.0,
                            -1.0,
                            100.0,
                            1e-300,
                            1e300,
                            std::numeric_limits<double>::infinity(),
                            -std::numeric_limits<double>::infinity(),
                            std::numeric_limits<double>::quiet_NaN(),
                            static_cast<double>(Below(1'000))};
  return numbers[Below(std::size(numbers))];
}

std::int64_t RandomMessages::Integer() {
  const std::int64_t numbers[] = {0,
                                  1,
                                  -1,
                                  2,
                                  160,
                                  120,
                                  std::numeric_limits<std::int32_t>::max(),
                                  std::numeric_limits<std::int32_t>::min(),
                                  std::numeric_limits<std::int64_t>::max(),
                                  std::numeric_limits<std::int64_t>::min(),
                                  static_cast<std::int64_t>(Below(10'000))};
  return numbers[Below(std::size(numbers))];
}

void RandomMessages::FillField(Message& message,
                               const FieldDescriptor& field,
                               int depth) {
  const Reflection& reflection = *message.GetReflection();
  const bool repeated = field.is_repeated();
#define PUT(Kind, value)                                          \
  return repeated ? reflection.Add##Kind(&message, &field, value) \
                  : reflection.Set##Kind(&message, &field, value)
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_INT32:
      PUT(Int32, static_cast<std::int32_t>(Integer()));
    case FieldDescriptor::CPPTYPE_INT64:
      PUT(Int64, Integer());
    case FieldDescriptor::CPPTYPE_UINT32:
      PUT(UInt32, static_cast<std::uint32_t>(Integer()));
    case FieldDescriptor::CPPTYPE_UINT64:
      PUT(UInt64, static_cast<std::uint64_t>(Integer()));
    case FieldDescriptor::CPPTYPE_DOUBLE:
      PUT(Double, Number());
    case FieldDescriptor::CPPTYPE_FLOAT:
      PUT(Float, static_cast<float>(Number()));
    case FieldDescriptor::CPPTYPE_BOOL:
      PUT(Bool, Below(2) == 0);
    case FieldDescriptor::CPPTYPE_ENUM:
      PUT(EnumValue, static_cast<int>(Below(10)));
    case FieldDescriptor::CPPTYPE_STRING:
      PUT(String,
          field.type() == FieldDescriptor::TYPE_BYTES ? Noise(4'096) : Text());
    case FieldDescriptor::CPPTYPE_MESSAGE:
      if (depth > 6) return;
      Fill(repeated ? *reflection.AddMessage(&message, &field)
                    : *reflection.MutableMessage(&message, &field),
           depth + 1);
  }
#undef PUT
}

void RandomMessages::Fill(Message& message, int depth) {
  const auto& type = *message.GetDescriptor();
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    if (Below(4) == 0) continue;
    const std::size_t times = field.is_repeated() ? Below(4) : 1;
    for (std::size_t t = 0; t < times; ++t) FillField(message, field, depth);
  }
}

std::string RandomMessages::Bytes(Message& message) {
  if (Below(6) == 0) return Noise(300);
  message.Clear();
  Fill(message);
  std::string bytes = message.SerializeAsString();
  if (Below(3) != 0 || bytes.empty()) return bytes;
  switch (Below(3)) {
    case 0:
      bytes.resize(Below(bytes.size()));
      break;
    case 1:
      bytes[Below(bytes.size())] = static_cast<char>(Below(256));
      break;
    default:
      bytes += Noise(50);
  }
  return bytes;
}

}  // namespace groundlock::test_support
