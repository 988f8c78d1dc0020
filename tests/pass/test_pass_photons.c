/* test_pass_photons.c: one bounce of photons against a C model in double precision: photon_model.h,
 * Beer-Lambert, and differentials as differences of two neighbouring rays.
 */
#include <string.h>

#include "tests/support/check.h"
#include "tests/support/pass_device.h"
#include "tests/support/photon_model.h"
#include "tests/support/tile_maps.h"

static struct pass_device *device;
static uint64_t random_state;

static int set_up(void **state)
{
    (void)state;
    device = pass_device_create();
    model_make();
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    pass_device_destroy(&device);
    return 0;
}

/* ---- running a bounce ---------------------------------------------------------------------------------- */

/* Strata of every cell. */
enum { CELLS = 16, STRATA_U = 7, STRATA_V = 5 };

struct bounce {
    uint32_t count, rule, features;
    uint32_t density;                            /* uniform: every stratum follows all branches */
    struct photon_ray *rays, *before, *children; /* before: as handed in */
    uint32_t *outcomes;
    uint32_t *totals; /* children and photons per workgroup */
    struct counters_gpu counters;
    struct frame_gpu frame;
};

static struct bounce bounce_of(uint32_t count)
{
    struct bounce b = {.count = count,
                       .density = DENSITY_UNIFORM_RULE,
                       .features = FEATURE_DIELECTRIC | FEATURE_THIN | FEATURE_MIRROR | FEATURE_ABSORPTION |
                                   FEATURE_CHROMATIC};
    b.rays = calloc(count, sizeof *b.rays);
    b.before = calloc(count, sizeof *b.before);
    b.children = calloc(2 * count, sizeof *b.children);
    b.outcomes = calloc(count, sizeof *b.outcomes);
    b.totals = calloc(count / GROUP_SIZE + 1, 2 * sizeof *b.totals);
    assert_true(b.rays && b.before && b.children && b.outcomes && b.totals);
    b.frame = (struct frame_gpu){.max_bounces = 12, .cull_energy = 1e-5f, .flux_unit = 0x1p-20f};
    return b;
}

static void bounce_free(struct bounce *b)
{
    free(b->rays);
    free(b->before);
    free(b->children);
    free(b->outcomes);
    free(b->totals);
}

static void run_bounce(struct bounce *b)
{
    uint32_t *queue = calloc(b->count, sizeof *queue);
    assert_non_null(queue);
    for (uint32_t i = 0; i < b->count; i++)
        queue[i] = i;
    memcpy(b->before, b->rays, b->count * sizeof *b->rays);
    b->counters = (struct counters_gpu){0};
    b->counters.queue[QUEUE_COUNT] = b->count;
    b->counters.queue[0] = (b->count + GROUP_SIZE - 1) / GROUP_SIZE;
    b->counters.stride[0] = 2;
    uint32_t texels[2] = {0}, tree[CELLS], columns[CELLS];
    for (int i = 0; i < CELLS; i++) {
        tree[i] = STRATA_U * STRATA_V;
        columns[i] = STRATA_U;
    }
    pass_device_run(
        device,
        &(struct pass_run){
            .shader = "photon_trace.comp.bvh",
            .features = b->features,
            .split = b->rule,
            .density = b->density,
            .has_push = true,
            .threads = b->count,
            PASS_LISTS({BINDING_NODES, GPU_READ, model_nodes, sizeof model_nodes},
                       {BINDING_TRIANGLES, GPU_READ, model_triangles, sizeof model_triangles},
                       {BINDING_MORE_TRIANGLES, GPU_READ, NULL, 0},
                       {BINDING_INSTANCES, GPU_READ, model_instances, sizeof model_instances},
                       {BINDING_VERTICES, GPU_READ, model_vertices, sizeof model_vertices},
                       {BINDING_INDICES, GPU_READ, model_indices, sizeof model_indices},
                       {BINDING_MATERIALS, GPU_READ, model_materials, sizeof model_materials},
                       {BINDING_TEXELS, GPU_READ, texels, sizeof texels},
                       {BINDING_FRAME, GPU_READ, &b->frame, sizeof b->frame},
                       {BINDING_PASS, GPU_READ_WRITE, &b->counters, sizeof b->counters},
                       {BINDING_PASS + 1, GPU_READ_WRITE, b->rays, b->count * sizeof *b->rays},
                       {BINDING_PASS + 2, GPU_WRITE, b->children, 2 * b->count * sizeof *b->children},
                       {BINDING_PASS + 3, GPU_READ, queue, b->count * 4},
                       {BINDING_PASS + 4, GPU_WRITE, b->outcomes, b->count * 4},
                       {BINDING_PASS + 5, GPU_WRITE, b->totals, (b->count / GROUP_SIZE + 1) * 8},
                       {BINDING_PASS + 6, GPU_READ_WRITE, NULL, 0}, {BINDING_PASS + 7, GPU_WRITE, NULL, 0},
                       {BINDING_PASS + 8, GPU_READ_WRITE, NULL, 0},
                       {BINDING_PASS + 9, GPU_READ, tree, sizeof tree},
                       {BINDING_PASS + 10, GPU_READ, columns, sizeof columns})});
    free(queue);
}

