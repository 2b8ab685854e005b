# SPDX-License-Identifier: Apache-2.0
# One macro per kind of target, so that every room's CMakeLists.txt says only
# what is particular to it: its sources and what it links.

find_program(CCACHE_PROGRAM ccache)
if(CCACHE_PROGRAM)
  set(ccache_settings CCACHE_SLOPPINESS=pch_defines,time_macros)
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    # What was compiled in another checkout is found, too. Not by clang, whose
    # precompiled headers name the files that they were made of.
    list(APPEND ccache_settings CCACHE_BASEDIR=${PROJECT_SOURCE_DIR} CCACHE_NOHASHDIR=1)
  elseif(GROUNDLOCK_FUZZ)
    # It does not know the option that names this file.
    list(APPEND ccache_settings CCACHE_EXTRAFILES=${PROJECT_SOURCE_DIR}/cmake/ubsan.ignore)
  endif()
  set(CMAKE_CXX_COMPILER_LAUNCHER ${CMAKE_COMMAND} -E env ${ccache_settings} ${CCACHE_PROGRAM})
endif()

# Flags of every target of ours; third-party headers are SYSTEM and exempt.
add_library(groundlock_flags INTERFACE)
target_compile_options(groundlock_flags INTERFACE
  -Wall -Wextra -Werror -Wshadow -Wnon-virtual-dtor -Woverloaded-virtual)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # GCC 12 reports false positives inside Eigen and the standard library when
  # it inlines deeply (GCC bugs 105562, 105329, 104475).
  target_compile_options(groundlock_flags INTERFACE
    -Wno-maybe-uninitialized -Wno-restrict -Wno-array-bounds
    -Wno-stringop-overflow -Wno-stringop-overread -fpch-preprocess)
  if(GROUNDLOCK_UNITY)
    # Of types in the unnamed namespace of a source that is compiled with others.
    target_compile_options(groundlock_flags INTERFACE -Wno-subobject-linkage)
  endif()
endif()
target_include_directories(groundlock_flags INTERFACE ${PROJECT_SOURCE_DIR})
# Optimised code is the same for every machine of the architecture, and results
# reproduce: no -march=native, no -ffast-math, and no fused multiply-adds, which
# one architecture has and another has not.
if(GROUNDLOCK_FUSED)
  # Noise in the last digits of all that our sources and Eigen reckon: no test's
  # outcome may hang on it. FMA brings AVX, for which Eigen would lay out memory
  # otherwise than Debian's OpenGV and Ceres do: it is not told.
  target_compile_options(groundlock_flags INTERFACE -mfma -ffp-contract=fast -U__AVX__ -U__FMA__)
else()
  target_compile_options(groundlock_flags INTERFACE -ffp-contract=off)
endif()
if(GROUNDLOCK_SANITIZER STREQUAL "address")
  set(sanitize -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer -O1)
elseif(GROUNDLOCK_SANITIZER STREQUAL "thread")
  set(sanitize -fsanitize=thread -fno-omit-frame-pointer -O1)
elseif(GROUNDLOCK_FUZZ)
  # Undefined behaviour is looked for in our sources, not in each template of
  # Eigen, OpenCV and the standard library, which nearly doubles the time; the
  # preset asan looks for it there, too.
  set(sanitize -fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=all -O1
    -fsanitize-ignorelist=${PROJECT_SOURCE_DIR}/cmake/ubsan.ignore)
elseif(NOT GROUNDLOCK_SANITIZER STREQUAL "")
  message(FATAL_ERROR "GROUNDLOCK_SANITIZER is '${GROUNDLOCK_SANITIZER}': expected address, thread or nothing")
endif()
# What a variable holds before it is set must not matter, and no sanitizer of
# GCC's sees a number that was never set: builds of everything that look for
# faults fill all that is left open with what spoils a result. Eigen's on the
# heap, too.
if(GROUNDLOCK_SANITIZER STREQUAL "address" OR GROUNDLOCK_FUSED OR CMAKE_BUILD_TYPE STREQUAL "Debug")
  target_compile_options(groundlock_flags INTERFACE -ftrivial-auto-var-init=pattern)
  target_compile_definitions(groundlock_flags INTERFACE EIGEN_INITIALIZE_MATRICES_BY_NAN)
endif()
if(sanitize)
  target_compile_options(groundlock_flags INTERFACE ${sanitize} -g1)
  # Eigen pads its allocations under the address sanitizer; memory that passes
  # between us and Debian's OpenGV must be allocated and freed alike.
  target_compile_definitions(groundlock_flags INTERFACE EIGEN_MALLOC_ALREADY_ALIGNED=1)
  target_link_options(groundlock_flags INTERFACE ${sanitize})
endif()

