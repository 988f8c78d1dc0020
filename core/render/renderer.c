/* renderer.c: what the views of a scene share: geometry on the device, tracers, pipelines. */
#include "renderer.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../../shaders/shader_table.h"
#include "view_state.h"

#define BOXES_PER_CASTER 512u

const struct channel_info channel_infos[CHANNEL_COUNT] = {
    {"caustics", 3, "radiance from caustic light at directly visible receivers, W/(m^2 sr)"},
    {"irradiance", 3, "caustic irradiance at directly visible receivers, W/m^2"},
    {"beauty", 3, "direct light, emission, caustics and indirect, W/(m^2 sr)"},
    {"depth", 1, "distance to the first hit along the view axis, m; infinity where there is none"},
    {"normal", 3, "unit shading normal of the surface the pixel shows, through glass and mirrors"},
    {"albedo", 3, "base colour of the surface the pixel shows, through glass and mirrors"},
    {"indirect", 3, "radiance from caustic light seen through glass and mirrors, W/(m^2 sr)"},
    {"density", 1, "task buffers: photons per cell, one tile per light"},
    {"variance", 1, "task buffers: relative change of the picture, one tile per light"},
};

void renderer_destroy(struct renderer **renderer)
{
    struct renderer *r = *renderer;
    if (!r)
        return;
    for (uint32_t i = 0; i < r->pipeline_count; i++)
        gpu_pipeline_destroy(&r->pipelines[i].pipeline);
    for (uint32_t i = 0; r->bottoms && i < r->scene->mesh_count; i++)
        gpu_accel_destroy(&r->bottoms[i]);
    gpu_accel_destroy(&r->top);
    for (uint32_t i = 0; r->trees && i < r->scene->mesh_count; i++)
        bvh_destroy(&r->trees[i]);
    struct gpu_buffer **buffers[] = {&r->nodes,    &r->triangles, &r->more_triangles, &r->instances,
                                     &r->vertices, &r->indices,   &r->materials,      &r->texels};
    for (size_t i = 0; i < sizeof buffers / sizeof *buffers; i++)
        gpu_buffer_destroy(buffers[i]);
    scene_pose_destroy(&r->pose);
    solids_free(&r->solids);
    free(r->bottoms);
    free(r->trees);
    free(r->tree_node);
    free(r->tree_triangle);
    free(r->mesh_boxes);
    free(r->mesh_islands);
    free(r->casters);
    free(r->mesh_first_box);
    free(r->mesh_box_count);
    free(r->instance_data);
    free(r->caster_boxes);
    free(r);
    *renderer = NULL;
}

static bool check_device_size(const struct renderer *r, const char *what, size_t bytes, struct error *error)
{
    uint64_t most = gpu_info(r->gpu)->max_storage_bytes;
    if (bytes <= most)
        return true;
    return error_set(error, STATUS_LIMIT,
                     "%s of scene '%s' need %zu MiB; this device takes %llu MiB in one buffer", what,
                     r->scene->name, bytes >> 20, (unsigned long long)(most >> 20));
}

