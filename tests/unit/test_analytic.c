/* The closed forms against what is known of them by hand, from textbooks, and from vectors traced here. */
#include "core/measure/analytic.h"
#include "tests/support/check.h"

static const double pi = 3.14159265358979323846;

/* ---- Fresnel ------------------------------------------------------------------------------------------- */

static void fresnel(void **state)
{
    (void)state;
    assert_close(analytic_fresnel(1, 1, 1.5), 0.04, 1e-15);
    assert_close(analytic_fresnel(1, 1.5, 1), 0.04, 1e-15);
    assert_close(analytic_fresnel(0.3, 1.3, 1.3), 0, 1e-15);
    assert_close(analytic_fresnel(0, 1, 1.5), 1, 1e-15);

    /* At Brewster's angle only the s half is left: ((n^2 - 1) / (n^2 + 1))^2 / 2. */
    double n = 1.5, brewster = atan(n);
    double s = (n * n - 1) / (n * n + 1);
    assert_close(analytic_fresnel(cos(brewster), 1, n), 0.5 * s * s, 1e-15);

    /* Total internal reflection past asin(1/n), not before; and the way back loses as much. */
    assert_close(analytic_fresnel(cos(asin(1 / n) + 1e-6), n, 1), 1, 0);
    assert_true(analytic_fresnel(cos(asin(1 / n) - 1e-3), n, 1) < 0.9);
    for (double angle = 0.05; angle < 1.5; angle += 0.1)
        assert_close(analytic_fresnel(cos(angle), 1, n), analytic_fresnel(cos(asin(sin(angle) / n)), n, 1),
                     1e-13);
}

/* ---- flat interface ------------------------------------------------------------------------------------ */

static void interface_without_contrast(void **state)
{
    (void)state;
    struct analytic_interface scene = {.intensity = 7, .light_height = 1.2, .depth = 0.8, .ior = 1};
    for (double r = 0; r < 6; r += 0.37) {
        double distance2 = r * r + 4;
        assert_close(analytic_interface_irradiance(&scene, r), 7 * 2 / pow(distance2, 1.5), 1e-12);
    }
}

static void interface_without_depth(void **state)
{
    (void)state;
    struct analytic_interface scene = {.intensity = 3, .light_height = 2, .ior = 1.33};
    for (double r = 0; r < 6; r += 0.37) {
        double cosine = 2 / sqrt(r * r + 4);
        double expected = 3 * cosine * cosine * cosine / 4 * (1 - analytic_fresnel(cosine, 1, 1.33));
        assert_close(analytic_interface_irradiance(&scene, r), expected, 1e-12);
    }
}

/* Straight below, the floor seems raised to depth/n: E = T I / (h + d/n)^2. */
static void interface_below_light(void **state)
{
    (void)state;
    struct analytic_interface scene = {.intensity = 5, .light_height = 1, .depth = 1.5, .ior = 1.5};
    assert_close(analytic_interface_irradiance(&scene, 0), 5 * 0.96 / 4, 1e-12);
    assert_close(analytic_interface_irradiance(&scene, 1e-7), 5 * 0.96 / 4, 1e-9);
}

/* All flux inside a radius is what the cone that reaches it carries, less what is reflected. */
static void interface_keeps_flux(void **state)
{
    (void)state;
    const double iors[] = {1.5, 1.33, 0.75};
    for (size_t k = 0; k < sizeof iors / sizeof *iors; k++) {
        double n = iors[k], angle = 0.7, h = 1.1, d = 0.9;
        struct analytic_interface scene = {.intensity = 1, .light_height = h, .depth = d, .ior = n};
        double outer = h * tan(angle) + d * tan(asin(sin(angle) / n));
        double floor_flux = 0, cone_flux = 0;
        int steps = 20000;
        for (int i = 0; i < steps; i++) {
            double r = (i + 0.5) / steps * outer, a = (i + 0.5) / steps * angle;
            floor_flux += analytic_interface_irradiance(&scene, r) * 2 * pi * r * outer / steps;
            cone_flux += (1 - analytic_fresnel(cos(a), 1, n)) * 2 * pi * sin(a) * angle / steps;
        }
        assert_close(floor_flux, cone_flux, 1e-7);
    }
}

