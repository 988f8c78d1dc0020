/* gltf_materials.hpp: materials and their textures. Internal to core/scene. */
#ifndef CAUSTIC_GLTF_MATERIALS_HPP
#define CAUSTIC_GLTF_MATERIALS_HPP

#include "gltf_document.hpp"

extern "C" {
#include "scene_builder.h"
}

/* All of the document's materials, in their order, and the images they use. Returns for every material the
 * TEXCOORD set its textures want. */
std::vector<int> gltf_add_materials(const gltf_document &document, gltf_folder &folder,
                                    scene_builder *builder);

#endif
