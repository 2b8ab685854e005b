#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs what Groundlock needs on Debian 12. Idempotent and unattended:
# packages that are there are left alone.
#
#   deploy/setup.sh build    what building it and running it needs
#   deploy/setup.sh [test]   and what the tests need: a second compiler, a
#                            database, a browser
set -euo pipefail

packages=(
  # Tool chain.
  build-essential cmake ninja-build ccache pkg-config git ca-certificates
  # Vision and geometry.
  libopencv-dev libopencv-contrib-dev libeigen3-dev libceres-dev
  libflann-dev libopengv-dev libembree-dev
  # Services.
  libgrpc++-dev libprotobuf-dev protobuf-compiler protobuf-compiler-grpc
  libabsl-dev libspdlog-dev libfmt-dev libcli11-dev nlohmann-json3-dev
  libssl-dev openssl libjwt-dev
  # Storage.
  libsqlite3-dev libxxhash-dev libpq-dev
  # Building and placing maps.
  colmap libgeographiclib-dev libexif-dev
  # Dashboard.
  libboost-dev zlib1g-dev libzstd-dev
  # Metrics.
  prometheus-cpp-dev
  # Video and image coding.
  libavformat-dev libavcodec-dev libavutil-dev libswscale-dev ffmpeg
  libturbojpeg0-dev libpng-dev
  # Scripts.
  python3
)
test_packages=(
  # Sanitizers, fuzzing, formatting and static analysis.
  clang-14 libclang-rt-14-dev clang-format-14 clang-tidy-14
  # A database, and the browser of the dashboard's tests.
  postgresql-15 chromium
  # Tests, benchmarks and evaluation scripts.
  libgtest-dev libgmock-dev libbenchmark-dev python3-numpy
  # The Python client.
  python3-pip python3-setuptools python3-wheel python3-grpcio python3-protobuf
  python3-pandas python3-zstandard python3-opencv python3-pytest mypy openssl
)

case "${1:-test}" in
  build) ;;
  test) packages+=("${test_packages[@]}") ;;
  *) sed -n '3,9p' "$0" >&2; exit 2 ;;
esac

# The dashboard's page needs any node from 18.13 on; a machine may have its own.
if ! command -v node >/dev/null || ! command -v npm >/dev/null; then
  packages+=(nodejs npm)
fi

missing=()
for package in "${packages[@]}"; do
  if ! dpkg-query -W -f='${Status}' "$package" 2>/dev/null |
      grep -q 'install ok installed'; then
    missing+=("$package")
  fi
done
if [ ${#missing[@]} -eq 0 ]; then
  echo "setup: all ${#packages[@]} packages are installed"
  exit 0
fi

as_root=()
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null || {
    echo "setup: run as root, or install sudo: these packages are missing: ${missing[*]}" >&2
    exit 1
  }
  as_root=(sudo)
fi
echo "setup: installing ${#missing[@]} packages: ${missing[*]}"
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get update -q
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
  apt-get install -y -q --no-install-recommends "${missing[@]}"
echo "setup: done"
