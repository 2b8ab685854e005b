# SPDX-License-Identifier: Apache-2.0
# For arm64 on another machine: Debian's cross compiler, the libraries that
# `deploy/setup.sh arm64` has unpacked, and an emulator that runs the tests.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
set(CMAKE_C_COMPILER aarch64-linux-gnu-gcc-12)
set(CMAKE_CXX_COMPILER aarch64-linux-gnu-g++-12)

if(DEFINED ENV{GROUNDLOCK_SYSROOT})
  set(CMAKE_SYSROOT $ENV{GROUNDLOCK_SYSROOT})
else()
  get_filename_component(CMAKE_SYSROOT ${CMAKE_CURRENT_LIST_DIR}/../../build-sysroot-arm64 ABSOLUTE)
endif()
if(NOT EXISTS ${CMAKE_SYSROOT}/.groundlock-packages)
  message(FATAL_ERROR "no libraries for arm64 in ${CMAKE_SYSROOT}: deploy/setup.sh arm64 unpacks them")
endif()

# Libraries and headers are the sysroot's, programs this machine's.
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
set(libraries ${CMAKE_SYSROOT}/usr/lib/aarch64-linux-gnu)
set(ENV{PKG_CONFIG_LIBDIR} ${libraries}/pkgconfig:${CMAKE_SYSROOT}/usr/share/pkgconfig)
set(ENV{PKG_CONFIG_SYSROOT_DIR} ${CMAKE_SYSROOT})
# The linker looks here for what libraries need in their turn.
set(CMAKE_EXE_LINKER_FLAGS_INIT
  "-Wl,-rpath-link,${libraries}:${CMAKE_SYSROOT}/lib/aarch64-linux-gnu")

set(CMAKE_CROSSCOMPILING_EMULATOR qemu-aarch64 -L ${CMAKE_SYSROOT})
