#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Generates TypeScript messages from proto/ into src/gen.
set -euo pipefail
cd "$(dirname "$0")"
root=../../..
protoc=${PROTOC:-protoc}
mkdir -p src/gen
mapfile -t files < <(cd "$root/proto" && find groundlock -name '*.proto' | sort)
newest=$(ls -t "${files[@]/#/$root/proto/}" generate.sh package-lock.json | head -1)
if [ -f src/gen/.stamp ] && [ ! "$newest" -nt src/gen/.stamp ]; then exit 0; fi
rm -rf src/gen && mkdir -p src/gen
"$protoc" -I "$root/proto" --plugin=protoc-gen-es=node_modules/.bin/protoc-gen-es \
  --es_out=src/gen --es_opt=target=ts,import_extension=none "${files[@]}"
touch src/gen/.stamp