static double sum3(vec4 v)
{
    return (double)v.x + (double)v.y + (double)v.z;
}

static struct vector read_p(const struct photon_ray *r, int axis)
{
    return axis ? (struct vector){(double)r->dp_u_v0.w, (double)r->dp_v1_dd_u.x, (double)r->dp_v1_dd_u.y}
                : vector_of(r->dp_u_v0);
}

static struct vector read_d(const struct photon_ray *r, int axis)
{
    return axis ? (struct vector){(double)r->dd_u2_dd_v.y, (double)r->dd_u2_dd_v.z, (double)r->dd_u2_dd_v.w}
                : (struct vector){(double)r->dp_v1_dd_u.z, (double)r->dp_v1_dd_u.w, (double)r->dd_u2_dd_v.x};
}

static void write_differential(struct photon_ray *r, const struct vector p[2], const struct vector d[2])
{
    r->dp_u_v0 = (vec4){(float)p[0].x, (float)p[0].y, (float)p[0].z, (float)p[1].x};
    r->dp_v1_dd_u = (vec4){(float)p[1].y, (float)p[1].z, (float)d[0].x, (float)d[0].y};
    r->dd_u2_dd_v = (vec4){(float)d[0].z, (float)d[1].x, (float)d[1].y, (float)d[1].z};
}

static double between(double low, double high)
{
    return low + (high - low) * pass_random(&random_state);
}

static struct vector anywhere(double reach)
{
    double x = between(-reach, reach), y = between(-reach, reach);
    return (struct vector){x, y, between(-reach, reach)};
}

static void fill_ray(struct photon_ray *r, struct vector o, struct vector d)
{
    struct vector p[2], turn[2];
    for (int k = 0; k < 2; k++) { /* of a beam: places across it, directions on the sphere */
        p[k] = anywhere(0.01);
        p[k] = model_add(p[k], d, -vector_dot(p[k], d));
        turn[k] = anywhere(0.01);
        turn[k] = model_add(turn[k], d, -vector_dot(turn[k], d));
    }
    *r = (struct photon_ray){.origin = {(float)o.x, (float)o.y, (float)o.z, 1}, .state = 1};
    r->direction = (vec4){(float)d.x, (float)d.y, (float)d.z, 2};
    r->flux = (vec4){(float)between(0.5, 2), (float)between(0.5, 2), (float)between(0.5, 2), 0};
    r->flux.w = (float)(sum3(r->flux) * between(1, 6));
    r->cell = (uint32_t)between(0, 16);
    r->hash = (uint32_t)between(0, 4e9);
    write_differential(r, p, turn);
    if (model_length(model_add(o, model_sphere_center, -1)) < 1)
        r->medium = MODEL_SOLID(MODEL_SPHERE);
}

static void fill_rays(struct bounce *b)
{
    for (uint32_t i = 0; i < b->count; i++) {
        struct vector o, d;
        double middle;
        do {
            o = i % 3 == 0 ? model_add(model_sphere_center, anywhere(0.9), 1) : anywhere(3);
            middle = model_length(model_add(o, model_sphere_center, -1));
        } while (middle > 0.9 && middle < 1.1);
        d = model_unit(model_add(anywhere(i % 2 ? 1 : 4), o, -1));
        fill_ray(&b->rays[i], o, d);
    }
}

/* ---- tests --------------------------------------------------------------------------------------------- */

struct tally {
    uint32_t reflected, refracted, split, total, mirrored, straight, stored, escaped, skipped, chosen;
    double place, direction, flux, position_change, direction_change;
};

