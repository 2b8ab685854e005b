# SPDX-License-Identifier: Apache-2.0
# What `cmake --install` puts where, and the Debian packages that CPack makes of
# it (deploy/packages.sh): one component is one package.
include(GNUInstallDirs)

# OpenCV's checks carry the name of the file in which they stand: without its
# folder, so that packages are the same wherever they are built. (Not a flag of
# all targets: every compiler's cache would lose all that it has.)
target_compile_options(groundlock_target PRIVATE -fmacro-prefix-map=${PROJECT_SOURCE_DIR}/=)

install(TARGETS groundlock-server
  RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT server)
install(FILES deploy/systemd/groundlock-server.service
  DESTINATION lib/systemd/system COMPONENT server)
install(FILES deploy/debian/server.ini
  DESTINATION /etc/groundlock COMPONENT server)

install(TARGETS groundlock
  RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT cli)

install(TARGETS groundlock-dashboard
  RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT dashboard)
install(FILES deploy/systemd/groundlock-dashboard.service
  DESTINATION lib/systemd/system COMPONENT dashboard)
if(TARGET groundlock_web)
  install(DIRECTORY ${PROJECT_BINARY_DIR}/share/groundlock/web
    DESTINATION share/groundlock COMPONENT dashboard
    PATTERN .stamp EXCLUDE)
endif()

# Manual pages and the shells' completion, from the options as they are; programs
# for another machine, or with a sanitizer's own habits, are not asked for them.
find_program(GROUNDLOCK_HELP2MAN help2man)
if(GROUNDLOCK_HELP2MAN AND NOT CMAKE_CROSSCOMPILING AND GROUNDLOCK_SANITIZER STREQUAL ""
    AND NOT GROUNDLOCK_FUZZ)
  set(described ${PROJECT_BINARY_DIR}/share/groundlock/described)
  file(MAKE_DIRECTORY ${described})
  # groundlock_describe(<file> <program> <command ...>): a file from what the command prints.
  function(groundlock_describe file program)
    add_custom_command(OUTPUT ${described}/${file}
      COMMAND ${ARGN} > ${described}/${file}
      DEPENDS ${program} VERBATIM)
    set_property(GLOBAL APPEND PROPERTY groundlock_described ${described}/${file})
  endfunction()
  # groundlock_manual(<program> <component> <command ...>): its page, compressed.
  function(groundlock_manual program component)
    add_custom_command(OUTPUT ${described}/${program}.1.gz
      COMMAND ${ARGN} > ${described}/${program}.1
      # The month in which it was made would make two builds differ.
      COMMAND sed -i "/^\\.TH/s/\"[A-Z][a-z]* [0-9]*\"/\"\"/" ${described}/${program}.1
      COMMAND gzip -9nf ${described}/${program}.1
      DEPENDS ${program} VERBATIM)
    set_property(GLOBAL APPEND PROPERTY groundlock_described ${described}/${program}.1.gz)
    install(FILES ${described}/${program}.1.gz
      DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 COMPONENT ${component})
  endfunction()

  groundlock_manual(groundlock cli groundlock completion man)
  groundlock_manual(groundlock-server server ${GROUNDLOCK_HELP2MAN} --no-info
    --name "server that keeps a lock on things that move on the ground" $<TARGET_FILE:groundlock-server>)
  groundlock_manual(groundlock-dashboard dashboard ${GROUNDLOCK_HELP2MAN} --no-info
    --name "web page to watch and steer Groundlock sessions with" $<TARGET_FILE:groundlock-dashboard>)
  groundlock_describe(groundlock groundlock groundlock completion bash)
  groundlock_describe(_groundlock groundlock groundlock completion zsh)
  groundlock_describe(groundlock.fish groundlock groundlock completion fish)
  install(FILES ${described}/groundlock
    DESTINATION share/bash-completion/completions COMPONENT cli)
  install(FILES ${described}/_groundlock
    DESTINATION share/zsh/vendor-completions COMPONENT cli)
  install(FILES ${described}/groundlock.fish
    DESTINATION share/fish/vendor_completions.d COMPONENT cli)
  get_property(files GLOBAL PROPERTY groundlock_described)
  add_custom_target(groundlock_described ALL DEPENDS ${files})
endif()

include(cmake/sdk_packages.cmake)

# Debian wants it compressed, and without the time at which that was done.
file(MAKE_DIRECTORY ${PROJECT_BINARY_DIR}/generated)
execute_process(COMMAND gzip -9nc ${PROJECT_SOURCE_DIR}/deploy/debian/changelog
  OUTPUT_FILE ${PROJECT_BINARY_DIR}/generated/changelog.gz COMMAND_ERROR_IS_FATAL ANY)
set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS deploy/debian/changelog)

set(documents README.md LICENSE docs/user_guide.md docs/operations.md docs/api.md)
set(package_server groundlock-server)
set(package_cli groundlock)
set(package_dashboard groundlock-dashboard)
set(package_dev libgroundlock-dev)
set(package_python python3-groundlock)
foreach(component IN ITEMS server cli dashboard dev python)
  set(package ${package_${component}})
  set(more)
  if(component STREQUAL "python")
    set(more docs/python.md)
  elseif(component STREQUAL "dev")
    set(more docs/cpp.md)
  endif()
  install(FILES ${documents} ${more}
    DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${package} COMPONENT ${component})
  install(FILES deploy/debian/copyright ${PROJECT_BINARY_DIR}/generated/changelog.gz
    DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${package} COMPONENT ${component})
endforeach()

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME groundlock)
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGE_CONTACT "Groundlock <groundlock@localhost>")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_COMPONENTS_ALL server cli dashboard dev python)
set(CPACK_COMPONENTS_GROUPING IGNORE)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)

set(CPACK_DEBIAN_SERVER_PACKAGE_NAME groundlock-server)
set(CPACK_DEBIAN_SERVER_DESCRIPTION
  "server that keeps a lock on things that move on the ground\n\
It holds maps and tracking sessions; clients stream camera frames over gRPC\n\
and get back the camera's pose and each target's 2D and 3D box.")
set(CPACK_DEBIAN_SERVER_PACKAGE_RECOMMENDS colmap)
set(CPACK_DEBIAN_SERVER_PACKAGE_CONTROL_EXTRA
  ${PROJECT_SOURCE_DIR}/deploy/debian/conffiles)

set(CPACK_DEBIAN_CLI_PACKAGE_NAME groundlock)
set(CPACK_DEBIAN_CLI_DESCRIPTION
  "command line of Groundlock: builds maps and tracks in videos\n\
 It talks to a groundlock-server, or runs one of its own where none is named.")
set(CPACK_DEBIAN_CLI_PACKAGE_RECOMMENDS "colmap, ffmpeg, gdal-bin, proj-data")
set(CPACK_DEBIAN_CLI_PACKAGE_DEPENDS "groundlock-server (= ${PROJECT_VERSION})")

set(CPACK_DEBIAN_DASHBOARD_PACKAGE_NAME groundlock-dashboard)
set(CPACK_DEBIAN_DASHBOARD_DESCRIPTION
  "web page to watch and steer Groundlock's sessions with\n\
 A proxy between browsers and a groundlock-server, and the page itself.")
include(CPack)
