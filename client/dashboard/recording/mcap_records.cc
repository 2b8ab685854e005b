// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/recording/internal/mcap_records.h"

#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <limits>
#include <type_traits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::recording::internal {
namespace {

constexpr int kZstdLevel = 1;  // images are compressed already

template <typename T>
void Put(T value, std::string* out) {
  static_assert(std::is_unsigned_v<T>);
  for (std::size_t i = 0; i < sizeof(T); ++i) {
    out->push_back(static_cast<char>((std::uint64_t{value} >> (8 * i)) & 0xFF));
  }
}

void PutString(std::string_view text, std::string* out) {
  Put(static_cast<std::uint32_t>(text.size()), out);
  out->append(text);
}

// A map of ids to numbers, with its length in bytes in front.
void PutMap(const std::map<std::uint16_t, std::uint64_t>& map,
            std::string* out) {
  Put(static_cast<std::uint32_t>(map.size() * 10), out);
  for (const auto& [key, value] : map) {
    Put(key, out);
    Put(value, out);
  }
}

// Appends a record whose content `fill` appends.
template <typename Fill>
void AppendRecord(Opcode opcode, std::string* out, Fill fill) {
  out->push_back(static_cast<char>(opcode));
  const std::size_t length_at = out->size();
  Put(std::uint64_t{0}, out);
  const std::size_t begin = out->size();
  fill(out);
  std::string length;
  Put(std::uint64_t{out->size() - begin}, &length);
  out->replace(length_at, length.size(), length);
}

// Reads values off the front of bytes; after the first that is not there
// everything is zero and ok() is false.
class Cursor {
 public:
  explicit Cursor(std::string_view bytes) : bytes_(bytes) {}

  template <typename T>
  T Take() {
    if (bytes_.size() < sizeof(T)) return Fail<T>();
    std::uint64_t value = 0;
    for (std::size_t i = 0; i < sizeof(T); ++i) {
      value |= std::uint64_t{static_cast<unsigned char>(bytes_[i])} << (8 * i);
    }
    bytes_.remove_prefix(sizeof(T));
    return static_cast<T>(value);
  }
  std::string_view TakeBytes(std::uint64_t size) {
    if (!ok_ || size > bytes_.size()) return Fail<std::string_view>();
    const std::string_view taken = bytes_.substr(0, size);
    bytes_.remove_prefix(size);
    return taken;
  }
  std::string_view TakeString() { return TakeBytes(Take<std::uint32_t>()); }
  std::map<std::uint16_t, std::uint64_t> TakeMap() {
    Cursor entries(TakeString());
    std::map<std::uint16_t, std::uint64_t> map;
    while (entries.ok() && !entries.empty()) {
      const auto key = entries.Take<std::uint16_t>();
      map[key] = entries.Take<std::uint64_t>();
    }
    ok_ = ok_ && entries.ok();
    return map;
  }
  std::string_view rest() const { return bytes_; }
  bool empty() const { return bytes_.empty(); }
  bool ok() const { return ok_; }

 private:
  template <typename T>
  T Fail() {
    ok_ = false;
    bytes_ = {};
    return T();
  }

  std::string_view bytes_;
  bool ok_ = true;
};

absl::Status TooShort(const char* record) {
  return absl::DataLossError(
      absl::StrCat("a ", record, " record is shorter than its fields"));
}

}  // namespace

std::uint64_t Summary::num_messages() const {
  std::uint64_t sum = 0;
  for (const auto& [channel, count] : messages_per_channel) sum += count;
  return sum;
}

std::uint32_t Crc32(std::string_view bytes, std::uint32_t seed) {
  uLong crc = seed;
  while (!bytes.empty()) {
    const std::size_t part =
        std::min<std::size_t>(bytes.size(), std::size_t{1} << 30);
    crc = crc32(crc,
                reinterpret_cast<const Bytef*>(bytes.data()),
                static_cast<uInt>(part));
    bytes.remove_prefix(part);
  }
  return static_cast<std::uint32_t>(crc);
}

void AppendHeader(std::string_view library, std::string* out) {
  AppendRecord(Opcode::kHeader, out, [library](std::string* content) {
    PutString("", content);  // no profile
    PutString(library, content);
  });
}

void Append(const Schema& schema, std::string* out) {
  AppendRecord(Opcode::kSchema, out, [&schema](std::string* content) {
    Put(schema.id, content);
    PutString(schema.name, content);
    PutString(schema.encoding, content);
    PutString(schema.data, content);
  });
}

void Append(const Channel& channel, std::string* out) {
  AppendRecord(Opcode::kChannel, out, [&channel](std::string* content) {
    Put(channel.id, content);
    Put(channel.schema_id, content);
    PutString(channel.topic, content);
    PutString(channel.message_encoding, content);
    Put(std::uint32_t{0}, content);  // no metadata
  });
}

void Append(const Message& message, std::string* out) {
  AppendRecord(Opcode::kMessage, out, [&message](std::string* content) {
    Put(message.channel_id, content);
    Put(message.sequence, content);
    Put(message.log_time_ns, content);
    Put(message.publish_time_ns, content);
    content->append(message.data);
  });
}

