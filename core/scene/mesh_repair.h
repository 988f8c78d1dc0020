/* mesh_repair.h: normals for meshes that come without, or with bad ones. Internal to core/scene. */
#ifndef CAUSTIC_MESH_REPAIR_H
#define CAUSTIC_MESH_REPAIR_H

#include "scene.h"

/* Gives three vertices per triangle its geometric normal. vertices[3 * i + j] is corner j of triangle i. */
void mesh_set_flat_normals(struct scene_vertex *vertices, uint32_t triangle_count);

/* Unit normals stay bit for bit; others are made unit, and those without a direction get the area-weighted
 * mean of their triangles' geometric normals (up, where that vanishes too); *repaired says how many. Indices
 * must be in range. False when out of memory. */
bool mesh_repair_normals(struct scene_vertex *vertices, uint32_t vertex_count, const uint32_t *indices,
                         uint32_t triangle_count, uint32_t *repaired);

/* Whether most of the surface winds clockwise as seen from the side its normals point to. */
bool mesh_is_inside_out(const struct scene_vertex *vertices, const uint32_t *indices,
                        uint32_t triangle_count);

#endif