/* ---- ring ---------------------------------------------------------------------------------------------- */

/* Light from infinity: a nephroid with its cusps half a radius from the centre (rays along +x). */
static void nephroid(void **state)
{
    (void)state;
    struct analytic_ring ring = {
        .radius = 2, .wall_height = 0.3, .is_directional = true, .light = {3, 0}, .light_height = 0.01};
    struct analytic_ring_point point;
    for (double t = -1.5; t <= 1.5; t += 0.125) {
        assert_true(analytic_ring_caustic(&ring, t, &point));
        assert_close(point.position[0], 2 * (3 * cos(t) - cos(3 * t)) / 4, 1e-12);
        assert_close(point.position[1], 2 * (3 * sin(t) - sin(3 * t)) / 4, 1e-12);
    }
    assert_false(analytic_ring_caustic(&ring, 2.5, &point));
    double cusp[2];
    assert_true(analytic_ring_cusp(&ring, cusp));
    assert_close(cusp[0], 1, 1e-12);
    assert_close(cusp[1], 0, 1e-12);
}

/* Light on the circle: a cardioid, its cusp a third of the radius from the centre. */
static void cardioid(void **state)
{
    (void)state;
    struct analytic_ring ring = {.radius = 3, .wall_height = 0.3, .light = {-3, 0}, .light_height = 5};
    struct analytic_ring_point point;
    for (double t = -3; t <= 3; t += 0.125) {
        assert_true(analytic_ring_caustic(&ring, t, &point));
        assert_close(point.position[0], 3 * (2 * cos(t) - cos(2 * t)) / 3, 1e-12);
        assert_close(point.position[1], 3 * (2 * sin(t) - sin(2 * t)) / 3, 1e-12);
    }
    double cusp[2];
    assert_true(analytic_ring_cusp(&ring, cusp));
    assert_close(cusp[0], 1, 1e-12);
    assert_close(cusp[1], 0, 1e-12);
}

/* Any light: the envelope is where neighbouring reflected lines cross. */
static void envelope(void **state)
{
    (void)state;
    struct analytic_ring ring = {.radius = 1, .wall_height = 0.3, .light = {2.4, -0.6}, .light_height = 1.7};
    double delta = 1e-5;
    int compared = 0;
    for (double t = -pi; t < pi; t += 0.1) {
        struct analytic_ring_point point;
        if (!analytic_ring_caustic(&ring, t, &point))
            continue;
        double wall[2][2], way[2][2];
        for (int k = 0; k < 2; k++) {
            double angle = t + (k ? delta : -delta);
            wall[k][0] = cos(angle);
            wall[k][1] = sin(angle);
            double in[2] = {wall[k][0] - 2.4, wall[k][1] + 0.6};
            double along = in[0] * wall[k][0] + in[1] * wall[k][1];
            way[k][0] = in[0] - 2 * along * wall[k][0];
            way[k][1] = in[1] - 2 * along * wall[k][1];
        }
        double cross = way[0][0] * way[1][1] - way[0][1] * way[1][0];
        double s = ((wall[1][0] - wall[0][0]) * way[1][1] - (wall[1][1] - wall[0][1]) * way[1][0]) / cross;
        assert_close(point.position[0], wall[0][0] + s * way[0][0], 1e-4);
        assert_close(point.position[1], wall[0][1] + s * way[0][1], 1e-4);
        compared++;
    }
    assert_in_range(compared, 20, 60);
}

