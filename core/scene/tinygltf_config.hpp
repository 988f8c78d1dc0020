/* tinygltf_config.hpp: tinygltf as this project uses it. The macros change the library's classes, so every
 * file that sees tinygltf sees it through here.
 *
 * It parses, and nothing else: no file access of its own, no image decoding, no writing. Its header is
 * compiled into this library (tinygltf_implementation.cpp) rather than linked, because the distributions'
 * shared library was built with its file access and stb's image decoders in it.
 */
#ifndef CAUSTIC_TINYGLTF_CONFIG_HPP
#define CAUSTIC_TINYGLTF_CONFIG_HPP

#define TINYGLTF_NO_FS
#define TINYGLTF_NO_STB_IMAGE
#define TINYGLTF_NO_STB_IMAGE_WRITE
#define TINYGLTF_NO_EXTERNAL_IMAGE
#define TINYGLTF_NO_INCLUDE_JSON
#define TINYGLTF_USE_CPP14
#include <nlohmann/json.hpp>
#include <tiny_gltf.h>

#endif
