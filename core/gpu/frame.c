/* frame.c: the ring of frames, and what is recorded into one.
 *
 * A record call never fails by itself: the first error is kept in the frame, later calls do nothing, and
 * gpu_frame_submit reports it. A frame that was begun and not submitted leaves the hazard tracker believing
 * in commands that never ran; the next frame then starts with a full barrier.
 */
#include "gpu_internal.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SETS_PER_POOL       64u
#define STAGING_BLOCK_BYTES ((size_t)1 << 20)
#define STAGING_ALIGNMENT   16u

/* ---- errors ------------------------------------------------------------------------------------------- */

bool frame_is_recording(const struct gpu_frame *frame)
{
    return frame->state == FRAME_RECORDING && !frame->has_error;
}

void frame_fail(struct gpu_frame *frame, enum status status, const char *format, ...)
{
    if (frame->has_error) {
        return;
    }
    frame->has_error = true;
    frame->error.status = status;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(frame->error.message, sizeof frame->error.message, format, arguments);
    va_end(arguments);
}

static void frame_fail_with(struct gpu_frame *frame, const struct error *error)
{
    frame_fail(frame, error->status, "%s", error->message);
}

bool frame_check_range(struct gpu_frame *frame, const struct gpu_buffer *buffer, size_t offset, size_t size,
                       const char *what)
{
    if (!buffer) {
        frame_fail(frame, STATUS_INVALID, "%s has no buffer", what);
        return false;
    }
    if (offset > buffer->size || size > buffer->size - offset) {
        frame_fail(frame, STATUS_INVALID, "%s: %zu bytes at %zu pass the end of buffer '%s' (%zu bytes)",
                   what, size, offset, buffer->name, buffer->size);
        return false;
    }
    return true;
}

/* ---- life of a frame ---------------------------------------------------------------------------------- */

bool frame_init(struct gpu_frame *frame, struct gpu *gpu, struct error *error)
{
    frame->gpu = gpu;
    const VkCommandPoolCreateInfo pool = {
        .sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO,
        .flags = VK_COMMAND_POOL_CREATE_TRANSIENT_BIT,
        .queueFamilyIndex = gpu->queue_family,
    };
    const VkFenceCreateInfo fence = {.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO};
    VkResult result = gpu->vk.vkCreateCommandPool(gpu->device, &pool, NULL, &frame->command_pool);
    if (result == VK_SUCCESS) {
        const VkCommandBufferAllocateInfo commands = {
            .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
            .commandPool = frame->command_pool,
            .level = VK_COMMAND_BUFFER_LEVEL_PRIMARY,
            .commandBufferCount = 1,
        };
        result = gpu->vk.vkAllocateCommandBuffers(gpu->device, &commands, &frame->commands);
    }
    if (result == VK_SUCCESS) {
        result = gpu->vk.vkCreateFence(gpu->device, &fence, NULL, &frame->fence);
    }
    return result == VK_SUCCESS || gpu_fail(gpu, error, result, "cannot create a frame on", gpu->info.name);
}

void frame_finish(struct gpu_frame *frame)
{
    struct gpu *gpu = frame->gpu;
    if (!gpu) {
        return;
    }
    for (uint32_t i = 0; i < frame->staging_count; i++) {
        gpu_buffer_destroy(&frame->staging[i].buffer);
    }
    for (uint32_t i = 0; i < frame->descriptor_pool_count; i++) {
        gpu->vk.vkDestroyDescriptorPool(gpu->device, frame->descriptor_pools[i], NULL);
    }
    for (uint32_t i = 0; i < frame->query_pool_count; i++) {
        gpu->vk.vkDestroyQueryPool(gpu->device, frame->query_pools[i], NULL);
    }
    gpu->vk.vkDestroyFence(gpu->device, frame->fence, NULL);
    gpu->vk.vkDestroyCommandPool(gpu->device, frame->command_pool, NULL);
    free(frame->staging);
    free(frame->descriptor_pools);
    free(frame->query_pools);
    free(frame->spans);
    free(frame->timings);
}

