// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/recording/mcap_reader.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <set>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/dashboard/recording/internal/mcap_records.h"
#include "map_store/base/status.h"

namespace groundlock::recording {
namespace {

namespace fs = std::filesystem;

// Larger than any chunk that is written: a message more than was asked for.
constexpr std::uint64_t kMaxChunkBytes = std::uint64_t{1} << 27;
constexpr std::uint64_t kMaxSummaryBytes = std::uint64_t{1} << 28;
constexpr std::uint64_t kMaxSmallRecordBytes = std::uint64_t{1} << 26;

class Reader final : public McapReader {
 public:
  explicit Reader(const fs::path& path)
      : name_(path.filename().string()), stream_(path, std::ios::binary) {
    std::error_code error;
    file_bytes_ = fs::file_size(path, error);
    if (error) file_bytes_ = 0;
  }

  absl::Status Init() {
    if (!stream_) {
      return absl::NotFoundError(absl::StrCat(name_, ": cannot be read"));
    }
    ASSIGN_OR_RETURN(
        const std::string magic,
        ReadAt(0,
               std::min<std::uint64_t>(internal::kMagic.size(), file_bytes_)));
    if (magic != internal::kMagic) {
      return absl::DataLossError(absl::StrCat(name_, ": is no MCAP file"));
    }
    ASSIGN_OR_RETURN(complete_, ReadSummary());
    return complete_ ? absl::OkStatus() : ScanData();
  }

  bool complete() const override { return complete_; }
  std::uint64_t data_bytes() const override { return data_bytes_; }
  const internal::Summary& summary() const override { return summary_; }

  std::uint64_t num_messages(std::string_view topic) const override {
    std::uint64_t sum = 0;
    for (const auto& channel : summary_.channels) {
      const auto count = summary_.messages_per_channel.find(channel.id);
      if (channel.topic == topic &&
          count != summary_.messages_per_channel.end()) {
        sum += count->second;
      }
    }
    return sum;
  }
  std::uint64_t start_time_ns() const override {
    return summary_.start_time_ns;
  }
  std::uint64_t end_time_ns() const override { return summary_.end_time_ns; }

  absl::Status Read(
      const std::function<bool(std::string_view topic)>& wanted,
      const std::function<bool(const McapMessage&)>& take) override {
    std::set<std::uint16_t> channels;
    for (const auto& channel : summary_.channels) {
      if (wanted(channel.topic)) channels.insert(channel.id);
    }
    for (const internal::ChunkIndex& entry : summary_.chunks) {
      const bool has = std::any_of(
          entry.message_index_offsets.begin(),
          entry.message_index_offsets.end(),
          [&](const auto& c) { return channels.contains(c.first); });
      if (!has) continue;
      ASSIGN_OR_RETURN(const bool go_on, ReadChunk(entry, channels, take));
      if (!go_on) break;
    }
    return absl::OkStatus();
  }

 private:
  absl::StatusOr<std::string> ReadAt(std::uint64_t offset, std::uint64_t size) {
    if (offset > file_bytes_ || size > file_bytes_ - offset) {
      return absl::DataLossError(
          absl::StrCat(name_, ": points behind its own end, to byte ", offset));
    }
    std::string bytes(size, '\0');
    stream_.clear();
    stream_.seekg(static_cast<std::streamoff>(offset));
    stream_.read(bytes.data(), static_cast<std::streamsize>(size));
    if (static_cast<std::uint64_t>(stream_.gcount()) != size) {
      return absl::DataLossError(
          absl::StrCat(name_, ": cannot be read at byte ", offset));
    }
    return bytes;
  }

  absl::Status Damaged(std::uint64_t offset, const absl::Status& why) const {
    return absl::Status(
        why.code(),
        absl::StrCat(name_, ": at byte ", offset, ": ", why.message()));
  }

  // false: the file has none.
  absl::StatusOr<bool> ReadSummary() {
    const std::uint64_t tail = internal::kFooterBytes + internal::kMagic.size();
    if (file_bytes_ < internal::kMagic.size() + tail) return false;
    ASSIGN_OR_RETURN(const std::string end, ReadAt(file_bytes_ - tail, tail));
    std::string_view bytes = end;
    if (!bytes.ends_with(internal::kMagic)) return false;
    auto record = internal::TakeRecord(&bytes);
    if (!record.ok() || record->opcode != internal::Opcode::kFooter) {
      return false;
    }
    ASSIGN_OR_RETURN(const internal::Footer footer,
                     internal::ParseFooter(record->content));
    if (footer.summary_offset == 0) return false;
    const std::uint64_t summary_end =
        file_bytes_ - internal::kMagic.size() - 4;  // the checksum itself
    if (footer.summary_offset >= summary_end ||
        summary_end - footer.summary_offset > kMaxSummaryBytes) {
      return absl::DataLossError(absl::StrCat(name_, ": its index is damaged"));
    }
    ASSIGN_OR_RETURN(
        const std::string section,
        ReadAt(footer.summary_offset, summary_end - footer.summary_offset));
    if (footer.summary_crc != 0 &&
        internal::Crc32(section) != footer.summary_crc) {
      return absl::DataLossError(
          absl::StrCat(name_, ": its index has a wrong checksum"));
    }
    data_bytes_ = footer.summary_offset;
    std::string_view rest(section);
    rest.remove_suffix(internal::kFooterBytes - 4);
    while (!rest.empty()) {
      auto one = internal::TakeRecord(&rest);
      if (!one.ok()) return Damaged(footer.summary_offset, one.status());
      const absl::Status taken = TakeSummaryRecord(*one);
      if (!taken.ok()) return Damaged(footer.summary_offset, taken);
    }
    return true;
  }

