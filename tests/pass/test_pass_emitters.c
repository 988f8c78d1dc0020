/* What lights with a size emit, against closed forms: irradiance at points of the pivot sphere of a rectangle
 * (Lambert's formula for polygons), a disk and a sphere; where rays start and what they meet; how much of the
 * emitter differentials stand for. */
#include <string.h>

#include "tests/support/check.h"
#include "tests/support/pass_device.h"
#include "tests/support/tile_maps.h"

static struct pass_device *device;

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

enum { CELLS = 8, SIDE = 4, COUNT = CELLS * CELLS * SIDE * SIDE, FLOATS = 12 };

static const double intensity = 5, pivot = 2;

/* A light at (1, 2, 3) that shines along a slanted axis, its tile a narrow cap about that. */
static struct light_gpu light_of(uint32_t type, uint32_t shape, double w, double h, uint32_t emitter_side)
{
    struct light_gpu light = {.type = type, .map = TILE_CAP, .shape = shape, .emitter_side = emitter_side};
    tile_set_frame(&light, (struct vector){0.2, -1, 0.3});
    double height = 0.02;
    light.position = (vec4){1, 2, 3, 1};
    light.intensity = (vec4){5, 5, 5, 15};
    light.tile_z.w = (float)height;
    light.tile_origin.w = (float)(2 * PI * height);
    light.emitter_x =
        (vec4){(float)w * light.tile_x.x, (float)w * light.tile_x.y, (float)w * light.tile_x.z, (float)pivot};
    light.emitter_y = (vec4){(float)h * light.tile_y.x, (float)h * light.tile_y.y, (float)h * light.tile_y.z,
                             (float)(shape == EMITTER_RECTANGLE ? hypot(w, h) : fmax(w, h))};
    return light;
}

static void emit(const struct light_gpu *light, struct photon_ray *rays, float *spreads)
{
    struct frame_gpu frame = {
        .cells = CELLS, .tile_levels = 3, .tile_slots = 1, .light_count = 1, .seed = 1, .flux_unit = 1e-9f};
    uint32_t *tree = calloc(pass_tree_size(CELLS * CELLS), sizeof *tree),
             *queue = calloc(COUNT, sizeof *queue), columns[CELLS * CELLS];
    assert_true(tree && queue);
    for (uint32_t i = 0; i < CELLS * CELLS; i++) {
        tree[i] = SIDE * SIDE;
        columns[i] = SIDE;
    }
    pass_tree_fill(tree, CELLS * CELLS);
    struct counters_gpu counters = {.task_count = COUNT};
    pass_device_run(
        device,
        &(struct pass_run){.shader = "photon_emit.comp",
                           .features = FEATURE_POINT | FEATURE_SPOT | FEATURE_SOFT,
                           .threads = COUNT,
                           PASS_LISTS({BINDING_FRAME, GPU_READ, &frame, sizeof frame},
                                      {BINDING_LIGHTS, GPU_READ, (void *)light, sizeof *light},
                                      {BINDING_PASS, GPU_READ_WRITE, &counters, sizeof counters},
                                      {BINDING_PASS + 1, GPU_READ, tree, pass_tree_size(CELLS * CELLS) * 4},
                                      {BINDING_PASS + 2, GPU_WRITE, rays, COUNT * sizeof *rays},
                                      {BINDING_PASS + 3, GPU_WRITE, queue, COUNT * 4},
                                      {BINDING_PASS + 4, GPU_WRITE, spreads, COUNT * FLOATS * 4},
                                      {BINDING_PASS + 5, GPU_READ, columns, sizeof columns})});
    free(tree);
    free(queue);
}

static struct vector minus(struct vector a, struct vector b)
{
    return (struct vector){a.x - b.x, a.y - b.y, a.z - b.z};
}

/* Irradiance at `p` (from the light's middle), across `n`, of a rectangle that radiates 1 W/(m^2 sr) evenly.
 */
static double polygon_irradiance(const struct light_gpu *light, struct vector p, struct vector n)
{
    struct vector x = vector_of(light->emitter_x), y = vector_of(light->emitter_y), corner[4];
    for (int i = 0; i < 4; i++) {
        double a = i == 0 || i == 3 ? -1 : 1, b = i < 2 ? -1 : 1;
        corner[i] = minus((struct vector){a * x.x + b * y.x, a * x.y + b * y.y, a * x.z + b * y.z}, p);
    }
    double sum = 0;
    for (int i = 0; i < 4; i++) {
        struct vector u = corner[i], v = corner[(i + 1) % 4], c = vector_cross(u, v);
        double sine = sqrt(vector_dot(c, c));
        sum += atan2(sine, vector_dot(u, v)) * vector_dot(c, n) / sine;
    }
    return fabs(sum) / 2;
}

