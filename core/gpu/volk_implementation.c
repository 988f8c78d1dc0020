/* The one place where the Vulkan loader's code is compiled. */
#define VOLK_IMPLEMENTATION
#include <volk.h>
