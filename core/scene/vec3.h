/* vec3.h: three doubles; geometry is generated and checked in double and stored as float. */
#ifndef CAUSTIC_VEC3_H
#define CAUSTIC_VEC3_H

#include <math.h>

struct vec3 {
    double x, y, z;
};

static inline struct vec3 vec3_make(double x, double y, double z)
{
    return (struct vec3){x, y, z};
}

static inline struct vec3 vec3_load(const float v[3])
{
    return (struct vec3){(double)v[0], (double)v[1], (double)v[2]};
}

static inline void vec3_store(float out[3], struct vec3 v)
{
    out[0] = (float)v.x, out[1] = (float)v.y, out[2] = (float)v.z;
}

static inline struct vec3 vec3_add(struct vec3 a, struct vec3 b)
{
    return (struct vec3){a.x + b.x, a.y + b.y, a.z + b.z};
}

static inline struct vec3 vec3_sub(struct vec3 a, struct vec3 b)
{
    return (struct vec3){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline struct vec3 vec3_scale(struct vec3 a, double s)
{
    return (struct vec3){a.x * s, a.y * s, a.z * s};
}

static inline double vec3_dot(struct vec3 a, struct vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline struct vec3 vec3_cross(struct vec3 a, struct vec3 b)
{
    return (struct vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* What remains of `a` across the unit vector `axis`. */
static inline struct vec3 vec3_across(struct vec3 a, struct vec3 axis)
{
    return vec3_sub(a, vec3_scale(axis, vec3_dot(a, axis)));
}

static inline double vec3_length(struct vec3 a)
{
    return sqrt(vec3_dot(a, a));
}

/* `fallback` (unit) where a is too short to have a direction, or is not finite. Scaled first, so that neither
 * the squares of a tiny vector vanish nor those of a huge one overflow. */
static inline struct vec3 vec3_unit(struct vec3 a, struct vec3 fallback)
{
    double largest = fmax(fabs(a.x), fmax(fabs(a.y), fabs(a.z)));
    if (!(largest > 1e-300) || !isfinite(a.x) || !isfinite(a.y) || !isfinite(a.z))
        return fallback;
    a = vec3_scale(a, 1.0 / largest);
    return vec3_scale(a, 1.0 / vec3_length(a));
}

#endif
