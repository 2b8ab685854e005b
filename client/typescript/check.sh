#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Packs the TypeScript client, installs the package as a user would, into
# BUILD/typescript/app, and tests it there against the real programs in BUILD/bin.
#
#   client/typescript/check.sh [BUILD] [ARGUMENTS OF node --test]   default: build
#
# Exits 77 (skipped) if node, npm, protoc or the programs are missing.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(realpath "$here/../..")
build=$(realpath "${1:-$root/build}")
shift || true
work=$build/typescript
export GROUNDLOCK_BIN=${GROUNDLOCK_BIN:-$build/bin}
export GROUNDLOCK_DATA=${GROUNDLOCK_DATA:-$(realpath -m "$root/../shared/data")}
export GROUNDLOCK_SCRATCH=$work
# What the Python client's tests have the dashboard record.
export GROUNDLOCK_RECORDING=$build/python/recording.mcap
# For the tests in a browser, which say so if one of these is not there.
export GROUNDLOCK_WEB_MODULES=$root/client/dashboard/web
CHROMIUM=${CHROMIUM:-$(command -v chromium || true)}
export CHROMIUM

skip() { echo "SKIPPED: $1"; exit 77; }
for program in node npm ffmpeg openssl "${PROTOC:-protoc}"; do
  command -v "$program" >/dev/null || skip "$program is not installed"
done
for program in groundlock-server groundlock; do
  [ -x "$GROUNDLOCK_BIN/$program" ] || skip "$program is not built"
done

cd "$here"
if [ ! -f node_modules/.package-lock.json ] || [ package-lock.json -nt node_modules/.package-lock.json ]; then
  # Not "npm ci": it refuses a lock file without addresses. Versions and
  # checksums are the lock file's here, too.
  npm install --no-save --no-audit --no-fund --loglevel=error
  touch node_modules/.package-lock.json
fi
# Which build the tests are to find: of a clone that with its commit. Said here,
# for the clone may get another commit while they run.
GROUNDLOCK_COMMIT=$(git -C "$root" describe --always --abbrev=12 --exclude='*' --dirty=+ 2>/dev/null || true)
export GROUNDLOCK_COMMIT
rm -rf dist "$work/app" "$work"/groundlock-*.tgz
mkdir -p "$work/app/node_modules/groundlock"
npm pack --silent --pack-destination "$work" >/dev/null
tar -xzf "$work"/groundlock-*.tgz -C "$work/app/node_modules/groundlock" --strip-components=1
# What npm would install beside it, from here: no network is needed twice.
for package in node_modules/* node_modules/@*; do
  name=$(basename "$package")
  [ -e "$work/app/node_modules/$name" ] || ln -s "$here/$package" "$work/app/node_modules/$name"
done
cp test/*.mjs "$work/app/"
cp "$root/docs/typescript.md" "$work/app/"
cd "$work/app"
exec node --test --test-concurrency=1 "$@" .
