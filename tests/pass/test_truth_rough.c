/* Rough casters against integrals in double precision that share nothing with the renderer but the lobe:
 * slopes of a normal distribution with variance alpha^2 / 2, alpha = roughness^2. A plane mirror, integrated
 * over its area; a slab of glass, over the slopes of both faces. */
#include "core/render/renderer.h"
#include "tests/support/check.h"
#include "tests/support/scenery.h"
#include "tests/support/truth.h"

static const double pi = 3.14159265358979323846;
enum { WIDTH = 120, HEIGHT = 68, PIXELS = WIDTH * HEIGHT, BLOCK = 4 };

struct deviation {
    double error, flux; /* relative L1, and the sum over the expected one */
};

/* Over means of BLOCK x BLOCK pixels: what is measured is smooth, photons are not. */
static struct deviation compare(const float *irradiance, const double *expected)
{
    double difference = 0, sum = 0, total = 0;
    for (int y = 0; y < HEIGHT; y += BLOCK)
        for (int x = 0; x < WIDTH; x += BLOCK) {
            double value = 0, wanted = 0;
            for (int k = 0; k < BLOCK * BLOCK; k++) {
                int i = (y + k / BLOCK) * WIDTH + x + k % BLOCK;
                value += (double)irradiance[3 * i];
                wanted += expected[i];
            }
            if (isnan(wanted))
                continue;
            difference += fabs(value - wanted);
            sum += value;
            total += wanted;
        }
    return (struct deviation){difference / total, sum / total};
}

static uint32_t roughened(struct scene_builder *builder, uint32_t material, double roughness)
{
    builder->scene->materials[material].roughness = (float)roughness;
    return material;
}

/* Every pixel that the expected picture has, by footprints and by photons that take one slope each. */
static void check(struct truth *stage, const char *name, double roughness, const double *expected,
                  const double bounds[2])
{
    static const char *const settings[2] = {"photons=65536",
                                            "photons=65536 aa=pixel density=uniform accumulate=16"};
    for (int way = 0; way < 2; way++) {
        truth_set(stage, settings[way]);
        view_reset(stage->view);
        const struct frame_result *result = truth_render(stage, way ? 1 : 4, 1u << CHANNEL_IRRADIANCE);
        struct deviation found = compare(truth_channel(result, CHANNEL_IRRADIANCE), expected);
        print_message("%s, roughness %.2f, %s: relative L1 %.4f, flux %.4f\n", name, roughness, settings[way],
                      found.error, found.flux);
        assert_in_bound(found.error, bounds[way]);
        assert_close(found.flux, 1, 0.01);
    }
}

/* ---- a mirror --------------------------------------------------------------------------------------------
 */

/* It hangs at y = 1, looks down, and is lit from the side below it. */
static const struct vec3 lamp = {-0.8, 0.4, 0};
static const double intensity = 10, half_side = 0.25;

static double mirrored(double roughness, const double floor[2])
{
    enum { STEPS = 64 };
    double alpha = pow(roughness, 2), sum = 0, area = pow(2 * half_side / STEPS, 2);
    for (int i = 0; i < STEPS * STEPS; i++) {
        struct vec3 place = vec3_make(half_side * ((2 * (i % STEPS) + 1.0) / STEPS - 1), 1,
                                      half_side * ((2 * (i / STEPS) + 1.0) / STEPS - 1));
        struct vec3 in = vec3_sub(lamp, place), out = vec3_sub(vec3_make(floor[0], 0, floor[1]), place);
        double to_lamp = vec3_length(in), to_floor = vec3_length(out);
        in = vec3_scale(in, 1 / to_lamp);
        out = vec3_scale(out, 1 / to_floor);
        struct vec3 half = vec3_add(in, out);
        double length = vec3_length(half), cosine = -half.y / length;
        if (cosine <= 0)
            continue;
        double density =
            exp((1 - 1 / (cosine * cosine)) / (alpha * alpha)) / (pi * alpha * alpha * pow(cosine, 3));
        /* lit, of the normals that turn it here (per steradian of them; there are four of directions),
         * arriving */
        sum += -intensity * in.y / (to_lamp * to_lamp) * density / (4 * 0.5 * length) * -out.y /
               (to_floor * to_floor) * area;
    }
    return sum;
}

