#include "scene_rest.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "../image/image_io.h"
#include "extent.h"
#include "vec3.h"

#define PI 3.14159265358979323846

static struct vec3 row(const float world[12], int index)
{
    return vec3_load(world + 4 * index);
}

static double determinant(const float world[12])
{
    return vec3_dot(row(world, 0), vec3_cross(row(world, 1), row(world, 2)));
}

static struct vec3 transform_point(const float world[12], const float point[3])
{
    struct vec3 p = vec3_load(point);
    return vec3_make(vec3_dot(row(world, 0), p) + (double)world[3],
                     vec3_dot(row(world, 1), p) + (double)world[7],
                     vec3_dot(row(world, 2), p) + (double)world[11]);
}

/* Per node, whether its scale or an ancestor's is animated; NULL when out of memory. The caller frees. */
static bool *find_animated_scales(const struct scene *scene)
{
    bool *is_animated = calloc((size_t)scene->node_count + 1, sizeof *is_animated);
    if (!is_animated)
        return NULL;
    for (uint32_t i = 0; i < scene->channel_count; i++)
        if (scene->channels[i].path == ANIMATION_SCALE)
            is_animated[scene->channels[i].node] = true;
    for (uint32_t i = 0; i < scene->node_count; i++)
        if (scene->nodes[i].parent != SCENE_NONE && is_animated[scene->nodes[i].parent])
            is_animated[i] = true;
    return is_animated;
}

/* Whether the mesh's box stays where squares and areas of coordinates fit a float. */
static bool is_near(const struct scene_mesh *mesh, const float world[12])
{
    for (int corner = 0; corner < 8; corner++) {
        float point[3];
        for (int axis = 0; axis < 3; axis++)
            point[axis] = corner >> axis & 1 ? mesh->bounds_max[axis] : mesh->bounds_min[axis];
        struct vec3 place = transform_point(world, point);
        if (!(fmax(fabs(place.x), fmax(fabs(place.y), fabs(place.z))) <= 1e9))
            return false;
    }
    return true;
}

static struct scene_pose *rest_pose(struct scene_builder *builder)
{
    if (!scene_builder_ok(builder))
        return NULL;
    struct error error;
    struct scene_pose *pose = scene_pose_create(builder->scene, &error);
    if (!pose)
        scene_builder_fail(builder, error.status, "%s", error.message);
    return pose;
}

void scene_drop_collapsed(struct scene_builder *builder)
{
    struct scene_pose *pose = rest_pose(builder);
    if (!pose)
        return;
    struct scene *scene = builder->scene;
    bool *has_animated_scale = find_animated_scales(scene);
    if (!has_animated_scale) {
        scene_builder_fail(builder, STATUS_MEMORY, "out of memory for scene \"%s\"", scene->name);
        scene_pose_destroy(&pose);
        return;
    }
    uint32_t kept = 0;
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        const float *world = pose->instance_to_world[i];
        /* Below this the inverse leaves the range of float. */
        double largest =
            fmax(vec3_length(row(world, 0)), fmax(vec3_length(row(world, 1)), vec3_length(row(world, 2))));
        bool is_collapsed = !(fabs(determinant(world)) > 1e-7 * largest * largest * largest) ||
                            largest < 1e-12 || !is_near(&scene->meshes[scene->instances[i].mesh], world);
        if (is_collapsed && !has_animated_scale[scene->instances[i].node]) {
            scene_builder_warn(
                builder,
                "node \"%s\": its transform has no volume or leads beyond 1e9 m, its mesh is left out",
                scene->nodes[scene->instances[i].node].name);
            continue;
        }
        scene->instances[kept++] = scene->instances[i];
    }
    scene->instance_count = kept;
    free(has_animated_scale);
    scene_pose_destroy(&pose);
}

void scene_warn_coarse(struct scene_builder *builder)
{
    struct scene_extent extent;
    struct error error;
    if (!scene_builder_ok(builder))
        return;
    if (!scene_extent_find(builder->scene, &extent, &error))
        scene_builder_fail(builder, error.status, "%s", error.message);
    else if (extent.coarseness > EXTENT_COARSE)
        scene_builder_warn(
            builder,
            "node \"%s\" is small as against its distance from the scene's middle, or its "
            "vertices lie far from their own origin: light goes astray there by %.2g of its size",
            builder->scene->nodes[builder->scene->instances[extent.coarsest].node].name, extent.coarseness);
}

/* ---- emissive meshes ---------------------------------------------------------------------------------- */

