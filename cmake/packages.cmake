# SPDX-License-Identifier: Apache-2.0
# What `cmake --install` puts where, and the Debian packages that CPack makes of
# it (deploy/packages.sh): one component is one package.
include(GNUInstallDirs)

install(TARGETS groundlock-server
  RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT server)
install(FILES deploy/systemd/groundlock-server.service
  DESTINATION lib/systemd/system COMPONENT server)
install(FILES deploy/debian/server.ini
  DESTINATION ${CMAKE_INSTALL_FULL_SYSCONFDIR}/groundlock COMPONENT server)

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

set(documents README.md LICENSE docs/user_guide.md docs/operations.md docs/api.md)
foreach(component IN ITEMS server cli dashboard)
  set(package groundlock-${component})
  if(component STREQUAL "cli")
    set(package groundlock)
  endif()
  install(FILES ${documents}
    DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${package} COMPONENT ${component})
  install(FILES deploy/debian/copyright
    DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${package} COMPONENT ${component})
endforeach()

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME groundlock)
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGE_CONTACT "Groundlock <groundlock@localhost>")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_COMPONENTS_ALL server cli dashboard)
set(CPACK_COMPONENTS_GROUPING IGNORE)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)

set(CPACK_DEBIAN_SERVER_PACKAGE_NAME groundlock-server)
set(CPACK_DEBIAN_SERVER_DESCRIPTION
  "server that keeps a lock on things that move on the ground\n\
 It holds maps and tracking sessions; clients stream camera frames over gRPC and\n\
 get back the camera's pose and each target's 2D and 3D box.")
set(CPACK_DEBIAN_SERVER_PACKAGE_RECOMMENDS colmap)
set(CPACK_DEBIAN_SERVER_PACKAGE_CONTROL_EXTRA
  ${PROJECT_SOURCE_DIR}/deploy/debian/conffiles)

set(CPACK_DEBIAN_CLI_PACKAGE_NAME groundlock)
set(CPACK_DEBIAN_CLI_DESCRIPTION
  "command line of Groundlock: builds maps and tracks in videos\n\
 It talks to a groundlock-server, or runs one of its own where none is named.")
set(CPACK_DEBIAN_CLI_PACKAGE_RECOMMENDS "colmap, ffmpeg")
set(CPACK_DEBIAN_CLI_PACKAGE_DEPENDS "groundlock-server (= ${PROJECT_VERSION})")

set(CPACK_DEBIAN_DASHBOARD_PACKAGE_NAME groundlock-dashboard)
set(CPACK_DEBIAN_DASHBOARD_DESCRIPTION
  "web page to watch and steer Groundlock's sessions with\n\
 A proxy between browsers and a groundlock-server, and the page itself.")
include(CPack)