/* One child against the model; `flux` is what it should carry, `spread` how far apart the photons of its
 * branch are. */
static void check_child(const struct photon_ray *child, const struct photon_ray *parent,
                        const struct model_hit *hit, enum model_way way, const double flux[3], double spread,
                        struct tally *tally)
{
    struct vector o = vector_of(parent->origin), d = model_unit(vector_of(parent->direction));
    struct model_turn turn = model_turn_of(hit, o, d, way);
    tally->place = fmax(tally->place, model_length(model_add(vector_of(child->origin), turn.position, -1)));
    tally->direction =
        fmax(tally->direction, model_length(model_add(vector_of(child->direction), turn.direction, -1)));
    const float found[3] = {child->flux.x, child->flux.y, child->flux.z};
    for (int k = 0; k < 3; k++)
        tally->flux = fmax(tally->flux, fabs((double)found[k] - flux[k]) / sum3(parent->flux));
    assert_close((double)child->direction.w, (double)parent->direction.w + hit->t, 1e-5 * (1 + hit->t));
    assert_int_equal(child->state & 0xff, (parent->state & 0xff) + 1);
    assert_int_equal(child->cell, parent->cell);
    assert_true(child->flux.w == parent->flux.w && child->origin.w == parent->origin.w);

    for (int axis = 0; axis < 2; axis++) {
        const double step = 1e-4;
        struct vector p = read_p(parent, axis), change = read_d(parent, axis);
        struct model_turn a =
            model_turn_of(hit, model_add(o, p, -step), model_unit(model_add(d, change, -step)), way);
        struct model_turn b =
            model_turn_of(hit, model_add(o, p, step), model_unit(model_add(d, change, step)), way);
        struct vector p_expected =
            model_add((struct vector){0, 0, 0}, model_add(b.position, a.position, -1), spread / (2 * step));
        struct vector d_expected =
            model_add((struct vector){0, 0, 0}, model_add(b.direction, a.direction, -1), spread / (2 * step));
        double scale = model_length(p_expected) + model_length(d_expected);
        tally->position_change = fmax(tally->position_change,
                                      model_length(model_add(read_p(child, axis), p_expected, -1)) / scale);
        tally->direction_change = fmax(tally->direction_change,
                                       model_length(model_add(read_d(child, axis), d_expected, -1)) / scale);
    }
}

