#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""What docs/api.md asks of grpcurl, which Debian 12 does not have: calls methods with
JSON, by the server's own reflection and nothing else.

    grpcurl -plaintext [-d JSON|@] HOST:PORT list | describe SYMBOL | SERVICE/METHOD
"""
import json
import pathlib
import subprocess
import sys
import tempfile

import grpc
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory

# As far as it is used; the numbers are those of grpc.reflection.v1alpha.
REFLECTION = """
syntax = "proto3";
package grpc.reflection.v1alpha;
message Files { repeated bytes file_descriptor_proto = 1; }
message Service { string name = 1; }
message Services { repeated Service service = 1; }
message Request { string file_containing_symbol = 4; string file_by_filename = 3; string list_services = 7; }
message Response { Files file_descriptor_response = 4; Services list_services_response = 6; }
"""


def reflection_messages():
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "reflection.proto").write_text(REFLECTION)
        subprocess.run(["protoc", f"-I{folder}", f"--descriptor_set_out={folder}/set", "reflection.proto"], check=True)
        files = descriptor_pb2.FileDescriptorSet.FromString((folder / "set").read_bytes())
    pool = descriptor_pool.DescriptorPool()
    pool.Add(files.file[0])
    factory = message_factory.MessageFactory(pool)
    return [factory.GetPrototype(pool.FindMessageTypeByName(f"grpc.reflection.v1alpha.{n}")) for n in ("Request", "Response")]


def values(text):
    """The JSON values that stand one after the other in the text."""
    decoder = json.JSONDecoder()
    text = text.strip()
    while text:
        value, end = decoder.raw_decode(text)
        yield value
        text = text[end:].lstrip()


def main():
    arguments = sys.argv[1:]
    assert arguments.pop(0) == "-plaintext"
    data = "{}"
    if arguments[0] == "-d":
        data = arguments[1] if arguments[1] != "@" else sys.stdin.read()
        del arguments[:2]
    address, what, *symbol = arguments
    channel = grpc.insecure_channel(address)
    request, response = reflection_messages()

    def reflect(**asked):
        call = channel.stream_stream(
            "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
            request_serializer=request.SerializeToString, response_deserializer=response.FromString)
        return next(call(iter([request(**asked)])))

    if what == "list":
        print("\n".join(s.name for s in reflect(list_services="*").list_services_response.service))
        return 0
    pool = descriptor_pool.DescriptorPool()
    known = set()

    def add(serialized):
        file = descriptor_pb2.FileDescriptorProto.FromString(serialized)
        if file.name in known:
            return
        known.add(file.name)
        for needed in file.dependency:
            for more in reflect(file_by_filename=needed).file_descriptor_response.file_descriptor_proto:
                add(more)
        pool.Add(file)

    name, _, method_name = (symbol[0] if what == "describe" else what).partition("/")
    files = reflect(file_containing_symbol=name).file_descriptor_response.file_descriptor_proto
    if not files:
        sys.exit(f"the server knows no {name}")
    for serialized in files:
        add(serialized)
    service = pool.FindServiceByName(name)
    if what == "describe":
        print("\n".join(f"{m.name}({m.input_type.full_name}) returns ({m.output_type.full_name})" for m in service.methods))
        return 0
    method = service.methods_by_name[method_name]
    factory = message_factory.MessageFactory(pool)
    asked = factory.GetPrototype(method.input_type)
    call = channel.stream_stream(
        f"/{name}/{method_name}", request_serializer=asked.SerializeToString,
        response_deserializer=factory.GetPrototype(method.output_type).FromString)
    requests = [json_format.ParseDict(value, asked()) for value in values(data)]
    for answer in call(iter(requests)):
        print(json_format.MessageToJson(answer))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except grpc.RpcError as error:
        sys.exit(f"{error.code().name}: {error.details()}")
