#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What deploy/monitoring asks for, the server exposes, and the docs name; and
# the files are what Grafana and Prometheus read.
#
#   tests/lint/monitoring.sh [ROOT]
set -euo pipefail
root=${1:-$(dirname "$0")/../..}
cd "$root"
failures=0
for name in $(grep -ohE 'groundlock_[a-z_]+' deploy/monitoring/* | sort -u); do
  # Histograms and alerts' own names have suffixes and capitals of their own.
  plain=$(sed -E 's/_(bucket|sum|count)$//' <<< "$name")
  exposer=server/app/metrics_exposer.cc
  if [[ $plain == groundlock_dashboard_* ]]; then exposer=client/dashboard/proxy/dashboard_metrics.cc; fi
  for file in "$exposer" docs/operations.md; do
    if ! grep -qE "$plain[^a-z_]" "$file"; then
      echo "monitoring: $file does not know $plain" >&2
      failures=$((failures + 1))
    fi
  done
done
python3 - <<'PYTHON' || failures=$((failures + 1))
import json
with open("deploy/monitoring/grafana.json", encoding="utf-8") as file:
    panels = json.load(file)["panels"]
assert panels and all(panel["targets"] for panel in panels), "a panel shows nothing"
ids = [panel["id"] for panel in panels]
assert len(set(ids)) == len(ids), "two panels have one id"
with open("deploy/monitoring/alerts.yaml", encoding="utf-8") as file:
    text = file.read()
assert text.count("- alert:") == text.count("expr:") == text.count("summary:"), "an alert is incomplete"
for line in text.splitlines():
    if "expr:" in line:
        assert line.count("(") == line.count(")"), line
PYTHON
if [ "$failures" -gt 0 ]; then
  echo "monitoring: $failures failures" >&2
  exit 1
fi
echo "monitoring: all metrics that are asked for are there"
