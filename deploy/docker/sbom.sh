#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What this system consists of, by dpkg, as SPDX 2.3 (tag-value) on standard
# output.
#   sbom.sh NAME
set -euo pipefail
name=${1:?the name of what is listed}
created=$(date -u -d "@${SOURCE_DATE_EPOCH:-$(date +%s)}" +%Y-%m-%dT%H:%M:%SZ)
list() {
  dpkg-query -W -f '${db:Status-Status}\t${Package}\t${Version}\t${Architecture}\n' |
    awk -F '\t' '$1 == "installed"' | LC_ALL=C sort
}
cat <<HEADER
SPDXVersion: SPDX-2.3
DataLicense: CC0-1.0
SPDXID: SPDXRef-DOCUMENT
DocumentName: $name
DocumentNamespace: urn:spdx:$name:$(list | sha256sum | cut -c1-32)
Creator: Tool: dpkg-query
Created: $created
HEADER
list | awk -F '\t' '{
  id = $2 "-" $4; gsub(/[^A-Za-z0-9.-]/, "-", id)
  version = $3; gsub(/:/, "%3A", version); gsub(/\+/, "%2B", version)
  printf "\nPackageName: %s\nSPDXID: SPDXRef-%s\nPackageVersion: %s\n", $2, id, $3
  print "PackageDownloadLocation: NOASSERTION\nFilesAnalyzed: false"
  printf "ExternalRef: PACKAGE-MANAGER purl pkg:deb/debian/%s@%s?arch=%s\n", $2, version, $4
  printf "Relationship: SPDXRef-DOCUMENT DESCRIBES SPDXRef-%s\n", id
}'
