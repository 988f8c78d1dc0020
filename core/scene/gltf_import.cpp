#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <new>
#include <set>

#include "gltf_document.hpp"
#include "gltf_materials.hpp"
#include "gltf_meshes.hpp"

extern "C" {
#include "scene_rest.h"
}

static constexpr double pi = 3.14159265358979323846;
/* Keys of all animations together; a few hundred bytes of file can ask for the same ones again and again. */
static constexpr size_t max_keys = size_t(16) << 20;

struct importer {
    gltf_document &document;
    scene_builder *builder;
    std::vector<int> parents;          /* of the document's nodes; -1: root */
    std::vector<uint32_t> scene_nodes; /* document node -> scene node, or SCENE_NONE outside the scene */
    std::set<std::pair<uint32_t, int>> animated; /* (scene node, path) that a channel was made for */

    const tinygltf::Model &model() const
    {
        return document.model;
    }
    std::string node_name(size_t index) const
    {
        const std::string &name = model().nodes[index].name;
        return "node " + (name.empty() ? std::to_string(index) : gltf_quoted(name));
    }
};

/* ---- nodes -------------------------------------------------------------------------------------------- */

static void find_parents(importer &in)
{
    const std::vector<tinygltf::Node> &nodes = in.model().nodes;
    in.parents.assign(nodes.size(), -1);
    for (size_t i = 0; i < nodes.size(); i++)
        for (int child : nodes[i].children) {
            if (child < 0 || (size_t)child >= nodes.size())
                gltf_fail(STATUS_INVALID, "%s: there is no node %d to be its child", in.node_name(i).c_str(),
                          child);
            if (in.parents[(size_t)child] >= 0)
                gltf_fail(STATUS_INVALID, "%s has two parents, nodes %d and %zu",
                          in.node_name((size_t)child).c_str(), in.parents[(size_t)child], i);
            in.parents[(size_t)child] = (int)i;
        }
    /* With one parent each, a cycle shows as a walk upwards that meets itself. */
    std::vector<size_t> seen_by(nodes.size(), SIZE_MAX);
    for (size_t i = 0; i < nodes.size(); i++)
        for (int at = (int)i; at >= 0 && seen_by[(size_t)at] != i; at = in.parents[(size_t)at]) {
            if (seen_by[(size_t)at] != SIZE_MAX)
                break;
            seen_by[(size_t)at] = i;
            int parent = in.parents[(size_t)at];
            if (parent >= 0 && seen_by[(size_t)parent] == i)
                gltf_fail(STATUS_INVALID, "%s is its own ancestor", in.node_name((size_t)parent).c_str());
        }
}

/* The nodes of the default scene, or of all roots where the file has no scenes. */
static std::vector<bool> find_reachable(importer &in)
{
    const tinygltf::Model &model = in.model();
    std::vector<bool> is_reachable(model.nodes.size(), false);
    std::vector<int> stack;
    if (model.scenes.empty()) {
        for (size_t i = 0; i < model.nodes.size(); i++)
            if (in.parents[i] < 0)
                stack.push_back((int)i);
    } else {
        int index = model.defaultScene < 0 ? 0 : model.defaultScene;
        if ((size_t)index >= model.scenes.size())
            gltf_fail(STATUS_INVALID, "there is no scene %d to begin with", index);
        if (model.scenes.size() > 1)
            scene_builder_warn(in.builder, "only scene %d of %zu is imported", index, model.scenes.size());
        for (int root : model.scenes[(size_t)index].nodes) {
            if (root < 0 || (size_t)root >= model.nodes.size())
                gltf_fail(STATUS_INVALID, "scene %d: there is no node %d", index, root);
            if (in.parents[(size_t)root] >= 0)
                gltf_fail(STATUS_INVALID, "scene %d: %s is no root, it has a parent", index,
                          in.node_name((size_t)root).c_str());
            stack.push_back(root);
        }
    }
    while (!stack.empty()) {
        size_t node = (size_t)stack.back();
        stack.pop_back();
        if (is_reachable[node])
            continue;
        is_reachable[node] = true;
        stack.insert(stack.end(), model.nodes[node].children.begin(), model.nodes[node].children.end());
    }
    return is_reachable;
}

