// SPDX-License-Identifier: Apache-2.0
// The records of an MCAP file and their bytes: https://mcap.dev/spec. All
// integers are little endian. Internal to the recording room.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_INTERNAL_MCAP_RECORDS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_INTERNAL_MCAP_RECORDS_H_

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace groundlock::recording::internal {

inline constexpr std::string_view kMagic("\x89MCAP0\r\n", 8);
// Opcode and length in front of every record.
inline constexpr std::size_t kRecordHeaderBytes = 9;
// Footer with its header; the closing magic follows it.
inline constexpr std::size_t kFooterBytes = kRecordHeaderBytes + 20;

enum class Opcode : std::uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kMessageIndex = 0x07,
  kChunkIndex = 0x08,
  kStatistics = 0x0B,
  kSummaryOffset = 0x0E,
  kDataEnd = 0x0F,
};

struct Schema {
  std::uint16_t id = 0;  // > 0
  std::string name;
  std::string encoding;
  std::string data;
};

struct Channel {
  std::uint16_t id = 0;
  std::uint16_t schema_id = 0;
  std::string topic;
  std::string message_encoding;
};

// Views into the bytes that were parsed.
struct Message {
  std::uint16_t channel_id = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time_ns = 0;
  std::uint64_t publish_time_ns = 0;
  std::string_view data;
};

struct Chunk {
  std::uint64_t start_time_ns = 0;
  std::uint64_t end_time_ns = 0;
  std::uint64_t uncompressed_bytes = 0;
  std::uint32_t uncompressed_crc = 0;  // 0 = none
  std::string_view compression;        // "", "zstd"
  std::string_view records;            // compressed
};

struct ChunkIndex {
  std::uint64_t start_time_ns = 0;
  std::uint64_t end_time_ns = 0;
  std::uint64_t chunk_offset = 0;  // of the chunk record, in the file
  std::uint64_t chunk_bytes = 0;   // of the chunk record, with its header
  // By channel: where its message index record is.
  std::map<std::uint16_t, std::uint64_t> message_index_offsets;
  std::uint64_t message_index_bytes = 0;
  std::string compression;
  std::uint64_t compressed_bytes = 0;
  std::uint64_t uncompressed_bytes = 0;
};

struct Footer {
  std::uint64_t summary_offset = 0;  // 0 = none
  std::uint64_t summary_offset_offset = 0;
  std::uint32_t summary_crc = 0;
};

// What a file's summary section says.
struct Summary {
  std::vector<Schema> schemas;
  std::vector<Channel> channels;
  std::vector<ChunkIndex> chunks;
  std::map<std::uint16_t, std::uint64_t> messages_per_channel;
  std::uint64_t start_time_ns = 0;  // of all messages; 0 if there are none
  std::uint64_t end_time_ns = 0;

  std::uint64_t num_messages() const;
};

// (log time, offset in the uncompressed chunk) of each message of a channel.
using MessageIndex = std::vector<std::pair<std::uint64_t, std::uint64_t>>;

std::uint32_t Crc32(std::string_view bytes, std::uint32_t seed = 0);

// Appends the record, header included.
void AppendHeader(std::string_view library, std::string* out);
void Append(const Schema& schema, std::string* out);
void Append(const Channel& channel, std::string* out);
void Append(const Message& message, std::string* out);
void Append(const Chunk& chunk, std::string* out);
void Append(std::uint16_t channel_id,
            const MessageIndex& index,
            std::string* out);
void Append(const ChunkIndex& index, std::string* out);
void AppendDataEnd(std::string* out);
// The whole summary section, the footer and the closing magic, for a file in
// which they begin at `offset`.
void AppendSummary(const Summary& summary,
                   std::uint64_t offset,
                   std::string* out);

// A record's opcode and content. kDataLoss if `bytes` does not hold all of it;
// *bytes is moved behind it.
struct Record {
  Opcode opcode = Opcode::kHeader;
  std::string_view content;
};
absl::StatusOr<Record> TakeRecord(std::string_view* bytes);

// Of a record's content. kDataLoss says what is wrong with it.
absl::StatusOr<Schema> ParseSchema(std::string_view content);
absl::StatusOr<Channel> ParseChannel(std::string_view content);
absl::StatusOr<Message> ParseMessage(std::string_view content);
absl::StatusOr<Chunk> ParseChunk(std::string_view content);
absl::StatusOr<ChunkIndex> ParseChunkIndex(std::string_view content);
absl::StatusOr<Footer> ParseFooter(std::string_view content);
// Channel id of a message index.
absl::StatusOr<std::uint16_t> ParseMessageIndexChannel(
    std::string_view content);
// Sets messages_per_channel and the times.
absl::Status ParseStatistics(std::string_view content, Summary* summary);

// A chunk's records, uncompressed, checked against its CRC. kDataLoss;
// kResourceExhausted if they would take more than max_bytes.
absl::StatusOr<std::string> Uncompress(const Chunk& chunk,
                                       std::uint64_t max_bytes);
// zstd.
absl::StatusOr<std::string> Compress(std::string_view bytes);

}  // namespace groundlock::recording::internal

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_INTERNAL_MCAP_RECORDS_H_
