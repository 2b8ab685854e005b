// SPDX-License-Identifier: Apache-2.0
// What a program tells the operating system about itself.
#ifndef GROUNDLOCK_MAP_STORE_BASE_PROCESS_H_
#define GROUNDLOCK_MAP_STORE_BASE_PROCESS_H_

#include <string>

namespace groundlock::base {

// The calling thread's name, as top, ps and debuggers show it: of at most 15
// characters, else cut. No effect where the system has no such names.
void NameThisThread(const std::string& name);

// Images of megabytes come and go with each frame. The C library gives such
// memory back at once and gets it again page by page, which costs a tenth of a
// frame's time: from here on it keeps up to some tens of MiB per thread. Call
// once, at the start of a program; no effect elsewhere than with glibc.
void KeepFreedMemory();

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_PROCESS_H_
