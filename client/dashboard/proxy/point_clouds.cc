// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/point_clouds.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace groundlock::dashboard {
namespace {

std::shared_ptr<const EncodedCloud> EncodeCloud(
    const gl::MapInfo& map, std::vector<gl::GetPointCloudResponse> blocks) {
  auto cloud = std::make_shared<EncodedCloud>();
  cloud->start.set_map_name(map.name());
  cloud->start.set_map_version(map.version());
  cloud->start.set_num_blocks(static_cast<std::uint32_t>(blocks.size()));
  cloud->start.set_total_points(blocks.empty() ? 0
                                               : blocks.front().total_points());
  for (gl::GetPointCloudResponse& block : blocks) {
    pb::ServerMessage message;
    pb::PointCloudBlock* out = message.mutable_point_cloud_block();
    out->set_map_name(map.name());
    out->set_map_version(map.version());
    out->set_index(static_cast<std::uint32_t>(cloud->blocks.size()));
    out->set_num_blocks(cloud->start.num_blocks());
    out->mutable_points()->Swap(&block);
    cloud->blocks.push_back(Encode(message));
    cloud->bytes += cloud->blocks.back()->size();
  }
  return cloud;
}

}  // namespace

void PointClouds::Get(const std::string& token,
                      const std::string& name,
                      std::uint64_t version,
                      Callback callback) {
  gl::GetMapRequest request;
  request.set_name(name);
  request.set_version(version);
  relay_->Call(token,
               request,
               [this, token, callback = std::move(callback)](
                   absl::StatusOr<gl::GetMapResponse> response) {
                 if (!response.ok()) {
                   callback(response.status());
                   return;
                 }
                 const gl::MapInfo& map = response->map();
                 const Key key(absl::StrCat(map.name(), "/", map.version()),
                               map.content_hash());
                 std::shared_ptr<const EncodedCloud> known;
                 std::shared_ptr<Fetch> fetch;
                 {
                   base::MutexLock lock(&mutex_);
                   const auto kept = std::find_if(
                       kept_.begin(), kept_.end(), [&](const auto& one) {
                         return one.first == key;
                       });
                   if (kept != kept_.end()) {
                     kept_.splice(kept_.begin(), kept_, kept);
                     known = kept->second;
                   } else if (const auto under_way = fetches_.find(key);
                              under_way != fetches_.end()) {
                     under_way->second->waiting.push_back(callback);
                     return;
                   } else {
                     fetch = std::make_shared<Fetch>();
                     fetch->waiting.push_back(callback);
                     fetches_[key] = fetch;
                   }
                 }
                 if (known != nullptr) {
                   callback(known);
                   return;
                 }
                 gl::GetPointCloudRequest points;
                 points.set_name(map.name());
                 points.set_version(map.version());
                 points.set_max_points(max_points_);
                 relay_->GetPointCloud(
                     token,
                     points,
                     [this, fetch](gl::GetPointCloudResponse block) {
                       fetch->bytes += block.ByteSizeLong();
                       fetch->blocks.push_back(std::move(block));
                       return fetch->bytes <= max_bytes_;
                     },
                     [this, key, map, fetch](const absl::Status& status) {
                       Fetched(key, map, fetch, status);
                     });
               });
}

void PointClouds::Fetched(const Key& key,
                          const gl::MapInfo& map,
                          const std::shared_ptr<Fetch>& fetch,
                          const absl::Status& status) {
  absl::StatusOr<std::shared_ptr<const EncodedCloud>> result =
      absl::ResourceExhaustedError(
          "the map's points do not fit into the dashboard's memory");
  if (fetch->bytes <= max_bytes_) {
    if (status.ok()) {
      result = EncodeCloud(map, std::move(fetch->blocks));
    } else {
      result = status;
    }
  }
  std::vector<Callback> waiting;
  {
    base::MutexLock lock(&mutex_);
    waiting.swap(fetch->waiting);
    fetches_.erase(key);
    if (result.ok()) {
      kept_.emplace_front(key, *result);
      std::uint64_t bytes = 0;
      for (const auto& one : kept_) bytes += one.second->bytes;
      while (bytes > max_bytes_ && kept_.size() > 1) {
        bytes -= kept_.back().second->bytes;
        kept_.pop_back();
      }
    }
  }
  for (const Callback& callback : waiting) callback(result);
}

}  // namespace groundlock::dashboard
