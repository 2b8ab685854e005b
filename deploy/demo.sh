#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The whole way, on any Debian 12 machine: builds Groundlock, renders a yard
# with a car that drives behind an obstacle, starts a server, imports the map,
# and tracks the car in 3D through the occlusion.
#
#   deploy/demo.sh [--out FOLDER]     default: out/demo
#
# Leaves FOLDER/results.csv, FOLDER/overlay.mp4, FOLDER/overlay.png.
set -euo pipefail
cd "$(dirname "$0")/.."

out=out/demo
while [ $# -gt 0 ]; do
  case "$1" in
    --out) out=${2:?--out needs a folder}; shift 2 ;;
    *) sed -n '3,9p' "$0" >&2; exit 2 ;;
  esac
done

deploy/setup.sh
if [ ! -f build/CMakeCache.txt ]; then cmake --preset release >/dev/null; fi
cmake --build build --target groundlock groundlock-server

start=$SECONDS
say() { printf '\n== %s\n' "$*"; }
mkdir -p "$out"
bin=build/bin
server_pid=
cleanup() {
  if [ -n "$server_pid" ]; then
    kill -TERM "$server_pid" 2>/dev/null || true
    wait "$server_pid" 2>/dev/null || true
  fi
}
trap cleanup EXIT

say "Rendering the yard and its map"
"$bin/groundlock" simulate yard mapping --out "$out/yard"
say "Rendering the sequence: a car drives behind an obstacle"
"$bin/groundlock" simulate yard occlusion --out "$out/yard"

say "Starting the server"
rm -rf "$out/store" "$out/port"
"$bin/groundlock-server" --listen 127.0.0.1:0 --metrics "" --store "$out/store" \
  --port-file "$out/port" >"$out/server.log" 2>&1 &
server_pid=$!
for _ in $(seq 100); do
  [ -s "$out/port" ] && break
  kill -0 "$server_pid" 2>/dev/null || { cat "$out/server.log" >&2; exit 1; }
  sleep 0.1
done
server=127.0.0.1:$(cat "$out/port")
echo "groundlock-server listens on $server"

say "Importing the map"
"$bin/groundlock" map import yard "$out/yard/map" --align "$out/yard/align.json" \
  --server "$server"

say "Tracking the car"
init_box=$(cat "$out/yard/occlusion_init_box.txt")
"$bin/groundlock" track "$out/yard/occlusion.mp4" --map yard \
  --camera "$out/yard/camera.json" --init-box "$init_box" \
  --results "$out/results.csv" --overlay "$out/overlay.mp4" --server "$server"

# A picture from the middle of the occlusion: the predicted box stands behind
# the obstacle.
ffmpeg -v error -y -i "$out/overlay.mp4" \
  -vf "select=eq(n\,$(tests/eval/hidden_frame.py "$out/results.csv"))" \
  -frames:v 1 "$out/overlay.png"

say "Done in $((SECONDS - start)) s after the build"
echo "results   $out/results.csv"
echo "overlay   $out/overlay.mp4  (picture: $out/overlay.png)"
