#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Whether systemd reads its units without complaint, and finds them confined:
# what a service may still do has an exposure of 1.7 of 10 (below 2 is "ok").
# Nothing is started.
#
#   tests/lint/units.sh BIN     BIN: where the programs are
set -euo pipefail
bin=$(cd "$1" && pwd)
cd "$(dirname "$0")/../.."
if ! command -v systemd-analyze >/dev/null; then
  echo "units: SKIPPED, there is no systemd-analyze" >&2
  exit 77
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
failures=0
for unit in deploy/systemd/*.service; do
  copy=$folder/$(basename "$unit")
  # The programs are not installed here.
  sed -E "s#^ExecStart=groundlock#ExecStart=$bin/groundlock#" "$unit" >"$copy"
  # It complains on its output, and about other units of the machine, too.
  said=$(systemd-analyze verify --man=no "$copy" 2>&1 | grep -F "$(basename "$unit")" || true)
  if [ -n "$said" ]; then
    echo "units: $said" >&2
    failures=$((failures + 1))
  fi
  if ! level=$(systemd-analyze security --offline=true --threshold=20 "$copy" 2>&1); then
    echo "units: $(tail -1 <<<"$level")" >&2
    failures=$((failures + 1))
  fi
  tail -1 <<<"$level"
done
[ "$failures" -eq 0 ]