/* Which part of the curve is lit: on the axis, with the light at a distance of 4 radii and its height 1. */
static void lit_part(void **state)
{
    (void)state;
    struct analytic_ring ring = {.radius = 1, .light = {-4, 0}, .light_height = 1};
    struct analytic_ring_point point;
    /* p = 5, q = 5/9: the ray that reaches the cusp meets the wall at (5/9) / (5 + 5/9) = 0.1, and passes
     * over the near side at 0.1 + 2 / (5 + 5/9) = 0.46. */
    const double heights[] = {0.0999, 0.1001, 0.4599, 0.4601};
    const bool lit[] = {false, true, true, false};
    for (int i = 0; i < 4; i++) {
        ring.wall_height = heights[i];
        assert_true(analytic_ring_caustic(&ring, 0, &point));
        assert_close(point.distance, 5.0 / 9, 1e-12);
        assert_int_equal(point.is_lit, lit[i]);
    }
    /* A light inside has no near side to pass. */
    ring.light[0] = -0.9;
    ring.wall_height = 0.9;
    assert_true(analytic_ring_caustic(&ring, 0, &point));
    assert_true(point.is_lit);

    /* At the middle of a radius the wall beyond it sends parallel rays back; at the centre all return there.
     */
    double cusp[2];
    ring.light[0] = 0.5;
    assert_false(analytic_ring_caustic(&ring, 0, &point));
    ring.light[0] = 0;
    assert_false(analytic_ring_cusp(&ring, cusp));
    assert_true(analytic_ring_caustic(&ring, 1, &point));
    assert_close(hypot(point.position[0], point.position[1]), 0, 1e-12);
}

/* Light from a lamp on the axis of the ring: by symmetry, the flux per ring of floor from its solid angle.
 * And for any lamp the flux that meets the wall once and then the floor is that of the directions that do so.
 */
static void ring_flux(void **state)
{
    (void)state;
    struct analytic_ring ring = {.radius = 0.5, .wall_height = 0.25, .light = {0, 0}, .light_height = 1.7};
    struct analytic_ring_ray ray;
    double sum = 0, limit = 0.5 * 0.25 / (1.7 - 0.25); /* where light over the wall's edge lands */
    int steps = 20000;
    for (int i = 0; i < steps; i++) {
        assert_true(analytic_ring_trace(&ring, 1, (i + 0.5) / steps, &ray));
        assert_close(hypot(ray.position[0], ray.position[1]), fabs(0.5 - (i + 0.5) / steps), 1e-12);
        sum += ray.flux / steps;
    }
    double near = sin(atan(1.7 / 0.5)), far = sin(atan(1.7 / (0.5 + limit)));
    assert_close(sum, near - far, 1e-5);

    /* A lamp beside the axis, outside, against directions shot at the ring one by one, traced in three
     * dimensions. */
    ring.light[0] = 1.4;
    ring.light[1] = -0.6;
    double total = 0, shot = 0;
    for (int i = 0; i < 2000; i++)
        for (int j = 0; j < 500; j++)
            if (analytic_ring_trace(&ring, 2 * pi * (i + 0.5) / 2000, (j + 0.5) / 500, &ray))
                total += ray.flux * 2 * pi / 2000 / 500;
    double half = asin(0.5 / hypot(1.4, 0.6)), middle = atan2(0.6, -1.4);
    for (int i = 0; i < 2000; i++) {
        double azimuth = middle + half * (2 * (i + 0.5) / 2000 - 1);
        double way[2] = {cos(azimuth), sin(azimuth)};
        double along = -(1.4 * way[0] - 0.6 * way[1]);
        double chord = sqrt(0.25 - (1.4 * 1.4 + 0.6 * 0.6 - along * along)); /* half of it */
        for (int j = 0; j < 2000; j++) {
            double sine = (j + 0.5) / 2000, fall = sine / sqrt(1 - sine * sine);
            double near_side = 1.7 - fall * (along - chord), far_side = 1.7 - fall * (along + chord);
            /* After the wall the floor lies far_side / fall away; the next wall a whole chord. */
            if (near_side >= 0.25 && far_side > 0 && far_side <= 0.25 && far_side / fall <= 2 * chord)
                shot += 2 * half / 2000 / 2000;
        }
    }
    assert_true(shot > 0.01);
    assert_close(total / shot, 1, 1e-3);

    /* From far away: what passes over a level area the size of the ring, as far as it meets the wall. */
    ring.is_directional = true;
    ring.light_height = 0.5;
    ring.wall_height = 0.2;
    assert_true(analytic_ring_trace(&ring, atan2(-0.6, 1.4), 0.3, &ray));
    assert_close(ray.flux, 0.5 * sin(atan(0.5)), 1e-12);
    assert_true(analytic_ring_trace(&ring, atan2(-0.6, 1.4), 0.41, &ray));
    assert_close(ray.flux, 0, 0);
}

