// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/key_frame_follower.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <memory>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "server/localization/solvers/pose_estimate.h"
#include "tests/support/rendered_plane_map.h"

namespace groundlock::localization {
namespace {

using geometry::Rigid3;
using test_support::LookAlongY;
using test_support::RenderedPlace;

// Landmarks on a grid of pixels of the first pose, exactly where the panels
// are; landmark i is seen in 1 + i % 7 views.
std::shared_ptr<const map::Map> MakeMap(const RenderedPlace& place,
                                        const Rigid3& world_from_camera) {
  map::MapData data;
  data.source_format = "rendered";
  data.metric = true;
  data.cameras.push_back(place.camera());
  for (int v = 0; v < 7; ++v) {
    map::MapViewData& view = data.views.emplace_back();
    view.name = std::to_string(v);
    view.camera_from_world = world_from_camera.Inverse();
  }
  for (double y = 20.0; y < 350.0; y += 20.0) {
    for (double x = 20.0; x < 630.0; x += 20.0) {
      const auto hit = place.Intersect(world_from_camera, {x, y});
      if (!hit) continue;
      const auto id = static_cast<std::uint32_t>(data.landmarks.size());
      data.landmarks.push_back({hit->p_world, {}, 0.0F});
      for (std::uint32_t v = 0; v <= id % 7; ++v) {
        data.views[v].keypoints_px.emplace_back(static_cast<float>(x),
                                                static_cast<float>(y));
        data.views[v].landmarks.push_back(id);
        data.views[v].descriptors.emplace_back();
      }
    }
  }
  return test_support::OpenTemporaryMap(data);
}

class KeyFrameFollowerTest : public testing::Test {
 protected:
  KeyFrameFollowerTest() : map_(MakeMap(place_, from_)) {
    const Rigid3 camera_from_world = from_.Inverse();
    for (std::uint32_t i = 0; i < map_->landmarks().size(); ++i) {
      key_frame_.landmarks.push_back(
          {{i,
            *place_.camera().ImageFromCamera(camera_from_world *
                                             map_->landmarks()[i].Position())},
           i % 2 == 0});
    }
    key_frame_.pyramid = image::BuildPyramid(place_.Render(from_));
  }

  // Of each landmark found: how far from where it is.
  std::vector<double> Errors_px(const std::vector<FollowedLandmark>& found,
                                const Rigid3& world_from_camera) const {
    std::vector<double> errors_px;
    for (const FollowedLandmark& landmark : found) {
      const auto truth = place_.camera().ImageFromCamera(
          world_from_camera.Inverse() *
          map_->landmarks()[landmark.match.landmark].Position());
      errors_px.push_back((landmark.match.pixel_px - *truth).norm());
    }
    std::sort(errors_px.begin(), errors_px.end());
    return errors_px;
  }

