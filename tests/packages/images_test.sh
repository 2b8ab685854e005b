#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes the images of deploy/docker from the packages of a finished build, on a
# base that debootstrap makes, and tracks a video through server and dashboard
# that run in them as compose.yaml runs them: by TLS, with tokens, and with maps in
# PostgreSQL. Without a daemon: Debian's buildah. Where a Docker daemon can be run,
# compose.yaml itself is, too (compose.sh).
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
store=(--root "$folder/storage" --runroot "$folder/run" --storage-driver vfs)
buildah_() { buildah "${store[@]}" "$@"; }
end_jobs() {
  for pid in "${jobs_of_ours[@]}"; do kill -TERM "$pid" 2>/dev/null || true; done
  for pid in "${jobs_of_ours[@]}"; do wait "$pid" 2>/dev/null || true; done
  jobs_of_ours=()
}
cleanup() {
  local code=$?
  end_jobs
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
in_container=(run --isolation chroot --network host -v "$folder/share:/share")
inside() {
  local container=$1; shift
  buildah_ "${in_container[@]}" "$container" -- "$@"
}
# start LOG CONTAINER COMMAND…: in the background. The job is buildah itself, which
# passes on the signal that ends it, and no shell around it.
start_inside() {
  local log=$1 container=$2; shift 2
  (exec buildah "${store[@]}" "${in_container[@]}" "$container" -- "$@") >"$log" 2>&1 &
  jobs_of_ours+=($!)
}
[ "$(inside "$server" id -u)" = 10001 ] || fail "the server is not its own user"
for package in groundlock groundlock-server colmap libc6; do
  inside "$server" grep -qx "PackageName: $package" /usr/share/groundlock/sbom.spdx ||
    fail "the server's list of packages lacks $package"
done
inside "$dashboard" grep -qx "PackageName: groundlock-dashboard" /usr/share/groundlock/sbom.spdx ||
  fail "the dashboard's list of packages"

step "What compose.yaml gives them: certificates, tokens, a database"
free_port() {
  python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])'
}
grpc_port=$(free_port) metrics_port=$(free_port) page_port=$(free_port) page_metrics_port=$(free_port)
database_port=$(free_port)
secrets=$folder/secrets
deploy/certificates.sh "$secrets" server.example >"$folder/certificates.log" 2>&1 || fail "certificates"
(
  umask 077
  "$build/bin/groundlock" token create --file "$secrets/tokens" --scopes admin ops >"$secrets/ops.token"
  # Of one that may only look on it would be known as well; here it feeds a session of its own.
  "$build/bin/groundlock" token create --file "$secrets/tokens" \
    --scopes maps:read,sessions:watch,sessions:own dashboard >"$secrets/dashboard.token"
) 2>"$folder/tokens.log" || fail "tokens"
chown 10001 "$secrets"/{server.key,tokens,dashboard.token}
in_container+=(-v "$secrets:/run/secrets")
ops=$(cat "$secrets/ops.token")