static bool upload_vertices(struct renderer *r, struct error *error)
{
    const struct scene *scene = r->scene;
    bool is_khr = r->tracer == TRACER_KHR;
    size_t vertex_bytes = scene->vertex_count * sizeof(struct scene_vertex_gpu);
    size_t index_bytes = scene->index_count * sizeof(uint32_t);
    if (!check_device_size(r, "the vertices", vertex_bytes, error) ||
        !check_device_size(r, "the indices", index_bytes, error))
        return false;
    struct scene_vertex_gpu *vertices = malloc(vertex_bytes + 1);
    uint32_t *indices = malloc(index_bytes + 1);
    if (vertices && indices) {
        for (uint32_t i = 0; i < scene->vertex_count; i++) {
            const struct scene_vertex *v = &scene->vertices[i];
            vertices[i].position_u = (vec4){v->position[0], v->position[1], v->position[2], v->uv[0]};
            vertices[i].normal_v = (vec4){v->normal[0], v->normal[1], v->normal[2], v->uv[1]};
        }
        if (index_bytes > 0)
            memcpy(indices, scene->indices, index_bytes);
        for (uint32_t m = 0; m < scene->mesh_count; m++) {
            const struct scene_mesh *mesh = &scene->meshes[m];
            for (uint32_t i = 0; i < 3 * mesh->triangle_count; i++)
                indices[mesh->first_index + i] += mesh->first_vertex;
        }
        r->vertices = gpu_buffer_create_filled(r->gpu, "vertices", vertices, vertex_bytes, is_khr, error);
        if (r->vertices)
            r->indices = gpu_buffer_create_filled(r->gpu, "indices", indices, index_bytes, is_khr, error);
    } else
        error_set(error, STATUS_MEMORY, "out of memory for scene '%s'", scene->name);
    free(vertices);
    free(indices);
    return r->indices != NULL;
}

static uint32_t image_place(const struct scene *scene, uint32_t image)
{
    uint64_t first = 0;
    for (uint32_t i = 0; i < image; i++)
        first += (uint64_t)scene->images[i].width * scene->images[i].height;
    return (uint32_t)first;
}

static bool upload_materials(struct renderer *r, struct error *error)
{
    const struct scene *scene = r->scene;
    struct material_gpu *materials = calloc(scene->material_count + 1, sizeof *materials);
    if (!materials)
        return error_set(error, STATUS_MEMORY, "out of memory for %u materials", scene->material_count);
    for (uint32_t i = 0; i < scene->material_count; i++) {
        const struct scene_material *m = &scene->materials[i];
        struct material_gpu *g = &materials[i];
        g->kind = (uint32_t)m->kind;
        g->color_ior = (vec4){m->base_color[0], m->base_color[1], m->base_color[2], m->ior};
        float sigma[3] = {0, 0, 0};
        for (int k = 0; k < 3; k++)
            if (m->attenuation_distance > 0 && m->attenuation_color[k] < 1)
                sigma[k] = -logf(fmaxf(m->attenuation_color[k], 1e-6f)) / m->attenuation_distance;
        g->absorption = (vec4){sigma[0], sigma[1], sigma[2], m->roughness};
        float cauchy = m->dispersion * (m->ior - 1) / (20 * DISPERSION_F_TO_C);
        g->emission = (vec4){m->emission[0], m->emission[1], m->emission[2], cauchy};
        g->color_first = g->emission_first = NONE;
        g->flags = (uint32_t)r->solids.number[i] << 8 | r->solids.material[i] << 16;
        if (m->base_color_image != SCENE_NONE) {
            const struct scene_image *image = &scene->images[m->base_color_image];
            g->color_first = image_place(scene, m->base_color_image);
            g->color_width = image->width;
            g->color_height = image->height;
            g->flags |= (image->clamp_u ? 1u : 0u) | (image->clamp_v ? 2u : 0u);
        }
        if (m->emission_image != SCENE_NONE) {
            const struct scene_image *image = &scene->images[m->emission_image];
            g->emission_first = image_place(scene, m->emission_image);
            g->emission_width = image->width;
            g->emission_height = image->height;
            g->flags |= (image->clamp_u ? 4u : 0u) | (image->clamp_v ? 8u : 0u);
        }
    }
    r->materials = gpu_buffer_create_filled(r->gpu, "materials", materials,
                                            scene->material_count * sizeof *materials, false, error);
    free(materials);
    if (!r->materials)
        return false;
    size_t texel_bytes = (size_t)image_place(scene, scene->image_count) * 8;
    if (!check_device_size(r, "the images", texel_bytes, error))
        return false;
    char *texels = malloc(texel_bytes + 1), *at = texels;
    if (!texels)
        return error_set(error, STATUS_MEMORY, "out of memory for %zu MiB of images", texel_bytes >> 20);
    for (uint32_t i = 0; i < scene->image_count; i++) {
        size_t bytes = (size_t)scene->images[i].width * scene->images[i].height * 8;
        memcpy(at, scene->images[i].texels, bytes);
        at += bytes;
    }
    r->texels = gpu_buffer_create_filled(r->gpu, "texels", texels, texel_bytes, false, error);
    free(texels);
    return r->texels != NULL;
}