static void copy_finite(const importer &in, size_t node, const std::vector<double> &values, size_t count,
                        const char *what, float *out)
{
    if (values.empty())
        return;
    if (values.size() != count)
        gltf_fail(STATUS_INVALID, "%s: its %s has %zu numbers, not %zu", in.node_name(node).c_str(), what,
                  values.size(), count);
    for (size_t i = 0; i < count; i++) {
        out[i] = (float)values[i];
        if (!std::isfinite(out[i]))
            gltf_fail(STATUS_INVALID, "%s: its %s is not finite", in.node_name(node).c_str(), what);
    }
}

static scene_node read_node(const importer &in, size_t index, uint32_t parent)
{
    const tinygltf::Node &source = in.model().nodes[index];
    scene_node node = scene_node_default(source.name.c_str(), parent);
    node.has_matrix = !source.matrix.empty();
    copy_finite(in, index, source.matrix, 16, "matrix", node.matrix);
    copy_finite(in, index, source.translation, 3, "translation", node.translation);
    copy_finite(in, index, source.rotation, 4, "rotation", node.rotation);
    copy_finite(in, index, source.scale, 3, "scale", node.scale);
    if (node.has_matrix &&
        (node.matrix[3] != 0 || node.matrix[7] != 0 || node.matrix[11] != 0 || node.matrix[15] != 1))
        gltf_fail(STATUS_INVALID, "%s: its matrix is not affine, its last row is %g %g %g %g",
                  in.node_name(index).c_str(), (double)node.matrix[3], (double)node.matrix[7],
                  (double)node.matrix[11], (double)node.matrix[15]);
    double squared = 0;
    for (float part : node.rotation)
        squared += (double)part * (double)part;
    if (!(squared > 1e-12))
        gltf_fail(STATUS_INVALID, "%s: its rotation is zero", in.node_name(index).c_str());
    /* A unit quaternion stays bit for bit. */
    if (std::fabs(squared - 1) > 1e-5)
        for (float &part : node.rotation)
            part = (float)((double)part / std::sqrt(squared));
    return node;
}

/* In the document's order, except that a parent comes before its children. */
static void add_nodes(importer &in)
{
    std::vector<bool> is_reachable = find_reachable(in);
    in.scene_nodes.assign(in.model().nodes.size(), SCENE_NONE);
    std::vector<size_t> chain;
    for (size_t i = 0; i < in.scene_nodes.size(); i++) {
        if (!is_reachable[i])
            continue;
        chain.clear();
        for (int at = (int)i; at >= 0 && in.scene_nodes[(size_t)at] == SCENE_NONE;
             at = in.parents[(size_t)at])
            chain.push_back((size_t)at);
        for (size_t j = chain.size(); j-- > 0;) {
            int parent = in.parents[chain[j]];
            scene_node node =
                read_node(in, chain[j], parent < 0 ? SCENE_NONE : in.scene_nodes[(size_t)parent]);
            in.scene_nodes[chain[j]] = scene_builder_node(in.builder, &node);
        }
    }
}

/* ---- lights and cameras ------------------------------------------------------------------------------- */

/* `extras.radius` of the light, or of the node that holds it, which goes before: a sphere of a point light, a
 * disk of a spot light. */
static void read_radius(importer &in, size_t node, const tinygltf::Light &source, const std::string &what,
                        scene_light &light)
{
    tinygltf::Value value;
    for (const tinygltf::Value *extras : {&source.extras, &in.model().nodes[node].extras})
        if (extras->IsObject() && extras->Has("radius"))
            value = extras->Get("radius");
    if (value.Type() == tinygltf::NULL_TYPE)
        return;
    if (!value.IsNumber() || light.type == LIGHT_DIRECTIONAL) {
        scene_builder_warn(in.builder, "%s: its radius is ignored, %s", what.c_str(),
                           value.IsNumber() ? "a directional light has none" : "it is no number");
        return;
    }
    double radius = value.GetNumberAsDouble();
    double inside = radius >= 0 ? std::fmin(radius, SCENE_MAX_LIGHT_RADIUS) : 0;
    if (inside != radius)
        scene_builder_warn(in.builder, "%s: its radius is %g; %g is used, the nearest it may be",
                           what.c_str(), radius, inside);
    if (!((float)inside > 0))
        return;
    light.shape = light.type == LIGHT_POINT ? LIGHT_SHAPE_SPHERE : LIGHT_SHAPE_DISK;
    light.half_size[0] = light.half_size[1] = (float)inside;
}