# What hardens a server that strangers send bytes to: checked copies, guarded
# stacks, addresses that differ from run to run, and tables of functions that
# nothing can overwrite. The sanitizers bring their own checks.
# Debian's GCC makes position-independent executables by itself.
if(NOT sanitize)
  target_compile_options(groundlock_flags INTERFACE
    -fstack-protector-strong $<$<CONFIG:Release>:-U_FORTIFY_SOURCE -D_FORTIFY_SOURCE=2>)
  target_link_options(groundlock_flags INTERFACE -Wl,-z,relro,-z,now)
endif()

# GNU's other linker takes a quarter of the time; it warns about what clang's
# sanitizers export.
find_program(GROUNDLOCK_GOLD ld.gold)
if(GROUNDLOCK_GOLD AND NOT sanitize)
  target_link_options(groundlock_flags INTERFACE -fuse-ld=gold)
endif()

# Tests cost more to compile than to run. GCC takes the optimisation from the
# precompiled header, so tests have their own.
add_library(groundlock_test_flags INTERFACE)
target_link_libraries(groundlock_test_flags INTERFACE groundlock_flags)
if(CMAKE_BUILD_TYPE STREQUAL "Release")
  target_compile_options(groundlock_test_flags INTERFACE -O1)
endif()

# groundlock_pch(<family> [LEVEL -On] [LIBRARIES ...])
# Precompiled headers, one per family of rooms, and with GoogleTest for its tests.
# LEVEL: the optimisation in a Release build of rooms that wait for sockets, disks
# and people, for a shorter build; GCC takes it from the precompiled header, hence
# by family.
function(groundlock_pch family)
  cmake_parse_arguments(arg "" "LEVEL" "LIBRARIES" ${ARGN})
  set(groundlock_level_${family} $<$<CONFIG:Release>:${arg_LEVEL}> PARENT_SCOPE)
  file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/pch/${family}.cc CONTENT "")
  add_library(groundlock_pch_${family} OBJECT EXCLUDE_FROM_ALL ${PROJECT_BINARY_DIR}/pch/${family}.cc)
  target_link_libraries(groundlock_pch_${family} PRIVATE groundlock_flags ${arg_LIBRARIES})
  target_compile_options(groundlock_pch_${family} PRIVATE $<$<CONFIG:Release>:${arg_LEVEL}>)
  target_precompile_headers(groundlock_pch_${family} PRIVATE <cmake/pch/${family}.h>)
  if(GROUNDLOCK_TESTS)
    add_library(groundlock_pch_test_${family} OBJECT EXCLUDE_FROM_ALL ${PROJECT_BINARY_DIR}/pch/${family}.cc)
    target_link_libraries(groundlock_pch_test_${family} PRIVATE
      groundlock_test_flags ${arg_LIBRARIES} GTest::gmock GTest::gtest)
    target_precompile_headers(groundlock_pch_test_${family} PRIVATE
      <cmake/pch/${family}.h> <gmock/gmock.h> <gtest/gtest.h>)
  endif()
endfunction()

# groundlock_library(<name> PCH base|vision|service [UNITY n] SOURCES ... [PUBLIC ...] [PRIVATE ...])
# Makes library groundlock_<name> with alias groundlock::<name>.
# UNITY: where headers cost more than the sources do, n sources are compiled at
# once (with GROUNDLOCK_UNITY): their unnamed namespaces must not collide.
function(groundlock_library name)
  cmake_parse_arguments(arg "" "PCH;UNITY" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  set(target groundlock_${name})
  add_library(${target} STATIC ${arg_SOURCES})
  add_library(groundlock::${name} ALIAS ${target})
  target_link_libraries(${target} PUBLIC groundlock_flags ${arg_PUBLIC} PRIVATE ${arg_PRIVATE})
  groundlock_compile_as(${target} "${arg_PCH}" "${arg_UNITY}")
endfunction()

# With the family's precompiled header and its level of optimisation.
function(groundlock_compile_as target family unity)
  if(family)
    target_precompile_headers(${target} REUSE_FROM groundlock_pch_${family})
    target_compile_options(${target} PRIVATE ${groundlock_level_${family}})
  endif()
  if(unity AND GROUNDLOCK_UNITY)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE ${unity})
  endif()
endfunction()

# groundlock_executable(<name> PCH ... [UNITY n] SOURCES ... LIBRARIES ...): bin/<name>.
function(groundlock_executable name)
  cmake_parse_arguments(arg "" "PCH;UNITY" "SOURCES;LIBRARIES" ${ARGN})
  add_executable(${name} ${arg_SOURCES})
  target_link_libraries(${name} PRIVATE groundlock_allocator groundlock_flags ${arg_LIBRARIES})
  groundlock_compile_as(${name} "${arg_PCH}" "${arg_UNITY}")
endfunction()

