/* test_pass_density.c: the task buffers' control loop against a C model in double precision: feedback to
 * density, budget, samples, quadtree, the tasks' way down, and the remap when a tile moves.
 */
#include <string.h>

#include "tests/support/check.h"
#include "tests/support/pass_device.h"
#include "tests/support/tile_maps.h"

enum { MOST_CELLS = 4 * 64 * 64 };

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

static double uniform(void)
{
    return pass_random(&random_state);
}

/* ---- one turn of the loop ------------------------------------------------------------------------------ */

struct task_buffers {
    struct frame_gpu frame;
    struct light_gpu lights[4];
    uint32_t total; /* cells of the atlas */
    uint32_t features, rule;
    uint32_t mask[MOST_CELLS];
    struct feedback_gpu feedback[MOST_CELLS];
    float old_density[MOST_CELLS];
    /* what the passes make */
    struct counters_gpu counters;
    float density[MOST_CELLS], variance[MOST_CELLS];
    uint32_t tree[2 * MOST_CELLS], columns[MOST_CELLS];
    uint32_t costs[MOST_CELLS];
    float aspect[MOST_CELLS];
};

static struct task_buffers *buffers_of(uint32_t cells, uint32_t slots, uint32_t lights)
{
    struct task_buffers *b = calloc(1, sizeof *b);
    assert_non_null(b);
    b->total = cells * cells * slots;
    assert_true(b->total <= MOST_CELLS);
    b->frame = (struct frame_gpu){.cells = cells,
                                  .tile_slots = slots,
                                  .light_count = lights,
                                  .part_count = lights,
                                  .photon_budget = 131072,
                                  .ray_capacity = 4 * 131072,
                                  .photon_capacity = 5 * 131072,
                                  .min_samples = 1,
                                  .target_area = 0.1f,
                                  .variance_gain = 2,
                                  .temporal_weight = 0.5f,
                                  .flux_unit = 0x1p-30f};
    while (1u << b->frame.tile_levels < cells)
        b->frame.tile_levels++;
    b->features = FEATURE_VARIANCE | FEATURE_DIRECTIONAL;
    for (uint32_t i = 0; i < lights * cells * cells; i++)
        b->mask[i] = 1;
    return b;
}

static void set_fixed(uint32_t *low, uint32_t *high, double value, double scale)
{
    double units = floor(value * scale + 0.5);
    *high = (uint32_t)(units / 4294967296.0);
    *low = (uint32_t)(units - *high * 4294967296.0);
}

static void set_feedback(struct feedback_gpu *feedback, double area, double root, double change)
{
    set_fixed(&feedback->area_low, &feedback->area_high, area, 65536);
    set_fixed(&feedback->root_low, &feedback->root_high, root, 1048576);
    set_fixed(&feedback->change_low, &feedback->change_high, change, 16777216);
}

static void set_errors(struct feedback_gpu *feedback, double u, double v)
{
    set_fixed(&feedback->error_u_low, &feedback->error_u_high, u, 0x1p30);
    set_fixed(&feedback->error_v_low, &feedback->error_v_high, v, 0x1p30);
}

static void run(struct task_buffers *b, const char *shader, uint32_t phase, uint32_t threads,
                struct pass_list extra[9])
{
    struct pass_list lists[13] = {
        {BINDING_FRAME, GPU_READ, &b->frame, sizeof b->frame},
        {BINDING_LIGHTS, GPU_READ, b->lights, sizeof b->lights},
        {BINDING_PASS, GPU_READ_WRITE, &b->counters, sizeof b->counters},
        {BINDING_PASS + 1, GPU_READ, b->mask, b->total * 4},
    };
    uint32_t count = 4;
    for (; extra[count - 4].data; count++)
        lists[count] = extra[count - 4];
    pass_device_run(device, &(struct pass_run){.shader = shader,
                                               .features = b->features,
                                               .density = b->rule,
                                               .phase = phase,
                                               .threads = threads,
                                               .lists = lists,
                                               .list_count = count});
}

