/* test_gpu_barrier.c: the hazard tracker against a plain oracle, without a device.
 *
 * Random commands touch random resources. The oracle keeps every access and every barrier: two accesses of
 * one resource of which one writes are ordered when a barrier recorded between them covers the stages of both
 * and, after a write, makes that write available and visible. Every conflicting pair must be ordered, and a
 * command must bring a barrier only when the ones before it leave a pair unordered.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/gpu/gpu_internal.h"

#define RESOURCE_COUNT 5u
#define COMMAND_COUNT  300u
#define ROUND_COUNT    60u

struct access {
    uint32_t resource, time;
    enum usage usage;
};

struct recorded_barrier {
    uint32_t time; /* before the command of this number */
    VkMemoryBarrier2 barrier;
};

static struct recorded_barrier barriers[COMMAND_COUNT];
static uint32_t barrier_count, now;

static VKAPI_ATTR void VKAPI_CALL record_barrier(VkCommandBuffer commands, const VkDependencyInfo *dependency)
{
    (void)commands;
    assert_int_equal(dependency->memoryBarrierCount, 1);
    assert_true(barrier_count < COMMAND_COUNT);
    barriers[barrier_count++] =
        (struct recorded_barrier){.time = now, .barrier = dependency->pMemoryBarriers[0]};
}

/* What Vulkan asks of each kind of access, written down apart from barrier.c. */
static void expected_scope(enum usage usage, VkPipelineStageFlags2 *stages, VkAccessFlags2 *access,
                           bool *writes)
{
    const VkPipelineStageFlags2 draw =
        VK_PIPELINE_STAGE_2_VERTEX_SHADER_BIT | VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT;
    *writes = false;
    switch (usage) {
    case USAGE_COMPUTE_WRITE:
    case USAGE_DRAW_WRITE:
        *writes = true;
        *stages = usage == USAGE_DRAW_WRITE ? draw : VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT;
        *access = VK_ACCESS_2_SHADER_STORAGE_WRITE_BIT;
        break;
    case USAGE_COMPUTE_READ:
    case USAGE_DRAW_READ:
        *stages = usage == USAGE_DRAW_READ ? draw : VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT;
        *access = VK_ACCESS_2_SHADER_STORAGE_READ_BIT;
        break;
    case USAGE_COMPUTE_TRACE:
        *stages = VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT;
        *access = VK_ACCESS_2_ACCELERATION_STRUCTURE_READ_BIT_KHR;
        break;
    case USAGE_INDIRECT:
        *stages = VK_PIPELINE_STAGE_2_DRAW_INDIRECT_BIT;
        *access = VK_ACCESS_2_INDIRECT_COMMAND_READ_BIT;
        break;
    case USAGE_COPY_READ:
        *stages = VK_PIPELINE_STAGE_2_ALL_TRANSFER_BIT;
        *access = VK_ACCESS_2_TRANSFER_READ_BIT;
        break;
    case USAGE_COPY_WRITE:
        *writes = true;
        *stages = VK_PIPELINE_STAGE_2_ALL_TRANSFER_BIT;
        *access = VK_ACCESS_2_TRANSFER_WRITE_BIT;
        break;
    case USAGE_BUILD_READ:
        *stages = VK_PIPELINE_STAGE_2_ACCELERATION_STRUCTURE_BUILD_BIT_KHR;
        *access = VK_ACCESS_2_SHADER_READ_BIT | VK_ACCESS_2_ACCELERATION_STRUCTURE_READ_BIT_KHR;
        break;
    default:
        *writes = true;
        *stages = VK_PIPELINE_STAGE_2_ACCELERATION_STRUCTURE_BUILD_BIT_KHR;
        *access = VK_ACCESS_2_ACCELERATION_STRUCTURE_WRITE_BIT_KHR;
        break;
    }
}

/* Whether one barrier of the first `count` orders the two accesses. */
static bool is_ordered(const struct access *earlier, const struct access *later, uint32_t count)
{
    VkPipelineStageFlags2 first_stages, second_stages;
    VkAccessFlags2 first_access, second_access;
    bool first_writes, second_writes;
    expected_scope(earlier->usage, &first_stages, &first_access, &first_writes);
    expected_scope(later->usage, &second_stages, &second_access, &second_writes);
    for (uint32_t i = 0; i < count; i++) {
        const VkMemoryBarrier2 *barrier = &barriers[i].barrier;
        if (barriers[i].time > earlier->time && barriers[i].time <= later->time &&
            !(first_stages & ~barrier->srcStageMask) && !(second_stages & ~barrier->dstStageMask) &&
            (!first_writes ||
             (!(first_access & ~barrier->srcAccessMask) && !(second_access & ~barrier->dstAccessMask)))) {
            return true;
        }
    }
    return false;
}

