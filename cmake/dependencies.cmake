# SPDX-License-Identifier: Apache-2.0
# Third-party packages, all from Debian 12 (deploy/setup.sh installs them).
find_package(Threads REQUIRED)
find_package(absl REQUIRED)
find_package(Eigen3 REQUIRED)
find_package(spdlog REQUIRED)
find_package(CLI11 REQUIRED)
find_package(nlohmann_json REQUIRED)
find_package(OpenCV REQUIRED COMPONENTS core imgproc imgcodecs videoio video features2d flann calib3d tracking)
find_package(Ceres REQUIRED)
find_package(embree 3 REQUIRED)
find_package(Protobuf REQUIRED)
find_package(OpenSSL REQUIRED)
find_package(gRPC CONFIG REQUIRED)
find_package(SQLite3 REQUIRED)
find_package(PkgConfig REQUIRED)
find_package(prometheus-cpp CONFIG REQUIRED COMPONENTS core)
find_package(Boost 1.74 REQUIRED)  # headers alone: Asio, Beast
pkg_check_modules(libpq REQUIRED IMPORTED_TARGET libpq)
pkg_check_modules(sleef REQUIRED IMPORTED_TARGET sleef)
pkg_check_modules(seccomp REQUIRED IMPORTED_TARGET libseccomp)
pkg_check_modules(xxhash REQUIRED IMPORTED_TARGET libxxhash)
pkg_check_modules(zstd REQUIRED IMPORTED_TARGET libzstd)
pkg_check_modules(turbojpeg REQUIRED IMPORTED_TARGET libturbojpeg)
pkg_check_modules(flann REQUIRED IMPORTED_TARGET flann)
pkg_check_modules(tcmalloc REQUIRED IMPORTED_TARGET libtcmalloc_minimal)
pkg_check_modules(ffmpeg REQUIRED IMPORTED_TARGET libavformat libavcodec libavutil libswscale)

pkg_check_modules(jwt REQUIRED IMPORTED_TARGET libjwt)
find_package(ZLIB REQUIRED)
pkg_check_modules(exif REQUIRED IMPORTED_TARGET libexif)
pkg_check_modules(geographiclib REQUIRED IMPORTED_TARGET geographiclib)

# OpenGV's config file does not carry its include directories.
find_package(opengv CONFIG REQUIRED)

# OpenCV's imported targets lack its system include directory under Debian's
# layout when only OpenCV_LIBS is linked: one interface target carries both.
add_library(groundlock_opencv INTERFACE)
add_library(groundlock::opencv ALIAS groundlock_opencv)
target_include_directories(groundlock_opencv SYSTEM INTERFACE ${OpenCV_INCLUDE_DIRS})
target_link_libraries(groundlock_opencv INTERFACE ${OpenCV_LIBS})

# What programs allocate with. The C library's gives the pictures of a frame back
# to the system after each one, which clears the same pages anew for the next: a
# quarter of a frame's time (docs/benchmarks.md, "Memory"). Sanitizers have
# allocators of their own.
add_library(groundlock_allocator INTERFACE)
if(GROUNDLOCK_SANITIZER STREQUAL "" AND NOT GROUNDLOCK_FUZZ)
  target_link_libraries(groundlock_allocator INTERFACE PkgConfig::tcmalloc)
endif()

if(GROUNDLOCK_TESTS)
  find_package(GTest REQUIRED)
endif()
if(GROUNDLOCK_BENCHMARKS)
  find_package(benchmark REQUIRED)
endif()

groundlock_pch(base LIBRARIES Eigen3::Eigen absl::status)
groundlock_pch(vision LIBRARIES Eigen3::Eigen absl::status groundlock::opencv)
groundlock_pch(service LEVEL -O1 LIBRARIES Eigen3::Eigen absl::status gRPC::grpc++)
groundlock_pch(tools LEVEL -O1 LIBRARIES Eigen3::Eigen absl::status groundlock::opencv CLI11::CLI11 nlohmann_json::nlohmann_json)
