/* analytic.h: caustics that can be written down, as truth for the renderer's.
 *
 * Everything here is derived from Snell, Fresnel, the mirror equation and conservation of flux, in double,
 * and shares no code with the renderer. Lengths in metres, angles in radians, intensities in W/sr,
 * irradiances in W/m^2.
 */
#ifndef CAUSTIC_ANALYTIC_H
#define CAUSTIC_ANALYTIC_H

#include <stdbool.h>
#include <stddef.h>

/* Reflectance of a smooth boundary between dielectrics for unpolarised light. `cos_incident` >= 0 is measured
 * in the medium the light comes from. 1 at total internal reflection. */
double analytic_fresnel(double cos_incident, double ior_from, double ior_to);

/* ---- flat interface ------------------------------------------------------------------------------------ */

/* A point light above a flat, endless boundary, and below it a floor parallel to it. */
struct analytic_interface {
    double intensity;    /* W/sr, the same in all directions */
    double light_height; /* of the light above the boundary, > 0 */
    double depth;        /* of the floor below the boundary, >= 0 */
    double ior; /* of the lower medium over the upper one, > 0; below 1 the light is in the denser one */
};

/* Irradiance of the floor at `radius` >= 0 from the point below the light, by light refracted once. */
double analytic_interface_irradiance(const struct analytic_interface *scene, double radius);

/* ---- polished ring ------------------------------------------------------------------------------------- */

/* A mirror on the inside of an upright cylinder that stands on the floor, its axis through the origin of the
 * plan (x, y). Reflection at an upright wall leaves the vertical part of a direction alone, so in plan every
 * ray is reflected as by a circle, whatever its slope, and the caustic on the floor is the circle's
 * catacaustic: the slope only decides how far along its line a ray meets the floor, that is, which part of
 * the curve is lit. */
struct analytic_ring {
    double radius;       /* of the cylinder, > 0 */
    double wall_height;  /* > 0 */
    bool is_directional; /* light from infinitely far away */
    double light[2]; /* plan position of the light; directional: the way light travels in plan, need not be
                        unit */
    double
        light_height; /* above the floor, > wall_height; directional: drop per metre travelled in plan, > 0 */
};

struct analytic_ring_point {
    double position[2]; /* of the catacaustic, in plan */
    double
        distance; /* from the wall along the reflected ray; below 0 the focus is virtual, behind the mirror */
    bool is_lit;  /* light that met the wall once, at or below its height and after passing above the wall's
                     near  side when it came from outside, reaches the floor there before it meets the wall
                     again */
};

/* The point of the catacaustic made by the wall at `angle` from the x axis. False when the light does not
 * meet the inside of the wall there or the reflected rays are parallel. */
bool analytic_ring_caustic(const struct analytic_ring *ring, double angle, struct analytic_ring_point *point);

/* Light that met the wall once at `angle` and meets the floor `distance` further along, in plan. */
struct analytic_ring_ray {
    double position[2];
    double flux; /* W per radian of wall and metre of distance for a light of 1 W/sr (directional: 1 W/m^2
                    across the light); 0 where is_lit would be false */
};

/* False when the light does not meet the inside of the wall there. */
bool analytic_ring_trace(const struct analytic_ring *ring, double angle, double distance,
                         struct analytic_ring_ray *ray);

/* The cusp on the axis through the light and the centre, made by the wall beyond the centre. False when the
 * light is at the centre (all rays return to it) or at the middle of a radius (its reflected rays are
 * parallel). */
bool analytic_ring_cusp(const struct analytic_ring *ring, double cusp[2]);

/* ---- glass sphere -------------------------------------------------------------------------------------- */

/* A glass sphere above a floor, a point light straight above its centre. */
struct analytic_sphere {
    double intensity;     /* W/sr */
    double radius;        /* > 0 */
    double ior;           /* of the sphere over its surroundings, >= 1 */
    double centre_height; /* of the centre above the floor, >= radius */
    double light_height;  /* of the light above the centre, > radius */
    double extinction;    /* of the glass, 1/m; 0: clear */
};

/* How light gets past the sphere. */
enum analytic_sphere_path {
    ANALYTIC_SPHERE_REFLECTED = 1,    /* off the outside */
    ANALYTIC_SPHERE_TRANSMITTED = 2,  /* in and out */
    ANALYTIC_SPHERE_ONE_INTERNAL = 4, /* in, reflected once inside, out: the rainbow */
    ANALYTIC_SPHERE_TWO_INTERNAL = 8
};

struct analytic_sphere_ray {
    double angle;    /* of the ray from the downward axis when it left the light */
    double leaving;  /* of the ray from the downward axis when it left the sphere, outward positive, not
                        wrapped */
    double share;    /* of its flux that is left */
    bool lands;      /* whether it goes down */
    double position; /* where it meets the floor, from the axis, along the side it started on; 0 when it does
                        not */
};

/* Follows the ray that meets the sphere at `incidence` (0 on the axis, pi/2 at the rim) along one path. */
void analytic_sphere_trace(const struct analytic_sphere *scene, enum analytic_sphere_path path,
                           double incidence, struct analytic_sphere_ray *ray);

/* Mean irradiance of the rings of the floor between edges[i] and edges[i + 1] (`ring_count` + 1 rising radii
 * from the axis, the first >= 0), by the light of `paths` (a sum of enum analytic_sphere_path). The flux of
 * `steps` pencils of rays (0: 400,000) is spread over the stretch of floor each of them covers, so a ring
 * that holds a focus has its finite mean. Returns the flux in W that lands on the floor, in and outside the
 * rings. */
double analytic_sphere_profile(const struct analytic_sphere *scene, unsigned paths, const double *edges,
                               size_t ring_count, double *irradiance, size_t steps);

#endif
