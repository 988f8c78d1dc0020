/* test_pass_compact.c: photon_scan and photon_compact: the next bounce's queue and the photon list against a
 * serial loop, and every photon's footprint against its projection by finite differences, in double
 * precision.
 */
#include <string.h>

#include "core/image/image_io.h"
#include "tests/support/check.h"
#include "tests/support/pass_device.h"
#include "tests/support/tile_maps.h"

enum { WIDTH = 60, HEIGHT = 40, PIXELS = WIDTH * HEIGHT, RAYS = 2000, CELLS = 16, BASE = 77 };
enum { GROUPS = (RAYS + GROUP_SIZE - 1) / GROUP_SIZE };

static struct pass_device *device;
static uint64_t random_state;

static int set_up(void **state)
{
    (void)state;
    device = pass_device_create();
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    pass_device_destroy(&device);
    return 0;
}

static double between(double low, double high)
{
    return low + (high - low) * pass_random(&random_state);
}

static struct vector add(struct vector a, struct vector b, double scale)
{
    return (struct vector){a.x + scale * b.x, a.y + scale * b.y, a.z + scale * b.z};
}

static struct vector unit(struct vector a)
{
    return add((struct vector){0, 0, 0}, a, 1 / sqrt(vector_dot(a, a)));
}

static struct vector anywhere(void)
{
    double x = between(-1, 1), y = between(-1, 1);
    return (struct vector){x, y, between(-1, 1)};
}

static vec4 with_w(struct vector v, float w)
{
    return (vec4){(float)v.x, (float)v.y, (float)v.z, w};
}

/* ---- scan ---------------------------------------------------------------------------------------------- */

static void run_scan(struct frame_gpu *frame, struct counters_gpu *counters, uint32_t *totals,
                     uint32_t groups, uint32_t parity)
{
    pass_device_run(device,
                    &(struct pass_run){.shader = "photon_scan.comp",
                                       .has_push = true,
                                       .push = parity,
                                       .threads = 1,
                                       PASS_LISTS({BINDING_FRAME, GPU_READ, frame, sizeof *frame},
                                                  {BINDING_PASS, GPU_READ_WRITE, counters, sizeof *counters},
                                                  {BINDING_PASS + 1, GPU_READ_WRITE, totals, groups * 8})});
}

static void sums_are_those_of_a_loop(void **state)
{
    (void)state;
    static const uint32_t counts[] = {1, 2, 63, 64, 65, 1000, 4099};
    random_state = 2;
    for (uint32_t i = 0; i < sizeof counts / sizeof *counts; i++) {
        uint32_t groups = counts[i], parity = i % 2, children = 0, photons = 0;
        uint32_t *totals = calloc(2 * groups, sizeof *totals),
                 *expected = calloc(2 * groups, sizeof *expected);
        assert_true(totals && expected);
        for (uint32_t k = 0; k < groups; k++) {
            totals[2 * k] = (uint32_t)between(0, 129);
            totals[2 * k + 1] = (uint32_t)between(0, 65);
            expected[2 * k] = children;
            expected[2 * k + 1] = photons;
            children += totals[2 * k];
            photons += totals[2 * k + 1];
        }
        for (int is_full = 0; is_full < 2; is_full++) {
            /* room for every ray to split, or for one ray less than that */
            struct frame_gpu frame = {.ray_capacity = 2 * children + 8,
                                      .photon_capacity = BASE + photons + 2 * children};
            frame.ray_capacity = is_full == 1 && i % 2 ? 2 * children - 1 : frame.ray_capacity;
            frame.photon_capacity -= is_full == 1 && i % 2 == 0;
            struct counters_gpu counters = {.photon_count = BASE};
            counters.queue[4 * parity] = groups;
            counters.queue[4 * parity + QUEUE_COUNT] = groups * GROUP_SIZE - 5;
            uint32_t *found = malloc(groups * 8);
            assert_non_null(found);
            memcpy(found, totals, groups * 8);
            run_scan(&frame, &counters, found, groups, parity);
            assert_memory_equal(found, expected, groups * 8);
            uint32_t next = 4 * (1 - parity);
            assert_int_equal(counters.queue[next + QUEUE_COUNT], children);
            assert_int_equal(counters.queue[next], (children + GROUP_SIZE - 1) / GROUP_SIZE);
            assert_int_equal(counters.photon_base, BASE);
            assert_int_equal(counters.photon_count, BASE + photons);
            assert_int_equal(counters.photon_groups[0], (BASE + photons + GROUP_SIZE - 1) / GROUP_SIZE);
            assert_int_equal(counters.count[COUNT_RAYS], groups * GROUP_SIZE - 5);
            assert_int_equal(counters.count[COUNT_STORED], photons);
            assert_int_equal(counters.stride[1 - parity], is_full ? 1 : 2);
            assert_int_equal(counters.count[COUNT_GUARD_SPLIT], is_full);
            free(found);
        }
        free(totals);
        free(expected);
    }
}

