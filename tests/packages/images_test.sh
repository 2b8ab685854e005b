#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes the images of deploy/docker from the packages of a finished build, on a
# base that debootstrap makes, and tracks a video through server and dashboard
# that run in them. Without a daemon: Debian's buildah.
#
#   tests/packages/images_test.sh BUILD_FOLDER
#
# Exits with 77 where it cannot run: without root, buildah or debootstrap.
set -euo pipefail
cd "$(dirname "$0")/../.."
build=$(realpath "${1:?the build folder}")
skip() { echo "SKIPPED: $*" >&2; exit 77; }
fail() { echo "FAILED: $*" >&2; exit 1; }
[ "$(id -u)" -eq 0 ] || skip "images are made by root alone here (chroot isolation)"
for program in buildah debootstrap; do
  command -v "$program" >/dev/null || skip "there is no $program (deploy/setup.sh images)"
done
start=$SECONDS
step() { printf '== %s (%d s so far)\n' "$1" $((SECONDS - start)); }
. tests/packages/debian_base.sh

folder=$(mktemp -d)
chmod 755 "$folder"
jobs_of_ours=()
buildah_() {
  buildah --root "$folder/storage" --runroot "$folder/run" --storage-driver vfs "$@"
}
cleanup() {
  local code=$?
  for pid in "${jobs_of_ours[@]}"; do kill -TERM "$pid" 2>/dev/null || true; done
  for pid in "${jobs_of_ours[@]}"; do wait "$pid" 2>/dev/null || true; done
  if [ "$code" -ne 0 ]; then tail -n 40 "$folder"/*.log >&2 || true; fi
  buildah_ rm --all >/dev/null 2>&1 || true
  rm -rf "$folder"
}
trap cleanup EXIT
# until_true WORDS COMMAND…: waits for a state, not for a time.
until_true() {
  local what=$1; shift
  for _ in $(seq 600); do
    if "$@" >/dev/null 2>&1; then return 0; fi
    sleep 0.2
  done
  fail "$what"
}

step "Packages"
context=$folder/context
mkdir -p "$context/deploy/docker"
cp deploy/docker/*.sh "$context/deploy/docker/"
make_packages "$build" "$context/out/packages" "$folder/cpack.log" || fail "cpack"

step "Base"
base=$(sed -n 's/^ARG BASE=//p' deploy/docker/Dockerfile)
make_debian "$folder/base" "$folder/debootstrap.log" || fail "debootstrap"
container=$(buildah_ from scratch)
buildah_ add "$container" "$folder/base" / >/dev/null
buildah_ commit --format docker --rm "$container" "docker.io/library/$base" >"$folder/commit.log" 2>&1 || fail "the base"
rm -rf "$folder/base"

for target in server dashboard; do
  step "Image: $target"
  buildah_ build --format docker --isolation chroot --network host --pull-never \
    --ignorefile deploy/docker/Dockerfile.dockerignore -f deploy/docker/Dockerfile \
    --target "$target" -t "localhost/groundlock-$target" "$context" >"$folder/$target.build.log" 2>&1 ||
    fail "the image $target"
  config() { buildah_ inspect --type image --format "{{.Docker.Config.$1}}" "localhost/groundlock-$target"; }
  [ "$(config User)" = groundlock ] || fail "$target runs as $(config User)"
  config Healthcheck.Test | grep -q healthcheck.sh || fail "$target has no health check"
done
server=$(buildah_ from --pull-never localhost/groundlock-server)
dashboard=$(buildah_ from --pull-never localhost/groundlock-dashboard)
# inside CONTAINER COMMAND…: as the image's user; /share is ours as well.
mkdir "$folder/share"
chmod 777 "$folder/share"
inside() {
  local container=$1; shift
  buildah_ run --isolation chroot --network host -v "$folder/share:/share" "$container" -- "$@"
}
[ "$(inside "$server" id -u)" = 10001 ] || fail "the server is not its own user"
for package in groundlock groundlock-server colmap libc6; do
  inside "$server" grep -qx "PackageName: $package" /usr/share/groundlock/sbom.spdx ||
    fail "the server's list of packages lacks $package"
done
inside "$dashboard" grep -qx "PackageName: groundlock-dashboard" /usr/share/groundlock/sbom.spdx ||
  fail "the dashboard's list of packages"

step "The server, in its image"
metrics_port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
inside "$server" groundlock-server --listen 127.0.0.1:0 --metrics "127.0.0.1:$metrics_port" \
  --store /share/store --port-file /share/port >"$folder/server.log" 2>&1 &
jobs_of_ours+=($!)
until_true "the server does not start" test -s "$folder/share/port"
address=127.0.0.1:$(cat "$folder/share/port")
healthy() {
  inside "$server" /usr/local/lib/groundlock/healthcheck.sh "$metrics_port" /metrics "groundlock_serving 1"
}
until_true "the server is not healthy" healthy
if inside "$server" /usr/local/lib/groundlock/healthcheck.sh "$metrics_port" /metrics "groundlock_serving 0" 2>/dev/null; then
  fail "the health check says yes to everything"
fi
inside "$server" groundlock simulate yard mapping --out /share/yard --size 480x270 >"$folder/simulate.log" 2>&1
inside "$server" groundlock simulate yard occlusion --out /share/yard --size 480x270 --frames 24 >>"$folder/simulate.log" 2>&1
inside "$server" groundlock map import yard /share/yard/map --align /share/yard/align.json \
  --server "$address" >"$folder/import.log" 2>&1
box=$(cat "$folder/share/yard/occlusion_init_box.txt")
inside "$server" groundlock track /share/yard/occlusion.mp4 --map yard --camera /share/yard/camera.json \
  --init-box "$box" --results /share/results.csv --server "$address" >"$folder/track.log" 2>&1
tracked=$(grep -c ',TRACKED,.*target,TRACKED' "$folder/share/results.csv" || true)
[ "$tracked" -ge 12 ] || fail "only $tracked of 24 frames were tracked"

step "The dashboard, in its image"
processed() { sed -n 's/^groundlock_frames_processed_total \([0-9]*\).*/\1/p' <(curl_metrics); }
curl_metrics() {
  python3 -c 'import sys, urllib.request as u; print(u.urlopen(sys.argv[1], timeout=30).read().decode())' \
    "http://127.0.0.1:$metrics_port/metrics"
}
before=$(processed)
IFS=, read -r x y width height <<<"$box"
cat >"$folder/share/start.json" <<JSON
{"source_id": "file:occlusion.mp4", "loop": true,
 "targets": [{"target_id": "car", "box": {"x": $x, "y": $y, "width": $width, "height": $height}}],
 "session": {"session_id": "images", "map_name": "yard", "options": {"flow_mode": "FLOW_MODE_LIVE"}}}
JSON
inside "$dashboard" groundlock-dashboard --listen 127.0.0.1:0 --server "$address" \
  --data /share/dashboard --sources /share/yard --start /share/start.json \
  --port-file /share/dashboard_port >"$folder/dashboard.log" 2>&1 &
jobs_of_ours+=($!)
until_true "the dashboard does not start" test -s "$folder/share/dashboard_port"
dashboard_port=$(cat "$folder/share/dashboard_port")
inside "$dashboard" /usr/local/lib/groundlock/healthcheck.sh "$dashboard_port" /healthz ok ||
  fail "the dashboard is not healthy"
inside "$dashboard" /usr/local/lib/groundlock/healthcheck.sh "$dashboard_port" / '<!doctype html>' ||
  inside "$dashboard" /usr/local/lib/groundlock/healthcheck.sh "$dashboard_port" / '<!DOCTYPE html>' ||
  fail "the dashboard has no page"
more() { [ "$(processed)" -ge $((before + 24)) ]; }
until_true "no frame goes through the dashboard" more
printf 'images: built and run in %d s\n' $((SECONDS - start))
