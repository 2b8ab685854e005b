// SPDX-License-Identifier: Apache-2.0
// A small map to be imported.
#ifndef GROUNDLOCK_TESTS_INTEGRATION_TEXT_MODEL_H_
#define GROUNDLOCK_TESTS_INTEGRATION_TEXT_MODEL_H_

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "client/sdk/client.h"

namespace groundlock::test {

inline constexpr int kTextModelPoints = 400;
inline constexpr int kTextModelViews = 4;

// A COLMAP text model: a bumpy ground seen by cameras that look straight down
// from 5 units above. Names and contents of its files.
std::vector<std::pair<std::string, std::string>> TextModel();

// Writes the files into a folder of the name below `directory`, to be imported
// as the map `name`.
sdk::ImportRequest WriteForImport(
    const std::filesystem::path& directory,
    const std::string& name,
    const std::vector<std::pair<std::string, std::string>>& files);

}  // namespace groundlock::test

#endif  // GROUNDLOCK_TESTS_INTEGRATION_TEXT_MODEL_H_
