/* test_pass_lookup.c: caustics seen through glass and mirrors, by the grid of points (lookup_grid.comp,
 * lookup.comp) and by the tree of photons (photon_tree.comp, lookup_gather.comp, lookup_report.comp), against
 * a loop over every photon and every chain point in double precision; against each other and in another
 * order, bit by bit; and with all photons in one spot. */
#include <string.h>

#include "shaders/shared/lookup_layout.h"
#include "tests/support/check.h"
#include "tests/support/pass_device.h"

enum { WIDTH = 40, HEIGHT = 30, PIXELS = WIDTH * HEIGHT, LAYERS = 2, POINTS = PIXELS * LAYERS, SLOTS = 2048 };

static uint64_t random_state;

static double between(double low, double high)
{
    return pass_between(&random_state, low, high);
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void tangent_frame(const double n[3], double t1[3], double t2[3])
{
    double other[3] = {0, 1, 0};
    if (!(fabs(n[1]) < 0.9)) {
        other[0] = 1;
        other[1] = 0;
    }
    for (int k = 0; k < 3; k++)
        t1[k] = n[(k + 1) % 3] * other[(k + 2) % 3] - n[(k + 2) % 3] * other[(k + 1) % 3];
    double length = sqrt(dot(t1, t1));
    for (int k = 0; k < 3; k++)
        t1[k] /= length;
    for (int k = 0; k < 3; k++)
        t2[k] = n[(k + 1) % 3] * t1[(k + 2) % 3] - n[(k + 2) % 3] * t1[(k + 1) % 3];
}

/* Half floats of values within [-1, 1]: a multiple of 2^-11 or, below 2^-14, of 2^-24, is one. */
static uint32_t half_of(double value)
{
    if (value == 0)
        return 0;
    int exponent;
    double fraction = frexp(fabs(value), &exponent); /* 0.5 to 1 */
    uint32_t bits = exponent > -14 ? (uint32_t)(exponent + 14) << 10 | (uint32_t)((fraction * 2 - 1) * 1024)
                                   : (uint32_t)(fabs(value) * 16777216);
    return bits | (value < 0 ? 0x8000u : 0);
}

static double value_of_half(uint32_t half)
{
    double magnitude = half & 0x7c00 ? ldexp(1 + (half & 0x3ff) / 1024.0, (int)(half >> 10 & 31) - 15)
                                     : (half & 0x3ff) / 16777216.0;
    return half & 0x8000 ? -magnitude : magnitude;
}

enum structure { GRID, TREE, STRUCTURES };
static const char *const structure_names[STRUCTURES] = {"grid", "tree"};

/* ---- a frame ------------------------------------------------------------------------------------------- */

struct lookup_case {
    struct frame_gpu frame;
    uint32_t features, count;
    struct chain_point chains[POINTS], sorted[POINTS];
    uint32_t places[2 * POINTS], codes[POINTS];
    vec4 weights[POINTS], indirect[PIXELS];
    struct lookup_cell cells[SLOTS];
    uint32_t marks[SLOTS / 4]; /* eight bits a slot */
    struct lookup_gpu lookup;
    struct counters_gpu counters;
    uint32_t sums[6 * POINTS];
    struct lookup_photon *seen;
    struct photon *photons;
};

static void set_axes(struct chain_point *point, const double x[3], const double y[3], double throughput)
{
    double xx = dot(x, x), yy = dot(y, y), xy = dot(x, y);
    float reach = (float)sqrt(0.5 * (xx + yy) + sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy)) * 1.001f;
    uint32_t bits = (pass_float_bits(reach) + 0xfff) & ~0xfffu, halves[6];
    for (int k = 0; k < 3; k++) {
        halves[k] = half_of(x[k] / (double)pass_bits_float(bits));
        halves[3 + k] = half_of(y[k] / (double)pass_bits_float(bits));
    }
    point->axes = (uvec4){halves[0] | halves[1] << 16, halves[2] | halves[3] << 16,
                          halves[4] | halves[5] << 16, bits | (uint32_t)(throughput * 1024)};
}

/* Points on a floor, on a wall and on a leaning plane, with pixels from 4 mm to 6 cm, some four times as long
 * as wide; every seventh pixel sees nothing through glass, the second layer less. */
