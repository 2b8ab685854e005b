// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/simulator.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/simulator/internal/colmap_writer.h"
#include "client/simulator/internal/imu.h"
#include "client/simulator/internal/mapper.h"
#include "client/simulator/internal/parallel.h"
#include "client/simulator/internal/renderer.h"
#include "client/simulator/internal/sensor.h"
#include "client/simulator/internal/sequences.h"
#include "client/simulator/internal/truth.h"
#include "client/simulator/internal/video_file.h"
#include "map_store/base/file.h"
#include "map_store/base/mix_seed.h"
#include "map_store/base/status.h"
#include "map_store/geometry/similarity3.h"

namespace groundlock::simulator {
namespace {

namespace fs = std::filesystem;

constexpr char kYard[] = "yard";
constexpr char kHills[] = "hills";
constexpr char kAerial[] = "aerial";
constexpr float kFullWidth_px = 1'280.0F;  // where textures are full
constexpr int kMinSize_px = 64;
constexpr int kMaxSize_px = 4'096;
constexpr int kMaxSamples = 64;
constexpr int kMaxThreads = 256;
constexpr double kMaxFps = 1'000.0;
constexpr double kShutter = 0.3;  // open for this share of the frame interval
constexpr double kMappingFps = 24.0;
constexpr int kJpegQuality = 95;
constexpr double kWholly = 0.98;  // share of the target's surface seen

double Now_s() {
  return std::chrono::duration<double>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

absl::Status Out(std::string_view field,
                 double value,
                 double low,
                 double high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      base::Abseil(field), " is ", value, ": expected ", low, " to ", high));
}

absl::Status Unknown(std::string_view what,
                     const std::string& name,
                     const std::vector<std::string>& known) {
  return absl::InvalidArgumentError(absl::StrCat("no ",
                                                 base::Abseil(what),
                                                 " '",
                                                 name,
                                                 "': the known ones are ",
                                                 absl::StrJoin(known, ", ")));
}

bool Contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

// Where on Earth a yard is said to lie: somewhere in the middle latitudes, over
// the ellipsoid.
constexpr geometry::GeodeticPosition kOrigin = {58.4, 15.6, 100.0};
// Of the elevation model: as fine as a drone's own survey, and as far beyond
// the yard as its cameras see ground.
constexpr double kElevationStep_m = 0.25;
constexpr double kElevationHalfSide_m = 3.0 * kHalfYard_m;

// Gives each sequence noise of its own. A sequence that came later is numbered
// after those that were there: theirs stays what it was.
std::uint64_t SequenceNumber(const std::string& sequence) {
  std::vector<std::string> names = YardSequenceNames();
  const std::vector<std::string> aerial = AerialSequenceNames();
  names.insert(names.end(), aerial.begin(), aerial.end());
  for (const char* later : {"quartet"}) {
    std::erase(names, later);
    names.emplace_back(later);
  }
  return 100U +
         (std::find(names.begin(), names.end(), sequence) - names.begin());
}

// The frame of the model that a real structure from motion would have left.
geometry::Similarity3 WorldFromModel() {
  geometry::Similarity3 w;
  w.scale = 2.4;
  w.rotation = Eigen::Quaterniond(
      Eigen::AngleAxisd(1.9, Eigen::Vector3d(0.8, -0.5, 0.33).normalized()));
  w.translation = {1.3, -4.2, 1.7};
  return w;
}

std::string AlignJson(const geometry::Similarity3& w) {
  return absl::StrFormat(
      "{\"scale\":%.17g,\"rotation_wxyz\":[%.17g,%.17g,%.17g,%.17g],"
      "\"translation\":[%.17g,%.17g,%.17g]}\n",
      w.scale,
      w.rotation.w(),
      w.rotation.x(),
      w.rotation.y(),
      w.rotation.z(),
      w.translation.x(),
      w.translation.y(),
      w.translation.z());
}

std::string BoxText(const geometry::Box2& box) {
  return absl::StrFormat(
      "%.2f,%.2f,%.2f,%.2f\n", box.x(), box.y(), box.width(), box.height());
}

Terrain TerrainOf(const SimulationOptions& options) {
  if (options.scene != kHills) return {};
  constexpr std::uint64_t kTerrainSeed = 30;
  return Terrain::Hills(base::MixSeed(options.seed, kTerrainSeed), kHalfYard_m);
}

std::optional<Drive> DriveOf(const SimulationOptions& options,
                             const Terrain& terrain) {
  const auto& drive = options.scene == kAerial ? AerialDrive : YardDrive;
  return drive(options.sequence, terrain, options.seed);
}

std::vector<geometry::Rigid3> MappingViewsOf(const SimulationOptions& options,
                                             const Terrain& terrain) {
  const auto& views =
      options.scene == kAerial ? AerialMappingViews : YardMappingViews;
  return views(terrain, options.seed);
}

// One call of Simulate.
class Run {
 public:
  Run(const SimulationOptions& options, const ProgressCallback& progress)
      : options_(options),
        progress_(progress),
        threads_(options.threads > 0
                     ? options.threads
                     : std::max(1U, std::thread::hardware_concurrency())),
        lens_(Lens::ForSize(options.width_px, options.height_px)),
        terrain_(TerrainOf(options)) {}

