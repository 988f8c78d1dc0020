/* tile_maps.h: the equal-area maps of light tiles in double precision, both ways, from Shirley and Chiu 1997
 * and Clarberg 2008: the reference of shaders/light.glsl.
 *
 * Directions are in the tile's own frame, its axis along z, unless a name says world.
 */
#ifndef TILE_MAPS_H
#define TILE_MAPS_H

#include "shaders/shared/render_layout.h"

#define PI 3.14159265358979323846

struct vector {
    double x, y, z;
};

double vector_dot(struct vector a, struct vector b);
struct vector vector_cross(struct vector a, struct vector b);
struct vector vector_of(vec4 v);

/* Square to cap of height 1 - cos(half angle), and back. */
struct vector cap_direction(double u, double v, double height);
void cap_place(struct vector d, double height, double *u, double *v);

/* Square to sphere, and back. */
struct vector octahedron_direction(double u, double v);
void octahedron_place(struct vector d, double *u, double *v);

/* Between a light's tile frame and the world. */
struct vector tile_to_world(const struct light_gpu *light, struct vector d);
struct vector tile_to_local(const struct light_gpu *light, struct vector d);
/* World direction at a place of a TILE_CAP or TILE_SPHERE. */
struct vector tile_direction(const struct light_gpu *light, double u, double v);

/* A tile frame about `z` (any length), also the light's direction; the w of these is cleared, but direction.w
 * is 1. */
void tile_set_frame(struct light_gpu *light, struct vector z);

#endif
