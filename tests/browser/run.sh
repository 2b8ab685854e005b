#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The browser tests: the page in Debian's Chromium, against the real programs.
#
#   tests/browser/run.sh [BUILD]     default: build
#
# Exits 77 (skipped) if node, Chromium or the page is missing. Screenshots go to
# $GROUNDLOCK_SCREENSHOTS if that is set.
set -euo pipefail
cd "$(dirname "$0")/../.."
build=$(realpath "${1:-build}")
web=client/dashboard/web
export GROUNDLOCK_BIN=$build/bin
export GROUNDLOCK_WEB=$build/share/groundlock/web
export GROUNDLOCK_DATA=${GROUNDLOCK_DATA:-$(realpath -m ../shared/data)}
export GROUNDLOCK_BROWSER_SCRATCH=$build/browser
export CHROMIUM=${CHROMIUM:-$(command -v chromium || true)}

skip() { echo "SKIPPED: $1"; exit 77; }
command -v node >/dev/null || skip "node is not installed"
[ -n "$CHROMIUM" ] || skip "chromium is not installed"
[ -f "$GROUNDLOCK_WEB/index.html" ] || skip "the page is not built: target groundlock_web"
[ -d "$web/node_modules/playwright-core" ] || skip "playwright-core is not installed: npm ci in $web"
for program in groundlock-server groundlock-dashboard groundlock; do
  [ -x "$GROUNDLOCK_BIN/$program" ] || skip "$program is not built"
done
exec node --test tests/browser/dashboard.test.mjs