/* ---- sphere -------------------------------------------------------------------------------------------- */

static const struct analytic_sphere ball = {
    .intensity = 2, .radius = 0.5, .ior = 1.5, .centre_height = 0.9, .light_height = 3};

/* A vector ray tracer for the plane through the axis: x outward, y up, the centre at the origin. */
static double trace_plane(const struct analytic_sphere *scene, enum analytic_sphere_path path, double angle,
                          double *share)
{
    double origin[2] = {0, scene->light_height}, way[2] = {sin(angle), -cos(angle)}, radius = scene->radius;
    double ior = 1;
    int crossings = path == ANALYTIC_SPHERE_REFLECTED ? 1 : path == ANALYTIC_SPHERE_TRANSMITTED ? 2 : 3;
    *share = 1;
    for (int i = 0; i < crossings; i++) {
        double along = origin[0] * way[0] + origin[1] * way[1];
        double square = along * along - (origin[0] * origin[0] + origin[1] * origin[1] - radius * radius);
        double t = i == 0 ? -along - sqrt(square) : -2 * along;
        origin[0] += t * way[0];
        origin[1] += t * way[1];
        if (i)
            *share *= exp(-scene->extinction * t);
        double normal[2] = {origin[0] / radius, origin[1] / radius};
        double cosine = -(way[0] * normal[0] + way[1] * normal[1]);
        if (cosine < 0) {
            cosine = -cosine;
            normal[0] = -normal[0];
            normal[1] = -normal[1];
        }
        double other = ior == 1 ? scene->ior : 1;
        double reflectance = analytic_fresnel(cosine, ior, other);
        if (path == ANALYTIC_SPHERE_REFLECTED || (path == ANALYTIC_SPHERE_ONE_INTERNAL && i == 1)) {
            *share *= reflectance;
            way[0] += 2 * cosine * normal[0];
            way[1] += 2 * cosine * normal[1];
        } else {
            *share *= 1 - reflectance;
            double eta = ior / other, rest = sqrt(1 - eta * eta * (1 - cosine * cosine));
            way[0] = eta * way[0] + (eta * cosine - rest) * normal[0];
            way[1] = eta * way[1] + (eta * cosine - rest) * normal[1];
            ior = other;
        }
    }
    if (way[1] >= 0)
        return NAN;
    return origin[0] + way[0] / -way[1] * (origin[1] + scene->centre_height);
}

static void sphere_rays(void **state)
{
    (void)state;
    struct analytic_sphere clear = ball, tinted = ball;
    tinted.extinction = 1.7;
    const enum analytic_sphere_path paths[] = {ANALYTIC_SPHERE_REFLECTED, ANALYTIC_SPHERE_TRANSMITTED,
                                               ANALYTIC_SPHERE_ONE_INTERNAL};
    int landed = 0;
    for (size_t k = 0; k < 3; k++) {
        for (double incidence = 0.01; incidence < 1.57; incidence += 0.01) {
            const struct analytic_sphere *scene = landed % 2 ? &tinted : &clear;
            struct analytic_sphere_ray ray;
            double share;
            analytic_sphere_trace(scene, paths[k], incidence, &ray);
            double position = trace_plane(scene, paths[k], ray.angle, &share);
            assert_int_equal(ray.lands, isfinite(position));
            assert_close(ray.share, share, 1e-9);
            if (ray.lands && fabs(position) < 100) {
                assert_close(ray.position, position, 1e-6 * (1 + position * position));
                landed++;
            }
        }
    }
    assert_in_range(landed, 150, 471);
}

