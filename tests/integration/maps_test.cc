// SPDX-License-Identifier: Apache-2.0
// Maps over a real socket: import, look, export, delete; and imports that must
// fail and leave nothing behind.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "groundlock/v1/maps.grpc.pb.h"
#include "grpcpp/grpcpp.h"
#include "tests/integration/test_server.h"
#include "tests/integration/text_model.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class MapsTest : public ::testing::Test {
 protected:
  MapsTest()
      : directory_(
            *base::TemporaryDirectory::Create(fs::temp_directory_path())),
        client_(server_.Connect()) {}

  sdk::ImportRequest Request(
      const std::string& name,
      const std::vector<std::pair<std::string, std::string>>& files) {
    return WriteForImport(directory_.path(), name, files);
  }

  // What a client that does not use the SDK might send.
  grpc::Status Upload(const std::vector<v1::ImportMapRequest>& messages) {
    const auto stub = v1::MapService::NewStub(grpc::CreateChannel(
        server_.address(), grpc::InsecureChannelCredentials()));
    grpc::ClientContext context;
    v1::ImportMapResponse response;
    const auto writer = stub->ImportMap(&context, &response);
    for (const auto& message : messages) {
      if (!writer->Write(message)) break;
    }
    writer->WritesDone();
    return writer->Finish();
  }

  void ExpectNothingLeft() {
    EXPECT_TRUE(Eventually([this] { return fs::is_empty(server_.scratch()); }));
    EXPECT_TRUE(client_->ListMaps()->empty());
  }

  base::TemporaryDirectory directory_;
  TestServer server_;
  std::unique_ptr<sdk::Client> client_;
};

v1::ImportMapRequest Header(const std::string& name) {
  v1::ImportMapRequest message;
  message.mutable_header()->set_name(name);
  message.mutable_header()->set_model_path(".");
  return message;
}

v1::ImportMapRequest File(const std::string& path, std::uint64_t size) {
  v1::ImportMapRequest message;
  message.mutable_file_start()->set_path(path);
  message.mutable_file_start()->set_size_bytes(size);
  return message;
}

v1::ImportMapRequest Chunk(std::size_t size) {
  v1::ImportMapRequest message;
  message.set_chunk(std::string(size, 'x'));
  return message;
}

TEST_F(MapsTest, ImportListShowExportDelete) {
  std::uint64_t done = 0;
  std::uint64_t total = 0;
  const auto report = client_->ImportMap(Request("yard", TextModel()),
                                         [&](std::uint64_t d, std::uint64_t t) {
                                           EXPECT_GE(d, done);
                                           done = d;
                                           total = t;
                                           return true;
                                         });
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(done, total);
  EXPECT_GT(total, 0U);
  EXPECT_EQ(report->map.name, "yard");
  EXPECT_EQ(report->map.version, 1U);
  EXPECT_EQ(report->map.num_landmarks, kTextModelPoints);
  EXPECT_EQ(report->map.num_views, kTextModelViews);
  EXPECT_FALSE(report->map.metric);
  EXPECT_FALSE(report->map.has_descriptors);
  // The ground was found: it is z = 0, the cameras are above.
  EXPECT_NEAR(report->map.ground_world.normal.z(), 1.0, 1e-9);
  const auto cloud = client_->GetPointCloud("yard");
  ASSERT_TRUE(cloud.ok()) << cloud.status();
  ASSERT_EQ(cloud->xyz_world.size(), kTextModelPoints);
  ASSERT_EQ(cloud->cameras.size(), kTextModelViews);
  for (const auto& p : cloud->xyz_world) {
    EXPECT_NEAR(p.z(), 0.0, 0.05);  // ten sigma of the bumps
  }
  for (const auto& camera : cloud->cameras) {
    EXPECT_NEAR(camera.world_from_camera.translation.z(), 5.0, 0.1);
  }
  EXPECT_EQ(client_->GetPointCloud("yard", 0, 50)->xyz_world.size(), 50U);

  // Given an alignment, the second version is metric.
  sdk::ImportRequest again = Request("yard", TextModel());
  again.world_from_source = geometry::Similarity3{
      2.0, Eigen::Quaterniond::Identity(), Eigen::Vector3d::Zero()};
  const auto second = client_->ImportMap(again);
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_EQ(second->map.version, 2U);
  EXPECT_TRUE(second->map.metric);
  const auto maps = client_->ListMaps();
  ASSERT_TRUE(maps.ok());
  ASSERT_EQ(maps->size(), 1U);
  EXPECT_EQ(maps->front().version, 2U);
  EXPECT_EQ(client_->GetMap("yard", 1)->version, 1U);

  const fs::path exported = directory_.path() / "exported";
  // With a slash at the end, as a shell completes a folder's name.
  const absl::Status status = client_->ExportMap(
      "yard", 0, sdk::MapExportFormat::kColmapText, exported / "");
  ASSERT_TRUE(status.ok()) << status;
  EXPECT_TRUE(fs::exists(exported / "points3D.txt"));
  const fs::path ply = directory_.path() / "yard.ply";
  ASSERT_TRUE(
      client_->ExportMap("yard", 0, sdk::MapExportFormat::kPly, ply).ok());
  EXPECT_GT(fs::file_size(ply), kTextModelPoints * 12U);
  EXPECT_EQ(
      client_->ExportMap("yard", 0, sdk::MapExportFormat::kPly, ply).code(),
      absl::StatusCode::kAlreadyExists);

  ASSERT_TRUE(client_->DeleteMap("yard").ok());
  EXPECT_EQ(client_->GetMap("yard").status().code(),
            absl::StatusCode::kNotFound);
  EXPECT_EQ(client_->DeleteMap("yard").code(), absl::StatusCode::kNotFound);
  ExpectNothingLeft();
}

