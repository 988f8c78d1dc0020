/* result.c: from what the device read back to a frame's result: statistics, pass times, channels. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "view_state.h"

static double fixed_value(const struct counters_gpu *counters, int fate, double unit)
{
    return ((double)counters->flux_high[fate] * 4294967296.0 + (double)counters->flux_low[fate]) * unit;
}

void result_add_counters(struct view *view, double weight)
{
    static const struct {
        enum stat_id stat;
        int count;
    } counts[] = {
        {STAT_photons_emitted, COUNT_EMITTED},
        {STAT_rays_traced, COUNT_RAYS},
        {STAT_rays_hit, COUNT_HITS},
        {STAT_photons_split, COUNT_SPLIT},
        {STAT_photons_stored, COUNT_STORED},
        {STAT_photons_splatted, COUNT_SPLATTED},
        {STAT_photons_contributing, COUNT_CONTRIBUTING},
        {STAT_culled_visibility, COUNT_CULLED_VISIBILITY},
        {STAT_culled_solid_angle, COUNT_CULLED_SOLID_ANGLE},
        {STAT_culled_energy, COUNT_CULLED_ENERGY},
        {STAT_kernel_evaluations, COUNT_KERNEL},
        {STAT_kernel_pixels, COUNT_KERNEL_INSIDE},
        {STAT_footprints_limited, COUNT_LIMITED},
        {STAT_guard_density, COUNT_GUARD_DENSITY},
        {STAT_guard_differential, COUNT_GUARD_DIFFERENTIAL},
        {STAT_guard_footprint, COUNT_GUARD_FOOTPRINT},
        {STAT_guard_traversal, COUNT_GUARD_TRAVERSAL},
        {STAT_guard_overflow, COUNT_GUARD_OVERFLOW},
        {STAT_guard_split, COUNT_GUARD_SPLIT},
    };
    static const enum stat_id fluxes[FATE_COUNT] = {STAT_flux_emitted,
                                                    STAT_flux_splatted,
                                                    STAT_flux_culled_visibility,
                                                    STAT_flux_culled_solid_angle,
                                                    STAT_flux_culled_energy,
                                                    STAT_flux_direct,
                                                    STAT_flux_absorbed,
                                                    STAT_flux_escaped,
                                                    STAT_flux_bounce_limit,
                                                    STAT_flux_split_once,
                                                    STAT_flux_thinned,
                                                    STAT_flux_thinned,
                                                    STAT_flux_buffer};
    const struct counters_gpu *counters = gpu_buffer_map(view->buffers[BUFFER_READBACK_COUNTERS]);
    double *stats = view->result.stats;
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
        stats[counts[i].stat] += counters->count[counts[i].count];
    for (int i = 0; i < FATE_COUNT; i++)
        stats[fluxes[i]] += fixed_value(counters, i, (double)view->data.flux_unit) *
                            (i == FATE_THINNED_IN ? -weight : weight);
    stats[STAT_tiles] = view->part_count;
    stats[STAT_cells_masked] = counters->count[COUNT_CELLS];
    stats[STAT_density_total] = (double)counters->density_total;
    stats[STAT_density_largest] = (double)counters->density_largest;
}

void result_add_timings(struct view *view, struct gpu_frame *frame)
{
    uint32_t count;
    uint64_t total;
    const struct gpu_timing *timings = gpu_frame_timings(frame, &count, &total);
    struct frame_result *result = &view->result;
    for (uint32_t i = 0; i < count; i++) {
        uint32_t p = 0;
        while (p < result->pass_count && strcmp(result->passes[p].name, timings[i].name) != 0)
            p++;
        if (p == result->pass_count) {
            if (p == VIEW_MAX_PASSES)
                continue;
            result->passes[result->pass_count++] = (struct frame_pass){timings[i].name, 0};
        }
        result->passes[p].elapsed_ns += timings[i].elapsed_ns;
    }
    result->stats[STAT_gpu_ns] += (double)total;
}

static bool grow(float **values, size_t *size, size_t count, struct error *error)
{
    if (*size >= count)
        return true;
    float *grown = realloc(*values, count * sizeof **values);
    if (!grown)
        return error_set(error, STATUS_MEMORY, "out of memory for a frame of %zu values", count);
    *values = grown;
    *size = count;
    return true;
}

/* Tiles of the atlas side by side, cells in rows instead of along the Morton curve. */
static void unroll_atlas(const struct view *view, const float *cells, float *image, uint32_t columns,
                         uint32_t rows)
{
    uint32_t side = view->cells, width = columns * side;
    memset(image, 0, (size_t)width * rows * side * sizeof *image);
    for (uint32_t part = 0; part < view->part_count; part++)
        for (uint32_t i = 0; i < side * side; i++) {
            uint32_t x = 0, y = 0;
            for (uint32_t bit = 0; bit < 16; bit++) {
                x |= ((i >> (2 * bit)) & 1) << bit;
                y |= ((i >> (2 * bit + 1)) & 1) << bit;
            }
            x += part % columns * side;
            y += part / columns * side;
            image[(size_t)y * width + x] = cells[(size_t)part * side * side + i];
        }
}