static void run_update(struct task_buffers *b)
{
    static vec2 partials[2 * MOST_CELLS / GROUP_SIZE + 2];
    struct pass_list feedback = {BINDING_PASS + 2, GPU_READ, b->feedback, b->total * sizeof *b->feedback};
    run(b, "density_measure.comp", 0, b->total,
        (struct pass_list[9]){feedback,
                              {BINDING_PASS + 3, GPU_WRITE, partials, sizeof partials},
                              {BINDING_PASS + 4, GPU_WRITE, b->density, b->total * 4},
                              {BINDING_PASS + 5, GPU_READ, b->tree, b->total * 4},
                              {BINDING_PASS + 6, GPU_READ, b->columns, b->total * 4},
                              {BINDING_PASS + 7, GPU_READ_WRITE, b->aspect, b->total * 4},
                              {BINDING_PASS + 8, GPU_READ, b->costs, b->total * 4}});
    run(b, "density_scale.comp", 0, 1,
        (struct pass_list[9]){{BINDING_PASS + 2, GPU_READ, partials, sizeof partials}});
    pass_device_run(device, &(struct pass_run){
                                .shader = "density_update.comp",
                                .features = b->features,
                                .density = b->rule,
                                .threads = b->total,
                                PASS_LISTS({BINDING_FRAME, GPU_READ, &b->frame, sizeof b->frame},
                                           {BINDING_LIGHTS, GPU_READ, b->lights, sizeof b->lights},
                                           {BINDING_PASS, GPU_READ_WRITE, &b->counters, sizeof b->counters},
                                           {BINDING_PASS + 1, GPU_READ, b->mask, b->total * 4}, feedback,
                                           {BINDING_PASS + 3, GPU_READ, b->old_density, b->total * 4},
                                           {BINDING_PASS + 4, GPU_READ_WRITE, b->density, b->total * 4},
                                           {BINDING_PASS + 5, GPU_WRITE, b->variance, b->total * 4})});
}

static void run_budget(struct task_buffers *b)
{
    static vec2 partials[2 * MOST_CELLS / GROUP_SIZE + 2];
    run(b, "density_sum.comp", 0, b->total,
        (struct pass_list[9]){{BINDING_PASS + 2, GPU_READ, b->density, b->total * 4},
                              {BINDING_PASS + 3, GPU_WRITE, partials, sizeof partials}});
    run(b, "density_scale.comp", 1, 1,
        (struct pass_list[9]){{BINDING_PASS + 2, GPU_READ, partials, sizeof partials}});
    uint32_t level = 0;
    for (uint32_t count = b->total; count > 0; count /= 4, level++)
        pass_device_run(
            device, &(struct pass_run){
                        .shader = "quadtree.comp",
                        .features = b->features,
                        .density = b->rule,
                        .has_push = true,
                        .push = level,
                        .threads = count,
                        PASS_LISTS({BINDING_FRAME, GPU_READ, &b->frame, sizeof b->frame},
                                   {BINDING_LIGHTS, GPU_READ, b->lights, sizeof b->lights},
                                   {BINDING_PASS, GPU_READ_WRITE, &b->counters, sizeof b->counters},
                                   {BINDING_PASS + 1, GPU_READ, b->mask, b->total * 4},
                                   {BINDING_PASS + 2, GPU_READ_WRITE, b->density, b->total * 4},
                                   {BINDING_PASS + 3, GPU_READ_WRITE, b->tree, pass_tree_size(b->total) * 4},
                                   {BINDING_PASS + 4, GPU_READ_WRITE, b->columns, b->total * 4},
                                   {BINDING_PASS + 5, GPU_READ, b->aspect, b->total * 4})});
}

/* ---- the model ----------------------------------------------------------------------------------------- */

static double area_of(const struct feedback_gpu *f)
{
    return pass_fixed(f->area_low, f->area_high) / 65536;
}

static double root_of(const struct feedback_gpu *f)
{
    return pass_fixed(f->root_low, f->root_high) / 1048576;
}

/* The error rule: errors U and V of the cell in u and v, scaled from its k x m strata to one. It asks for the
 * root of (U V)^(1/4) over the root of the rays a photon costs; its aspect is log2 of sqrt(U / V). `last` is
 * the state before the update. */
static double model_wish(const struct task_buffers *last, uint32_t cell, double *aspect)
{
    const struct feedback_gpu *f = &last->feedback[cell];
    double k = last->columns[cell], m = last->tree[cell] / k;
    double u = pass_fixed(f->error_u_low, f->error_u_high) * 0x1p-30 * k * k;
    double v = pass_fixed(f->error_v_low, f->error_v_high) * 0x1p-30 * m * m;
    *aspect = (double)last->aspect[cell];
    if (!(u * v > 0))
        return 0;
    double w = (double)last->frame.temporal_weight, wanted = log2(sqrt(u / v));
    *aspect = (1 - w) * *aspect + w * fmax(-6, fmin(6, wanted));
    return sqrt(pow(u * v, 0.25) * sqrt(k * m / last->costs[cell]));
}

/* design 5: D' = (area or scaled root) / A_t + g v; w D' + (1 - w) of the neighbourhood's mean, in which
 * the cell counts as much as four neighbours; w is w_t, up to five times as much by how much the picture
 * changed. */