/* A ball lens has the focal length n R / (2 (n - 1)) from its centre. */
static void sphere_focus(void **state)
{
    (void)state;
    struct analytic_sphere scene = ball;
    double focal = 1.5 * 0.5 / (2 * 0.5);
    scene.centre_height = 1 / (1 / focal - 1 / scene.light_height);
    struct analytic_sphere_ray ray;
    analytic_sphere_trace(&scene, ANALYTIC_SPHERE_TRANSMITTED, 1e-3, &ray);
    assert_close(ray.position / 1e-3, 0, 1e-5);
    scene.centre_height += 0.1;
    analytic_sphere_trace(&scene, ANALYTIC_SPHERE_TRANSMITTED, 1e-3, &ray);
    assert_true(fabs(ray.position / 1e-3) > 0.01);
}

/* The first rainbow of water: least deviation where cos i = sqrt((n^2 - 1) / 3), 137.97 degrees for n = 4/3.
 */
static void sphere_rainbow(void **state)
{
    (void)state;
    struct analytic_sphere scene = ball;
    scene.ior = 4.0 / 3;
    scene.light_height = 1e9;
    double least = pi;
    for (double incidence = 0; incidence < 1.57; incidence += 1e-4) {
        struct analytic_sphere_ray ray;
        analytic_sphere_trace(&scene, ANALYTIC_SPHERE_ONE_INTERNAL, incidence, &ray);
        least = fmin(least, fabs(ray.leaving));
    }
    double incidence = acos(sqrt((scene.ior * scene.ior - 1) / 3));
    double expected = pi + 2 * incidence - 4 * asin(sin(incidence) / scene.ior);
    assert_close(least, expected, 1e-6);
    assert_close(least * 180 / pi, 137.97, 0.01);
}

/* A sphere of air in air changes nothing: the floor's own irradiance inside the sphere's shadow, none
 * outside. */
static void sphere_of_air(void **state)
{
    (void)state;
    struct analytic_sphere scene = ball;
    scene.ior = 1;
    double height = scene.centre_height + scene.light_height;
    double shadow = height * tan(asin(scene.radius / scene.light_height));
    double edges[13], irradiance[12]; /* ten rings in the shadow, two outside */
    for (int i = 0; i < 13; i++)
        edges[i] = shadow * i / 10;
    double all = ANALYTIC_SPHERE_REFLECTED + ANALYTIC_SPHERE_TRANSMITTED + ANALYTIC_SPHERE_ONE_INTERNAL;
    double landed = analytic_sphere_profile(&scene, (unsigned)all, edges, 12, irradiance, 0);
    for (int i = 0; i < 10; i++) {
        /* Flux of the ring from its solid angle, over its area. */
        double inner = height / hypot(height, edges[i]), outer = height / hypot(height, edges[i + 1]);
        double area = pi * (edges[i + 1] * edges[i + 1] - edges[i] * edges[i]);
        assert_close(irradiance[i], 2 * 2 * pi * (inner - outer) / area, 1e-6);
    }
    assert_close(irradiance[11], 0, 1e-25); /* Fresnel terms of rounding, squared */
    assert_close(landed, 2 * 2 * pi * (1 - cos(asin(scene.radius / scene.light_height))), 1e-9);
}

/* The rings hold exactly the flux that lands, and any two sets of rings agree on it; halving the step changes
 * nothing. */
