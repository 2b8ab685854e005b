// SPDX-License-Identifier: Apache-2.0
// Aligns patches of two images of which motion has blurred one more than the
// other, and which differ in brightness.
//
// Lucas-Kanade assumes that both show the same: it then settles where the
// sharp patch fits the blurred one least badly, off by up to a pixel, and alike
// for all edges of one kind. Here each image is blurred by the other's motion
// first, which makes them alike (convolutions commute).
// Source: Jin, Favaro & Cipolla 2005 (tracking through motion blur).
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_BLURRED_PATCH_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_BLURRED_PATCH_H_

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <optional>

namespace groundlock::localization {

// A place of a key image, and how it is seen in the current one. Points are
// OpenCV's: the centre of the top-left pixel is (0, 0).
struct PatchPair {
  Eigen::Vector2d key_point = Eigen::Vector2d::Zero();
  // Of offsets from the patch's centre.
  Eigen::Matrix2d key_from_current = Eigen::Matrix2d::Identity();
  // By how much the place moved in each image while that was exposed; pixels.
  Eigen::Vector2d key_blur = Eigen::Vector2d::Zero();
  Eigen::Vector2d current_blur = Eigen::Vector2d::Zero();
};

// Where the patch is in `current`; both CV_8UC1. Brightness may differ by a
// factor and an offset. nullopt if it is not found within a few pixels of
// `start`, looks different or touches the image's border. Thread-safe.
// Source: Baker & Matthews 2004 (inverse compositional).
std::optional<Eigen::Vector2d> AlignPatch(const cv::Mat& key,
                                          const cv::Mat& current,
                                          const PatchPair& pair,
                                          const Eigen::Vector2d& start);

// Share of the patch's variance, in [0, 1], that `current` at `point` does not
// repeat; nullopt if a patch touches the image's border. Thread-safe.
std::optional<double> PatchMismatch(const cv::Mat& key,
                                    const cv::Mat& current,
                                    const PatchPair& pair,
                                    const Eigen::Vector2d& point);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_BLURRED_PATCH_H_