static void make_points(struct lookup_case *c)
{
    const double normals[3][3] = {{0, 1, 0}, {1, 0, 0}, {0.48, 0.6, -0.64}};
    for (uint32_t i = 0; i < POINTS; i++) {
        struct chain_point *point = &c->chains[i];
        *point = (struct chain_point){.position_normal = {0, 0, 0, pass_bits_float(NONE)}};
        c->weights[i] =
            (vec4){(float)between(0.1, 0.3), (float)between(0.1, 0.3), (float)between(0.1, 0.3), 0};
        if (i % 7 == 0 || (i >= PIXELS && i % 3))
            continue;
        uint32_t packed = pass_pack_normal(normals[i % 3]);
        double n[3], t1[3], t2[3], x[3], y[3];
        pass_unpack_normal(packed, n);
        tangent_frame(n, t1, t2);
        double u = between(-0.5, 0.5), v = between(-0.5, 0.5), off = between(-1e-4, 1e-4);
        double size = exp(between(log(0.004), log(0.06))), turn = between(0, 6.28),
               stretch = between(0.25, 1);
        double place[3];
        for (int k = 0; k < 3; k++) {
            place[k] = u * t1[k] + v * t2[k] + off * n[k];
            x[k] = size * (cos(turn) * t1[k] + sin(turn) * t2[k]);
            y[k] = size * stretch * (-sin(turn + 0.3) * t1[k] + cos(turn + 0.3) * t2[k]);
        }
        point->position_normal =
            (vec4){(float)place[0], (float)place[1] - 1, (float)place[2] - 3, pass_bits_float(packed)};
        set_axes(point, x, y, between(0.1, 1));
    }
}

static void make_photons(struct lookup_case *c, bool in_one_spot)
{
    const double normals[3][3] = {{0, 1, 0}, {1, 0, 0}, {0.48, 0.6, -0.64}};
    for (uint32_t i = 0; i < c->count; i++) {
        struct lookup_photon *p = &c->seen[i];
        uint32_t packed = pass_pack_normal(normals[in_one_spot ? 0 : i % 3]);
        double n[3], t1[3], t2[3];
        pass_unpack_normal(packed, n);
        tangent_frame(n, t1, t2);
        double u = in_one_spot ? 0.1 : between(-0.6, 0.6), v = in_one_spot ? 0.1 : between(-0.6, 0.6);
        double major = in_one_spot ? 0 : exp(between(log(1e-4), log(0.06)));
        double minor = major * between(0.03, 1), turn = between(0, 6.28), cosine = cos(turn),
               sine = sin(turn);
        p->position = (vec4){(float)(u * t1[0] + v * t2[0]), (float)(u * t1[1] + v * t2[1]) - 1,
                             (float)(u * t1[2] + v * t2[2]) - 3, pass_bits_float(packed)};
        p->covariance = (vec4){(float)(major * major * cosine * cosine + minor * minor * sine * sine),
                               (float)((major * major - minor * minor) * cosine * sine),
                               (float)(major * major * sine * sine + minor * minor * cosine * cosine),
                               (float)(0.25 * major)};
        p->flux = (vec4){(float)between(0.1, 2), (float)between(0.1, 2), (float)between(0.1, 2),
                         (float)(major * minor)};
        p->cell = i % 13 ? i % 5 : NONE;
        c->photons[i].cell = i % 2 ? NONE : i % 5;
        c->photons[i].area = i % 2 ? 0 : 2;
    }
}

static struct lookup_case *case_of(uint32_t features, uint32_t count, bool in_one_spot)
{
    struct lookup_case *c = calloc(1, sizeof *c);
    assert_non_null(c);
    c->features = features | FEATURE_LOOKUP | FEATURE_BRANCHES;
    c->count = count;
    c->seen = calloc(count, sizeof *c->seen);
    c->photons = calloc(count, sizeof *c->photons);
    assert_true(c->seen && c->photons);
    c->frame = (struct frame_gpu){.width = WIDTH,
                                  .height = HEIGHT,
                                  .camera_branches = LAYERS,
                                  .walk_alone = 64,
                                  .lookup_base = 0x1p-14f,
                                  .lookup_slots = SLOTS,
                                  .irradiance_unit = 0x1p-16f,
                                  .cell_flux = 1,
                                  .tint = {1, 1, 1, 0}};
    make_points(c);
    make_photons(c, in_one_spot);
    return c;
}

