#include "pass_device.h"

#include <stdlib.h>
#include <string.h>

#include "shaders/shader_table.h"
#include "tests/support/check.h"

enum { PIPELINES = 64, LISTS = 24, CONSTANTS = 6 };

struct pipeline {
    const char *shader;
    uint32_t values[CONSTANTS], mask;
    struct gpu_pipeline *pipeline;
};

struct pass_device {
    struct gpu *gpu;
    struct pipeline pipelines[PIPELINES];
    uint32_t pipeline_count;
};

static void check(bool done, const char *what, const struct error *error)
{
    if (!done)
        fail_msg("%s: %s", what, error->message);
}

struct pass_device *pass_device_create(void)
{
    struct error error;
    struct pass_device *device = calloc(1, sizeof *device);
    assert_non_null(device);
    device->gpu = gpu_create(&(struct gpu_params){0}, &error);
    check(device->gpu != NULL, "device", &error);
    return device;
}

void pass_device_destroy(struct pass_device **device)
{
    struct pass_device *d = *device;
    if (!d)
        return;
    for (uint32_t i = 0; i < d->pipeline_count; i++)
        gpu_pipeline_destroy(&d->pipelines[i].pipeline);
    gpu_destroy(&d->gpu);
    free(d);
    *device = NULL;
}

struct pass_device *pass_shared;

int pass_shared_set_up(void **state)
{
    (void)state;
    pass_shared = pass_device_create();
    return 0;
}

int pass_shared_tear_down(void **state)
{
    (void)state;
    pass_device_destroy(&pass_shared);
    return 0;
}

static struct gpu_pipeline *find_pipeline(struct pass_device *device, const struct pass_run *run)
{
    static const uint32_t ids[CONSTANTS] = {CONSTANT_FEATURES, CONSTANT_SPLIT, CONSTANT_DENSITY,
                                            CONSTANT_AA,       CONSTANT_DEPTH, 8};
    struct pipeline wanted = {
        .shader = run->shader,
        .values = {run->features, run->split, run->density, run->aa, run->depth, run->phase}};
    for (uint32_t i = 0; i < run->list_count; i++)
        wanted.mask |= 1u << run->lists[i].binding;
    for (uint32_t i = 0; i < device->pipeline_count; i++) {
        const struct pipeline *made = &device->pipelines[i];
        if (strcmp(made->shader, wanted.shader) == 0 && made->mask == wanted.mask &&
            memcmp(made->values, wanted.values, sizeof wanted.values) == 0)
            return made->pipeline;
    }
    assert_true(device->pipeline_count < PIPELINES);
    struct error error;
    struct gpu_constant constants[CONSTANTS];
    for (uint32_t i = 0; i < CONSTANTS; i++)
        constants[i] = (struct gpu_constant){ids[i], wanted.values[i]};
    struct gpu_pipeline_params params = {.name = run->shader,
                                         .constants = constants,
                                         .constant_count = CONSTANTS,
                                         .binding_mask = wanted.mask,
                                         .push_bytes = run->has_push ? 4 : 0};
    params.spirv = shader_find(run->shader, &params.spirv_bytes);
    if (!params.spirv)
        fail_msg("there is no shader %s", run->shader);
    wanted.pipeline = gpu_pipeline_create(device->gpu, &params, &error);
    check(wanted.pipeline != NULL, run->shader, &error);
    device->pipelines[device->pipeline_count++] = wanted;
    return wanted.pipeline;
}

/* The lists on the device; what is written gets a buffer to be read back from. */
struct lists {
    const struct pass_list *lists;
    uint32_t count, mask;
    struct gpu_buffer *buffers[LISTS], *readbacks[LISTS];
    struct gpu_bind binds[LISTS];
};

static void upload_lists(struct pass_device *device, struct lists *on, const struct pass_list *lists,
                         uint32_t count)
{
    struct error error;
    *on = (struct lists){.lists = lists, .count = count};
    assert_true(count <= LISTS);
    for (uint32_t i = 0; i < count; i++) {
        const struct pass_list *list = &lists[i];
        on->buffers[i] = gpu_buffer_create_filled(device->gpu, "list", list->data, list->size, false, &error);
        check(on->buffers[i] != NULL, "list", &error);
        if ((list->access & GPU_WRITE) && list->size > 0) {
            on->readbacks[i] =
                gpu_buffer_create(device->gpu,
                                  &(struct gpu_buffer_params){
                                      .name = "readback", .size = list->size, .memory = GPU_MEMORY_READBACK},
                                  &error);
            check(on->readbacks[i] != NULL, "readback", &error);
        }
        on->mask |= 1u << list->binding;
        on->binds[i] =
            (struct gpu_bind){.binding = list->binding, .access = list->access, .buffer = on->buffers[i]};
    }
}

static void finish_lists(struct lists *on, struct gpu_frame *frame)
{
    struct error error;
    for (uint32_t i = 0; i < on->count; i++)
        if (on->readbacks[i])
            gpu_record_copy(frame, on->readbacks[i], 0, on->buffers[i], 0, on->lists[i].size);
    check(gpu_frame_submit(frame, &error) && gpu_frame_wait(frame, &error), "frame", &error);
    for (uint32_t i = 0; i < on->count; i++) {
        if (on->readbacks[i])
            memcpy(on->lists[i].data, gpu_buffer_map(on->readbacks[i]), on->lists[i].size);
        gpu_buffer_destroy(&on->readbacks[i]);
        gpu_buffer_destroy(&on->buffers[i]);
    }
}