bool result_collect_channels(struct view *view, struct error *error)
{
    struct frame_result *result = &view->result;
    size_t pixels = (size_t)view->width * view->height;
    result->channel_count = 0;
    const float *values = view->plan.has_output ? gpu_buffer_map(view->buffers[BUFFER_READBACK]) : NULL;
    if (!values && (view->channel_mask & ((1u << CHANNEL_DENSITY) - 1))) {
        size_t before = view->host_size;
        if (!grow(&view->host_values, &view->host_size, pixels * 3 + pixels, error))
            return false;
        if (before != view->host_size || result->frame == 0) {
            memset(view->host_values, 0, view->host_size * sizeof(float));
            for (size_t i = 0; i < pixels; i++)
                view->host_values[3 * pixels + i] = INFINITY;
        }
    }
    uint32_t columns = 1;
    while (columns * columns < view->part_count)
        columns *= 2;
    uint32_t rows = columns;
    while (rows > 1 && (rows / 2) * columns >= view->part_count)
        rows /= 2;
    uint32_t side = view->plan.has_photons ? view->cells : 1;
    size_t cells = (size_t)columns * rows * side * side;
    if (view->channel_mask >> CHANNEL_DENSITY &&
        !grow(&view->atlas_values, &view->atlas_size, 2 * cells, error))
        return false;
    for (uint32_t i = 0; i < CHANNEL_COUNT; i++) {
        if (!(view->channel_mask & (1u << i)))
            continue;
        struct frame_channel *channel = &result->channels[result->channel_count++];
        *channel = (struct frame_channel){(enum channel)i, view->width, view->height,
                                          channel_infos[i].components, NULL};
        if (i < CHANNEL_DENSITY) {
            channel->values = values ? values : view->host_values + (i == CHANNEL_DEPTH ? 3 * pixels : 0);
            if (values)
                values += pixels * channel->components;
            continue;
        }
        float *image = view->atlas_values + (i == CHANNEL_VARIANCE ? cells : 0);
        channel->width = columns * side;
        channel->height = rows * side;
        channel->values = image;
        if (!view->plan.has_photons || (i == CHANNEL_VARIANCE && !view->plan.has_variance)) {
            memset(image, 0, cells * sizeof *image);
            continue;
        }
        const float *atlas = (const float *)((const char *)gpu_buffer_map(view->buffers[BUFFER_READBACK]) +
                                             view->asked[BUFFER_OUTPUT]);
        size_t stored = (size_t)view->tile_slots * view->cells * view->cells;
        unroll_atlas(view, atlas + (i == CHANNEL_VARIANCE ? stored : 0), image, columns, rows);
    }
    return true;
}