# Of compose.yaml's own services all but the database run in their images; it is this machine's.
programs=$(echo /usr/lib/postgresql/*/bin | tr ' ' '\n' | tail -n 1)
[ -x "$programs/initdb" ] || skip "there is no PostgreSQL (deploy/setup.sh)"
mkdir "$folder/database"
chown postgres "$folder/database"
as_postgres() { setpriv --reuid postgres --regid postgres --clear-groups -- "$@"; }
as_postgres "$programs/initdb" -D "$folder/database/data" --auth=trust --username=groundlock --encoding=UTF8 \
  --locale=C --no-sync >"$folder/initdb.log" 2>&1 || fail "initdb"
(exec setpriv --reuid postgres --regid postgres --clear-groups --pdeathsig QUIT -- "$programs/postgres" \
  -D "$folder/database/data" -p "$database_port" -k "$folder/database" -c listen_addresses=127.0.0.1) \
  >"$folder/postgres.log" 2>&1 &
jobs_of_ours+=($!)
until_true "no database" as_postgres "$programs/pg_isready" -h 127.0.0.1 -p "$database_port"
as_postgres "$programs/createdb" -h 127.0.0.1 -p "$database_port" -U groundlock groundlock

# composed SERVICE KEY: the words of compose.yaml, a line each, with the ports and names that they have here.
composed() {
  /usr/bin/python3 - "$1" "$2" "$grpc_port" "$metrics_port" "$page_port" "$page_metrics_port" "$database_port" <<'PYTHON'
import sys, yaml
service, key, grpc, metrics, page, page_metrics, database = sys.argv[1:]
value = yaml.safe_load(open("deploy/docker/compose.yaml"))["services"][service]
for name in key.split("."):
    value = value[name]
for word in value if isinstance(value, list) else [value]:
    for there, here in (("0.0.0.0:50551", f"127.0.0.1:{grpc}"), ("0.0.0.0:9464", f"127.0.0.1:{metrics}"),
                        ("0.0.0.0:8080", f"127.0.0.1:{page}"), ("0.0.0.0:9465", f"127.0.0.1:{page_metrics}"),
                        ("server:50551", f"127.0.0.1:{grpc}"), ("postgres:5432", f"127.0.0.1:{database}")):
        word = word.replace(there, here)
    print(page_metrics if word == "9465" else word)
PYTHON
}

step "The server, in its image"
mapfile -t arguments < <(composed server command)
[ ${#arguments[@]} -ge 6 ] || fail "compose.yaml's server has no command"
start_inside "$folder/server.log" "$server" env GROUNDLOCK_STORE="$(composed server environment.GROUNDLOCK_STORE)" \
  groundlock-server "${arguments[@]}"
healthy() {
  inside "$server" /usr/local/lib/groundlock/healthcheck.sh "$metrics_port" /metrics "groundlock_serving 1"
}
until_true "the server is not healthy" healthy
if inside "$server" /usr/local/lib/groundlock/healthcheck.sh "$metrics_port" /metrics "groundlock_serving 0" 2>/dev/null; then
  fail "the health check says yes to everything"
fi
inside "$server" groundlock simulate yard mapping --out /share/yard --size 480x270 >"$folder/simulate.log" 2>&1
inside "$server" groundlock simulate yard occlusion --out /share/yard --size 480x270 --frames 24 >>"$folder/simulate.log" 2>&1
groundlock_inside() {
  inside "$server" env GROUNDLOCK_TOKEN="$ops" groundlock "$@" --server "grpcs://localhost:$grpc_port" --ca /run/secrets/ca.pem
}
if inside "$server" groundlock map list --server "grpcs://localhost:$grpc_port" --ca /run/secrets/ca.pem \
    >"$folder/stranger.log" 2>&1; then
  fail "the server asks nobody who they are"
fi
groundlock_inside map import yard /share/yard/map --align /share/yard/align.json >"$folder/import.log" 2>&1
box=$(cat "$folder/share/yard/occlusion_init_box.txt")
groundlock_inside track /share/yard/occlusion.mp4 --map yard --camera /share/yard/camera.json \
  --init-box "$box" --results /share/results.csv >"$folder/track.log" 2>&1
tracked=$(grep -c ',TRACKED,.*target,TRACKED' "$folder/share/results.csv" || true)
[ "$tracked" -ge 12 ] || fail "only $tracked of 24 frames were tracked"
[ "$(as_postgres "$programs/psql" -h 127.0.0.1 -p "$database_port" -U groundlock -Atc 'SELECT count(*) FROM groundlock.maps')" = 1 ] ||
  fail "the map is not in the database"

step "The dashboard, in its image"
fetch() {
  python3 -c 'import ssl, sys, urllib.request as u
print(u.urlopen(sys.argv[1], timeout=30, context=ssl.create_default_context(cafile=sys.argv[2])).read().decode())' \
    "$1" "$secrets/ca.pem"
}
processed() { sed -n 's/^groundlock_frames_processed_total \([0-9]*\).*/\1/p' <(fetch "http://127.0.0.1:$metrics_port/metrics"); }
before=$(processed)
IFS=, read -r x y width height <<<"$box"
cat >"$folder/share/start.json" <<JSON
{"source_id": "file:occlusion.mp4", "loop": true,
 "targets": [{"target_id": "car", "box": {"x": $x, "y": $y, "width": $width, "height": $height}}],
 "session": {"session_id": "images", "map_name": "yard", "options": {"flow_mode": "FLOW_MODE_LIVE"}}}
JSON
mapfile -t arguments < <(composed dashboard command)
start_inside "$folder/dashboard.log" "$dashboard" groundlock-dashboard "${arguments[@]}" \
  --sources /share/yard --start /share/start.json
mapfile -t check < <(composed dashboard healthcheck.test)
until_true "the dashboard is not healthy" inside "$dashboard" "${check[@]:1}"
fetch "https://localhost:$page_port/" | grep -qi '^<!doctype html>' || fail "the dashboard has no page"
more() { [ "$(processed)" -ge $((before + 24)) ]; }
until_true "no frame goes through the dashboard" more
end_jobs

# Compose itself needs a daemon, which not every machine can run.
if command -v dockerd >/dev/null && command -v docker-compose >/dev/null && unshare --mount --net true 2>/dev/null; then
  step "compose.yaml, by its own commands and a daemon of its own"
  database=$(buildah_ from --pull-never "docker.io/library/$base")
  buildah_ run --isolation chroot --network host "$database" -- sh -c \
    'apt-get update -q && apt-get install -y -q --no-install-recommends postgresql-15 && rm -rf /var/lib/apt/lists/*' \
    >"$folder/postgres.build.log" 2>&1 || fail "the image of PostgreSQL"
  buildah_ copy "$database" tests/packages/postgres_entrypoint.sh /usr/local/bin/ >/dev/null
  buildah_ config --entrypoint '["/usr/local/bin/postgres_entrypoint.sh"]' --cmd '' \
    --env PATH=/usr/lib/postgresql/15/bin:/usr/sbin:/usr/bin:/sbin:/bin "$database"
  buildah_ commit --format docker --rm "$database" docker.io/library/postgres:15 >"$folder/commit.log" 2>&1 ||
    fail "the image of PostgreSQL"
  mkdir "$folder/images"
  for image in localhost/groundlock-server=groundlock:latest localhost/groundlock-dashboard=groundlock-dashboard:latest \
      docker.io/library/postgres:15=postgres:15; do
    name=${image#*=}
    buildah_ push --format docker "${image%=*}" "docker-archive:$folder/images/${name%:*}.tar:docker.io/library/$name" \
      >"$folder/push.log" 2>&1 || fail "the image $name for the daemon"
  done
  unshare --mount --net --pid --fork --kill-child --mount-proc tests/packages/compose.sh "$build" "$folder"
else
  echo "compose.yaml was not run: there is no dockerd or docker-compose (deploy/setup.sh images), or no namespace" >&2
fi
printf 'images: built and run in %d s\n' $((SECONDS - start))
