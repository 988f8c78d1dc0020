/* test_pass_feedback.c: what photons report to their cells, against a serial loop in double precision. */
#include <string.h>

#include "core/image/image_io.h"
#include "tests/support/check.h"
#include "tests/support/pass_device.h"

enum { WIDTH = 40, HEIGHT = 24, PIXELS = WIDTH * HEIGHT, PHOTONS = 3000, CELLS = 64 };

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

static float word_as_float(uint32_t word)
{
    float value;
    memcpy(&value, &word, sizeof value);
    return value;
}

static double between(double low, double high)
{
    return low + (high - low) * pass_random(&random_state);
}

struct report {
    struct frame_gpu frame;
    uint32_t features, rule;
    struct counters_gpu counters;
    struct photon photons[PHOTONS];
    struct target_gpu targets[PIXELS];
    vec4 now[PIXELS], before[PIXELS];
    struct feedback_gpu feedback[CELLS];
    uint32_t tree[CELLS], columns[CELLS];
};

static struct report *report_of(void)
{
    struct report *r = calloc(1, sizeof *r);
    assert_non_null(r);
    r->features = FEATURE_VARIANCE;
    r->rule = DENSITY_SQRT_RULE;
    r->frame.filter_radius = 0.75f;
    for (uint32_t i = 0; i < PIXELS; i++) /* a pixel in seven shows no receiver */
        r->targets[i].position_normal.w = word_as_float(i % 7 ? 0 : NONE);
    r->counters.photon_count = PHOTONS - 100; /* what lies behind is none of this frame's */
    r->frame.width = WIDTH;
    r->frame.height = HEIGHT;
    r->frame.flags = FLAG_HAS_PREVIOUS;
    /* last frame's camera stood elsewhere and looked down -z through 30 px per unit of tangent */
    r->frame.eye = (vec4){1, 2, 3, 0};
    r->frame.old_eye = (vec4){1.1f, 1.9f, 3.05f, 0};
    r->frame.old_forward = (vec4){0, 0, -1, 0};
    r->frame.old_right = (vec4){1, 0, 0, 0};
    r->frame.old_up = (vec4){0, 1, 0, 0};
    r->frame.old_scale = (vec4){30, -30, 0.5f * WIDTH, 0.5f * HEIGHT};
    for (uint32_t i = 0; i < PIXELS; i++) {
        r->now[i] = (vec4){(float)between(0, 9), (float)between(0, 9), (float)between(0, 9), 0};
        r->before[i] = (vec4){(float)between(0, 9), (float)between(0, 9), (float)between(0, 9), 0};
        if (i % 5 == 0)
            r->now[i] = r->before[i] = (vec4){0, 0, 0, 0};
    }
    for (uint32_t i = 0; i < CELLS; i++) {
        r->columns[i] = 1 + i % 7;
        r->tree[i] = r->columns[i] * (1 + i % 5);
    }
    for (uint32_t i = 0; i < PHOTONS; i++) {
        struct photon *p = &r->photons[i];
        double z = between(-5, 0.5);
        p->position = (vec4){(float)(between(-0.9, 0.9) * z), (float)(between(-0.6, 0.6) * z), (float)z, 0};
        p->center = (vec4){(float)between(-4, WIDTH + 4), (float)between(-4, HEIGHT + 4), 0, 0};
        p->area = i % 9 ? (float)exp(between(-6, 8)) : 0;
        p->root = (float)exp(between(-4, 4));
        p->shape = image_half_from_float((float)between(0, 0.3)) | ((uint32_t)between(0, 256) << 16);
        /* any covariance, filter included, as the inverse's upper triangular root; or a box below a pixel */
        double xx = exp(between(-2, 5)) + 0.5625, yy = exp(between(-2, 5)) + 0.5625;
        double xy = between(-0.95, 0.95) * sqrt((xx - 0.5625) * (yy - 0.5625)), det = xx * yy - xy * xy;
        p->ellipse = (vec4){(float)sqrt(yy / det), (float)(-xy / sqrt(yy * det)), (float)(1 / sqrt(yy)),
                            (float)sqrt(yy)};
        if (i % 11 == 0)
            p->ellipse = (vec4){(float)between(0, 1), (float)between(0, 1), 0, -1};
        p->cell = i % 13 ? (uint32_t)between(0, CELLS) | i % 3 << CELL_SPACING_SHIFT : NONE;
    }
    return r;
}