static void case_free(struct lookup_case *c)
{
    free(c->seen);
    free(c->photons);
    free(c);
}

/* Photons look for points in the grid. */
static void look_up_by_grid(struct lookup_case *c, struct pass_list frame)
{
    for (uint32_t phase = 0; phase < 3; phase++)
        pass_device_run(
            pass_shared,
            &(struct pass_run){.shader = "lookup_grid.comp",
                               .features = c->features,
                               .phase = phase,
                               .threads = POINTS,
                               PASS_LISTS(frame, {BINDING_PASS, GPU_READ_WRITE, &c->lookup, sizeof c->lookup},
                                          {BINDING_PASS + 1, GPU_READ, c->chains, sizeof c->chains},
                                          {BINDING_PASS + 2, GPU_READ_WRITE, c->cells, sizeof c->cells},
                                          {BINDING_PASS + 3, GPU_READ_WRITE, c->marks, sizeof c->marks},
                                          {BINDING_PASS + 4, GPU_READ_WRITE, c->places, sizeof c->places},
                                          {BINDING_PASS + 5, GPU_WRITE, c->sorted, sizeof c->sorted},
                                          {BINDING_PASS + 6, GPU_READ_WRITE, c->codes, sizeof c->codes})});
    uint32_t *walks = calloc(c->count, sizeof *walks);
    assert_non_null(walks);
    for (uint32_t phase = 0; phase < 2; phase++)
        pass_device_run(
            pass_shared,
            &(struct pass_run){
                .shader = "lookup.comp",
                .features = c->features,
                .phase = phase,
                .threads = phase ? 3 * 64 : c->count /* fewer groups than walks: they take turns */,
                PASS_LISTS(frame, {BINDING_PASS, GPU_READ_WRITE, &c->counters, sizeof c->counters},
                           {BINDING_PASS + 1, GPU_READ_WRITE, &c->lookup, sizeof c->lookup},
                           {BINDING_PASS + 2, GPU_READ, c->seen, c->count * sizeof *c->seen},
                           {BINDING_PASS + 3, GPU_READ, c->cells, sizeof c->cells},
                           {BINDING_PASS + 4, GPU_READ, c->marks, sizeof c->marks},
                           {BINDING_PASS + 5, GPU_READ, c->sorted, sizeof c->sorted},
                           {BINDING_PASS + 6, GPU_READ_WRITE, c->sums, sizeof c->sums},
                           {BINDING_PASS + 7, GPU_READ_WRITE, c->photons, c->count * sizeof *c->photons},
                           {BINDING_PASS + 8, GPU_READ_WRITE, walks, c->count * sizeof *walks},
                           {BINDING_PASS + 9, GPU_READ, c->codes, sizeof c->codes})});
    free(walks);
}

