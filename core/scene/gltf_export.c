/* Writes a GLB that scene_import reads back as the same scene: the same bits in vertices, indices,
 * transforms, keys and light intensities. Stand-ins for emissive meshes are not written; importing makes them
 * again. Textures are not written either: a scene holds them decoded, and the material keeps its factors. */
#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "scene.h"

enum { COMPONENT_UINT = 5125, COMPONENT_FLOAT = 5126, TARGET_VERTICES = 34962, TARGET_INDICES = 34963 };

/* The binary chunk grows as accessors are added; each has a buffer view of its own. */
struct writer {
    unsigned char *bytes;
    size_t size, capacity;
    json_t *views, *accessors;
    bool has_failed;
};

static void *append(struct writer *writer, size_t size)
{
    if (writer->has_failed)
        return NULL;
    if (size > writer->capacity - writer->size) {
        size_t wanted = writer->capacity * 2 + size;
        unsigned char *larger = realloc(writer->bytes, wanted);
        if (!larger) {
            writer->has_failed = true;
            return NULL;
        }
        writer->bytes = larger;
        writer->capacity = wanted;
    }
    unsigned char *room = writer->bytes + writer->size;
    writer->size += size;
    return room;
}

static int component_count(const char *type)
{
    return !strcmp(type, "SCALAR") ? 1 : !strcmp(type, "VEC2") ? 2 : !strcmp(type, "VEC3") ? 3 : 4;
}

/* Takes 4-byte components from elements `stride` bytes apart. Returns the accessor's index. */
static json_int_t add_accessor(struct writer *writer, const void *values, size_t stride, size_t count,
                               int component, const char *type, int target, const float *minimum,
                               const float *maximum)
{
    size_t width = 4 * (size_t)component_count(type), start = writer->size;
    unsigned char *room = append(writer, count * width);
    for (size_t i = 0; room && i < count; i++)
        memcpy(room + i * width, (const char *)values + i * stride, width);
    json_t *view = json_pack("{s:i, s:I, s:I}", "buffer", 0, "byteOffset", (json_int_t)start, "byteLength",
                             (json_int_t)(count * width));
    if (target)
        json_object_set_new(view, "target", json_integer(target));
    json_array_append_new(writer->views, view);
    json_t *accessor =
        json_pack("{s:I, s:i, s:I, s:s}", "bufferView", (json_int_t)json_array_size(writer->views) - 1,
                  "componentType", component, "count", (json_int_t)count, "type", type);
    for (int end = 0; minimum && maximum && end < 2; end++) {
        json_t *list = json_array();
        for (int i = 0; i < component_count(type); i++)
            json_array_append_new(list, json_real((double)(end ? maximum : minimum)[i]));
        json_object_set_new(accessor, end ? "max" : "min", list);
    }
    json_array_append_new(writer->accessors, accessor);
    return (json_int_t)json_array_size(writer->accessors) - 1;
}

static json_t *float_list(const float *values, size_t count)
{
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++)
        json_array_append_new(list, json_real((double)values[i]));
    return list;
}

static void set_name(json_t *object, const char *name)
{
    /* A name cut from hostile bytes may be no UTF-8; then it is left out. */
    json_t *string = *name ? json_string(name) : NULL;
    if (string)
        json_object_set_new(object, "name", string);
}

/* The member, made an empty object or list when it is not there. */
static json_t *member(json_t *object, const char *name, bool is_list)
{
    json_t *found = json_object_get(object, name);
    if (!found) {
        found = is_list ? json_array() : json_object();
        json_object_set_new(object, name, found);
    }
    return found;
}

/* ---- materials, meshes -------------------------------------------------------------------------------- */

