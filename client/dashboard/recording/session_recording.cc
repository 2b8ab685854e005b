// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/recording/session_recording.h"

#include <google/protobuf/descriptor.h>
#include <google/protobuf/descriptor.pb.h>

#include <algorithm>
#include <deque>
#include <set>
#include <thread>
#include <utility>
#include <variant>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "client/dashboard/recording/mcap_reader.h"
#include "foxglove/compressed_image.pb.h"
#include "map_store/base/mutex.h"
#include "map_store/base/status.h"

namespace groundlock::recording {
namespace {

namespace pb = ::groundlock::v1;
namespace fs = std::filesystem;
using std::chrono::nanoseconds;
using std::chrono::steady_clock;
using std::chrono::system_clock;

constexpr std::string_view kInfoTopic = "/session/info";
constexpr std::string_view kMapTopic = "/session/map";
constexpr std::string_view kPointsTopic = "/session/points";
constexpr std::string_view kResultTopic = "/session/result";
constexpr std::string_view kImageTopic = "/session/image";

std::uint64_t NowNs() {
  return static_cast<std::uint64_t>(std::chrono::duration_cast<nanoseconds>(
                                        system_clock::now().time_since_epoch())
                                        .count());
}

void AddFile(const google::protobuf::FileDescriptor* file,
             std::set<std::string>* seen,
             google::protobuf::FileDescriptorSet* set) {
  if (!seen->insert(file->name()).second) return;
  for (int i = 0; i < file->dependency_count(); ++i) {
    AddFile(file->dependency(i), seen, set);
  }
  file->CopyTo(set->add_file());
}

// What a reader needs to understand a message without our sources.
std::string SchemaData(const google::protobuf::Descriptor* message) {
  google::protobuf::FileDescriptorSet set;
  std::set<std::string> seen;
  AddFile(message->file(), &seen, &set);
  return set.SerializeAsString();
}

absl::StatusOr<std::uint16_t> AddChannel(
    McapWriter& writer,
    std::string_view topic,
    const google::protobuf::Descriptor* message) {
  return writer.AddChannel(topic, message->full_name(), SchemaData(message));
}

// "jpeg" or "png"; by the bytes where the encoding does not say.
std::string FormatOf(const pb::Image& image) {
  if (image.encoding() == pb::IMAGE_ENCODING_PNG ||
      absl::string_view(image.data()).substr(0, 4) == "\x89PNG") {
    return "png";
  }
  return "jpeg";
}

struct Waiting {
  std::uint64_t log_time_ns = 0;
  std::variant<std::shared_ptr<const pb::WatchSessionResponse>,
               std::shared_ptr<const pb::GetPointCloudResponse>>
      content;
  bool with_image = false;
  std::uint64_t bytes = 0;
};

class Recording final : public SessionRecording {
 public:
  Recording(std::unique_ptr<McapWriter> writer,
            const SessionRecordingOptions& options)
      : options_(options), writer_(std::move(writer)) {}
  ~Recording() override { Finish().IgnoreError(); }

  absl::Status Begin(const pb::Session& session,
                     const std::optional<pb::MapInfo>& map) {
    ASSIGN_OR_RETURN(
        const std::uint16_t info,
        AddChannel(*writer_, kInfoTopic, pb::Session::descriptor()));
    ASSIGN_OR_RETURN(
        const std::uint16_t map_channel,
        AddChannel(*writer_, kMapTopic, pb::MapInfo::descriptor()));
    ASSIGN_OR_RETURN(
        points_channel_,
        AddChannel(
            *writer_, kPointsTopic, pb::GetPointCloudResponse::descriptor()));
    ASSIGN_OR_RETURN(
        result_channel_,
        AddChannel(*writer_, kResultTopic, pb::FrameResult::descriptor()));
    ASSIGN_OR_RETURN(
        image_channel_,
        AddChannel(
            *writer_, kImageTopic, foxglove::CompressedImage::descriptor()));
    const std::uint64_t now = NowNs();
    RETURN_IF_ERROR(
        writer_->Write(info, now, now, session.SerializeAsString()));
    if (map.has_value()) {
      RETURN_IF_ERROR(
          writer_->Write(map_channel, now, now, map->SerializeAsString()));
    }
    RETURN_IF_ERROR(writer_->Flush());
    frame_id_ = session.session_id();
    start_ = steady_clock::now();
    base::MutexLock lock(&mutex_);
    state_.file_bytes = writer_->file_bytes();
    over_ = false;
    thread_ = std::thread([this] { Run(); });
    return absl::OkStatus();
  }

