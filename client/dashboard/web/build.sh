#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds the page. Does nothing if nothing has changed since the last time.
#
#   client/dashboard/web/build.sh [FOLDER]     default: client/dashboard/web/dist
#
# Needs node >= 18.13, npm and protoc. Packages come as package-lock.json says.
set -euo pipefail
out=$(realpath -m "${1:-$(dirname "$0")/dist}")
cd "$(dirname "$0")"

for program in node npm "${PROTOC:-protoc}"; do
  command -v "$program" >/dev/null || {
    echo "build.sh: '$program' is missing; deploy/setup.sh installs it" >&2
    exit 1
  }
done
exec 9>.build.lock && flock 9

stamp=$out/.stamp
newer() {  # is anything among "$@" newer than the stamp?
  [ ! -f "$1" ] || [ -n "$(find "${@:2}" -newer "$1" -print -quit)" ]
}
sources=(index.html package.json package-lock.json tsconfig.json vite.config.ts
  generate.sh build.sh public src ../../../proto)
if ! newer "$stamp" "${sources[@]}"; then exit 0; fi

if newer node_modules/.package-lock.json package-lock.json; then
  # Not "npm ci": it refuses a lock file without the addresses of the optional
  # packages of other platforms. Versions and checksums are the lock file's here, too.
  npm install --no-save --no-audit --no-fund --loglevel=error
  touch node_modules/.package-lock.json
fi
./generate.sh
node_modules/.bin/tsc --noEmit
GROUNDLOCK_WEB_OUT=$out node_modules/.bin/vite build --logLevel warn
# Compressed once, not with every request.
find "$out" -type f \( -name '*.js' -o -name '*.css' -o -name '*.html' -o -name '*.svg' \) \
  -exec gzip -9 -k -n -f {} +
touch "$stamp"