static bool is_caster_mesh(const struct scene *scene, uint32_t mesh)
{
    return scene->materials[scene->meshes[mesh].material].kind != MATERIAL_DIFFUSE;
}

/* Orders boxes by island: those that touch, directly or through others, hold one connected surface and get
 * one number. A mesh may hold many glasses that lie far apart. */
static void boxes_by_island(float (*boxes)[6], uint32_t *islands, uint32_t count)
{
    float all[BOXES_PER_CASTER][6];
    uint32_t number_of[BOXES_PER_CASTER], reached[BOXES_PER_CASTER], sorted = 0, number = 0;
    memcpy(all, boxes, count * sizeof *boxes);
    for (uint32_t i = 0; i < count; i++)
        number_of[i] = SCENE_NONE;
    for (uint32_t first = 0; first < count; first++) {
        if (number_of[first] != SCENE_NONE)
            continue;
        uint32_t end = 0;
        reached[end++] = first;
        number_of[first] = number;
        for (uint32_t at = 0; at < end; at++) {
            const float *a = all[reached[at]];
            for (uint32_t i = 0; i < count; i++) {
                const float *b = all[i];
                if (number_of[i] == SCENE_NONE && a[0] <= b[3] && b[0] <= a[3] && a[1] <= b[4] &&
                    b[1] <= a[4] && a[2] <= b[5] && b[2] <= a[5]) {
                    number_of[i] = number;
                    reached[end++] = i;
                }
            }
        }
        for (uint32_t i = first; i < count; i++)
            if (number_of[i] == number) {
                memcpy(boxes[sorted], all[i], sizeof *boxes);
                islands[sorted++] = number;
            }
        number++;
    }
}

/* Trees of all meshes for the bvh tracer; of casters only, for their bounds, when the device traces itself.
 */
static bool build_trees(struct renderer *r, struct error *error)
{
    const struct scene *scene = r->scene;
    uint32_t count = scene->mesh_count;
    r->trees = calloc(count + 1, sizeof *r->trees);
    r->tree_node = calloc(count + 1, sizeof *r->tree_node);
    r->tree_triangle = calloc(count + 1, sizeof *r->tree_triangle);
    r->mesh_boxes = calloc((size_t)(count + 1) * BOXES_PER_CASTER, sizeof *r->mesh_boxes);
    r->mesh_islands = calloc((size_t)(count + 1) * BOXES_PER_CASTER, sizeof *r->mesh_islands);
    r->mesh_first_box = calloc(count + 1, sizeof *r->mesh_first_box);
    r->mesh_box_count = calloc(count + 1, sizeof *r->mesh_box_count);
    if (!r->trees || !r->tree_node || !r->tree_triangle || !r->mesh_boxes || !r->mesh_islands ||
        !r->mesh_first_box || !r->mesh_box_count)
        return error_set(error, STATUS_MEMORY, "out of memory for the trees of %u meshes", count);
    uint32_t casters = 0;
    for (uint32_t i = 0; i < scene->instance_count; i++)
        casters += is_caster_mesh(scene, scene->instances[i].mesh);
    uint32_t share = casters ? MAX_CASTER_BOXES / casters : 1;
    share = share < 1 ? 1 : share > BOXES_PER_CASTER ? BOXES_PER_CASTER : share;
    uint32_t nodes = r->top_node_capacity, triangles = 0, boxes = 0;
    for (uint32_t m = 0; m < count; m++) {
        if (r->tracer == TRACER_KHR && !is_caster_mesh(scene, m))
            continue;
        r->trees[m] = bvh_create_mesh(scene, m, error);
        if (!r->trees[m])
            return false;
        r->tree_node[m] = nodes;
        r->tree_triangle[m] = triangles;
        nodes += r->trees[m]->node_count;
        triangles += r->trees[m]->item_count;
        if (is_caster_mesh(scene, m)) {
            r->mesh_first_box[m] = boxes;
            r->mesh_box_count[m] = bvh_frontier(r->trees[m], r->mesh_boxes + boxes, share);
            boxes_by_island(r->mesh_boxes + boxes, r->mesh_islands + boxes, r->mesh_box_count[m]);
            boxes += r->mesh_box_count[m];
        }
    }
    return true;
}