  absl::Status TakeSummaryRecord(const internal::Record& record) {
    switch (record.opcode) {
      case internal::Opcode::kSchema: {
        ASSIGN_OR_RETURN(auto schema, internal::ParseSchema(record.content));
        summary_.schemas.push_back(std::move(schema));
        return absl::OkStatus();
      }
      case internal::Opcode::kChannel: {
        ASSIGN_OR_RETURN(auto channel, internal::ParseChannel(record.content));
        summary_.channels.push_back(std::move(channel));
        return absl::OkStatus();
      }
      case internal::Opcode::kChunkIndex: {
        ASSIGN_OR_RETURN(auto index, internal::ParseChunkIndex(record.content));
        summary_.chunks.push_back(std::move(index));
        return absl::OkStatus();
      }
      case internal::Opcode::kStatistics:
        return internal::ParseStatistics(record.content, &summary_);
      default:
        return absl::OkStatus();  // readers skip what they do not know
    }
  }

  // Goes through the data section record by record, up to where it breaks off.
  absl::Status ScanData() {
    std::uint64_t offset = internal::kMagic.size();
    data_bytes_ = offset;
    for (;;) {
      if (file_bytes_ - offset < internal::kRecordHeaderBytes) break;
      ASSIGN_OR_RETURN(const std::string head,
                       ReadAt(offset, internal::kRecordHeaderBytes));
      std::uint64_t size = 0;
      for (int i = 8; i >= 1; --i) {
        size = size << 8 | static_cast<unsigned char>(head[i]);
      }
      const auto opcode = static_cast<internal::Opcode>(head[0]);
      const std::uint64_t body = offset + internal::kRecordHeaderBytes;
      if (size > file_bytes_ - body) break;
      if (opcode == internal::Opcode::kDataEnd ||
          opcode == internal::Opcode::kFooter) {
        break;
      }
      const absl::Status taken = ScanRecord(opcode, offset, size);
      if (!taken.ok()) break;
      offset = body + size;
      data_bytes_ = offset;
    }
    DropUnindexedChunk();
    return absl::OkStatus();
  }

  // A chunk counts once the indexes behind it are there too.
  void DropUnindexedChunk() {
    if (summary_.chunks.empty()) return;
    const internal::ChunkIndex& last = summary_.chunks.back();
    const bool indexed =
        std::none_of(last.message_index_offsets.begin(),
                     last.message_index_offsets.end(),
                     [](const auto& entry) { return entry.second == 0; });
    if (indexed) return;
    for (const auto& [channel, count] : last_counts_) {
      summary_.messages_per_channel[channel] -= count;
    }
    data_bytes_ = last.chunk_offset;
    summary_.chunks.pop_back();
    summary_.end_time_ns =
        summary_.chunks.empty() ? 0 : summary_.chunks.back().end_time_ns;
    if (summary_.chunks.empty()) summary_.start_time_ns = 0;
  }

  absl::Status ScanRecord(internal::Opcode opcode,
                          std::uint64_t offset,
                          std::uint64_t size) {
    const std::uint64_t limit = opcode == internal::Opcode::kChunk
                                    ? kMaxChunkBytes
                                    : kMaxSmallRecordBytes;
    if (size > limit) return absl::DataLossError("a record is too large");
    ASSIGN_OR_RETURN(const std::string content,
                     ReadAt(offset + internal::kRecordHeaderBytes, size));
    switch (opcode) {
      case internal::Opcode::kSchema:
      case internal::Opcode::kChannel:
        return TakeSummaryRecord({opcode, content});
      case internal::Opcode::kChunk:
        return ScanChunk(content, offset);
      case internal::Opcode::kMessageIndex: {
        if (summary_.chunks.empty()) return absl::OkStatus();
        ASSIGN_OR_RETURN(const std::uint16_t channel,
                         internal::ParseMessageIndexChannel(content));
        internal::ChunkIndex& chunk = summary_.chunks.back();
        chunk.message_index_offsets[channel] = offset;
        chunk.message_index_bytes = offset + internal::kRecordHeaderBytes +
                                    size -
                                    (chunk.chunk_offset + chunk.chunk_bytes);
        return absl::OkStatus();
      }
      default:
        return absl::OkStatus();
    }
  }

