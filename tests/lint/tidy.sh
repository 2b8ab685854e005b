#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs clang-tidy 14 with the repository's .clang-tidy; findings are errors.
#   tests/lint/tidy.sh [--since REV]   all sources, or those changed since REV
# A file is checked again only if it, or a header of ours, has changed since it
# last passed (stamps in build-tidy/).
set -euo pipefail
cd "$(dirname "$0")/../.."

mapfile -t sources < <(find map_store server client -name '*.cc' | sort)
if [ "${1:-}" = "--since" ]; then
  mapfile -t sources < <(git diff --name-only --diff-filter=d "$2" -- map_store server client | grep '\.cc$' || true)
fi
[ ${#sources[@]} -gt 0 ] || { echo "tidy: nothing to check"; exit 0; }

cmake -S . -B build-tidy -G Ninja -DCMAKE_CXX_COMPILER=clang++-14 \
  -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON -DCMAKE_EXPORT_COMPILE_COMMANDS=ON \
  -DGROUNDLOCK_UNITY=OFF -DGROUNDLOCK_TESTS=OFF -DGROUNDLOCK_BENCHMARKS=OFF >build-tidy.log 2>&1 ||
  { cat build-tidy.log >&2; rm -f build-tidy.log; exit 1; }
rm -f build-tidy.log
ninja -C build-tidy groundlock_proto >/dev/null

mkdir -p build-tidy/stamps
headers=$(find map_store server client proto -name '*.h' -o -name '*.inc' -o -name '*.proto' | sort | xargs cat .clang-tidy | sha256sum)
todo=()
for source in "${sources[@]}"; do
  stamp=build-tidy/stamps/$(echo "$headers $(sha256sum "$source")" | sha256sum | cut -c1-32)
  [ -e "$stamp" ] || todo+=("$source:$stamp")
done
check() {
  local source=${1%%:*} stamp=${1##*:}
  if output=$(clang-tidy-14 --quiet -p build-tidy "$source" 2>/dev/null); then
    touch "$stamp"
  else
    printf '%s\n' "$output"
    return 1
  fi
}
export -f check
if [ ${#todo[@]} -gt 0 ]; then
  printf '%s\n' "${todo[@]}" | xargs -P "$(nproc)" -I{} bash -c 'check "{}"' || {
    echo "tidy: findings above" >&2
    exit 1
  }
fi
echo "tidy: ${#sources[@]} files checked, ${#todo[@]} of them anew"