  void Add(std::shared_ptr<const pb::WatchSessionResponse> update) override {
    const bool has_image = !update->image().data().empty();
    const std::uint64_t result_bytes = update->result().ByteSizeLong();
    const std::uint64_t image_bytes = update->image().data().size();
    Enqueue({NowNs(), std::move(update), has_image, result_bytes}, image_bytes);
  }

  void AddPoints(
      std::shared_ptr<const pb::GetPointCloudResponse> block) override {
    const std::uint64_t bytes = block->ByteSizeLong();
    Enqueue({NowNs(), std::move(block), false, bytes}, 0);
  }

  absl::Status Finish() override {
    std::thread thread;
    {
      base::MutexLock lock(&mutex_);
      stop_ = true;
      thread.swap(thread_);
    }
    if (thread.joinable()) thread.join();
    base::MutexLock lock(&mutex_);
    mutex_.Await([this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return over_; });
    return state_.status;
  }

  SessionRecordingState state() const override {
    base::MutexLock lock(&mutex_);
    return state_;
  }

 private:
  void Enqueue(Waiting item, std::uint64_t image_bytes) {
    base::MutexLock lock(&mutex_);
    if (stop_ || !state_.status.ok()) return;
    if (item.with_image && waiting_bytes_ + item.bytes + image_bytes >
                               options_.max_waiting_bytes) {
      item.with_image = false;
      ++state_.left_out;
    } else {
      item.bytes += image_bytes;
    }
    if (waiting_bytes_ + item.bytes > options_.max_waiting_bytes) {
      ++state_.left_out;
      return;
    }
    if (item.content.index() == 0) {
      ++state_.frames;
      state_.duration = steady_clock::now() - start_;
    }
    waiting_bytes_ += item.bytes;
    waiting_.push_back(std::move(item));
  }

  void Run() {
    auto flushed = steady_clock::now();
    absl::Status status;
    for (bool stopping = false; status.ok() && !stopping;) {
      std::deque<Waiting> items;
      {
        base::MutexLock lock(&mutex_);
        mutex_.AwaitFor(options_.flush_interval,
                        [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
                          return stop_ || !waiting_.empty();
                        });
        items.swap(waiting_);
        stopping = stop_;
      }
      std::uint64_t bytes = 0;
      for (const Waiting& item : items) {
        if (status.ok()) status = Write(item);
        bytes += item.bytes;
      }
      if (status.ok() &&
          steady_clock::now() - flushed >= options_.flush_interval) {
        status = writer_->Flush();
        flushed = steady_clock::now();
      }
      base::MutexLock lock(&mutex_);
      waiting_bytes_ -= bytes;
      state_.file_bytes = writer_->file_bytes();
    }
    // Also after an error: what was written gets its index if there is room.
    const absl::Status finished = writer_->Finish();
    base::MutexLock lock(&mutex_);
    state_.status = status.ok() ? finished : status;
    state_.file_bytes = writer_->file_bytes();
    over_ = true;
  }