/* ---- compact ------------------------------------------------------------------------------------------- */

struct line_up {
    struct frame_gpu frame;
    uint32_t features, aa;
    struct target_gpu targets[PIXELS];
    struct photon_ray rays[RAYS];
    uint32_t queue[RAYS], outcomes[RAYS], totals[2 * GROUPS], tree[CELLS];
    struct counters_gpu counters;
    uint32_t next[2 * RAYS];
    struct photon photons[BASE + RAYS];
};

static struct vector project(const struct frame_gpu *frame, struct vector relative)
{
    double z = vector_dot(relative, vector_of(frame->forward));
    return (struct vector){
        (double)frame->center.z + (double)frame->center.x * vector_dot(relative, vector_of(frame->right)) / z,
        (double)frame->center.w + (double)frame->center.y * vector_dot(relative, vector_of(frame->up)) / z,
        z};
}

/* Direction through a place on screen. */
static struct vector unproject(const struct frame_gpu *frame, double x, double y)
{
    struct vector d = add(vector_of(frame->forward), vector_of(frame->right),
                          (x - (double)frame->center.z) / (double)frame->center.x);
    return add(d, vector_of(frame->up), (y - (double)frame->center.w) / (double)frame->center.y);
}

static uint32_t pack_normal(struct vector n)
{
    double sum = fabs(n.x) + fabs(n.y) + fabs(n.z), x = n.x / sum, y = n.y / sum;
    if (n.z < 0) {
        double across = x;
        x = copysign(1 - fabs(y), x);
        y = copysign(1 - fabs(across), y);
    }
    return ((uint32_t)lround(x * 32767) & 0xffff) | (uint32_t)lround(y * 32767) << 16;
}

/* Some rays go on, some split, some are deposits: each deposit on the surface of a pixel of its own, but for
 * every tenth that faces away from the camera or lies behind it. `spread` px: their footprints. */