# groundlock_test(<path/name> PCH ... SOURCES ... LIBRARIES ... [LABELS ...])
# A GoogleTest executable; the CTest name is the path, e.g. server/ground/box_lift.
# Labels: "data" needs $GROUNDLOCK_DATA (left out of the slow sanitizer runs),
# "concurrent" also runs under the thread sanitizer.
function(groundlock_test name)
  cmake_parse_arguments(arg "" "PCH;TIMEOUT" "SOURCES;LIBRARIES;LABELS" ${ARGN})
  if(NOT GROUNDLOCK_TESTS)
    return()
  endif()
  string(REPLACE "/" "_" target test_${name})
  add_executable(${target} ${arg_SOURCES})
  target_link_libraries(${target} PRIVATE groundlock_allocator groundlock_test_flags ${arg_LIBRARIES} GTest::gmock GTest::gtest_main)
  set_target_properties(${target} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/tests)
  if(arg_PCH)
    target_precompile_headers(${target} REUSE_FROM groundlock_pch_test_${arg_PCH})
  endif()
  if(GROUNDLOCK_SANITIZER STREQUAL "thread" AND arg_PCH STREQUAL "service")
    target_link_libraries(${target} PRIVATE groundlock::grpc_tsan)
  endif()
  add_test(NAME ${name} COMMAND ${target})
  if("concurrent" IN_LIST arg_LABELS)
    add_dependencies(groundlock_concurrent_tests ${target})
  endif()
  # What must not hang on a hair: tests/perturb.py.
  if(arg_LIBRARIES MATCHES "groundlock::(perturbation|test_support|drawn_scene|rendered_plane_map|recorded_data)")
    add_dependencies(groundlock_perturbed_tests ${target})
    list(APPEND arg_LABELS perturbed)
  endif()
  # What looks at images and reckons: what another architecture may do otherwise.
  if(name MATCHES "^(map_store/(base|geometry|map|features)|server/(image|localization|target|ground|motion|movers|tracking))/"
      AND NOT "data" IN_LIST arg_LABELS)
    add_dependencies(groundlock_vision_tests ${target})
    list(APPEND arg_LABELS vision)
  endif()
  # What parses strangers' bytes, and what answers them, runs under the address sanitizer in CI.
  if((name MATCHES "^(map_store/(base|geometry|map|formats|storage)|server/(image|service)|client/dashboard/recording)/"
      OR name MATCHES "^integration/(access|attacks|bad_input|sessions)$")
      AND NOT "data" IN_LIST arg_LABELS)
    add_dependencies(groundlock_input_tests ${target})
    list(APPEND arg_LABELS input)
  endif()
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 600)
  endif()
  if(CMAKE_CROSSCOMPILING)
    math(EXPR arg_TIMEOUT "20 * ${arg_TIMEOUT}")  # in an emulator
  endif()
  # A test that may take longer starts earlier, so that no core waits for it at the end.
  # A data test that finds no $GROUNDLOCK_DATA prints SKIPPED and says so.
  set_tests_properties(${name} PROPERTIES TIMEOUT ${arg_TIMEOUT} COST ${arg_TIMEOUT} LABELS "${arg_LABELS}"
    WORKING_DIRECTORY ${PROJECT_SOURCE_DIR})
endfunction()

# groundlock_benchmark(<name> SOURCES ... LIBRARIES ...): bench/<name>, Google Benchmark.
function(groundlock_benchmark name)
  cmake_parse_arguments(arg "" "PCH" "SOURCES;LIBRARIES" ${ARGN})
  if(NOT GROUNDLOCK_BENCHMARKS)
    return()
  endif()
  add_executable(${name} ${arg_SOURCES})
  target_link_libraries(${name} PRIVATE groundlock_allocator groundlock_flags ${arg_LIBRARIES} benchmark::benchmark)
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/bench)
  if(arg_PCH)
    target_precompile_headers(${name} REUSE_FROM groundlock_pch_${arg_PCH})
  endif()
endfunction()

# groundlock_fuzzer(<name> SOURCES ... LIBRARIES ...): fuzz/<name>, libFuzzer.
function(groundlock_fuzzer name)
  cmake_parse_arguments(arg "" "PCH" "SOURCES;LIBRARIES" ${ARGN})
  if(NOT GROUNDLOCK_FUZZ)
    return()
  endif()
  add_executable(${name} ${arg_SOURCES})
  target_link_libraries(${name} PRIVATE groundlock_flags ${arg_LIBRARIES})
  target_link_options(${name} PRIVATE -fsanitize=fuzzer)
  if(arg_PCH)
    target_precompile_headers(${name} REUSE_FROM groundlock_pch_${arg_PCH})
  endif()
  add_dependencies(groundlock_fuzzers ${name})
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/fuzz)
endfunction()
