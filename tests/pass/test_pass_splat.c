/* test_pass_splat.c: splat.comp, splat_quad.* and resolve.comp against a loop over every photon and every
 * pixel in double precision; and against themselves, bit by bit: computed splats in another order, blended
 * ones in the same.
 */
#include <string.h>

#include "tests/support/check.h"
#include "tests/support/pass_device.h"

enum { WIDTH = 61, HEIGHT = 37, PIXELS = WIDTH * HEIGHT, PHOTONS = 700 };
enum { PIECES_MAX = 2 * PHOTONS, PIECE_THREADS = 7 * 64 }; /* fewer groups than pieces: they take turns */

static uint64_t random_state;

static double between(double low, double high)
{
    return pass_between(&random_state, low, high);
}

/* ---- what is drawn ------------------------------------------------------------------------------------- */

struct picture {
    struct frame_gpu frame;
    uint32_t features, aa, depth, count;
    struct photon photons[PHOTONS];
    struct target_gpu targets[PIXELS];
    struct surface_gpu surfaces[PIXELS];
    struct counters_gpu counters;
    uint32_t sums[6 * PIXELS];
    uint32_t reached[PHOTONS];
    struct splat_piece pieces[PIECES_MAX];
    uint32_t piece_room;
    vec4 blended[PIXELS];
    vec4 irradiance[PIXELS];
};

/* A camera at the origin looks down -z at the wall z = -4; left of an edge there is a step of it, z = -3.4; a
 * strip of it is turned by 70 degrees; here and there is nothing. */
static void make_targets(struct picture *p)
{
    const double focal = 40;
    p->frame.width = WIDTH;
    p->frame.height = HEIGHT;
    p->frame.forward = (vec4){0, 0, -1, (float)(1 / (focal * focal))};
    for (uint32_t i = 0; i < PIXELS; i++) {
        uint32_t x = i % WIDTH, y = i / WIDTH;
        double depth = x < 20 ? 3.4 : 4, normal[3] = {0, 0, 1};
        if (y >= 30) {
            normal[0] = sin(1.22);
            normal[2] = cos(1.22);
        }
        bool is_empty = x > 50 && y < 8;
        p->targets[i].position_normal =
            (vec4){(float)((x + 0.5 - WIDTH * 0.5) / focal * depth),
                   (float)(-(y + 0.5 - HEIGHT * 0.5) / focal * depth), (float)-depth,
                   pass_bits_float(is_empty ? NONE : pass_pack_normal(normal))};
        p->surfaces[i].albedo = (vec4){0.8f, 0.5f, x % 7 ? 0.25f : 0, 0};
    }
}

/* Ellipses of every size and stretch, under perspective, many half outside; every fifth a box. */
static void make_photons(struct picture *p)
{
    const double facing[3] = {0, 0, 1};
    p->count = PHOTONS;
    for (uint32_t i = 0; i < PHOTONS; i++) {
        struct photon *photon = &p->photons[i];
        double depth = i % 3 ? 4 : 3.4;
        photon->position =
            (vec4){(float)between(-2, 2), (float)between(-1, 1), (float)(-depth + between(-0.05, 0.05)),
                   pass_bits_float(pass_pack_normal(facing))};
        photon->center = (vec4){(float)between(-15, WIDTH + 15), (float)between(-15, HEIGHT + 15), 0, 0};
        photon->density = (vec4){(float)between(0.1, 4), (float)between(0.1, 4), (float)between(0.1, 4),
                                 (float)between(0.02, 0.2)};
        photon->cell = i % 11 ? i % 5 | i % 3 << CELL_SPACING_SHIFT : NONE;
        if (i % 5 == 0) {
            photon->ellipse = (vec4){(float)between(0, 1), (float)between(0, 1), 0, -1};
            continue;
        }
        /* covariance from axes: the upper triangular U has |U o| = 1 on the ellipse */
        double minor = exp(between(log(0.4), log(4))), major = minor * exp(between(0, log(60))),
               turn = between(0, 3.14159);
        major = fmin(major, 64);
        double c = cos(turn), s = sin(turn), xx = major * major * c * c + minor * minor * s * s,
               yy = major * major * s * s + minor * minor * c * c,
               xy = (major * major - minor * minor) * c * s;
        double det = xx * yy - xy * xy, u00 = sqrt(yy / det);
        double bend = between(0, 0.5), way = between(0, 6.2832), w[2] = {cos(way), sin(way)};
        double along = sqrt(w[0] * w[0] * xx + 2 * w[0] * w[1] * xy + w[1] * w[1] * yy);
        photon->center.z = (float)(bend * w[0] / along);
        photon->center.w = (float)(bend * w[1] / along);
        photon->ellipse = (vec4){(float)u00, (float)(-xy / (det * u00)), (float)(1 / sqrt(yy)),
                                 (float)(sqrt(yy) / (1 - bend) * 1.0001)};
    }
}