/* Keeps one staging block, big enough for what the last frame needed. */
static void recycle_staging(struct gpu_frame *frame)
{
    if (frame->staging_count > 1) {
        size_t total = 0;
        for (uint32_t i = 0; i < frame->staging_count; i++) {
            total += frame->staging[i].buffer->size;
            gpu_buffer_destroy(&frame->staging[i].buffer);
        }
        frame->staging_count = 0;
        const struct gpu_buffer_params params = {
            .name = "staging",
            .size = total < frame->gpu->info.max_storage_bytes ? total
                                                               : (size_t)frame->gpu->info.max_storage_bytes,
            .memory = GPU_MEMORY_UPLOAD,
        };
        /* Without this block the next upload allocates its own, and reports a failure then. */
        struct error error;
        frame->staging[0].buffer = gpu_buffer_create(frame->gpu, &params, &error);
        frame->staging_count = frame->staging[0].buffer ? 1 : 0;
    }
    if (frame->staging_count > 0) {
        frame->staging[0].used = 0;
    }
}

struct gpu_frame *gpu_frame_begin(struct gpu *gpu, struct error *error)
{
    for (uint32_t i = 0; i < FRAME_RING; i++) {
        if (gpu->frames[i].state == FRAME_RECORDING) {
            gpu->frames[i].state = FRAME_FAILED;
            gpu->needs_full_barrier = true;
        }
    }
    if (gpu->is_lost) {
        gpu_fail(gpu, error, VK_ERROR_DEVICE_LOST, "cannot begin a frame on", gpu->info.name);
        return NULL;
    }
    struct gpu_frame *frame = &gpu->frames[gpu->frame_serial % FRAME_RING];
    VkResult result = VK_SUCCESS;
    if (frame->state == FRAME_SUBMITTED) {
        result = fence_wait(gpu, frame->fence);
    }
    if (result == VK_SUCCESS) {
        frame->state = FRAME_IDLE;
        result = gpu->vk.vkResetCommandPool(gpu->device, frame->command_pool, 0);
    }
    for (uint32_t i = 0; i < frame->descriptor_pool_count && result == VK_SUCCESS; i++) {
        result = gpu->vk.vkResetDescriptorPool(gpu->device, frame->descriptor_pools[i], 0);
    }
    if (result == VK_SUCCESS) {
        const VkCommandBufferBeginInfo begin = {
            .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO,
            .flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT,
        };
        result = gpu->vk.vkBeginCommandBuffer(frame->commands, &begin);
    }
    if (result != VK_SUCCESS) {
        gpu_fail(gpu, error, result, "cannot begin a frame on", gpu->info.name);
        return NULL;
    }
    recycle_staging(frame);
    frame->descriptor_pool_used = 0;
    frame->span_count = 0;
    frame->timing_count = 0;
    frame->total_ns = 0;
    frame->readback_sources = 0;
    frame->has_error = false;
    frame->serial = ++gpu->frame_serial;
    frame->state = FRAME_RECORDING;
    for (uint32_t i = 0; i < frame->query_pool_count; i++) {
        gpu->vk.vkCmdResetQueryPool(frame->commands, frame->query_pools[i], 0, SPANS_PER_POOL * 2);
    }
    if (gpu->needs_full_barrier) {
        tracker_full_barrier(gpu, frame->commands);
        gpu->needs_full_barrier = false;
    }
    return frame;
}

