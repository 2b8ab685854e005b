// SPDX-License-Identifier: Apache-2.0
// Calls of any method with any bytes, as strangers might make them.
#ifndef GROUNDLOCK_TESTS_INTEGRATION_RAW_CALL_H_
#define GROUNDLOCK_TESTS_INTEGRATION_RAW_CALL_H_

#include <google/protobuf/descriptor.h>
#include <google/protobuf/message.h>
#include <grpcpp/channel.h>
#include <grpcpp/support/status.h>

#include <chrono>
#include <cstddef>
#include <memory>
#include <string>
#include <vector>

namespace groundlock::test {

// All methods of the API.
std::vector<const google::protobuf::MethodDescriptor*> EveryMethod();
// "/package.Service/Method".
std::string PathOf(const google::protobuf::MethodDescriptor& method);
// An empty message of a generated type.
std::unique_ptr<google::protobuf::Message> NewMessage(
    const google::protobuf::Descriptor& type);

std::shared_ptr<grpc::Channel> RawChannel(const std::string& address);

struct RawAnswer {
  grpc::Status status;
  std::vector<std::string> messages;
};
// Sends the messages, and no more; reads until the end, or at most so many
// answers. authorization: of the metadata of this name; empty = none.
RawAnswer CallRaw(const std::shared_ptr<grpc::Channel>& channel,
                  const std::string& path,
                  const std::string& authorization,
                  const std::vector<std::string>& messages,
                  std::size_t max_answers = 100,
                  std::chrono::milliseconds timeout = std::chrono::minutes(1));

// Puts the names where a request of any kind says which session and which map
// it is about, in its first message. Of several messages that it may hold, the
// one that names something.
void NameObjects(google::protobuf::Message& request,
                 const std::string& session,
                 const std::string& map);

}  // namespace groundlock::test

#endif  // GROUNDLOCK_TESTS_INTEGRATION_RAW_CALL_H_
