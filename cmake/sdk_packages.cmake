# SPDX-License-Identifier: Apache-2.0
# The packages for people who write programs: libgroundlock-dev (the C++ client,
# for find_package(Groundlock) and pkg-config) and python3-groundlock.
include(CMakePackageConfigHelpers)
set(libraries ${CMAKE_INSTALL_LIBDIR})
if(CMAKE_LIBRARY_ARCHITECTURE)
  set(libraries lib/${CMAKE_LIBRARY_ARCHITECTURE})  # where Debian looks, for one architecture beside another
endif()

# One archive of what the client needs of our rooms. Static: it has no stable
# binary interface yet that a shared library would have to promise. Of
# map_store/base it takes the files alone: what replaces the C library's
# functions has no business in other people's programs.
add_library(groundlock_dev STATIC
  $<TARGET_OBJECTS:groundlock_sdk> $<TARGET_OBJECTS:groundlock_geometry>
  $<FILTER:$<TARGET_OBJECTS:groundlock_base>,INCLUDE,/file\\.cc> $<TARGET_OBJECTS:groundlock_version>
  $<TARGET_OBJECTS:groundlock_messages> $<TARGET_OBJECTS:groundlock_proto>)
set_target_properties(groundlock_dev PROPERTIES
  LINKER_LANGUAGE CXX OUTPUT_NAME groundlock EXPORT_NAME groundlock
  ARCHIVE_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/lib)
target_compile_features(groundlock_dev INTERFACE cxx_std_20)
target_include_directories(groundlock_dev INTERFACE $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}/groundlock>)
# Without -march=native or with it, Eigen's matrices must lie in memory alike.
target_compile_definitions(groundlock_dev INTERFACE EIGEN_MAX_ALIGN_BYTES=16)
target_link_libraries(groundlock_dev INTERFACE
  absl::status absl::statusor absl::strings absl::str_format absl::synchronization absl::time
  Eigen3::Eigen gRPC::grpc++ protobuf::libprotobuf Threads::Threads GeographicLib)
add_custom_command(TARGET groundlock_dev POST_BUILD
  COMMAND ${CMAKE_STRIP} --strip-debug --remove-section=.comment --enable-deterministic-archives
    $<TARGET_FILE:groundlock_dev> VERBATIM)

install(TARGETS groundlock_dev EXPORT Groundlock
  ARCHIVE DESTINATION ${libraries} COMPONENT dev)
install(EXPORT Groundlock NAMESPACE Groundlock:: FILE GroundlockTargets.cmake
  DESTINATION ${libraries}/cmake/Groundlock COMPONENT dev)
configure_package_config_file(${PROJECT_SOURCE_DIR}/client/sdk/package/GroundlockConfig.cmake.in
  ${PROJECT_BINARY_DIR}/generated/GroundlockConfig.cmake
  INSTALL_DESTINATION ${libraries}/cmake/Groundlock)
write_basic_package_version_file(${PROJECT_BINARY_DIR}/generated/GroundlockConfigVersion.cmake
  COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/generated/GroundlockConfig.cmake
    ${PROJECT_BINARY_DIR}/generated/GroundlockConfigVersion.cmake
  DESTINATION ${libraries}/cmake/Groundlock COMPONENT dev)
file(RELATIVE_PATH prefix_from_pc /${libraries}/pkgconfig /.)
string(REGEX REPLACE "/$" "" prefix_from_pc ${prefix_from_pc})
configure_file(${PROJECT_SOURCE_DIR}/client/sdk/package/groundlock.pc.in
  ${PROJECT_BINARY_DIR}/generated/groundlock.pc @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/generated/groundlock.pc
  DESTINATION ${libraries}/pkgconfig COMPONENT dev)
# What client.h includes, and nothing else: the test of the packages compiles it.
foreach(header
    client/sdk/client.h client/sdk/map_types.h client/sdk/tracking_stream.h client/sdk/types.h
    map_store/geometry/box.h map_store/geometry/camera_model.h map_store/geometry/geodesy.h
    map_store/geometry/plane.h map_store/geometry/rigid3.h map_store/geometry/similarity3.h)
  get_filename_component(folder ${header} DIRECTORY)
  install(FILES ${PROJECT_SOURCE_DIR}/${header}
    DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/groundlock/${folder} COMPONENT dev)
