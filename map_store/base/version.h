// SPDX-License-Identifier: Apache-2.0
// Which build this is. A library of its own (groundlock::version), so that a
// new commit links the programs anew and nothing else.
#ifndef GROUNDLOCK_MAP_STORE_BASE_VERSION_H_
#define GROUNDLOCK_MAP_STORE_BASE_VERSION_H_

namespace groundlock::base {

// "0.1.0 (1a2b3c4d5e6f)": version and commit; "+" after the commit: the tree
// had changes. Without a repository the version alone.
const char* Version();

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_VERSION_H_
