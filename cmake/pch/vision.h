// SPDX-License-Identifier: Apache-2.0
// Precompiled for the rooms that see: base plus OpenCV's core.
#include "cmake/pch/base.h"

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
