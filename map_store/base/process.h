// SPDX-License-Identifier: Apache-2.0
// What a program tells the operating system about itself.
#ifndef GROUNDLOCK_MAP_STORE_BASE_PROCESS_H_
#define GROUNDLOCK_MAP_STORE_BASE_PROCESS_H_

#include <string>

namespace groundlock::base {

// The calling thread's name, as top, ps and debuggers show it: of at most 15
// characters, else cut. No effect where the system has no such names.
void NameThisThread(const std::string& name);

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_PROCESS_H_
