#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A fresh Debian 12 with nothing but the packages of a finished build: installs
# them by apt and runs the tutorial's commands, as they are written, as a user
# without rights and without a network.
#
#   tests/packages/fresh_debian_test.sh BUILD_FOLDER
#
# Exits with 77 where it cannot run: without root or debootstrap.
set -euo pipefail
cd "$(dirname "$0")/../.."
build=$(realpath "${1:?the build folder}")
skip() { echo "SKIPPED: $*" >&2; exit 77; }
fail() { echo "FAILED: $*" >&2; exit 1; }
[ "$(id -u)" -eq 0 ] || skip "only root may change the root folder"
for program in debootstrap unshare ip; do
  command -v "$program" >/dev/null || skip "there is no $program (deploy/setup.sh images)"
done
start=$SECONDS
step() { printf '== %s (%d s so far)\n' "$1" $((SECONDS - start)); }
. tests/packages/debian_base.sh

folder=$(mktemp -d)
chmod 755 "$folder"
root=$folder/root
cleanup() {
  local code=$?
  if [ "$code" -ne 0 ]; then tail -n 40 "$folder"/*.log >&2 || true; fi
  rm -rf --one-file-system "$folder"
}
trap cleanup EXIT
# within [UNSHARE OPTIONS] -- COMMAND…: in the fresh system. What is mounted there
# goes away with the command.
within() {
  local options=()
  while [ "$1" != -- ]; do options+=("$1"); shift; done
  shift
  unshare --mount --pid --fork --kill-child "${options[@]}" -- bash -euc '
    root=$1; shift
    mount -t proc proc "$root/proc"
    mount --rbind /dev "$root/dev"
    ip link set lo up
    exec env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 DEBIAN_FRONTEND=noninteractive \
      ${http_proxy:+http_proxy="$http_proxy"} ${https_proxy:+https_proxy="$https_proxy"} \
      chroot "$root" "$@"' bash "$root" "$@"
}

step "A fresh Debian"
make_debian "$root" "$folder/debootstrap.log" || fail "debootstrap"

step "The packages"
make_packages "$build" "$root/packages" "$folder/cpack.log" || fail "cpack"
within -- sh -c 'apt-get update -q && apt-get install -y -q -o APT::Install-Recommends=true /packages/*.deb' \
  >"$folder/install.log" 2>&1 || fail "apt-get install"
within -- sh -c 'rm -rf /var/cache/apt/archives/*.deb && useradd --create-home newcomer' >"$folder/user.log" 2>&1 ||
  fail "useradd"
for program in groundlock groundlock-server groundlock-dashboard; do
  within -- "$program" --version >"$folder/version.log" 2>&1 || fail "$program does not start"
done

/usr/bin/python3 tests/docs/commands_test.py --scripts "$root/tutorial" docs/tutorial.md >"$folder/scripts.log" 2>&1 ||
  fail "the tutorial's commands"
home=/home/newcomer
for script in "$root"/tutorial/*.sh; do
  name=$(basename "$script")
  step "The tutorial, line ${name%.sh}"
  within --net -- setpriv --reuid newcomer --regid newcomer --init-groups env HOME=$home \
    bash -euo pipefail -c "cd; . /tutorial/$name" >"$folder/tutorial.log" 2>&1 </dev/null ||
    fail "docs/tutorial.md:${name%.sh}"
done
for file in results.csv overlay.mp4 first.png yard.build/report.html; do
  [ -s "$root$home/$file" ] || fail "no $file"
done
cat "$folder/tutorial.log"
printf 'fresh Debian: the tutorial runs with the packages alone (%d s, %d packages installed)\n' \
  $((SECONDS - start)) "$(within -- dpkg-query -f '.\n' -W | wc -l)"