bool gpu_frame_submit(struct gpu_frame *frame, struct error *error)
{
    struct gpu *gpu = frame->gpu;
    if (frame->state != FRAME_RECORDING) {
        return error_set(error, STATUS_INVALID, "the frame is not being recorded, so it cannot be submitted");
    }
    if (frame->span_count && !frame->spans[frame->span_count - 1].is_closed) {
        frame_fail(frame, STATUS_INVALID, "pass '%s' was not ended before its frame",
                   frame->spans[frame->span_count - 1].name);
    }
    frame->state = FRAME_FAILED;
    gpu->needs_full_barrier = true;
    if (frame->has_error) {
        *error = frame->error;
        return false;
    }
    host_barrier(gpu, frame->commands, frame->readback_sources);
    VkResult result = gpu->vk.vkEndCommandBuffer(frame->commands);
    const VkCommandBufferSubmitInfo commands = {
        .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_SUBMIT_INFO,
        .commandBuffer = frame->commands,
    };
    const VkSubmitInfo2 submit = {
        .sType = VK_STRUCTURE_TYPE_SUBMIT_INFO_2,
        .commandBufferInfoCount = 1,
        .pCommandBufferInfos = &commands,
    };
    if (result == VK_SUCCESS) {
        result = gpu->vk.vkResetFences(gpu->device, 1, &frame->fence);
    }
    if (result == VK_SUCCESS) {
        result = gpu->vk.vkQueueSubmit2(gpu->queue, 1, &submit, frame->fence);
    }
    if (result != VK_SUCCESS) {
        return gpu_fail(gpu, error, result, "cannot submit a frame to", gpu->info.name);
    }
    gpu->needs_full_barrier = false;
    frame->state = FRAME_SUBMITTED;
    return true;
}

static bool read_timings(struct gpu_frame *frame)
{
    struct gpu *gpu = frame->gpu;
    free(frame->timings);
    frame->timings = calloc(frame->span_count ? frame->span_count : 1, sizeof *frame->timings);
    if (!frame->timings) {
        return false;
    }
    const uint64_t mask = gpu->timestamp_bits >= 64 ? UINT64_MAX : ((uint64_t)1 << gpu->timestamp_bits) - 1;
    uint64_t first = 0, last = 0;
    for (uint32_t i = 0; i < frame->span_count; i++) {
        uint64_t ticks[2] = {0, 0};
        if (gpu->timestamp_bits &&
            gpu->vk.vkGetQueryPoolResults(gpu->device, frame->query_pools[i / SPANS_PER_POOL],
                                          i % SPANS_PER_POOL * 2, 2, sizeof ticks, ticks, sizeof *ticks,
                                          VK_QUERY_RESULT_64_BIT) != VK_SUCCESS) {
            ticks[0] = ticks[1] = last;
        }
        first = i == 0 ? ticks[0] : first;
        last = ticks[1];
        uint32_t entry = 0;
        while (entry < frame->timing_count && strcmp(frame->timings[entry].name, frame->spans[i].name) != 0) {
            entry++;
        }
        if (entry == frame->timing_count) {
            frame->timings[frame->timing_count++].name = frame->spans[i].name;
        }
        frame->timings[entry].elapsed_ns +=
            (uint64_t)((double)((ticks[1] - ticks[0]) & mask) * gpu->info.timestamp_period_ns);
    }
    frame->total_ns = (uint64_t)((double)((last - first) & mask) * gpu->info.timestamp_period_ns);
    return true;
}

bool gpu_frame_wait(struct gpu_frame *frame, struct error *error)
{
    struct gpu *gpu = frame->gpu;
    if (frame->state == FRAME_DONE) {
        return true;
    }
    if (frame->state != FRAME_SUBMITTED) {
        return error_set(error, STATUS_INVALID, "the frame was not submitted, so it cannot be waited for");
    }
    const VkResult result = fence_wait(gpu, frame->fence);
    if (result != VK_SUCCESS) {
        return gpu_fail(gpu, error, result, "a frame failed on", gpu->info.name);
    }
    frame->state = FRAME_DONE;
    return read_timings(frame) || error_set(error, STATUS_MEMORY, "out of host memory for the pass times");
}

const struct gpu_timing *gpu_frame_timings(struct gpu_frame *frame, uint32_t *count, uint64_t *total_ns)
{
    *count = frame->state == FRAME_DONE ? frame->timing_count : 0;
    *total_ns = frame->state == FRAME_DONE ? frame->total_ns : 0;
    return frame->timings;
}

