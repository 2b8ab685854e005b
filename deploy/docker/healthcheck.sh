#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Whether a port of this container answers as it should, with nothing but bash.
#   healthcheck.sh PORT PATH WORDS     WORDS stand at the beginning of a line
set -euo pipefail
exec 3<>"/dev/tcp/127.0.0.1/$1"
printf 'GET %s HTTP/1.0\r\nHost: localhost\r\n\r\n' "$2" >&3
answer=$(cat <&3)
while IFS= read -r line; do
  if [[ $line == "$3"* ]]; then exit 0; fi
done <<<"$answer"
echo "no line of $2 begins with: $3" >&2
exit 1
