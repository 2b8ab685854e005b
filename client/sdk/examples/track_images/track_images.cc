// SPDX-License-Identifier: Apache-2.0
// Follows a target through images, in the order in which they are named:
//
//   track_images SERVER MAP X,Y,W,H IMAGE...
//
// MAP is "-" for none: the target is then followed in the image alone.
#include <cstdio>
#include <fstream>
#include <iterator>
#include <memory>
#include <optional>
#include <string>
#include <variant>

#include "client/sdk/client.h"

namespace sdk = groundlock::sdk;
namespace geometry = groundlock::geometry;

namespace {

int Fail(const absl::Status& status) {
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}

void Print(const sdk::FrameResult& result) {
  for (const sdk::TargetResult& target : result.targets) {
    std::printf(
        "%llu %s %s",
        static_cast<unsigned long long>(result.sequence),
        target.id.c_str(),
        target.state == sdk::TargetState::kTracked ? "TRACKED" : "not seen");
    if (target.box_px) {
      std::printf(" box %.1f,%.1f,%.1f,%.1f",
                  target.box_px->x(),
                  target.box_px->y(),
                  target.box_px->width(),
                  target.box_px->height());
    }
    if (target.ground_center_world) {
      std::printf(" at %.2f,%.2f",
                  target.ground_center_world->x(),
                  target.ground_center_world->y());
    }
    std::printf("\n");
  }
}

// Takes the next answer; false at the stream's end, which `status` explains.
bool Answer(sdk::TrackingStream& stream, absl::Status& status) {
  absl::StatusOr<std::optional<sdk::FrameReply>> reply = stream.Next();
  status = reply.status();
  if (!reply.ok() || !reply->has_value()) return false;
  if (const auto* result = std::get_if<sdk::FrameResult>(&**reply)) {
    Print(*result);
  } else if (const auto* error = std::get_if<sdk::FrameError>(&**reply)) {
    std::fprintf(stderr, "%s\n", error->status.ToString().c_str());
  }
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  double x, y, width, height;
  if (argc < 5 ||
      std::sscanf(argv[3], "%lf,%lf,%lf,%lf", &x, &y, &width, &height) != 4) {
    std::fprintf(stderr,
                 "usage: track_images SERVER MAP X,Y,W,H IMAGE...\n"
                 "client of Groundlock %s\n",
                 sdk::Version());
    return 2;
  }
  auto client = sdk::Client::Connect(argv[1]);
  if (!client.ok()) return Fail(client.status());
  sdk::SessionSpec spec;
  if (std::string(argv[2]) != "-") spec.map_name = argv[2];
  const auto session = (*client)->CreateSession(spec);
  if (!session.ok()) return Fail(session.status());
  const std::string id = session->spec.session_id;
  const auto target = (*client)->SetTarget(
      id, "target", geometry::Box2::FromXywh(x, y, width, height), 0);
  if (!target.ok()) return Fail(target.status());

  auto stream = (*client)->Track(id);
  if (!stream.ok()) return Fail(stream.status());
  absl::Status status;
  for (int i = 4; i < argc; ++i) {
    std::ifstream file(argv[i], std::ios::binary);
    sdk::Frame frame;
    frame.sequence = i - 4;
    frame.capture_time = std::chrono::milliseconds(40 * (i - 4));
    frame.image.bytes.assign(std::istreambuf_iterator<char>(file), {});
    status = (*stream)->Send(std::move(frame));
    if (!status.ok()) return Fail(status);
    if (!Answer(**stream, status)) return Fail(status);
  }
  (*stream)->CloseSend();
  while (Answer(**stream, status)) continue;
  if (!status.ok()) return Fail(status);
  return (*client)->DeleteSession(id).ok() ? 0 : 1;
}