static json_t *pack_material(const struct scene_material *material)
{
    const float *color = material->base_color;
    json_t *object = json_pack("{s:{s:[f,f,f,f], s:f, s:f}}", "pbrMetallicRoughness", "baseColorFactor",
                               (double)color[0], (double)color[1], (double)color[2], 1.0, "metallicFactor",
                               (double)material->metallic, "roughnessFactor", (double)material->roughness);
    set_name(object, material->name);
    if (material->double_sided)
        json_object_set_new(object, "doubleSided", json_true());
    float strongest = fmaxf(material->emission[0], fmaxf(material->emission[1], material->emission[2]));
    if (strongest > 0) {
        /* The factor may not pass 1, the strength may; a power of two divides without rounding. */
        int exponent = 0;
        frexpf(strongest, &exponent);
        float strength = exponent > 0 ? ldexpf(1, exponent) : 1;
        const float factor[3] = {material->emission[0] / strength, material->emission[1] / strength,
                                 material->emission[2] / strength};
        json_object_set_new(object, "emissiveFactor", float_list(factor, 3));
        if (strength > 1)
            json_object_set_new(member(object, "extensions", false), "KHR_materials_emissive_strength",
                                json_pack("{s:f}", "emissiveStrength", (double)strength));
    }
    if (material->transmission > 0)
        json_object_set_new(member(object, "extensions", false), "KHR_materials_transmission",
                            json_pack("{s:f}", "transmissionFactor", (double)material->transmission));
    if (material->transmission > 0 || material->ior != 1.5f)
        json_object_set_new(member(object, "extensions", false), "KHR_materials_ior",
                            json_pack("{s:f}", "ior", (double)material->ior));
    if (material->dispersion > 0)
        json_object_set_new(member(object, "extensions", false), "KHR_materials_dispersion",
                            json_pack("{s:f}", "dispersion", (double)material->dispersion));
    if (material->kind == MATERIAL_DIELECTRIC) {
        json_t *volume = json_pack("{s:f}", "thicknessFactor", 1.0);
        if (material->attenuation_distance > 0) {
            json_object_set_new(volume, "attenuationDistance",
                                json_real((double)material->attenuation_distance));
            json_object_set_new(volume, "attenuationColor", float_list(material->attenuation_color, 3));
        }
        json_object_set_new(member(object, "extensions", false), "KHR_materials_volume", volume);
    }
    return object;
}

static json_t *pack_mesh(struct writer *writer, const struct scene *scene, const struct scene_mesh *mesh)
{
    const struct scene_vertex *vertices = scene->vertices + mesh->first_vertex;
    size_t stride = sizeof *vertices;
    json_int_t position =
        add_accessor(writer, vertices->position, stride, mesh->vertex_count, COMPONENT_FLOAT, "VEC3",
                     TARGET_VERTICES, mesh->bounds_min, mesh->bounds_max);
    json_int_t normal = add_accessor(writer, vertices->normal, stride, mesh->vertex_count, COMPONENT_FLOAT,
                                     "VEC3", TARGET_VERTICES, NULL, NULL);
    json_int_t uv = add_accessor(writer, vertices->uv, stride, mesh->vertex_count, COMPONENT_FLOAT, "VEC2",
                                 TARGET_VERTICES, NULL, NULL);
    json_int_t indices =
        add_accessor(writer, scene->indices + mesh->first_index, sizeof(uint32_t),
                     3 * (size_t)mesh->triangle_count, COMPONENT_UINT, "SCALAR", TARGET_INDICES, NULL, NULL);
    return json_pack("{s:{s:I, s:I, s:I}, s:I, s:I}", "attributes", "POSITION", position, "NORMAL", normal,
                     "TEXCOORD_0", uv, "indices", indices, "material", (json_int_t)mesh->material);
}

/* ---- nodes -------------------------------------------------------------------------------------------- */

/* Which node a stand-in light made: it is left out, and nothing hangs from it. */
static bool is_stand_in(const struct scene *scene, uint32_t node)
{
    for (uint32_t i = 0; i < scene->light_count; i++)
        if (scene->lights[i].is_emissive_mesh && scene->lights[i].node == node)
            return true;
    return false;
}

static json_t *pack_node(const struct scene_node *node)
{
    static const float identity[10] = {0, 0, 0, 0, 0, 0, 1, 1, 1, 1};
    json_t *object = json_object();
    set_name(object, node->name);
    if (node->has_matrix) {
        json_object_set_new(object, "matrix", float_list(node->matrix, 16));
        return object;
    }
    if (memcmp(node->translation, identity, sizeof node->translation) != 0)
        json_object_set_new(object, "translation", float_list(node->translation, 3));
    if (memcmp(node->rotation, identity + 3, sizeof node->rotation) != 0)
        json_object_set_new(object, "rotation", float_list(node->rotation, 4));
    if (memcmp(node->scale, identity + 7, sizeof node->scale) != 0)
        json_object_set_new(object, "scale", float_list(node->scale, 3));
    return object;
}