static void sphere_keeps_flux(void **state)
{
    (void)state;
    double edges[201], rough_edges[3] = {0, 10, 2000}, irradiance[200], finer[200], rough[2];
    for (int i = 0; i <= 200; i++)
        edges[i] = 0.05 * i;
    unsigned paths = ANALYTIC_SPHERE_TRANSMITTED;
    double landed = analytic_sphere_profile(&ball, paths, edges, 200, irradiance, 0);
    double same = analytic_sphere_profile(&ball, paths, rough_edges, 2, rough, 0);
    analytic_sphere_profile(&ball, paths, edges, 200, finer, 800000);
    double flux = 0, difference = 0, total = 0;
    for (int i = 0; i < 200; i++) {
        flux += irradiance[i] * pi * (edges[i + 1] * edges[i + 1] - edges[i] * edges[i]);
        difference += fabs(irradiance[i] - finer[i]);
        total += finer[i];
    }
    assert_close(landed, same, 1e-12);
    assert_close(flux, rough[0] * pi * 100, 1e-9);
    assert_close(flux + rough[1] * pi * (4e6 - 100), landed, 1e-6);
    assert_true(difference / total < 1e-5);

    /* Every ray through this sphere goes down: all flux that enters, less both Fresnel losses, lands. */
    double expected = 0;
    int steps = 100000;
    for (int i = 0; i < steps; i++) {
        double angle = (i + 0.5) / steps * asin(ball.radius / ball.light_height);
        double incidence = asin(fmin(sin(angle) * ball.light_height / ball.radius, 1));
        double transmittance = 1 - analytic_fresnel(cos(incidence), 1, ball.ior);
        expected += 2 * 2 * pi * sin(angle) * transmittance * transmittance *
                    asin(ball.radius / ball.light_height) / steps;
    }
    assert_close(landed, expected, 2e-5);
}

/* Against 4 million rays shot at the sphere and binned where vectors say they land. */
static void sphere_profile(void **state)
{
    (void)state;
    enum { RINGS = 40, RAYS = 4000000 };
    unsigned paths = ANALYTIC_SPHERE_REFLECTED | ANALYTIC_SPHERE_TRANSMITTED | ANALYTIC_SPHERE_ONE_INTERNAL;
    double edges[RINGS + 1], irradiance[RINGS], binned[RINGS] = {0};
    for (int i = 0; i <= RINGS; i++)
        edges[i] = 0.02 * i;
    analytic_sphere_profile(&ball, paths, edges, RINGS, irradiance, 0);

    double cap = 1 - cos(asin(ball.radius / ball.light_height));
    for (int i = 0; i < RAYS; i++) {
        double angle = acos(1 - cap * (i + 0.5) / RAYS);
        for (unsigned path = 1; path <= ANALYTIC_SPHERE_ONE_INTERNAL; path <<= 1) {
            double share, position = fabs(trace_plane(&ball, (enum analytic_sphere_path)path, angle, &share));
            if (position < edges[RINGS])
                binned[(int)(position / 0.02)] += ball.intensity * 2 * pi * cap / RAYS * share;
        }
    }
    double difference = 0, total = 0;
    for (int i = 0; i < RINGS; i++) {
        double area = pi * (edges[i + 1] * edges[i + 1] - edges[i] * edges[i]);
        difference += fabs(irradiance[i] * area - binned[i]);
        total += binned[i];
    }
    print_message("sphere profile against %d traced rays: relative L1 %.2e\n", RAYS, difference / total);
    assert_true(difference / total < 1e-4);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(fresnel),
        cmocka_unit_test(interface_without_contrast),
        cmocka_unit_test(interface_without_depth),
        cmocka_unit_test(interface_below_light),
        cmocka_unit_test(interface_keeps_flux),
        cmocka_unit_test(nephroid),
        cmocka_unit_test(cardioid),
        cmocka_unit_test(envelope),
        cmocka_unit_test(lit_part),
        cmocka_unit_test(ring_flux),
        cmocka_unit_test(sphere_rays),
        cmocka_unit_test(sphere_focus),
        cmocka_unit_test(sphere_rainbow),
        cmocka_unit_test(sphere_of_air),
        cmocka_unit_test(sphere_keeps_flux),
        cmocka_unit_test(sphere_profile),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
