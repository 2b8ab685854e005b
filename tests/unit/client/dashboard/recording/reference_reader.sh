#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A recording of ours, read by @mcap/core.
#   reference_reader.sh TEST_PROGRAM
# Exits 77 (skipped) if the page's packages are not installed.
set -euo pipefail
root=$(cd "$(dirname "$0")/../../../../.." && pwd)
if [ ! -d "$root/client/dashboard/web/node_modules/@mcap/core" ]; then
  echo "SKIPPED: npm ci in client/dashboard/web has not been run"
  exit 77
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
GROUNDLOCK_RECORDING_COPY=$folder/copy.mcap "$1" --gtest_filter='*KeepsResultsImages*'
node "$root/tests/browser/read_recording.mjs" "$folder/copy.mcap" | tee "$folder/counts"
grep -q '"/session/result":50,"/session/image":50' "$folder/counts"