void Append(const Chunk& chunk, std::string* out) {
  AppendRecord(Opcode::kChunk, out, [&chunk](std::string* content) {
    Put(chunk.start_time_ns, content);
    Put(chunk.end_time_ns, content);
    Put(chunk.uncompressed_bytes, content);
    Put(chunk.uncompressed_crc, content);
    PutString(chunk.compression, content);
    Put(std::uint64_t{chunk.records.size()}, content);
    content->append(chunk.records);
  });
}

void Append(std::uint16_t channel_id,
            const MessageIndex& index,
            std::string* out) {
  AppendRecord(Opcode::kMessageIndex, out, [&](std::string* content) {
    Put(channel_id, content);
    Put(static_cast<std::uint32_t>(index.size() * 16), content);
    for (const auto& [time, offset] : index) {
      Put(time, content);
      Put(offset, content);
    }
  });
}

void Append(const ChunkIndex& index, std::string* out) {
  AppendRecord(Opcode::kChunkIndex, out, [&index](std::string* content) {
    Put(index.start_time_ns, content);
    Put(index.end_time_ns, content);
    Put(index.chunk_offset, content);
    Put(index.chunk_bytes, content);
    PutMap(index.message_index_offsets, content);
    Put(index.message_index_bytes, content);
    PutString(index.compression, content);
    Put(index.compressed_bytes, content);
    Put(index.uncompressed_bytes, content);
  });
}

void AppendDataEnd(std::string* out) {
  AppendRecord(Opcode::kDataEnd, out, [](std::string* content) {
    Put(std::uint32_t{0}, content);  // chunks have their own checksums
  });
}

void AppendSummary(const Summary& summary,
                   std::uint64_t offset,
                   std::string* out) {
  std::string section;
  struct Group {
    Opcode opcode;
    std::uint64_t begin;
    std::uint64_t bytes;
  };
  std::vector<Group> groups;
  const auto group = [&](Opcode opcode, auto fill) {
    const std::size_t begin = section.size();
    fill();
    if (section.size() > begin) {
      groups.push_back({opcode, offset + begin, section.size() - begin});
    }
  };
  group(Opcode::kSchema, [&] {
    for (const Schema& schema : summary.schemas) Append(schema, &section);
  });
  group(Opcode::kChannel, [&] {
    for (const Channel& channel : summary.channels) Append(channel, &section);
  });
  group(Opcode::kStatistics, [&] {
    AppendRecord(Opcode::kStatistics, &section, [&](std::string* content) {
      Put(summary.num_messages(), content);
      Put(static_cast<std::uint16_t>(summary.schemas.size()), content);
      Put(static_cast<std::uint32_t>(summary.channels.size()), content);
      Put(std::uint32_t{0}, content);  // attachments
      Put(std::uint32_t{0}, content);  // metadata
      Put(static_cast<std::uint32_t>(summary.chunks.size()), content);
      Put(summary.start_time_ns, content);
      Put(summary.end_time_ns, content);
      PutMap(summary.messages_per_channel, content);
    });
  });
  group(Opcode::kChunkIndex, [&] {
    for (const ChunkIndex& chunk : summary.chunks) Append(chunk, &section);
  });
  const std::uint64_t offsets_begin = offset + section.size();
  for (const Group& one : groups) {
    AppendRecord(Opcode::kSummaryOffset, &section, [&one](std::string* out2) {
      Put(static_cast<std::uint8_t>(one.opcode), out2);
      Put(one.begin, out2);
      Put(one.bytes, out2);
    });
  }
  // The footer; its checksum covers everything of the summary before itself.
  section.push_back(static_cast<char>(Opcode::kFooter));
  Put(std::uint64_t{20}, &section);
  Put(offset, &section);
  Put(offsets_begin, &section);
  Put(Crc32(section), &section);
  section.append(kMagic);
  out->append(section);
}

absl::StatusOr<Record> TakeRecord(std::string_view* bytes) {
  Cursor cursor(*bytes);
  Record record;
  record.opcode = static_cast<Opcode>(cursor.Take<std::uint8_t>());
  record.content = cursor.TakeBytes(cursor.Take<std::uint64_t>());
  if (!cursor.ok()) {
    return absl::DataLossError("a record is longer than what is left of it");
  }
  *bytes = cursor.rest();
  return record;
}

absl::StatusOr<Schema> ParseSchema(std::string_view content) {
  Cursor cursor(content);
  Schema schema;
  schema.id = cursor.Take<std::uint16_t>();
  schema.name = cursor.TakeString();
  schema.encoding = cursor.TakeString();
  schema.data = cursor.TakeString();
  if (!cursor.ok()) return TooShort("schema");
  return schema;
}

absl::StatusOr<Channel> ParseChannel(std::string_view content) {
  Cursor cursor(content);
  Channel channel;
  channel.id = cursor.Take<std::uint16_t>();
  channel.schema_id = cursor.Take<std::uint16_t>();
  channel.topic = cursor.TakeString();
  channel.message_encoding = cursor.TakeString();
  if (!cursor.ok()) return TooShort("channel");
  return channel;
}