endforeach()
install(DIRECTORY ${PROJECT_SOURCE_DIR}/proto/groundlock/v1
  DESTINATION share/groundlock/proto/groundlock COMPONENT dev)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/client/sdk/examples
  DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/libgroundlock-dev COMPONENT dev)

# Python: the sources as they are, and the messages and the build's name (as
# client/python/setup.py makes them; cmake/write_version.cmake writes the latter).
set(python ${PROJECT_BINARY_DIR}/python3-groundlock)
set(messages)
foreach(name geometry maps tracking)
  list(APPEND messages ${python}/groundlock/v1/${name}_pb2.py ${python}/groundlock/v1/${name}_pb2.pyi)
endforeach()
file(MAKE_DIRECTORY ${python}/groundlock/v1)
file(CONFIGURE OUTPUT ${python}/groundlock/v1/__init__.py CONTENT
"# SPDX-License-Identifier: Apache-2.0
\"\"\"The messages of the protocol, generated from proto/groundlock/v1.\"\"\"
")
add_custom_command(OUTPUT ${messages}
  COMMAND protobuf::protoc --proto_path=${PROJECT_SOURCE_DIR}/proto --python_out=${python} --pyi_out=${python}
    groundlock/v1/geometry.proto groundlock/v1/maps.proto groundlock/v1/tracking.proto
  DEPENDS ${PROJECT_SOURCE_DIR}/proto/groundlock/v1/geometry.proto
    ${PROJECT_SOURCE_DIR}/proto/groundlock/v1/maps.proto ${PROJECT_SOURCE_DIR}/proto/groundlock/v1/tracking.proto
  VERBATIM)
add_custom_target(groundlock_python_messages ALL DEPENDS ${messages})
add_dependencies(groundlock_python_messages groundlock_write_version)
configure_file(${PROJECT_SOURCE_DIR}/client/python/METADATA.in ${python}/METADATA @ONLY)
file(CONFIGURE OUTPUT ${python}/INSTALLER CONTENT "debian\n")
set(site lib/python3/dist-packages)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/client/python/groundlock ${python}/groundlock
  DESTINATION ${site} COMPONENT python
  PATTERN __pycache__ EXCLUDE)
install(FILES ${python}/METADATA ${python}/INSTALLER
  DESTINATION ${site}/groundlock-${PROJECT_VERSION}.dist-info COMPONENT python)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/client/python/examples
  DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/python3-groundlock COMPONENT python
  PATTERN __pycache__ EXCLUDE)

set(CPACK_DEBIAN_DEV_PACKAGE_NAME libgroundlock-dev)
set(CPACK_DEBIAN_DEV_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_DEV_DESCRIPTION
  "C++ client of a Groundlock server\n\
Headers, a static library, the protocol's files, and what find_package and\n\
pkg-config need. Streams reconnect and resume by themselves.")
set(CPACK_DEBIAN_DEV_PACKAGE_DEPENDS
  "libabsl-dev, libeigen3-dev, libgrpc++-dev, libprotobuf-dev, libgeographiclib-dev")

set(CPACK_DEBIAN_PYTHON_PACKAGE_NAME python3-groundlock)
set(CPACK_DEBIAN_PYTHON_PACKAGE_SECTION python)
set(CPACK_DEBIAN_PYTHON_PACKAGE_ARCHITECTURE all)
set(CPACK_DEBIAN_PYTHON_DESCRIPTION
  "Python client of a Groundlock server\n\
Maps, sessions and frames, for plain programs and for asyncio: arrays of NumPy\n\
in, typed dataclasses out. Streams reconnect and resume by themselves.")
set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS "python3:any, python3-grpcio, python3-protobuf, python3-numpy")
set(CPACK_DEBIAN_PYTHON_PACKAGE_RECOMMENDS "groundlock-server, ffmpeg, python3-opencv | python3-pil")
set(CPACK_DEBIAN_PYTHON_PACKAGE_SUGGESTS "python3-pandas, python3-zstandard, python3-matplotlib")
set(CPACK_DEBIAN_PYTHON_PACKAGE_CONTROL_EXTRA
  ${PROJECT_SOURCE_DIR}/deploy/debian/python/postinst ${PROJECT_SOURCE_DIR}/deploy/debian/python/prerm)
