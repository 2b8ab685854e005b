// SPDX-License-Identifier: Apache-2.0
// A map from photos through the dashboard: uploaded, built by the server with
// COLMAP, listed, aligned by control points.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdio>
#include <opencv2/imgcodecs.hpp>
#include <set>
#include <string>
#include <vector>

#include "tests/integration/dashboard_fixture.h"
#include "tests/support/rendered_plane_map.h"

namespace groundlock::test {
namespace {

using boost::beast::http::verb;
using ::testing::HasSubstr;
using ::testing::IsSupersetOf;

constexpr int kPhotos = 8;

// Along a bow in front of the place, looking at its middle.
geometry::Rigid3 ViewAt(int i) {
  const double x_m = 0.45 * (i - 3.5);
  return test_support::LookAlongY(
      {x_m, 0.25 * (i % 2) - 0.02 * x_m * x_m, 1.5 + 0.12 * (i % 3)},
      0.09 * x_m,
      -0.02);
}

std::string PhotoName(int i) { return "photo" + std::to_string(i) + ".png"; }

bool IsReplyTo(const pb::ServerMessage& message, std::uint64_t id) {
  return message.request_id() == id && !message.has_progress();
}

class DashboardBuild : public DashboardTest {
 protected:
  std::string Upload() const {
    const std::string body = Fetch(port(),
                                   verb::post,
                                   "/api/uploads",
                                   {},
                                   R"({"kind":"map","name":"place"})")
                                 .body();
    std::string id = body.substr(body.find(':') + 2, 32);
    for (int i = 0; i < kPhotos; ++i) {
      std::vector<unsigned char> png;
      cv::imencode(".png", place_.Render(ViewAt(i)), png);
      EXPECT_EQ(Fetch(port(),
                      verb::put,
                      "/api/uploads/" + id + "/" + PhotoName(i),
                      {},
                      std::string(png.begin(), png.end()))
                    .result_int(),
                201U);
    }
    return id;
  }
  pb::ClientMessage BuildOf(const std::string& upload_id) const {
    pb::ClientMessage message;
    pb::BuildMap* build = message.mutable_build_map();
    build->set_upload_id(upload_id);
    build->set_name("place");
    v1::CameraModel* camera = build->mutable_camera();
    camera->set_model(v1::CAMERA_MODEL_ID_SIMPLE_PINHOLE);
    camera->set_width_px(place_.camera().width_px());
    camera->set_height_px(place_.camera().height_px());
    for (const double param : place_.camera().params()) {
      camera->add_params(param);
    }
    return message;
  }

  const test_support::RenderedPlace place_ = test_support::RenderedPlace(21);
};

TEST_F(DashboardBuild, PhotosBecomeAMapThatIsListedAndAligned) {
  TestServer server;
  Start(server);
  const std::string upload_id = Upload();
  Page page(port());
  pb::ClientMessage nowhere = BuildOf("nobody");
  EXPECT_EQ(page.Ask(nowhere).error().code(), 5);  // NOT_FOUND

  const std::uint64_t id = page.Send(BuildOf(upload_id));
  std::set<std::string> stages;
  const auto built = page.ReadUntil([&](const pb::ServerMessage& message) {
    if (message.request_id() == id && message.has_progress()) {
      stages.insert(message.progress().stage());
      EXPECT_GE(message.progress().fraction(), 0.0);
      EXPECT_LE(message.progress().fraction(), 1.0);
    }
    return IsReplyTo(message, id);
  });
  ASSERT_TRUE(built.has_value());
  ASSERT_TRUE(built->has_map_imported()) << built->error().message();
  EXPECT_THAT(stages, IsSupersetOf({"features", "mapping"}));
  EXPECT_EQ(built->map_imported().map().name(), "place");
  EXPECT_THAT(built->map_imported().report_json(), HasSubstr("num_registered"));
  // A page that comes now finds it in the list, and the upload is used up.
  Page other(port());
  EXPECT_TRUE(other
                  .ReadUntil([](const pb::ServerMessage& message) {
                    return message.maps().maps_size() == 1 &&
                           message.maps().maps(0).name() == "place";
                  })
                  .has_value());
  EXPECT_EQ(page.Ask(BuildOf(upload_id)).error().code(), 5);

  // Where a surveyor found the photos' cameras to have stood.
  const auto cloud = server.Connect()->GetPointCloud("place");
  ASSERT_TRUE(cloud.ok()) << cloud.status();
  pb::ClientMessage align;
  align.mutable_align_map()->set_name("place");
  align.mutable_align_map()->set_report_only(true);
  for (const sdk::MapCamera& camera : cloud->cameras) {
    auto* point =
        align.mutable_align_map()->mutable_control_points()->add_points();
    point->set_name(camera.name);
    const auto set = [](const Eigen::Vector3d& p, v1::Vector3* out) {
      out->set_x(p.x());
      out->set_y(p.y());
      out->set_z(p.z());
    };
    set(camera.world_from_camera.translation,
        point->mutable_point()->mutable_position_world());
    set(ViewAt(camera.name[5] - '0').translation,
        point->mutable_place()->mutable_position_m());
  }
  ASSERT_GE(align.align_map().control_points().points_size(), 6);
  const pb::ServerMessage tried = page.Ask(align);
  ASSERT_TRUE(tried.has_map_aligned()) << tried.error().message();
  EXPECT_EQ(tried.map_aligned().residuals_size(),
            align.align_map().control_points().points_size());
  // 3 m of way, 9 m in front of a wall.
  EXPECT_LT(tried.map_aligned().rms_error_m(), 0.05);
  align.mutable_align_map()->set_report_only(false);
  const pb::ServerMessage aligned = page.Ask(align);
  ASSERT_TRUE(aligned.has_map_aligned()) << aligned.error().message();
  EXPECT_EQ(aligned.map_aligned().map().version(), 2U);
  // Its list may have come before the reply: another page sees it for sure.
  Page late(port());
  EXPECT_TRUE(late.ReadUntil([](const pb::ServerMessage& message) {
                    return message.maps().maps_size() == 1 &&
                           message.maps().maps(0).version() == 2;
                  })
                  .has_value());
}

TEST_F(DashboardBuild, ABuildIsCancelled) {
  TestServer server;
  Start(server);
  Page page(port());
  const std::uint64_t id = page.Send(BuildOf(Upload()));
  ASSERT_TRUE(page.ReadUntil([&](const pb::ServerMessage& message) {
                    return message.request_id() == id;  // it is under way
                  })
                  ->has_progress());
  pb::ClientMessage cancel;
  cancel.mutable_cancel()->set_request_id(id);
  page.Send(cancel);
  const auto ended = page.ReadUntil(
      [&](const pb::ServerMessage& message) { return IsReplyTo(message, id); });
  ASSERT_TRUE(ended.has_value());
  EXPECT_EQ(ended->error().code(), 1);  // CANCELLED
  EXPECT_TRUE(
      Eventually([&] { return std::filesystem::is_empty(server.scratch()); }));
  EXPECT_TRUE(absl::IsNotFound(server.Connect()->GetMap("place").status()));
}

}  // namespace
}  // namespace groundlock::test