static void check_bounce(const struct bounce *b, struct tally *tally)
{
    for (uint32_t i = 0; i < b->count; i++) {
        const struct photon_ray *ray = &b->before[i], *child = &b->children[2 * i];
        struct vector o = vector_of(ray->origin), d = model_unit(vector_of(ray->direction));
        struct model_hit hit;
        if (!model_trace(o, d, &hit)) {
            tally->escaped++;
            assert_int_equal(b->outcomes[i], 0);
            continue;
        }
        struct model_turn turn = model_turn_of(&hit, o, d, MODEL_REFRACT),
                          mirrored = model_turn_of(&hit, o, d, MODEL_REFLECT);
        bool is_dielectric = model_materials[hit.part].kind == KIND_DIELECTRIC;
        /* grazing ways are another test's; here no decision may hang on rounding */
        if (hit.border < 1e-4 || turn.cos_i < 0.05 ||
            (is_dielectric && turn.cos_t > 0 && turn.cos_t < 0.05) ||
            vector_dot(mirrored.direction, turn.geometric) < 0.01 ||
            (is_dielectric && turn.cos_t > 0 && vector_dot(turn.direction, turn.geometric) > -0.01)) {
            tally->skipped++;
            continue;
        }
        double flux[3] = {(double)ray->flux.x, (double)ray->flux.y, (double)ray->flux.z};
        if (ray->medium) {
            const vec4 *a = &model_materials[ray->medium - MODEL_SOLID(0)].absorption;
            flux[0] *= exp(-(double)a->x * hit.t);
            flux[1] *= exp(-(double)a->y * hit.t);
            flux[2] *= exp(-(double)a->z * hit.t);
        }
        const vec4 *color = &model_materials[hit.part].color_ior;
        const double base[3] = {(double)color->x, (double)color->y, (double)color->z};
        if (hit.part == MODEL_FLOOR) {
            tally->stored++;
            assert_int_equal(b->outcomes[i], OUTCOME_PHOTON);
            const struct photon_ray *photon = &b->rays[i];
            assert_in_bound(model_length(model_add(vector_of(photon->origin), turn.position, -1)),
                            1e-5 * (1 + hit.t));
            assert_in_bound(model_length(model_add(vector_of(photon->direction), turn.geometric, -1)), 1e-6);
            assert_close((double)photon->flux.x, flux[0], 1e-5);
            continue;
        }
        if (hit.part == MODEL_MIRROR) {
            tally->mirrored++;
            double left[3], grazing = pow(1 - turn.cos_i, 5);
            for (int k = 0; k < 3; k++)
                left[k] = flux[k] * (base[k] + (1 - base[k]) * grazing);
            assert_int_equal(b->outcomes[i], OUTCOME_CHILD0);
            check_child(child, ray, &hit, MODEL_REFLECT, left, 1, tally);
            continue;
        }
        bool is_front = vector_dot(turn.normal, hit.corners[0].normal) > 0;
        double ior = (double)color->w, reflectance = model_reflectance(turn.cos_i, is_front ? ior : 1 / ior);
        enum model_way onward = MODEL_REFRACT;
        double through[3] = {flux[0], flux[1], flux[2]};
        if (hit.part == MODEL_SHEET) {
            /* both faces, all reflections between them: R + T R T + T R^3 T + ... */
            double r = model_reflectance(turn.cos_i, ior);
            reflectance = r + (1 - r) * (1 - r) * r / (1 - r * r);
            onward = MODEL_STRAIGHT;
            for (int k = 0; k < 3; k++)
                through[k] *= base[k];
        }
        double reflected[3], refracted[3];
        for (int k = 0; k < 3; k++) {
            reflected[k] = flux[k] * reflectance;
            refracted[k] = through[k] * (1 - reflectance);
        }
        if (reflectance >= 1) {
            tally->total++;
            assert_int_equal(b->outcomes[i], OUTCOME_CHILD0);
            assert_int_equal(child->medium, ray->medium);
            check_child(child, ray, &hit, MODEL_REFLECT, flux, 1, tally);
        } else if (b->outcomes[i] == (OUTCOME_CHILD0 | OUTCOME_CHILD1)) {
            tally->split++;
            if (onward == MODEL_REFRACT)
                assert_int_equal(child->medium, is_front ? MODEL_SOLID(hit.part) : 0);
            assert_int_equal(child[1].medium, ray->medium);
            assert_int_equal(child->state >> 8 & 15, (ray->state >> 8 & 15) + 1);
            check_child(child, ray, &hit, onward, refracted, 1, tally);
            check_child(child + 1, ray, &hit, MODEL_REFLECT, reflected, 1, tally);
        } else {
            /* one way at random: all of the flux, photons further apart by the root of its probability */
            tally->chosen++;
            assert_int_equal(b->outcomes[i], OUTCOME_CHILD0);
            bool is_reflected = vector_dot(vector_of(child->direction), turn.geometric) > 0;
            tally->reflected += is_reflected;
            tally->refracted += !is_reflected;
            double chance = is_reflected ? reflectance : 1 - reflectance;
            if (b->rule == SPLIT_ENERGY_RULE) /* only where the other way hardly matters */
                assert_in_bound(fmin(reflectance, 1 - reflectance) * (flux[0] + flux[1] + flux[2]),
                                0.011 * (double)ray->flux.w);
            check_child(child, ray, &hit, is_reflected ? MODEL_REFLECT : onward,
                        is_reflected ? flux : through, 1 / sqrt(chance), tally);
        }
    }
    print_message("%u split, %u chosen (%u reflected), %u totally reflected, %u mirrored, %u stored, %u "
                  "escaped, %u skipped\n",
                  tally->split, tally->chosen, tally->reflected, tally->total, tally->mirrored, tally->stored,
                  tally->escaped, tally->skipped);
    print_message("place %.1e, direction %.1e, flux %.1e, dP %.1e, dD %.1e\n", tally->place, tally->direction,
                  tally->flux, tally->position_change, tally->direction_change);
    assert_in_bound(tally->place, 1e-4); /* origins are moved off the surface by 256 roundings */
    assert_in_bound(tally->direction, 1e-5);
    assert_in_bound(tally->flux, 1e-5);
    assert_in_bound(tally->position_change, 1e-4);
    assert_in_bound(tally->direction_change, 1e-3);
    assert_true(tally->skipped < b->count / 5);
}

