// SPDX-License-Identifier: Apache-2.0
// Frames out, answers in: the long-lived streams of a session.
#ifndef GROUNDLOCK_CLIENT_SDK_TRACKING_STREAM_H_
#define GROUNDLOCK_CLIENT_SDK_TRACKING_STREAM_H_

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/sdk/types.h"

namespace groundlock::sdk {

struct TrackingStreamOptions {
  // Frames that may be on the way: sent, and their answer not yet taken by
  // Next() (or handled by on_reply). Send() waits when it is reached.
  int max_in_flight = 16;
  // Reconnecting: waits between attempts grow from the first to the last, and
  // the stream gives up when it could not be restored for give_up_after.
  std::chrono::milliseconds first_backoff{100};
  std::chrono::milliseconds last_backoff{5'000};
  std::chrono::milliseconds give_up_after{60'000};
  // If set, answers go here, from a thread of the stream, one at a time and in
  // order, and Next() is not used. It may call Send() only if max_in_flight
  // cannot be reached, and must not destroy the stream.
  std::function<void(const FrameReply&)> on_reply;

  absl::Status Validate() const;  // names field, value and bound
};

// Sends frames to a session and receives their answers: one for every frame, in
// the order of the frames, across broken connections. After a break it
// reconnects with back-off, learns from the server which frames have arrived,
// has the answers that got lost on the way sent again and sends the frames that
// did not arrive once more.
//
// Thread-safe. One thread may send while another receives. A single thread may
// do both in turns if it never has max_in_flight answers outstanding.
class TrackingStream {
 public:
  virtual ~TrackingStream() = default;  // cancels

  // The first sequence number that the server takes, as it said when the stream
  // was opened: a client that was killed goes on from there.
  virtual std::uint64_t next_sequence() const = 0;

  // Hands over a frame; waits while max_in_flight are on the way.
  // kInvalidArgument: the sequence is not above the previous one. Otherwise the
  // reason for which the stream has ended (kNotFound: the session is gone;
  // kAborted: another stream took over; kUnavailable: it could not be
  // restored).
  virtual absl::Status Send(Frame frame) = 0;
  // No more frames; Next() goes on with the outstanding answers.
  virtual void CloseSend() = 0;

  // The next answer, waiting for it; nullopt after CloseSend() and the last
  // answer. An error ends the stream.
  virtual absl::StatusOr<std::optional<FrameReply>> Next() = 0;
  // As Next(), but kDeadlineExceeded (the stream goes on) when nothing came.
  virtual absl::StatusOr<std::optional<FrameReply>> NextWithin(
      std::chrono::milliseconds timeout) = 0;
  // Waits until every frame sent is answered; implies CloseSend(). For users of
  // on_reply.
  virtual absl::Status Finish() = 0;

  // Ends the stream at once; waiting calls return kCancelled. The session
  // stays.
  virtual void Cancel() = 0;
  // How often the connection was lost and restored.
  virtual int num_reconnects() const = 0;
};

// Follows a session's results. Does not reconnect: open another.
class SessionWatcher {
 public:
  virtual ~SessionWatcher() = default;  // cancels
  // The next update, waiting for it; nullopt when the session has ended.
  // One thread at a time.
  virtual absl::StatusOr<std::optional<WatchUpdate>> Next() = 0;
  // From any thread: a waiting Next() returns kCancelled.
  virtual void Cancel() = 0;
};

}  // namespace groundlock::sdk

#endif  // GROUNDLOCK_CLIENT_SDK_TRACKING_STREAM_H_
