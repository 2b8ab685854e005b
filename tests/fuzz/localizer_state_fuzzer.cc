// SPDX-License-Identifier: Apache-2.0
// Arbitrary bytes as what a session knows of its camera: they are refused, or
// the session goes on with them and knows the same when it is asked again.
// The first byte says how: an odd one is followed by changes to a state that a
// session has saved, so that the checks behind its first bytes are reached.
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <string>
#include <utility>
#include <vector>

#include "server/localization/localizer.h"
#include "tests/support/rendered_plane_map.h"

namespace {

using groundlock::localization::Localizer;
using groundlock::test_support::LookAlongY;
using groundlock::test_support::MapFromViews;
using groundlock::test_support::MappingViews;
using groundlock::test_support::OpenTemporaryMap;
using groundlock::test_support::RenderedPlace;

void Require(bool holds) {
  if (!holds) std::abort();
}

struct Session {
  Session()
      : place(1), map(OpenTemporaryMap(MapFromViews(place, MappingViews()))) {
    Require(map != nullptr);
    const auto source = Make(true);
    for (int i = 0; i < 8; ++i) {
      pictures.push_back(
          place.Render(LookAlongY({0.3 + 0.02 * i, 0.3, 1.7}, 0.05, -0.05)));
    }
    for (int i = 0; i < 6; ++i) Step(*source, i);
    valid = source->Save();
  }

  // Searches are not what is tried here.
  std::unique_ptr<Localizer> Make(bool wait_for_anchor) const {
    groundlock::localization::LocalizerOptions options;
    options.wait_for_anchor = wait_for_anchor;
    auto made = groundlock::localization::CreateLocalizer(
        "fast", map, options, [](auto, const auto&) {});
    Require(made.ok());
    return *std::move(made);
  }
  void Step(Localizer& localizer, int index) const {
    groundlock::image::Frame frame;
    frame.sequence = static_cast<std::uint64_t>(index);
    frame.capture_time = index * std::chrono::milliseconds(40);
    frame.luma = pictures[static_cast<std::size_t>(index)];
    Require(localizer.Localize({&frame, place.camera(), {}}).ok());
  }

  RenderedPlace place;
  std::shared_ptr<const groundlock::map::Map> map;
  std::vector<cv::Mat> pictures;
  std::string valid;
};

std::string MakeInput(const Session& session,
                      const std::uint8_t* data,
                      std::size_t size) {
  if (data[0] % 2 == 0) {
    return std::string(reinterpret_cast<const char*>(data) + 1, size - 1);
  }
  std::string bytes = session.valid;
  // Three bytes each: where, from the end, before which the images lie; what.
  for (std::size_t i = 1; i + 2 < size; i += 3) {
    const std::size_t at = (data[i] << 8 | data[i + 1]) % bytes.size();
    bytes[bytes.size() - 1 - at] = static_cast<char>(data[i + 2]);
  }
  if (size % 3 == 0) bytes.resize(bytes.size() - data[size - 1]);
  return bytes;
}

// The place is made and mapped before the first input, whose time it would
// exceed.
const Session* session = nullptr;

}  // namespace

extern "C" int LLVMFuzzerInitialize(int*, char***) {
  session = new Session();
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  if (size == 0) return 0;
  static const std::unique_ptr<Localizer> localizer = session->Make(false);
  static const std::unique_ptr<Localizer> other = session->Make(false);
  const std::string bytes = MakeInput(*session, data, size);
  if (!localizer->Restore(bytes).ok()) return 0;
  const std::string saved = localizer->Save();
  Require(other->Restore(saved).ok() && other->Save() == saved);
  for (int i = 6; i < 8; ++i) session->Step(*localizer, i);
  return 0;
}