  const RenderedPlace place_{1};
  const Rigid3 from_ = LookAlongY({0.0, 0.0, 1.6}, 0.0, -0.03);
  std::shared_ptr<const map::Map> map_;
  KeyFrame key_frame_;
};

TEST_F(KeyFrameFollowerTest, FollowsToAFractionOfAPixel) {
  ASSERT_GT(key_frame_.landmarks.size(), 300U);
  // What a camera does in a few frames: 8 cm and 2 degrees.
  const Rigid3 to = LookAlongY({0.06, 0.05, 1.62}, 0.03, -0.045);
  const auto pyramid = image::BuildPyramid(place_.Render(to));
  // Exact prediction; and one that is off by 6 px, as after a jerk.
  for (const Rigid3& predicted :
       {to, LookAlongY({0.06, 0.05, 1.62}, 0.042, -0.045)}) {
    const auto found = FollowLandmarks(*map_,
                                       key_frame_,
                                       *pyramid,
                                       place_.camera(),
                                       {predicted},
                                       Reach::kNear);
    EXPECT_GT(found.size(), key_frame_.landmarks.size() * 8 / 10);
    const std::vector<double> errors_px = Errors_px(found, to);
    // The renderer places pixels to 1/32, twice; patches shrink by a percent.
    EXPECT_LT(errors_px[errors_px.size() / 2], 0.1);
    // At the panels' edges half of the patch moves otherwise.
    EXPECT_LT(errors_px[errors_px.size() * 8 / 10], 0.3);
    for (const FollowedLandmark& landmark : found) {
      EXPECT_EQ(landmark.is_anchored, landmark.match.landmark % 2 == 0);
    }
  }
}

TEST_F(KeyFrameFollowerTest, WithoutMotionNothingMoves) {
  const auto found = FollowLandmarks(*map_,
                                     key_frame_,
                                     *key_frame_.pyramid,
                                     place_.camera(),
                                     {from_},
                                     Reach::kNear);
  EXPECT_GT(found.size(), key_frame_.landmarks.size() * 95 / 100);
  EXPECT_LT(Errors_px(found, from_).back(), 0.02);
}

TEST_F(KeyFrameFollowerTest, LeavesOutWhatIsHiddenOrOutside) {
  cv::Mat luma = place_.Render(from_);
  luma(cv::Rect(200, 0, 240, 360)).setTo(20);
  const auto found = FollowLandmarks(*map_,
                                     key_frame_,
                                     *image::BuildPyramid(luma),
                                     place_.camera(),
                                     {from_},
                                     Reach::kNear);
  EXPECT_GT(found.size(), 100U);
  for (const FollowedLandmark& landmark : found) {
    // Half of the patch may still see something.
    const double x_px = landmark.match.pixel_px.x();
    EXPECT_TRUE(x_px < 208.0 || x_px > 432.0) << x_px;
  }

  // Turned away by half the image: what is followed lies inside.
  const Rigid3 aside = LookAlongY({0.0, 0.0, 1.6}, 0.6, -0.03);
  const auto inside =
      FollowLandmarks(*map_,
                      key_frame_,
                      *image::BuildPyramid(place_.Render(aside)),
                      place_.camera(),
                      {aside},
                      Reach::kNear);
  EXPECT_GT(inside.size(), 50U);
  EXPECT_LT(inside.size(), key_frame_.landmarks.size() * 7 / 10);
  for (const FollowedLandmark& landmark : inside) {
    EXPECT_TRUE(place_.camera().IsInsideImage(landmark.match.pixel_px, 4.0));
  }
}

TEST_F(KeyFrameFollowerTest, FarMotionThatNobodyExpectsIsFollowed) {
  // By 70 of 640 px.
  const Rigid3 to = LookAlongY({0.1, 0.0, 1.6}, 0.08, -0.02);
  const auto pyramid = image::BuildPyramid(place_.Render(to));
  // Nothing rather than something else.
  EXPECT_TRUE(
      FollowLandmarks(
          *map_, key_frame_, *pyramid, place_.camera(), {from_}, Reach::kNear)
          .empty());
  const auto found = FollowLandmarks(
      *map_, key_frame_, *pyramid, place_.camera(), {from_}, Reach::kFar);
  EXPECT_GT(found.size(), 40U);
  EXPECT_LT(found.size(), 80U);
  const std::vector<double> errors_px = Errors_px(found, to);
  EXPECT_GT(std::count_if(errors_px.begin(),
                          errors_px.end(),
                          [](double error) { return error < 1.0; }),
            static_cast<long>(found.size()) * 6 / 10);
}

TEST_F(KeyFrameFollowerTest, NothingToFollowIsNothingFound) {
  const auto pyramid = image::BuildPyramid(place_.Render(from_));
  // Turned around: no landmark is in front.
  EXPECT_TRUE(FollowLandmarks(*map_,
                              key_frame_,
                              *pyramid,
                              place_.camera(),
                              {LookAlongY({0.0, 0.0, 1.6}, M_PI, 0.0)},
                              Reach::kNear)
                  .empty());
  KeyFrame empty = key_frame_;
  empty.landmarks.clear();
  EXPECT_TRUE(
      FollowLandmarks(
          *map_, empty, *pyramid, place_.camera(), {from_}, Reach::kNear)
          .empty());
}

TEST_F(KeyFrameFollowerTest, SpreadTakesFromEveryCellTheBestFirst) {
  const cv::Size size_px(640, 360);
  const auto chosen = SpreadOverImage(*map_, key_frame_.landmarks, size_px, 60);
  ASSERT_EQ(chosen.size(), 60U);
  // 16 x 9 cells of 40 px: no cell gives two while another has not given one,
  // and what it gives is anchored where it holds an anchored landmark, then
  // seen in most views.
  const auto cell_of = [](const FollowedLandmark& landmark) {
    const Eigen::Vector2d& pixel_px = landmark.match.pixel_px;
    return static_cast<int>(pixel_px.y() / 40.0) * 16 +
           static_cast<int>(pixel_px.x() / 40.0);
  };
  std::array<int, 144> count{};
  for (const FollowedLandmark& landmark : chosen) {
    EXPECT_EQ(++count[cell_of(landmark)], 1);
    for (const FollowedLandmark& other : key_frame_.landmarks) {
      if (cell_of(other) != cell_of(landmark)) continue;
      const auto rank = [&](const FollowedLandmark& l) {
        return std::pair(l.is_anchored,
                         map_->landmarks()[l.match.landmark].num_observations);
      };
      EXPECT_GE(rank(landmark), rank(other));
    }
  }

  // Even: when all cells give the same, none gives two more than another that
  // still has some.
  std::array<int, 144> available{};
  for (const auto& landmark : key_frame_.landmarks) {
    ++available[cell_of(landmark)];
  }
  const auto more = SpreadOverImage(*map_, key_frame_.landmarks, size_px, 220);
  ASSERT_EQ(more.size(), 220U);
  count.fill(0);
  for (const FollowedLandmark& landmark : more) ++count[cell_of(landmark)];
  const int deepest = *std::max_element(count.begin(), count.end());
  for (int cell = 0; cell < 144; ++cell) {
    EXPECT_GE(count[cell], std::min(available[cell], deepest - 1)) << cell;
  }
}

TEST_F(KeyFrameFollowerTest, SpreadDoesNotDependOnTheOrder) {
  const cv::Size size_px(640, 360);
  std::vector<FollowedLandmark> reversed(key_frame_.landmarks.rbegin(),
                                         key_frame_.landmarks.rend());
  const auto one = SpreadOverImage(*map_, key_frame_.landmarks, size_px, 100);
  const auto two = SpreadOverImage(*map_, reversed, size_px, 100);
  ASSERT_EQ(one.size(), two.size());
  for (std::size_t i = 0; i < one.size(); ++i) {
    EXPECT_EQ(one[i].match.landmark, two[i].match.landmark);
  }
  EXPECT_EQ(SpreadOverImage(*map_, reversed, size_px, 100'000).size(),
            reversed.size());
  EXPECT_TRUE(SpreadOverImage(*map_, reversed, size_px, 0).empty());
  EXPECT_TRUE(SpreadOverImage(*map_, {}, size_px, 10).empty());
}

}  // namespace
}  // namespace groundlock::localization