static void add_light(importer &in, size_t node, int index)
{
    const tinygltf::Model &model = in.model();
    if (index < 0 || (size_t)index >= model.lights.size())
        gltf_fail(STATUS_INVALID, "%s: there is no light %d", in.node_name(node).c_str(), index);
    const tinygltf::Light &source = model.lights[(size_t)index];
    std::string what = "light " + (source.name.empty() ? std::to_string(index) : gltf_quoted(source.name));
    scene_light light = {};
    scene_name_copy(light.name, source.name.empty() ? model.nodes[node].name.c_str() : source.name.c_str());
    light.node = in.scene_nodes[node];
    if (source.type == "point")
        light.type = LIGHT_POINT;
    else if (source.type == "spot")
        light.type = LIGHT_SPOT;
    else if (source.type == "directional")
        light.type = LIGHT_DIRECTIONAL;
    else
        gltf_fail(STATUS_INVALID, "%s has the type %s", what.c_str(), gltf_quoted(source.type).c_str());
    if (!source.color.empty() && source.color.size() != 3)
        gltf_fail(STATUS_INVALID, "%s: its colour has %zu numbers, not 3", what.c_str(), source.color.size());
    for (size_t i = 0; i < 3; i++) {
        double value = (source.color.empty() ? 1 : source.color[i]) * source.intensity;
        if (!(value >= 0 && value <= 1e12))
            gltf_fail(STATUS_INVALID, "%s: an intensity of %g is outside 0 to 1e12", what.c_str(), value);
        light.intensity[i] = (float)value;
    }
    if (light.type == LIGHT_SPOT) {
        double inner = source.spot.innerConeAngle, outer = source.spot.outerConeAngle;
        /* Not `outer > pi / 2`: a file's pi / 2 may be a float rounded up. */
        if (!(inner >= 0 && inner < outer && outer <= pi / 2 + 1e-6))
            gltf_fail(STATUS_INVALID, "%s: cone angles of %g and %g; 0 <= inner < outer <= pi/2",
                      what.c_str(), inner, outer);
        light.outer_cone = std::fmin((float)outer, (float)(pi / 2));
        light.inner_cone = (float)inner;
        /* Cones closer than a float can tell apart would divide by zero. */
        if (!(light.inner_cone < light.outer_cone))
            light.inner_cone = std::nextafter(light.outer_cone, 0.0f);
    }
    read_radius(in, node, source, what, light);
    if (source.range > 0)
        scene_builder_warn(in.builder, "%s: its range is ignored, its light never ends", what.c_str());
    scene_builder_light(in.builder, &light);
}

static void add_camera(importer &in, size_t node, int index)
{
    const tinygltf::Model &model = in.model();
    if (index < 0 || (size_t)index >= model.cameras.size())
        gltf_fail(STATUS_INVALID, "%s: there is no camera %d", in.node_name(node).c_str(), index);
    const tinygltf::Camera &source = model.cameras[(size_t)index];
    std::string what = "camera " + (source.name.empty() ? std::to_string(index) : gltf_quoted(source.name));
    if (source.type != "perspective") {
        scene_builder_warn(in.builder, "%s is not a perspective camera and is left out", what.c_str());
        return;
    }
    scene_camera camera = {};
    scene_name_copy(camera.name, source.name.empty() ? model.nodes[node].name.c_str() : source.name.c_str());
    camera.node = in.scene_nodes[node];
    if (!(source.perspective.yfov > 1e-4 && source.perspective.yfov < pi - 1e-3))
        gltf_fail(STATUS_INVALID, "%s: a vertical field of view of %g radians", what.c_str(),
                  source.perspective.yfov);
    camera.yfov = (float)source.perspective.yfov;
    double aspect = source.perspective.aspectRatio;
    camera.aspect = aspect > 1e-3 && aspect < 1e3 ? (float)aspect : 0;
    scene_builder_camera(in.builder, &camera);
}

