# SPDX-License-Identifier: Apache-2.0
# Sourced by the tests that need a Debian 12 with nothing in it.

# make_packages BUILD FOLDER LOG: the packages of a finished build.
make_packages() {
  mkdir -p "$2"
  cpack --config "$1/CPackConfig.cmake" -B "$2/packed" >"$3" 2>&1 || return
  mv "$2"/packed/*.deb "$2/"
  rm -rf "$2/packed"
}

# make_debian ROOT LOG: a Debian 12 in the folder ROOT, of essential packages
# alone; further ones it takes from where this machine's come from.
make_debian() {
  debootstrap --variant=minbase bookworm "$1" >"$2" 2>&1 || return
  cp -a /etc/apt/apt.conf.d/. "$1/etc/apt/apt.conf.d/"
  if [ -f /etc/apt/sources.list ]; then cp /etc/apt/sources.list "$1/etc/apt/"; fi
  if [ -d /etc/apt/sources.list.d ]; then cp -a /etc/apt/sources.list.d/. "$1/etc/apt/sources.list.d/"; fi
  rm -rf "$1"/var/cache/apt/archives/*.deb "$1"/var/lib/apt/lists/*
}