static double model_update(const struct task_buffers *b, const struct task_buffers *last, uint32_t cell)
{
    const struct frame_gpu *frame = &b->frame;
    uint32_t cells = frame->cells, tile = cell / (cells * cells) * cells * cells, x, y;
    if (!b->mask[cell])
        return 0;
    double suggested = area_of(&b->feedback[cell]);
    if (b->rule == DENSITY_SQRT_RULE) {
        double areas = 0, roots = 0;
        for (uint32_t i = 0; i < b->total; i++)
            if (b->mask[i]) {
                areas += area_of(&b->feedback[i]);
                roots += root_of(&b->feedback[i]);
            }
        suggested = roots > 0 ? root_of(&b->feedback[cell]) * areas / roots : 0;
    } else if (b->rule == DENSITY_ERROR_RULE) {
        double areas = 0, wishes = 0, aspect;
        for (uint32_t i = 0; i < b->total; i++)
            if (b->mask[i]) {
                areas += area_of(&b->feedback[i]);
                wishes += model_wish(last, i, &aspect);
            }
        areas = fmin(areas, frame->photon_budget * (double)frame->target_area);
        suggested = model_wish(last, cell, &aspect) * (wishes > 0 ? areas / wishes : 0);
        assert_close((double)b->aspect[cell], aspect, 1e-5);
    }
    suggested /= (double)frame->target_area;
    double change = pass_fixed(b->feedback[cell].change_low, b->feedback[cell].change_high) / 16777216;
    if (b->features & FEATURE_VARIANCE)
        suggested += (double)frame->variance_gain * change;
    pass_morton_place(cell - tile, &x, &y);
    double sum = 4 * (double)b->old_density[cell], weight = 4;
    const int moves[4][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}};
    for (int k = 0; k < 4; k++) {
        int64_t nx = (int64_t)x + moves[k][0], ny = (int64_t)y + moves[k][1];
        if (nx < 0 || ny < 0 || nx >= cells || ny >= cells)
            continue;
        uint32_t neighbour = tile + pass_morton((uint32_t)nx, (uint32_t)ny);
        if (b->mask[neighbour]) {
            sum += (double)b->old_density[neighbour];
            weight++;
        }
    }
    double w = (double)frame->temporal_weight;
    if (b->features & FEATURE_VARIANCE)
        w = fmin(w * (1 + 4 * change), 1);
    return fmax(w * suggested + (1 - w) * sum / weight, frame->min_samples);
}

static void fill_randomly(struct task_buffers *b)
{
    for (uint32_t i = 0; i < b->frame.light_count * b->frame.cells * b->frame.cells; i++) {
        b->mask[i] = uniform() < 0.7;
        b->old_density[i] = b->mask[i] ? (float)exp(6 * uniform()) : 0;
        double root = exp(3 * uniform()), change = uniform();
        if (b->mask[i] && uniform() < 0.8)
            set_feedback(&b->feedback[i], exp(5 * uniform()), root, change);
        if (b->rule == DENSITY_ERROR_RULE && b->mask[i] && uniform() < 0.8)
            set_errors(&b->feedback[i], exp(-9 * uniform()), exp(-9 * uniform()));
        else if (b->rule == DENSITY_ERROR_RULE)
            set_errors(&b->feedback[i], 0, 0);
        b->columns[i] = 1 + (uint32_t)(9 * uniform());
        b->tree[i] = b->columns[i] * (1 + (uint32_t)(9 * uniform()));
        b->aspect[i] = (float)(4 * uniform() - 2);
        b->costs[i] = 1 + (uint32_t)(900 * uniform());
    }
}

/* ---- tests --------------------------------------------------------------------------------------------- */

static void densities_follow_the_model(void **state)
{
    (void)state;
    static const uint32_t rules[] = {DENSITY_SQRT_RULE, DENSITY_AREA_RULE, DENSITY_ERROR_RULE};
    static const char *const names[] = {"sqrt", "area", "uniform", "error"};
    random_state = 3;
    for (uint32_t i = 0; i < 6; i++) {
        struct task_buffers *b = buffers_of(i < 3 ? 16 : 2, i < 3 ? 4 : 1, i < 3 ? 3 : 1);
        b->rule = rules[i % 3];
        b->frame.temporal_weight = i == 3 ? 1 : 0.3f;
        b->features = i == 4 ? 0 : FEATURE_VARIANCE;
        fill_randomly(b);
        b->mask[0] = 1;
        set_feedback(&b->feedback[0], 3, 2, 0.5);
        set_errors(&b->feedback[0], 0.1, 0.02);
        memset(b->density, 0xff, sizeof b->density);
        struct task_buffers *last = malloc(sizeof *last);
        assert_non_null(last);
        memcpy(last, b, sizeof *last);
        run_update(b);
        double worst = 0;
        for (uint32_t cell = 0; cell < b->total; cell++) {
            double expected = model_update(b, last, cell), found = (double)b->density[cell];
            assert_true(isfinite(found));
            if (!b->mask[cell])
                assert_true(found == 0 && b->variance[cell] == 0);
            else {
                worst = fmax(worst, fabs(found / expected - 1));
                double change =
                    pass_fixed(b->feedback[cell].change_low, b->feedback[cell].change_high) / 16777216;
                if (b->features & FEATURE_VARIANCE)
                    assert_close((double)b->variance[cell], change, 1e-6);
            }
        }
        print_message("%s, %u cells: worst %.1e\n", names[b->rule], b->total, worst);
        assert_in_bound(worst, 1e-5);
        assert_int_equal(b->counters.count[COUNT_GUARD_DENSITY], 0);
        free(last);
        free(b);
    }
}

