#include "analytic.h"

#include <math.h>

static const double pi = 3.14159265358979323846;

double analytic_fresnel(double cos_incident, double ior_from, double ior_to)
{
    double cos_i = fmin(fmax(cos_incident, 0), 1);
    double sin_t = ior_from / ior_to * sqrt(1 - cos_i * cos_i);
    if (sin_t >= 1)
        return 1;
    double cos_t = sqrt(1 - sin_t * sin_t);
    double s = (ior_from * cos_i - ior_to * cos_t) / (ior_from * cos_i + ior_to * cos_t);
    double p = (ior_to * cos_i - ior_from * cos_t) / (ior_to * cos_i + ior_from * cos_t);
    return 0.5 * (s * s + p * p);
}

/* ---- flat interface ------------------------------------------------------------------------------------ */

/* Where the ray of slope u = tan(angle from the vertical) meets the floor. */
static double interface_radius(const struct analytic_interface *scene, double u)
{
    double sine = u / sqrt(1 + u * u);
    return scene->light_height * u + scene->depth * sine / sqrt(scene->ior * scene->ior - sine * sine);
}

double analytic_interface_irradiance(const struct analytic_interface *scene, double radius)
{
    double h = scene->light_height, d = scene->depth, n = scene->ior;

    /* The radius rises with the slope, so bisection finds the one ray that arrives. In the denser medium
     * slopes end at total reflection, where the radius grows without bound. */
    double low = 0, high = radius / h;
    if (n < 1)
        high = fmin(high, n / sqrt(1 - n * n));
    for (int i = 0; i < 200; i++) {
        double middle = 0.5 * (low + high);
        if (interface_radius(scene, middle) < radius)
            low = middle;
        else
            high = middle;
    }
    double u = 0.5 * (low + high);

    /* Flux I T sin(a) da in the ring r dr: E = I T (sin a / r) / (dr/da). */
    double cosine = 1 / sqrt(1 + u * u), sine = u * cosine;
    double cosine_below = sqrt(fmax(1 - sine * sine / (n * n), 0));
    double sine_over_radius = 1 / (h / cosine + d / (n * cosine_below));
    double radius_by_angle =
        h / (cosine * cosine) + d * cosine / (n * cosine_below * cosine_below * cosine_below);
    double transmittance = 1 - analytic_fresnel(cosine, 1, n);
    return scene->intensity * transmittance * sine_over_radius / radius_by_angle;
}

/* ---- polished ring ------------------------------------------------------------------------------------- */

/* One meeting of the light with the wall, in plan. */
struct wall_hit {
    double position[2], reflected[2]; /* reflected: unit */
    double travelled;                 /* from the light; directional: not used */
    double cosine;                    /* of incidence, > 0 */
};

static bool wall_hit_at(const struct analytic_ring *ring, double angle, struct wall_hit *hit)
{
    double normal[2] = {-cos(angle), -sin(angle)}; /* into the ring */
    double way[2] = {ring->light[0], ring->light[1]};
    for (int i = 0; i < 2; i++) {
        hit->position[i] = -ring->radius * normal[i];
        if (!ring->is_directional)
            way[i] = hit->position[i] - ring->light[i];
    }
    hit->travelled = hypot(way[0], way[1]);
    if (hit->travelled == 0)
        return false;
    hit->cosine = -(way[0] * normal[0] + way[1] * normal[1]) / hit->travelled;
    for (int i = 0; i < 2; i++)
        hit->reflected[i] = way[i] / hit->travelled + 2 * hit->cosine * normal[i];
    return hit->cosine > 0;
}

/* Whether light that met the wall reaches the floor `distance` further along: it falls evenly from the light
 * to there. */
static bool is_lit(const struct analytic_ring *ring, const struct wall_hit *hit, double distance)
{
    double fall =
        ring->is_directional ? ring->light_height : ring->light_height / (hit->travelled + distance);
    double height_at_wall = fall * distance;
    double chord = 2 * ring->radius * hit->cosine;
    bool is_outside = ring->is_directional || hypot(ring->light[0], ring->light[1]) > ring->radius;
    bool clears_near_wall = !is_outside || height_at_wall + fall * chord >= ring->wall_height;
    return distance > 0 && distance <= chord && height_at_wall <= ring->wall_height && clears_near_wall;
}

bool analytic_ring_caustic(const struct analytic_ring *ring, double angle, struct analytic_ring_point *point)
{
    struct wall_hit hit;
    if (!wall_hit_at(ring, angle, &hit))
        return false;
    /* The mirror equation in the plane of incidence: 1/p + 1/q = 2/(R cos i). */
    double vergence = 2 / (ring->radius * hit.cosine) - (ring->is_directional ? 0 : 1 / hit.travelled);
    if (vergence == 0)
        return false;
    point->distance = 1 / vergence;
    for (int i = 0; i < 2; i++)
        point->position[i] = hit.position[i] + point->distance * hit.reflected[i];
    point->is_lit = is_lit(ring, &hit, point->distance);
    return true;
}

bool analytic_ring_trace(const struct analytic_ring *ring, double angle, double distance,
                         struct analytic_ring_ray *ray)
{
    struct wall_hit hit;
    if (!wall_hit_at(ring, angle, &hit))
        return false;
    for (int i = 0; i < 2; i++)
        ray->position[i] = hit.position[i] + distance * hit.reflected[i];

    /* Unfold the mirror: the flux is what would reach level ground beyond the wall. From a point at height H
     * that is cos e de dphi with tan e = H / L; from far away, the sine of the elevation per area. */
    double across = ring->radius * hit.cosine, height = ring->light_height;
    if (ring->is_directional) {
        ray->flux = across * height / sqrt(1 + height * height);
    } else {
        double length = hit.travelled + distance;
        ray->flux = across / hit.travelled * height * length / pow(length * length + height * height, 1.5);
    }
    if (!is_lit(ring, &hit, distance))
        ray->flux = 0;
    return true;
}

