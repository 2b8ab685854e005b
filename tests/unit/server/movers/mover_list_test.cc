// SPDX-License-Identifier: Apache-2.0
#include "server/movers/mover_list.h"

#include <gtest/gtest.h>

#include <vector>

namespace groundlock::movers {
namespace {

constexpr double kStep_s = 0.1;
constexpr double kImage_px2 = 1'280.0 * 720.0;

Finding Thing(double x_m, double v_m_s, std::vector<std::uint64_t> points) {
  Finding finding;
  finding.box_px = geometry::Box2::FromXywh(100 + 20 * x_m, 200, 40, 20);
  finding.place_m = {x_m, 5.0};
  finding.place_covariance_m2 = 0.04 * Eigen::Matrix2d::Identity();
  finding.velocity_m_s = {v_m_s, 0.0};
  finding.velocity_covariance_m2_s2 = 0.01 * Eigen::Matrix2d::Identity();
  finding.point_ids = std::move(points);
  finding.ground_per_image_m2_px2 = 0.0025;
  return finding;
}

TEST(Existence, RisesWithFindingsAndFallsWithout) {
  const ExistenceModel model;
  const double found = Found(model, 0.3, 100.0);
  EXPECT_GT(found, 0.3);
  EXPECT_LT(found, 1.0);
  EXPECT_LT(NotFound(model, 0.3), 0.3);
  EXPECT_LT(Found(model, 0.3, 0.0), 0.3);
  // A finding as likely by chance says nothing.
  EXPECT_NEAR(Found(model, 0.3, 1.0), 0.3, 1e-12);
  EXPECT_LT(PredictExistence(model, 0.3, 1.0), 0.3);
}

TEST(MoverList, OneFindingIsNotBelievedAndManyAre) {
  MoverList list{ExistenceModel{}};
  for (int i = 0; i < 10; ++i) {
    list.Update(
        std::vector{Thing(0.2 * i, 2.0, {1, 2, 3})}, kStep_s, kImage_px2);
    ASSERT_EQ(list.movers().size(), 1U);
    if (i == 0) {
      EXPECT_FALSE(list.movers()[0].reported());
    }
  }
  EXPECT_EQ(list.movers()[0].id, 1U);
  EXPECT_NEAR(list.movers()[0].state[0], 1.8, 0.2);
  EXPECT_NEAR(list.movers()[0].state[2], 2.0, 0.1);
}

TEST(MoverList, KeepsTheIdWhenAllPointsAreOthers) {
  MoverList list{ExistenceModel{}};
  for (std::uint64_t i = 0; i < 20; ++i) {
    list.Update(std::vector{Thing(0.2 * i, 2.0, {3 * i, 3 * i + 1, 3 * i + 2})},
                kStep_s,
                kImage_px2);
  }
  ASSERT_EQ(list.movers().size(), 1U);
  EXPECT_EQ(list.movers()[0].id, 1U);
}

TEST(MoverList, IsPredictedWhileUnseenAndThenForgotten) {
  MoverList list{ExistenceModel{}};
  for (int i = 0; i < 10; ++i) {
    list.Update(
        std::vector{Thing(0.2 * i, 2.0, {1, 2, 3})}, kStep_s, kImage_px2);
  }
  list.Update({}, kStep_s, kImage_px2);
  ASSERT_EQ(list.movers().size(), 1U);
  EXPECT_NEAR(list.movers()[0].state[0], 2.0, 0.2);
  for (int i = 0; i < 10; ++i) list.Update({}, kStep_s, kImage_px2);
  EXPECT_TRUE(list.movers().empty());
}

TEST(MoverList, TwoThatPassEachOtherKeepTheirIds) {
  MoverList list{ExistenceModel{}};
  for (int i = 0; i < 20; ++i) {
    list.Update(std::vector{Thing(0.3 * i, 3.0, {1, 2, 3}),
                            Thing(6.0 - 0.3 * i, -3.0, {4, 5, 6})},
                kStep_s,
                kImage_px2);
  }
  ASSERT_EQ(list.movers().size(), 2U);
  for (const ListedMover& mover : list.movers()) {
    EXPECT_EQ(mover.id == 1, mover.state[2] > 0.0);
  }
}

TEST(MoverList, ForgetsWhatBecomesATarget) {
  MoverList list{ExistenceModel{}};
  list.Update(std::vector{Thing(0.0, 2.0, {1, 2, 3})}, kStep_s, kImage_px2);
  list.Forget(std::vector{geometry::Box2::FromXywh(500, 200, 40, 20)});
  EXPECT_EQ(list.movers().size(), 1U);
  list.Forget(std::vector{geometry::Box2::FromXywh(95, 195, 60, 40)});
  EXPECT_TRUE(list.movers().empty());
}

TEST(MoverList, HoldsAFewDozenWhateverIsFound) {
  MoverList list{ExistenceModel{}};
  for (int round = 0; round < 3; ++round) {
    std::vector<Finding> findings;
    for (int i = 0; i < 500; ++i) findings.push_back(Thing(10.0 * i, 1.0, {}));
    list.Update(findings, kStep_s, kImage_px2);
    EXPECT_LE(list.movers().size(), 64U);
  }
}

}  // namespace
}  // namespace groundlock::movers
