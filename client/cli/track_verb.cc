// SPDX-License-Identifier: Apache-2.0
// groundlock track INPUT …
#include <CLI/CLI.hpp>
#include <algorithm>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/cli/parse.h"
#include "client/cli/track_run.h"
#include "client/cli/verbs.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

// As they stand on the command line.
struct TrackFlags {
  std::string input;
  std::string map;
  bool no_map = false;
  std::string camera;
  std::string init_box;
  std::optional<std::uint64_t> init_frame;
  std::vector<std::string> targets;
  std::vector<std::string> bodies;
  std::string results;
  std::string overlay;
  std::string movers;
  std::string localizer;
  std::string tracker;
  bool realtime = false;
  bool host_clock = false;
  bool matches = false;
  std::string encoding = "auto";
  std::string session;
  std::string frames;
  double fps = media::VideoSourceOptions{}.fps;
  std::uint64_t seed = 0;
  std::string priors;
  std::string imu;
  std::string imu_model;
  std::int64_t imu_epoch_ns = 0;
};

// The id of the target that --init-box marks.
constexpr const char* kDefaultTarget = "target";

absl::Status TellBodies(const TrackFlags& flags,
                        std::vector<TargetSpec>& targets) {
  std::set<std::string> told;
  for (const std::string& text : flags.bodies) {
    auto spec = ParseBody(text, sdk::BodyKinds());
    if (!spec.ok()) return base::Annotate(spec.status(), "--body");
    const std::string id = spec->id.empty() ? kDefaultTarget : spec->id;
    const auto target = std::find_if(targets.begin(),
                                     targets.end(),
                                     [&](const auto& t) { return t.id == id; });
    if (target == targets.end()) {
      return absl::InvalidArgumentError(
          spec->id.empty()
              ? absl::StrCat("--body ",
                             text,
                             ": there is no --init-box; of a --target write "
                             "ID:",
                             text)
              : absl::StrCat("--body ", text, ": there is no target ", id));
    }
    if (!told.insert(id).second) {
      return absl::InvalidArgumentError(
          absl::StrCat("--body: the target ", id, " has two bodies"));
    }
    target->body = spec->body;
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<TargetSpec>> Targets(const TrackFlags& flags) {
  std::vector<TargetSpec> targets;
  if (!flags.init_box.empty()) {
    auto box = ParseBox(flags.init_box);
    if (!box.ok()) return base::Annotate(box.status(), "--init-box");
    targets.push_back({kDefaultTarget, *box, flags.init_frame});
  } else if (flags.init_frame) {
    return absl::InvalidArgumentError(
        "--init-frame is the frame of --init-box, which is missing");
  }
  std::set<std::string> ids;
  for (const TargetSpec& target : targets) ids.insert(target.id);
  for (const std::string& text : flags.targets) {
    auto target = ParseTarget(text);
    if (!target.ok()) return base::Annotate(target.status(), "--target");
    if (!ids.insert(target->id).second) {
      return absl::InvalidArgumentError(
          absl::StrCat("--target: there are two targets named ", target->id));
    }
    targets.push_back(*std::move(target));
  }
  RETURN_IF_ERROR(TellBodies(flags, targets));
  return targets;
}

absl::StatusOr<TrackOptions> MakeOptions(const TrackFlags& flags) {
  TrackOptions options;
  options.input = flags.input;
  if (flags.map.empty() != flags.no_map) {
    return absl::InvalidArgumentError(
        flags.no_map ? "--map and --no-map exclude each other"
                     : "--map NAME is missing (or --no-map, to track in the "
                       "image only)");
  }
  options.map_name = flags.map;
  if (!flags.camera.empty()) {
    ASSIGN_OR_RETURN(options.camera, ReadCamera(flags.camera));
  }
  ASSIGN_OR_RETURN(options.targets, Targets(flags));
  if (!flags.frames.empty()) {
    auto range = ParseFrameRange(flags.frames);
    if (!range.ok()) return base::Annotate(range.status(), "--frames");
    options.source.frames = *range;
  }
  for (const TargetSpec& target : options.targets) {
    if (!target.frame) continue;
    if (*target.frame < options.source.frames.begin ||
        *target.frame >= options.source.frames.end) {
      return absl::InvalidArgumentError(absl::StrCat("target ",
                                                     target.id,
                                                     ": frame ",
                                                     *target.frame,
                                                     " is outside --frames ",
                                                     flags.frames));
    }
  }
  options.source.fps = flags.fps;
  ASSIGN_OR_RETURN(options.encoding, media::EncodingFromName(flags.encoding));
  options.realtime = flags.realtime;
  if (flags.host_clock && !flags.realtime) {
    return absl::InvalidArgumentError(
        "--host-clock is of use with --realtime only");
  }
  options.host_clock = flags.host_clock;
  options.session_id = flags.session;
  options.results = flags.results;
  options.overlay = flags.overlay;
  options.movers = flags.movers;
  options.session.report_movers = !flags.movers.empty();
  options.session.localizer = flags.localizer;
  options.session.tracker = flags.tracker;
  options.session.seed = flags.seed;
  if (!flags.priors.empty()) {
    ASSIGN_OR_RETURN(options.priors, ReadPriors(flags.priors));
  }
  if (!flags.imu.empty() || !flags.imu_model.empty()) {
    if (flags.imu.empty() || flags.imu_model.empty()) {
      return absl::InvalidArgumentError(
          "--imu and --imu-model need each other");
    }
    if (flags.host_clock) {
      return absl::InvalidArgumentError(
          "--imu and --host-clock exclude each other: the samples are of the "
          "recording's clock");
    }
    ASSIGN_OR_RETURN(options.session.imu, ReadImu(flags.imu_model));
    ASSIGN_OR_RETURN(auto samples, ReadInertial(flags.imu));
    options.inertial = InertialTrack(
        std::move(samples), std::chrono::nanoseconds(flags.imu_epoch_ns));
  }
  options.session.report_matches = flags.matches;
  return options;
}

void AddInputOptions(CLI::App& verb, TrackFlags& flags) {
  verb.add_option("INPUT",
                  flags.input,
                  "Video file, folder of images, RTSP URL or V4L2 device")
      ->required();
  verb.add_option("--map", flags.map, "Map that the camera moves in")
      ->type_name("NAME");
  verb.add_flag("--no-map", flags.no_map, "Track in the image only");
  verb.add_option("--camera", flags.camera, "The camera's lens [the map's own]")
      ->type_name("camera.json");
  verb.add_option("--init-box",
                  flags.init_box,
                  "The target's box in its first frame, pixels (x and y of "
                  "the upper-left corner)")
      ->type_name("X,Y,W,H");
  verb.add_option("--init-frame",
                  flags.init_frame,
                  "Frame of --init-box, from 0 [the first that is sent]")
      ->type_name("N");
  verb.add_option("--target",
                  flags.targets,
                  "A further target; may be given several times")
      ->type_name("ID:X,Y,W,H[@FRAME]")
      ->take_all()
      ->allow_extra_args(false);
  verb.add_option("--body",
                  flags.bodies,
                  "What is known of a target's body: its kind (" +
                      absl::StrJoin(sdk::BodyKinds(), ", ") +
                      ") and/or length, width and height in the map's unit; "
                      "ID: of a --target; may be given several times")
      ->type_name("[ID:]KIND|LxWxH|KIND,LxWxH")
      ->take_all()
      ->allow_extra_args(false);
  verb.add_option("--frames",
                  flags.frames,
                  "Only the frames FROM to TO - 1, counted from 0")
      ->type_name("FROM:TO");
  verb.add_option("--fps", flags.fps, "Frames per second of a folder of images")
      ->capture_default_str();
}

void AddRunOptions(CLI::App& verb, TrackFlags& flags) {
  verb.add_option("--results", flags.results, "Results, one row per frame")
      ->type_name("out.csv");
  verb.add_option("--overlay", flags.overlay, "Video with what was found")
      ->type_name("out.mp4");
  verb.add_option("--movers",
                  flags.movers,
                  "Look for what else moves over the map's ground: one row "
                  "per frame and mover; in the overlay, too")
      ->type_name("out.csv");
  verb.add_option(
      "--localizer",
      flags.localizer,
      "How the camera is localised: fast or baseline [the server's]");
  verb.add_option("--tracker",
                  flags.tracker,
                  "2D tracker: dcf, act, kcf, csrt, … [the server's]");
  verb.add_flag("--realtime",
                flags.realtime,
                "Send at the pace of the capture times; frames that come too "
                "fast for the server are dropped");
  verb.add_flag("--host-clock",
                flags.host_clock,
                "With --realtime: stamp frames with this machine's clock, as "
                "a camera would, so that viewers can tell the delay");
  verb.add_flag("--matches",
                flags.matches,
                "Report matched landmarks, for viewers of the session");
  verb.add_option("--encoding",
                  flags.encoding,
                  "auto, jpeg, png or raw; auto: raw to this machine, JPEG "
                  "over the network, image files as they are")
      ->capture_default_str();
  verb.add_option("--session",
                  flags.session,
                  "Name of the session; if it exists, it goes on from the "
                  "next frame");
  verb.add_option("--seed", flags.seed, "Seed of everything random");
  verb.add_option("--priors",
                  flags.priors,
                  "Where other sensors say the camera was, by frame: columns "
                  "frame and x,y,z,sigma or latitude,longitude,height,sigma "
                  "and/or qw,qx,qy,qz,rotation_sigma_deg")
      ->type_name("priors.csv");
  verb.add_option("--imu",
                  flags.imu,
                  "What an inertial measurement unit on the camera recorded, "
                  "as EuRoC's imu0/data.csv: its gyroscope helps in fast turns")
      ->type_name("data.csv");
  verb.add_option("--imu-model",
                  flags.imu_model,
                  "That unit: how it is turned against the camera, and its "
                  "noise")
      ->type_name("imu.json");
  verb.add_option("--imu-epoch",
                  flags.imu_epoch_ns,
                  "What the unit's clock says when the video's is 0")
      ->type_name("NS");
}

}  // namespace

void AddTrackVerb(CLI::App& app, VerbContext& context) {
  CLI::App* verb =
      app.add_subcommand("track", "Follow targets through a video");
  auto flags = std::make_shared<TrackFlags>();
  AddInputOptions(*verb, *flags);
  AddRunOptions(*verb, *flags);
  AddCommonOptions(*verb, context);
  verb->callback([flags, &context] {
    context.run = [flags, &context]() -> absl::Status {
      ASSIGN_OR_RETURN(const TrackOptions options, MakeOptions(*flags));
      return TrackRun(options, context).Run();
    };
  });
}

}  // namespace groundlock::cli
