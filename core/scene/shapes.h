/* shapes.h: surfaces the built-in scenes are made of. Each appends one mesh and returns its index.
 *
 * Triangles wind counter-clockwise seen from the side their normals point to, which is the outside of a
 * solid. Units are metres. Deterministic. Internal to core/scene.
 */
#ifndef CAUSTIC_SHAPES_H
#define CAUSTIC_SHAPES_H

#include "scene_builder.h"
#include "vec3.h"

/* Quads given by corner and two edges; the normal is edge_u x edge_v. Vertices are not shared: flat shading.
 */
struct shape_quad {
    struct vec3 corner, edge_u, edge_v;
};
uint32_t shape_quads(struct scene_builder *builder, const char *name, uint32_t material,
                     const struct shape_quad *quads, uint32_t count);

/* A horizontal square centred at (x, y, z), normal up: two triangles. */
uint32_t shape_floor(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 center,
                     double side);

/* A closed box, flat faces outward: 12 triangles. */
uint32_t shape_box(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 minimum,
                   struct vec3 maximum);

/* 20 * 4^subdivisions triangles on the sphere, vertices shared, normals exactly radial. */
uint32_t shape_icosphere(struct scene_builder *builder, const char *name, uint32_t material,
                         struct vec3 center, double radius, uint32_t subdivisions);

/* The side of a cylinder about the vertical axis through `center`, from its bottom up; `is_inner` turns the
 * normals to the axis. 2 * segments triangles, smooth. */
uint32_t shape_tube(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 center,
                    double radius, double height, uint32_t segments, bool is_inner);

/* A closed solid of revolution about the vertical axis through `center`. The profile runs from a point on the
 * axis (its bottom) round the outside to another point on the axis: x is the radius, y the height. It is
 * smoothed by a centripetal Catmull-Rom spline and cut into rings, closer where it bends; normals from the
 * spline. 2 * segments * rings triangles. */
struct shape_profile_point {
    double radius, height;
};
uint32_t shape_revolution(struct scene_builder *builder, const char *name, uint32_t material,
                          struct vec3 center, const struct shape_profile_point *profile,
                          uint32_t profile_count, uint32_t rings, uint32_t segments);

/* Ring in the plane across `axis` (unit). 2 * segments * sides triangles, smooth. */
uint32_t shape_torus(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 center,
                     struct vec3 axis, double ring_radius, double tube_radius, uint32_t segments,
                     uint32_t sides);

/* A faceted, lumpy solid: an octahedron's faces cut into frequency^2 triangles each, 8 * frequency^2 in all,
 * pushed out to an uneven sphere. Flat normals, vertices not shared. */
uint32_t shape_gem(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 center,
                   double radius, uint32_t frequency);

/* A prism of three faces with its axis along z, from corners (x, y) counter-clockwise seen from +z: 8
 * triangles, flat. */
uint32_t shape_prism(struct scene_builder *builder, const char *name, uint32_t material,
                     const double corners[3][2], double z_minimum, double z_maximum);

/* A square grid of cells x cells quads centred at `center`, 2 * cells^2 triangles, normals up, its height a
 * sum of sines; normals are exact. */
struct shape_wave {
    double wave_x, wave_z; /* wave vector, rad/m */
    double amplitude, phase;
};
uint32_t shape_water(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 center,
                     double side, uint32_t cells, const struct shape_wave *waves, uint32_t wave_count);

#endif