/* design 5: every rule asks for as many photons in all as the area rule, the error rule for no more than
 * the budget. */
static void rules_ask_for_the_same_total(void **state)
{
    (void)state;
    static const uint32_t rules[] = {DENSITY_SQRT_RULE, DENSITY_AREA_RULE, DENSITY_ERROR_RULE};
    for (uint32_t k = 0; k < 3; k++) {
        random_state = 17;
        struct task_buffers *b = buffers_of(16, 1, 1);
        b->rule = rules[k];
        b->features = 0;
        b->frame.temporal_weight = 1;
        for (uint32_t i = 0; i < b->total; i++) {
            set_feedback(&b->feedback[i], 1 + 99 * uniform(), 1 + 9 * uniform(), 0);
            if (b->rule == DENSITY_ERROR_RULE)
                set_errors(&b->feedback[i], 0.01 + uniform(), 0.01 + uniform());
            b->columns[i] = b->tree[i] = b->costs[i] = 1;
        }
        run_update(b);
        double found = 0, areas = 0;
        for (uint32_t i = 0; i < b->total; i++) {
            found += (double)b->density[i];
            areas += area_of(&b->feedback[i]);
        }
        double expected = areas / (double)b->frame.target_area;
        if (b->rule == DENSITY_ERROR_RULE)
            expected = fmin(expected, b->frame.photon_budget);
        assert_close(found, expected, 1e-5 * expected);
        free(b);
    }
}

static void uniform_density_stays(void **state)
{
    (void)state;
    random_state = 5;
    struct task_buffers *b = buffers_of(16, 1, 1);
    b->rule = DENSITY_UNIFORM_RULE;
    fill_randomly(b);
    run_update(b);
    for (uint32_t i = 0; i < b->total; i++)
        assert_true(b->density[i] == b->old_density[i]);
    free(b);
}

/* design 5: no NaN, no infinity can enter a task buffer. */
static void poison_is_clamped(void **state)
{
    (void)state;
    static const float poisons[] = {NAN, INFINITY, -INFINITY, -1e30f, -5, 1e30f};
    for (uint32_t i = 0; i < sizeof poisons / sizeof *poisons; i++)
        for (uint32_t rule = 0; rule < 2; rule++) {
            random_state = 23 + i;
            struct task_buffers *b = buffers_of(8, 1, 1);
            b->rule = rule;
            fill_randomly(b);
            b->mask[20] = 1;
            b->old_density[20] = poisons[i];
            run_update(b);
            for (uint32_t cell = 0; cell < b->total; cell++)
                assert_true(b->mask[cell] ? b->density[cell] >= 1 && b->density[cell] <= 1048576
                                          : b->density[cell] == 0);
            if (poisons[i] > 1048576) /* what is below the minimum is raised to it, not counted */
                assert_true(b->counters.count[COUNT_GUARD_DENSITY] > 0);
            free(b);
        }
    /* sums as large as the accumulators hold, and a target area of next to nothing */
    struct task_buffers *b = buffers_of(8, 1, 1);
    b->frame.target_area = 1e-38f;
    memset(&b->feedback[3], 0xff, sizeof b->feedback[3]);
    run_update(b);
    for (uint32_t cell = 0; cell < b->total; cell++)
        assert_true(b->density[cell] >= 1 && b->density[cell] <= 1048576);
    assert_true(b->counters.count[COUNT_GUARD_DENSITY] > 0);
    free(b);
}