void frames_release(struct gpu *gpu, uint64_t serial, const char *name)
{
    for (uint32_t i = 0; i < FRAME_RING && serial > 0; i++) {
        struct gpu_frame *frame = &gpu->frames[i];
        if (frame->serial > serial) {
            continue;
        }
        if (frame->state == FRAME_SUBMITTED) {
            fence_wait(gpu, frame->fence);
        } else if (frame->state == FRAME_RECORDING && frame->serial == serial) {
            frame_fail(frame, STATUS_INVALID,
                       "'%s' was destroyed while a frame that uses it was being recorded", name);
        }
    }
}

void frames_wait_all(struct gpu *gpu)
{
    for (uint32_t i = 0; i < FRAME_RING; i++) {
        if (gpu->frames[i].state == FRAME_SUBMITTED) {
            fence_wait(gpu, gpu->frames[i].fence);
        }
    }
}

/* ---- passes ------------------------------------------------------------------------------------------- */

static void write_timestamp(struct gpu_frame *frame, uint32_t span, uint32_t end)
{
    /* Both ends wait for all earlier commands: passes then never overlap and their times add up. */
    if (frame->gpu->timestamp_bits) {
        frame->gpu->vk.vkCmdWriteTimestamp2(frame->commands, VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT,
                                            frame->query_pools[span / SPANS_PER_POOL],
                                            span % SPANS_PER_POOL * 2 + end);
    }
}

/* False after frame_fail. */
static bool grow_query_pools(struct gpu_frame *frame)
{
    struct gpu *gpu = frame->gpu;
    struct error error;
    const VkQueryPoolCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO,
        .queryType = VK_QUERY_TYPE_TIMESTAMP,
        .queryCount = SPANS_PER_POOL * 2,
    };
    VkQueryPool *pools = realloc(frame->query_pools, (frame->query_pool_count + 1) * sizeof *pools);
    if (!pools) {
        frame_fail(frame, STATUS_MEMORY, "out of host memory for pass timers");
        return false;
    }
    frame->query_pools = pools;
    const VkResult result =
        gpu->vk.vkCreateQueryPool(gpu->device, &info, NULL, &pools[frame->query_pool_count]);
    if (result != VK_SUCCESS) {
        gpu_fail(gpu, &error, result, "cannot create pass timers on", gpu->info.name);
        frame_fail_with(frame, &error);
        return false;
    }
    gpu->vk.vkCmdResetQueryPool(frame->commands, pools[frame->query_pool_count], 0, SPANS_PER_POOL * 2);
    frame->query_pool_count++;
    return true;
}

/* Room for one more span, and for its timer. False after frame_fail. */
static bool grow_spans(struct gpu_frame *frame)
{
    const uint32_t span = frame->span_count;
    if (span == frame->span_capacity) {
        const uint32_t capacity = span + SPANS_PER_POOL;
        struct span *spans = realloc(frame->spans, capacity * sizeof *spans);
        if (!spans) {
            frame_fail(frame, STATUS_MEMORY, "out of host memory for pass timers");
            return false;
        }
        frame->spans = spans;
        frame->span_capacity = capacity;
    }
    return !frame->gpu->timestamp_bits || span / SPANS_PER_POOL < frame->query_pool_count ||
           grow_query_pools(frame);
}

void gpu_pass_begin(struct gpu_frame *frame, const char *name)
{
    struct gpu *gpu = frame->gpu;
    if (!frame_is_recording(frame)) {
        return;
    }
    const uint32_t span = frame->span_count;
    if (span > 0 && !frame->spans[span - 1].is_closed) {
        frame_fail(frame, STATUS_INVALID, "pass '%s' begins inside pass '%s'", name,
                   frame->spans[span - 1].name);
        return;
    }
    if (!grow_spans(frame)) {
        return;
    }
    frame->spans[span] = (struct span){.name = name};
    frame->span_count++;
    if (gpu->has_debug_utils) {
        const VkDebugUtilsLabelEXT label = {.sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_LABEL_EXT,
                                            .pLabelName = name};
        vkCmdBeginDebugUtilsLabelEXT(frame->commands, &label);
    }
    write_timestamp(frame, span, 0);
}