  absl::StatusOr<SimulationReport> All() {
    const double start_s = Now_s();
    std::error_code error;
    fs::create_directories(options_.output, error);
    if (error) {
      return absl::UnavailableError(
          absl::StrCat(options_.output.string(), ": ", error.message()));
    }
    const auto drive = DriveOf(options_, terrain_);
    RETURN_IF_ERROR(CheckLength(drive));
    RETURN_IF_ERROR(WriteFile("camera.json", lens_.ToJson()));
    RETURN_IF_ERROR(Progress("textures", 0.0));
    const float detail = std::clamp(
        static_cast<float>(options_.width_px) / kFullWidth_px, 0.25F, 1.0F);
    SceneModel scene = BuildYard(terrain_, options_.seed, detail, threads_);
    RETURN_IF_ERROR(Progress("light", 0.0));
    ASSIGN_OR_RETURN(
        renderer_,
        Renderer::Create(std::move(scene), lens_, options_.seed, threads_));
    sensor_ = std::make_unique<Sensor>(
        cv::Size(options_.width_px, options_.height_px),
        base::MixSeed(options_.seed, SequenceNumber(options_.sequence)),
        threads_);
    RETURN_IF_ERROR(drive ? Film(*drive) : Map());
    report_.total_s = Now_s() - start_s;
    return report_;
  }

 private:
  struct OtherCar {
    std::string truth;
    std::optional<geometry::Box2> init_box;  // in the first frame
  };

  absl::Status Progress(std::string_view stage, double fraction) {
    if (!progress_ || progress_({stage, fraction})) return absl::OkStatus();
    return absl::CancelledError("the simulation was cancelled");
  }

  absl::Status WriteFile(const std::string& name, const std::string& content) {
    RETURN_IF_ERROR(base::WriteFileAtomically(options_.output / name, content));
    report_.files.push_back(options_.output / name);
    return absl::OkStatus();
  }

  // What files of another car begin with: "laps_other", "laps_other2", ...
  std::string OtherName(std::size_t index) const {
    return absl::StrCat(options_.sequence,
                        "_other",
                        index == 0 ? std::string() : absl::StrCat(index + 1));
  }

  absl::Status CheckLength(const std::optional<Drive>& drive) {
    const int all =
        drive ? static_cast<int>(std::floor(drive->duration_s * options_.fps))
              : static_cast<int>(MappingViewsOf(options_, terrain_).size());
    report_.frames = options_.frames == 0 ? all : options_.frames;
    return Out("frames", report_.frames, 1, all);
  }

  static Moment At(const Drive& drive, double t_s) {
    Moment moment{drive.world_from_camera(t_s), drive.world_from_car(t_s)};
    for (const auto& other : drive.world_from_other_cars) {
      moment.world_from_other_cars.push_back(other(t_s));
    }
    return moment;
  }

  absl::Status Film(const Drive& drive) {
    const fs::path path = options_.output / (options_.sequence + ".mp4");
    const fs::path part = path.string() + ".part";
    const absl::Status status = FilmTo(drive, part);
    std::error_code error;
    if (!status.ok()) {
      fs::remove(part, error);
      return status;
    }
    fs::rename(part, path, error);
    if (error) {
      return absl::UnavailableError(
          absl::StrCat(path.string(), ": ", error.message()));
    }
    report_.files.push_back(path);
    RETURN_IF_ERROR(WriteFile(options_.sequence + "_truth.csv", truth_));
    constexpr std::uint64_t kImuSeed = 40;
    RETURN_IF_ERROR(WriteFile("imu.json", ImuJson()));
    RETURN_IF_ERROR(
        WriteFile(options_.sequence + "_imu.csv",
                  ImuCsv(drive.world_from_camera,
                         (report_.frames - 1) / options_.fps,
                         base::MixSeed(base::MixSeed(options_.seed, kImuSeed),
                                       SequenceNumber(options_.sequence)))));
    for (std::size_t i = 0; i < others_.size(); ++i) {
      RETURN_IF_ERROR(WriteFile(OtherName(i) + "_truth.csv", others_[i].truth));
    }
    if (report_.init_box && report_.init_frame == 0) {
      RETURN_IF_ERROR(WriteFile(options_.sequence + "_init_box.txt",
                                BoxText(*report_.init_box)));
    }
    for (std::size_t i = 0; i < others_.size(); ++i) {
      if (!others_[i].init_box) continue;
      RETURN_IF_ERROR(WriteFile(OtherName(i) + "_init_box.txt",
                                BoxText(*others_[i].init_box)));
    }
    return absl::OkStatus();
  }