bool analytic_ring_cusp(const struct analytic_ring *ring, double cusp[2])
{
    /* The wall beyond the centre: where the light points, or opposite to where it stands. */
    double x = ring->is_directional ? ring->light[0] : -ring->light[0];
    double y = ring->is_directional ? ring->light[1] : -ring->light[1];
    struct analytic_ring_point point;
    if ((x == 0 && y == 0) || !analytic_ring_caustic(ring, atan2(y, x), &point))
        return false;
    cusp[0] = point.position[0];
    cusp[1] = point.position[1];
    return true;
}

/* ---- glass sphere -------------------------------------------------------------------------------------- */

void analytic_sphere_trace(const struct analytic_sphere *scene, enum analytic_sphere_path path,
                           double incidence, struct analytic_sphere_ray *ray)
{
    double radius = scene->radius;
    double angle = asin(radius / scene->light_height * sin(incidence));
    double refracted = asin(sin(incidence) / scene->ior);
    double reflectance = analytic_fresnel(cos(incidence), 1, scene->ior);
    double entry = incidence - angle; /* of the point met first, from the upward axis at the centre */

    /* All happens in one plane through the axis. Refraction turns the ray by incidence - refracted toward the
     * axis, twice; a reflection inside by pi - 2 refracted, the same way round; each crossing of the sphere
     * moves the point by as much. */
    double leaving, exit, share;
    if (path == ANALYTIC_SPHERE_REFLECTED) {
        leaving = angle + pi - 2 * incidence;
        exit = entry;
        share = reflectance;
    } else {
        int internal = path == ANALYTIC_SPHERE_TRANSMITTED ? 0 : path == ANALYTIC_SPHERE_ONE_INTERNAL ? 1 : 2;
        double chord = 2 * radius * cos(refracted);
        leaving = angle - 2 * (incidence - refracted) - internal * (pi - 2 * refracted);
        exit = entry + (internal + 1) * (pi - 2 * refracted);
        share = (1 - reflectance) * (1 - reflectance) * pow(reflectance, internal) *
                exp(-scene->extinction * chord * (internal + 1));
    }

    *ray = (struct analytic_sphere_ray){.angle = angle, .leaving = leaving, .share = share};
    ray->lands = cos(leaving) > 0;
    if (ray->lands) {
        double height = scene->centre_height + radius * cos(exit);
        ray->position = radius * sin(exit) + height * tan(leaving);
    }
}

/* The rings, while flux is spread over them. */
struct ring_sums {
    const double *edges;
    double *flux;
    size_t count;
};

/* Adds `flux`, spread evenly over the radii from `from` to `to`. */
static void spread(const struct ring_sums *rings, double from, double to, double flux)
{
    double low = fmin(from, to), high = fmax(from, to);
    size_t first = 0, last = rings->count; /* the ring that holds `low`, by bisection: edges[first] <= low */
    if (high < rings->edges[0] || low >= rings->edges[rings->count])
        return;
    while (last - first > 1) {
        size_t middle = first + (last - first) / 2;
        if (rings->edges[middle] <= low)
            first = middle;
        else
            last = middle;
    }
    if (high == low) {
        if (low >= rings->edges[first])
            rings->flux[first] += flux;
        return;
    }
    for (size_t i = first; i < rings->count && rings->edges[i] < high; i++) {
        double inside = fmin(high, rings->edges[i + 1]) - fmax(low, rings->edges[i]);
        if (inside > 0)
            rings->flux[i] += flux * inside / (high - low);
    }
}

double analytic_sphere_profile(const struct analytic_sphere *scene, unsigned paths, const double *edges,
                               size_t ring_count, double *irradiance, size_t steps)
{
    struct ring_sums rings = {edges, irradiance, ring_count};
    double landed = 0;
    if (!steps)
        steps = 400000;
    for (size_t i = 0; i < ring_count; i++)
        irradiance[i] = 0;

    for (unsigned path = ANALYTIC_SPHERE_REFLECTED; path <= ANALYTIC_SPHERE_TWO_INTERNAL; path <<= 1) {
        if (!(paths & path))
            continue;
        struct analytic_sphere_ray before, middle, after;
        analytic_sphere_trace(scene, path, 0, &before);
        for (size_t i = 0; i < steps; i++, before = after) {
            double step = 0.5 * pi / (double)steps;
            analytic_sphere_trace(scene, path, ((double)i + 0.5) * step, &middle);
            analytic_sphere_trace(scene, path, (double)(i + 1) * step, &after);
            if (!before.lands || !middle.lands || !after.lands)
                continue;
            /* cos(before) - cos(after), without the loss of digits. */
            double solid_angle =
                4 * pi * sin(0.5 * (before.angle + after.angle)) * sin(0.5 * (after.angle - before.angle));
            double flux = scene->intensity * solid_angle * middle.share;
            landed += flux;
            double from = before.position, to = after.position;
            if (from * to < 0) { /* across the axis: both sides fall on the same radii */
                double part = fabs(from) / (fabs(from) + fabs(to));
                spread(&rings, fabs(from), 0, flux * part);
                spread(&rings, 0, fabs(to), flux * (1 - part));
            } else {
                spread(&rings, fabs(from), fabs(to), flux);
            }
        }
    }
    for (size_t i = 0; i < ring_count; i++)
        irradiance[i] /= pi * (edges[i + 1] * edges[i + 1] - edges[i] * edges[i]);
    return landed;
}
