// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/postgres_content.h"

#include <fstream>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/storage/internal/postgres_schema.h"

namespace groundlock::storage::internal {
namespace {

constexpr PostgresStatement kInsertChunk = {
    "insert_chunk",
    "INSERT INTO groundlock.chunks VALUES ($1::int, $2::int, $3::bytea)"};
constexpr PostgresStatement kSelectChunk = {
    "select_chunk",
    "SELECT bytes FROM groundlock.chunks "
    "WHERE map_id = $1::int AND number = $2::int",
    /*binary_result=*/true};

}  // namespace

absl::Status InsertContent(PostgresConnection& connection,
                           std::int64_t map_id,
                           const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::string chunk(kPostgresChunkBytes, '\0');
  for (std::int64_t number = 0; stream; ++number) {
    stream.read(chunk.data(), static_cast<std::streamsize>(chunk.size()));
    const auto bytes = static_cast<std::size_t>(stream.gcount());
    if (bytes == 0) break;
    RETURN_IF_ERROR(
        connection
            .Run(kInsertChunk,
                 PostgresParameters().Add(map_id).Add(number).AddBytes(
                     std::string_view(chunk).substr(0, bytes)))
            .status());
  }
  if (stream.eof()) return absl::OkStatus();
  return absl::InternalError(absl::StrCat("cannot read ", file.string()));
}

absl::Status FetchContent(PostgresConnection& connection,
                          std::int64_t map_id,
                          std::uint64_t bytes,
                          const std::filesystem::path& file) {
  ASSIGN_OR_RETURN(base::AtomicFile out, base::AtomicFile::Create(file));
  std::uint64_t got = 0;
  for (std::int64_t number = 0; got < bytes; ++number) {
    ASSIGN_OR_RETURN(
        const PostgresResult row,
        connection.Run(kSelectChunk,
                       PostgresParameters().Add(map_id).Add(number)));
    const std::uint64_t expected = std::min(kPostgresChunkBytes, bytes - got);
    if (row.num_rows() != 1 || row.Text(0, 0).size() != expected) {
      return absl::DataLossError(absl::StrCat(
          connection.Description(),
          ": chunk ",
          number,
          " of map ",
          map_id,
          row.num_rows() != 1 ? " is missing" : " is not of the right size"));
    }
    RETURN_IF_ERROR(out.Write(row.Text(0, 0)));
    got += expected;
  }
  return out.Commit();
}

}  // namespace groundlock::storage::internal