void gpu_pass_end(struct gpu_frame *frame)
{
    if (!frame_is_recording(frame)) {
        return;
    }
    if (frame->span_count == 0 || frame->spans[frame->span_count - 1].is_closed) {
        frame_fail(frame, STATUS_INVALID, "a pass ends that was not begun");
        return;
    }
    frame->spans[frame->span_count - 1].is_closed = true;
    write_timestamp(frame, frame->span_count - 1, 1);
    if (frame->gpu->has_debug_utils) {
        vkCmdEndDebugUtilsLabelEXT(frame->commands);
    }
}

/* ---- binding ------------------------------------------------------------------------------------------ */

/* False after frame_fail. */
static bool add_descriptor_pool(struct gpu_frame *frame)
{
    struct gpu *gpu = frame->gpu;
    struct error error;
    const VkDescriptorPoolSize sizes[] = {
        {VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, SETS_PER_POOL * MAX_BINDINGS},
        {VK_DESCRIPTOR_TYPE_ACCELERATION_STRUCTURE_KHR, SETS_PER_POOL},
    };
    const VkDescriptorPoolCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO,
        .maxSets = SETS_PER_POOL,
        .poolSizeCount = gpu->info.has_ray_query ? 2 : 1,
        .pPoolSizes = sizes,
    };
    VkDescriptorPool *pools =
        realloc(frame->descriptor_pools, (frame->descriptor_pool_count + 1) * sizeof *pools);
    if (!pools) {
        frame_fail(frame, STATUS_MEMORY, "out of host memory for descriptors");
        return false;
    }
    frame->descriptor_pools = pools;
    const VkResult result =
        gpu->vk.vkCreateDescriptorPool(gpu->device, &info, NULL, &pools[frame->descriptor_pool_count]);
    if (result != VK_SUCCESS) {
        gpu_fail(gpu, &error, result, "cannot create descriptors on", gpu->info.name);
        frame_fail_with(frame, &error);
        return false;
    }
    frame->descriptor_pool_count++;
    return true;
}

static VkDescriptorSet allocate_set(struct gpu_frame *frame, const struct program *program)
{
    struct gpu *gpu = frame->gpu;
    for (;;) {
        if (frame->descriptor_pool_used == frame->descriptor_pool_count && !add_descriptor_pool(frame)) {
            return VK_NULL_HANDLE;
        }
        const VkDescriptorSetAllocateInfo info = {
            .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO,
            .descriptorPool = frame->descriptor_pools[frame->descriptor_pool_used],
            .descriptorSetCount = 1,
            .pSetLayouts = &program->set_layout,
        };
        VkDescriptorSet set = VK_NULL_HANDLE;
        const VkResult result = gpu->vk.vkAllocateDescriptorSets(gpu->device, &info, &set);
        if (result == VK_SUCCESS) {
            return set;
        }
        if (result != VK_ERROR_OUT_OF_POOL_MEMORY && result != VK_ERROR_FRAGMENTED_POOL) {
            struct error error;
            gpu_fail(gpu, &error, result, "cannot allocate descriptors for", program->name);
            frame_fail_with(frame, &error);
            return VK_NULL_HANDLE;
        }
        frame->descriptor_pool_used++;
    }
}

static bool is_compute(const struct program *program)
{
    return program->stages == VK_SHADER_STAGE_COMPUTE_BIT;
}

/* The bind of `binding`; NULL after frame_fail. */
static const struct gpu_bind *find_bind(struct gpu_frame *frame, const struct program *program,
                                        const struct gpu_bind *binds, uint32_t bind_count, uint32_t binding)
{
    const struct gpu_bind *found = NULL;
    for (uint32_t i = 0; i < bind_count; i++) {
        if (binds[i].binding == binding) {
            if (found) {
                frame_fail(frame, STATUS_INVALID, "'%s' binds %u twice", program->name, binding);
                return NULL;
            }
            found = &binds[i];
        }
    }
    const bool wants_accel = program->accel_mask & 1u << binding;
    if (!found || (wants_accel ? !found->accel : !found->buffer)) {
        frame_fail(frame, STATUS_INVALID, "'%s' needs %s at binding %u", program->name,
                   wants_accel ? "an acceleration structure" : "a buffer", binding);
        return NULL;
    }
    if (wants_accel && !found->accel->instances) {
        frame_fail(frame, STATUS_INVALID, "'%s' needs a top-level acceleration structure at binding %u",
                   program->name, binding);
        return NULL;
    }
    if (!wants_accel && (found->access < GPU_READ || found->access > GPU_READ_WRITE)) {
        frame_fail(frame, STATUS_INVALID, "'%s' declares no access for binding %u", program->name, binding);
        return NULL;
    }
    return found;
}

