// SPDX-License-Identifier: Apache-2.0
// Image names of foreign reconstructions: paths of a machine that is not ours.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_NAMED_FILES_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_NAMED_FILES_H_

#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/map/map_data.h"

namespace groundlock::formats::internal {

// The file that `name` means, in the first of `folders` that has it: under the
// name's own path if that is relative, else (and then) by its last part. If
// `extension` is given it takes the place of the name's own; the name with it
// appended is looked for as well. Never a file outside of the folders, whatever
// the name says: its author may not be the user.
std::optional<std::filesystem::path> FindNamedFile(
    std::span<const std::filesystem::path> folders,
    const std::string& name,
    std::string_view extension = {});

// Where files of images go when a reconstruction is uploaded.
inline constexpr char kImagesFolder[] = "images";
// Where the file that FindNamedFile finds for a name goes, so that it finds it
// there again: kImagesFolder/NAME, NAME's own folders kept if they are
// relative. `extension` as there.
std::string RemoteName(const std::string& name,
                       std::string_view extension = {});

// Names of views: the last part of each image's name where that is unambiguous,
// else the name as it is. kInvalidArgument if a name is there twice.
absl::StatusOr<std::vector<std::string>> ViewNames(
    std::span<const std::string> image_names);

// `path`'s folder, "." if it has none.
std::filesystem::path FolderOf(const std::filesystem::path& path);

// What else has to be known of images to make views of foreign ones.
struct ViewImage {
  std::filesystem::path path;  // empty = there is none
  // Of each feature, px, diameter; empty = not known.
  std::vector<float> sizes_px;
};

// Descriptors for all features of `data` (which has none), computed from the
// images, one per view. Names of the views whose image is missing or cannot be
// read come back in `lacking`. What a user should know goes into `warnings`.
// go_on: as ImportOptions has it.
absl::Status DescribeFromImages(std::span<const ViewImage> images,
                                const std::function<bool()>& go_on,
                                map::MapData* data,
                                std::vector<std::string>* lacking,
                                std::vector<std::string>* warnings);

}  // namespace groundlock::formats::internal

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_INTERNAL_NAMED_FILES_H_
