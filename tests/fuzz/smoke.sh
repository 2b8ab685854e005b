#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs every fuzz target for a short while, two per core at once; fails if any
# finds something.
#   tests/fuzz/smoke.sh FOLDER SECONDS_EACH
set -euo pipefail

fuzz_one() {
  local fuzzer=$1 seconds=$2
  local name work seeds=()
  name=$(basename "$fuzzer")
  work=$(mktemp -d)
  mkdir "$work/corpus"
  if [ -d "tests/fuzz/corpus/$name" ]; then seeds+=("tests/fuzz/corpus/$name"); fi
  # 1 GiB and 10 s per input are bounds on what untrusted bytes may cost.
  if ! "$fuzzer" -max_total_time="$seconds" -rss_limit_mb=1024 -timeout=10 \
      -artifact_prefix="$work/" "$work/corpus" "${seeds[@]}" >"$work/log" 2>&1; then
    tail -50 "$work/log" >&2
    echo "fuzz: $name failed; its input lies in $work" >&2
    return 1
  fi
  local runs
  runs=$(sed -n 's/^Done \([0-9]*\) runs.*/\1/p' "$work/log")
  rm -rf "$work"
  # A target that runs nothing checks nothing.
  if [ "${runs:-0}" -lt 100 ]; then
    echo "fuzz: $name tried only ${runs:-0} inputs" >&2
    return 1
  fi
  echo "fuzz: $name: $runs inputs without a finding"
}
export -f fuzz_one

folder=$1
seconds=$2
mapfile -t fuzzers < <(find "$folder" -maxdepth 1 -name '*_fuzzer' -type f -perm -u+x | sort)
if [ ${#fuzzers[@]} -eq 0 ]; then
  echo "fuzz: no target in $folder" >&2
  exit 1
fi
printf '%s\0' "${fuzzers[@]}" |
  xargs -0 -P "$((2 * $(nproc)))" -I{} bash -c 'set -euo pipefail; fuzz_one "$1" "$2"' _ {} "$seconds"
echo "fuzz: ${#fuzzers[@]} targets passed"
