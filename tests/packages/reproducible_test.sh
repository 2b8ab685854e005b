#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Compiles the tree a second time, elsewhere and without ccache, and compares the
# Debian packages of both builds, byte by byte.
#
#   tests/packages/reproducible_test.sh BUILD_FOLDER
#
# Takes what a build from nothing takes: for the night.
set -euo pipefail
cd "$(dirname "$0")/../.."
build=$(realpath "${1:?the build folder}")
fail() { echo "FAILED: $*" >&2; exit 1; }
folder=$(mktemp -d)
cleanup() {
  local code=$?
  if [ "$code" -ne 0 ]; then tail -n 20 "$folder"/*.log >&2 || true; fi
  rm -rf "$folder"
}
trap cleanup EXIT

# The same commit, with what was changed since: so --version says the same.
git clone -q --no-hardlinks . "$folder/another-place"
git ls-files -z --modified --others --exclude-standard --deduplicate | while IFS= read -r -d '' file; do
  if [ -e "$file" ]; then
    mkdir -p "$(dirname "$folder/another-place/$file")"
    cp -p "$file" "$folder/another-place/$file"
  else
    rm -f "$folder/another-place/$file"
  fi
done

start=$SECONDS
export CCACHE_DISABLE=1
(
  cd "$folder/another-place"
  cmake --preset release -DGROUNDLOCK_TESTS=OFF -DGROUNDLOCK_BENCHMARKS=OFF >"$folder/configure.log"
  targets=(groundlock groundlock-server groundlock-dashboard groundlock_described groundlock_dev groundlock_python_messages)
  if command -v npm >/dev/null; then targets+=(groundlock_web); fi
  time cmake --build build --target "${targets[@]}" >"$folder/build.log" 2>&1
) || fail "the second build"
printf 'the second build took %d s\n' $((SECONDS - start))

SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)
export SOURCE_DATE_EPOCH
for round in first second; do
  from=$build
  if [ "$round" = second ]; then from="$folder/another-place/build"; fi
  cpack --config "$from/CPackConfig.cmake" -B "$folder/$round" >"$folder/cpack.log" 2>&1 || fail "cpack"
done
different=()
for deb in "$folder"/first/*.deb; do
  name=$(basename "$deb")
  if cmp -s "$deb" "$folder/second/$name"; then
    sha256sum "$deb" | sed "s:$folder/first/::"
    continue
  fi
  different+=("$name")
  for round in first second; do dpkg-deb -x "$folder/$round/$name" "$folder/$round-unpacked"; done
  diff -rq "$folder/first-unpacked" "$folder/second-unpacked" >&2 || true
done
[ ${#different[@]} -eq 0 ] || fail "two builds differ: ${different[*]}"
echo "reproducible: two builds in two places made the same packages"