/* n = floor(sqrt D)^2 under the budget, with density=error k x m; every level the sum of the one below. */
static void check_tree(struct task_buffers *b, const float *wanted)
{
    double total = 0, largest = 0, least = b->frame.min_samples;
    uint32_t masked = 0;
    for (uint32_t i = 0; i < b->total; i++) {
        masked += b->mask[i];
        total += b->mask[i] ? (double)wanted[i] : 0;
        largest = fmax(largest, b->mask[i] ? (double)wanted[i] : 0);
    }
    double room = fmax(b->frame.photon_budget - masked * least, 0), wish = total - masked * least;
    double scale = wish > room ? room / wish : 1;
    assert_close((double)b->counters.density_total, total, 1e-5 * total);
    assert_close((double)b->counters.density_largest, largest, 1e-6 * largest);
    assert_close((double)b->counters.density_scale, scale, 1e-5 * scale);
    assert_int_equal(b->counters.count[COUNT_CELLS], masked);
    uint64_t photons = 0;
    for (uint32_t i = 0; i < b->total; i++) {
        double d = b->mask[i] ? least + ((double)wanted[i] - least) * scale : 0;
        assert_close((double)b->density[i], d, 2e-5 * d);
        /* a density within rounding of a square may go to either side of it */
        double low = floor(sqrt((double)b->density[i] * (1 - 1e-6))),
               high = floor(sqrt((double)b->density[i] * (1 + 1e-6)));
        if (b->mask[i] && b->rule == DENSITY_ERROR_RULE) {
            double k = b->columns[i], m = b->tree[i] / k, most = fmax((double)b->density[i], 1);
            double wanted_k = sqrt((double)b->density[i] * exp2((double)b->aspect[i]));
            assert_true(k >= 1 && m >= 1 && m == floor(m) && k * m <= most * (1 + 1e-6));
            assert_close(k, fmin(fmax(wanted_k, 1), floor(most)), 0.5 + 1e-4 * k);
            assert_true(k * (m + 1) > most * (1 - 1e-6)); /* no row more would fit */
        } else
            assert_true(b->tree[i] == low * low || b->tree[i] == high * high);
        assert_true(!b->mask[i] || b->tree[i] >= 1);
        photons += b->tree[i];
    }
    uint32_t *expected = calloc(pass_tree_size(b->total), sizeof *expected);
    assert_non_null(expected);
    memcpy(expected, b->tree, b->total * sizeof *expected);
    pass_tree_fill(expected, b->total);
    assert_memory_equal(expected, b->tree, pass_tree_size(b->total) * sizeof *expected);
    free(expected);
    print_message("budget %u, %u of %u cells masked: %llu photons wished %.0f\n", b->frame.photon_budget,
                  masked, b->total, (unsigned long long)photons, total);
    assert_true(photons <= b->frame.photon_budget);
    assert_int_equal(b->counters.task_count, photons);
    assert_int_equal(b->counters.count[COUNT_EMITTED], photons);
    assert_int_equal(b->counters.queue[QUEUE_COUNT], photons);
    assert_int_equal(b->counters.queue[0], (photons + GROUP_SIZE - 1) / GROUP_SIZE);
}

/* Tasks 0 to n - 1 are every sample of every cell, once: beams say where on the tile they started. */
static void check_tasks(struct task_buffers *b)
{
    uint32_t cells = b->frame.cells, count = b->counters.task_count;
    for (uint32_t i = 0; i < b->frame.light_count; i++)
        b->lights[i] = (struct light_gpu){.type = LIGHT_TYPE_DIRECTIONAL,
                                          .map = TILE_RECT,
                                          .direction = {0, 0, 1, 0},
                                          .intensity = {1, 1, 1, 3},
                                          .tile_x = {1, 0, 0, 0.5f},
                                          .tile_y = {0, 1, 0, 0.5f},
                                          .tile_origin = {0.5f, 0.5f, (float)i, 1}};
    struct photon_ray *rays = calloc(count, sizeof *rays);
    uint32_t *queue = calloc(count, sizeof *queue), *starts = calloc(b->total + 1, sizeof *starts);
    uint8_t *seen = calloc(count, 1);
    assert_true(rays && queue && starts && seen);
    for (uint32_t i = 0; i < b->total; i++)
        starts[i + 1] = starts[i] + b->tree[i];
    pass_device_run(
        device,
        &(struct pass_run){.shader = "photon_emit.comp",
                           .features = FEATURE_DIRECTIONAL,
                           .density = b->rule,
                           .threads = count,
                           PASS_LISTS({BINDING_FRAME, GPU_READ, &b->frame, sizeof b->frame},
                                      {BINDING_LIGHTS, GPU_READ, b->lights, sizeof b->lights},
                                      {BINDING_PASS, GPU_READ_WRITE, &b->counters, sizeof b->counters},
                                      {BINDING_PASS + 1, GPU_READ, b->tree, pass_tree_size(b->total) * 4},
                                      {BINDING_PASS + 2, GPU_WRITE, rays, count * sizeof *rays},
                                      {BINDING_PASS + 3, GPU_WRITE, queue, count * 4},
                                      {BINDING_PASS + 5, GPU_READ, b->columns, b->total * 4})});
    for (uint32_t i = 0; i < count; i++) {
        uint32_t cell = rays[i].cell, x, y;
        assert_true(cell < b->total && b->tree[cell] > 0);
        assert_int_equal((uint32_t)rays[i].origin.z, cell / (cells * cells));
        pass_morton_place(cell % (cells * cells), &x, &y);
        uint32_t k = b->columns[cell], m = b->tree[cell] / k;
        assert_int_equal(k * m, b->tree[cell]);
        double column = ((double)rays[i].origin.x * cells - x) * k,
               row = ((double)rays[i].origin.y * cells - y) * m;
        assert_close(column - floor(column), 0.5, 0.01);
        assert_close(row - floor(row), 0.5, 0.01);
        assert_true(column > 0 && row > 0 && column < k && row < m);
        uint32_t task = starts[cell] + (uint32_t)row * k + (uint32_t)column;
        assert_int_equal(seen[task], 0);
        seen[task] = 1;
    }
    free(rays);
    free(queue);
    free(starts);
    free(seen);
}