/* Into one buffer, or into two where the device takes no larger one. */
static bool upload_triangles(struct renderer *r, const struct bvh_triangle *triangles, size_t count,
                             struct error *error)
{
    size_t first = (size_t)(gpu_info(r->gpu)->max_storage_bytes / sizeof *triangles);
    if (count <= first)
        first = count;
    else
        r->first_triangles = (uint32_t)first;
    r->triangles =
        gpu_buffer_create_filled(r->gpu, "bvh triangles", triangles, first * sizeof *triangles, false, error);
    if (r->triangles && count > first)
        r->more_triangles = gpu_buffer_create_filled(r->gpu, "more bvh triangles", triangles + first,
                                                     (count - first) * sizeof *triangles, false, error);
    return r->triangles && (r->more_triangles || count == first);
}

static bool upload_trees(struct renderer *r, struct error *error)
{
    const struct scene *scene = r->scene;
    size_t node_count = r->top_node_capacity, triangle_count = 0;
    for (uint32_t m = 0; m < scene->mesh_count; m++) {
        node_count += r->trees[m]->node_count;
        triangle_count += r->trees[m]->item_count;
    }
    size_t node_bytes = node_count * sizeof(struct bvh_node),
           triangle_bytes = triangle_count * sizeof(struct bvh_triangle);
    uint64_t most = gpu_info(r->gpu)->max_storage_bytes;
    if (!check_device_size(r, "the nodes", node_bytes, error))
        return false;
    if (triangle_count > 2 * (most / sizeof(struct bvh_triangle)))
        return error_set(
            error, STATUS_LIMIT,
            "the triangles of scene '%s' need %zu MiB; this device takes %llu MiB in each of two buffers",
            scene->name, triangle_bytes >> 20, (unsigned long long)(most >> 20));
    struct bvh_node *nodes = calloc(node_count + 1, sizeof *nodes);
    struct bvh_triangle *triangles = calloc(triangle_count + 1, sizeof *triangles);
    bool is_done = false;
    if (nodes && triangles) {
        for (uint32_t m = 0; m < scene->mesh_count; m++) {
            const struct bvh *tree = r->trees[m];
            memcpy(nodes + r->tree_node[m], tree->nodes, tree->node_count * sizeof *nodes);
            if (tree->item_count > 0)
                memcpy(triangles + r->tree_triangle[m], tree->triangles,
                       tree->item_count * sizeof *triangles);
        }
        r->nodes = gpu_buffer_create_filled(r->gpu, "bvh nodes", nodes, node_bytes, false, error);
        is_done = r->nodes && upload_triangles(r, triangles, triangle_count, error);
    } else
        error_set(error, STATUS_MEMORY, "out of memory for %zu MiB of bvh",
                  (node_bytes + triangle_bytes) >> 20);
    free(nodes);
    free(triangles);
    return is_done;
}