static void run(struct report *r)
{
    memset(r->feedback, 0, sizeof r->feedback);
    pass_device_run(
        device,
        &(struct pass_run){.shader = "feedback.comp",
                           .features = r->features,
                           .density = r->rule,
                           .threads = PHOTONS,
                           PASS_LISTS({BINDING_FRAME, GPU_READ, &r->frame, sizeof r->frame},
                                      {BINDING_PASS, GPU_READ_WRITE, &r->counters, sizeof r->counters},
                                      {BINDING_PASS + 1, GPU_READ, r->targets, sizeof r->targets},
                                      {BINDING_PASS + 2, GPU_READ_WRITE, r->feedback, sizeof r->feedback},
                                      {BINDING_PASS + 3, GPU_READ, r->now, sizeof r->now},
                                      {BINDING_PASS + 4, GPU_READ, r->before, sizeof r->before},
                                      {BINDING_PASS + 5, GPU_READ, r->photons, sizeof r->photons},
                                      {BINDING_PASS + 6, GPU_READ, r->tree, sizeof r->tree},
                                      {BINDING_PASS + 7, GPU_READ, r->columns, sizeof r->columns})});
}

static double luminance(vec4 c)
{
    return 0.2126 * (double)c.x + 0.7152 * (double)c.y + 0.0722 * (double)c.z; /* ITU-R BT.709 */
}

/* Relative change between the photon's pixel and the one its point had in the last frame; 0 where there is
 * none. */
static double change_of(const struct report *r, const struct photon *p, bool *is_border)
{
    double x = (double)p->position.x + (double)r->frame.eye.x - (double)r->frame.old_eye.x;
    double y = (double)p->position.y + (double)r->frame.eye.y - (double)r->frame.old_eye.y;
    double z = -((double)p->position.z + (double)r->frame.eye.z - (double)r->frame.old_eye.z);
    double at_x = (double)p->center.x, at_y = (double)p->center.y;
    if (z <= 0 || at_x < 0 || at_y < 0 || at_x >= WIDTH || at_y >= HEIGHT)
        return 0;
    double old_x = 0.5 * WIDTH + 30 * x / z, old_y = 0.5 * HEIGHT - 30 * y / z;
    *is_border = fmin(fabs(old_x - round(old_x)), fabs(old_y - round(old_y))) < 1e-4;
    if (old_x < 0 || old_y < 0 || old_x >= WIDTH || old_y >= HEIGHT)
        return 0;
    double a = luminance(r->now[(int)at_y * WIDTH + (int)at_x]),
           b = luminance(r->before[(int)old_y * WIDTH + (int)old_x]);
    return a + b > 0 ? fabs(a - b) / (a + b) : 0;
}

static double share_of(const struct photon *p)
{
    return (double)image_half_to_float((uint16_t)p->shape);
}

static void cells_get_the_sums(void **state)
{
    (void)state;
    random_state = 4;
    struct report *r = report_of();
    run(r);
    double area[CELLS] = {0}, root[CELLS] = {0}, change[CELLS] = {0}, doubt[CELLS] = {0};
    uint32_t counts[CELLS] = {0}, changed = 0;
    for (uint32_t i = 0; i < r->counters.photon_count; i++) {
        const struct photon *p = &r->photons[i];
        if (p->cell == NONE || !(p->area > 0))
            continue;
        uint32_t cell = p->cell & CELL_INDEX_MASK;
        bool is_border = false;
        double moved = share_of(p) * change_of(r, p, &is_border);
        changed += moved > 0;
        counts[cell]++;
        area[cell] += (double)p->area;
        root[cell] += (double)p->root;
        change[cell] += moved;
        doubt[cell] += is_border ? share_of(p) : 0;
    }
    double worst = 0;
    for (uint32_t i = 0; i < CELLS; i++) {
        const struct feedback_gpu *f = &r->feedback[i];
        assert_true(counts[i] > 10);
        /* half a unit of rounding a photon */
        assert_close(pass_fixed(f->area_low, f->area_high) / 65536, area[i],
                     counts[i] * 0x1p-17 + 1e-9 * area[i]);
        assert_close(pass_fixed(f->root_low, f->root_high) / 1048576, root[i],
                     counts[i] * 0x1p-21 + 1e-9 * root[i]);
        double found = pass_fixed(f->change_low, f->change_high) / 16777216;
        worst = fmax(worst, fabs(found - change[i]));
        assert_close(found, change[i], 1e-5 + doubt[i]);
    }
    print_message("%u photons saw a change; changes agree within %.1e\n", changed, worst);
    assert_true(changed > 300);
    free(r);
}

