// SPDX-License-Identifier: Apache-2.0
// Precompiled for the command line: vision plus options and JSON.
#include "cmake/pch/vision.h"

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