/* What came in is in the children, the photons or the ledger. */
static void check_ledger(const struct bounce *b)
{
    double in = 0, out = 0, fates = 0;
    for (uint32_t i = 0; i < b->count; i++) {
        in += sum3(b->before[i].flux);
        if (b->outcomes[i] & OUTCOME_CHILD0)
            out += sum3(b->children[2 * i].flux);
        if (b->outcomes[i] & OUTCOME_CHILD1)
            out += sum3(b->children[2 * i + 1].flux);
        if (b->outcomes[i] & OUTCOME_PHOTON)
            out += sum3(b->rays[i].flux);
    }
    for (int fate = 0; fate < FATE_COUNT; fate++)
        fates += pass_fixed(b->counters.flux_low[fate], b->counters.flux_high[fate]) *
                 (double)b->frame.flux_unit * (fate == FATE_THINNED_IN ? -1 : 1);
    print_message("flux in %.6f, on its way %.6f, in the ledger %.6f: off by %.1e\n", in, out, fates,
                  fabs((out + fates) / in - 1));
    assert_close(out + fates, in, 2e-6 * in);
}

static void one_bounce_follows_the_model(void **state)
{
    (void)state;
    random_state = 12;
    struct bounce b = bounce_of(3000);
    struct tally tally = {0};
    fill_rays(&b);
    run_bounce(&b);
    check_bounce(&b, &tally);
    assert_true(tally.split > 500 && tally.total > 50 && tally.mirrored > 100 && tally.stored > 100 &&
                tally.escaped > 100);
    check_ledger(&b);
    uint32_t hits = 0, splits = 0;
    for (uint32_t i = 0; i < b.count; i++) {
        hits += b.outcomes[i] != 0;
        splits += b.outcomes[i] == 3;
    }
    assert_int_equal(b.counters.count[COUNT_HITS], hits);
    assert_int_equal(b.counters.count[COUNT_SPLIT], splits);
    bounce_free(&b);
}

static void roulette_is_fair(void **state)
{
    (void)state;
    random_state = 13;
    struct bounce b = bounce_of(8000);
    struct tally tally = {0};
    b.rule = SPLIT_ROULETTE_RULE;
    fill_rays(&b);
    run_bounce(&b);
    check_bounce(&b, &tally);
    check_ledger(&b);
    assert_int_equal(tally.split, 0);
    /* how many reflect, against the sum of their chances and its deviation */
    double mean = 0, variance = 0;
    for (uint32_t i = 0; i < b.count; i++) {
        struct model_hit hit;
        struct vector o = vector_of(b.before[i].origin), d = model_unit(vector_of(b.before[i].direction));
        if (!model_trace(o, d, &hit) || hit.border < 1e-4 ||
            model_materials[hit.part].kind != KIND_DIELECTRIC)
            continue;
        struct model_turn turn = model_turn_of(&hit, o, d, MODEL_REFLECT);
        if (turn.cos_i < 0.05)
            continue;
        bool is_front = vector_dot(turn.normal, hit.corners[0].normal) > 0;
        double ior = (double)model_materials[hit.part].color_ior.w,
               r = model_reflectance(turn.cos_i, is_front ? ior : 1 / ior);
        bool is_reflected = vector_dot(vector_of(b.children[2 * i].direction), turn.geometric) > 0;
        mean += is_reflected - r;
        variance += r * (1 - r);
    }
    print_message("reflected more often than their chances say by %.1f, deviation %.1f\n", mean,
                  sqrt(variance));
    assert_true(variance > 100);
    assert_in_bound(fabs(mean), 4 * sqrt(variance));
    bounce_free(&b);
}

