/* photon_model.h: a small scene and what a bounce of light does in it, in double precision: every triangle in
 * turn, Snell by angles, Fresnel by sines and tangents.
 */
#ifndef TEST_PHOTON_MODEL_H
#define TEST_PHOTON_MODEL_H

#include "core/scene/bvh.h"
#include "pass_device.h"
#include "tile_maps.h"

/* A mesh, an instance and a material each. */
enum { MODEL_SPHERE, MODEL_MIRROR, MODEL_FLOOR, MODEL_SHEET, MODEL_SLAB, MODEL_PARTS };
enum { MODEL_AROUND = 24, MODEL_DOWN = 12, MODEL_QUADS = 4 };
enum {
    MODEL_SPHERE_VERTICES = MODEL_AROUND * (MODEL_DOWN + 1),
    MODEL_SPHERE_TRIANGLES = MODEL_AROUND * MODEL_DOWN * 2,
    MODEL_VERTICES = MODEL_SPHERE_VERTICES + 4 * MODEL_QUADS,
    MODEL_TRIANGLES = MODEL_SPHERE_TRIANGLES + 2 * MODEL_QUADS,
    MODEL_NODES = 2 * MODEL_TRIANGLES + 64
};

extern const struct vector model_sphere_center;
extern struct material_gpu model_materials[MODEL_PARTS];
/* The scene as a shader gets it. */
extern struct scene_vertex_gpu model_vertices[MODEL_VERTICES];
extern uint32_t model_indices[3 * MODEL_TRIANGLES];
extern struct scene_instance_gpu model_instances[MODEL_PARTS];
extern struct bvh_node model_nodes[MODEL_NODES];
extern struct bvh_triangle model_triangles[MODEL_TRIANGLES];

void model_make(void);
/* The solid number of a part: shaders/media.glsl. */
#define MODEL_SOLID(part) ((part) + 1u)

struct vector model_add(struct vector a, struct vector b, double scale);
struct vector model_unit(struct vector a);
double model_length(struct vector a);

struct model_corner {
    struct vector position, normal;
};

struct model_hit {
    uint32_t part;
    struct model_corner corners[3];
    double t;
    double border; /* distance of the nearest decision from the other way, relative */
};

void model_fetch(uint32_t part, uint32_t triangle, struct model_corner corners[3]);
bool model_trace(struct vector o, struct vector d, struct model_hit *hit);

enum model_way { MODEL_REFLECT, MODEL_REFRACT, MODEL_STRAIGHT };

struct model_turn {
    struct vector position, direction, geometric, normal; /* normals oppose the ray */
    double cos_i, cos_t;                                  /* cos_t 0: total reflection */
};

/* Position, and the way on, of a ray on the plane of `hit`. */
struct model_turn model_turn_of(const struct model_hit *hit, struct vector o, struct vector d,
                                enum model_way way);
double model_reflectance(double cos_i, double ratio);

#endif