  absl::Status FilmTo(const Drive& drive, const fs::path& part) {
    ASSIGN_OR_RETURN(
        const auto video,
        VideoFile::Create(
            part, {options_.width_px, options_.height_px}, options_.fps));
    const CarSamples samples(renderer_->car(), options_.seed);
    truth_ = TruthHeader(true);
    others_.assign(drive.world_from_other_cars.size(), {truth_, std::nullopt});
    for (int frame = 0; frame < report_.frames; ++frame) {
      const double t_s = frame / options_.fps;
      const double start_s = Now_s();
      std::vector<Moment> moments;
      for (int i = 0; i < options_.samples_per_pixel; ++i) {
        // Spread evenly over the shutter, centred on the truth's moment.
        const double f = (i + 0.5) / options_.samples_per_pixel - 0.5;
        moments.push_back(At(drive, t_s + f * kShutter / options_.fps));
      }
      const cv::Mat image =
          sensor_->Expose(renderer_->Render(moments), frame, t_s);
      report_.render_s += Now_s() - start_s;
      RETURN_IF_ERROR(video->Write(image));
      const Moment middle = At(drive, t_s);
      const TargetTruth target = samples.Measure(*renderer_, middle);
      truth_ += TruthRow(frame, t_s, middle, target);
      for (std::size_t i = 0; i < others_.size(); ++i) {
        // The same moment, with this car as the first.
        Moment moment = middle;
        std::swap(*moment.world_from_car, moment.world_from_other_cars[i]);
        const TargetTruth other = samples.Measure(*renderer_, moment);
        others_[i].truth += TruthRow(frame, t_s, moment, other);
        if (frame == 0 && other.seen_fraction > kWholly) {
          others_[i].init_box = other.seen_box;
        }
      }
      if (target.visible_fraction == 0.0) ++report_.hidden_frames;
      if (!target.in_view()) ++report_.unseen_frames;
      if (!report_.init_frame && target.seen_fraction > kWholly) {
        report_.init_frame = frame;
        report_.init_box = target.seen_box;
      }
      RETURN_IF_ERROR(
          Progress("frames", static_cast<double>(frame + 1) / report_.frames));
    }
    return video->Finish();
  }

  // Renders, stores and describes one mapping view at a time.
  absl::Status RenderViews(YardMap& map, std::vector<cv::Mat>& images) {
    const auto poses = MappingViewsOf(options_, terrain_);
    truth_ = TruthHeader(false);
    for (int i = 0; i < report_.frames; ++i) {
      const double start_s = Now_s();
      // Without motion blur: every sample at the same moment.
      const std::vector<Moment> moments(options_.samples_per_pixel,
                                        Moment{poses[i], std::nullopt});
      const double t_s = i / kMappingFps;
      images.push_back(sensor_->Expose(renderer_->Render(moments), i, t_s));
      report_.render_s += Now_s() - start_s;
      MapView view;
      view.name = absl::StrFormat("%04d.jpg", i);
      view.camera_from_world = poses[i].Inverse();
      std::vector<uchar> jpeg;
      cv::imencode(".jpg",
                   images.back(),
                   jpeg,
                   {cv::IMWRITE_JPEG_QUALITY, kJpegQuality});
      RETURN_IF_ERROR(WriteFile(absl::StrCat("mapping/", view.name),
                                std::string(jpeg.begin(), jpeg.end())));
      truth_ += TruthRow(i, t_s, moments[0], std::nullopt);
      map.views.push_back(std::move(view));
      RETURN_IF_ERROR(
          Progress("views", static_cast<double>(i + 1) / report_.frames));
    }
    return absl::OkStatus();
  }