bool frame_bind(struct gpu_frame *frame, struct program *program, const struct gpu_bind *binds,
                uint32_t bind_count, const void *push, struct hazards *hazards)
{
    struct gpu *gpu = frame->gpu;
    VkWriteDescriptorSet writes[MAX_BINDINGS];
    VkDescriptorBufferInfo buffers[MAX_BINDINGS];
    VkWriteDescriptorSetAccelerationStructureKHR accels[MAX_BINDINGS];
    uint32_t count = 0;
    if (program->push_bytes && !push) {
        frame_fail(frame, STATUS_INVALID, "'%s' was given no push constants", program->name);
        return false;
    }
    for (uint32_t binding = 0; binding < MAX_BINDINGS; binding++) {
        if (!(program->binding_mask & 1u << binding)) {
            continue;
        }
        const struct gpu_bind *bind = find_bind(frame, program, binds, bind_count, binding);
        if (!bind) {
            return false;
        }
        writes[count] = (VkWriteDescriptorSet){
            .sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET,
            .dstBinding = binding,
            .descriptorCount = 1,
        };
        if (program->accel_mask & 1u << binding) {
            accels[count] = (VkWriteDescriptorSetAccelerationStructureKHR){
                .sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET_ACCELERATION_STRUCTURE_KHR,
                .accelerationStructureCount = 1,
                .pAccelerationStructures = &bind->accel->handle,
            };
            writes[count].pNext = &accels[count];
            writes[count].descriptorType = VK_DESCRIPTOR_TYPE_ACCELERATION_STRUCTURE_KHR;
            tracker_require(&gpu->tracker, hazards, &bind->accel->backing->history, USAGE_COMPUTE_TRACE);
        } else {
            buffers[count] = (VkDescriptorBufferInfo){.buffer = bind->buffer->handle,
                                                      .range = (bind->buffer->size + 3) / 4 * 4};
            writes[count].pBufferInfo = &buffers[count];
            writes[count].descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
            if (bind->access & GPU_READ) {
                tracker_require(&gpu->tracker, hazards, &bind->buffer->history,
                                is_compute(program) ? USAGE_COMPUTE_READ : USAGE_DRAW_READ);
            }
            if (bind->access & GPU_WRITE) {
                tracker_require(&gpu->tracker, hazards, &bind->buffer->history,
                                is_compute(program) ? USAGE_COMPUTE_WRITE : USAGE_DRAW_WRITE);
            }
        }
        count++;
    }
    const VkDescriptorSet set = count ? allocate_set(frame, program) : VK_NULL_HANDLE;
    if (count && !set) {
        return false;
    }
    for (uint32_t i = 0; i < count; i++) {
        writes[i].dstSet = set;
    }
    const VkPipelineBindPoint point =
        is_compute(program) ? VK_PIPELINE_BIND_POINT_COMPUTE : VK_PIPELINE_BIND_POINT_GRAPHICS;
    tracker_resolve(gpu, frame->commands, hazards);
    gpu->vk.vkCmdBindPipeline(frame->commands, point, program->handle);
    if (count) {
        gpu->vk.vkUpdateDescriptorSets(gpu->device, count, writes, 0, NULL);
        gpu->vk.vkCmdBindDescriptorSets(frame->commands, point, program->layout, 0, 1, &set, 0, NULL);
    }
    if (program->push_bytes) {
        gpu->vk.vkCmdPushConstants(frame->commands, program->layout, program->stages, 0, program->push_bytes,
                                   push);
    }
    return true;
}

