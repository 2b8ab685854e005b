// SPDX-License-Identifier: Apache-2.0
// How far features that were matched by descriptors lie from where landmarks
// truly are.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_FEATURE_ERRORS_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_FEATURE_ERRORS_H_

namespace groundlock::localization {

// Of a refinement on such features: SIFT's own localisation error reaches a
// pixel and a half at coarse octaves, and is twice that at most.
inline constexpr double kFeatureGate_px = 3.0;

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_FEATURE_ERRORS_H_
