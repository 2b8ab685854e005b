#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Runs deploy/docker/compose.yaml by its own commands, as its first lines give them,
# with a Docker daemon in a network and a mount namespace of its own: tracks a video
# through what it starts, and starts the server anew. images_test.sh calls it:
#
#   unshare --mount --net --pid --fork --mount-proc tests/packages/compose.sh BUILD FOLDER
#
#   FOLDER/images/*.tar   the images groundlock, groundlock-dashboard, postgres:15
#   FOLDER/share/yard     a rendered yard with its sequence "occlusion"
# What differs from a user's way: the images are there already (the daemon has no way
# to a registry), and up goes on in the background.
set -euo pipefail
cd "$(dirname "$0")/../.."
build=$(realpath "$1")
folder=$(realpath "$2")
fail() { echo "FAILED: compose: $*" >&2; exit 1; }
until_true() {
  local what=$1; shift
  for _ in $(seq 600); do
    if "$@" >/dev/null 2>&1; then return 0; fi
    sleep 0.2
  done
  fail "$what"
}

ip link set lo up
export DOCKER_HOST=unix://$folder/docker/socket DOCKER_CONFIG=$folder/docker/config
mkdir -p "$folder/docker/config"
dockerd --data-root "$folder/docker/data" --exec-root "$folder/docker/exec" --pidfile "$folder/docker/pid" \
  --host "$DOCKER_HOST" >"$folder/dockerd.log" 2>&1 &
daemon=$!
compose=(docker-compose -f deploy/docker/compose.yaml)
cleanup() {
  local code=$?
  if [ "$code" -ne 0 ]; then (cd "$folder/tree" && "${compose[@]}" logs --no-color >"$folder/containers.log" 2>&1) || true; fi
  (cd "$folder/tree" && "${compose[@]}" down --volumes >"$folder/down.log" 2>&1) || true
  kill "$daemon" 2>/dev/null || true
  wait "$daemon" 2>/dev/null || true
  return "$code"
}
trap cleanup EXIT
until_true "no Docker daemon" docker version
for image in "$folder"/images/*.tar; do docker load -q -i "$image"; done >"$folder/load.log"

# The commands of compose.yaml itself, up to the last: what makes the images is left
# out, and there is nobody here to be another user than root.
mkdir -p "$folder/tree/deploy/docker"
cp deploy/docker/compose.yaml "$folder/tree/deploy/docker/"
cp deploy/certificates.sh "$folder/tree/deploy/"
sed -n 's/^#   //p' deploy/docker/compose.yaml |
  sed -e '/^deploy\/packages\.sh$/d' -e 's/\bsudo //' \
    -e 's/^docker compose \(.*\) up --build$/docker-compose \1 up --no-build --detach/' >"$folder/tree/commands.sh"
grep -q -- '--no-build --detach' "$folder/tree/commands.sh" || fail "its first lines do not start it"
sed '/^groundlock map list/,$d' "$folder/tree/commands.sh" >"$folder/tree/up.sh"
sed -n '/^groundlock map list/,$p' "$folder/tree/commands.sh" >"$folder/tree/list.sh"
PATH=$build/bin:$PATH
cd "$folder/tree"
bash -euo pipefail up.sh >"$folder/up.log" 2>&1 || fail "its own commands"
healthy() {
  [ "$(docker inspect --format '{{.State.Health.Status}}' "$("${compose[@]}" ps -q "$1")")" = healthy ]
}
for service in postgres server dashboard; do until_true "$service is not healthy" healthy "$service"; done
bash -euo pipefail list.sh >"$folder/list.log" 2>&1 || fail "its last command"

as_ops=(--server grpcs://localhost:50551 --ca deploy/docker/secrets/ca.pem --token-file deploy/docker/secrets/ops.token)
yard=$folder/share/yard
groundlock map import yard "$yard/map" --align "$yard/align.json" "${as_ops[@]}" >"$folder/import.log" 2>&1 || fail "import"
track() {
  groundlock track "$yard/occlusion.mp4" --map yard --camera "$yard/camera.json" \
    --init-box "$(cat "$yard/occlusion_init_box.txt")" --results "$folder/compose.csv" "${as_ops[@]}" \
    >"$folder/track.log" 2>&1 || fail "track"
  local tracked
  tracked=$(grep -c ',TRACKED,.*target,TRACKED' "$folder/compose.csv" || true)
  [ "$tracked" -ge 12 ] || fail "only $tracked frames were tracked"
}
track
[ "$("${compose[@]}" exec -T postgres psql -U groundlock -Atc 'SELECT count(*) FROM groundlock.maps')" = 1 ] ||
  fail "the map is not in the database"
for service in server dashboard; do
  [ "$("${compose[@]}" exec -T "$service" id -u)" = 10001 ] || fail "$service is not its own user"
  if "${compose[@]}" exec -T "$service" touch /usr/written 2>/dev/null; then fail "$service may write to its image"; fi
done

# The person logs in at the dashboard with the token of which the first lines speak.
python3 - deploy/docker/secrets <<'PYTHON' || fail "nobody can log in at the dashboard"
import json, ssl, sys, urllib.request as u
context = ssl.create_default_context(cafile=f"{sys.argv[1]}/ca.pem")
address = "https://localhost:8080"
assert b"<!doctype html>" in u.urlopen(address, timeout=30, context=context).read().lower()
token = open(f"{sys.argv[1]}/ops.token").read().strip()
u.urlopen(u.Request(address + "/api/login", json.dumps({"token": token}).encode(),
                    {"Origin": address, "Content-Type": "application/json"}), timeout=30, context=context)
PYTHON

# A container that is lost: the next one has the same maps.
docker rm --force "$("${compose[@]}" ps -q server)" >/dev/null
"${compose[@]}" up --no-build --detach >"$folder/again.log" 2>&1 || fail "up again"
until_true "the new server is not healthy" healthy server
track
echo "compose: postgres, server and dashboard run by compose.yaml's own commands"