static struct picture *picture_of(uint32_t features, uint32_t aa, uint32_t depth)
{
    struct picture *p = calloc(1, sizeof *p);
    assert_non_null(p);
    p->features = features;
    p->aa = aa;
    p->depth = depth;
    p->piece_room = PIECES_MAX;
    p->frame.irradiance_unit = 0x1p-20f;
    p->frame.flux_unit = 0x1p-20f;
    p->frame.tint = (vec4){1, 1, 1, 0};
    p->frame.msaa_threshold = 40; /* of ellipses from 0.5 to 800 px^2 */
    make_targets(p);
    make_photons(p);
    return p;
}

static bool is_quads(const struct picture *p)
{
    return p->aa == AA_MSAA || p->aa == AA_MSAA_SAMPLE || p->aa == AA_MSAA_SMALL;
}

static void draw_quads(struct picture *p)
{
    memset(p->reached, 0, sizeof p->reached);
    pass_device_draw(
        pass_shared,
        &(struct pass_draw){.vertex_shader = "splat_quad.vert",
                            .fragment_shader = "splat_quad.frag",
                            .aa = p->aa,
                            .depth = p->depth,
                            .width = WIDTH,
                            .height = HEIGHT,
                            .samples = pass_device_samples(pass_shared),
                            .per_sample = p->aa != AA_MSAA,
                            .vertices = 6 * p->count,
                            .picture = p->blended,
                            PASS_LISTS({BINDING_FRAME, GPU_READ, &p->frame, sizeof p->frame},
                                       {BINDING_PASS + 1, GPU_READ, p->targets, sizeof p->targets},
                                       {BINDING_PASS + 2, GPU_READ, p->photons, sizeof p->photons},
                                       {BINDING_PASS + 3, GPU_WRITE, p->reached, sizeof p->reached})});
    pass_device_run(
        pass_shared,
        &(struct pass_run){.shader = "splat_count.comp",
                           .features = p->features,
                           .aa = p->aa,
                           .threads = p->count,
                           PASS_LISTS({BINDING_FRAME, GPU_READ, &p->frame, sizeof p->frame},
                                      {BINDING_PASS, GPU_READ_WRITE, &p->counters, sizeof p->counters},
                                      {BINDING_PASS + 1, GPU_READ, p->reached, sizeof p->reached})});
}

