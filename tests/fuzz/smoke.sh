#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs every fuzz target for a short while; fails on the first finding.
#   tests/fuzz/smoke.sh FOLDER SECONDS_EACH
set -euo pipefail
folder=$1
seconds=$2
ran=0
for fuzzer in "$folder"/*_fuzzer; do
  [ -x "$fuzzer" ] || continue
  name=$(basename "$fuzzer")
  corpus=$(mktemp -d)
  log=$(mktemp)
  seeds=()
  if [ -d "tests/fuzz/corpus/$name" ]; then seeds+=("tests/fuzz/corpus/$name"); fi
  # 2 GiB and 10 s per input are bounds on what untrusted bytes may cost.
  if ! "$fuzzer" -max_total_time="$seconds" -rss_limit_mb=2048 -timeout=10 \
      -artifact_prefix="$corpus/" "$corpus" "${seeds[@]}" >"$log" 2>&1; then
    tail -50 "$log" >&2
    echo "fuzz: $name failed; its input lies in $corpus" >&2
    exit 1
  fi
  runs=$(sed -n 's/^Done \([0-9]*\) runs.*/\1/p' "$log")
  echo "fuzz: $name: ${runs:-0} inputs without a finding"
  rm -rf "$corpus" "$log"
  ran=$((ran + 1))
done
if [ "$ran" -eq 0 ]; then
  echo "fuzz: no target in $folder" >&2
  exit 1
fi
echo "fuzz: $ran targets passed"