static struct line_up *line_up_of(double spread)
{
    struct line_up *l = calloc(1, sizeof *l);
    assert_non_null(l);
    l->features = FEATURE_CHROMATIC;
    struct frame_gpu *frame = &l->frame;
    struct vector forward = unit((struct vector){0.4, -0.7, -0.6}),
                  right = unit(vector_cross(forward, (struct vector){0, 1, 0}));
    const float focal = 55;
    *frame = (struct frame_gpu){.eye = {1, 2, 3, 0},
                                .forward = with_w(forward, 1 / (focal * focal)),
                                .right = with_w(right, 0),
                                .up = with_w(vector_cross(right, forward), 0),
                                .center = {focal, -focal, 0.5f * WIDTH, 0.5f * HEIGHT},
                                .width = WIDTH,
                                .height = HEIGHT,
                                .kappa = 1.3f,
                                .filter_radius = 0.75f,
                                .max_radius = 1e4f,
                                .max_anisotropy = 1e4f,
                                .cell_flux = 2,
                                .flux_unit = 0x1p-20f};
    for (uint32_t i = 0; i < CELLS; i++)
        l->tree[i] = (i + 1) * (i + 1);
    for (uint32_t i = 0; i < PIXELS; i++)
        memset(&l->targets[i].position_normal.w, 0xff, 4);
    for (uint32_t i = 0; i < RAYS; i++)
        l->queue[i] = (i * 1237u + 55u) % RAYS; /* every slot once */
    for (uint32_t i = 0; i < RAYS; i++) {
        static const uint32_t choices[] = {0, OUTCOME_CHILD0, OUTCOME_CHILD0 | OUTCOME_CHILD1, OUTCOME_PHOTON,
                                           OUTCOME_PHOTON};
        l->outcomes[i] = choices[(uint32_t)between(0, 5)];
        uint32_t *totals = &l->totals[2 * (i / GROUP_SIZE)];
        totals[0] += (l->outcomes[i] & 1) + (l->outcomes[i] >> 1 & 1);
        totals[1] += l->outcomes[i] == OUTCOME_PHOTON;
        double x = i % WIDTH + between(0.1, 0.9), y = i / WIDTH + between(0.1, 0.9), depth = between(2, 6);
        struct vector p = add((struct vector){0, 0, 0}, unproject(frame, x, y), depth), n;
        do
            n = unit(anywhere());
        while (vector_dot(n, unit(p)) > -0.3);
        struct vector u = anywhere(), v = anywhere();
        u = add(u, n, -vector_dot(u, n));
        v = add(v, n, -vector_dot(v, n));
        double scale = spread * exp(between(-1.5, 1.5)) * depth / (double)focal;
        if (i % 10 == 3)
            n = add((struct vector){0, 0, 0}, n, -1); /* faces away */
        else if (i % 10 == 7)
            p = add((struct vector){0, 0, 0}, p, -1); /* behind the camera, and facing it */
        struct photon_ray *ray = &l->rays[l->queue[i]];
        *ray = (struct photon_ray){
            .origin = with_w(add(p, vector_of(frame->eye), 1), 1000),
            .direction = with_w(n, (float)between(1, 4)),
            .flux = {(float)between(0.1, 1), (float)between(0.1, 1), (float)between(0.1, 1), 4},
            .cell = i % CELLS,
            .state = 2 | i % 3 << 22};
        ray->dp_u_v0 =
            (vec4){(float)(scale * u.x), (float)(scale * u.y), (float)(scale * u.z), (float)(scale * v.x)};
        ray->dp_v1_dd_u = (vec4){(float)(scale * v.y), (float)(scale * v.z), 0, 0};
        struct target_gpu *target = &l->targets[i];
        target->position_normal = with_w(p, 0);
        uint32_t bits = pack_normal(n);
        memcpy(&target->position_normal.w, &bits, 4);
    }
    return l;
}

static void run_compact(struct line_up *l, uint32_t parity)
{
    uint32_t totals[2 * GROUPS];
    memcpy(totals, l->totals, sizeof totals);
    l->counters = (struct counters_gpu){.photon_count = BASE, .stride = {2, 2}};
    l->frame.ray_capacity = l->frame.photon_capacity = 8 * RAYS;
    l->counters.queue[4 * parity] = GROUPS;
    l->counters.queue[4 * parity + QUEUE_COUNT] = RAYS;
    run_scan(&l->frame, &l->counters, totals, GROUPS, parity);
    memset(l->next, 0xee, sizeof l->next);
    memset(l->photons, 0xee, sizeof l->photons);
    pass_device_run(device, &(struct pass_run){
                                .shader = "photon_compact.comp",
                                .features = l->features,
                                .aa = l->aa,
                                .has_push = true,
                                .push = parity,
                                .threads = RAYS,
                                PASS_LISTS({BINDING_FRAME, GPU_READ, &l->frame, sizeof l->frame},
                                           {BINDING_PASS, GPU_READ_WRITE, &l->counters, sizeof l->counters},
                                           {BINDING_PASS + 1, GPU_READ, l->targets, sizeof l->targets},
                                           {BINDING_PASS + 2, GPU_READ, l->rays, sizeof l->rays},
                                           {BINDING_PASS + 3, GPU_READ, l->queue, sizeof l->queue},
                                           {BINDING_PASS + 4, GPU_READ, l->outcomes, sizeof l->outcomes},
                                           {BINDING_PASS + 5, GPU_READ, totals, sizeof totals},
                                           {BINDING_PASS + 6, GPU_WRITE, l->next, sizeof l->next},
                                           {BINDING_PASS + 7, GPU_WRITE, l->photons, sizeof l->photons},
                                           {BINDING_PASS + 8, GPU_READ, l->tree, sizeof l->tree},
                                           {BINDING_PASS + 9, GPU_WRITE, NULL, 0},
                                           {BINDING_PASS + 10, GPU_READ, NULL, 0})});
}