static void draw(struct picture *p)
{
    memset(p->sums, 0, sizeof p->sums);
    p->counters = (struct counters_gpu){.photon_count = p->count};
    size_t size = PIXELS * (p->features & FEATURE_CHROMATIC ? 24 : 8);
    if (is_quads(p))
        draw_quads(p);
    for (uint32_t phase = 0; phase < 2 && p->aa != AA_MSAA && p->aa != AA_MSAA_SAMPLE; phase++)
        pass_device_run(
            pass_shared,
            &(struct pass_run){.shader = "splat.comp",
                               .features = p->features,
                               .aa = p->aa,
                               .depth = p->depth,
                               .phase = phase,
                               .threads = phase ? PIECE_THREADS : p->count,
                               PASS_LISTS({BINDING_FRAME, GPU_READ, &p->frame, sizeof p->frame},
                                          {BINDING_PASS, GPU_READ_WRITE, &p->counters, sizeof p->counters},
                                          {BINDING_PASS + 1, GPU_READ, p->targets, sizeof p->targets},
                                          {BINDING_PASS + 2, GPU_READ, p->photons, sizeof p->photons},
                                          {BINDING_PASS + 3, GPU_READ_WRITE, p->sums, size},
                                          {BINDING_PASS + 4, GPU_READ_WRITE, p->pieces,
                                           p->piece_room * sizeof *p->pieces})});
    pass_device_run(
        pass_shared,
        &(struct pass_run){.shader = "resolve.comp",
                           .features = p->features,
                           .aa = p->aa,
                           .threads = PIXELS,
                           PASS_LISTS({BINDING_FRAME, GPU_READ, &p->frame, sizeof p->frame},
                                      {BINDING_LIGHTS, GPU_READ, p->targets, sizeof p->targets},
                                      {BINDING_PASS, GPU_READ_WRITE, &p->counters, sizeof p->counters},
                                      {BINDING_PASS + 1, GPU_READ, p->targets, sizeof p->targets},
                                      {BINDING_PASS + 2, GPU_READ, p->sums, size},
                                      {BINDING_PASS + 3, GPU_WRITE, p->irradiance, sizeof p->irradiance},
                                      {BINDING_PASS + 4, GPU_READ, p->surfaces, sizeof p->surfaces},
                                      {BINDING_PASS + 5, GPU_READ, p->blended, sizeof p->blended})});
}

/* ---- the model ----------------------------------------------------------------------------------------- */

static bool accepts(const struct picture *p, uint32_t pixel, const struct photon *photon, bool *is_close)
{
    vec4 target = p->targets[pixel].position_normal;
    if (pass_float_bits(target.w) == NONE)
        return false;
    double n[3], m[3];
    pass_unpack_normal(pass_float_bits(photon->position.w), n);
    pass_unpack_normal(pass_float_bits(target.w), m);
    double off = ((double)target.x - (double)photon->position.x) * n[0] +
                 ((double)target.y - (double)photon->position.y) * n[1] +
                 ((double)target.z - (double)photon->position.z) * n[2];
    double limit = (double)photon->density.w, facing = n[0] * m[0] + n[1] * m[1] + n[2] * m[2];
    if (p->depth == DEPTH_MARGIN) {
        limit = 0.01 * fabs((double)target.x * n[0] + (double)target.y * n[1] + (double)target.z * n[2]);
        facing = 1;
    }
    *is_close |= fabs(fabs(off) / limit - 1) < 1e-5;
    return fabs(off) <= limit && facing > 0.5;
}

/* The conic A o.o + 2 b.o + c = 0 that bounds a photon on screen; o is the offset from its center. */
struct conic {
    double xx, xy, yy, x, y, c;
};

static struct conic conic_of(const struct photon *photon)
{
    double u00 = (double)photon->ellipse.x, u01 = (double)photon->ellipse.y, u11 = (double)photon->ellipse.z;
    double wx = (double)photon->center.z, wy = (double)photon->center.w;
    return (struct conic){
        u00 * u00 - wx * wx, u00 * u01 - wx * wy, u01 * u01 + u11 * u11 - wy * wy, -wx, -wy, -1};
}

static double conic_at(const struct conic *q, double x, double y)
{
    return q->xx * x * x + 2 * q->xy * x * y + q->yy * y * y + 2 * (q->x * x + q->y * y) + q->c;
}

/* The part of a pixel (its low corner at an offset) inside the conic: chords of thin rows. */
static double overlap(const struct conic *q, double left, double top)
{
    enum { ROWS = 1000 };
    double sum = 0;
    for (int i = 0; i < ROWS; i++) {
        double y = top + (i + 0.5) / ROWS, b = q->xy * y + q->x, c = q->yy * y * y + 2 * q->y * y + q->c;
        double d = b * b - q->xx * c;
        if (d > 0)
            sum += fmax(fmin((-b + sqrt(d)) / q->xx, left + 1) - fmax((-b - sqrt(d)) / q->xx, left), 0);
    }
    return sum / ROWS;
}

/* Half axes and direction of the conic's ellipse, and its middle as an offset. */
struct axes {
    double middle[2], along[2], radii[2];
};

