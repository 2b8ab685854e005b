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

# Where they were built must not matter (reproducible_test.sh builds twice).
tree=$(cd "$(dirname "$0")/../.." && pwd)
if grep -rlF -e "$tree" -e "$build" "$folder/root"; then fail "packaged files name the folder in which they were built"; fi

for package in libgroundlock-dev python3-groundlock; do
  [ -s "$folder/root/usr/share/doc/$package/copyright" ] || fail "$package: copyright"
done
version=$("$folder/root/usr/bin/groundlock" --version)
if git -C "$tree" rev-parse -q --verify HEAD >/dev/null 2>&1; then
  [[ "$version" =~ ^[0-9.]+\ \([0-9a-f]{12}\+?\)$ ]] || fail "the version names no commit: $version"
fi
for package in groundlock groundlock-server groundlock-dashboard; do
  deb=$(echo "$folder/first/${package}"_*.deb)
  [ -f "$deb" ] || fail "no package $package"
  dpkg-deb -f "$deb" Depends | grep libc6 >/dev/null || fail "$package does not know its libraries"
  [ -s "$folder/root/usr/share/doc/$package/copyright" ] || fail "$package: copyright"
  "$folder/root/usr/bin/$package" --help >/dev/null || fail "$package does not start"
  [ "$("$folder/root/usr/bin/$package" --version)" = "$version" ] || fail "$package --version is not $version"
done
if command -v lintian >/dev/null; then
  # No address stands behind the packages yet: nobody is named as maintainer.
  lintian --allow-root --tag-display-limit 0 --suppress-tags bogus-mail-host,bogus-mail-host-in-debian-changelog \
    --fail-on error,warning "$folder"/first/*.deb || fail "lintian"
else
  echo "lintian is not here: the packages were not looked at by it"
fi
[ -s "$folder/root/etc/groundlock/server.ini" ] || fail "no /etc/groundlock/server.ini"
dpkg-deb -I "$folder"/first/groundlock-server_*.deb conffiles | grep -x /etc/groundlock/server.ini >/dev/null ||
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

# The packages for those who write programs, against the server of the package.
# installed COMMAND...: nothing of the source tree or of this machine's own installation.
installed() {
  (cd "$folder" && env -u GROUNDLOCK_TOKEN PATH="$folder/root/usr/bin:$PATH" \
    PYTHONPATH="$folder/root/usr/lib/python3/dist-packages" PYTHONDONTWRITEBYTECODE=1 "$@")
}
installed groundlock simulate yard occlusion --out "$folder/yard" --size 480x270 --frames 6 >/dev/null
ffmpeg -v error -i "$folder/yard/occlusion.mp4" -q:v 2 "$folder/yard/%03d.jpg"
box=$(cat "$folder/yard/occlusion_init_box.txt")
# Not by installed(): what is ended has to be the server itself, and no shell around it.
env -u GROUNDLOCK_TOKEN "$folder/root/usr/bin/groundlock-server" --listen 127.0.0.1:0 --metrics "" \
  --store "$folder/store" --port-file "$folder/port" >"$folder/server.log" 2>&1 &
server=$!
end() {
  kill "$server" 2>/dev/null || true
  wait "$server" 2>/dev/null || true
  rm -rf "$folder"
}
trap end EXIT
for _ in $(seq 600); do
  if [ -s "$folder/port" ]; then break; fi
  kill -0 "$server" 2>/dev/null || { cat "$folder/server.log" >&2; fail "the installed server ended"; }
  sleep 0.1
done
address=127.0.0.1:$(cat "$folder/port")

example=$folder/root/usr/share/doc/libgroundlock-dev/examples/track_images
cmake -S "$example" -B "$folder/consumer" -DCMAKE_PREFIX_PATH="$folder/root/usr" -DCMAKE_BUILD_TYPE=Release \
  -DCMAKE_CXX_FLAGS="-Wall -Wextra -Werror" >"$folder/log" 2>&1 &&
  cmake --build "$folder/consumer" >>"$folder/log" 2>&1 || { cat "$folder/log" >&2; fail "find_package(Groundlock)"; }
PKG_CONFIG_PATH=$(echo "$folder"/root/usr/lib/*/pkgconfig)
export PKG_CONFIG_PATH
read -ra flags <<<"$(pkg-config --cflags --libs groundlock)"
"${CXX:-c++}" -std=c++20 -O1 "$example/track_images.cc" -o "$folder/consumer/by_pkg_config" "${flags[@]}" >"$folder/log" 2>&1 ||
  { cat "$folder/log" >&2; fail "pkg-config groundlock"; }
# The lines of docs/cpp.md: of the example's CMakeLists.txt, and a program that compiles.
lines_of() { awk -v fence="\`\`\`$1" '$0 == fence { on = 1; next } /^```$/ { on = 0 } on' "$tree/docs/cpp.md"; }
lines_of cmake | while IFS= read -r line; do
  grep -qxF -- "$line" "$example/CMakeLists.txt" || fail "docs/cpp.md: the example has no line $line"
done
{
  printf '#include "client/sdk/client.h"\nvoid Example(groundlock::sdk::Frame frame) {\n'
  lines_of c++
  echo '}'
} >"$folder/page.cc"
grep -q Connect "$folder/page.cc" || fail "docs/cpp.md has no program"
"${CXX:-c++}" -std=c++20 -fsyntax-only -Wno-unused-result "$folder/page.cc" "${flags[@]}" >"$folder/log" 2>&1 ||
  { cat "$folder/log" >&2; fail "docs/cpp.md does not compile"; }

for program in track_images by_pkg_config; do
  installed "$folder/consumer/$program" "$address" - "$box" "$folder"/yard/00*.jpg >"$folder/tracked" ||
    fail "$program does not work"
  [ "$(grep -c ' target TRACKED box ' "$folder/tracked")" -eq 6 ] || { cat "$folder/tracked" >&2; fail "$program"; }
done
told=$(installed "$folder/consumer/track_images" 2>&1 || true)
[[ "$told" == *"Groundlock $version" ]] || fail "the C++ client is not $version: $told"
if installed "$folder/consumer/track_images" "$address" nowhere "$box" "$folder/yard/001.jpg" 2>"$folder/log" ||
    ! grep -q nowhere "$folder/log"; then
  fail "a map that is not there is not named"
fi

if /usr/bin/python3 -c 'import grpc, google.protobuf, numpy' 2>/dev/null; then
  installed /usr/bin/python3 - "$address" "$folder/yard/occlusion.mp4" "$box" <<'PYTHON' || fail "python3-groundlock"
import subprocess, sys
from importlib import metadata
import groundlock
from groundlock.v1 import tracking_pb2
root = groundlock.__file__
assert "/dist-packages/" in root and tracking_pb2.__file__.startswith(root.rsplit("/", 1)[0]), root
assert metadata.version("groundlock") == groundlock.__version__
assert groundlock.BUILD == subprocess.check_output(["groundlock", "--version"], text=True).strip(), groundlock.BUILD
address, video, box = sys.argv[1:]
run = groundlock.track(video, map=None, box=tuple(float(v) for v in box.split(",")), server=address)
states = [car.state for _, car in run.target()]
assert states == [groundlock.TargetState.TRACKED] * 6, states
PYTHON
else
  echo "python3-groundlock was not tried: Debian's python3-grpcio, python3-protobuf or python3-numpy is not installed"
fi
echo "packages: $(cd "$folder/first" && ls -- *.deb | tr '\n' ' ')are sound"