static double sum3(vec4 v)
{
    return (double)v.x + (double)v.y + (double)v.z;
}

static double flux_of(const struct line_up *l, int fate)
{
    return pass_fixed(l->counters.flux_low[fate], l->counters.flux_high[fate]) * (double)l->frame.flux_unit;
}

static void lists_keep_their_order(void **state)
{
    (void)state;
    for (uint32_t parity = 0; parity < 2; parity++) {
        random_state = 3;
        struct line_up *l = line_up_of(2);
        run_compact(l, parity);
        uint32_t children = 0, photons = BASE, seen = 0;
        double flux = 0, hidden = 0;
        for (uint32_t i = 0; i < RAYS; i++) {
            if (l->outcomes[i] & OUTCOME_CHILD0)
                assert_int_equal(l->next[children++], 2 * i);
            if (l->outcomes[i] & OUTCOME_CHILD1)
                assert_int_equal(l->next[children++], 2 * i + 1);
            if (l->outcomes[i] != OUTCOME_PHOTON)
                continue;
            const struct photon_ray *ray = &l->rays[l->queue[i]];
            const struct photon *p = &l->photons[photons++];
            assert_true(p->position.x == ray->origin.x - l->frame.eye.x);
            assert_true(p->position.y == ray->origin.y - l->frame.eye.y);
            bool is_hidden = i % 10 == 3 || i % 10 == 7;
            assert_int_equal(p->cell, is_hidden ? NONE : i % CELLS | i % 3 << CELL_SPACING_SHIFT);
            seen += !is_hidden;
            *(is_hidden ? &hidden : &flux) += sum3(ray->flux);
        }
        assert_int_equal(l->counters.photon_count, photons);
        assert_int_equal(l->counters.queue[4 * (1 - parity) + QUEUE_COUNT], children);
        for (uint32_t i = children; i < 2 * RAYS; i++)
            assert_int_equal(l->next[i], 0xeeeeeeee);
        for (uint32_t i = 0; i < BASE; i++) /* earlier bounces' photons stay */
            assert_int_equal(l->photons[i].cell, 0xeeeeeeee);
        assert_int_equal(l->counters.count[COUNT_SPLATTED], seen);
        assert_int_equal(l->counters.count[COUNT_CULLED_VISIBILITY], photons - BASE - seen);
        assert_close(flux_of(l, FATE_SPLATTED), flux, 1e-5 * flux);
        assert_close(flux_of(l, FATE_CULLED_VISIBILITY), hidden, 1e-5 * hidden);
        print_message("%u children, %u photons, %u of them seen\n", children, photons - BASE, seen);
        assert_true(children > 500 && seen > 300);
        free(l);
    }
}

/* A photon's covariance on screen, from differences of projected points. */
struct footprint {
    double xx, xy, yy, area, jacobian; /* px^2; jacobian: px^2 per m^2 of the tangent plane */
    struct vector t1, t2;              /* tangents, and their images in px per m */
    double j1[2], j2[2];
};

static void image(const struct frame_gpu *frame, struct vector p, struct vector change, double result[2])
{
    const double step = 1e-5;
    struct vector a = project(frame, add(p, change, -step)), b = project(frame, add(p, change, step));
    result[0] = (b.x - a.x) / (2 * step);
    result[1] = (b.y - a.y) / (2 * step);
}

