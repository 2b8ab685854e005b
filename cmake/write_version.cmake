# SPDX-License-Identifier: Apache-2.0
# Writes the source of base::Version() and the Python client's _build.py, if they
# have changed. To be run by
#   cmake -DSOURCE=… -DVERSION=… -DOUTPUT=… -DPYTHON=… -P write_version.cmake
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
# As client/python/setup.py writes it.
file(CONFIGURE OUTPUT ${PYTHON} @ONLY CONTENT [[
# SPDX-License-Identifier: Apache-2.0
"""Which build this is: the version, and with the commit."""
VERSION = "@VERSION@"
BUILD = "@text@"
]])