/* An instance's surface in the world. */
struct surface {
    double area;
    struct vec3 centroid;  /* weighted by area */
    struct vec3 direction; /* sum of area times normal */
};

static struct surface measure(const struct scene *scene, const struct scene_mesh *mesh, const float world[12])
{
    struct surface surface = {0};
    double side = determinant(world) < 0 ? -1 : 1; /* a mirrored mesh winds the other way */
    const uint32_t *indices = scene->indices + mesh->first_index;
    const struct scene_vertex *vertices = scene->vertices + mesh->first_vertex;
    for (uint32_t i = 0; i < mesh->triangle_count; i++) {
        struct vec3 corner[3];
        for (int j = 0; j < 3; j++)
            corner[j] = transform_point(world, vertices[indices[3 * i + (uint32_t)j]].position);
        struct vec3 normal = vec3_cross(vec3_sub(corner[1], corner[0]), vec3_sub(corner[2], corner[0]));
        double area = vec3_length(normal) / 2;
        surface.area += area;
        surface.direction = vec3_add(surface.direction, vec3_scale(normal, side / 2));
        struct vec3 middle = vec3_scale(vec3_add(corner[0], vec3_add(corner[1], corner[2])), 1.0 / 3);
        surface.centroid = vec3_add(surface.centroid, vec3_scale(middle, area));
    }
    if (surface.area > 0)
        surface.centroid = vec3_scale(surface.centroid, 1 / surface.area);
    return surface;
}

/* How far the mesh reaches beyond its centroid along `direction`. */
static double reach(const struct scene *scene, const struct scene_mesh *mesh, const float world[12],
                    struct vec3 centroid, struct vec3 direction)
{
    double farthest = 0;
    for (uint32_t i = 0; i < mesh->vertex_count; i++) {
        struct vec3 point = transform_point(world, scene->vertices[mesh->first_vertex + i].position);
        farthest = fmax(farthest, vec3_dot(vec3_sub(point, centroid), direction));
    }
    return farthest;
}

/* The emission's mean over its texture: uneven emission is imported as even. */
static struct vec3 mean_emission(const struct scene *scene, const struct scene_material *material)
{
    struct vec3 emission = vec3_load(material->emission);
    if (material->emission_image == SCENE_NONE)
        return emission;
    const struct scene_image *image = &scene->images[material->emission_image];
    struct vec3 sum = {0};
    size_t count = (size_t)image->width * image->height;
    for (size_t i = 0; i < count; i++) {
        const uint16_t *texel = image->texels + 4 * i;
        sum = vec3_add(sum,
                       vec3_make((double)image_half_to_float(texel[0]), (double)image_half_to_float(texel[1]),
                                 (double)image_half_to_float(texel[2])));
    }
    sum = vec3_scale(sum, count ? 1.0 / (double)count : 0);
    return vec3_make(emission.x * sum.x, emission.y * sum.y, emission.z * sum.z);
}

/* Some direction across the unit vector `axis`. */
static struct vec3 any_side(struct vec3 axis)
{
    struct vec3 up = fabs(axis.y) < 0.9 ? vec3_make(0, 1, 0) : vec3_make(1, 0, 0);
    return vec3_unit(vec3_cross(axis, up), vec3_make(1, 0, 0));
}

/* ---- what shape it is ---------------------------------------------------------------------------------- */

/* Edges whose direction may be that of a rectangle's side; enough for any plain one. */
#define MAX_EDGES 64u

/* How far the mesh reaches from `centroid` along +-`axis`: the larger of the two ways, and both together. */
static double extent(const struct scene *scene, const struct scene_mesh *mesh, const float world[12],
                     struct vec3 centroid, struct vec3 axis)
{
    return reach(scene, mesh, world, centroid, axis) +
           reach(scene, mesh, world, centroid, vec3_scale(axis, -1));
}

/* The side of the smallest rectangle around the mesh, in its plane, that lies along one of its edges. */
static struct vec3 rectangle_side(const struct scene *scene, const struct scene_mesh *mesh,
                                  const float world[12], const struct surface *surface, struct vec3 direction,
                                  double *area)
{
    struct vec3 best = any_side(direction);
    *area = INFINITY;
    const uint32_t *indices = scene->indices + mesh->first_index;
    const struct scene_vertex *vertices = scene->vertices + mesh->first_vertex;
    uint32_t edges = mesh->triangle_count < MAX_EDGES / 3 ? 3 * mesh->triangle_count : MAX_EDGES;
    for (uint32_t i = 0; i < edges; i++) {
        struct vec3 from = transform_point(world, vertices[indices[i]].position);
        struct vec3 to = transform_point(world, vertices[indices[i % 3 == 2 ? i - 2 : i + 1]].position);
        struct vec3 edge = vec3_unit(vec3_across(vec3_sub(to, from), direction), best);
        double around = extent(scene, mesh, world, surface->centroid, edge) *
                        extent(scene, mesh, world, surface->centroid, vec3_cross(direction, edge));
        if (around < *area) {
            *area = around;
            best = edge;
        }
    }
    return best;
}