void frame_mark(struct gpu_frame *frame, struct gpu_buffer *buffer, enum usage usage)
{
    tracker_mark(frame, &buffer->history, usage);
    if (buffer->memory == GPU_MEMORY_READBACK &&
        (usage == USAGE_COMPUTE_WRITE || usage == USAGE_DRAW_WRITE || usage == USAGE_COPY_WRITE)) {
        frame->readback_sources |= 1u << usage;
    }
}

void frame_mark_binds(struct gpu_frame *frame, struct program *program, const struct gpu_bind *binds,
                      uint32_t bind_count)
{
    program->serial = frame->serial;
    for (uint32_t i = 0; i < bind_count; i++) {
        if (binds[i].binding >= MAX_BINDINGS || !(program->binding_mask & 1u << binds[i].binding)) {
            continue;
        }
        if (program->accel_mask & 1u << binds[i].binding) {
            frame_mark(frame, binds[i].accel->backing, USAGE_COMPUTE_TRACE);
            continue;
        }
        if (binds[i].access & GPU_READ) {
            frame_mark(frame, binds[i].buffer, is_compute(program) ? USAGE_COMPUTE_READ : USAGE_DRAW_READ);
        }
        if (binds[i].access & GPU_WRITE) {
            frame_mark(frame, binds[i].buffer, is_compute(program) ? USAGE_COMPUTE_WRITE : USAGE_DRAW_WRITE);
        }
    }
}

/* ---- commands ----------------------------------------------------------------------------------------- */

void gpu_record_dispatch(struct gpu_frame *frame, const struct gpu_dispatch *dispatch)
{
    struct gpu *gpu = frame->gpu;
    if (!frame_is_recording(frame)) {
        return;
    }
    struct program *program = &dispatch->pipeline->program;
    struct hazards hazards = {0};
    uint32_t groups[3];
    tracker_next_command(&gpu->tracker);
    for (uint32_t i = 0; i < 3; i++) {
        groups[i] = dispatch->groups[i] ? dispatch->groups[i] : 1;
        if (!dispatch->indirect && groups[i] > gpu->limits.maxComputeWorkGroupCount[i]) {
            frame_fail(frame, STATUS_LIMIT, "'%s' dispatches %u groups; %s allows %u", program->name,
                       groups[i], gpu->info.name, gpu->limits.maxComputeWorkGroupCount[i]);
            return;
        }
    }
    if (dispatch->indirect) {
        if (dispatch->indirect_offset % 4 != 0) {
            frame_fail(frame, STATUS_INVALID, "'%s': the indirect offset %zu is not a multiple of 4",
                       program->name, dispatch->indirect_offset);
            return;
        }
        if (!frame_check_range(frame, dispatch->indirect, dispatch->indirect_offset,
                               sizeof(VkDispatchIndirectCommand), program->name)) {
            return;
        }
        tracker_require(&gpu->tracker, &hazards, &dispatch->indirect->history, USAGE_INDIRECT);
    }
    if (!frame_bind(frame, program, dispatch->binds, dispatch->bind_count, dispatch->push, &hazards)) {
        return;
    }
    if (dispatch->indirect) {
        gpu->vk.vkCmdDispatchIndirect(frame->commands, dispatch->indirect->handle, dispatch->indirect_offset);
        frame_mark(frame, dispatch->indirect, USAGE_INDIRECT);
    } else {
        gpu->vk.vkCmdDispatch(frame->commands, groups[0], groups[1], groups[2]);
    }
    frame_mark_binds(frame, program, dispatch->binds, dispatch->bind_count);
}

void frame_begin_transfer(struct gpu_frame *frame, struct gpu_buffer *target, struct gpu_buffer *source)
{
    struct gpu *gpu = frame->gpu;
    struct hazards hazards = {0};
    tracker_next_command(&gpu->tracker);
    tracker_require(&gpu->tracker, &hazards, &target->history, USAGE_COPY_WRITE);
    if (source) {
        tracker_require(&gpu->tracker, &hazards, &source->history, USAGE_COPY_READ);
    }
    tracker_resolve(gpu, frame->commands, &hazards);
    frame_mark(frame, target, USAGE_COPY_WRITE);
    if (source) {
        frame_mark(frame, source, USAGE_COPY_READ);
    }
}

