#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Generates the messages from proto/groundlock into src/gen. protobuf-es, as
# for the dashboard's page: they are typed and compiled in, so that who installs
# the package needs neither protoc nor the .proto files.
set -euo pipefail
cd "$(dirname "$0")"
root=../../proto
protoc=${PROTOC:-protoc}
mapfile -t files < <(cd "$root" && find groundlock -name '*.proto' | sort)
newest=$(ls -t "${files[@]/#/$root/}" generate.sh package-lock.json | head -1)
if [ -f src/gen/.stamp ] && [ ! "$newest" -nt src/gen/.stamp ]; then exit 0; fi
rm -rf src/gen && mkdir -p src/gen
"$protoc" -I "$root" --plugin=protoc-gen-es=node_modules/.bin/protoc-gen-es \
  --es_out=src/gen --es_opt=target=ts,import_extension=js "${files[@]}"
touch src/gen/.stamp