/* The ellipse with the surface's second moments about its centroid, seen along `direction`: its long radius
 * lies along the returned axis, radii in `radii`. */
static struct vec3 fit_ellipse(const struct scene *scene, const struct scene_mesh *mesh,
                               const float world[12], const struct surface *surface, struct vec3 direction,
                               double radii[2])
{
    struct vec3 x = any_side(direction), y = vec3_cross(direction, x);
    double xx = 0, xy = 0, yy = 0;
    const uint32_t *indices = scene->indices + mesh->first_index;
    const struct scene_vertex *vertices = scene->vertices + mesh->first_vertex;
    for (uint32_t i = 0; i < mesh->triangle_count; i++) {
        double u[4] = {0}, v[4] = {0}; /* of the corners; [3]: their sum */
        struct vec3 corner[3];
        for (int j = 0; j < 3; j++) {
            corner[j] = vec3_sub(transform_point(world, vertices[indices[3 * i + (uint32_t)j]].position),
                                 surface->centroid);
            u[3] += u[j] = vec3_dot(corner[j], x);
            v[3] += v[j] = vec3_dot(corner[j], y);
        }
        double area = vec3_length(vec3_cross(vec3_sub(corner[1], corner[0]), vec3_sub(corner[2], corner[0])));
        for (int j = 0; j < 4; j++) {
            xx += area / 24 * u[j] * u[j];
            xy += area / 24 * u[j] * v[j];
            yy += area / 24 * v[j] * v[j];
        }
    }
    double middle = (xx + yy) / 2, apart = hypot((xx - yy) / 2, xy), angle = atan2(2 * xy, xx - yy) / 2;
    /* variance of an ellipse along a radius: r^2 / 4 */
    radii[0] = 2 * sqrt((middle + apart) / surface->area);
    radii[1] = 2 * sqrt(fmax(middle - apart, 0) / surface->area);
    return vec3_add(vec3_scale(x, cos(angle)), vec3_scale(y, sin(angle)));
}

/* Shape and size of an open surface's light, with the surface's own area; returns its side. */
static struct vec3 fit_shape(const struct scene *scene, const struct scene_mesh *mesh, const float world[12],
                             const struct surface *surface, struct vec3 direction, struct scene_light *light)
{
    double around, size[2];
    struct vec3 side = rectangle_side(scene, mesh, world, surface, direction, &around);
    light->shape = surface->area > 0.95 * around ? LIGHT_SHAPE_RECTANGLE : LIGHT_SHAPE_DISK;
    if (light->shape == LIGHT_SHAPE_RECTANGLE) {
        size[0] = extent(scene, mesh, world, surface->centroid, side) / 2;
        size[1] = extent(scene, mesh, world, surface->centroid, vec3_cross(direction, side)) / 2;
    } else
        side = fit_ellipse(scene, mesh, world, surface, direction, size);
    double whole = (light->shape == LIGHT_SHAPE_RECTANGLE ? 4 : PI) * size[0] * size[1];
    double scale = whole > 0 ? sqrt(surface->area / whole) : 0;
    for (int i = 0; i < 2; i++)
        light->half_size[i] = (float)fmin(size[i] * scale, SCENE_MAX_LIGHT_RADIUS);
    if (!(light->half_size[0] > 0 && light->half_size[1] > 0))
        light->shape = LIGHT_SHAPE_POINT;
    return side;
}

/* A node under `parent`, whose world transform at rest is `world`, with its origin at `position`, its -Z
 * along `direction` and its X along `right` in the world. */