static bool usage_writes(enum usage usage)
{
    VkPipelineStageFlags2 stages;
    VkAccessFlags2 access;
    bool writes;
    expected_scope(usage, &stages, &access, &writes);
    return writes;
}

static uint32_t random_state;

static uint32_t random_below(uint32_t bound)
{
    random_state = random_state * 1664525u + 1013904223u;
    return (random_state >> 8) % bound;
}

static void every_conflict_is_ordered_and_no_barrier_is_idle(void **state)
{
    (void)state;
    static struct access accesses[COMMAND_COUNT * 3];
    uint32_t total_barriers = 0, total_conflicts = 0;
    random_state = 20230821;
    for (uint32_t round = 0; round < ROUND_COUNT; round++) {
        struct gpu *gpu = calloc(1, sizeof *gpu);
        assert_non_null(gpu);
        gpu->vk.vkCmdPipelineBarrier2 = record_barrier;
        struct gpu_frame frame = {.gpu = gpu, .serial = 1};
        struct history histories[RESOURCE_COUNT] = {0};
        uint32_t access_count = 0;
        barrier_count = 0;
        for (now = 1; now <= COMMAND_COUNT; now++) {
            struct hazards hazards = {0};
            const uint32_t first_new = access_count, barriers_before = barrier_count;
            tracker_next_command(&gpu->tracker);
            for (uint32_t i = 0, count = 1 + random_below(3); i < count; i++) {
                accesses[access_count++] = (struct access){.resource = random_below(RESOURCE_COUNT),
                                                           .time = now,
                                                           .usage = random_below(USAGE_COUNT)};
            }
            for (uint32_t i = first_new; i < access_count; i++) {
                tracker_require(&gpu->tracker, &hazards, &histories[accesses[i].resource], accesses[i].usage);
            }
            tracker_resolve(gpu, VK_NULL_HANDLE, &hazards);
            for (uint32_t i = first_new; i < access_count; i++) {
                tracker_mark(&frame, &histories[accesses[i].resource], accesses[i].usage);
            }

            bool needs_barrier = false;
            for (uint32_t later = first_new; later < access_count; later++) {
                for (uint32_t earlier = 0; earlier < first_new; earlier++) {
                    if (accesses[earlier].resource != accesses[later].resource ||
                        (!usage_writes(accesses[earlier].usage) && !usage_writes(accesses[later].usage))) {
                        continue;
                    }
                    total_conflicts++;
                    needs_barrier |= !is_ordered(&accesses[earlier], &accesses[later], barriers_before);
                    assert_true(is_ordered(&accesses[earlier], &accesses[later], barrier_count));
                }
            }
            assert_int_equal(barrier_count - barriers_before, needs_barrier ? 1 : 0);
        }
        total_barriers += barrier_count;
        free(gpu);
    }
    print_message("%u conflicts, %u commands, %u barriers\n", total_conflicts, ROUND_COUNT * COMMAND_COUNT,
                  total_barriers);
    assert_true(total_conflicts > 100000);
}

/* After commands that were recorded but never ran, one full barrier restores what the tracker may assume. */
static void a_full_barrier_orders_everything_before_it(void **state)
{
    (void)state;
    struct gpu *gpu = calloc(1, sizeof *gpu);
    assert_non_null(gpu);
    gpu->vk.vkCmdPipelineBarrier2 = record_barrier;
    struct gpu_frame frame = {.gpu = gpu, .serial = 1};
    for (uint32_t first = 0; first < USAGE_COUNT; first++) {
        for (uint32_t second = 0; second < USAGE_COUNT; second++) {
            struct history history = {0};
            struct hazards hazards = {0};
            tracker_next_command(&gpu->tracker);
            tracker_mark(&frame, &history, first);
            barrier_count = 0;
            tracker_full_barrier(gpu, VK_NULL_HANDLE);
            assert_int_equal(barrier_count, 1);
            assert_true(barriers[0].barrier.srcStageMask == VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT);
            assert_true(barriers[0].barrier.dstStageMask == VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT);
            tracker_next_command(&gpu->tracker);
            tracker_require(&gpu->tracker, &hazards, &history, second);
            assert_int_equal(hazards.sources, 0);
        }
    }
    free(gpu);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_conflict_is_ordered_and_no_barrier_is_idle),
        cmocka_unit_test(a_full_barrier_orders_everything_before_it),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