static struct footprint footprint_of(const struct line_up *l, const struct photon_ray *ray)
{
    struct footprint f;
    double a[2], b[2], kappa = (double)l->frame.kappa;
    struct vector p = add(vector_of(ray->origin), vector_of(l->frame.eye), -1), n = vector_of(ray->direction);
    image(&l->frame, p, vector_of(ray->dp_u_v0), a);
    image(&l->frame, p,
          (struct vector){(double)ray->dp_u_v0.w, (double)ray->dp_v1_dd_u.x, (double)ray->dp_v1_dd_u.y}, b);
    f.xx = kappa * (a[0] * a[0] + b[0] * b[0]);
    f.xy = kappa * (a[0] * a[1] + b[0] * b[1]);
    f.yy = kappa * (a[1] * a[1] + b[1] * b[1]);
    f.area = fabs(a[0] * b[1] - a[1] * b[0]);
    f.t1 = unit(vector_cross(n, (struct vector){0.3, 0.5, 0.81}));
    f.t2 = vector_cross(n, f.t1);
    image(&l->frame, p, f.t1, f.j1);
    image(&l->frame, p, f.t2, f.j2);
    f.jacobian = fabs(f.j1[0] * f.j2[1] - f.j1[1] * f.j2[0]);
    return f;
}

