/* barrier.c: which barrier a command needs.
 *
 * Every command has a number, every resource remembers the number of its last access of each kind. Two
 * accesses conflict when one of them writes. A barrier orders all earlier commands, not only those of one
 * resource, so what it ordered is noted per pair of kinds, and an access that an earlier barrier covers needs
 * none of its own. Submission order on the one queue makes this hold across frames too.
 */
#include "gpu_internal.h"

#include <string.h>

static const struct {
    VkPipelineStageFlags2 stages;
    VkAccessFlags2 access;
    bool writes;
} usages[USAGE_COUNT] = {
    [USAGE_COMPUTE_READ] = {VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_STORAGE_READ_BIT,
                            false},
    [USAGE_COMPUTE_WRITE] = {VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_STORAGE_WRITE_BIT,
                             true},
    [USAGE_COMPUTE_TRACE] = {VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT,
                             VK_ACCESS_2_ACCELERATION_STRUCTURE_READ_BIT_KHR, false},
    [USAGE_DRAW_READ] = {VK_PIPELINE_STAGE_2_VERTEX_SHADER_BIT | VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT,
                         VK_ACCESS_2_SHADER_STORAGE_READ_BIT, false},
    [USAGE_DRAW_WRITE] = {VK_PIPELINE_STAGE_2_VERTEX_SHADER_BIT | VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT,
                          VK_ACCESS_2_SHADER_STORAGE_WRITE_BIT, true},
    [USAGE_INDIRECT] = {VK_PIPELINE_STAGE_2_DRAW_INDIRECT_BIT, VK_ACCESS_2_INDIRECT_COMMAND_READ_BIT, false},
    [USAGE_COPY_READ] = {VK_PIPELINE_STAGE_2_ALL_TRANSFER_BIT, VK_ACCESS_2_TRANSFER_READ_BIT, false},
    [USAGE_COPY_WRITE] = {VK_PIPELINE_STAGE_2_ALL_TRANSFER_BIT, VK_ACCESS_2_TRANSFER_WRITE_BIT, true},
    [USAGE_BUILD_READ] = {VK_PIPELINE_STAGE_2_ACCELERATION_STRUCTURE_BUILD_BIT_KHR,
                          VK_ACCESS_2_ACCELERATION_STRUCTURE_READ_BIT_KHR | VK_ACCESS_2_SHADER_READ_BIT,
                          false},
    [USAGE_BUILD_WRITE] = {VK_PIPELINE_STAGE_2_ACCELERATION_STRUCTURE_BUILD_BIT_KHR,
                           VK_ACCESS_2_ACCELERATION_STRUCTURE_READ_BIT_KHR |
                               VK_ACCESS_2_ACCELERATION_STRUCTURE_WRITE_BIT_KHR,
                           true},
};

void tracker_next_command(struct tracker *tracker)
{
    tracker->command++;
}

void tracker_require(const struct tracker *tracker, struct hazards *hazards, const struct history *history,
                     enum usage usage)
{
    for (uint32_t earlier = 0; earlier < USAGE_COUNT; earlier++) {
        if ((usages[earlier].writes || usages[usage].writes) &&
            history->last[earlier] > tracker->ordered[earlier][usage]) {
            hazards->sources |= 1u << earlier;
            hazards->targets |= 1u << usage;
        }
    }
}

static void emit(const struct gpu *gpu, VkCommandBuffer commands, const VkMemoryBarrier2 *barrier)
{
    const VkDependencyInfo dependency = {
        .sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO,
        .memoryBarrierCount = 1,
        .pMemoryBarriers = barrier,
    };
    gpu->vk.vkCmdPipelineBarrier2(commands, &dependency);
}

void tracker_resolve(struct gpu *gpu, VkCommandBuffer commands, const struct hazards *hazards)
{
    if (hazards->sources == 0) {
        return;
    }
    VkMemoryBarrier2 barrier = {.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER_2};
    for (uint32_t i = 0; i < USAGE_COUNT; i++) {
        if (hazards->sources & 1u << i) {
            barrier.srcStageMask |= usages[i].stages;
            /* After a read there is nothing to make available: the execution dependency is enough. */
            barrier.srcAccessMask |= usages[i].writes ? usages[i].access : 0;
        }
        if (hazards->targets & 1u << i) {
            barrier.dstStageMask |= usages[i].stages;
            barrier.dstAccessMask |= usages[i].access;
        }
    }
    emit(gpu, commands, &barrier);

    struct tracker *tracker = &gpu->tracker;
    for (uint32_t source = 0; source < USAGE_COUNT; source++) {
        const VkAccessFlags2 made_available = usages[source].writes ? usages[source].access : 0;
        if ((usages[source].stages & ~barrier.srcStageMask) || (made_available & ~barrier.srcAccessMask)) {
            continue;
        }
        for (uint32_t target = 0; target < USAGE_COUNT; target++) {
            const bool is_visible = !made_available || !(usages[target].access & ~barrier.dstAccessMask);
            if (!(usages[target].stages & ~barrier.dstStageMask) && is_visible) {
                tracker->ordered[source][target] = tracker->command - 1;
            }
        }
    }
}

void tracker_mark(struct gpu_frame *frame, struct history *history, enum usage usage)
{
    history->last[usage] = frame->gpu->tracker.command;
    history->serial = frame->serial;
}

void full_barrier(const struct gpu *gpu, VkCommandBuffer commands)
{
    const VkMemoryBarrier2 barrier = {
        .sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER_2,
        .srcStageMask = VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT,
        .srcAccessMask = VK_ACCESS_2_MEMORY_WRITE_BIT,
        .dstStageMask = VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT,
        .dstAccessMask = VK_ACCESS_2_MEMORY_READ_BIT | VK_ACCESS_2_MEMORY_WRITE_BIT,
    };
    emit(gpu, commands, &barrier);
}

void tracker_full_barrier(struct gpu *gpu, VkCommandBuffer commands)
{
    full_barrier(gpu, commands);
    for (uint32_t source = 0; source < USAGE_COUNT; source++) {
        for (uint32_t target = 0; target < USAGE_COUNT; target++) {
            gpu->tracker.ordered[source][target] = gpu->tracker.command;
        }
    }
}

void host_barrier(struct gpu *gpu, VkCommandBuffer commands, uint32_t sources)
{
    VkMemoryBarrier2 barrier = {
        .sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER_2,
        .dstStageMask = VK_PIPELINE_STAGE_2_HOST_BIT,
        .dstAccessMask = VK_ACCESS_2_HOST_READ_BIT,
    };
    for (uint32_t i = 0; i < USAGE_COUNT; i++) {
        if (sources & 1u << i) {
            barrier.srcStageMask |= usages[i].stages;
            barrier.srcAccessMask |= usages[i].access;
        }
    }
    if (sources != 0) {
        emit(gpu, commands, &barrier);
    }
}