/* Points look for photons in the tree. */
static void look_up_by_tree(struct lookup_case *c, struct pass_list frame)
{
    struct tree_node *nodes = calloc(TREE_NODES, sizeof *nodes);
    struct tree_photon *order = calloc(c->count, sizeof *order);
    uint32_t *places = calloc(c->count, 2 * sizeof *places), *shares = calloc(c->count, 2 * sizeof *shares);
    static uint32_t list[POINTS];
    assert_true(nodes && order && places && shares);
    const struct pass_list tree = {BINDING_PASS + 4, GPU_READ_WRITE, nodes, TREE_NODES * sizeof *nodes};
    for (uint32_t step = 0; step < 4 + TREE_LEVELS - 1; step++) {
        uint32_t phase = step < 4 ? step : 4, level = step < 4 ? 0 : step - 3;
        pass_device_run(
            pass_shared,
            &(struct pass_run){
                .shader = "photon_tree.comp",
                .features = c->features,
                .phase = phase,
                .has_push = true,
                .push = level,
                .threads = phase == 0   ? POINTS
                           : phase == 2 ? TREE_BUCKETS
                           : phase == 4 ? TREE_BUCKETS >> 3 * level
                                        : c->count,
                PASS_LISTS(frame, tree, {BINDING_PASS, GPU_READ_WRITE, &c->counters, sizeof c->counters},
                           {BINDING_PASS + 1, GPU_READ_WRITE, &c->lookup, sizeof c->lookup},
                           {BINDING_PASS + 2, GPU_READ, c->chains, sizeof c->chains},
                           {BINDING_PASS + 3, GPU_READ, c->seen, c->count * sizeof *c->seen},
                           {BINDING_PASS + 5, GPU_READ_WRITE, places, c->count * 2 * sizeof *places},
                           {BINDING_PASS + 6, GPU_READ_WRITE, order, c->count * sizeof *order},
                           {BINDING_PASS + 7, GPU_READ_WRITE, list, sizeof list},
                           {BINDING_PASS + 8, GPU_READ_WRITE, c->places, sizeof c->places})});
    }
    pass_device_run(
        pass_shared,
        &(struct pass_run){
            .shader = "lookup_gather.comp",
            .features = c->features,
            .threads = 8 * POINTS,
            PASS_LISTS(frame, {BINDING_PASS, GPU_READ_WRITE, &c->lookup, sizeof c->lookup},
                       {BINDING_PASS + 1, GPU_READ, c->chains, sizeof c->chains},
                       {BINDING_PASS + 2, GPU_READ, list, sizeof list},
                       {BINDING_PASS + 3, GPU_READ, nodes, TREE_NODES * sizeof *nodes},
                       {BINDING_PASS + 4, GPU_READ, order, c->count * sizeof *order},
                       {BINDING_PASS + 5, GPU_READ, c->seen, c->count * sizeof *c->seen},
                       {BINDING_PASS + 6, GPU_READ_WRITE, c->sums, sizeof c->sums},
                       {BINDING_PASS + 7, GPU_READ_WRITE, shares, c->count * 2 * sizeof *shares})});
    pass_device_run(
        pass_shared,
        &(struct pass_run){
            .shader = "lookup_report.comp",
            .features = c->features,
            .threads = c->count,
            PASS_LISTS(frame, {BINDING_PASS, GPU_READ_WRITE, &c->counters, sizeof c->counters},
                       {BINDING_PASS + 1, GPU_READ_WRITE, &c->lookup, sizeof c->lookup},
                       {BINDING_PASS + 2, GPU_READ, c->seen, c->count * sizeof *c->seen},
                       {BINDING_PASS + 3, GPU_READ, shares, c->count * 2 * sizeof *shares},
                       {BINDING_PASS + 7, GPU_READ_WRITE, c->photons, c->count * sizeof *c->photons})});
    free(nodes);
    free(order);
    free(places);
    free(shares);
}

static void look_up(struct lookup_case *c, enum structure structure)
{
    memset(c->cells, 0, sizeof c->cells);
    memset(c->marks, 0, sizeof c->marks);
    memset(c->sums, 0, sizeof c->sums);
    c->lookup = (struct lookup_gpu){0};
    c->counters = (struct counters_gpu){.photon_count = c->count};
    const struct pass_list frame = {BINDING_FRAME, GPU_READ, &c->frame, sizeof c->frame};
    if (structure == GRID)
        look_up_by_grid(c, frame);
    else
        look_up_by_tree(c, frame);
    pass_device_run(
        pass_shared,
        &(struct pass_run){.shader = "lookup_resolve.comp",
                           .features = c->features,
                           .threads = PIXELS,
                           PASS_LISTS(frame, {BINDING_PASS, GPU_READ, c->places, sizeof c->places},
                                      {BINDING_PASS + 1, GPU_READ, c->sums, sizeof c->sums},
                                      {BINDING_PASS + 2, GPU_READ, c->weights, sizeof c->weights},
                                      {BINDING_PASS + 3, GPU_WRITE, c->indirect, sizeof c->indirect},
                                      {BINDING_PASS + 4, GPU_READ, &c->lookup, sizeof c->lookup},
                                      {BINDING_PASS + 5, GPU_READ, NULL, 0})});
}

/* ---- the model ----------------------------------------------------------------------------------------- */

