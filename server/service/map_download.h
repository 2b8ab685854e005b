// SPDX-License-Identifier: Apache-2.0
// What viewers and other tools take from a map, message by message. Both block
// on the disk and are used by one thread at a time.
#ifndef GROUNDLOCK_SERVER_SERVICE_MAP_DOWNLOAD_H_
#define GROUNDLOCK_SERVER_SERVICE_MAP_DOWNLOAD_H_

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "groundlock/v1/maps.pb.h"
#include "map_store/map/map.h"
#include "map_store/storage/store.h"
#include "server/service/scratch_space.h"

namespace groundlock::service {

// Landmarks and cameras in blocks.
class PointCloudProducer {
 public:
  PointCloudProducer(storage::Store* store,
                     groundlock::v1::GetPointCloudRequest request);
  // Fills the next block; false at the end.
  absl::StatusOr<bool> Next(groundlock::v1::GetPointCloudResponse& out);

 private:
  storage::Store* const store_;
  const groundlock::v1::GetPointCloudRequest request_;
  std::shared_ptr<const map::Map> map_;
  std::uint64_t total_points_ = 0;
  std::uint64_t next_point_ = 0;
  std::uint64_t next_view_ = 0;
};

// The map exported to a temporary directory, file by file.
class ExportProducer {
 public:
  // num_exports: how many there are, this one from now on; kResourceExhausted
  // above max_exports.
  ExportProducer(storage::Store* store,
                 const ScratchSpace* scratch,
                 groundlock::v1::ExportMapRequest request,
                 std::atomic<int>* num_exports,
                 int max_exports);
  ~ExportProducer() { --*num_exports_; }
  ExportProducer(const ExportProducer&) = delete;
  ExportProducer& operator=(const ExportProducer&) = delete;
  absl::StatusOr<bool> Next(groundlock::v1::ExportMapResponse& out);

 private:
  absl::Status Export();

  storage::Store* const store_;
  const ScratchSpace* const scratch_;
  const groundlock::v1::ExportMapRequest request_;
  std::atomic<int>* const num_exports_;
  const absl::Status place_;  // whether there was one
  std::unique_ptr<ScratchDirectory> directory_;
  std::vector<std::filesystem::path> files_;
  std::vector<std::string> warnings_;  // not yet sent
  std::filesystem::path root_;         // what the sent paths are relative to
  std::size_t next_file_ = 0;
  std::ifstream file_;
  std::uint64_t missing_bytes_ = 0;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_MAP_DOWNLOAD_H_
