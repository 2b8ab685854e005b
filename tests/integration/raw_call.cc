// SPDX-License-Identifier: Apache-2.0
#include "tests/integration/raw_call.h"

#include <grpcpp/create_channel.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include "groundlock/v1/maps.pb.h"
#include "groundlock/v1/tracking.pb.h"

namespace groundlock::test {
namespace {

namespace proto = google::protobuf;

grpc::ByteBuffer ToBuffer(const std::string& bytes) {
  const grpc::Slice slice(bytes);
  return grpc::ByteBuffer(&slice, 1);
}

std::string ToString(const grpc::ByteBuffer& buffer) {
  std::vector<grpc::Slice> slices;
  if (!buffer.Dump(&slices).ok()) return "";
  std::string bytes;
  for (const grpc::Slice& slice : slices) {
    bytes.append(reinterpret_cast<const char*>(slice.begin()), slice.size());
  }
  return bytes;
}

}  // namespace

std::vector<const proto::MethodDescriptor*> EveryMethod() {
  std::vector<const proto::MethodDescriptor*> methods;
  for (const auto* file :
       {v1::Session::descriptor()->file(), v1::MapInfo::descriptor()->file()}) {
    for (int s = 0; s < file->service_count(); ++s) {
      for (int m = 0; m < file->service(s)->method_count(); ++m) {
        methods.push_back(file->service(s)->method(m));
      }
    }
  }
  return methods;
}

std::string PathOf(const proto::MethodDescriptor& method) {
  return "/" + method.service()->full_name() + "/" + method.name();
}

std::unique_ptr<proto::Message> NewMessage(const proto::Descriptor& type) {
  return std::unique_ptr<proto::Message>(
      proto::MessageFactory::generated_factory()->GetPrototype(&type)->New());
}

std::shared_ptr<grpc::Channel> RawChannel(const std::string& address) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 100);
  return grpc::CreateCustomChannel(
      address, grpc::InsecureChannelCredentials(), arguments);
}

RawAnswer CallRaw(const std::shared_ptr<grpc::Channel>& channel,
                  const std::string& path,
                  const std::string& authorization,
                  const std::vector<std::string>& messages,
                  std::size_t max_answers,
                  std::chrono::milliseconds timeout) {
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + timeout);
  if (!authorization.empty()) {
    context.AddMetadata("authorization", authorization);
  }
  grpc::CompletionQueue queue;
  const auto call = stub.PrepareCall(&context, path, &queue);
  const auto wait = [&queue] {
    void* tag = nullptr;
    bool ok = false;
    return queue.Next(&tag, &ok) && ok;
  };
  call->StartCall(nullptr);
  bool alive = wait();
  for (std::size_t i = 0; alive && i < messages.size(); ++i) {
    call->Write(ToBuffer(messages[i]), nullptr);
    alive = wait();
  }
  if (alive) {
    call->WritesDone(nullptr);
    wait();
  }
  RawAnswer answer;
  for (;;) {
    grpc::ByteBuffer buffer;
    call->Read(&buffer, nullptr);
    if (!wait()) break;
    answer.messages.push_back(ToString(buffer));
    if (answer.messages.size() >= max_answers) context.TryCancel();
  }
  call->Finish(&answer.status, nullptr);
  wait();
  return answer;
}

void NameObjects(proto::Message& request,
                 const std::string& session,
                 const std::string& map) {
  const proto::Descriptor& type = *request.GetDescriptor();
  for (int i = 0; i < type.field_count(); ++i) {
    const proto::FieldDescriptor& field = *type.field(i);
    if (field.is_repeated()) continue;
    if (field.name() == "session_id") {
      request.GetReflection()->SetString(&request, &field, session);
    } else if (field.name() == "name" || field.name() == "map_name") {
      request.GetReflection()->SetString(&request, &field, map);
    } else if (field.name() == "header" || field.name() == "attach") {
      NameObjects(*request.GetReflection()->MutableMessage(&request, &field),
                  session,
                  map);
    }
  }
}

}  // namespace groundlock::test