absl::StatusOr<Message> ParseMessage(std::string_view content) {
  Cursor cursor(content);
  Message message;
  message.channel_id = cursor.Take<std::uint16_t>();
  message.sequence = cursor.Take<std::uint32_t>();
  message.log_time_ns = cursor.Take<std::uint64_t>();
  message.publish_time_ns = cursor.Take<std::uint64_t>();
  if (!cursor.ok()) return TooShort("message");
  message.data = cursor.rest();
  return message;
}

absl::StatusOr<Chunk> ParseChunk(std::string_view content) {
  Cursor cursor(content);
  Chunk chunk;
  chunk.start_time_ns = cursor.Take<std::uint64_t>();
  chunk.end_time_ns = cursor.Take<std::uint64_t>();
  chunk.uncompressed_bytes = cursor.Take<std::uint64_t>();
  chunk.uncompressed_crc = cursor.Take<std::uint32_t>();
  chunk.compression = cursor.TakeString();
  chunk.records = cursor.TakeBytes(cursor.Take<std::uint64_t>());
  if (!cursor.ok()) return TooShort("chunk");
  return chunk;
}

absl::StatusOr<ChunkIndex> ParseChunkIndex(std::string_view content) {
  Cursor cursor(content);
  ChunkIndex index;
  index.start_time_ns = cursor.Take<std::uint64_t>();
  index.end_time_ns = cursor.Take<std::uint64_t>();
  index.chunk_offset = cursor.Take<std::uint64_t>();
  index.chunk_bytes = cursor.Take<std::uint64_t>();
  index.message_index_offsets = cursor.TakeMap();
  index.message_index_bytes = cursor.Take<std::uint64_t>();
  index.compression = cursor.TakeString();
  index.compressed_bytes = cursor.Take<std::uint64_t>();
  index.uncompressed_bytes = cursor.Take<std::uint64_t>();
  if (!cursor.ok()) return TooShort("chunk index");
  return index;
}

absl::StatusOr<Footer> ParseFooter(std::string_view content) {
  Cursor cursor(content);
  Footer footer;
  footer.summary_offset = cursor.Take<std::uint64_t>();
  footer.summary_offset_offset = cursor.Take<std::uint64_t>();
  footer.summary_crc = cursor.Take<std::uint32_t>();
  if (!cursor.ok()) return TooShort("footer");
  return footer;
}

absl::StatusOr<std::uint16_t> ParseMessageIndexChannel(
    std::string_view content) {
  Cursor cursor(content);
  const auto channel = cursor.Take<std::uint16_t>();
  if (!cursor.ok()) return TooShort("message index");
  return channel;
}

absl::Status ParseStatistics(std::string_view content, Summary* summary) {
  Cursor cursor(content);
  cursor.Take<std::uint64_t>();  // messages
  cursor.Take<std::uint16_t>();  // schemas
  cursor.Take<std::uint32_t>();  // channels
  cursor.Take<std::uint32_t>();  // attachments
  cursor.Take<std::uint32_t>();  // metadata
  cursor.Take<std::uint32_t>();  // chunks
  summary->start_time_ns = cursor.Take<std::uint64_t>();
  summary->end_time_ns = cursor.Take<std::uint64_t>();
  summary->messages_per_channel = cursor.TakeMap();
  return cursor.ok() ? absl::OkStatus() : TooShort("statistics");
}

absl::StatusOr<std::string> Uncompress(const Chunk& chunk,
                                       std::uint64_t max_bytes) {
  if (chunk.uncompressed_bytes > max_bytes) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "a chunk of ", chunk.uncompressed_bytes, " bytes is too large"));
  }
  std::string records;
  if (chunk.compression.empty()) {
    records = chunk.records;
  } else if (chunk.compression == "zstd") {
    records.resize(chunk.uncompressed_bytes);
    const std::size_t size = ZSTD_decompress(records.data(),
                                             records.size(),
                                             chunk.records.data(),
                                             chunk.records.size());
    if (ZSTD_isError(size) != 0) {
      return absl::DataLossError(
          absl::StrCat("a chunk is damaged: ", ZSTD_getErrorName(size)));
    }
    records.resize(size);
  } else {
    return absl::UnimplementedError(
        absl::StrCat("a chunk is compressed with \"",
                     base::Abseil(chunk.compression),
                     "\": only zstd is understood"));
  }
  if (records.size() != chunk.uncompressed_bytes ||
      (chunk.uncompressed_crc != 0 &&
       Crc32(records) != chunk.uncompressed_crc)) {
    return absl::DataLossError("a chunk's checksum is wrong");
  }
  return records;
}

absl::StatusOr<std::string> Compress(std::string_view bytes) {
  std::string out(ZSTD_compressBound(bytes.size()), '\0');
  const std::size_t size = ZSTD_compress(
      out.data(), out.size(), bytes.data(), bytes.size(), kZstdLevel);
  if (ZSTD_isError(size) != 0) {
    return absl::InternalError(absl::StrCat("zstd: ", ZSTD_getErrorName(size)));
  }
  out.resize(size);
  return out;
}

}  // namespace groundlock::recording::internal
