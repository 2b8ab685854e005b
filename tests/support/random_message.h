// SPDX-License-Identifier: Apache-2.0
// Messages of any type with anything in their fields.
#ifndef GROUNDLOCK_TESTS_SUPPORT_RANDOM_MESSAGE_H_
#define GROUNDLOCK_TESTS_SUPPORT_RANDOM_MESSAGE_H_

#include <google/protobuf/message.h>

#include <cstddef>
#include <cstdint>
#include <random>
#include <string>
#include <utility>
#include <vector>

namespace groundlock::test_support {

class RandomMessages {
 public:
  // names: what texts are, half of the time.
  RandomMessages(std::uint64_t seed, std::vector<std::string> names)
      : generator_(seed), names_(std::move(names)) {}

  // Fields of all kinds, each there or not: extreme numbers, not-a-numbers,
  // enumerators that there are not, names, random bytes.
  void Fill(google::protobuf::Message& message, int depth = 0);
  // The bytes of a message so filled; a third of the time broken somewhere, a
  // sixth of the time nothing but noise.
  std::string Bytes(google::protobuf::Message& message);
  // 0 to n - 1.
  std::size_t Below(std::size_t n) {
    return std::uniform_int_distribution<std::size_t>(0, n - 1)(generator_);
  }

 private:
  std::string Noise(std::size_t max_bytes);
  std::string Text();
  double Number();
  std::int64_t Integer();
  void FillField(google::protobuf::Message& message,
                 const google::protobuf::FieldDescriptor& field,
                 int depth);

  std::mt19937_64 generator_;
  const std::vector<std::string> names_;
};

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_RANDOM_MESSAGE_H_
