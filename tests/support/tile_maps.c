#include "tile_maps.h"

#include <math.h>
#include <stdbool.h>

double vector_dot(struct vector a, struct vector b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

struct vector vector_cross(struct vector a, struct vector b)
{
    return (struct vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

struct vector vector_of(vec4 v)
{
    return (struct vector){(double)v.x, (double)v.y, (double)v.z};
}

/* Square to cap of height 1 - cos(half angle): concentric squares become circles, radii go with the root of
 * the area. */
struct vector cap_direction(double u, double v, double height)
{
    double a = 2 * u - 1, b = 2 * v - 1, r, angle;
    if (a * a > b * b) {
        r = a;
        angle = PI / 4 * b / a;
    } else if (b != 0) {
        r = b;
        angle = PI / 2 - PI / 4 * a / b;
    } else
        return (struct vector){0, 0, 1};
    double down = height * r * r, sine = sqrt(down * (2 - down));
    sine = r < 0 ? -sine : sine;
    return (struct vector){sine * cos(angle), sine * sin(angle), 1 - down};
}

void cap_place(struct vector d, double height, double *u, double *v)
{
    double sine2 = d.x * d.x + d.y * d.y;
    double down = d.z > 0 ? sine2 / (1 + d.z) : 1 - d.z;
    double r = sqrt(down / height), angle = atan2(d.y, d.x), a, b;
    if (angle < -PI / 4)
        angle += 2 * PI;
    if (angle < PI / 4) {
        a = r;
        b = angle * a / (PI / 4);
    } else if (angle < 3 * PI / 4) {
        b = r;
        a = -(angle - PI / 2) * b / (PI / 4);
    } else if (angle < 5 * PI / 4) {
        a = -r;
        b = (angle - PI) * a / (PI / 4);
    } else {
        b = -r;
        a = -(angle - 3 * PI / 2) * b / (PI / 4);
    }
    *u = 0.5 * (a + 1);
    *v = 0.5 * (b + 1);
}

struct vector octahedron_direction(double u, double v)
{
    double a = fabs(2 * u - 1), b = fabs(2 * v - 1);
    bool is_upper = a + b <= 1;
    double r = is_upper ? a + b : 2 - a - b;
    double angle = r > 0 ? PI / 4 * ((b - a) / r + 1) : 0;
    double sine = r * sqrt(2 - r * r), z = 1 - r * r;
    return (struct vector){copysign(sine * cos(angle), 2 * u - 1), copysign(sine * sin(angle), 2 * v - 1),
                           is_upper ? z : -z};
}

void octahedron_place(struct vector d, double *u, double *v)
{
    double r = sqrt((d.x * d.x + d.y * d.y) / (1 + fabs(d.z)));
    double b = r * atan2(fabs(d.y), fabs(d.x)) / (PI / 2), a = r - b;
    if (d.z < 0) {
        double swap = a;
        a = 1 - b;
        b = 1 - swap;
    }
    *u = 0.5 * (1 + copysign(a, d.x));
    *v = 0.5 * (1 + copysign(b, d.y));
}

struct vector tile_to_world(const struct light_gpu *light, struct vector d)
{
    struct vector x = vector_of(light->tile_x), y = vector_of(light->tile_y), z = vector_of(light->tile_z);
    return (struct vector){x.x * d.x + y.x * d.y + z.x * d.z, x.y * d.x + y.y * d.y + z.y * d.z,
                           x.z * d.x + y.z * d.y + z.z * d.z};
}

struct vector tile_to_local(const struct light_gpu *light, struct vector d)
{
    return (struct vector){vector_dot(vector_of(light->tile_x), d), vector_dot(vector_of(light->tile_y), d),
                           vector_dot(vector_of(light->tile_z), d)};
}

struct vector tile_direction(const struct light_gpu *light, double u, double v)
{
    return tile_to_world(light, light->map == TILE_CAP ? cap_direction(u, v, (double)light->tile_z.w)
                                                       : octahedron_direction(u, v));
}

static vec4 with_w(struct vector v, double w)
{
    return (vec4){(float)v.x, (float)v.y, (float)v.z, (float)w};
}

/* A tile frame about `z`, turned about it by something. */
void tile_set_frame(struct light_gpu *light, struct vector z)
{
    double length = sqrt(vector_dot(z, z));
    z = (struct vector){z.x / length, z.y / length, z.z / length};
    struct vector side = vector_cross(z, (struct vector){0.31, -0.62, 0.72});
    length = sqrt(vector_dot(side, side));
    struct vector x = {side.x / length, side.y / length, side.z / length};
    light->tile_x = with_w(x, 0);
    light->tile_y = with_w(vector_cross(z, x), 0);
    light->tile_z = with_w(z, 0);
    light->direction = with_w(z, 1);
}