static void the_budget_holds_and_tasks_cover_it(void **state)
{
    (void)state;
    static const struct {
        uint32_t cells, slots, lights, budget, min_samples;
        double spread;
    } cases[] = {{1, 1, 1, 1, 1, 10},      {1, 4, 2, 2, 1, 3},      {8, 1, 1, 100, 1, 8},
                 {4, 4, 3, 100, 1, 12},    {16, 1, 1, 1024, 4, 10}, {64, 4, 3, 131072, 1, 8},
                 {32, 4, 4, 131072, 9, 6}, {64, 1, 1, 131072, 1, 1}};
    random_state = 99;
    enum { CASES = sizeof cases / sizeof *cases };
    for (uint32_t n = 0; n < 2 * CASES; n++) {
        uint32_t i = n % CASES;
        struct task_buffers *b = buffers_of(cases[i].cells, cases[i].slots, cases[i].lights);
        b->rule = n < CASES ? DENSITY_SQRT_RULE : DENSITY_ERROR_RULE;
        b->frame.photon_budget = cases[i].budget;
        b->frame.min_samples = cases[i].min_samples;
        for (uint32_t cell = 0; cell < b->total; cell++) {
            b->mask[cell] = b->mask[cell] && (b->total < 8 || uniform() < 0.6);
            b->aspect[cell] = (float)(8 * uniform() - 4);
            b->density[cell] =
                b->mask[cell] ? (float)(cases[i].min_samples * exp(cases[i].spread * uniform())) : 0;
        }
        float *wanted = calloc(b->total, sizeof *wanted);
        assert_non_null(wanted);
        memcpy(wanted, b->density, b->total * sizeof *wanted);
        run_budget(b);
        check_tree(b, wanted);
        check_tasks(b);
        free(wanted);
        free(b);
    }
}

/* Equal densities that come to a square each: the budget is met to the photon or missed by a whole row, never
 * passed. */
static void equal_squares_do_not_pass_the_budget(void **state)
{
    (void)state;
    for (uint32_t side = 2; side < 9; side++) {
        struct task_buffers *b = buffers_of(32, 1, 1);
        b->frame.photon_budget = side * side * b->total;
        for (uint32_t i = 0; i < b->total; i++)
            b->density[i] = 777.7f;
        run_budget(b);
        assert_true(b->counters.task_count <= b->frame.photon_budget);
        assert_true(b->counters.task_count >= (side - 1) * (side - 1) * b->total);
        free(b);
    }
}

/* ---- remap --------------------------------------------------------------------------------------------- */

static void run_seed(struct task_buffers *b)
{
    run(b, "density_seed.comp", 0, b->total,
        (struct pass_list[9]){{BINDING_PASS + 2, GPU_READ, b->old_density, b->total * 4},
                              {BINDING_PASS + 3, GPU_WRITE, b->density, b->total * 4}});
}

static void set_old(struct light_gpu *light, const struct light_gpu *old)
{
    light->old_x = old->tile_x;
    light->old_y = old->tile_y;
    light->old_z = old->tile_z;
    light->old_origin = old->tile_origin;
    light->old_map = old->map;
    light->has_previous = light->changed = 1;
}

static struct light_gpu tile_of(uint32_t map, struct vector axis, double half_angle)
{
    struct light_gpu light = {.type = map == TILE_RECT ? LIGHT_TYPE_DIRECTIONAL : LIGHT_TYPE_POINT,
                              .map = map};
    tile_set_frame(&light, axis);
    double height = 2 * pow(sin(0.5 * half_angle), 2);
    light.tile_z.w = (float)height;
    light.tile_origin.w = (float)(map == TILE_CAP ? 2 * PI * height : 4 * PI);
    if (map == TILE_RECT) {
        light.tile_x.w = (float)half_angle;
        light.tile_y.w = (float)(0.5 * half_angle);
        light.tile_origin = (vec4){(float)(0.3 * half_angle), 0.2f, 1, (float)(2 * half_angle * half_angle)};
    }
    return light;
}

/* Where the middle of a new cell lies on the old tile; false outside it. */
static bool old_place(const struct light_gpu *light, const struct light_gpu *old, double u, double v,
                      double *old_u, double *old_v)
{
    if (light->map == TILE_RECT) {
        struct vector p = tile_to_world(light, (struct vector){(2 * u - 1) * (double)light->tile_x.w,
                                                               (2 * v - 1) * (double)light->tile_y.w, 0});
        struct vector from = vector_of(light->tile_origin), to = vector_of(old->tile_origin);
        p = tile_to_local(old,
                          (struct vector){p.x + from.x - to.x, p.y + from.y - to.y, p.z + from.z - to.z});
        *old_u = 0.5 * (p.x / (double)old->tile_x.w + 1);
        *old_v = 0.5 * (p.y / (double)old->tile_y.w + 1);
        return *old_u >= 0 && *old_v >= 0 && *old_u < 1 && *old_v < 1;
    }
    struct vector d = tile_to_local(old, tile_direction(light, u, v));
    if (old->map == TILE_SPHERE)
        octahedron_place(d, old_u, old_v);
    else if (1 - d.z <= (double)old->tile_z.w)
        cap_place(d, (double)old->tile_z.w, old_u, old_v);
    else
        return false;
    return true;
}