  absl::Status Write(const Waiting& item) {
    if (const auto* points =
            std::get_if<std::shared_ptr<const pb::GetPointCloudResponse>>(
                &item.content)) {
      return writer_->Write(points_channel_,
                            item.log_time_ns,
                            item.log_time_ns,
                            (*points)->SerializeAsString());
    }
    const pb::WatchSessionResponse& update = *std::get<0>(item.content);
    const auto capture_ns =
        static_cast<std::uint64_t>(update.result().capture_time_ns());
    RETURN_IF_ERROR(writer_->Write(result_channel_,
                                   item.log_time_ns,
                                   capture_ns,
                                   update.result().SerializeAsString()));
    if (!item.with_image) return absl::OkStatus();
    foxglove::CompressedImage image;
    image.mutable_timestamp()->set_seconds(
        static_cast<std::int64_t>(item.log_time_ns / 1'000'000'000));
    image.mutable_timestamp()->set_nanos(
        static_cast<std::int32_t>(item.log_time_ns % 1'000'000'000));
    image.set_frame_id(frame_id_);
    image.set_data(update.image().data());
    image.set_format(FormatOf(update.image()));
    return writer_->Write(image_channel_,
                          item.log_time_ns,
                          capture_ns,
                          image.SerializeAsString());
  }

  const SessionRecordingOptions options_;
  const std::unique_ptr<McapWriter> writer_;  // of the thread, once it runs
  std::uint16_t points_channel_ = 0;
  std::uint16_t result_channel_ = 0;
  std::uint16_t image_channel_ = 0;
  std::string frame_id_;
  steady_clock::time_point start_;

  mutable base::Mutex mutex_;
  std::deque<Waiting> waiting_ ABSL_GUARDED_BY(mutex_);
  std::uint64_t waiting_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  SessionRecordingState state_ ABSL_GUARDED_BY(mutex_);
  bool stop_ ABSL_GUARDED_BY(mutex_) = false;
  bool over_ ABSL_GUARDED_BY(mutex_) = true;  // no thread writes
  std::thread thread_ ABSL_GUARDED_BY(mutex_);
};

template <typename Proto>
absl::Status Parse(const McapMessage& message, Proto* out) {
  if (!out->ParseFromArray(message.data.data(),
                           static_cast<int>(message.data.size()))) {
    return absl::DataLossError(absl::StrCat(
        "a message of ", base::Abseil(message.topic), " is damaged"));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::unique_ptr<SessionRecording>> SessionRecording::Create(
    const fs::path& path,
    const pb::Session& session,
    const std::optional<pb::MapInfo>& map,
    const SessionRecordingOptions& options) {
  ASSIGN_OR_RETURN(auto writer, McapWriter::Create(path, options.mcap));
  auto recording = std::make_unique<Recording>(std::move(writer), options);
  RETURN_IF_ERROR(recording->Begin(session, map));
  return recording;
}

absl::StatusOr<RecordingDescription> DescribeRecording(const fs::path& path) {
  ASSIGN_OR_RETURN(const auto reader, McapReader::Open(path));
  RecordingDescription description;
  description.complete = reader->complete();
  description.frames = reader->num_messages(kResultTopic);
  description.start_time = system_clock::time_point(
      std::chrono::duration_cast<system_clock::duration>(
          nanoseconds(reader->start_time_ns())));
  description.duration = std::chrono::duration<double>(
      1e-9 *
      static_cast<double>(reader->end_time_ns() - reader->start_time_ns()));
  absl::Status parsed;
  RETURN_IF_ERROR(reader->Read(
      [](std::string_view topic) {
        return topic == kInfoTopic || topic == kMapTopic;
      },
      [&](const McapMessage& message) {
        if (message.topic == kInfoTopic) {
          parsed = Parse(message, &description.session);
        } else {
          parsed = Parse(message, &description.map.emplace());
        }
        return parsed.ok();
      }));
  RETURN_IF_ERROR(parsed);
  return description;
}

absl::Status ReadResults(
    const fs::path& path,
    const std::function<bool(const pb::FrameResult&)>& take) {
  ASSIGN_OR_RETURN(const auto reader, McapReader::Open(path));
  absl::Status parsed;
  RETURN_IF_ERROR(
      reader->Read([](std::string_view topic) { return topic == kResultTopic; },
                   [&](const McapMessage& message) {
                     pb::FrameResult result;
                     parsed = Parse(message, &result);
                     return parsed.ok() && take(result);
                   }));
  return parsed;
}

}  // namespace groundlock::recording
