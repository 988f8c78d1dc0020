/* extent.h: where a scene lies and how large it is, and how exactly floats can follow rays in it.
 *
 * Rays are traced in floats about an origin. A scene that lies far from (0, 0, 0) as against its size gets an
 * origin of its own, on a grid so coarse that moving to it rounds nothing; positions in the world are then
 * relative to that. What stays coarse is a caster that is small as against its distance from the origin.
 */
#ifndef CAUSTIC_EXTENT_H
#define CAUSTIC_EXTENT_H

#include "scene.h"

/* A ray leaves a surface this far from it, as a share of the largest coordinate, and no nearer than
 * EXTENT_STEP_MIN in a scene of ordinary size (shaders/scene.glsl, offset_origin). */
#define EXTENT_STEP     0x1p-15
#define EXTENT_STEP_MIN 0x1p-16

/* In floats: a coordinate's 2^-23. The first leaves room for all errors of a hit that were ever seen, the
 * second for those of its own arithmetic, about four. */
#define EXTENT_STEPS      256
#define EXTENT_STEPS_FINE 8

/* That step over the half size of the coarsest caster, above which a picture shows it. Then rays are kept off
 * surfaces by EXTENT_STEPS_FINE. */
#define EXTENT_COARSE 0.01

struct scene_extent {
    double origin[3];
    double scale;      /* of EXTENT_STEP_MIN: a power of two, 1 for scenes of 1 to 128 m */
    double steps;      /* EXTENT_STEPS, or EXTENT_STEPS_FINE where a caster is coarse with those */
    double coarseness; /* as EXTENT_COARSE, with these steps; 0 without casters */
    uint32_t coarsest; /* that caster's instance */
};

/* At rest. False and *error when out of memory. */
bool scene_extent_find(const struct scene *scene, struct scene_extent *extent, struct error *error);

#endif