static bool build_accels(struct renderer *r, struct error *error)
{
    const struct scene *scene = r->scene;
    r->bottoms = calloc(scene->mesh_count + 1, sizeof *r->bottoms);
    if (!r->bottoms)
        return error_set(error, STATUS_MEMORY, "out of memory for %u meshes", scene->mesh_count);
    for (uint32_t m = 0; m < scene->mesh_count; m++) {
        const struct scene_mesh *mesh = &scene->meshes[m];
        /* indices are absolute on the device */
        r->bottoms[m] = gpu_accel_create_bottom(r->gpu, mesh->name,
                                                &(struct gpu_triangles){
                                                    .vertices = r->vertices,
                                                    .vertex_stride = sizeof(struct scene_vertex_gpu),
                                                    .first_vertex = 0,
                                                    .vertex_count = scene->vertex_count,
                                                    .indices = r->indices,
                                                    .first_index = mesh->first_index,
                                                    .triangle_count = mesh->triangle_count,
                                                },
                                                error);
        if (!r->bottoms[m])
            return false;
    }
    r->top =
        gpu_accel_create_top(r->gpu, "scene", scene->instance_count > 0 ? scene->instance_count : 1, error);
    return r->top != NULL;
}

static bool disperses(const struct scene *scene)
{
    for (uint32_t i = 0; i < scene->material_count; i++)
        if (scene->materials[i].kind == MATERIAL_DIELECTRIC && scene->materials[i].dispersion > 0)
            return true;
    return false;
}

size_t renderer_rays_per_photon(const struct scene *scene)
{
    return disperses(scene) ? RAYS_PER_BAND_PHOTON : RAYS_PER_PHOTON;
}

/* Of a ray, or of the columns beside it where those are more: five of six floats (shaders/spread.glsl). */
static size_t ray_bytes(const struct scene *scene)
{
    size_t columns = disperses(scene) ? 5 * 6 * sizeof(float) : 0;
    return columns > sizeof(struct photon_ray) ? columns : sizeof(struct photon_ray);
}

size_t renderer_stored_per_photon(const struct scene *scene)
{
    return disperses(scene) ? STORED_PER_BAND_PHOTON : STORED_PER_PHOTON;
}

struct renderer *renderer_create(const struct renderer_params *params, struct error *error)
{
    const struct gpu_info *info = gpu_info(params->gpu);
    if (params->tracer == TRACER_KHR && !info->has_ray_query) {
        error_set(error, STATUS_UNSUPPORTED,
                  "tracer khr needs VK_KHR_ray_query, which device '%s' (%s) lacks; use bvh", info->name,
                  info->driver);
        return NULL;
    }
    struct renderer *r = calloc(1, sizeof *r);
    if (!r) {
        error_set(error, STATUS_MEMORY, "out of memory for a renderer");
        return NULL;
    }
    r->gpu = params->gpu;
    r->scene = params->scene;
    r->tracer = params->tracer != TRACER_AUTO    ? params->tracer
                : info->has_hardware_ray_tracing ? TRACER_KHR
                                                 : TRACER_BVH;
    uint64_t most = info->max_storage_bytes;
    uint64_t pixels = most / sizeof(struct surface_gpu),
             photons = most / (renderer_stored_per_photon(r->scene) * sizeof(struct photon));
    r->limits.max_pixels = (uint32_t)(pixels < VIEW_MAX_PIXELS ? pixels : VIEW_MAX_PIXELS);
    uint64_t rays = most / (renderer_rays_per_photon(r->scene) * ray_bytes(r->scene));
    photons = photons < rays ? photons : rays;
    photons = photons / 4096 * 4096;
    r->limits.max_photons = (uint32_t)fmin((double)photons, setting_infos[SETTING_photons].maximum);
    const struct scene *scene = r->scene;
    r->limits.min_photons = scene->light_count > 0 ? scene->light_count : 1;
    r->top_node_capacity = 2 * scene->instance_count + 2;
    r->instance_data = calloc(scene->instance_count + 1, sizeof *r->instance_data);
    r->caster_boxes = calloc(MAX_CASTER_BOXES, sizeof *r->caster_boxes);
    r->casters = calloc(MAX_CASTER_BOXES, sizeof *r->casters);
    r->pose = scene_extent_find(scene, &r->extent, error) ? scene_pose_create(scene, error) : NULL;
    if (r->pose) {
        scene_pose_set_origin(r->pose, r->extent.origin);
        scene_pose_set_time(scene, r->pose, 0);
    }
    if (!r->instance_data || !r->caster_boxes || !r->casters)
        error_set(error, STATUS_MEMORY, "out of memory for %u instances", scene->instance_count);
    if (!r->pose || !r->instance_data || !r->caster_boxes || !r->casters || !upload_vertices(r, error) ||
        !build_trees(r, error) ||
        !solids_find(&r->solids, scene, r->pose, r->trees, r->extent.scale, error) ||
        !upload_materials(r, error) ||
        !(r->tracer == TRACER_KHR ? build_accels(r, error) : upload_trees(r, error)))
        goto failed;
    r->instances = gpu_buffer_create(
        r->gpu,
        &(struct gpu_buffer_params){.name = "instances",
                                    .size = (scene->instance_count + 1) * sizeof(struct scene_instance_gpu)},
        error);
    if (!r->instances || !renderer_set_time(r, 0, error))
        goto failed;
    return r;
failed:
    renderer_destroy(&r);
    return NULL;
}