static void pack_lights(const struct scene *scene, json_t *root, json_t *const *nodes)
{
    static const char *const types[] = {"point", "spot", "directional"};
    json_t *list = json_array();
    for (uint32_t i = 0; i < scene->light_count; i++) {
        const struct scene_light *light = &scene->lights[i];
        if (light->is_emissive_mesh)
            continue;
        json_t *object = json_pack("{s:s, s:o, s:f}", "type", types[light->type], "color",
                                   float_list(light->intensity, 3), "intensity", 1.0);
        set_name(object, light->name);
        if (light->type == LIGHT_SPOT)
            json_object_set_new(object, "spot",
                                json_pack("{s:f, s:f}", "innerConeAngle", (double)light->inner_cone,
                                          "outerConeAngle", (double)light->outer_cone));
        if (light->shape != LIGHT_SHAPE_POINT)
            json_object_set_new(object, "extras", json_pack("{s:f}", "radius", (double)light->half_size[0]));
        json_object_set_new(member(nodes[light->node], "extensions", false), "KHR_lights_punctual",
                            json_pack("{s:I}", "light", (json_int_t)json_array_size(list)));
        json_array_append_new(list, object);
    }
    if (json_array_size(list))
        json_object_set_new(member(root, "extensions", false), "KHR_lights_punctual",
                            json_pack("{s:O}", "lights", list));
    json_decref(list);
}

static void pack_cameras(const struct scene *scene, json_t *root, json_t *const *nodes)
{
    for (uint32_t i = 0; i < scene->camera_count; i++) {
        const struct scene_camera *camera = &scene->cameras[i];
        json_t *lens = json_pack("{s:f, s:f}", "yfov", (double)camera->yfov, "znear", 0.01);
        if (camera->aspect > 0)
            json_object_set_new(lens, "aspectRatio", json_real((double)camera->aspect));
        json_t *object = json_pack("{s:s, s:o}", "type", "perspective", "perspective", lens);
        set_name(object, camera->name);
        json_object_set_new(nodes[camera->node], "camera", json_integer((json_int_t)i));
        json_array_append_new(member(root, "cameras", true), object);
    }
}

/* How many instances from `first` on belong to one node. */
static uint32_t run_length(const struct scene *scene, uint32_t first)
{
    uint32_t count = 1;
    while (first + count < scene->instance_count &&
           scene->instances[first + count].node == scene->instances[first].node)
        count++;
    return count;
}

static bool is_same_run(const struct scene *scene, uint32_t a, uint32_t b)
{
    uint32_t count = run_length(scene, a);
    bool is_same = count == run_length(scene, b);
    for (uint32_t i = 0; i < count && is_same; i++)
        is_same = scene->instances[a + i].mesh == scene->instances[b + i].mesh;
    return is_same;
}

/* A glTF mesh is all primitives of one node, so a node's instances become one mesh. Nodes that hold the same
 * scene meshes share it. */
static void pack_instances(struct writer *writer, const struct scene *scene, json_t *root,
                           json_t *const *nodes)
{
    /* Per scene mesh, the first run that begins with it, and the glTF mesh that was made of that. */
    uint32_t *runs = malloc(((size_t)scene->mesh_count + 1) * sizeof *runs);
    json_int_t *made = malloc(((size_t)scene->mesh_count + 1) * sizeof *made);
    writer->has_failed |= !runs || !made;
    for (uint32_t i = 0; runs && i < scene->mesh_count; i++)
        runs[i] = SCENE_NONE;
    for (uint32_t i = 0; !writer->has_failed && i < scene->instance_count; i += run_length(scene, i)) {
        uint32_t first_mesh = scene->instances[i].mesh;
        bool is_known = runs[first_mesh] != SCENE_NONE && is_same_run(scene, runs[first_mesh], i);
        json_int_t number = is_known ? made[first_mesh] : 0;
        if (!is_known) {
            json_t *primitives = json_array();
            for (uint32_t at = 0; at < run_length(scene, i); at++)
                json_array_append_new(
                    primitives, pack_mesh(writer, scene, &scene->meshes[scene->instances[i + at].mesh]));
            json_t *mesh = json_pack("{s:o}", "primitives", primitives);
            set_name(mesh, scene->meshes[first_mesh].name);
            json_t *meshes = member(root, "meshes", true);
            number = (json_int_t)json_array_size(meshes);
            json_array_append_new(meshes, mesh);
            if (runs[first_mesh] == SCENE_NONE) {
                runs[first_mesh] = i;
                made[first_mesh] = number;
            }
        }
        json_object_set_new(nodes[scene->instances[i].node], "mesh", json_integer(number));
    }
    free(runs);
    free(made);
}

