#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What the image postgres:15 does when it starts, as far as compose.yaml relies on
# it, for an image of Debian's PostgreSQL: images_test.sh reaches no registry.
set -euo pipefail
data=/var/lib/postgresql/data
programs=/usr/lib/postgresql/15/bin
as_postgres=(setpriv --reuid postgres --regid postgres --clear-groups --)
chown postgres:postgres "$data"
if [ ! -s "$data/PG_VERSION" ]; then
  password=$(mktemp)
  printf '%s\n' "$POSTGRES_PASSWORD" >"$password"
  chown postgres "$password"
  "${as_postgres[@]}" "$programs/initdb" -D "$data" --username="$POSTGRES_USER" --encoding=UTF8 --locale=C \
    --auth-local=trust --auth-host=scram-sha-256 --pwfile="$password"
  rm "$password"
  echo "host all all all scram-sha-256" >>"$data/pg_hba.conf"
  echo "CREATE DATABASE \"$POSTGRES_DB\"" | "${as_postgres[@]}" "$programs/postgres" --single -D "$data" postgres
fi
mkdir -p /var/run/postgresql
chown postgres:postgres /var/run/postgresql
exec "${as_postgres[@]}" "$programs/postgres" -D "$data" -c "listen_addresses=*"