/* The thesis' rule: both ways at the first glass, then the same way again; what is not followed is said. */
static void split_once_says_what_it_loses(void **state)
{
    (void)state;
    random_state = 14;
    struct bounce b = bounce_of(2000);
    b.rule = SPLIT_ONCE_RULE;
    fill_rays(&b);
    for (uint32_t i = 0; i < b.count; i++)
        b.rays[i].state |= i % 2 ? 1u << 8 | (i % 4 == 1 ? 1u : 2u) << 12
                                 : 0; /* split before, reflected or refracted last */
    run_bounce(&b);
    check_ledger(&b);
    uint32_t counts[3] = {0};
    for (uint32_t i = 0; i < b.count; i++) {
        struct model_hit hit;
        struct vector o = vector_of(b.before[i].origin), d = model_unit(vector_of(b.before[i].direction));
        if (!model_trace(o, d, &hit) || hit.border < 1e-4 ||
            model_materials[hit.part].kind != KIND_DIELECTRIC)
            continue;
        struct model_turn turn = model_turn_of(&hit, o, d, MODEL_REFRACT);
        if (turn.cos_i < 0.05 || turn.cos_t < 0.05)
            continue;
        uint32_t history = i % 2 == 0 ? 0 : i % 4 == 1 ? 1 : 2;
        counts[history]++;
        assert_int_equal(b.outcomes[i], history == 0 ? 3 : 1);
        if (history)
            assert_true((vector_dot(vector_of(b.children[2 * i].direction), turn.geometric) > 0) ==
                        (history == 1));
    }
    assert_true(counts[0] > 100 && counts[1] > 50 && counts[2] > 50);
    bounce_free(&b);
}

/* Of a cell's 7 x 5 strata, 3 x 2 follow branches of spacing 2 and one those of spacing 4. A dim branch is
 * left to the fewest that bring it to 0.15 of the emitted flux at spacing^2 times its own; they carry it for
 * all. */
static void dim_branches_are_carried_by_few(void **state)
{
    (void)state;
    for (uint32_t test = 0; test < 5; test++) {
        const uint32_t had = test < 3 ? 1 : 2, apart = test < 3 ? 1u << test : 2u << (test - 3);
        const double counts[3][2] = {{STRATA_U, STRATA_V}, {3, 2}, {1, 1}};
        struct bounce b = bounce_of(had == 1 ? STRATA_U * STRATA_V : 3 * 2);
        b.density = DENSITY_SQRT_RULE;
        struct model_hit hit;
        for (uint32_t i = 0; i < b.count; i++) {
            random_state = 15; /* the same ray in every stratum that is left */
            fill_ray(&b.rays[i], (struct vector){0.1, 4, 0.2}, model_unit((struct vector){0.3, -1, 0.1}));
            b.rays[i].state |= (i < 6 ? 1u << 14 : 0) | (i == 4 ? 1u << 15 : 0) | (had / 2) << 22;
        }
        struct vector o = vector_of(b.rays[0].origin), d = model_unit(vector_of(b.rays[0].direction));
        assert_true(model_trace(o, d, &hit) && hit.part == MODEL_SLAB);
        double r = model_reflectance(model_turn_of(&hit, o, d, MODEL_REFLECT).cos_i,
                                     (double)model_materials[MODEL_SLAB].color_ior.w);
        double step = apart / had, whole = b.count * sum3(b.rays[0].flux);
        for (uint32_t i = 0; i < b.count; i++)
            b.rays[i].flux.w = (float)(r * sum3(b.rays[i].flux) * step * step / (0.15 * 1.1));
        run_bounce(&b);
        check_ledger(&b);
        double weak = 0, strong = 0, area = 0;
        double wider[2] = {counts[had / 2][0] / counts[apart / 2][0],
                           counts[had / 2][1] / counts[apart / 2][1]};
        for (uint32_t i = 0; i < b.count; i++) {
            bool carries = apart == had || i < 6 * (apart == 2) || (apart == 4 && i == 4);
            assert_int_equal(b.outcomes[i], carries ? 3 : 1);
            strong += sum3(b.children[2 * i].flux);
            assert_int_equal(b.children[2 * i].state >> 22, had / 2);
            if (!carries)
                continue;
            const struct photon_ray *child = &b.children[2 * i + 1];
            assert_int_equal(child->state >> 22, apart / 2);
            weak += sum3(child->flux);
            area += model_length(vector_cross(read_p(child, 0), read_p(child, 1)));
            for (int axis = 0; axis < 2; axis++) {
                double of_main = model_length(read_p(&b.children[2 * i], axis));
                assert_close(model_length(read_p(child, axis)), wider[axis] * of_main, 1e-5 * of_main);
            }
        }
        double one = model_length(vector_cross(read_p(&b.children[0], 0), read_p(&b.children[0], 1)));
        assert_close(weak, whole * r, 1e-5 * whole);
        assert_close(strong, whole * (1 - r), 1e-5 * whole);
        assert_close(area, b.count * one, 1e-4 * b.count * one); /* their footprints still tile the beam */
        bounce_free(&b);
    }
}

