// SPDX-License-Identifier: Apache-2.0
// The image room's vectors under this room's names.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_VECTORS_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_VECTORS_H_

#include "server/image/vectors.h"

namespace groundlock::target::internal {

using image::kVectorFloats;
using image::WholeVectors;

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_VECTORS_H_