static struct axes axes_of(const struct conic *q)
{
    double det = q->xx * q->yy - q->xy * q->xy;
    struct axes a = {.middle = {(-q->x * q->yy + q->y * q->xy) / det, (-q->y * q->xx + q->x * q->xy) / det}};
    double level = -conic_at(q, a.middle[0], a.middle[1]); /* at the middle; 0 on the rim */
    double turn = 0.5 * atan2(2 * q->xy, q->xx - q->yy);   /* of the stiffer axis, the short one */
    double stiff = 0.5 * (q->xx + q->yy) + hypot(0.5 * (q->xx - q->yy), q->xy);
    a.along[0] = -sin(turn);
    a.along[1] = cos(turn);
    a.radii[0] = sqrt(level * stiff / det);
    a.radii[1] = sqrt(level / stiff);
    return a;
}

/* Where Vulkan's standard puts the samples, in sixteenths of a pixel. */
static const uint8_t (*sample_places(uint32_t samples))[2]
{
    static const uint8_t two[][2] = {{12, 12}, {4, 4}};
    static const uint8_t four[][2] = {{6, 2}, {14, 6}, {2, 10}, {10, 14}};
    static const uint8_t eight[][2] = {{9, 5}, {7, 11}, {13, 9}, {5, 3}, {3, 13}, {1, 7}, {11, 15}, {15, 1}};
    return samples == 2 ? two : samples == 4 ? four : samples == 8 ? eight : NULL;
}

/* Of a part of the unit disk's area in single precision, a difference of four that are as large as pi. */
static const double disk_error = 3e-6;

/* Overlaps below it may be none to the shader. */
static const double faint = 1e-5;

/* Corners are snapped to 1/256 px, so a sample this near to a quad's edge may fall on either side. */
static const double snap = 0.005;

/* The share of a pixel's samples that take the photon. */
static double sampled(const struct picture *p, const struct photon *photon, double ox, double oy,
                      bool *is_close)
{
    uint32_t samples = pass_device_samples(pass_shared), taken = 0;
    const uint8_t(*places)[2] = sample_places(samples);
    struct conic q = conic_of(photon);
    struct axes a = axes_of(&q);
    for (uint32_t i = 0; i < samples; i++) {
        double x = ox + places[i][0] / 16.0 - 0.5, y = oy + places[i][1] / 16.0 - 0.5;
        double dx = x - a.middle[0], dy = y - a.middle[1];
        double along = fabs(dx * a.along[0] + dy * a.along[1]) - a.radii[0];
        double across = fabs(dx * a.along[1] - dy * a.along[0]) - a.radii[1];
        bool is_in_quad = along < 0 && across < 0;
        if (p->aa == AA_MSAA) {
            *is_close |= fmax(along, across) < snap && fmax(along, across) > -snap;
            taken += is_in_quad;
        } else {
            double level = conic_at(&q, x, y);
            *is_close |= fabs(level) < 1e-4;
            taken += level < 0;
        }
    }
    return (double)taken / samples;
}

/* What a photon adds at a pixel per unit of its density; *is_close when rounding decides whether it does. */
static double kernel(const struct picture *p, const struct photon *photon, int x, int y, bool *is_close)
{
    double cx = (double)photon->center.x, cy = (double)photon->center.y;
    if (p->aa == AA_PIXEL)
        return floor(cx) == x && floor(cy) == y;
    if (p->aa == AA_FILTER && photon->ellipse.w < 0) {
        /* the share of the box that lies over the pixel */
        double wide = fmax((double)photon->ellipse.x, 1e-6), high = fmax((double)photon->ellipse.y, 1e-6);
        double left = fmax(cx - 0.5 * wide, x), right = fmin(cx + 0.5 * wide, x + 1);
        double top = fmax(cy - 0.5 * high, y), bottom = fmin(cy + 0.5 * high, y + 1);
        return fmax(right - left, 0) * fmax(bottom - top, 0) / (wide * high);
    }
    double ox = x + 0.5 - cx, oy = y + 0.5 - cy;
    double depth = 1 + (double)photon->center.z * ox + (double)photon->center.w * oy;
    if (depth <= 0)
        return 0; /* behind the horizon */
    struct conic q = conic_of(photon);
    if (p->aa == AA_COVERAGE) {
        struct axes a = axes_of(&q);
        double dx = ox - a.middle[0], dy = oy - a.middle[1];
        bool is_away = fabs(dx * a.along[0] + dy * a.along[1]) > a.radii[0] + 0.75 ||
                       fabs(dx * a.along[1] - dy * a.along[0]) > a.radii[1] + 0.75;
        double part = is_away ? 0 : overlap(&q, ox - 0.5, oy - 0.5);
        *is_close |= part > 0 && part < faint;
        return part;
    }
    double area = 3.14159265358979 / ((double)photon->ellipse.x * (double)photon->ellipse.z);
    bool is_sampled =
        p->aa == AA_MSAA_SAMPLE || (p->aa == AA_MSAA_SMALL && area < (double)p->frame.msaa_threshold);
    if (is_sampled)
        return sampled(p, photon, ox, oy, is_close);
    double a = (double)photon->ellipse.x * ox + (double)photon->ellipse.y * oy,
           b = (double)photon->ellipse.z * oy;
    double r2 = (a * a + b * b) / (depth * depth);
    *is_close |= fabs(r2 - 1) < 1e-4;
    if (r2 >= 1)
        return 0;
    if (p->aa == AA_MSAA)
        return sampled(p, photon, ox, oy, is_close);
    return p->aa == AA_FILTER ? 1 - r2 : 1;
}