static void add_contents(importer &in, gltf_meshes &meshes)
{
    for (size_t i = 0; i < in.scene_nodes.size(); i++) {
        if (in.scene_nodes[i] == SCENE_NONE)
            continue;
        const tinygltf::Node &node = in.model().nodes[i];
        if (node.mesh >= 0)
            for (uint32_t mesh : meshes.get(node.mesh, in.node_name(i)))
                scene_builder_instance(in.builder, in.scene_nodes[i], mesh);
        if (node.skin >= 0)
            scene_builder_warn(in.builder, "%s: its skin is ignored, the mesh does not bend",
                               in.node_name(i).c_str());
        if (node.camera >= 0)
            add_camera(in, i, node.camera);
        auto light = node.extensions.find("KHR_lights_punctual");
        if (light != node.extensions.end() && light->second.IsObject() && light->second.Has("light"))
            add_light(in, i, light->second.Get("light").GetNumberAsInt());
        if (node.extensions.count("EXT_mesh_gpu_instancing"))
            gltf_fail(STATUS_UNSUPPORTED, "%s uses EXT_mesh_gpu_instancing, which is not supported",
                      in.node_name(i).c_str());
    }
}

/* ---- animation ---------------------------------------------------------------------------------------- */

/* A key's values as malloc'ed floats: the scene frees them. */
static float *copy_floats(const std::vector<float> &values)
{
    float *copy = (float *)malloc(values.size() * sizeof(float));
    if (!copy)
        throw std::bad_alloc();
    memcpy(copy, values.data(), values.size() * sizeof(float));
    return copy;
}

static void add_channel(importer &in, const tinygltf::Animation &animation,
                        const tinygltf::AnimationChannel &source, const std::string &what, size_t &keys_left)
{
    const std::string &path = source.target_path;
    if (source.target_node < 0 || path == "weights" || path == "pointer") {
        scene_builder_warn(in.builder, "%s: it animates %s, which is ignored", what.c_str(),
                           path == "weights" ? "morph weights" : "no node");
        return;
    }
    if ((size_t)source.target_node >= in.model().nodes.size())
        gltf_fail(STATUS_INVALID, "%s: there is no node %d", what.c_str(), source.target_node);
    if (source.sampler < 0 || (size_t)source.sampler >= animation.samplers.size())
        gltf_fail(STATUS_INVALID, "%s: there is no sampler %d", what.c_str(), source.sampler);
    const tinygltf::AnimationSampler &sampler = animation.samplers[(size_t)source.sampler];
    scene_channel channel = {};
    channel.node = in.scene_nodes[(size_t)source.target_node];
    if (channel.node == SCENE_NONE)
        return;
    if (!scene_builder_ok(in.builder))
        return;
    if (in.builder->scene->nodes[channel.node].has_matrix) {
        scene_builder_warn(in.builder, "%s: %s has a matrix and cannot be animated", what.c_str(),
                           in.node_name((size_t)source.target_node).c_str());
        return;
    }
    if (path == "translation")
        channel.path = ANIMATION_TRANSLATION;
    else if (path == "rotation")
        channel.path = ANIMATION_ROTATION;
    else if (path == "scale")
        channel.path = ANIMATION_SCALE;
    else
        gltf_fail(STATUS_INVALID, "%s: there is no path %s", what.c_str(), gltf_quoted(path).c_str());
    if (sampler.interpolation == "STEP")
        channel.interpolation = ANIMATION_STEP;
    else if (sampler.interpolation == "CUBICSPLINE")
        channel.interpolation = ANIMATION_CUBIC;
    else if (sampler.interpolation.empty() || sampler.interpolation == "LINEAR")
        channel.interpolation = ANIMATION_LINEAR;
    else
        gltf_fail(STATUS_INVALID, "%s: there is no interpolation %s", what.c_str(),
                  gltf_quoted(sampler.interpolation).c_str());

    std::vector<float> times =
        gltf_read_floats(in.document, sampler.input, TINYGLTF_TYPE_SCALAR, keys_left, what + ", input");
    for (size_t i = 0; i < times.size(); i++)
        if (!std::isfinite(times[i]) || times[i] < 0 || (i > 0 && times[i] <= times[i - 1]))
            gltf_fail(STATUS_INVALID,
                      "%s, key %zu: its time %g is negative, not finite or not after the one before",
                      what.c_str(), i, (double)times[i]);
    size_t per_key = channel.interpolation == ANIMATION_CUBIC ? 3 : 1;
    std::vector<float> values =
        gltf_read_floats(in.document, sampler.output,
                         channel.path == ANIMATION_ROTATION ? TINYGLTF_TYPE_VEC4 : TINYGLTF_TYPE_VEC3,
                         3 * max_keys, what + ", output");
    size_t width = channel.path == ANIMATION_ROTATION ? 4 : 3;
    if (values.size() != times.size() * per_key * width)
        gltf_fail(STATUS_INVALID, "%s: %zu output values for %zu keys", what.c_str(), values.size() / width,
                  times.size());
    for (size_t i = 0; i < values.size(); i++)
        if (!std::isfinite(values[i]))
            gltf_fail(STATUS_INVALID, "%s, key %zu: its value is not finite", what.c_str(),
                      i / (width * per_key));
    if (!in.animated.insert({channel.node, channel.path}).second) {
        scene_builder_warn(in.builder, "%s: %s of %s is animated twice, the first one is used", what.c_str(),
                           path.c_str(), in.node_name((size_t)source.target_node).c_str());
        return;
    }
    keys_left -= times.size();
    channel.key_count = (uint32_t)times.size();
    channel.times = copy_floats(times);
    try {
        channel.values = copy_floats(values);
    } catch (...) {
        free(channel.times);
        throw;
    }
    scene_builder_channel(in.builder, &channel);
}

