// SPDX-License-Identifier: Apache-2.0
// Matching as map_store/features does it.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_DESCRIPTOR_MATCHING_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_DESCRIPTOR_MATCHING_H_

#include "map_store/features/descriptor_matching.h"

namespace groundlock::localization {

using features::DescriptorMatch;
using features::DescriptorSet;
using features::MatchDescriptors;

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_DESCRIPTOR_MATCHING_H_
