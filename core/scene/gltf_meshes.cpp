#include "gltf_meshes.hpp"

#include <cmath>
#include <cstring>

extern "C" {
#include "mesh_repair.h"
}

/* Triangle corners of a list, strip or fan of `count` indices. Strips may hold triangles with two equal
 * corners, which only join their parts: those are dropped. */
static std::vector<uint32_t> triangulate(const std::vector<uint32_t> &indices, int mode)
{
    if (mode == TINYGLTF_MODE_TRIANGLES)
        return std::vector<uint32_t>(indices.begin(), indices.end() - (std::ptrdiff_t)(indices.size() % 3));
    std::vector<uint32_t> out;
    for (size_t i = 2; i < indices.size(); i++) {
        uint32_t a, b = indices[i - 1], c = indices[i];
        if (mode == TINYGLTF_MODE_TRIANGLE_FAN) {
            a = indices[0];
        } else {
            a = indices[i - 2];
            if (i & 1)
                std::swap(a, b);
        }
        if (a == b || b == c || c == a)
            continue;
        out.insert(out.end(), {a, b, c});
    }
    return out;
}

uint32_t gltf_meshes::default_material()
{
    if (default_material_ == SCENE_NONE) {
        scene_material material = scene_material_default("default");
        /* glTF's default has metallic 1 and roughness 1: a rough metal, which is imported as a diffuse
         * receiver. */
        material.metallic = 1;
        default_material_ = scene_builder_material(builder_, &material);
    }
    return default_material_;
}

static int attribute(const tinygltf::Primitive &primitive, const std::string &name)
{
    auto found = primitive.attributes.find(name);
    return found == primitive.attributes.end() ? -1 : found->second;
}