/* The pixel whose plane tells the area a pixel shows: its own, or for aa=pixel, where light of a receiver may
 * lie in a pixel whose middle sees glass, the last of its neighbours that has one. */
static uint32_t plane_of(const struct picture *p, uint32_t pixel)
{
    uint32_t plane = pixel;
    if (p->aa != AA_PIXEL || pass_float_bits(p->targets[pixel].position_normal.w) != NONE)
        return plane;
    int width = (int)p->frame.width, height = (int)p->frame.height;
    for (int k = 0; k < 9; k++) {
        int x = (int)pixel % width + k % 3 - 1, y = (int)pixel / width + k / 3 - 1;
        if (x >= 0 && y >= 0 && x < width && y < height &&
            pass_float_bits(p->targets[y * width + x].position_normal.w) != NONE)
            plane = (uint32_t)(y * width + x);
    }
    return plane;
}

static void compare(const char *name, struct picture *p)
{
    static double expected[PIXELS][3], doubt[PIXELS];
    memset(expected, 0, sizeof expected);
    memset(doubt, 0, sizeof doubt);
    uint32_t inside = 0, reached = 0, doubts = 0;
    double doubt_sum = 0;
    for (uint32_t i = 0; i < p->count; i++) {
        const struct photon *photon = &p->photons[i];
        if (photon->cell == NONE)
            continue;
        bool has_reached = false;
        double value[3] = {(double)photon->density.x, (double)photon->density.y, (double)photon->density.z};
        double value_max = fmax(value[0], fmax(value[1], value[2]));
        for (uint32_t pixel = 0; pixel < PIXELS; pixel++) {
            bool is_close = false;
            double k = kernel(p, photon, (int)(pixel % WIDTH), (int)(pixel / WIDTH), &is_close);
            if (k == 0 && !is_close)
                continue;
            inside += k > 0;
            bool takes = p->aa == AA_PIXEL || accepts(p, pixel, photon, &is_close);
            doubts += is_close;
            for (int c = 0; c < 3; c++)
                expected[pixel][c] += takes ? k * value[c] : 0;
            if (p->aa == AA_COVERAGE)
                doubt[pixel] +=
                    disk_error * value_max / ((double)photon->ellipse.x * (double)photon->ellipse.z);
            else if (is_close)
                doubt[pixel] += value_max;
            has_reached |= takes && k > 0;
        }
        reached += has_reached;
    }
    double worst = 0, sum = 0, found_sum = 0, flux = 0;
    const double tint[3] = {(double)p->frame.tint.x, (double)p->frame.tint.y, (double)p->frame.tint.z};
    for (uint32_t i = 0; i < PIXELS; i++) {
        const uint32_t plane = plane_of(p, i);
        const float *found = &p->irradiance[i].x, *albedo = &p->surfaces[plane].albedo.x;
        double mean = (expected[i][0] + expected[i][1] + expected[i][2]) / 3, seen = 0;
        for (int c = 0; c < 3; c++) {
            double e = p->features & FEATURE_CHROMATIC ? expected[i][c] : mean * tint[c];
            double tolerance = 2e-5 * e + 2e-5 + doubt[i];
            worst = fmax(worst, fabs((double)found[c] - e) / tolerance);
            sum += e;
            doubt_sum += doubt[i];
            found_sum += (double)found[c];
            seen += p->aa != AA_PIXEL ? (double)found[c]
                    : albedo[c] > 0   ? (double)found[c] / (double)albedo[c]
                                      : 0;
        }
        vec4 target = p->targets[plane].position_normal;
        if (pass_float_bits(target.w) != NONE) {
            /* a pixel's part of the sphere, seen from the eye, on the target's plane */
            double n[3], z = -(double)target.z;
            pass_unpack_normal(pass_float_bits(target.w), n);
            double distance =
                sqrt((double)target.x * (double)target.x + (double)target.y * (double)target.y + z * z);
            double toward =
                fabs((double)target.x * n[0] + (double)target.y * n[1] + (double)target.z * n[2]) / distance;
            double solid_angle = (double)p->frame.forward.w * pow(z / distance, 3);
            flux += seen * solid_angle * distance * distance / toward;
        }
    }
    double ledger = pass_fixed(p->counters.flux_low[FATE_BUFFER], p->counters.flux_high[FATE_BUFFER]) *
                    (double)p->frame.flux_unit;
    print_message("%s: %u pixels inside, %u in doubt; worst %.2f of the tolerance, sums %.6f and %.6f\n",
                  name, inside, doubts, worst, found_sum, sum);
    assert_in_bound(worst, 1);
    assert_close(found_sum, sum, 1e-5 * sum + (is_quads(p) ? doubt_sum : 0));
    assert_true(sum > 0);
    assert_close(ledger, flux, 1e-4 * flux);
    if (!is_quads(p))
        assert_in_bound(fabs((double)p->counters.count[COUNT_KERNEL_INSIDE] - inside),
                        doubts + 1e-3 * inside);
    assert_in_bound(fabs((double)p->counters.count[COUNT_CONTRIBUTING] - reached), doubts);
    assert_true(p->counters.count[COUNT_KERNEL] >= p->counters.count[COUNT_KERNEL_INSIDE]);
    assert_int_equal(p->counters.count[COUNT_GUARD_OVERFLOW], 0);
}

