// SPDX-License-Identifier: Apache-2.0
// Whether this is a build with a sanitizer that keeps shadows of all memory
// (address, thread): figures of memory and bounds on it then mean nothing.
#ifndef GROUNDLOCK_MAP_STORE_BASE_SANITIZERS_H_
#define GROUNDLOCK_MAP_STORE_BASE_SANITIZERS_H_

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define GROUNDLOCK_HAS_SHADOW 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define GROUNDLOCK_HAS_SHADOW 1
#endif
#endif

namespace groundlock::base {

#if defined(GROUNDLOCK_HAS_SHADOW)
inline constexpr bool kHasShadow = true;
#else
inline constexpr bool kHasShadow = false;
#endif

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_SANITIZERS_H_
