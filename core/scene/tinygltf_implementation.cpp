/* 2.7 uses these without including them when its file access is left out. */
#include <fstream>
#include <sstream>

#define TINYGLTF_IMPLEMENTATION
#include "tinygltf_config.hpp"
