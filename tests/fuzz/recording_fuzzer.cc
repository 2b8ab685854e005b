// SPDX-License-Identifier: Apache-2.0
// Arbitrary bytes as a recording: it is read or refused, and what can be read
// can be repaired, after which it is whole and says the same. Inputs with an
// odd first byte change a valid file instead, so that the checks behind its
// first bytes are reached.
#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "client/dashboard/recording/mcap_reader.h"
#include "client/dashboard/recording/mcap_writer.h"
#include "client/dashboard/recording/session_recording.h"
#include "map_store/base/file.h"

namespace {

using groundlock::recording::McapMessage;
using groundlock::recording::McapReader;
using groundlock::recording::McapWriter;

void Require(bool holds) {
  if (!holds) std::abort();
}

std::string ValidFile() {
  const std::string path =
      "/tmp/recording_fuzzer." + std::to_string(getpid()) + ".mcap";
  unlink(path.c_str());
  groundlock::recording::McapWriterOptions options;
  options.chunk_bytes = 100;
  {
    auto writer = McapWriter::Create(path, options);
    Require(writer.ok());
    const auto channel = (*writer)->AddChannel(
        "/session/result", "groundlock.v1.FrameResult", "schema");
    Require(channel.ok());
    for (std::uint64_t i = 0; i < 5; ++i) {
      Require((*writer)->Write(*channel, i, i, std::string(30, '\x08')).ok());
    }
    Require((*writer)->Finish().ok());
  }
  const auto bytes = groundlock::base::ReadFile(path, 1 << 20);
  unlink(path.c_str());
  Require(bytes.ok());
  return *bytes;
}

std::string MakeInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0 || data[0] % 2 == 0) {
    return std::string(reinterpret_cast<const char*>(data), size);
  }
  static const std::string* const valid = new std::string(ValidFile());
  std::string bytes = *valid;
  // Three bytes each: where, and what.
  for (std::size_t i = 1; i + 2 < size; i += 3) {
    const std::size_t at = (data[i] << 8 | data[i + 1]) % bytes.size();
    bytes[at] = static_cast<char>(data[i + 2]);
  }
  if (size % 3 == 0) bytes.resize(bytes.size() - data[size - 1]);
  return bytes;
}

// How many messages can be read.
std::uint64_t CountMessages(McapReader& reader) {
  std::uint64_t count = 0;
  reader
      .Read([](std::string_view) { return true; },
            [&count](const McapMessage&) {
              ++count;
              return true;
            })
      .IgnoreError();
  return count;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  const std::string bytes = MakeInput(data, size);
  const int fd = memfd_create("recording", MFD_CLOEXEC);
  Require(fd >= 0);
  Require(write(fd, bytes.data(), bytes.size()) ==
          static_cast<ssize_t>(bytes.size()));
  const std::string path = "/proc/self/fd/" + std::to_string(fd);
  {
    const auto reader = McapReader::Open(path);
    if (reader.ok()) {
      const std::uint64_t before = CountMessages(**reader);
      if (!(*reader)->complete() &&
          groundlock::recording::RepairMcap(path).ok()) {
        const auto repaired = McapReader::Open(path);
        Require(repaired.ok() && (*repaired)->complete());
        Require(CountMessages(**repaired) == before);
      }
    }
  }
  groundlock::recording::DescribeRecording(path).status().IgnoreError();
  groundlock::recording::ReadResults(path, [](const auto&) {
    return true;
  }).IgnoreError();
  close(fd);
  return 0;
}