/* Kernel of a photon at a chain point, 1/m^2; *doubt when rounding decides whether the point is inside. */
static double kernel(const struct lookup_photon *photon, const struct chain_point *point, bool *doubt)
{
    double n[3], m[3], t1[3], t2[3], x[3], y[3];
    pass_unpack_normal(pass_float_bits(photon->position.w), n);
    pass_unpack_normal(pass_float_bits(point->position_normal.w), m);
    tangent_frame(n, t1, t2);
    const uint32_t words[3] = {point->axes.x, point->axes.y, point->axes.z};
    double reach = (double)pass_bits_float(point->axes.w & ~0xfffu), halves[6];
    for (int k = 0; k < 6; k++)
        halves[k] = reach * value_of_half(words[k / 2] >> 16 * (k % 2) & 0xffff);
    memcpy(x, halves, sizeof x);
    memcpy(y, halves + 3, sizeof y);
    const double offset[3] = {(double)point->position_normal.x - (double)photon->position.x,
                              (double)point->position_normal.y - (double)photon->position.y,
                              (double)point->position_normal.z - (double)photon->position.z};
    double a[2] = {dot(x, t1), dot(x, t2)}, b[2] = {dot(y, t1), dot(y, t2)},
           o[2] = {dot(offset, t1), dot(offset, t2)};
    double xx = (double)photon->covariance.x + a[0] * a[0] + b[0] * b[0];
    double xy = (double)photon->covariance.y + a[0] * a[1] + b[0] * b[1];
    double yy = (double)photon->covariance.z + a[1] * a[1] + b[1] * b[1];
    double det = xx * yy - xy * xy, r2 = (yy * o[0] * o[0] - 2 * xy * o[0] * o[1] + xx * o[1] * o[1]) / det;
    double limit = (double)photon->covariance.w + 0.25 * reach, off = fabs(dot(offset, n));
    if (dot(n, m) <= 0.5 || off > limit * 1.0001 || r2 > 1.001)
        return 0;
    *doubt |= off > limit * 0.9999 || r2 > 0.999;
    return off <= limit && r2 < 1 ? 2 * (1 - r2) / (3.14159265358979 * sqrt(det)) : 0;
}

/* `limited`: photons whose footprints are made smaller. */
static void compare(struct lookup_case *c, const char *name, uint32_t limited)
{
    double worst = 0, worst_area = 0, expected_sum = 0, found_sum = 0;
    double(*expected)[3] = calloc(PIXELS, sizeof *expected), *doubt = calloc(PIXELS, sizeof *doubt);
    assert_true(expected && doubt);
    uint32_t points = 0, inside = 0, doubts = 0;
    for (uint32_t i = 0; i < POINTS; i++)
        points += pass_float_bits(c->chains[i].position_normal.w) != NONE;
    for (uint32_t i = 0; i < c->count; i++) {
        const struct lookup_photon *photon = &c->seen[i];
        double area = 0, area_doubt = 0;
        for (uint32_t k = 0; k < POINTS && photon->cell != NONE; k++) {
            bool is_doubtful = false;
            if (pass_float_bits(c->chains[k].position_normal.w) == NONE)
                continue;
            double value = kernel(photon, &c->chains[k], &is_doubtful);
            double throughput = (c->chains[k].axes.w & 0xfff) / 1024.0;
            area += (double)LOOKUP_AREA_PART * value * (double)photon->flux.w * throughput;
            inside += value > 0;
            doubts += is_doubtful;
            double flux[3] = {(double)photon->flux.x, (double)photon->flux.y, (double)photon->flux.z};
            if (!(c->features & FEATURE_CHROMATIC))
                flux[0] = flux[1] = flux[2] = (flux[0] + flux[1] + flux[2]) / 3;
            const double weight[3] = {(double)c->weights[k].x, (double)c->weights[k].y,
                                      (double)c->weights[k].z};
            for (int channel = 0; channel < 3; channel++)
                expected[k % PIXELS][channel] += value * flux[channel] * weight[channel];
            /* what a point at the very rim may add: the kernel is 0.002 of its middle there */
            double rim = 0.005 * flux[0] / 1e-6;
            if (is_doubtful)
                doubt[k % PIXELS] += fmin(rim, value > 0 ? value * 4 : rim), area_doubt += 1e-3;
        }
        bool is_drawn = i % 2 == 0;
        double found = (double)c->photons[i].area - (is_drawn ? 2 : 0);
        worst_area =
            fmax(worst_area, fabs(found - area) / (area_doubt + 2e-4 * area + 2e-5 + (is_drawn ? 1e-6 : 0)));
        if (!is_drawn)
            assert_true((c->photons[i].cell != NONE) == (found > 0));
    }
    for (uint32_t i = 0; i < PIXELS; i++) {
        const float *found = &c->indirect[i].x;
        for (int channel = 0; channel < 3; channel++) {
            double e = expected[i][channel];
            worst = fmax(worst, fabs((double)found[channel] - e) / (2e-4 * e + 1e-3 + doubt[i]));
            expected_sum += e;
            found_sum += (double)found[channel];
        }
    }
    print_message(
        "%s: %u points in %u cells, %u pairs (%u doubtful) of %u tested; worst %.3f, area %.3f of the "
        "tolerance, sum %.6f\n",
        name, points, c->lookup.count[LOOKUP_COUNT_CELLS], inside, doubts,
        c->lookup.count[LOOKUP_COUNT_KERNEL], worst, worst_area, found_sum / expected_sum);
    assert_int_equal(c->lookup.count[LOOKUP_COUNT_POINTS], points);
    assert_int_equal(c->lookup.count[LOOKUP_COUNT_GUARD], limited);
    assert_int_equal(c->lookup.count[LOOKUP_COUNT_OVERFLOW], 0);
    assert_true(abs((int)c->lookup.count[LOOKUP_COUNT_INSIDE] - (int)inside) <= (int)doubts);
    assert_in_bound(worst, 1);
    assert_in_bound(worst_area, 1);
    assert_close(found_sum / expected_sum, 1, 1e-4);
    free(expected);
    free(doubt);
}

