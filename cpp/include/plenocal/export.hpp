// Symbols that a shared library exports; everything else in it is hidden.
#pragma once

#if defined(__GNUC__)
#define PLENOCAL_API __attribute__((visibility("default")))
#else
#define PLENOCAL_API
#endif