static void ends_of_paths_are_told_apart(void **state)
{
    (void)state;
    struct bounce b = bounce_of(6);
    random_state = 16;
    struct vector above = {-3.2, 3.5, 0.4}, down = {0, -1, 0};
    for (uint32_t i = 0; i < b.count; i++)
        fill_ray(&b.rays[i], above, down); /* past everything, to the floor */
    b.rays[1].state = 0;                   /* met a receiver first: direct light */
    fill_ray(&b.rays[2], above, (struct vector){0, 1, 0});
    fill_ray(&b.rays[3], (struct vector){0.1, 4, 0.2}, down);
    b.rays[3].state = b.frame.max_bounces;
    fill_ray(&b.rays[4], (struct vector){0.1, 4, 0.2}, down);
    b.rays[4].flux.w = (float)(2 * sum3(b.rays[4].flux) / (double)b.frame.cull_energy);
    fill_ray(&b.rays[5], (struct vector){0.1, 4, 0.2}, down);
    b.rays[5].flux.w = (float)(0.5 * sum3(b.rays[5].flux) / (double)b.frame.cull_energy);
    run_bounce(&b);
    const uint32_t outcomes[6] = {OUTCOME_PHOTON, 0, 0, 0, 0, OUTCOME_CHILD0};
    const int fates[6] = {FATE_NONE,         FATE_DIRECT,        FATE_ESCAPED,
                          FATE_BOUNCE_LIMIT, FATE_CULLED_ENERGY, FATE_NONE};
    for (uint32_t i = 0; i < b.count; i++) {
        assert_int_equal(b.outcomes[i], outcomes[i]);
        if (fates[i] != FATE_NONE)
            assert_close(pass_fixed(b.counters.flux_low[fates[i]], b.counters.flux_high[fates[i]]) *
                             (double)b.frame.flux_unit,
                         sum3(b.before[i].flux), 1e-5);
    }
    assert_int_equal(b.counters.count[COUNT_CULLED_ENERGY], 1);
    check_ledger(&b);
    bounce_free(&b);
}

/* At the critical angle the refracted differential diverges: it stays finite, and the clamp is counted. */
static void grazing_exit_stays_finite(void **state)
{
    (void)state;
    struct bounce b = bounce_of(256);
    b.rule = SPLIT_ONCE_RULE; /* follows the way out, little as it carries */
    random_state = 17;
    struct model_corner c[3];
    model_fetch(MODEL_SLAB, 0, c);
    struct vector n = c[0].normal, along = model_unit(model_add(c[1].position, c[0].position, -1));
    struct vector o = {0, 1.2, 0};
    if (vector_dot(model_add(c[0].position, o, -1), n) < 0)
        n = model_add((struct vector){0, 0, 0}, n, -1);
    for (uint32_t i = 0; i < b.count; i++) {
        double sine = (1 + ((int)i - 128) * 2e-8) / (double)model_materials[MODEL_SLAB].color_ior.w;
        fill_ray(&b.rays[i], o,
                 model_add(model_add((struct vector){0, 0, 0}, along, sine), n, sqrt(1 - sine * sine)));
        b.rays[i].medium = MODEL_SOLID(MODEL_SLAB);
    }
    run_bounce(&b);
    uint32_t out = 0, total = 0;
    for (uint32_t i = 0; i < b.count; i++)
        for (uint32_t k = 0; k < 2; k++) {
            if (!(b.outcomes[i] >> k & 1))
                continue;
            const struct photon_ray *child = &b.children[2 * i + k];
            const float *values = &child->origin.x;
            for (int j = 0; j < 24; j++)
                assert_true(isfinite(values[j]));
            assert_close(model_length(vector_of(child->direction)), 1, 1e-5);
            out += child->medium == 0;
            total += child->medium != 0;
        }
    print_message("%u leave, %u stay, %u clamped\n", out, total, b.counters.count[COUNT_GUARD_DIFFERENTIAL]);
    assert_true(out > 20 && total > 20);
    assert_true(b.counters.count[COUNT_GUARD_DIFFERENTIAL] > 10);
    check_ledger(&b);
    bounce_free(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(one_bounce_follows_the_model),  cmocka_unit_test(roulette_is_fair),
        cmocka_unit_test(split_once_says_what_it_loses), cmocka_unit_test(dim_branches_are_carried_by_few),
        cmocka_unit_test(ends_of_paths_are_told_apart),  cmocka_unit_test(grazing_exit_stays_finite),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
