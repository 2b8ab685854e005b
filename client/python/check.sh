#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs the Python client as a user would, into BUILD/python/site, and checks
# it: types by mypy, behaviour by pytest against the real programs in BUILD/bin.
#
#   client/python/check.sh [BUILD] [PYTEST ARGUMENTS]     default: build
#
# Exits 77 (skipped) if Debian's packages (deploy/setup.sh) or the programs are
# missing. PYTHON names another interpreter.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(realpath "$here/../..")
build=$(realpath "${1:-$root/build}")
shift || true
work=$build/python
export GROUNDLOCK_BIN=${GROUNDLOCK_BIN:-$build/bin}
export GROUNDLOCK_DATA=${GROUNDLOCK_DATA:-$(realpath -m "$root/../shared/data")}
export GROUNDLOCK_SCRATCH=$work PYTHONDONTWRITEBYTECODE=1
unset GROUNDLOCK_TOKEN

skip() { echo "SKIPPED: $1"; exit 77; }
needed="import grpc, google.protobuf, numpy, pandas, zstandard, setuptools, wheel, pip, pytest, mypy"
python=
# The packages are those of Debian's python3; another one may come first.
for candidate in ${PYTHON:-python3 /usr/bin/python3}; do
  if "$candidate" -c "$needed" 2>/dev/null; then python=$candidate; break; fi
done
[ -n "$python" ] || skip "no python3 with what '$needed' asks for: deploy/setup.sh installs it"
for program in protoc ffmpeg openssl; do
  command -v "$program" >/dev/null || skip "$program is not installed"
done
for program in groundlock-server groundlock; do
  [ -x "$GROUNDLOCK_BIN/$program" ] || skip "$program is not built"
done

# From a copy: building leaves files beside the sources.
rm -rf "$work/source" "$work/site"
mkdir -p "$work/source/client"
cp -r "$here" "$work/source/client/python"
cp -r "$root/proto" "$work/source/proto"
rm -rf "$work/source/client/python/"{build,groundlock/v1}
# Which build the tests are to find: of a clone that with its commit. Said here,
# for the clone may get another commit while they run.
GROUNDLOCK_COMMIT=$(git -C "$root" describe --always --abbrev=12 --exclude='*' --dirty=+ 2>/dev/null || true)
export GROUNDLOCK_COMMIT
"$python" -m pip install --quiet --no-build-isolation --no-index --no-deps \
  --disable-pip-version-check --root-user-action=ignore \
  --target "$work/site" "$work/source/client/python"

cd "$work"
export PYTHONPATH=$work/site MYPYPATH=$work/site
"$python" -m mypy --config-file "$here/pyproject.toml" --cache-dir "$work/mypy" \
  site/groundlock "$here/examples"
exec "$python" -m pytest -q -p no:cacheprovider -c "$here/pyproject.toml" \
  --rootdir "$here" "$here/tests" "$@"