void gltf_meshes::add_primitive(const tinygltf::Mesh &mesh, const tinygltf::Primitive &primitive,
                                const std::string &what, std::vector<uint32_t> &made)
{
    const size_t vertex_limit = SCENE_MAX_VERTICES, corner_limit = size_t(SCENE_MAX_TRIANGLES) * 3;
    for (const char *name : {"KHR_draco_mesh_compression", "EXT_meshopt_compression"})
        if (primitive.extensions.count(name))
            gltf_fail(STATUS_UNSUPPORTED, "%s is compressed with %s, which is not supported", what.c_str(),
                      name);
    if (primitive.mode < TINYGLTF_MODE_TRIANGLES || primitive.mode > TINYGLTF_MODE_TRIANGLE_FAN) {
        if (primitive.mode < 0 || primitive.mode > TINYGLTF_MODE_TRIANGLE_FAN)
            gltf_fail(STATUS_INVALID, "%s has mode %d", what.c_str(), primitive.mode);
        scene_builder_warn(builder_, "%s holds points or lines and is left out", what.c_str());
        return;
    }
    if (primitive.material >= 0 && (size_t)primitive.material >= document_.model.materials.size())
        gltf_fail(STATUS_INVALID, "%s: there is no material %d", what.c_str(), primitive.material);
    if (!primitive.targets.empty())
        scene_builder_warn(builder_, "%s: morph targets are ignored", what.c_str());
    if (attribute(primitive, "POSITION") < 0)
        gltf_fail(STATUS_INVALID, "%s has no POSITION", what.c_str());

    std::vector<float> positions = gltf_read_floats(document_, attribute(primitive, "POSITION"),
                                                    TINYGLTF_TYPE_VEC3, vertex_limit, what + ", POSITION");
    size_t count = positions.size() / 3;
    for (size_t i = 0; i < positions.size(); i++)
        if (!std::isfinite(positions[i]))
            gltf_fail(STATUS_INVALID, "%s, vertex %zu: position is not finite", what.c_str(), i / 3);
    /* A float's step there is 64 m, and areas in it still fit a float. */
    for (size_t i = 0; i < positions.size(); i++)
        if (std::fabs(positions[i]) > 1e9f)
            gltf_fail(STATUS_LIMIT, "%s, vertex %zu: a coordinate of %g is beyond 1e9", what.c_str(), i / 3,
                      (double)positions[i]);

    std::vector<float> normals, uvs;
    if (attribute(primitive, "NORMAL") >= 0)
        normals = gltf_read_floats(document_, attribute(primitive, "NORMAL"), TINYGLTF_TYPE_VEC3,
                                   vertex_limit, what + ", NORMAL");
    int set = primitive.material >= 0 ? texcoords_[(size_t)primitive.material] : 0;
    std::string texcoord = "TEXCOORD_" + std::to_string(set);
    if (attribute(primitive, texcoord) >= 0)
        uvs = gltf_read_floats(document_, attribute(primitive, texcoord), TINYGLTF_TYPE_VEC2, vertex_limit,
                               what + ", " + texcoord);
    if ((!normals.empty() && normals.size() / 3 != count) || (!uvs.empty() && uvs.size() / 2 != count))
        gltf_fail(STATUS_INVALID, "%s: its attributes do not have equally many elements", what.c_str());
    for (float &value : uvs)
        if (!std::isfinite(value) || std::fabs(value) > 1e6f)
            value = 0;

    std::vector<uint32_t> corners;
    if (primitive.indices >= 0) {
        corners = gltf_read_indices(document_, primitive.indices, corner_limit, what + ", indices");
        for (size_t i = 0; i < corners.size(); i++)
            if (corners[i] >= count)
                gltf_fail(STATUS_INVALID, "%s, index %zu: vertex %u of %zu", what.c_str(), i, corners[i],
                          count);
    } else {
        corners.resize(count);
        for (size_t i = 0; i < count; i++)
            corners[i] = (uint32_t)i;
    }
    if (primitive.mode == TINYGLTF_MODE_TRIANGLES && corners.size() % 3)
        scene_builder_warn(builder_,
                           "%s: %zu corners are no whole number of triangles, the last %zu are left out",
                           what.c_str(), corners.size(), corners.size() % 3);
    corners = triangulate(corners, primitive.mode);
    if (corners.empty()) {
        scene_builder_warn(builder_, "%s has no triangles and is left out", what.c_str());
        return;
    }
    if (corners.size() > corner_limit)
        gltf_fail(STATUS_LIMIT, "%s has %zu triangles; the most is %u", what.c_str(), corners.size() / 3,
                  SCENE_MAX_TRIANGLES);

    /* Without normals the faces are flat, so no vertex is shared. */
    bool is_flat = normals.empty();
    size_t vertex_count = is_flat ? corners.size() : count;
    if (vertex_count > vertex_limit)
        gltf_fail(STATUS_LIMIT, "%s has %zu vertices; the most is %zu", what.c_str(), vertex_count,
                  vertex_limit);
    if (!scene_builder_ok(builder_))
        return;
    uint32_t first_vertex = builder_->scene->vertex_count, first_index = builder_->scene->index_count;
    scene_vertex *vertices = scene_builder_vertices(builder_, (uint32_t)vertex_count);
    uint32_t *indices = scene_builder_indices(builder_, (uint32_t)corners.size());
    if (!vertices || !indices)
        return;
    for (size_t i = 0; i < vertex_count; i++) {
        size_t source = is_flat ? corners[i] : i;
        memcpy(vertices[i].position, &positions[source * 3], sizeof vertices[i].position);
        if (!is_flat)
            memcpy(vertices[i].normal, &normals[source * 3], sizeof vertices[i].normal);
        if (!uvs.empty())
            memcpy(vertices[i].uv, &uvs[source * 2], sizeof vertices[i].uv);
    }
    for (size_t i = 0; i < corners.size(); i++)
        indices[i] = is_flat ? (uint32_t)i : corners[i];
    uint32_t triangle_count = (uint32_t)(corners.size() / 3), repaired = 0;
    if (is_flat)
        mesh_set_flat_normals(vertices, triangle_count);
    else if (!mesh_repair_normals(vertices, (uint32_t)vertex_count, indices, triangle_count, &repaired))
        gltf_fail(STATUS_MEMORY, "out of memory for the normals of %s", what.c_str());
    if (repaired)
        scene_builder_warn(builder_, "%s: %u normals have no direction; those of the triangles are used",
                           what.c_str(), repaired);
    if (!is_flat && mesh_is_inside_out(vertices, indices, triangle_count)) {
        scene_builder_warn(builder_, "%s: its triangles wind against its normals; they are turned round",
                           what.c_str());
        for (uint32_t i = 0; i < triangle_count; i++)
            std::swap(indices[3 * (size_t)i + 1], indices[3 * (size_t)i + 2]);
    }
    uint32_t material = primitive.material >= 0 ? (uint32_t)primitive.material : default_material();
    made.push_back(scene_builder_mesh(builder_, mesh.name.c_str(), material, first_vertex, first_index));
}

const std::vector<uint32_t> &gltf_meshes::get(int index, const std::string &node)
{
    if (index < 0 || (size_t)index >= made_.size())
        gltf_fail(STATUS_INVALID, "%s: there is no mesh %d", node.c_str(), index);
    size_t at = (size_t)index;
    if (!is_made_[at]) {
        is_made_[at] = true;
        const tinygltf::Mesh &mesh = document_.model.meshes[at];
        for (size_t i = 0; i < mesh.primitives.size(); i++) {
            std::string what = "mesh " + (mesh.name.empty() ? std::to_string(at) : gltf_quoted(mesh.name));
            if (mesh.primitives.size() > 1)
                what += ", primitive " + std::to_string(i);
            add_primitive(mesh, mesh.primitives[i], what, made_[at]);
        }
    }
    return made_[at];
}