static void nothing_changes_without_a_previous_frame(void **state)
{
    (void)state;
    for (int way = 0; way < 3; way++) {
        random_state = 4;
        struct report *r = report_of();
        if (way == 0)
            r->frame.flags = 0;
        else if (way == 1)
            r->features = 0;
        else /* a still picture from a still camera, every photon at its own pixel */
            for (uint32_t i = 0; i < PHOTONS; i++) {
                struct photon *p = &r->photons[i];
                r->frame.old_eye = r->frame.eye;
                p->center.x = (float)(0.5 * WIDTH - 30 * (double)p->position.x / (double)p->position.z);
                p->center.y = (float)(0.5 * HEIGHT + 30 * (double)p->position.y / (double)p->position.z);
                double x = (double)p->center.x, y = (double)p->center.y;
                if (fmin(fabs(x - round(x)), fabs(y - round(y))) < 1e-3)
                    p->cell = NONE; /* rounding decides which pixel it is */
            }
        if (way == 2)
            memcpy(r->before, r->now, sizeof r->now);
        run(r);
        for (uint32_t i = 0; i < CELLS; i++) {
            assert_true(r->feedback[i].change_low == 0 && r->feedback[i].change_high == 0);
            assert_true(r->feedback[i].area_low != 0 && r->feedback[i].root_low != 0);
        }
        free(r);
    }
}

static void order_changes_no_bit(void **state)
{
    (void)state;
    random_state = 9;
    struct report *r = report_of();
    r->counters.photon_count = PHOTONS;
    struct feedback_gpu first[CELLS];
    run(r);
    memcpy(first, r->feedback, sizeof first);
    for (uint32_t i = PHOTONS - 1; i > 0; i--) {
        uint32_t other = (uint32_t)between(0, i + 1);
        struct photon swap = r->photons[i];
        r->photons[i] = r->photons[other];
        r->photons[other] = swap;
    }
    run(r);
    assert_memory_equal(first, r->feedback, sizeof first);
    free(r);
}

/* Luminance between pixel middles, of those that show a receiver; `fallback` where none does. */
static double luminance_at(const struct report *r, double x, double y, double fallback)
{
    int x0 = (int)floor(x - 0.5), y0 = (int)floor(y - 0.5);
    double sum = 0, weight = 0;
    for (int k = 0; k < 4; k++) {
        int px = x0 + k % 2, py = y0 + k / 2;
        if (px < 0 || py < 0 || px >= WIDTH || py >= HEIGHT || (py * WIDTH + px) % 7 == 0)
            continue;
        double w = (1 - fabs(x - 0.5 - px)) * (1 - fabs(y - 0.5 - py));
        sum += w * luminance(r->now[py * WIDTH + px]);
        weight += w;
    }
    return weight > 0 ? sum / weight : fallback;
}

/* A kernel of variance C / 6 blurs a picture I by half of I'' C / 6: with I'' C by differences over the
 * footprint's own axes, I(+) + I(-) - 2 I, that is a twelfth of it. Differences are taken over a pixel at
 * least. A thousandth is the least. */
static void model_error(const struct report *r, const struct photon *p, double error[2])
{
    double xx, yy, xy;
    if (p->ellipse.w < 0) { /* a box of sides sqrt(2 C), without filter */
        xx = 0.5 * pow((double)p->ellipse.x, 2) + 0.5625;
        yy = 0.5 * pow((double)p->ellipse.y, 2) + 0.5625;
        xy = 0;
    } else { /* the inverse of U^T U */
        double a = (double)p->ellipse.x, b = (double)p->ellipse.y, c = (double)p->ellipse.z;
        double m00 = a * a, m01 = a * b, m11 = b * b + c * c, det = m00 * m11 - m01 * m01;
        xx = m11 / det, yy = m00 / det, xy = -m01 / det;
    }
    double angle = 0.5 * atan2(2 * xy, xx - yy);
    double here = luminance_at(r, (double)p->center.x, (double)p->center.y, -1), blur[2] = {0, 0};
    for (int k = 0; k < 2; k++, angle += 1.5707963267948966) {
        double ex = cos(angle), ey = sin(angle);
        double width = fmax(xx * ex * ex + 2 * xy * ex * ey + yy * ey * ey - 0.5625, 0);
        double far = fmax(width, 1), reach = sqrt(far);
        double ahead =
            luminance_at(r, (double)p->center.x + reach * ex, (double)p->center.y + reach * ey, here);
        double behind =
            luminance_at(r, (double)p->center.x - reach * ex, (double)p->center.y - reach * ey, here);
        if (here > 0)
            blur[k] = fmin(fabs(ahead + behind - 2 * here) * width / far / (12 * here), 1);
    }
    double from_u = ((p->shape >> 16) & 255) / 255.0;
    for (int k = 0; k < 2; k++)
        error[k] = 0.001 + (k ? 1 - from_u : from_u) * blur[0] + (k ? from_u : 1 - from_u) * blur[1];
}

