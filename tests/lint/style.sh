#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Fails on files that clang-format 14 would change, on files without a licence
# line, and on public headers without an include guard of our form.
set -euo pipefail
cd "$(dirname "$0")/../.."
failures=0
mapfile -t sources < <(find map_store server client tests -name '*.h' -o -name '*.cc' -o -name '*.inc' | sort)
if ! clang-format-14 --dry-run --Werror "${sources[@]}"; then
  echo "style: run clang-format-14 -i on the files above" >&2
  failures=1
fi
for file in "${sources[@]}"; do
  if [ "$(head -1 "$file")" != "// SPDX-License-Identifier: Apache-2.0" ]; then
    echo "style: $file: the first line is not the SPDX licence line" >&2
    failures=1
  fi
  if [[ $file == *.h ]]; then
    guard="GROUNDLOCK_$(echo "${file%.h}_H_" | tr '[:lower:]/.-' '[:upper:]___')"
    if ! grep -q "^#ifndef $guard\$" "$file"; then
      echo "style: $file: the include guard is not $guard" >&2
      failures=1
    fi
  fi
done
# Compilers differ in which argument they draw first; in braces the order is fixed.
drawn='[A-Za-z0-9_]\([\w.+*\s-]*\b(\w+)\((random_?|generator_?|engine_?)\)[^;{}]*?,[^;{}]*?\b\1\(\2\)'
if grep -Pzl "$drawn" "${sources[@]}"; then
  echo "style: the files above draw random numbers twice in a list of arguments" >&2
  failures=1
fi
if [ "$failures" -ne 0 ]; then exit 1; fi
echo "style: ${#sources[@]} files are in order"