void pass_device_run(struct pass_device *device, const struct pass_run *run)
{
    struct error error;
    struct gpu_pipeline *pipeline = find_pipeline(device, run);
    struct lists on;
    upload_lists(device, &on, run->lists, run->list_count);
    struct gpu_frame *frame = gpu_frame_begin(device->gpu, &error);
    check(frame != NULL, run->shader, &error);
    gpu_record_dispatch(frame,
                        &(struct gpu_dispatch){.pipeline = pipeline,
                                               .binds = on.binds,
                                               .bind_count = on.count,
                                               .push = run->has_push ? &run->push : NULL,
                                               .groups = {(run->threads + GROUP_SIZE - 1) / GROUP_SIZE}});
    finish_lists(&on, frame);
}

uint32_t pass_device_samples(const struct pass_device *device)
{
    return gpu_info(device->gpu)->max_samples;
}

void pass_device_draw(struct pass_device *device, const struct pass_draw *draw)
{
    struct error error;
    struct lists on;
    upload_lists(device, &on, draw->lists, draw->list_count);
    const struct gpu_constant constants[] = {{CONSTANT_AA, draw->aa}, {CONSTANT_DEPTH, draw->depth}};
    struct gpu_raster_params params = {.name = draw->vertex_shader,
                                       .constants = constants,
                                       .constant_count = 2,
                                       .binding_mask = on.mask,
                                       .width = draw->width,
                                       .height = draw->height,
                                       .samples = draw->samples,
                                       .per_sample = draw->per_sample,
                                       .writes_buffers = true};
    params.vertex_spirv = shader_find(draw->vertex_shader, &params.vertex_bytes);
    params.fragment_spirv = shader_find(draw->fragment_shader, &params.fragment_bytes);
    struct gpu_raster *raster = gpu_raster_create(device->gpu, &params, &error);
    check(raster != NULL, draw->vertex_shader, &error);
    size_t size = sizeof(vec4) * draw->width * draw->height;
    struct gpu_buffer *picture = gpu_buffer_create(
        device->gpu,
        &(struct gpu_buffer_params){.name = "picture", .size = size, .memory = GPU_MEMORY_READBACK}, &error);
    check(picture != NULL, "picture", &error);
    struct gpu_frame *frame = gpu_frame_begin(device->gpu, &error);
    check(frame != NULL, draw->vertex_shader, &error);
    gpu_record_draw(frame, &(struct gpu_draw){.raster = raster,
                                              .binds = on.binds,
                                              .bind_count = on.count,
                                              .vertex_count = draw->vertices,
                                              .instance_count = 1});
    gpu_record_raster_read(frame, raster, picture);
    finish_lists(&on, frame);
    memcpy(draw->picture, gpu_buffer_map(picture), size);
    gpu_buffer_destroy(&picture);
    gpu_raster_destroy(&raster);
}

double pass_random(uint64_t *state)
{
    *state = *state * 6364136223846793005u + 1442695040888963407u;
    return (double)(*state >> 11) * 0x1p-53;
}

double pass_between(uint64_t *state, double low, double high)
{
    return low + (high - low) * pass_random(state);
}

uint32_t pass_pack_normal(const double n[3])
{
    double sum = fabs(n[0]) + fabs(n[1]) + fabs(n[2]), x = n[0] / sum, y = n[1] / sum;
    if (n[2] < 0) { /* the lower half is folded over the diagonals */
        double across = x;
        x = copysign(1 - fabs(y), x);
        y = copysign(1 - fabs(across), y);
    }
    return ((uint32_t)lround(x * 32767) & 0xffff) | (uint32_t)lround(y * 32767) << 16;
}

void pass_unpack_normal(uint32_t bits, double n[3])
{
    double x = fmax((int16_t)(bits & 0xffff) / 32767.0, -1), y = fmax((int16_t)(bits >> 16) / 32767.0, -1);
    n[2] = 1 - fabs(x) - fabs(y);
    n[0] = n[2] < 0 ? copysign(1 - fabs(y), x) : x;
    n[1] = n[2] < 0 ? copysign(1 - fabs(x), y) : y;
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int k = 0; k < 3; k++)
        n[k] /= length;
}

float pass_bits_float(uint32_t bits)
{
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

uint32_t pass_float_bits(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

uint32_t pass_morton(uint32_t x, uint32_t y)
{
    uint32_t code = 0;
    for (uint32_t bit = 0; bit < 16; bit++)
        code |= (x >> bit & 1u) << (2 * bit) | (y >> bit & 1u) << (2 * bit + 1);
    return code;
}

void pass_morton_place(uint32_t code, uint32_t *x, uint32_t *y)
{
    *x = *y = 0;
    for (uint32_t bit = 0; bit < 16; bit++) {
        *x |= (code >> (2 * bit) & 1u) << bit;
        *y |= (code >> (2 * bit + 1) & 1u) << bit;
    }
}

uint32_t pass_tree_size(uint32_t cells)
{
    uint32_t size = 0;
    for (; cells > 0; cells /= 4)
        size += cells;
    return size;
}

void pass_tree_fill(uint32_t *tree, uint32_t cells)
{
    for (uint32_t *below = tree; cells > 1; cells /= 4) {
        uint32_t *here = below + cells;
        for (uint32_t i = 0; i < cells / 4; i++)
            here[i] = below[4 * i] + below[4 * i + 1] + below[4 * i + 2] + below[4 * i + 3];
        below = here;
    }
}