void gpu_record_fill(struct gpu_frame *frame, struct gpu_buffer *buffer, size_t offset, size_t size,
                     uint32_t value)
{
    if (!frame_is_recording(frame) || !frame_check_range(frame, buffer, offset, size, "a fill") ||
        size == 0) {
        return;
    }
    if (offset + size == buffer->size) {
        size = (size + 3) / 4 * 4;
    }
    if (offset % 4 != 0 || size % 4 != 0) {
        frame_fail(frame, STATUS_INVALID,
                   "a fill of buffer '%s': offset %zu and size %zu are not multiples of 4", buffer->name,
                   offset, size);
        return;
    }
    frame_begin_transfer(frame, buffer, NULL);
    frame->gpu->vk.vkCmdFillBuffer(frame->commands, buffer->handle, offset, size, value);
}

void gpu_record_copy(struct gpu_frame *frame, struct gpu_buffer *target, size_t target_offset,
                     struct gpu_buffer *source, size_t source_offset, size_t size)
{
    if (!frame_is_recording(frame) ||
        !frame_check_range(frame, target, target_offset, size, "a copy's target") ||
        !frame_check_range(frame, source, source_offset, size, "a copy's source") || size == 0) {
        return;
    }
    if (target == source && target_offset < source_offset + size && source_offset < target_offset + size) {
        frame_fail(frame, STATUS_INVALID, "a copy within buffer '%s' overlaps itself", target->name);
        return;
    }
    frame_begin_transfer(frame, target, source);
    const VkBufferCopy region = {.srcOffset = source_offset, .dstOffset = target_offset, .size = size};
    frame->gpu->vk.vkCmdCopyBuffer(frame->commands, source->handle, target->handle, 1, &region);
}

void *frame_stage(struct gpu_frame *frame, size_t size, struct gpu_buffer **buffer, size_t *offset)
{
    struct staging_block *block = frame->staging_count ? &frame->staging[frame->staging_count - 1] : NULL;
    size_t start = block ? (block->used + STAGING_ALIGNMENT - 1) / STAGING_ALIGNMENT * STAGING_ALIGNMENT : 0;
    if (!block || start > block->buffer->size || size > block->buffer->size - start) {
        struct staging_block *blocks = realloc(frame->staging, (frame->staging_count + 1) * sizeof *blocks);
        if (!blocks) {
            frame_fail(frame, STATUS_MEMORY, "out of host memory for an upload of %zu bytes", size);
            return NULL;
        }
        frame->staging = blocks;
        const struct gpu_buffer_params params = {
            .name = "staging",
            .size = size > STAGING_BLOCK_BYTES ? size : STAGING_BLOCK_BYTES,
            .memory = GPU_MEMORY_UPLOAD,
        };
        struct error error;
        block = &blocks[frame->staging_count];
        *block = (struct staging_block){.buffer = gpu_buffer_create(frame->gpu, &params, &error)};
        if (!block->buffer) {
            frame_fail_with(frame, &error);
            return NULL;
        }
        frame->staging_count++;
        start = 0;
    }
    block->used = start + size;
    *buffer = block->buffer;
    *offset = start;
    return (uint8_t *)block->buffer->mapped + start;
}

void gpu_record_upload(struct gpu_frame *frame, struct gpu_buffer *target, size_t offset, const void *data,
                       size_t size)
{
    struct gpu_buffer *staging;
    size_t staging_offset;
    if (!frame_is_recording(frame) || !frame_check_range(frame, target, offset, size, "an upload") ||
        size == 0) {
        return;
    }
    void *bytes = frame_stage(frame, size, &staging, &staging_offset);
    if (!bytes) {
        return;
    }
    memcpy(bytes, data, size);
    frame_begin_transfer(frame, target, NULL);
    const VkBufferCopy region = {.srcOffset = staging_offset, .dstOffset = offset, .size = size};
    frame->gpu->vk.vkCmdCopyBuffer(frame->commands, staging->handle, target->handle, 1, &region);
}