static uint32_t add_node(struct scene_builder *builder, uint32_t parent, const float world[12],
                         struct vec3 position, struct vec3 direction, struct vec3 right)
{
    struct vec3 back = vec3_scale(direction, -1);
    const struct vec3 wanted[4] = {
        right, vec3_cross(back, right), back,
        vec3_sub(position, vec3_make((double)world[3], (double)world[7], (double)world[11]))};
    /* matrix = inverse(world) * wanted, a column at a time by Cramer's rule. */
    struct vec3 columns[3];
    for (int i = 0; i < 3; i++)
        columns[i] = vec3_make((double)world[i], (double)world[4 + i], (double)world[8 + i]);
    double volume = vec3_dot(columns[0], vec3_cross(columns[1], columns[2]));
    struct scene_node node = scene_node_default("emissive mesh", parent);
    node.has_matrix = true;
    for (int i = 0; i < 4; i++) {
        struct vec3 local = vec3_make(vec3_dot(wanted[i], vec3_cross(columns[1], columns[2])) / volume,
                                      vec3_dot(columns[0], vec3_cross(wanted[i], columns[2])) / volume,
                                      vec3_dot(columns[0], vec3_cross(columns[1], wanted[i])) / volume);
        vec3_store(node.matrix + 4 * i, local);
    }
    node.matrix[15] = 1;
    return scene_builder_node(builder, &node);
}

/* Returns whether the instance stays. */
static bool add_light(struct scene_builder *builder, struct scene_instance instance, const float world[12])
{
    struct scene *scene = builder->scene;
    const struct scene_mesh *mesh = &scene->meshes[instance.mesh];
    const struct scene_material *material = &scene->materials[mesh->material];
    if (material->emission[0] <= 0 && material->emission[1] <= 0 && material->emission[2] <= 0)
        return true;
    struct scene_light light = {0};
    scene_name_copy(light.name, *mesh->name ? mesh->name : scene->nodes[instance.node].name);
    if (!*light.name)
        scene_name_copy(light.name, *material->name ? material->name : "emissive mesh");
    if (scene->light_count >= SCENE_MAX_LIGHTS) {
        scene_builder_warn(builder, "emissive mesh \"%s\" lights nothing: a scene may have %u lights",
                           light.name, SCENE_MAX_LIGHTS);
        return true;
    }
    struct vec3 emission = mean_emission(scene, material);
    struct surface surface = measure(scene, mesh, world);
    if (!(surface.area > 0) || !isfinite(surface.area))
        return true;
    struct vec3 direction = vec3_unit(surface.direction, vec3_make(0, 0, -1));
    bool is_closed = vec3_length(surface.direction) < 0.02 * surface.area;
    struct vec3 intensity = vec3_scale(emission, is_closed ? surface.area / 4 : surface.area);
    double strongest = fmax(intensity.x, fmax(intensity.y, intensity.z));
    if (!(strongest <= 1e12)) {
        scene_builder_warn(builder, "emissive mesh \"%s\" lights nothing: %.4g W/sr are more than 1e12",
                           light.name, strongest);
        return true;
    }
    vec3_store(light.intensity, intensity);
    struct vec3 position = surface.centroid, side = any_side(direction);
    if (is_closed) {
        light.type = LIGHT_POINT;
        light.shape = LIGHT_SHAPE_SPHERE;
        double radius = fmin(sqrt(surface.area / (4 * PI)), SCENE_MAX_LIGHT_RADIUS);
        light.half_size[0] = light.half_size[1] = (float)radius;
        scene_builder_warn(
            builder,
            "emissive mesh \"%s\" is closed: a sphere of its area, radius %.4g m, stands in for it, "
            "%.4g W/sr, and its surface is left out",
            light.name, radius, strongest);
    } else {
        light.type = LIGHT_SPOT;
        light.outer_cone = (float)(PI / 2);
        light.is_emissive_mesh = true;
        side = fit_shape(scene, mesh, world, &surface, direction, &light);
        double clearance = 1e-3 * sqrt(surface.area);
        position =
            vec3_add(position, vec3_scale(direction, reach(scene, mesh, world, surface.centroid, direction) +
                                                         clearance));
        scene_builder_warn(builder,
                           "emissive mesh \"%s\" of %.4g m^2: a flat %s of even emission stands in for it, "
                           "%.4g W/sr along its normal%s",
                           light.name, surface.area,
                           light.shape == LIGHT_SHAPE_RECTANGLE ? "rectangle" : "disk", strongest,
                           material->double_sided ? "; its other side gives no light" : "");
    }
    light.node = add_node(builder, instance.node, world, position, direction, side);
    scene_builder_light(builder, &light);
    return !is_closed;
}

void scene_add_emissive_lights(struct scene_builder *builder)
{
    struct scene_pose *pose = rest_pose(builder);
    if (!pose)
        return;
    struct scene *scene = builder->scene;
    uint32_t kept = 0;
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        struct scene_instance instance = scene->instances[i];
        if (add_light(builder, instance, pose->instance_to_world[i]))
            scene->instances[kept++] = instance;
    }
    scene->instance_count = kept;
    scene_pose_destroy(&pose);
}
