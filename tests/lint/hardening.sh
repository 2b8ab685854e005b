#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Whether the programs that are there are hardened as they are built to be: code
# at addresses that differ from run to run, stacks that are guarded and hold no
# code, tables of functions that nothing can overwrite, copies that are checked.
#
#   tests/lint/hardening.sh BIN     BIN: where the programs are
set -euo pipefail
bin=$(cd "$1" && pwd)
if readelf --dyn-syms -W "$bin/groundlock-server" | grep -E "__(asan|tsan)_init" >/dev/null; then
  echo "hardening: SKIPPED, sanitizers bring their own" >&2
  exit 77
fi
failures=0
# expect PROGRAM WHAT PATTERN READELF-OPTIONS...: what readelf says has the pattern.
expect() {
  local program=$1 what=$2 pattern=$3
  shift 3
  if ! readelf -W "$@" "$bin/$program" | grep -E "$pattern" >/dev/null; then
    echo "hardening: $program: $what" >&2
    failures=$((failures + 1))
  fi
}
for program in groundlock-server groundlock-dashboard groundlock; do
  expect "$program" "is not position-independent" 'Type: +DYN \(Position-Independent Executable' -h
  expect "$program" "its stack may hold code" 'GNU_STACK.* RW +0x' -l
  expect "$program" "its tables stay writable (RELRO)" 'GNU_RELRO' -l
  expect "$program" "binds its functions late (BIND_NOW)" '\((FLAGS_1\).*NOW|BIND_NOW|FLAGS\).*BIND_NOW)' -d
  expect "$program" "its stack is not guarded" '__stack_chk_fail' --dyn-syms
  expect "$program" "its copies are not checked (FORTIFY)" '__(memcpy|memset|read|snprintf|fprintf)_chk' --dyn-syms
  if readelf -W -d "$bin/$program" | grep TEXTREL >/dev/null; then
    echo "hardening: $program: its code is written to (TEXTREL)" >&2
    failures=$((failures + 1))
  fi
done
[ "$failures" -eq 0 ]