static void check_light(const char *name, const struct light_gpu *light, double tolerance)
{
    struct photon_ray *rays = calloc(COUNT, sizeof *rays);
    float *spreads = calloc(COUNT, FLOATS * sizeof *spreads);
    assert_true(rays && spreads);
    emit(light, rays, spreads);
    double area = (light->shape == EMITTER_RECTANGLE ? 4 : PI) *
                  sqrt(vector_dot(vector_of(light->emitter_x), vector_of(light->emitter_x)) *
                       vector_dot(vector_of(light->emitter_y), vector_of(light->emitter_y)));
    double worst = 0, off_pivot = 0, variance[2] = {0};
    struct vector middle = vector_of(light->position);
    for (uint32_t cell = 0; cell < CELLS * CELLS; cell++) {
        double flux = 0, u = 0, v = 0;
        uint32_t cx, cy;
        pass_morton_place(cell, &cx, &cy);
        for (uint32_t k = 0; k < SIDE * SIDE; k++) {
            const struct photon_ray *ray = &rays[cell * SIDE * SIDE + k];
            flux += (double)ray->flux.x;
            u = (cx + (k % SIDE + 0.5) / SIDE) / CELLS, v = (cy + (k / SIDE + 0.5) / SIDE) / CELLS;
            struct vector d = tile_direction(light, u, v), e = minus(vector_of(ray->origin), middle),
                          way = vector_of(ray->direction),
                          to = {pivot * d.x - e.x, pivot * d.y - e.y, pivot * d.z - e.z};
            struct vector miss = vector_cross(to, way);
            off_pivot = fmax(off_pivot, sqrt(vector_dot(miss, miss)));
            /* second moment of where rays start, and what their columns stand for, a sixth of their squares
             */
            const struct vector axes[2] = {vector_of(light->tile_x), vector_of(light->tile_y)};
            for (int i = 0; i < 2; i++) {
                const float *s = spreads + FLOATS * (cell * SIDE * SIDE + k);
                double place = vector_dot(e, axes[i]), columns = 0;
                for (int c = 0; c < 2; c++) {
                    struct vector column = {(double)s[6 * c], (double)s[6 * c + 1], (double)s[6 * c + 2]};
                    columns += vector_dot(column, axes[i]) * vector_dot(column, axes[i]) / 6;
                }
                variance[i] += (place * place + columns) / COUNT;
            }
        }
        struct vector d = tile_direction(light, (cx + 0.5) / CELLS, (cy + 0.5) / CELLS),
                      p = {pivot * d.x, pivot * d.y, pivot * d.z};
        double here = flux / ((double)light->tile_origin.w / (CELLS * CELLS) * pivot * pivot), expected;
        if (light->shape == EMITTER_SPHERE)
            expected = intensity / (pivot * pivot);
        else if (light->shape == EMITTER_RECTANGLE)
            expected = intensity / area * polygon_irradiance(light, p, d);
        else { /* on the axis, and how it falls off beside it for a small disk */
            double radius = (double)light->emitter_y.w, cosine = vector_dot(d, vector_of(light->direction));
            expected = intensity / area * PI * radius * radius / (radius * radius + pivot * pivot) * cosine;
        }
        worst = fmax(worst, fabs(here / expected - 1));
    }
    double half[2] = {sqrt(vector_dot(vector_of(light->emitter_x), vector_of(light->emitter_x))),
                      sqrt(vector_dot(vector_of(light->emitter_y), vector_of(light->emitter_y)))};
    print_message("%s, %u strata a side: irradiance off by %.2e at most, pivot missed by %.1e m\n", name,
                  light->emitter_side, worst, off_pivot);
    assert_in_bound(worst, tolerance);
    assert_in_bound(off_pivot, 1e-5);
    for (int i = 0; i < 2; i++) {
        double whole = light->shape == EMITTER_RECTANGLE ? half[i] * half[i] / 3 : half[i] * half[i] / 4;
        print_message("  variance along axis %d: %.5f m^2, of the emitter %.5f\n", i, variance[i], whole);
        assert_close(variance[i] / whole, 1, 0.08);
    }
    free(rays);
    free(spreads);
}

static void irradiance_is_that_of_the_emitter(void **state)
{
    (void)state;
    for (uint32_t side = 1; side <= 4; side *= 4) {
        struct light_gpu rectangle = light_of(LIGHT_TYPE_COSINE, EMITTER_RECTANGLE, 0.4, 0.25, side);
        /* strata go with places in a cell: an eighth of the tile is wide, and its weights are not even */
        check_light("rectangle", &rectangle, side == 1 ? 0.003 : 0.012);
        struct light_gpu disk = light_of(LIGHT_TYPE_COSINE, EMITTER_DISK, 0.3, 0.3, side);
        check_light("disk", &disk, side == 1 ? 0.002 : 0.012);
        struct light_gpu sphere = light_of(LIGHT_TYPE_POINT, EMITTER_SPHERE, 0.3, 0.3, side);
        check_light("sphere", &sphere, side == 1 ? 1e-6 : 0.012);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(irradiance_is_that_of_the_emitter)};
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