TEST_F(MapsTest, AMapWithoutDescriptorsCannotBeTrackedOn) {
  ASSERT_TRUE(client_->ImportMap(Request("yard", TextModel())).ok());
  sdk::SessionSpec spec = Spec("s");
  spec.map_name = "yard";
  const auto session = client_->CreateSession(spec);
  EXPECT_EQ(session.status().code(), absl::StatusCode::kFailedPrecondition)
      << session.status();
}

TEST_F(MapsTest, DamagedModelsAreRefusedAndLeaveNothing) {
  auto model = TextModel();
  model[2].second = model[2].second.substr(0, model[2].second.size() / 2) +
                    "7 not a number\n";
  const auto broken = client_->ImportMap(Request("broken", model));
  EXPECT_EQ(broken.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(broken.status().ToString(), HasSubstr("points3D.txt"));
  EXPECT_THAT(broken.status().ToString(), ::testing::Not(HasSubstr("scratch")));

  const std::vector<std::pair<std::string, std::string>> text_as_bin = {
      {"cameras.bin", TextModel()[0].second},
      {"images.bin", TextModel()[1].second},
      {"points3D.bin", TextModel()[2].second}};
  const auto text = client_->ImportMap(Request("text", text_as_bin));
  EXPECT_FALSE(text.ok());
  EXPECT_THAT(text.status().ToString(), HasSubstr(".bin"));

  model = TextModel();
  model.pop_back();
  EXPECT_FALSE(client_->ImportMap(Request("partial", model)).ok());
  EXPECT_FALSE(client_->ImportMap(Request("bad name", TextModel())).ok());
  ExpectNothingLeft();
}

TEST_F(MapsTest, UploadsAreCheckedAsTheyArrive) {
  for (const std::string path : {"../out",
                                 "/etc/passwd",
                                 "a/../../out",
                                 "a//b",
                                 ".",
                                 "..",
                                 "",
                                 "a\\..\\b",
                                 "a/"}) {
    const auto status = Upload({Header("m"), File(path, 1), Chunk(1)});
    EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << path;
    EXPECT_THAT(status.error_message(), HasSubstr("file_start.path"));
  }
  struct Case {
    std::vector<v1::ImportMapRequest> messages;
    std::string message;
  };
  const std::vector<Case> cases = {
      {{}, "header"},
      {{File("a", 1)}, "header"},
      {{Header("m")}, "no file"},
      {{Header("m"), Chunk(1)}, "before a file_start"},
      {{Header("m"), File("a", 1), Chunk(2)}, "more bytes than announced"},
      {{Header("m"), File("a", 5), Chunk(2)}, "lacks 3 bytes"},
      {{Header("m"), File("a", 5), Chunk(2), File("b", 1)}, "lacks 3 bytes"},
      {{Header("m"), File("a", 0), File("a", 0)}, "collides"},
      {{Header("m"), File("a", 2 << 20), Chunk((1 << 20) + 1)}, "more than"},
      {{Header("m"), File("a", 1ULL << 60)}, "more than"},
      {{Header("m"), Header("m")}, "expected file_start or chunk"},
  };
  for (const Case& bad : cases) {
    const auto status = Upload(bad.messages);
    EXPECT_FALSE(status.ok());
    EXPECT_THAT(status.error_message(), HasSubstr(bad.message));
  }
  v1::ImportMapRequest two_files = Header("m");
  two_files.mutable_header()->set_num_files(2);
  EXPECT_THAT(Upload({two_files, File("a", 0)}).error_message(),
              HasSubstr("2 files were announced"));
  ExpectNothingLeft();
}

TEST_F(MapsTest, ACancelledImportLeavesNothing) {
  const auto report =
      client_->ImportMap(Request("yard", TextModel()),
                         [](std::uint64_t, std::uint64_t) { return false; });
  EXPECT_EQ(report.status().code(), absl::StatusCode::kCancelled);
  ExpectNothingLeft();
}

TEST_F(MapsTest, LocalizeNamesWhatIsWrong) {
  sdk::LocalizeSpec spec;
  spec.map_name = "nowhere";
  spec.camera = TestCamera();
  spec.image = SquareImage(10, 10);
  EXPECT_EQ(client_->Localize(spec).status().code(),
            absl::StatusCode::kNotFound);
  ASSERT_TRUE(client_->ImportMap(Request("yard", TextModel())).ok());
  spec.map_name = "yard";
  EXPECT_EQ(client_->Localize(spec).status().code(),
            absl::StatusCode::kFailedPrecondition);
  spec.prior = sdk::PosePrior();
  spec.prior->position_arm_camera_m = Eigen::Vector3d(0.1, 0.2, 0.3);
  const absl::Status no_position = client_->Localize(spec).status();
  EXPECT_EQ(no_position.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(no_position.message()),
              HasSubstr("prior.position_arm_m"));
}

}  // namespace
}  // namespace groundlock::test
