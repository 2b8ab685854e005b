#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs what Groundlock needs on Debian 12. Idempotent and unattended:
# packages that are there are left alone.
#
#   deploy/setup.sh run      what its programs call; who installs the packages gets
#                            that, and the libraries, with them
#   deploy/setup.sh build    and what building it needs
#   deploy/setup.sh [test]   and what the tests need: a second compiler, a
#                            database, a browser
#   deploy/setup.sh images   what the tests of a fresh Debian and of the container
#                            images need: debootstrap, buildah, and a Docker daemon
#                            (where systemd runs, it is stopped again)
#   deploy/setup.sh arm64    what a build for arm64 on another machine needs: the
#                            cross compiler, an emulator, and the libraries of
#                            Debian's arm64, which go to build-sysroot-arm64/
#                            (or $GROUNDLOCK_SYSROOT): 2 GB
set -euo pipefail

programs=(
  # Building maps; video; elevation models; certificates; scripts.
  colmap ffmpeg gdal-bin proj-data openssl ca-certificates python3
)
tools=(
  build-essential cmake ninja-build ccache pkg-config git
  protobuf-compiler protobuf-compiler-grpc help2man
)
libraries=(
  # Vision and geometry.
  libopencv-dev libopencv-contrib-dev libeigen3-dev libceres-dev
  libflann-dev libopengv-dev libembree-dev libsleef-dev
  # Services.
  libgrpc++-dev libprotobuf-dev
  libabsl-dev libspdlog-dev libfmt-dev libcli11-dev nlohmann-json3-dev
  libssl-dev libjwt-dev libseccomp-dev
  # Memory.
  libgoogle-perftools-dev
  # Storage.
  libsqlite3-dev libxxhash-dev libpq-dev
  # Placing maps.
  libgeographiclib-dev libexif-dev
  # Dashboard.
  libboost-dev zlib1g-dev libzstd-dev
  # Metrics.
  prometheus-cpp-dev
  # Video and image coding.
  libavformat-dev libavcodec-dev libavutil-dev libswscale-dev
  libturbojpeg0-dev libpng-dev
)
test_libraries=(libgtest-dev libgmock-dev libbenchmark-dev)
test_tools=(
  # What takes the packages, the manual pages and the completion scripts.
  lintian mandoc zsh fish
  # Sanitizers, fuzzing, formatting and static analysis.
  clang-14 libclang-rt-14-dev clang-format-14 clang-tidy-14
  # A database, and the browser of the dashboard's tests.
  postgresql-15 chromium
  # Evaluation scripts, and what reads the manifests: the schemas of Kubernetes'
  # API are in its client.
  python3-numpy python3-yaml python3-kubernetes
  # The Python client.
  python3-pip python3-setuptools python3-wheel python3-grpcio python3-protobuf
  python3-pandas python3-zstandard python3-opencv python3-pytest mypy
  python3-matplotlib
  # promtool, which tries the alerts.
  prometheus
  # The documents: their site, a network of its own for their commands, and what
  # these call.
  mkdocs iproute2 util-linux sqlite3
)

packages=("${programs[@]}" "${tools[@]}" "${libraries[@]}")
case "${1:-test}" in
  run) packages=("${programs[@]}") ;;
  build) ;;
  test) packages+=("${test_libraries[@]}" "${test_tools[@]}") ;;
  images) packages=(buildah debootstrap docker.io docker-compose iproute2 python3) ;;
  arm64) packages=("${programs[@]}" "${tools[@]}" g++-12-aarch64-linux-gnu qemu-user mmdebstrap) ;;
  *) sed -n '3,17p' "$0" >&2; exit 2 ;;
esac

# The libraries of Debian's arm64 in a folder of their own: as packages of this
# machine some of them would replace its own. They are only unpacked, so what
# their scripts would have done is done here.
make_sysroot() {
  local sysroot=${GROUNDLOCK_SYSROOT:-$(dirname "$0")/../build-sysroot-arm64}
  local include=("${libraries[@]}" "${test_libraries[@]}" libc6-dev libstdc++-12-dev
    libblas-dev liblapack-dev libhdf5-dev)
  local stamp="$sysroot/.groundlock-packages"
  if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "${include[*]}" ]; then
    echo "setup: $sysroot is there"
    return
  fi
  rm -rf "$sysroot"
  echo "setup: unpacking ${#include[@]} packages for arm64 to $sysroot"
  mmdebstrap --quiet --variant=extract --architectures=arm64 \
    --include="$(IFS=,; echo "${include[*]}")" bookworm "$sysroot"
  # Links that name a path from the root lead out of the folder.
  local link target
  find "$sysroot/usr" "$sysroot/etc" -type l -lname '/*' -print0 |
    while IFS= read -r -d '' link; do
      target=$(readlink "$link")
      ln -sfn --relative "$sysroot$target" "$link"
    done
  # Of some libraries there are several, and installation chooses.
  local library of_arm64="$sysroot/usr/lib/aarch64-linux-gnu"
  for library in blas lapack; do
    for link in "$of_arm64/$library"/*.so*; do
      ln -sfn "$library/${link##*/}" "$of_arm64/${link##*/}"
    done
  done
  ln -sfn hdf5-serial.pc "$of_arm64/pkgconfig/hdf5.pc"
  # Some of CMake's files name libraries from the root, too.
  grep -rlZ ';/usr/' "$of_arm64/cmake" | xargs -0 sed -i 's:;/usr/:;${CMAKE_SYSROOT}/usr/:g'
  # CMake's files for gRPC name its programs, which run on this machine.
  local program
  for program in /usr/bin/protoc /usr/bin/grpc_*_plugin; do
    ln -sfn "$program" "$sysroot/usr/bin/"
  done
  echo "${include[*]}" >"$stamp"
}

# The dashboard's page is made by any node from 18.13 on; a machine may have its own.
if [ "${1:-test}" != run ] && { ! command -v node || ! command -v npm; } >/dev/null; then
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
else
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
  # Of prometheus only promtool is wanted, no server that others reach.
  if [[ " ${missing[*]} " == *" prometheus "* && -d /run/systemd/system ]]; then
    "${as_root[@]}" systemctl disable --now prometheus
  fi
  # The tests start a Docker daemon of their own.
  if [[ " ${missing[*]} " == *" docker.io "* && -d /run/systemd/system ]]; then
    "${as_root[@]}" systemctl disable --now docker.socket docker
  fi
  echo "setup: done"
fi
if [ "${1:-test}" = arm64 ]; then make_sysroot; fi
