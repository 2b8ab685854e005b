// SPDX-License-Identifier: Apache-2.0
// What waits to be sent to one viewer, and in which order it goes.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_OUTBOX_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_OUTBOX_H_

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "groundlock/dashboard/v1/dashboard.pb.h"

namespace groundlock::dashboard {

namespace pb = ::groundlock::dashboard::v1;

// An encoded ServerMessage, shared by all viewers that get it.
using Buffer = std::shared_ptr<const std::string>;
Buffer Encode(const pb::ServerMessage& message);

// What a page hears last whose log-in has ended.
Buffer EndOfLogin(const std::string& why);

// A frame's result and image as they go to viewers.
struct FrameBuffers {
  std::string session_id;
  std::uint64_t sequence = 0;
  // With `skipped` as the server told it.
  std::shared_ptr<const pb::ServerMessage> update;
  Buffer update_bytes;
  Buffer image_bytes;  // null = none
};

// Bounded: beyond its limits results and images are left out, and replies are
// refused. Order: replies; then results; then, in turns, the newest image of
// each session and the next part of what is long (histories, point clouds). So
// an image never comes before its result. Not thread-safe.
class Outbox {
 public:
  Outbox(int max_replies, int max_results)
      : max_replies_(max_replies), max_results_(max_results) {}

  // False: too many wait; the viewer does not listen.
  bool AddReply(Buffer message);
  void AddFrame(const std::shared_ptr<const FrameBuffers>& frame,
                bool with_image);
  // Parts in their order; they go before parts that are added later.
  bool AddParts(std::vector<Buffer> parts);
  // How many images of a session may be sent that the viewer has not taken; 0 =
  // any number.
  void SetImageWindow(const std::string& session_id, std::uint32_t images);
  // The viewer has taken this image and those sent before it. False: it was not
  // among those on their way.
  bool ImageTaken(const std::string& session_id, std::uint64_t sequence);
  // Of a session that the viewer follows no more.
  void Forget(const std::string& session_id);

  // The next to send; null if nothing waits.
  Buffer Next();

  std::uint64_t images_left_out() const { return images_left_out_; }
  std::uint64_t results_left_out() const { return results_left_out_; }

 private:
  // Without the frame's image, which would be kept as long as the result waits.
  struct Result {
    std::string session_id;
    std::shared_ptr<const pb::ServerMessage> update;
    Buffer update_bytes;
    std::uint64_t left_out = 0;  // before it, of the same session
  };

  // A session's images.
  struct Images {
    Buffer newest;  // null = none waits
    std::uint64_t sequence = 0;
    std::uint32_t window = 0;
    std::deque<std::uint64_t> in_flight;  // at most `window`
    bool Ready() const {
      return newest != nullptr && (window == 0 || in_flight.size() < window);
    }
  };
  using ImagesBySession = std::map<std::string, Images>;

  // The session whose turn it is; end() if none is ready.
  ImagesBySession::iterator NextImages();

  const int max_replies_;
  const int max_results_;
  std::deque<Buffer> replies_;
  std::deque<Result> results_;
  ImagesBySession images_;
  std::string last_image_session_;
  std::deque<std::vector<Buffer>> parts_;
  std::size_t next_part_ = 0;  // of parts_.front()
  bool part_was_last_ = false;
  std::uint64_t images_left_out_ = 0;
  std::uint64_t results_left_out_ = 0;
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_OUTBOX_H_