enum tracer renderer_tracer(const struct renderer *renderer)
{
    return renderer->tracer;
}

const struct renderer_limits *renderer_limits(const struct renderer *renderer)
{
    return &renderer->limits;
}

/* ---- pose ---------------------------------------------------------------------------------------------- */

static void transform_box(const float m[12], const float low[3], const float high[3], float out_low[3],
                          float out_high[3])
{
    for (int row = 0; row < 3; row++) {
        float a = m[4 * row + 3], b = a;
        for (int k = 0; k < 3; k++) {
            float x = m[4 * row + k] * low[k], y = m[4 * row + k] * high[k];
            a += fminf(x, y);
            b += fmaxf(x, y);
        }
        /* sums of rounded products: keep the box conservative */
        float slack = 4e-7f * fmaxf(fabsf(a), fabsf(b));
        out_low[row] = a - slack;
        out_high[row] = b + slack;
    }
}

static void invert_affine(const float m[12], float out[12])
{
    double c[3][3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int a = (j + 1) % 3, b = (j + 2) % 3, d = (i + 1) % 3, e = (i + 2) % 3;
            c[i][j] = (double)m[4 * a + d] * m[4 * b + e] - (double)m[4 * a + e] * m[4 * b + d];
        }
    double determinant = m[0] * c[0][0] + m[1] * c[1][0] + m[2] * c[2][0];
    double inverse = determinant != 0 ? 1 / determinant : 0;
    for (int i = 0; i < 3; i++) {
        double t = 0;
        for (int j = 0; j < 3; j++) {
            out[4 * i + j] = (float)(c[i][j] * inverse);
            t -= c[i][j] * inverse * m[4 * j + 3];
        }
        out[4 * i + 3] = (float)t;
    }
}

static void add_caster_box(struct renderer *r, const float low[3], const float high[3], bool begins_caster)
{
    if (begins_caster)
        r->casters[r->caster_count++] = (struct caster_box){
            {low[0], low[1], low[2], (float)r->caster_box_count}, {high[0], high[1], high[2], 0}};
    struct caster_box *caster = &r->casters[r->caster_count - 1];
    float *minimum = &caster->minimum.x, *maximum = &caster->maximum.x;
    for (int k = 0; k < 3; k++) {
        minimum[k] = fminf(minimum[k], low[k]);
        maximum[k] = fmaxf(maximum[k], high[k]);
    }
    caster->maximum.w++;
    r->caster_boxes[r->caster_box_count++] =
        (struct caster_box){{low[0], low[1], low[2], 0}, {high[0], high[1], high[2], 0}};
}

