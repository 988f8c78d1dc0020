#include "mesh_repair.h"

#include <stdlib.h>

#include "vec3.h"

/* Twice the triangle's area, along its geometric normal. */
static struct vec3 area_vector(const struct scene_vertex *a, const struct scene_vertex *b,
                               const struct scene_vertex *c)
{
    struct vec3 origin = vec3_load(a->position);
    return vec3_cross(vec3_sub(vec3_load(b->position), origin), vec3_sub(vec3_load(c->position), origin));
}

void mesh_set_flat_normals(struct scene_vertex *vertices, uint32_t triangle_count)
{
    for (uint32_t i = 0; i < triangle_count; i++) {
        struct scene_vertex *corners = vertices + 3 * (size_t)i;
        struct vec3 normal =
            vec3_unit(area_vector(&corners[0], &corners[1], &corners[2]), vec3_make(0, 1, 0));
        for (int corner = 0; corner < 3; corner++)
            vec3_store(corners[corner].normal, normal);
    }
}

bool mesh_repair_normals(struct scene_vertex *vertices, uint32_t vertex_count, const uint32_t *indices,
                         uint32_t triangle_count, uint32_t *repaired)
{
    const struct vec3 none = {0};
    *repaired = 0;
    for (uint32_t i = 0; i < vertex_count; i++) {
        struct vec3 normal = vec3_load(vertices[i].normal);
        double squared = vec3_dot(normal, normal);
        /* A float vector's rounding moves its square by some 1e-7. */
        if (fabs(squared - 1) < 1e-5)
            continue;
        normal = vec3_unit(normal, none);
        *repaired += vec3_dot(normal, normal) == 0;
        vec3_store(vertices[i].normal, normal);
    }
    if (!*repaired)
        return true;
    struct vec3 *sums = calloc(vertex_count, sizeof *sums);
    if (!sums)
        return false;
    for (uint32_t i = 0; i < triangle_count; i++) {
        const uint32_t *corners = indices + 3 * (size_t)i;
        struct vec3 area = area_vector(&vertices[corners[0]], &vertices[corners[1]], &vertices[corners[2]]);
        for (int corner = 0; corner < 3; corner++)
            sums[corners[corner]] = vec3_add(sums[corners[corner]], area);
    }
    for (uint32_t i = 0; i < vertex_count; i++) {
        const float *normal = vertices[i].normal;
        if (normal[0] == 0 && normal[1] == 0 && normal[2] == 0)
            vec3_store(vertices[i].normal, vec3_unit(sums[i], vec3_make(0, 1, 0)));
    }
    free(sums);
    return true;
}

bool mesh_is_inside_out(const struct scene_vertex *vertices, const uint32_t *indices, uint32_t triangle_count)
{
    double agreement = 0;
    for (uint32_t i = 0; i < triangle_count; i++) {
        const struct scene_vertex *a = &vertices[indices[3 * (size_t)i]],
                                  *b = &vertices[indices[3 * (size_t)i + 1]],
                                  *c = &vertices[indices[3 * (size_t)i + 2]];
        struct vec3 normal =
            vec3_add(vec3_load(a->normal), vec3_add(vec3_load(b->normal), vec3_load(c->normal)));
        agreement += vec3_dot(area_vector(a, b, c), normal);
    }
    return agreement < 0;
}