/* ---- tests --------------------------------------------------------------------------------------------- */

/* Whether the device takes several samples, at places known here. */
static bool can_sample(const char *name)
{
    uint32_t samples = pass_device_samples(pass_shared);
    bool can = sample_places(samples) != NULL;
    if (!can)
        print_message("%s: left out, the device takes %u samples a pixel\n", name, samples);
    return can;
}

static void splats_follow_the_model(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        uint32_t features, aa, depth;
    } cases[] = {
        {"filter", FEATURE_CHROMATIC, AA_FILTER, DEPTH_PLANE},
        {"filter, one channel", 0, AA_FILTER, DEPTH_PLANE},
        {"filter, margin", FEATURE_CHROMATIC, AA_FILTER, DEPTH_MARGIN},
        {"none", FEATURE_CHROMATIC, AA_NONE, DEPTH_PLANE},
        {"pixel", FEATURE_CHROMATIC, AA_PIXEL, DEPTH_PLANE},
        {"coverage", FEATURE_CHROMATIC, AA_COVERAGE, DEPTH_PLANE},
        {"coverage, one channel", 0, AA_COVERAGE, DEPTH_MARGIN},
        {"msaa", FEATURE_CHROMATIC, AA_MSAA, DEPTH_PLANE},
        {"msaa_sample", FEATURE_CHROMATIC, AA_MSAA_SAMPLE, DEPTH_PLANE},
        {"msaa_sample, margin", FEATURE_CHROMATIC, AA_MSAA_SAMPLE, DEPTH_MARGIN},
        {"msaa_small", FEATURE_CHROMATIC, AA_MSAA_SMALL, DEPTH_PLANE},
    };
    for (uint32_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        random_state = 5 + i;
        struct picture *p = picture_of(cases[i].features, cases[i].aa, cases[i].depth);
        if (p->features == 0)
            p->frame.tint = (vec4){1.5f, 0.9f, 0.6f, 0};
        if (is_quads(p) && !can_sample(cases[i].name)) {
            free(p);
            continue;
        }
        if (p->aa != AA_FILTER && p->aa != AA_PIXEL) /* boxes are the filter's */
            for (uint32_t k = 0; k < PHOTONS; k += 5)
                p->photons[k].cell = NONE;
        for (uint32_t k = 0; k < PHOTONS && p->aa == AA_PIXEL;
             k++) { /* photon_compact hands over none outside */
            const vec4 *center = &p->photons[k].center;
            if (center->x < 0 || center->y < 0 || center->x >= WIDTH || center->y >= HEIGHT)
                p->photons[k].cell = NONE;
        }
        draw(p);
        compare(cases[i].name, p);
        free(p);
    }
}

