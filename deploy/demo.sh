#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The whole way, on any Debian 12 machine: builds Groundlock, renders a yard
# with two cars that drive laps, starts a server, imports the map, and tracks them
# in 3D, also while one is behind an obstacle and while both are out of view: by
# TLS and with tokens, as for a server that others reach.
#
#   deploy/demo.sh [--out FOLDER] [--serve|--no-serve]     default: out/demo
#
# Leaves FOLDER/results.csv, FOLDER/overlay.mp4, FOLDER/overlay.png, and ends with
# the dashboard's address, at which the car drives on and on. With --serve (the
# default on a terminal) it stays up until Ctrl-C; with --no-serve it is checked
# and stopped.
set -euo pipefail
cd "$(dirname "$0")/.."

out=out/demo
if [ -t 1 ]; then serve=yes; else serve=no; fi
while [ $# -gt 0 ]; do
  case "$1" in
    --out) out=${2:?--out needs a folder}; shift 2 ;;
    --serve) serve=yes; shift ;;
    --no-serve) serve=no; shift ;;
    *) sed -n '3,13p' "$0" >&2; exit 2 ;;
  esac
done

deploy/setup.sh build
# What only tests need is neither installed nor looked for.
if [ ! -f build/CMakeCache.txt ]; then
  cmake --preset release -DGROUNDLOCK_TESTS=OFF -DGROUNDLOCK_BENCHMARKS=OFF >/dev/null
fi
cmake --build build --target groundlock groundlock-server groundlock-dashboard
# The page needs node; everything else goes without.
if command -v npm >/dev/null; then cmake --build build --target groundlock_web; fi

start=$SECONDS
say() { printf '\n== %s\n' "$*"; }
mkdir -p "$out"
bin=build/bin
server_pid=
dashboard_pid=
cleanup() {
  if [ -n "$dashboard_pid" ]; then
    kill -TERM "$dashboard_pid" 2>/dev/null || true
    wait "$dashboard_pid" 2>/dev/null || true
  fi
  if [ -n "$server_pid" ]; then
    kill -TERM "$server_pid" 2>/dev/null || true
    wait "$server_pid" 2>/dev/null || true
  fi
}
trap cleanup EXIT

say "Rendering the yard and its map"
"$bin/groundlock" simulate yard mapping --out "$out/yard"
say "Rendering the sequence: two cars drive laps, one of them behind an obstacle"
"$bin/groundlock" simulate yard laps --out "$out/yard"

# As a server is run that others reach: by TLS, with an authority of its own, and
# asking everybody who they are. The dashboard has an identity of its own, which
# may look on and feed its own session; the viewer acts by another one.
say "Starting the server"
rm -rf "$out/store" "$out/port" "$out/secrets"
deploy/certificates.sh "$out/secrets" >"$out/certificates.log" 2>&1 || {
  cat "$out/certificates.log" >&2
  exit 1
}
new_token() {  # NAME SCOPES
  (umask 077; "$bin/groundlock" token create --file "$out/secrets/tokens" --scopes "$2" "$1" \
    2>>"$out/certificates.log" >"$out/secrets/$1.token")
}
new_token viewer admin
new_token dashboard maps:read,sessions:watch,sessions:own
"$bin/groundlock-server" --listen 127.0.0.1:0 --metrics "" --store "$out/store" \
  --tls-cert "$out/secrets/server.pem" --tls-key "$out/secrets/server.key" \
  --token-file "$out/secrets/tokens" \
  --port-file "$out/port" >"$out/server.log" 2>&1 &
server_pid=$!
for _ in $(seq 100); do
  [ -s "$out/port" ] && break
  kill -0 "$server_pid" 2>/dev/null || { cat "$out/server.log" >&2; exit 1; }
  sleep 0.1
done
server=grpcs://127.0.0.1:$(cat "$out/port")
as_viewer=(--server "$server" --ca "$out/secrets/ca.pem" --token-file "$out/secrets/viewer.token")
echo "groundlock-server listens on $server"

say "Importing the map"
"$bin/groundlock" map import yard "$out/yard/map" --align "$out/yard/align.json" \
  "${as_viewer[@]}"