static void add_animations(importer &in)
{
    size_t keys_left = max_keys;
    const std::vector<tinygltf::Animation> &animations = in.model().animations;
    if (animations.size() > 1)
        scene_builder_warn(in.builder, "%zu animations are played together", animations.size());
    for (size_t i = 0; i < animations.size(); i++)
        for (size_t j = 0; j < animations[i].channels.size(); j++)
            add_channel(in, animations[i], animations[i].channels[j],
                        "animation " + std::to_string(i) + ", channel " + std::to_string(j), keys_left);
}

/* ---- the whole ---------------------------------------------------------------------------------------- */

static void fill(gltf_document &document, scene_builder *builder)
{
    for (const std::string &warning : document.warnings)
        scene_builder_warn(builder, "%s", warning.c_str());
    importer in = {document, builder, {}, {}, {}};
    find_parents(in);
    add_nodes(in);
    gltf_meshes meshes(document, builder, gltf_add_materials(document, document.folder, builder));
    add_contents(in, meshes);
    add_animations(in);
    scene_drop_collapsed(builder);
    scene_warn_coarse(builder);
    scene_add_emissive_lights(builder);
}

/* Nothing of C++ leaves through here, neither an exception nor an allocation. */
template <typename Parse> static struct scene *import_with(const char *name, Parse parse, struct error *error)
{
    scene_builder builder = {};
    enum status status = STATUS_INVALID;
    std::string message;
    try {
        gltf_document document;
        parse(document);
        scene_builder_begin(&builder, name);
        if (scene_builder_ok(&builder))
            fill(document, &builder);
        struct error reason;
        struct scene *scene = scene_builder_finish(&builder, &reason);
        if (scene)
            return scene;
        status = reason.status;
        message = reason.message;
    } catch (const gltf_error &problem) {
        status = problem.status;
        message = problem.message;
    } catch (const std::bad_alloc &) {
        status = STATUS_MEMORY;
        message = "out of memory";
    } catch (const std::exception &problem) {
        message = std::string("the glTF is malformed: ") + problem.what();
    }
    scene_builder_abandon(&builder);
    error_set(error, status, "scene %s: %s", gltf_quoted(name).c_str(), message.c_str());
    return NULL;
}

extern "C" struct scene *scene_import_memory(const void *bytes, size_t size, struct error *error)
{
    return import_with(
        "memory", [&](gltf_document &document) { gltf_parse(document, (const unsigned char *)bytes, size); },
        error);
}

extern "C" struct scene *scene_import(const char *path, struct error *error)
{
    const char *slash = strrchr(path, '/');
    return import_with(
        slash ? slash + 1 : path,
        [&](gltf_document &document) {
            char *resolved = realpath(path, nullptr);
            if (!resolved)
                gltf_fail(STATUS_NOT_FOUND, "cannot open %s: %s", gltf_quoted(path).c_str(), strerror(errno));
            std::string real = resolved;
            free(resolved);
            document.folder = gltf_folder(real.substr(0, real.rfind('/')));
            std::vector<unsigned char> bytes = gltf_read_file(real);
            gltf_parse(document, bytes.data(), bytes.size());
        },
        error);
}
