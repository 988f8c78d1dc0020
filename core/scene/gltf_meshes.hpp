/* gltf_meshes.hpp: glTF meshes, one scene mesh per primitive of triangles. Internal to core/scene. */
#ifndef CAUSTIC_GLTF_MESHES_HPP
#define CAUSTIC_GLTF_MESHES_HPP

#include "gltf_document.hpp"

extern "C" {
#include "scene_builder.h"
}

class gltf_meshes {
  public:
    /* `texcoords`: per material, from gltf_add_materials. */
    gltf_meshes(const gltf_document &document, scene_builder *builder, std::vector<int> texcoords)
        : document_(document), builder_(builder), texcoords_(std::move(texcoords)),
          made_(document.model.meshes.size()), is_made_(document.model.meshes.size())
    {
    }

    /* The scene meshes of a glTF mesh, made when first asked for. */
    const std::vector<uint32_t> &get(int mesh, const std::string &node);

  private:
    void add_primitive(const tinygltf::Mesh &mesh, const tinygltf::Primitive &primitive,
                       const std::string &what, std::vector<uint32_t> &made);
    uint32_t default_material();

    const gltf_document &document_;
    scene_builder *builder_;
    std::vector<int> texcoords_;
    std::vector<std::vector<uint32_t>> made_;
    std::vector<bool> is_made_;
    uint32_t default_material_ = SCENE_NONE;
};

#endif