/* The density per solid angle at a direction is the same before and after: D goes with the tiles' measures.
 */
static void moved_tiles_keep_their_density(void **state)
{
    (void)state;
    const struct vector axis = {0.2, -0.9, 0.3}, turned = {0.35, -0.8, 0.2};
    const struct {
        const char *name;
        struct light_gpu light, old;
    } cases[] = {
        {"cap to wider cap", tile_of(TILE_CAP, turned, 0.6), tile_of(TILE_CAP, axis, 0.4)},
        {"cap to narrower cap", tile_of(TILE_CAP, turned, 0.2), tile_of(TILE_CAP, axis, 0.7)},
        {"sphere to cap", tile_of(TILE_CAP, turned, 1.3), tile_of(TILE_SPHERE, axis, PI)},
        {"cap to sphere", tile_of(TILE_SPHERE, turned, PI), tile_of(TILE_CAP, axis, 1.8)},
        {"sphere to turned sphere", tile_of(TILE_SPHERE, turned, PI), tile_of(TILE_SPHERE, axis, PI)},
        {"rectangle to wider one", tile_of(TILE_RECT, turned, 2), tile_of(TILE_RECT, turned, 1.5)},
    };
    enum { CELLS = 32 };
    random_state = 41;
    for (uint32_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct task_buffers *b =
            buffers_of(CELLS, 4, 2); /* the second light's tile moves, the first one's stays */
        b->lights[0] = tile_of(TILE_CAP, axis, 1);
        b->lights[0].has_previous = 1;
        b->lights[1] = cases[i].light;
        set_old(&b->lights[1], &cases[i].old);
        for (uint32_t cell = 0; cell < 2 * CELLS * CELLS; cell++) {
            b->old_density[cell] = (float)(2 + 50 * uniform());
            b->mask[cell] = uniform() < 0.8;
        }
        run_seed(b);
        double ratio = (double)cases[i].light.tile_origin.w / (double)cases[i].old.tile_origin.w;
        uint32_t found = 0, outside = 0, border = 0;
        for (uint32_t cell = 0; cell < b->total; cell++) {
            double d = (double)b->density[cell];
            if (!b->mask[cell]) {
                assert_true(d == 0);
                continue;
            }
            if (cell < CELLS * CELLS) {
                assert_true(d == (double)b->old_density[cell]);
                continue;
            }
            uint32_t x, y;
            pass_morton_place(cell % (CELLS * CELLS), &x, &y);
            double u = 0, v = 0;
            bool is_inside =
                old_place(&cases[i].light, &cases[i].old, (x + 0.5) / CELLS, (y + 0.5) / CELLS, &u, &v);
            double edge_u = fabs(u * CELLS - floor(u * CELLS + 0.5)),
                   edge_v = fabs(v * CELLS - floor(v * CELLS + 0.5));
            if (is_inside && fmin(edge_u, edge_v) < 1e-3) {
                border++; /* rounding decides which neighbour it is */
                continue;
            }
            double expected = b->frame.min_samples;
            if (is_inside) {
                uint32_t old_cell = CELLS * CELLS + pass_morton((uint32_t)(u * CELLS), (uint32_t)(v * CELLS));
                expected = fmax(expected, (double)b->old_density[old_cell] * ratio);
            }
            found += is_inside;
            outside += !is_inside;
            assert_close(d, expected, 1e-5 * expected);
        }
        print_message("%s: %u cells kept their density, %u are new, %u on borders\n", cases[i].name, found,
                      outside, border);
        assert_true(found > 200 && border < 40);
        free(b);
    }
    /* without a past, flat at what the budget's scale turns into the budget */
    struct task_buffers *b = buffers_of(8, 1, 1);
    b->lights[0] = tile_of(TILE_CAP, axis, 1);
    run_seed(b);
    for (uint32_t i = 0; i < b->total; i++)
        assert_true(b->density[i] == (float)b->frame.photon_budget);
    run_budget(b);
    assert_int_equal(b->counters.task_count, b->total * 2025); /* 45^2 of 2048 */
    free(b);
}

/* At rest a cell keeps its samples, whatever is reported. Without the flag the same turn
 * takes some from cells and gives some to others. */
static void at_rest_samples_stay(void **state)
{
    (void)state;
    random_state = 41;
    struct task_buffers *b = buffers_of(16, 1, 1);
    static uint32_t before[MOST_CELLS], freely[MOST_CELLS], columns[MOST_CELLS];
    fill_randomly(b);
    run_update(b);
    run_budget(b);
    memcpy(before, b->tree, sizeof before);
    memcpy(columns, b->columns, sizeof columns);
    memcpy(b->old_density, b->density, sizeof b->old_density);
    for (uint32_t i = 0; i < b->total; i++)
        if (b->mask[i])
            set_feedback(&b->feedback[i], exp(5 * uniform()), exp(3 * uniform()), 0);
    run_update(b);
    run_budget(b);
    memcpy(freely, b->tree, sizeof freely);
    b->frame.flags = FLAG_HOLD;
    memcpy(b->tree, before, sizeof before);
    memcpy(b->columns, columns, sizeof columns);
    run_update(b);
    run_budget(b);
    uint32_t fallen = 0, gained = 0;
    for (uint32_t i = 0; i < b->total; i++) {
        assert_int_equal(b->tree[i], before[i]);
        fallen += freely[i] < before[i];
        gained += freely[i] > before[i];
    }
    assert_true(fallen > 20 && gained > 20);
    free(b);
}

