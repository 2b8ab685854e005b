#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A certificate authority of your own, and what it issues: for a first try, and
# for networks without another one. Keys are readable by their owner alone.
#
#   deploy/certificates.sh FOLDER [NAME-OR-ADDRESS ...]
#
# Leaves in FOLDER ca.pem (give it to clients as --ca) and ca.key (keep it away
# from the server), server.pem and server.key for the names and addresses given
# besides localhost, client.pem and client.key. An authority that is there
# already is used again, so that this renews the others.
set -euo pipefail

folder=${1:?usage: deploy/certificates.sh FOLDER [NAME-OR-ADDRESS ...]}
shift
days=397  # what browsers accept of a server's certificate

mkdir -p "$folder"
cd "$folder"
umask 077

names=DNS:localhost,IP:127.0.0.1,IP:::1
for name in "$@"; do
  if [[ $name =~ ^[0-9.]+$ || $name == *:* ]]; then
    names+=,IP:$name
  else
    names+=,DNS:$name
  fi
done

new_key() { openssl genpkey -quiet -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1" 2>/dev/null ||
  openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1"; }

if [ ! -f ca.key ]; then
  new_key ca.key
  openssl req -x509 -new -key ca.key -days 3650 -subj "/CN=Groundlock authority" \
    -addext basicConstraints=critical,CA:TRUE \
    -addext keyUsage=critical,keyCertSign,cRLSign -out ca.pem
fi

# issue FILE SUBJECT PURPOSE NAMES: whole files appear, key first.
issue() {
  new_key "$1.key.new"
  openssl req -new -key "$1.key.new" -subj "/CN=$2" -out request.new
  {
    echo "basicConstraints=critical,CA:FALSE"
    echo "keyUsage=critical,digitalSignature"
    echo "extendedKeyUsage=$3"
    if [ -n "$4" ]; then echo "subjectAltName=$4"; fi
  } >extensions.new
  openssl x509 -req -in request.new -CA ca.pem -CAkey ca.key -days "$days" \
    -set_serial "0x$(openssl rand -hex 16)" -extfile extensions.new \
    -out "$1.pem.new" 2>/dev/null
  mv "$1.key.new" "$1.key"
  mv "$1.pem.new" "$1.pem"
  rm -f request.new extensions.new
}
issue server "${1:-localhost}" serverAuth "$names"
issue client groundlock-client clientAuth ""
chmod 644 ./*.pem
echo "certificates: $(pwd): ca.pem, server.pem, client.pem, and their keys"