static void every_pair_is_found(void **state)
{
    (void)state;
    const uint32_t features[2] = {0, FEATURE_CHROMATIC};
    for (int i = 0; i < 2 * STRUCTURES; i++) {
        random_state = 7 + (uint64_t)(i % 2);
        struct lookup_case *c = case_of(features[i % 2], 2500, false);
        look_up(c, i / 2);
        print_message("%s, ", structure_names[i / 2]);
        compare(c, i % 2 ? "three channels" : "one channel", 0);
        case_free(c);
    }
}

/* Both ways meet the same pairs and add up the same integers. */
static void both_ways_give_the_same_bits(void **state)
{
    (void)state;
    static vec4 first[PIXELS];
    /* the grid: every photon walks alone, the short walks do, none does */
    static const struct {
        enum structure structure;
        float walk_alone;
    } ways[] = {{GRID, 1e9f}, {GRID, 12}, {GRID, 0}, {TREE, 0}};
    enum { WAYS = sizeof ways / sizeof *ways };
    struct lookup_gpu lookup[WAYS];
    for (int i = 0; i < WAYS; i++) {
        random_state = 11;
        struct lookup_case *c = case_of(FEATURE_CHROMATIC, 3000, false);
        c->frame.walk_alone = ways[i].walk_alone;
        look_up(c, ways[i].structure);
        lookup[i] = c->lookup;
        if (i == 0)
            memcpy(first, c->indirect, sizeof first);
        else
            assert_memory_equal(first, c->indirect, sizeof first);
        case_free(c);
    }
    const int same[] = {LOOKUP_COUNT_POINTS, LOOKUP_COUNT_PHOTONS, LOOKUP_COUNT_SEEN, LOOKUP_COUNT_INSIDE};
    for (int i = 0; i < 4; i++)
        for (int way = 1; way < WAYS; way++)
            assert_int_equal(lookup[way].count[same[i]], lookup[0].count[same[i]]);
    print_message("%u long walks, all: %u\n", lookup[1].long_walks, lookup[2].long_walks);
    assert_int_equal(lookup[0].long_walks, 0);
    assert_true(lookup[1].long_walks > 100 && lookup[1].long_walks < lookup[2].long_walks);
    assert_true(lookup[0].count[LOOKUP_COUNT_INSIDE] > 1000);
}

