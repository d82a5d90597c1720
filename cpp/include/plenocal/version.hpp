// Version of the library. CMake reads it from here.
#pragma once

#define PLENOCAL_VERSION_MAJOR 0
#define PLENOCAL_VERSION_MINOR 1
#define PLENOCAL_VERSION_PATCH 0
#define PLENOCAL_VERSION "0.1.0"