/* While a view settles, a cell keeps its k x m strata if these are at least half of what it may have (d, what
 * the passes leave as its density), at most a quarter more where the budget has it, and with the error rule k
 * / m is less than a factor of two off. What isn't kept is what it would be without the flag. */
static void settling_samples_stay_where_they_serve(void **state)
{
    (void)state;
    const struct {
        uint32_t rule;
        double budget; /* over what cells ask for */
        const char *name;
    } cases[] = {{DENSITY_SQRT_RULE, 4, "sqrt, room"},
                 {DENSITY_ERROR_RULE, 4, "error, room"},
                 {DENSITY_ERROR_RULE, 1.1, "error, room for a tenth more"},
                 {DENSITY_ERROR_RULE, 0.8, "error, no room"}};
    random_state = 43;
    for (uint32_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct task_buffers *b = buffers_of(16, 1, 1);
        static uint32_t before[MOST_CELLS], columns[MOST_CELLS], freely[MOST_CELLS], free_columns[MOST_CELLS];
        static float wanted[MOST_CELLS];
        memset(wanted, 0, sizeof wanted);
        b->rule = cases[i].rule;
        fill_randomly(b);
        double total = 0;
        for (uint32_t cell = 0; cell < b->total; cell++) {
            double n = b->tree[cell], k = b->columns[cell];
            if (b->mask[cell]) {
                wanted[cell] = (float)fmax(1, n * exp2(2.5 * uniform() - 1));
                b->aspect[cell] = (float)(log2(k * k / n) + 3 * uniform() - 1.5);
            }
            total += (double)wanted[cell];
        }
        b->frame.photon_budget = (uint32_t)(cases[i].budget * total);
        memcpy(before, b->tree, sizeof before);
        memcpy(columns, b->columns, sizeof columns);
        memcpy(b->density, wanted, sizeof wanted);
        run_budget(b);
        memcpy(freely, b->tree, sizeof freely);
        memcpy(free_columns, b->columns, sizeof free_columns);
        memcpy(b->tree, before, sizeof before);
        memcpy(b->columns, columns, sizeof columns);
        memcpy(b->density, wanted, sizeof wanted);
        b->frame.flags = FLAG_SETTLE;
        run_budget(b);
        double most = fmin(1.25, b->frame.photon_budget / total);
        uint32_t kept = 0, released = 0, sum = 0;
        for (uint32_t cell = 0; cell < b->total; cell++) {
            sum += b->tree[cell];
            if (!b->mask[cell]) {
                assert_int_equal(b->tree[cell], 0);
                continue;
            }
            double d = (double)b->density[cell], n = before[cell], k = columns[cell];
            double off = fabs(log2(k * k / n) - (double)b->aspect[cell]);
            if (b->rule != DENSITY_ERROR_RULE)
                off = 0;
            double missing = fmin(d / 3, 2 * sqrt(n));
            bool is_kept = d - n <= missing && n <= fmax(most, 1) * d && off < 1;
            if (fabs(n - fmax(most, 1) * d) < 1e-4 * d || fabs(off - 1) < 1e-4 ||
                fabs(d - n - missing) < 1e-4 * d)
                continue; /* rounding decides */
            assert_int_equal(b->tree[cell], is_kept ? before[cell] : freely[cell]);
            assert_int_equal(b->columns[cell], is_kept ? columns[cell] : free_columns[cell]);
            kept += is_kept;
            released += !is_kept;
        }
        print_message("%s: %u cells keep their strata, %u don't; %u samples of %u\n", cases[i].name, kept,
                      released, sum, b->frame.photon_budget);
        assert_true(kept > 10 && released > 10);
        assert_true(sum <= b->frame.photon_budget);
        assert_int_equal(sum, b->counters.task_count);
        free(b);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(at_rest_samples_stay),
        cmocka_unit_test(settling_samples_stay_where_they_serve),
        cmocka_unit_test(densities_follow_the_model),
        cmocka_unit_test(rules_ask_for_the_same_total),
        cmocka_unit_test(uniform_density_stays),
        cmocka_unit_test(poison_is_clamped),
        cmocka_unit_test(the_budget_holds_and_tasks_cover_it),
        cmocka_unit_test(equal_squares_do_not_pass_the_budget),
        cmocka_unit_test(moved_tiles_keep_their_density),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