  absl::Status Map() {
    std::error_code error;
    fs::create_directories(options_.output / "mapping", error);
    if (error) {
      return absl::UnavailableError(
          absl::StrCat(options_.output.string(), ": ", error.message()));
    }
    YardMap map;
    map.lens = lens_;
    std::vector<cv::Mat> images;
    RETURN_IF_ERROR(RenderViews(map, images));
    RETURN_IF_ERROR(WriteFile("mapping_truth.csv", truth_));
    for (int i = 0; i < report_.frames; i += threads_) {
      ParallelFor(std::min(threads_, report_.frames - i), threads_, [&](int j) {
        ExtractFeatures(images[i + j], map.views[i + j]);
        images[i + j].release();
      });
      RETURN_IF_ERROR(Progress(
          "features",
          std::min(1.0, static_cast<double>(i + threads_) / report_.frames)));
    }
    if (!Triangulate(map, threads_, [&](double fraction) {
          return Progress("landmarks", fraction).ok();
        })) {
      return absl::CancelledError("the simulation was cancelled");
    }
    if (map.landmarks.empty()) {
      return absl::FailedPreconditionError(
          absl::StrCat("no landmark is seen in three of the ",
                       report_.frames,
                       " mapping views: render more or larger ones"));
    }
    Count(map);
    RETURN_IF_ERROR(
        WriteColmap(map, WorldFromModel(), options_.output / "map"));
    for (const char* name : {"sparse/0/cameras.bin",
                             "sparse/0/images.bin",
                             "sparse/0/points3D.bin",
                             "database.db"}) {
      report_.files.push_back(options_.output / "map" / name);
    }
    const ElevationText elevation = ElevationModelOf(
        terrain_, kElevationHalfSide_m, kElevationStep_m, kOrigin);
    RETURN_IF_ERROR(WriteFile("terrain.asc", elevation.grid));
    RETURN_IF_ERROR(WriteFile("terrain.prj", elevation.coordinate_system));
    RETURN_IF_ERROR(WriteFile("origin.txt",
                              absl::StrFormat("%.9f,%.9f,%.3f\n",
                                              kOrigin.latitude_deg,
                                              kOrigin.longitude_deg,
                                              kOrigin.height_m)));
    return WriteFile("align.json", AlignJson(WorldFromModel()));
  }

  void Count(const YardMap& map) {
    report_.num_landmarks = map.landmarks.size();
    for (const MapView& view : map.views) {
      report_.num_features += view.p_px.size();
    }
    double sum = 0.0;
    for (const MapLandmark& landmark : map.landmarks) {
      report_.num_observations += landmark.track.size();
      sum += landmark.error_px * static_cast<double>(landmark.track.size());
    }
    report_.mean_reprojection_error_px =
        sum /
        static_cast<double>(std::max<std::size_t>(1, report_.num_observations));
  }

  const SimulationOptions& options_;
  const ProgressCallback& progress_;
  int threads_;
  Lens lens_;
  const Terrain terrain_;
  std::unique_ptr<Renderer> renderer_;
  std::unique_ptr<Sensor> sensor_;
  std::string truth_;
  std::vector<OtherCar> others_;
  SimulationReport report_;
};

}  // namespace

std::vector<std::string> SceneNames() { return {kYard, kHills, kAerial}; }

std::vector<std::string> SequenceNames(std::string_view scene) {
  if (scene == kAerial) return AerialSequenceNames();
  if (scene != kYard && scene != kHills) return {};
  return YardSequenceNames();
}

absl::Status SimulationOptions::Validate() const {
  if (!Contains(SceneNames(), scene)) {
    return Unknown("scene", scene, SceneNames());
  }
  if (!Contains(SequenceNames(scene), sequence)) {
    return Unknown("sequence", sequence, SequenceNames(scene));
  }
  if (output.empty()) {
    return absl::InvalidArgumentError("output is empty: expected a folder");
  }
  RETURN_IF_ERROR(Out("width_px", width_px, kMinSize_px, kMaxSize_px));
  RETURN_IF_ERROR(Out("height_px", height_px, kMinSize_px, kMaxSize_px));
  if (width_px % 2 != 0 || height_px % 2 != 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("the size is ",
                     width_px,
                     "x",
                     height_px,
                     ": the video needs even sides"));
  }
  RETURN_IF_ERROR(Out("fps", fps, 1.0, kMaxFps));
  RETURN_IF_ERROR(Out("samples_per_pixel", samples_per_pixel, 1, kMaxSamples));
  RETURN_IF_ERROR(Out("threads", threads, 0, kMaxThreads));
  if (frames < 0) return Out("frames", frames, 0, 1e6);
  return absl::OkStatus();
}

absl::StatusOr<SimulationReport> Simulate(const SimulationOptions& options,
                                          const ProgressCallback& progress) {
  RETURN_IF_ERROR(options.Validate());
  try {
    return Run(options, progress).All();
  } catch (const cv::Exception& e) {
    return absl::InternalError(absl::StrCat("OpenCV: ", e.what()));
  }
}

}  // namespace groundlock::simulator