/* Points and photons the other way round: the same light at the same pixels, bit by bit. */
static void check_order(enum structure structure)
{
    random_state = 3;
    struct lookup_case *c = case_of(0, 500, false);
    static vec4 first[PIXELS];
    look_up(c, structure);
    memcpy(first, c->indirect, sizeof first);
    for (uint32_t i = 0; i < PIXELS / 2; i++)
        for (uint32_t layer = 0; layer < LAYERS; layer++) {
            uint32_t a = layer * PIXELS + i, b = layer * PIXELS + PIXELS - 1 - i;
            struct chain_point point = c->chains[a];
            vec4 weight = c->weights[a];
            c->chains[a] = c->chains[b];
            c->weights[a] = c->weights[b];
            c->chains[b] = point;
            c->weights[b] = weight;
        }
    for (uint32_t i = 0; i < c->count / 2; i++) {
        struct lookup_photon photon = c->seen[i];
        c->seen[i] = c->seen[c->count - 1 - i];
        c->seen[c->count - 1 - i] = photon;
    }
    look_up(c, structure);
    for (uint32_t i = 0; i < PIXELS; i++)
        assert_memory_equal(&first[i], &c->indirect[PIXELS - 1 - i], sizeof *first);
    case_free(c);
}

static void order_does_not_matter(void **state)
{
    (void)state;
    check_order(GRID);
    check_order(TREE);
}

/* 250,000 photons in one spot take the grid the time of as many photons anywhere: each meets the few points
 * there. In the tree each of those points meets all of them, and a point has no more rounds than 200,000
 * take. */
static void check_spot(enum structure structure, uint32_t count)
{
    random_state = 5;
    struct lookup_case *c = case_of(0, count, true);
    for (uint32_t i = 0; i < c->count; i++)
        c->seen[i].flux = (vec4){1e-3f, 1e-3f, 1e-3f, 1e-9f};
    look_up(c, structure);
    uint32_t photons = c->lookup.count[LOOKUP_COUNT_PHOTONS], pairs = c->lookup.count[LOOKUP_COUNT_KERNEL];
    double expected = 0, found = 0;
    for (uint32_t k = 0; k < POINTS; k++) {
        bool doubt = false;
        if (pass_float_bits(c->chains[k].position_normal.w) != NONE)
            expected += kernel(&c->seen[1], &c->chains[k], &doubt) * 1e-3 * photons * (double)c->weights[k].x;
    }
    for (uint32_t i = 0; i < PIXELS; i++)
        found += (double)c->indirect[i].x;
    print_message("one spot, %s: %u photons, %u pairs tested, sum %.5f of the expected\n",
                  structure_names[structure], photons, pairs, found / expected);
    assert_true(expected > 0);
    assert_close(found / expected, 1, 1e-3);
    assert_int_equal(c->lookup.count[LOOKUP_COUNT_GUARD], 0);
    assert_true(structure == TREE || pairs <= 100 * photons);
    case_free(c);
}

static void one_spot_is_not_special(void **state)
{
    (void)state;
    check_spot(GRID, 250000);
    check_spot(TREE, 200000);
}

/* 3,599 workgroups: both numbers that the order of workgroups may step by divide it. */
static void every_photon_is_met_once(void **state)
{
    (void)state;
    const uint32_t count = 61 * 59 * GROUP_SIZE;
    struct lookup_case *cases[STRUCTURES];
    uint32_t expected = 0;
    for (int i = 0; i < STRUCTURES; i++) {
        random_state = 13;
        cases[i] = case_of(0, count, false);
        cases[i]->frame.walk_alone = 1e9f;
        look_up(cases[i], (enum structure)i);
    }
    for (uint32_t i = 0; i < count; i++)
        expected += cases[GRID]->seen[i].cell != NONE;
    const struct lookup_gpu *grid = &cases[GRID]->lookup, *tree = &cases[TREE]->lookup;
    print_message("%u groups: %u photons, %u inside\n", count / GROUP_SIZE, grid->count[LOOKUP_COUNT_PHOTONS],
                  grid->count[LOOKUP_COUNT_INSIDE]);
    assert_int_equal(grid->count[LOOKUP_COUNT_PHOTONS], expected);
    assert_int_equal(grid->count[LOOKUP_COUNT_INSIDE], tree->count[LOOKUP_COUNT_INSIDE]);
    assert_int_equal(tree->count[LOOKUP_COUNT_GUARD], 0);
    assert_memory_equal(cases[GRID]->indirect, cases[TREE]->indirect, sizeof cases[GRID]->indirect);
    assert_memory_equal(cases[GRID]->photons, cases[TREE]->photons, count * sizeof *cases[GRID]->photons);
    for (int i = 0; i < STRUCTURES; i++)
        case_free(cases[i]);
}

