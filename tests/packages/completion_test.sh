#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The completion scripts and the manual page that `groundlock completion` makes:
# each shell takes its own, and every verb and option that --help names is there.
#
#   tests/packages/completion_test.sh BUILD_FOLDER
set -euo pipefail
groundlock=$(realpath "${1:?the build folder}")/bin/groundlock
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
fail() { echo "FAILED: $*" >&2; exit 1; }
for what in bash zsh fish man; do
  "$groundlock" completion "$what" >"$folder/$what" || fail "completion $what"
done
if "$groundlock" completion csh >/dev/null 2>&1; then fail "csh is no shell of ours"; fi

# offers WORDS…: what bash would offer for the last of them.
offers() {
  bash -c 'source "$1"; shift; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _groundlock
           printf "%s\n" "${COMPREPLY[@]}"' _ "$folder/bash" "$@"
}
offers groundlock "" | grep -x track >/dev/null || fail "bash: no verb"
offers groundlock map "" | grep -x build >/dev/null || fail "bash: no verb below map"
[ "$(offers groundlock map build --vid)" = --video ] || fail "bash: no option of map build"
[ "$(offers groundlock map build yard --video x.mp4 --max-im)" = --max-images ] || fail "bash: after values"
[ -z "$(offers groundlock track --vid)" ] || fail "bash: an option of another verb"

# Every option of every verb, as --help has it.
verbs() { offers groundlock "$@" "" | grep -v '^-'; }
mapfile -t paths < <(for verb in $(verbs); do
  if [ "$verb" = map ] || [ "$verb" = token ]; then
    for below in $(verbs "$verb"); do echo "$verb $below"; done
  else echo "$verb"; fi
done)
[ ${#paths[@]} -ge 15 ] || fail "only ${#paths[@]} verbs"
for path in "${paths[@]}"; do
  read -ra words <<<"$path"
  options=$("$groundlock" "${words[@]}" --help | grep -oE '^ +(-[a-z],)?--[a-z-]+' | grep -oE -- '--[a-z-]+' | sort -u)
  [ -n "$options" ] || fail "$path has no options"
  offered=$(offers groundlock "${words[@]}" --)
  for option in $options; do
    grep -qx -e "$option" <<<"$offered" || fail "bash: $path lacks $option"
    grep -qF -e "complete -c groundlock -n '__groundlock_at \"groundlock $path\" ' -l ${option#--} " "$folder/fish" ||
      fail "fish: $path lacks $option"
    # (Not -q: sed would write into a closed pipe.)
    sed -n "/^\.SS \"groundlock ${path//-/\\\\-}\"/,/^\.S[SH]/p" "$folder/man" |
      grep -F -e "${option//-/\\-}" >/dev/null || fail "man: $path lacks $option"
  done
done
# What zsh and fish offer at the same places, as those shells find it; beside a file.
touch "$folder/walk.mp4"
places=("" "map " "map build --vid" "map build yard --video x.mp4 --max-im" "track --vid" "track wal")
expected=("track" "build" "--video" "--max-images" "" "walk.mp4")
unexpected=("walk.mp4" "walk.mp4" "--max-images" "--video" "--video" "--video")
if command -v zsh >/dev/null; then
  # Outside of its line editor, zsh says what is added by the builtin that adds it.
  in_zsh() {
    (cd "$folder" && zsh -f -c '
      compadd() { shift; for word in "$@"; do [[ $word == $PREFIX* ]] && print -r -- "$word"; done }
      _files() { print -rl -- $PREFIX*(N) }
      words=(groundlock ${=1}); [[ $1 == *" " || -z $1 ]] && words+=("")
      CURRENT=$#words; PREFIX=$words[-1]
      source ./zsh' _ "$1" || true)
  }
else
  echo "zsh is not here: its script was not tried"
fi
if command -v fish >/dev/null; then
  in_fish() {
    (cd "$folder" && HOME=$folder fish --no-config -c 'source ./fish; complete -C "groundlock $argv[1]"' "$1" | cut -f1)
  }
else
  echo "fish is not here: its script was not tried"
fi
for shell in zsh fish; do
  declare -F "in_$shell" >/dev/null || continue
  for i in "${!places[@]}"; do
    offered=$("in_$shell" "${places[$i]}")
    [ -z "${expected[$i]}" ] || grep -qx -e "${expected[$i]}" <<<"$offered" ||
      fail "$shell: 'groundlock ${places[$i]}' does not offer ${expected[$i]}, but: $offered"
    if grep -qx -e "${unexpected[$i]}" <<<"$offered"; then
      fail "$shell: 'groundlock ${places[$i]}' offers ${unexpected[$i]}"
    fi
  done
done
if command -v mandoc >/dev/null; then
  mandoc -T lint -W error "$folder/man" || fail "the manual page"
elif command -v groff >/dev/null; then
  [ -z "$(groff -man -Tutf8 -ww "$folder/man" 2>&1 >/dev/null)" ] || fail "the manual page"
else
  echo "neither mandoc nor groff is here: the manual page was not rendered"
fi
echo "completion: ${#paths[@]} verbs, bash, zsh, fish and the manual page"
