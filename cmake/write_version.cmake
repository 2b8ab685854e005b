# SPDX-License-Identifier: Apache-2.0
# Writes the source of base::Version(), if it has changed. To be run by
#   cmake -DSOURCE=… -DVERSION=… -DOUTPUT=… -P write_version.cmake
execute_process(
  COMMAND git -C ${SOURCE} describe --always --abbrev=12 --exclude=* --dirty=+
  OUTPUT_VARIABLE commit OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
set(text "${VERSION}")
if(commit)
  string(APPEND text " (${commit})")
endif()
file(CONFIGURE OUTPUT ${OUTPUT} @ONLY CONTENT [[
// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/version.h"

namespace groundlock::base {
const char* Version() { return "@text@"; }
}  // namespace groundlock::base
]])