static void mirror(void **state)
{
    (void)state;
    /* A footprint has the lobe straightened out: at a roughness of 0.3 that is what its error is. */
    static const struct {
        double roughness, bounds[2];
    } cases[] = {{0.15, {0.02, 0.02}}, {0.3, {0.1, 0.02}}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct scene_builder builder;
        scenery_begin(&builder, NULL);
        scenery_floor(&builder, 16);
        uint32_t metal = roughened(&builder, scenery_mirror(&builder), cases[i].roughness);
        for (int k = 0; k < 3; k++)
            builder.scene->materials[metal].base_color[k] = 1;
        scenery_place(&builder, shape_floor(&builder, "mirror", metal, vec3_make(0, 1, 0), 2 * half_side));
        scenery_lamp(&builder, lamp, intensity);
        struct view_camera camera =
            scenery_camera(&builder, vec3_make(1.3, 2.5, 2.2), vec3_make(1.3, 0, 0), vec3_make(0, 1, 0), 40);
        struct truth stage;
        scenery_open(&stage, &builder, &camera, WIDTH, HEIGHT, "");
        static double expected[PIXELS];
        for (uint32_t p = 0; p < PIXELS; p++) {
            double floor[2];
            assert_true(truth_floor_point(&stage, p % WIDTH + 0.5, p / WIDTH + 0.5, floor));
            expected[p] = mirrored(cases[i].roughness, floor);
        }
        check(&stage, "mirror", cases[i].roughness, expected, cases[i].bounds);
        truth_close(&stage);
    }
}

/* ---- a slab of glass -------------------------------------------------------------------------------------
 */

/* Under a sun in the zenith, 1 m wide, over the floor by `gap`. */
static const double ior = 1.5, thickness = 0.1, gap = 0.6, slab_half = 0.5;

static double radical_inverse(uint32_t base, uint32_t index)
{
    double value = 0;
    for (double scale = 1.0 / base; index; index /= base, scale /= base)
        value += scale * (index % base);
    return value;
}

/* Unit vector behind an interface; the share that crosses it goes to *kept. */
static struct vec3 refracted(struct vec3 way, struct vec3 normal, double eta, double *kept)
{
    double in = -vec3_dot(way, normal), out = sqrt(1 - eta * eta * (1 - in * in));
    double parallel = (in - eta * out) / (in + eta * out), across = (eta * in - out) / (eta * in + out);
    *kept *= 1 - 0.5 * (parallel * parallel + across * across);
    return vec3_add(vec3_scale(way, eta), vec3_scale(normal, eta * in - out));
}

enum { RAYS = 1 << 17 };
static struct slab_ray {
    double shift, kept; /* along x, on the floor */
} slab_rays[RAYS];

static void trace_slab(double roughness)
{
    for (uint32_t i = 0; i < RAYS; i++) {
        struct vec3 way = vec3_make(0, -1, 0), place = vec3_make(0, 0, 0);
        double kept = 1;
        for (uint32_t face = 0; face < 2; face++) {
            double radius = roughness * roughness * sqrt(-log(1 - radical_inverse(face ? 5 : 2, i + 1))),
                   angle = 2 * pi * radical_inverse(face ? 7 : 3, i + 1);
            struct vec3 normal = vec3_unit(vec3_make(radius * cos(angle), 1, radius * sin(angle)), way);
            way = refracted(way, normal, face ? ior : 1 / ior, &kept);
            place = vec3_add(place, vec3_scale(way, (face ? gap : thickness) / -way.y));
        }
        slab_rays[i] = (struct slab_ray){place.x, kept};
    }
}

static void slab(void **state)
{
    (void)state;
    static const struct {
        double roughness, bounds[2];
    } cases[] = {{0.2, {0.01, 0.025}}, {0.4, {0.01, 0.03}}};
    double polished = pow((ior - 1) / (ior + 1), 2),
           twice = 1 / (1 - polished * polished); /* reflected to and fro */
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct scene_builder builder;
        scenery_begin(&builder, NULL);
        scenery_floor(&builder, 16);
        uint32_t glass = roughened(&builder, scenery_glass(&builder, ior), cases[i].roughness);
        scenery_place(&builder, shape_box(&builder, "slab", glass, vec3_make(-slab_half, gap, -slab_half),
                                          vec3_make(slab_half, gap + thickness, slab_half)));
        scenery_sun(&builder, vec3_make(0, -1, 0), intensity);
        struct view_camera camera =
            scenery_camera(&builder, vec3_make(0, 0.55, 0), vec3_make(0, 0, 0), vec3_make(0, 0, -1), 60);
        struct truth stage;
        scenery_open(&stage, &builder, &camera, WIDTH, HEIGHT, "");
        trace_slab(cases[i].roughness);
        static double expected[PIXELS];
        for (uint32_t p = 0; p < PIXELS; p++) {
            double floor[2];
            assert_true(truth_floor_point(&stage, p % WIDTH + 0.5, p / WIDTH + 0.5, floor));
            expected[p] = NAN;
            if (fabs(floor[1]) > 0.2)
                continue; /* what goes over the slab's other edges comes near */
            expected[p] = 0;
            for (uint32_t k = 0; k < RAYS; k++)
                if (fabs(floor[0] - slab_rays[k].shift) < slab_half)
                    expected[p] += intensity * twice * slab_rays[k].kept / RAYS;
        }
        check(&stage, "slab", cases[i].roughness, expected, cases[i].bounds);
        truth_close(&stage);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(mirror), cmocka_unit_test(slab)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
