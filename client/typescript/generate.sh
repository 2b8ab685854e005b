#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Generates the messages from proto/groundlock into src/gen. protobuf-es, as
# for the dashboard's page: they are typed and compiled in, so that who installs
# the package needs neither protoc nor the .proto files. Beside them goes which
# build of the package this is.
set -euo pipefail
cd "$(dirname "$0")"
root=../../proto
protoc=${PROTOC:-protoc}
mapfile -t files < <(cd "$root" && find groundlock -name '*.proto' | sort)
newest=$(ls -t "${files[@]/#/$root/}" generate.sh package-lock.json | head -1)
if [ ! -f src/gen/.stamp ] || [ "$newest" -nt src/gen/.stamp ]; then
  rm -rf src/gen && mkdir -p src/gen
  "$protoc" -I "$root" --plugin=protoc-gen-es=node_modules/.bin/protoc-gen-es \
    --es_out=src/gen --es_opt=target=ts,import_extension=js "${files[@]}"
  touch src/gen/.stamp
fi

# Without a repository the version alone; "+" after the commit: the tree had changes.
version=$(node -p 'require("./package.json").version')
commit=$(git describe --always --abbrev=12 --exclude='*' --dirty=+ 2>/dev/null || true)
cat >src/gen/build.ts <<TYPESCRIPT
/** The version of this package. */
export const VERSION = "$version";
/** The same with the commit of which it was made: "0.1.0 (1a2b3c4d5e6f)". */
export const BUILD = "$version${commit:+ ($commit)}";
TYPESCRIPT