static void footprints_follow_the_projection(void **state)
{
    (void)state;
    for (uint32_t aa = AA_FILTER; aa <= AA_NONE; aa++) {
        random_state = 5;
        struct line_up *l = line_up_of(2);
        l->aa = aa;
        l->frame.max_anisotropy = 64;
        run_compact(l, 0);
        uint32_t photon = BASE, checked = 0, bent = 0, boxes = 0;
        double worst_form = 0, worst_flux = 0, worst_bend = 0, worst_area = 0;
        for (uint32_t i = 0; i < RAYS; i++) {
            if (l->outcomes[i] != OUTCOME_PHOTON)
                continue;
            const struct photon *p = &l->photons[photon++];
            const struct photon_ray *ray = &l->rays[l->queue[i]];
            if (p->cell == NONE)
                continue;
            checked++;
            struct footprint f = footprint_of(l, ray);
            if (p->ellipse.w < 0) {
                /* Below a pixel a box without filter: of the variance C / 6 that the kernel has, so its sides
                 * are sqrt(2 C); the pixels share the flux. */
                boxes++;
                assert_true(fmax(f.xx, f.yy) <= 0.5 * (1 + 1e-4));
                assert_close((double)p->ellipse.x, sqrt(2 * f.xx), 1e-4);
                assert_close((double)p->ellipse.y, sqrt(2 * f.yy), 1e-4);
                worst_flux =
                    fmax(worst_flux, fabs((double)p->density.x / f.jacobian / (double)ray->flux.x - 1));
                continue;
            }
            assert_true(aa == AA_NONE || fmax(f.xx, f.yy) >= 0.5 * (1 - 1e-4));
            double filter = aa == AA_FILTER ? pow((double)l->frame.filter_radius, 2) : 1e-6;
            double xx = f.xx + filter, yy = f.yy + filter, xy = f.xy, det = xx * yy - xy * xy;
            double middle = 0.5 * (f.xx + f.yy), apart = hypot(0.5 * (f.xx - f.yy), f.xy);
            if (middle + apart > 64 * 64 * (middle - apart + filter))
                continue; /* limited: another test's */
            /* U^T U is the covariance's inverse */
            double u00 = (double)p->ellipse.x, u01 = (double)p->ellipse.y, u11 = (double)p->ellipse.z;
            double trace = (xx + yy) / det;
            worst_form = fmax(worst_form, fabs(u00 * u00 - yy / det) / trace);
            worst_form = fmax(worst_form, fabs(u00 * u01 + xy / det) / trace);
            worst_form = fmax(worst_form, fabs(u01 * u01 + u11 * u11 - xx / det) / trace);
            struct vector relative = add(vector_of(ray->origin), vector_of(l->frame.eye), -1);
            struct vector center = project(&l->frame, relative);
            assert_close((double)p->center.x, center.x, 1e-3);
            assert_close((double)p->center.y, center.y, 1e-3);

            /* the kernel 2 (1 - r^2) / pi, or a flat one, integrates to the photon's flux over the plane */
            double metres = PI * sqrt(det) / f.jacobian * (aa == AA_FILTER ? 0.5 : 1);
            worst_flux = fmax(worst_flux, fabs((double)p->density.x * metres / (double)ray->flux.x - 1));
            worst_flux = fmax(worst_flux, fabs((double)p->density.z * metres / (double)ray->flux.z - 1));
            worst_area = fmax(worst_area, fabs((double)p->area / f.area - 1) * fmin(1, f.area));
            double share = sum3(ray->flux) / ((double)ray->flux.w * l->tree[ray->cell]);
            assert_close((double)image_half_to_float((uint16_t)p->shape), share, 0x1p-11 * share + 1e-7);
            if (f.area > 1 && f.area < 15)
                assert_close((double)p->root, sqrt(f.area * sum3(ray->flux) / 2), 1e-3 * (double)p->root);

            /* the ellipse of the plane, seen in perspective, at eight places within it */
            double w0 = (double)p->center.z, w1 = (double)p->center.w;
            double bend = sqrt(w0 * w0 * xx + 2 * w0 * w1 * xy + w1 * w1 * yy);
            if (bend > 0.499) {
                assert_close(bend, 0.5, 1e-3);
                bent++;
                continue;
            }
            for (int k = 0; k < 8; k++) {
                double c = cos(k * PI / 4), s = sin(k * PI / 4), y = s / u11,
                       x = (c - u01 * y) / u00;           /* |U o| = 1 */
                double out = 1 / (1 - (w0 * x + w1 * y)); /* on the rim r = 1 */
                assert_true(fabs(y * out) <= (double)p->ellipse.w * (1 + 1e-4));

                double reach = 0.8 * out;
                struct vector way = unproject(&l->frame, center.x + reach * x, center.y + reach * y);
                struct vector n = vector_of(ray->direction);
                struct vector on_plane =
                    add(add((struct vector){0, 0, 0}, way, vector_dot(relative, n) / vector_dot(way, n)),
                        relative, -1);
                double m1 = vector_dot(on_plane, f.t1), m2 = vector_dot(on_plane, f.t2);
                double ox = f.j1[0] * m1 + f.j2[0] * m2, oy = f.j1[1] * m1 + f.j2[1] * m2;
                double exact = (yy * ox * ox - 2 * xy * ox * oy + xx * oy * oy) / det;
                double found = pow(reach / (1 + (w0 * x + w1 * y) * reach), 2);
                worst_bend = fmax(worst_bend, fabs(found - exact));
            }
        }
        print_message("%s: %u photons, %u boxes, %u near the horizon; form %.1e, flux %.1e, area %.1e, "
                      "perspective %.1e\n",
                      aa == AA_FILTER ? "filter" : "none", checked, boxes, bent, worst_form, worst_flux,
                      worst_area, worst_bend);
        assert_true(checked > 300 && bent < checked / 10);
        /* the determinant of a covariance 64 times as long as wide loses 64^2 roundings */
        const double tolerance = aa == AA_FILTER ? 3e-5 : 64 * 64 * 6e-8;
        assert_in_bound(worst_flux, tolerance);
        assert_in_bound(worst_form, tolerance);
        if (aa == AA_FILTER) /* without filter an ellipse is too thin to say where its rim is */
            assert_in_bound(worst_bend, tolerance);
        assert_in_bound(worst_area, 3e-5);
        free(l);
    }
}