static void pack_animation(struct writer *writer, const struct scene *scene, json_t *root,
                           const json_int_t *numbers)
{
    static const char *const paths[] = {"translation", "rotation", "scale"};
    static const char *const interpolations[] = {"STEP", "LINEAR", "CUBICSPLINE"};
    if (!scene->channel_count)
        return;
    json_t *samplers = json_array(), *channels = json_array();
    for (uint32_t i = 0; i < scene->channel_count; i++) {
        const struct scene_channel *channel = &scene->channels[i];
        size_t width = channel->path == ANIMATION_ROTATION ? 4 : 3;
        size_t per_key = channel->interpolation == ANIMATION_CUBIC ? 3 : 1;
        json_int_t input =
            add_accessor(writer, channel->times, sizeof(float), channel->key_count, COMPONENT_FLOAT, "SCALAR",
                         0, channel->times, channel->times + channel->key_count - 1);
        json_int_t output =
            add_accessor(writer, channel->values, width * sizeof(float), channel->key_count * per_key,
                         COMPONENT_FLOAT, width == 4 ? "VEC4" : "VEC3", 0, NULL, NULL);
        json_array_append_new(samplers, json_pack("{s:I, s:I, s:s}", "input", input, "output", output,
                                                  "interpolation", interpolations[channel->interpolation]));
        json_array_append_new(channels,
                              json_pack("{s:I, s:{s:I, s:s}}", "sampler", (json_int_t)i, "target", "node",
                                        numbers[channel->node], "path", paths[channel->path]));
    }
    json_object_set_new(root, "animations",
                        json_pack("[{s:o, s:o}]", "samplers", samplers, "channels", channels));
}

/* ---- the file ----------------------------------------------------------------------------------------- */

static void list_extensions(const struct scene *scene, json_t *root)
{
    bool has[6] = {false};
    static const char *const names[6] = {
        "KHR_lights_punctual", "KHR_materials_dispersion",   "KHR_materials_emissive_strength",
        "KHR_materials_ior",   "KHR_materials_transmission", "KHR_materials_volume"};
    has[0] = json_object_get(json_object_get(root, "extensions"), names[0]) != NULL;
    for (uint32_t i = 0; i < scene->material_count; i++)
        for (int at = 1; at < 6; at++)
            has[at] |= json_object_get(json_object_get(json_array_get(json_object_get(root, "materials"), i),
                                                       "extensions"),
                                       names[at]) != NULL;
    for (int at = 0; at < 6; at++)
        if (has[at])
            json_array_append_new(member(root, "extensionsUsed", true), json_string(names[at]));
}