/* No light crosses a step of the wall nor lands on the strip that is turned away, wherever its ellipse
 * reaches. */
static void edges_stop_light(void **state)
{
    (void)state;
    random_state = 21;
    struct picture *p = picture_of(FEATURE_CHROMATIC, AA_FILTER, DEPTH_PLANE);
    for (uint32_t i = 0; i < PHOTONS; i++) {
        p->photons[i].position.z = -4;
        p->photons[i].density.w = 0.1f;
        p->photons[i].center.x = (float)between(15, 30); /* about the step */
        p->photons[i].center.y = (float)between(20, 35); /* and the strip */
    }
    draw(p);
    double lit = 0;
    for (uint32_t i = 0; i < PIXELS; i++) {
        uint32_t x = i % WIDTH, y = i / WIDTH;
        if (x < 20 || y >= 30 || (x > 50 && y < 8))
            assert_true(p->irradiance[i].x == 0 && p->irradiance[i].y == 0 && p->irradiance[i].z == 0);
        else
            lit += (double)p->irradiance[i].x;
    }
    assert_true(lit > 0);
    free(p);
}

/* Whatever the size of an ellipse, down to a thousandth of a pixel, `coverage` spreads its whole area. */
static void coverage_keeps_flux(void **state)
{
    (void)state;
    random_state = 61;
    struct picture *p = picture_of(FEATURE_CHROMATIC, AA_COVERAGE, DEPTH_PLANE);
    double expected = 0, worst = 0;
    for (uint32_t i = 0; i < PIXELS; i++)
        p->targets[i].position_normal =
            (vec4){0, 0, -4, pass_bits_float(pass_pack_normal((const double[3]){0, 0, 1}))};
    for (uint32_t i = 0; i < PHOTONS; i++) {
        struct photon *photon = &p->photons[i];
        double minor = exp(between(log(1e-3), log(5))), major = fmin(minor * exp(between(0, log(64))), 14),
               turn = between(0, 3.14159);
        double c = cos(turn), s = sin(turn), yy = major * major * s * s + minor * minor * c * c,
               xy = (major * major - minor * minor) * c * s;
        double det = minor * minor * major * major, u00 = sqrt(yy / det);
        photon->position.z = -4;
        photon->cell = 0;
        photon->center = (vec4){(float)between(15, WIDTH - 15), (float)between(15, HEIGHT - 15), 0, 0};
        photon->ellipse = (vec4){(float)u00, (float)(-xy / (det * u00)), (float)(1 / sqrt(yy)), 0};
        double area = 3.14159265358979 * minor * major;
        photon->density = (vec4){(float)(1 / area), 1, 0, 1};
        expected += 1;
    }
    for (uint32_t i = 0; i < PHOTONS; i += 70) { /* and each of some alone */
        struct picture *one = picture_of(FEATURE_CHROMATIC, AA_COVERAGE, DEPTH_PLANE);
        memcpy(one->targets, p->targets, sizeof p->targets);
        one->photons[0] = p->photons[i];
        one->count = 1;
        draw(one);
        double sum = 0;
        for (uint32_t k = 0; k < PIXELS; k++)
            sum += (double)one->irradiance[k].x;
        worst = fmax(worst, fabs(sum - 1));
        assert_int_equal(one->counters.count[COUNT_CONTRIBUTING], 1);
        free(one);
    }
    draw(p);
    double sum = 0;
    for (uint32_t i = 0; i < PIXELS; i++)
        sum += (double)p->irradiance[i].x;
    print_message("coverage keeps %.7f of the flux; a single photon is off by %.1e at most\n", sum / expected,
                  worst);
    assert_close(sum, expected, 1e-4 * expected);
    assert_in_bound(worst, 1e-3);
    assert_int_equal(p->counters.count[COUNT_CONTRIBUTING], PHOTONS);
    free(p);
}

