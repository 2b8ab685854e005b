#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Arrows between the rooms run one way: fails on any #include against them.
#   tests/lint/layering.sh [ROOT]
set -euo pipefail
cd "${1:-$(dirname "$0")/../..}"

failures=0

# forbid FOLDERS PATTERN WHY: no source in FOLDERS may have an #include that
# matches PATTERN.
forbid() {
  local hits
  hits=$(grep -rnE --include='*.h' --include='*.cc' \
    "^#include [\"<]($2)" $1 2>/dev/null || true)
  if [ -n "$hits" ]; then
    printf 'layering: %s\n%s\n' "$3" "$hits" >&2
    failures=$((failures + 1))
  fi
}

vision="server/image server/localization server/target server/ground server/motion server/movers server/tracking"

forbid "map_store $vision client/cli client/media client/simulator" \
  'grpcpp/|grpc/|google/protobuf/|[^">]*\.pb\.h' \
  'only server/service, server/app and client/sdk speak gRPC'
forbid "map_store" 'server/|client/|tests/' 'map_store stands on nothing of ours'
forbid "map_store/base" 'map_store/(cage|decoding|geometry|terrain|map|features|formats|build|storage)/' 'base is the lowest room'
forbid "map_store/cage" 'map_store/(decoding|geometry|terrain|map|features|formats|build|storage)/|opencv' 'cage knows only base'
forbid "map_store/decoding" 'map_store/(geometry|terrain|map|features|formats|build|storage)/' 'decoding knows only cage and base'
forbid "map_store/geometry" 'map_store/(terrain|map|features|formats|build|storage)/|opencv' 'geometry knows only base and Eigen'
forbid "map_store/terrain" 'map_store/(map|decoding|features|formats|build|storage)/|opencv' 'terrain knows only base, cage and geometry'
forbid "map_store/map" 'map_store/(terrain|features|formats|build|storage)/' 'map knows only base and geometry'
forbid "map_store/features" 'map_store/(formats|storage|build)/' 'features knows only map and below'
forbid "map_store/formats" 'map_store/(storage|build)/' 'formats knows neither storage nor build'
forbid "map_store/build" 'map_store/storage/' 'build makes maps and does not keep them'
forbid "map_store/storage" 'map_store/(formats|build)/' 'formats and storage do not know each other'
forbid "$vision" 'server/(service|app)/|client/|map_store/(formats|build|storage)/' 'vision rooms know neither transport nor storage'
forbid "server/image" 'server/(localization|target|ground|motion|movers|tracking)/' 'image is the lowest vision room'
forbid "server/target server/ground server/motion" 'server/(localization|movers|tracking)/' 'sibling rooms meet in tracking'
forbid "server/target" 'server/(ground|motion)/' 'sibling rooms meet in tracking'
forbid "server/ground" 'server/(target|motion)/' 'sibling rooms meet in tracking'
forbid "server/motion" 'server/(target|ground)/' 'sibling rooms meet in tracking'
forbid "server/movers" 'server/(localization|target|motion|tracking)/|map_store/map/' 'movers know only images and the ground'
forbid "server/localization" 'server/(target|ground|motion|movers|tracking)/' 'sibling rooms meet in tracking'
forbid "server/localization/solvers" 'server/(image/|localization/(window|search|follow)/|localization/[a-z_]+[.]h)|map_store/map/' 'solvers know neither maps nor images'
forbid "server/localization/window" 'server/localization/((search|follow)/|[a-z_]+[.]h)|map_store/map/' 'the window knows only solvers'
forbid "server/localization/search" 'server/localization/(follow/|fast_|baseline_|state_)' 'a search knows nothing of the frames before'
forbid "server/localization/follow" 'server/localization/(fast_|baseline_|state_)' 'following knows no localizer'
forbid "server" 'map_store/terrain/' 'elevation models are read by clients'
forbid "server/service" 'server/app/|client/' 'service knows neither its program nor its clients'
forbid "client" 'server/' 'clients know the server only through its API'
forbid "client/sdk" 'client/(cli|dashboard|media|simulator)/' 'the SDK stands below the programs'
forbid "client/media" 'client/(cli|dashboard|simulator)/' 'media stands below the programs'
forbid "client/cli" 'client/dashboard/' 'the CLI and the dashboard do not know each other'
forbid "client/dashboard" 'client/cli/' 'the CLI and the dashboard do not know each other'
forbid "client/dashboard/recording" 'client/(sdk|media)/|client/dashboard/proxy/' 'recording knows only the messages'
forbid "map_store server client" 'tests/' 'nothing depends on tests'

if [ "$failures" -gt 0 ]; then
  echo "layering: $failures rules broken" >&2
  exit 1
fi
echo "layering: all arrows run one way"
