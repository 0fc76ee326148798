# The target for CMake: its compiler runs here, its headers and libraries are in the sysroot. catkin_packages.py sets TRIPLET.
set(CMAKE_SYSTEM_NAME Linux)
string(REGEX REPLACE "-.*" "" CMAKE_SYSTEM_PROCESSOR "$ENV{TRIPLET}")
set(CMAKE_C_COMPILER "$ENV{TRIPLET}-gcc")
set(CMAKE_CXX_COMPILER "$ENV{TRIPLET}-g++")
set(CMAKE_LIBRARY_ARCHITECTURE "$ENV{TRIPLET}")
set(CMAKE_SYSROOT /sysroot)
# What packages generate is looked for in their own folders as well: messages, for example.
set(CMAKE_FIND_ROOT_PATH /cache)
# Programs that run in the build are this computer's own; everything else is the target's.
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
# A library that catkin names, and the program does not use, would have to be on the robot.
foreach(kind EXE SHARED MODULE)
  set(CMAKE_${kind}_LINKER_FLAGS_INIT "-Wl,--as-needed -Wl,-rpath-link,/opt/packages/lib")
endforeach()