static json_t *pack_scene(struct writer *writer, const struct scene *scene)
{
    json_t *root =
        json_pack("{s:{s:s, s:s}, s:i}", "asset", "version", "2.0", "generator", "causticd", "scene", 0);
    json_t **nodes = calloc((size_t)scene->node_count + 1, sizeof(json_t *));
    json_int_t *numbers = calloc((size_t)scene->node_count + 1, sizeof *numbers);
    if (!nodes || !numbers) {
        writer->has_failed = true;
        goto done;
    }
    for (uint32_t i = 0; i < scene->material_count; i++)
        json_array_append_new(member(root, "materials", true), pack_material(&scene->materials[i]));
    json_t *roots = json_array();
    json_object_set_new(root, "scenes", json_pack("[{s:O}]", "nodes", roots));
    for (uint32_t i = 0; i < scene->node_count; i++) {
        nodes[i] = pack_node(
            &scene->nodes[i]); /* a stand-in's is made and thrown away: it keeps the lists aligned */
        if (is_stand_in(scene, i))
            continue;
        json_t *list = member(root, "nodes", true);
        numbers[i] = (json_int_t)json_array_size(list);
        json_array_append(list, nodes[i]);
        uint32_t parent = scene->nodes[i].parent;
        json_array_append_new(parent == SCENE_NONE ? roots : member(nodes[parent], "children", true),
                              json_integer(numbers[i]));
    }
    if (!json_array_size(roots)) /* an empty list is not glTF */
        json_object_del(root, "scenes"), json_object_del(root, "scene");
    json_decref(roots);
    pack_instances(writer, scene, root, nodes);
    pack_lights(scene, root, nodes);
    pack_cameras(scene, root, nodes);
    pack_animation(writer, scene, root, numbers);
    list_extensions(scene, root);
    if (writer->size) {
        json_object_set(root, "bufferViews", writer->views);
        json_object_set(root, "accessors", writer->accessors);
        json_object_set_new(root, "buffers", json_pack("[{s:I}]", "byteLength", (json_int_t)writer->size));
    }
done:
    for (uint32_t i = 0; nodes && i < scene->node_count; i++)
        json_decref(nodes[i]);
    free(nodes);
    free(numbers);
    return root;
}

static void put_u32(FILE *file, size_t value)
{
    const unsigned char bytes[4] = {(unsigned char)value, (unsigned char)(value >> 8),
                                    (unsigned char)(value >> 16), (unsigned char)(value >> 24)};
    fwrite(bytes, 1, 4, file);
}

/* Under a name of its own, then renamed: the file is whole or absent. */
static bool write_glb(const char *path, const char *text, const struct writer *writer, struct error *error)
{
    size_t text_size = strlen(text), text_padding = (4 - text_size % 4) % 4,
           padding = (4 - writer->size % 4) % 4;
    size_t total = 20 + text_size + text_padding + (writer->size ? 8 + writer->size + padding : 0);
    if (total > SCENE_MAX_FILE_BYTES)
        return error_set(error, STATUS_LIMIT, "cannot write %s: %zu bytes; a scene's file has at most %llu",
                         path, total, (unsigned long long)SCENE_MAX_FILE_BYTES);
    char temporary[4096];
    if (snprintf(temporary, sizeof temporary, "%s.part%ld", path, (long)getpid()) >= (int)sizeof temporary)
        return error_set(error, STATUS_INVALID, "cannot write %.100s...: the path is too long", path);
    FILE *file = fopen(temporary, "wb");
    if (!file)
        return error_set(error, STATUS_IO, "cannot write %s: %s", path, strerror(errno));
    fwrite("glTF", 1, 4, file);
    put_u32(file, 2);
    put_u32(file, total);
    put_u32(file, text_size + text_padding);
    fwrite("JSON", 1, 4, file);
    fwrite(text, 1, text_size, file);
    fwrite("   ", 1, text_padding, file);
    if (writer->size) {
        put_u32(file, writer->size + padding);
        fwrite("BIN", 1, 4, file);
        fwrite(writer->bytes, 1, writer->size, file);
        fwrite("\0\0\0", 1, padding, file);
    }
    bool is_written = !ferror(file);
    is_written = fclose(file) == 0 && is_written;
    if (is_written && rename(temporary, path) == 0)
        return true;
    int reason = errno;
    remove(temporary);
    return error_set(error, STATUS_IO, "cannot write %s: %s", path, strerror(reason));
}

bool scene_export(const struct scene *scene, const char *path, struct error *error)
{
    struct writer writer = {.views = json_array(), .accessors = json_array()};
    json_t *root = pack_scene(&writer, scene);
    /* 9 digits are every bit of a float. */
    char *text = json_dumps(root, JSON_COMPACT | JSON_REAL_PRECISION(9));
    bool is_written;
    if (!text || writer.has_failed)
        is_written = error_set(error, STATUS_MEMORY, "out of memory for writing %s", path);
    else
        is_written = write_glb(path, text, &writer, error);
    free(text);
    json_decref(root);
    json_decref(writer.views);
    json_decref(writer.accessors);
    free(writer.bytes);
    return is_written;
}