bool renderer_set_time(struct renderer *r, double time, struct error *error)
{
    (void)error;
    if (r->has_pose && r->pose_time == time)
        return true;
    bool moved = scene_pose_set_time(r->scene, r->pose, time);
    r->pose_time = time;
    if (r->has_pose && !moved)
        return true;
    r->has_pose = true;
    r->pose_version++;
    const struct scene *scene = r->scene;
    for (int k = 0; k < 3; k++) {
        r->scene_min[k] = INFINITY;
        r->scene_max[k] = -INFINITY;
    }
    r->caster_box_count = r->caster_count = 0;
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        const float *m = r->pose->instance_to_world[i];
        uint32_t mesh = scene->instances[i].mesh;
        struct scene_instance_gpu *g = &r->instance_data[i];
        memcpy(g->to_world, m, sizeof g->to_world);
        float inverse[12];
        invert_affine(m, inverse);
        memcpy(g->to_object, inverse, sizeof g->to_object);
        g->first_index = scene->meshes[mesh].first_index;
        g->material = scene->meshes[mesh].material;
        g->bvh_root = r->tree_node[mesh];
        g->bvh_triangle = r->tree_triangle[mesh];
        float low[3], high[3];
        transform_box(m, scene->meshes[mesh].bounds_min, scene->meshes[mesh].bounds_max, low, high);
        for (int k = 0; k < 3; k++) {
            r->scene_min[k] = fminf(r->scene_min[k], low[k]);
            r->scene_max[k] = fmaxf(r->scene_max[k], high[k]);
        }
        if (!is_caster_mesh(scene, mesh))
            continue;
        uint32_t first = r->mesh_first_box[mesh];
        for (uint32_t b = 0; b < r->mesh_box_count[mesh] && r->caster_box_count < MAX_CASTER_BOXES; b++) {
            const float *box = r->mesh_boxes[first + b];
            transform_box(m, box, box + 3, low, high);
            add_caster_box(r, low, high,
                           b == 0 || r->mesh_islands[first + b] != r->mesh_islands[first + b - 1]);
        }
    }
    return true;
}

bool renderer_upload_pose(struct renderer *r, struct gpu_frame *frame, struct error *error)
{
    const struct scene *scene = r->scene;
    uint32_t count = scene->instance_count;
    gpu_record_upload(frame, r->instances, 0, r->instance_data, (count + 1) * sizeof *r->instance_data);
    if (r->tracer == TRACER_KHR) {
        struct gpu_accel_instance *instances = calloc(count + 1, sizeof *instances);
        if (!instances)
            return error_set(error, STATUS_MEMORY, "out of memory for %u instances", count);
        for (uint32_t i = 0; i < count; i++) {
            instances[i].bottom = r->bottoms[scene->instances[i].mesh];
            memcpy(instances[i].object_to_world, r->pose->instance_to_world[i],
                   sizeof instances[i].object_to_world);
            instances[i].custom_index = i;
        }
        gpu_record_accel_build(frame, r->top, instances, count);
        free(instances);
        return true;
    }
    float(*boxes)[6] = calloc(count + 1, sizeof *boxes);
    if (!boxes)
        return error_set(error, STATUS_MEMORY, "out of memory for %u instances", count);
    for (uint32_t i = 0; i < count; i++) {
        const struct scene_mesh *mesh = &scene->meshes[scene->instances[i].mesh];
        transform_box(r->pose->instance_to_world[i], mesh->bounds_min, mesh->bounds_max, boxes[i],
                      boxes[i] + 3);
    }
    struct bvh *top = bvh_create_boxes((const float(*)[6])boxes, count, error);
    free(boxes);
    if (!top)
        return false;
    gpu_record_upload(frame, r->nodes, 0, top->nodes, top->node_count * sizeof *top->nodes);
    bvh_destroy(&top);
    return true;
}
