// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_FEATURES_OPEN_CV_SETUP_H_
#define GROUNDLOCK_MAP_STORE_FEATURES_OPEN_CV_SETUP_H_

namespace groundlock::features {

// Sets OpenCV's process-wide switches as every program of ours needs them. To
// be called once, at the start, before other threads use OpenCV.
// - One thread: parallelism comes from sessions and images, and OpenCV's own
//   would fight it.
// - The same code on every x86-64 processor, rather than what suits each best:
//   its code for AVX2 fuses multiplications with additions, so that SIFT's
//   keypoints and descriptors differ in their last digits from those of a
//   processor without. SIFT takes 15 to 25 % longer for it, off the frame path.
void SetUpOpenCv();

}  // namespace groundlock::features

#endif  // GROUNDLOCK_MAP_STORE_FEATURES_OPEN_CV_SETUP_H_