/* On a floor and on a wall two photons each, along the axes, 4 mm wide and `length` m long, with points of 4
 * mm along them and beyond. */
static struct lookup_case *needles(double length)
{
    enum { NEEDLES = 4 };
    const double normals[NEEDLES][3] = {{0, 1, 0}, {0, 1, 0}, {1, 0, 0}, {1, 0, 0}};
    const double major = 0.5 * length, minor = 0.002, size = 0.004;
    random_state = 17;
    struct lookup_case *c = case_of(0, NEEDLES, false);
    double along[NEEDLES][3], across[NEEDLES][3];
    for (uint32_t i = 0; i < NEEDLES; i++) {
        uint32_t packed = pass_pack_normal(normals[i]);
        bool is_turned = i % 2 == 1;
        double n[3];
        pass_unpack_normal(packed, n);
        tangent_frame(n, is_turned ? across[i] : along[i], is_turned ? along[i] : across[i]);
        float xx = (float)(is_turned ? minor * minor : major * major);
        float yy = (float)(is_turned ? major * major : minor * minor);
        c->seen[i] = (struct lookup_photon){.position = {0.1f * (float)i, -1, -3, pass_bits_float(packed)},
                                            .covariance = {xx, 0, yy, 0.002f},
                                            .flux = {1, 1, 1, (float)(major * minor)},
                                            .cell = i};
    }
    for (uint32_t i = 0; i < POINTS; i++) {
        const struct lookup_photon *photon = &c->seen[i % NEEDLES];
        c->chains[i] = (struct chain_point){.position_normal = {0, 0, 0, pass_bits_float(NONE)}};
        if (i / NEEDLES % 2)
            continue;
        double at = between(-0.55, 0.55) * length, beside = between(-0.004, 0.004), x[3], y[3];
        const double *u = along[i % NEEDLES], *v = across[i % NEEDLES];
        for (int k = 0; k < 3; k++) {
            x[k] = size * u[k];
            y[k] = size * v[k];
        }
        c->chains[i].position_normal =
            (vec4){photon->position.x + (float)(at * u[0] + beside * v[0]),
                   photon->position.y + (float)(at * u[1] + beside * v[1]),
                   photon->position.z + (float)(at * u[2] + beside * v[2]), photon->position.w};
        set_axes(&c->chains[i], x, y, 0.5);
    }
    return c;
}

/* Needles of 10 m reach 320 cells to either side and are met to their ends. Those of 40 m are longer than
 * packed cells tell apart: each gives the light of one that reaches 500 cells, and is counted once, whether
 * one thread walks or eight do. */
static void needles_stay_in_range(void **state)
{
    (void)state;
    for (int i = 0; i < 2; i++) {
        struct lookup_case *c = needles(10);
        c->frame.walk_alone = i ? 1e9f : 64;
        look_up(c, GRID);
        compare(c, "needles of 10 m", 0);
        case_free(c);

        c = needles(40);
        c->frame.walk_alone = i ? 1e9f : 64;
        look_up(c, GRID);
        const double cell = 1.0 / 64; /* the power of two above three times 4 mm */
        for (uint32_t k = 0; k < c->count; k++) {
            vec4 *covariance = &c->seen[k].covariance;
            double longest = sqrt((double)covariance->x + (double)covariance->z) + 4 * (double)covariance->w;
            float shrink = (float)(500 * cell / longest);
            *covariance = (vec4){covariance->x * shrink * shrink, covariance->y * shrink * shrink,
                                 covariance->z * shrink * shrink, covariance->w * shrink};
        }
        compare(c, "needles of 40 m", c->count);
        case_free(c);
    }
}

int main(void)
{
    if (gpu_list(NULL, 0) == 0)
        skip_program("there is no Vulkan device");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_pair_is_found),      cmocka_unit_test(both_ways_give_the_same_bits),
        cmocka_unit_test(order_does_not_matter),    cmocka_unit_test(one_spot_is_not_special),
        cmocka_unit_test(every_photon_is_met_once), cmocka_unit_test(needles_stay_in_range),
    };
    return cmocka_run_group_tests(tests, pass_shared_set_up, pass_shared_tear_down);
}
