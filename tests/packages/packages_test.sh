#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes the Debian packages of a finished build, twice, and uses what is in them.
#
#   tests/packages/packages_test.sh BUILD_FOLDER
set -euo pipefail
build=$(realpath "${1:?the build folder}")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
fail() { echo "FAILED: $*" >&2; exit 1; }

export SOURCE_DATE_EPOCH=1700000000
for round in first second; do
  cpack --config "$build/CPackConfig.cmake" -B "$folder/$round" >"$folder/log" 2>&1 || {
    cat "$folder/log" >&2; fail "cpack"; }
done
for deb in "$folder"/first/*.deb; do
  cmp "$deb" "$folder/second/$(basename "$deb")" || fail "two builds differ: $(basename "$deb")"
  dpkg-deb -x "$deb" "$folder/root"
done

for package in groundlock groundlock-server groundlock-dashboard; do
  deb=$(echo "$folder/first/${package}"_*.deb)
  [ -f "$deb" ] || fail "no package $package"
  dpkg-deb -f "$deb" Depends | grep -q libc6 || fail "$package does not know its libraries"
  [ -s "$folder/root/usr/share/doc/$package/copyright" ] || fail "$package: copyright"
  "$folder/root/usr/bin/$package" --help >/dev/null || fail "$package does not start"
  "$folder/root/usr/bin/$package" --version | grep -q '[0-9]' || fail "$package --version"
done
if command -v lintian >/dev/null; then
  # No address stands behind the packages yet: nobody is named as maintainer.
  lintian --allow-root --tag-display-limit 0 --suppress-tags bogus-mail-host,bogus-mail-host-in-debian-changelog \
    --fail-on error,warning "$folder"/first/*.deb || fail "lintian"
else
  echo "lintian is not here: the packages were not looked at by it"
fi
[ -s "$folder/root/etc/groundlock/server.ini" ] || fail "no /etc/groundlock/server.ini"
dpkg-deb -I "$folder"/first/groundlock-server_*.deb conffiles | grep -qx /etc/groundlock/server.ini ||
  fail "server.ini is no conffile"
for unit in groundlock-server groundlock-dashboard; do
  [ -f "$folder/root/lib/systemd/system/$unit.service" ] ||
    [ -f "$folder/root/usr/lib/systemd/system/$unit.service" ] || fail "no systemd unit $unit"
done
"$folder/root/usr/bin/groundlock-server" --config "$folder/root/etc/groundlock/server.ini" --help >/dev/null ||
  fail "server.ini is not understood"

for file in man/man1/groundlock.1.gz man/man1/groundlock-server.1.gz man/man1/groundlock-dashboard.1.gz bash-completion/completions/groundlock \
    zsh/vendor-completions/_groundlock fish/vendor_completions.d/groundlock.fish; do
  [ -s "$folder/root/usr/share/$file" ] || fail "no /usr/share/$file"
done

# The command line finds the server that is installed beside it.
XDG_DATA_HOME=$folder/data "$folder/root/usr/bin/groundlock" map list --local >/dev/null ||
  fail "the installed programs do not work together"
echo "packages: $(cd "$folder/first" && ls -- *.deb | tr '\n' ' ')are sound"
