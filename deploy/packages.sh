#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes Debian packages of this tree, and with --install installs them.
#
#   deploy/packages.sh [--install] [--out FOLDER]     default: out/packages
set -euo pipefail
cd "$(dirname "$0")/.."

out=out/packages
install=false
while [ $# -gt 0 ]; do
  case "$1" in
    --out) out=${2:?--out needs a folder}; shift 2 ;;
    --install) install=true; shift ;;
    *) sed -n '3,5p' "$0" >&2; exit 2 ;;
  esac
done

deploy/setup.sh build
if [ ! -f build/CMakeCache.txt ]; then
  cmake --preset release -DGROUNDLOCK_TESTS=OFF -DGROUNDLOCK_BENCHMARKS=OFF >/dev/null
fi
cmake --build build --target groundlock groundlock-server groundlock-dashboard groundlock_described \
  groundlock_dev groundlock_python_messages
if command -v npm >/dev/null; then cmake --build build --target groundlock_web; fi

# The same tree gives the same bytes: times in the archives are the commit's.
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct 2>/dev/null || echo 0)
export SOURCE_DATE_EPOCH
mkdir -p "$out"
rm -f "$out"/groundlock*.deb "$out"/libgroundlock-dev*.deb "$out"/python3-groundlock*.deb
cpack --config build/CPackConfig.cmake -B "$(realpath "$out")" >/dev/null
rm -rf "$out/_CPack_Packages"
ls -l "$out"/*.deb

if $install; then
  as_root=()
  if [ "$(id -u)" -ne 0 ]; then as_root=(sudo); fi
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
    apt-get install -y -q --no-install-recommends --reinstall "$(realpath "$out")"/*.deb
else
  echo "install them with: apt-get install ./${out#./}/*.deb"
fi