/* Fixed-point sums do not know an order; blended floats are added in the photons' order, every time. */
static void bits_stay(void **state)
{
    (void)state;
    random_state = 31;
    for (uint32_t aa = AA_FILTER; aa <= AA_COVERAGE; aa++) {
        struct picture *p = picture_of(FEATURE_CHROMATIC, aa, DEPTH_PLANE);
        if (is_quads(p) && !can_sample("bits")) {
            free(p);
            continue;
        }
        draw(p);
        uint32_t *sums = malloc(sizeof p->sums);
        vec4 *irradiance = malloc(sizeof p->irradiance);
        assert_true(sums && irradiance);
        memcpy(sums, p->sums, sizeof p->sums);
        memcpy(irradiance, p->irradiance, sizeof p->irradiance);
        for (int turn = 0; turn < 3; turn++) {
            /* first as it was, but with hardly any room for pieces, then shuffled */
            p->piece_room = turn == 0 ? 5 : PIECES_MAX;
            draw(p);
            assert_memory_equal(sums, p->sums, sizeof p->sums);
            assert_memory_equal(irradiance, p->irradiance, sizeof p->irradiance);
            for (uint32_t i = PHOTONS - 1; i > 0 && !is_quads(p); i--) {
                uint32_t other = (uint32_t)between(0, i + 1);
                struct photon swap = p->photons[i];
                p->photons[i] = p->photons[other];
                p->photons[other] = swap;
            }
        }
        free(sums);
        free(irradiance);
        free(p);
    }
}

/* Sums past 32 bits carry; what passes 64 bits is clamped and counted, and the picture stays finite. */
static void overflow_is_counted(void **state)
{
    (void)state;
    random_state = 41;
    struct picture *p = picture_of(FEATURE_CHROMATIC, AA_PIXEL, DEPTH_PLANE);
    double expected = 0;
    for (uint32_t i = 0; i < PHOTONS; i++) {
        p->photons[i].cell = 0;
        p->photons[i].center = (vec4){3.5f, 4.5f, 0, 0};
        p->photons[i].density = (vec4){(float)between(100, 4000), 1e30f, 0, 0};
        expected += (double)p->photons[i].density.x;
    }
    draw(p);
    const vec4 *pixel = &p->irradiance[4 * WIDTH + 3];
    assert_close((double)pixel->x, expected, 1e-6 * expected); /* 700 times 2^31 units */
    assert_true(isfinite(pixel->y) && pixel->y > 1e12f);
    assert_true(pixel->z == 0);
    assert_int_equal(p->counters.count[COUNT_GUARD_OVERFLOW], PHOTONS);
    free(p);
}

/* Ellipses with centres and sizes beyond all bounds draw nothing or something, and end. */
static void far_photons_end(void **state)
{
    (void)state;
    random_state = 51;
    struct picture *p = picture_of(FEATURE_CHROMATIC, AA_FILTER, DEPTH_PLANE);
    for (uint32_t i = 0; i < PHOTONS; i++) {
        float far = (float)exp(between(3, 13.8));
        p->photons[i].center.x = i & 1 ? far : -far;
        p->photons[i].center.y = i & 2 ? far : i & 4 ? -far : 10;
    }
    draw(p);
    compare("far centres", p);
    free(p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(splats_follow_the_model), cmocka_unit_test(edges_stop_light),
        cmocka_unit_test(coverage_keeps_flux),     cmocka_unit_test(bits_stay),
        cmocka_unit_test(overflow_is_counted),     cmocka_unit_test(far_photons_end),
    };
    return cmocka_run_group_tests(tests, pass_shared_set_up, pass_shared_tear_down);
}