/* Limits on size and stretch act on the singular values of the footprint, never on its energy (design 6). */
static void limits_keep_the_energy(void **state)
{
    (void)state;
    random_state = 8;
    struct line_up *l = line_up_of(4);
    l->frame.max_radius = 6;
    l->frame.max_anisotropy = 3;
    run_compact(l, 0);
    uint32_t photon = BASE, limited = 0;
    double worst = 0, filter = pow((double)l->frame.filter_radius, 2);
    for (uint32_t i = 0; i < RAYS; i++) {
        if (l->outcomes[i] != OUTCOME_PHOTON)
            continue;
        const struct photon *p = &l->photons[photon++];
        const struct photon_ray *ray = &l->rays[l->queue[i]];
        if (p->cell == NONE || p->ellipse.w < 0)
            continue; /* a box is no larger than a pixel */
        struct footprint f = footprint_of(l, ray);
        double middle = 0.5 * (f.xx + f.yy), apart = hypot(0.5 * (f.xx - f.yy), f.xy);
        double major = middle + apart, minor = middle - apart, limit = fmin(36, 9 * (minor + filter));
        limited += major > limit;
        double wanted = (fmin(major, limit) + filter) * (fmin(minor, limit) + filter);
        double u00 = (double)p->ellipse.x, u01 = (double)p->ellipse.y, u11 = (double)p->ellipse.z;
        double found = 1 / (u00 * u00 * u11 * u11); /* det C: the product of the squared axes */
        worst = fmax(worst, fabs(found / wanted - 1));
        /* the sum of the inverse squared axes, so that each is right and not just their product */
        double traces = 1 / (fmin(major, limit) + filter) + 1 / (fmin(minor, limit) + filter);
        worst = fmax(worst, fabs((u00 * u00 + u01 * u01 + u11 * u11) / traces - 1));
        double flux = (double)p->density.y * 0.5 * PI * sqrt(found) / f.jacobian;
        worst = fmax(worst, fabs(flux / (double)ray->flux.y - 1));
    }
    print_message("%u limited, worst %.1e\n", limited, worst);
    assert_true(limited > 100);
    assert_in_bound(worst, 2e-4);
    assert_true(l->counters.count[COUNT_LIMITED] >= limited);
    assert_int_equal(l->counters.count[COUNT_GUARD_FOOTPRINT], 0);
    free(l);
}

/* design 5: culled by the solid angle a photon's footprint takes as against free flight, and said so. */
static void magnified_photons_are_culled(void **state)
{
    (void)state;
    random_state = 9;
    struct line_up *l = line_up_of(2);
    l->frame.cull_magnification = 0.3f;
    run_compact(l, 0);
    uint32_t photon = BASE, culled = 0, close = 0;
    double flux = 0;
    for (uint32_t i = 0; i < RAYS; i++) {
        if (l->outcomes[i] != OUTCOME_PHOTON)
            continue;
        const struct photon *p = &l->photons[photon++];
        const struct photon_ray *ray = &l->rays[l->queue[i]];
        struct vector v = {(double)ray->dp_u_v0.w, (double)ray->dp_v1_dd_u.x, (double)ray->dp_v1_dd_u.y};
        struct vector area = vector_cross(vector_of(ray->dp_u_v0), v);
        double solid_angle = sqrt(vector_dot(area, area)) / pow((double)ray->direction.w, 2);
        double magnification = solid_angle * (double)ray->origin.w; /* over the stratum's */
        close += fabs(magnification / 0.3 - 1) < 1e-4;
        if (magnification <= 0.3)
            continue;
        culled++;
        flux += sum3(ray->flux);
        assert_int_equal(p->cell, NONE);
    }
    print_message("%u culled of %u\n", culled, photon - BASE);
    assert_int_equal(close, 0);
    assert_true(culled > 50 && culled < photon - BASE - 50);
    assert_int_equal(l->counters.count[COUNT_CULLED_SOLID_ANGLE], culled);
    assert_close(flux_of(l, FATE_CULLED_SOLID_ANGLE), flux, 1e-5 * flux);
    free(l);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sums_are_those_of_a_loop),         cmocka_unit_test(lists_keep_their_order),
        cmocka_unit_test(footprints_follow_the_projection), cmocka_unit_test(limits_keep_the_energy),
        cmocka_unit_test(magnified_photons_are_culled),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