say "Tracking both cars"
init_box=$(cat "$out/yard/laps_init_box.txt")
other_init_box=$(cat "$out/yard/laps_other_init_box.txt")
"$bin/groundlock" track "$out/yard/laps.mp4" --map yard \
  --camera "$out/yard/camera.json" --target "car:$init_box" --target "other:$other_init_box" \
  --results "$out/results.csv" --overlay "$out/overlay.mp4" "${as_viewer[@]}"

# A picture from the middle of the occlusion: the predicted box stands behind
# the obstacle.
ffmpeg -v error -y -i "$out/overlay.mp4" \
  -vf "select=eq(n\,$(tests/eval/hidden_frame.py "$out/results.csv" car))" \
  -frames:v 1 "$out/overlay.png"

# The dashboard plays the sequence again and again, with both cars marked: it ends
# where it begins.
say "Starting the dashboard"
port=0
if [ "$serve" = yes ]; then port=8080; fi
marked() {  # NAME X,Y,W,H
  IFS=, read -r x y width height <<<"$2"
  echo "{\"target_id\": \"$1\", \"box\": {\"x\": $x, \"y\": $y, \"width\": $width, \"height\": $height}}"
}
cat >"$out/start.json" <<JSON
{"source_id": "file:laps.mp4", "loop": true,
 "targets": [$(marked car "$init_box"), $(marked other "$other_init_box")],
 "session": {"session_id": "demo", "map_name": "yard",
             "options": {"flow_mode": "FLOW_MODE_LIVE", "report_matches": true}}}
JSON
rm -f "$out/dashboard_port"
start_dashboard() {
  "$bin/groundlock-dashboard" --listen "127.0.0.1:$port" --server "$server" \
    --ca "$out/secrets/ca.pem" --token-file "$out/secrets/dashboard.token" \
    --data "$out/dashboard" --sources "$out/yard" --start "$out/start.json" \
    --port-file "$out/dashboard_port" >"$out/dashboard.log" 2>&1 &
  dashboard_pid=$!
  for _ in $(seq 100); do
    [ -s "$out/dashboard_port" ] && return 0
    kill -0 "$dashboard_pid" 2>/dev/null || break
    sleep 0.1
  done
  dashboard_pid=
  return 1
}
start_dashboard || { port=0; start_dashboard; } || { cat "$out/dashboard.log" >&2; exit 1; }
dashboard=http://127.0.0.1:$(cat "$out/dashboard_port")
# fetch PATH: what the dashboard answers.
fetch() {
  python3 -c 'import sys, urllib.request as u; sys.stdout.buffer.write(u.urlopen(sys.argv[1], timeout=10).read())' \
    "$dashboard$1"
}
fetch /healthz >/dev/null
# The viewer may log in, and sees what the dashboard has started by itself.
python3 - "$dashboard" "$out/secrets/viewer.token" <<'PYTHON'
import json, sys, time, urllib.error, urllib.request as u
address, token = sys.argv[1], open(sys.argv[2]).read().strip()
try:
    u.urlopen(address + "/api/sessions/demo/trajectory", timeout=10)
    sys.exit("the dashboard asks nobody who they are")
except urllib.error.HTTPError as error:
    if error.code != 401: sys.exit(f"without a token: {error}")
for _ in range(300):
    try:
        login = u.Request(address + "/api/login", json.dumps({"token": token}).encode(),
                          {"Origin": address, "Content-Type": "application/json"})
        u.urlopen(login, timeout=10)
        break
    except urllib.error.HTTPError as error:
        if error.code != 503: sys.exit(f"the viewer cannot log in: {error}: {error.read()}")
        time.sleep(0.1)
else:
    sys.exit("the dashboard does not reach the server")
PYTHON
if [ -f build/share/groundlock/web/index.html ]; then
  fetch / >"$out/page.html"
  grep -qi '<html' "$out/page.html"
fi

say "Done in $((SECONDS - start)) s after the build"
echo "results   $out/results.csv"
echo "overlay   $out/overlay.mp4  (picture: $out/overlay.png)"
echo "dashboard $dashboard"
echo "          log in with $(cat "$out/secrets/viewer.token")"
if [ "$serve" = yes ]; then
  echo "          open it in a browser; Ctrl-C ends the demo"
  wait "$dashboard_pid" || true
fi
