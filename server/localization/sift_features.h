// SPDX-License-Identifier: Apache-2.0
// The features of a frame are those that maps are made of.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SIFT_FEATURES_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SIFT_FEATURES_H_

#include "map_store/features/sift_features.h"

namespace groundlock::localization {

using features::ExtractSift;
using features::RootSift;
using features::SiftFeatures;
using features::SiftOptions;

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SIFT_FEATURES_H_