  absl::Status ScanChunk(std::string_view content, std::uint64_t offset) {
    ASSIGN_OR_RETURN(const internal::Chunk chunk,
                     internal::ParseChunk(content));
    ASSIGN_OR_RETURN(const std::string records,
                     internal::Uncompress(chunk, kMaxChunkBytes));
    internal::ChunkIndex entry;
    entry.start_time_ns = chunk.start_time_ns;
    entry.end_time_ns = chunk.end_time_ns;
    entry.chunk_offset = offset;
    entry.chunk_bytes = internal::kRecordHeaderBytes + content.size();
    entry.compression = chunk.compression;
    entry.compressed_bytes = chunk.records.size();
    entry.uncompressed_bytes = chunk.uncompressed_bytes;
    std::map<std::uint16_t, std::uint64_t> counts;
    std::string_view rest = records;
    while (!rest.empty()) {
      ASSIGN_OR_RETURN(const internal::Record record,
                       internal::TakeRecord(&rest));
      if (record.opcode != internal::Opcode::kMessage) continue;
      ASSIGN_OR_RETURN(const internal::Message message,
                       internal::ParseMessage(record.content));
      ++counts[message.channel_id];
      // Where its index is follows; that it has the channel is known now.
      entry.message_index_offsets.emplace(message.channel_id, 0);
    }
    for (const auto& [channel, count] : counts) {
      summary_.messages_per_channel[channel] += count;
    }
    if (summary_.chunks.empty()) summary_.start_time_ns = entry.start_time_ns;
    summary_.end_time_ns = std::max(summary_.end_time_ns, entry.end_time_ns);
    summary_.chunks.push_back(std::move(entry));
    last_counts_ = std::move(counts);
    return absl::OkStatus();
  }

  // Returns whether to go on.
  absl::StatusOr<bool> ReadChunk(
      const internal::ChunkIndex& entry,
      const std::set<std::uint16_t>& channels,
      const std::function<bool(const McapMessage&)>& take) {
    const auto damaged = [&](const absl::Status& why) {
      return Damaged(entry.chunk_offset, why);
    };
    if (entry.chunk_bytes > kMaxChunkBytes) {
      return damaged(absl::DataLossError("the chunk is too large"));
    }
    ASSIGN_OR_RETURN(const std::string bytes,
                     ReadAt(entry.chunk_offset, entry.chunk_bytes));
    std::string_view view = bytes;
    const auto record = internal::TakeRecord(&view);
    if (!record.ok()) return damaged(record.status());
    if (record->opcode != internal::Opcode::kChunk) {
      return damaged(absl::DataLossError("there is no chunk"));
    }
    const auto chunk = internal::ParseChunk(record->content);
    if (!chunk.ok()) return damaged(chunk.status());
    const auto records = internal::Uncompress(*chunk, kMaxChunkBytes);
    if (!records.ok()) return damaged(records.status());
    std::string_view rest = *records;
    while (!rest.empty()) {
      const auto one = internal::TakeRecord(&rest);
      if (!one.ok()) return damaged(one.status());
      if (one->opcode != internal::Opcode::kMessage) continue;
      const auto message = internal::ParseMessage(one->content);
      if (!message.ok()) return damaged(message.status());
      if (!channels.contains(message->channel_id)) continue;
      if (!take(Describe(*message))) return false;
    }
    return true;
  }

  McapMessage Describe(const internal::Message& message) const {
    McapMessage out;
    for (const auto& channel : summary_.channels) {
      if (channel.id != message.channel_id) continue;
      out.topic = channel.topic;
      for (const auto& schema : summary_.schemas) {
        if (schema.id == channel.schema_id) out.schema = schema.name;
      }
    }
    out.log_time_ns = message.log_time_ns;
    out.publish_time_ns = message.publish_time_ns;
    out.data = message.data;
    return out;
  }

  const std::string name_;
  std::ifstream stream_;
  std::uint64_t file_bytes_ = 0;
  bool complete_ = false;
  std::uint64_t data_bytes_ = 0;
  internal::Summary summary_;
  std::map<std::uint16_t, std::uint64_t> last_counts_;  // of the last chunk
};

}  // namespace

absl::StatusOr<std::unique_ptr<McapReader>> McapReader::Open(
    const fs::path& path) {
  std::error_code error;
  if (!fs::is_regular_file(path, error)) {
    return absl::NotFoundError(
        absl::StrCat(path.string(), ": no such recording"));
  }
  auto reader = std::make_unique<Reader>(path);
  RETURN_IF_ERROR(reader->Init());
  return reader;
}

}  // namespace groundlock::recording