static void errors_follow_the_model(void **state)
{
    (void)state;
    random_state = 12;
    struct report *r = report_of();
    r->rule = DENSITY_ERROR_RULE;
    for (uint32_t i = 0; i < PIXELS; i++) /* a picture whose second differences mean something */
        for (int k = 0; k < 3; k++) {
            float value = (float)(2 + sin(0.3 * (i % WIDTH)) + cos(0.2 * (int)(i / WIDTH)));
            (&r->now[i].x)[k] = value;
        }
    run(r);
    double u[CELLS] = {0}, v[CELLS] = {0}, worst = 0;
    uint32_t counts[CELLS] = {0};
    for (uint32_t i = 0; i < r->counters.photon_count; i++) {
        const struct photon *p = &r->photons[i];
        if (p->cell == NONE || !(p->area > 0))
            continue;
        double error[2], flux = pow((double)p->root, 2) / fmin(fmax((double)p->area, 0.5), 1000);
        model_error(r, p, error);
        uint32_t cell = p->cell & CELL_INDEX_MASK;
        counts[cell]++;
        /* half of a side's strata follow branches of spacing 2, half of those branches of spacing 4, one at
         * least; their footprints are that many times as large */
        double larger = 1;
        for (int axis = 0; axis < 2; axis++) {
            uint32_t count = axis ? r->tree[cell] / r->columns[cell] : r->columns[cell], left = count;
            for (uint32_t k = 0; k < p->cell >> CELL_SPACING_SHIFT; k++)
                left = left / 2 > 1 ? left / 2 : 1;
            larger *= (double)count / left;
        }
        u[cell] += flux * error[0] / larger;
        v[cell] += flux * error[1] / larger;
    }
    for (uint32_t i = 0; i < CELLS; i++) {
        const struct feedback_gpu *f = &r->feedback[i];
        double found[2] = {pass_fixed(f->error_u_low, f->error_u_high) * 0x1p-30,
                           pass_fixed(f->error_v_low, f->error_v_high) * 0x1p-30};
        const double expected[2] = {u[i], v[i]};
        for (int k = 0; k < 2; k++) {
            assert_true(counts[i] > 10 && expected[k] > 0);
            worst = fmax(worst, fabs(found[k] / expected[k] - 1));
        }
    }
    print_message("errors of %d cells agree within %.1e\n", CELLS, worst);
    assert_in_bound(worst, 1e-3);
    free(r);
}

/* The largest areas a photon may have carry into the high words. */
static void sums_pass_32_bits(void **state)
{
    (void)state;
    random_state = 10;
    struct report *r = report_of();
    r->features = 0;
    for (uint32_t i = 0; i < PHOTONS; i++) {
        r->photons[i].cell = 7;
        r->photons[i].area = 1e9f;
        r->photons[i].root = 1e6f;
    }
    run(r);
    double count = r->counters.photon_count;
    assert_close(pass_fixed(r->feedback[7].area_low, r->feedback[7].area_high) / 65536, count * 1e9,
                 1e-6 * count * 1e9);
    assert_close(pass_fixed(r->feedback[7].root_low, r->feedback[7].root_high) / 1048576, count * 1e6,
                 1e-6 * count * 1e6);
    free(r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(cells_get_the_sums),      cmocka_unit_test(nothing_changes_without_a_previous_frame),
        cmocka_unit_test(errors_follow_the_model), cmocka_unit_test(order_changes_no_bit),
        cmocka_unit_test(sums_pass_32_bits),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
