/* memory.c: buffers, each with its own allocation, and copies that do not wait for a frame. */
#include "gpu_internal.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Fills and copies of gpu_buffer_create_filled go through a staging buffer of at most this size. */
#define FILL_CHUNK ((size_t)16 << 20)

/* ---- allocations -------------------------------------------------------------------------------------- */

static const struct {
    VkMemoryPropertyFlags required, wanted, unwanted;
} memory_kinds[] = {
    /* Device memory that the host can see is often a small window: leave it to others. */
    [GPU_MEMORY_DEVICE] = {0, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT},
    [GPU_MEMORY_UPLOAD] = {VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT, 0,
                           VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT},
    [GPU_MEMORY_READBACK] = {VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT,
                             VK_MEMORY_PROPERTY_HOST_CACHED_BIT, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT},
};

static bool choose_memory_type(const struct gpu *gpu, uint32_t allowed, enum gpu_memory memory,
                               uint32_t *type)
{
    int best = -1;
    for (uint32_t i = 0; i < gpu->memory_properties.memoryTypeCount; i++) {
        const VkMemoryPropertyFlags flags = gpu->memory_properties.memoryTypes[i].propertyFlags;
        if (!(allowed & 1u << i) ||
            (flags & memory_kinds[memory].required) != memory_kinds[memory].required ||
            (flags & VK_MEMORY_PROPERTY_LAZILY_ALLOCATED_BIT) || (flags & VK_MEMORY_PROPERTY_PROTECTED_BIT)) {
            continue;
        }
        const VkMemoryPropertyFlags wanted = memory_kinds[memory].wanted;
        const int score =
            ((flags & wanted) == wanted ? 2 : 0) + (flags & memory_kinds[memory].unwanted ? 0 : 1);
        if (score > best) {
            best = score;
            *type = i;
        }
    }
    return best >= 0;
}

VkDeviceMemory memory_allocate(struct gpu *gpu, const VkMemoryRequirements *requirements,
                               enum gpu_memory memory, bool with_address, const char *name,
                               uint64_t *allocated_bytes, struct error *error)
{
    uint32_t type = 0;
    if (!choose_memory_type(gpu, requirements->memoryTypeBits, memory, &type)) {
        error_set(error, STATUS_UNSUPPORTED, "the device has no memory of the kind that '%s' needs", name);
        return VK_NULL_HANDLE;
    }
    const VkMemoryAllocateFlagsInfo flags = {
        .sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO,
        .flags = VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT,
    };
    const VkMemoryAllocateInfo info = {
        .sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO,
        .pNext = with_address ? &flags : NULL,
        .allocationSize = requirements->size,
        .memoryTypeIndex = type,
    };
    VkDeviceMemory allocation = VK_NULL_HANDLE;
    const VkResult result = gpu->vk.vkAllocateMemory(gpu->device, &info, NULL, &allocation);
    if (result != VK_SUCCESS) {
        char what[128];
        snprintf(what, sizeof what, "cannot allocate %llu bytes (%llu are in use) for",
                 (unsigned long long)requirements->size, (unsigned long long)gpu->memory_in_use);
        gpu_fail(gpu, error, result, what, name);
        return VK_NULL_HANDLE;
    }
    *allocated_bytes = requirements->size;
    gpu->memory_in_use += requirements->size;
    return allocation;
}

void memory_free(struct gpu *gpu, VkDeviceMemory allocation, uint64_t allocated_bytes)
{
    if (allocation) {
        gpu->vk.vkFreeMemory(gpu->device, allocation, NULL);
        gpu->memory_in_use -= allocated_bytes;
    }
}

/* ---- buffers ------------------------------------------------------------------------------------------ */

static VkBufferUsageFlags role_usage(const struct gpu *gpu, enum buffer_role role)
{
    const VkBufferUsageFlags storage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT |
                                       VK_BUFFER_USAGE_INDIRECT_BUFFER_BIT |
                                       VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
    switch (role) {
    case BUFFER_BUILD_INPUT:
        return gpu->info.has_ray_query
                   ? storage | VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_BUILD_INPUT_READ_ONLY_BIT_KHR |
                         VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT
                   : storage;
    case BUFFER_STRUCTURE:
        return VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_STORAGE_BIT_KHR |
               VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT;
    case BUFFER_BUILD_SCRATCH:
        return VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT;
    default:
        return storage;
    }
}

struct gpu_buffer *buffer_create(struct gpu *gpu, const struct gpu_buffer_params *params,
                                 enum buffer_role role, struct error *error)
{
    const char *name = params->name ? params->name : "buffer";
    /* Structures and their scratch memory are not seen through a descriptor, so its limit is not theirs. */
    if (params->size == 0) {
        error_set(error, STATUS_INVALID, "buffer '%s' has a size of 0 bytes", name);
        return NULL;
    }
    if (role != BUFFER_STRUCTURE && role != BUFFER_BUILD_SCRATCH &&
        params->size > gpu->info.max_storage_bytes) {
        error_set(error, STATUS_LIMIT, "buffer '%s' needs %zu bytes; %s allows %llu in one buffer", name,
                  params->size, gpu->info.name, (unsigned long long)gpu->info.max_storage_bytes);
        return NULL;
    }
    struct gpu_buffer *buffer = calloc(1, sizeof *buffer);
    if (!buffer) {
        error_set(error, STATUS_MEMORY, "out of host memory for buffer '%s'", name);
        return NULL;
    }
    buffer->gpu = gpu;
    buffer->size = params->size;
    buffer->padded_size = (params->size + BUFFER_ALIGNMENT - 1) / BUFFER_ALIGNMENT * BUFFER_ALIGNMENT;
    buffer->memory = params->memory;
    snprintf(buffer->name, sizeof buffer->name, "%s", name);
    gpu->object_count++;

    const VkBufferCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO,
        .size = buffer->padded_size,
        .usage = role_usage(gpu, role),
        .sharingMode = VK_SHARING_MODE_EXCLUSIVE,
    };
    const bool with_address = info.usage & VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT;
    VkResult result = gpu->vk.vkCreateBuffer(gpu->device, &info, NULL, &buffer->handle);
    if (result != VK_SUCCESS) {
        buffer->handle = VK_NULL_HANDLE;
        gpu_fail(gpu, error, result, "cannot create buffer", name);
        goto fail;
    }
    VkMemoryRequirements requirements;
    gpu->vk.vkGetBufferMemoryRequirements(gpu->device, buffer->handle, &requirements);
    buffer->allocation = memory_allocate(gpu, &requirements, params->memory, with_address, name,
                                         &buffer->allocated_bytes, error);
    if (!buffer->allocation) {
        goto fail;
    }
    result = gpu->vk.vkBindBufferMemory(gpu->device, buffer->handle, buffer->allocation, 0);
    if (result == VK_SUCCESS && params->memory != GPU_MEMORY_DEVICE) {
        result = gpu->vk.vkMapMemory(gpu->device, buffer->allocation, 0, VK_WHOLE_SIZE, 0, &buffer->mapped);
    }
    if (result != VK_SUCCESS) {
        gpu_fail(gpu, error, result, "cannot map or bind the memory of buffer", name);
        goto fail;
    }
    if (with_address) {
        const VkBufferDeviceAddressInfo address = {
            .sType = VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO,
            .buffer = buffer->handle,
        };
        buffer->address = gpu->vk.vkGetBufferDeviceAddress(gpu->device, &address);
    }
    gpu_set_name(gpu, VK_OBJECT_TYPE_BUFFER, (uint64_t)buffer->handle, name);
    return buffer;

fail:
    gpu_buffer_destroy(&buffer);
    return NULL;
}

struct gpu_buffer *gpu_buffer_create(struct gpu *gpu, const struct gpu_buffer_params *params,
                                     struct error *error)
{
    return buffer_create(gpu, params, params->acceleration_input ? BUFFER_BUILD_INPUT : BUFFER_STORAGE,
                         error);
}

void gpu_buffer_destroy(struct gpu_buffer **pointer)
{
    struct gpu_buffer *buffer = *pointer;
    if (!buffer) {
        return;
    }
    *pointer = NULL;
    struct gpu *gpu = buffer->gpu;
    frames_release(gpu, buffer->history.serial, buffer->name);
    gpu->vk.vkDestroyBuffer(gpu->device, buffer->handle, NULL);
    memory_free(gpu, buffer->allocation, buffer->allocated_bytes);
    gpu->object_count--;
    free(buffer);
}

size_t gpu_buffer_size(const struct gpu_buffer *buffer)
{
    return buffer->size;
}

void *gpu_buffer_map(struct gpu_buffer *buffer)
{
    return buffer->mapped;
}

/* ---- immediate commands ------------------------------------------------------------------------------- */

VkCommandBuffer immediate_begin(struct gpu *gpu, struct error *error)
{
    if (gpu->is_lost) {
        gpu_fail(gpu, error, VK_ERROR_DEVICE_LOST, "cannot use", gpu->info.name);
        return VK_NULL_HANDLE;
    }
    const VkCommandBufferBeginInfo begin = {
        .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO,
        .flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT,
    };
    VkResult result = gpu->vk.vkResetCommandPool(gpu->device, gpu->immediate_pool, 0);
    if (result == VK_SUCCESS) {
        result = gpu->vk.vkBeginCommandBuffer(gpu->immediate_commands, &begin);
    }
    if (result != VK_SUCCESS) {
        gpu_fail(gpu, error, result, "cannot record commands for", gpu->info.name);
        return VK_NULL_HANDLE;
    }
    full_barrier(gpu, gpu->immediate_commands);
    return gpu->immediate_commands;
}

bool immediate_end(struct gpu *gpu, struct error *error)
{
    full_barrier(gpu, gpu->immediate_commands);
    VkResult result = gpu->vk.vkEndCommandBuffer(gpu->immediate_commands);
    const VkCommandBufferSubmitInfo commands = {
        .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_SUBMIT_INFO,
        .commandBuffer = gpu->immediate_commands,
    };
    const VkSubmitInfo2 submit = {
        .sType = VK_STRUCTURE_TYPE_SUBMIT_INFO_2,
        .commandBufferInfoCount = 1,
        .pCommandBufferInfos = &commands,
    };
    if (result == VK_SUCCESS) {
        result = gpu->vk.vkResetFences(gpu->device, 1, &gpu->immediate_fence);
    }
    if (result == VK_SUCCESS) {
        result = gpu->vk.vkQueueSubmit2(gpu->queue, 1, &submit, gpu->immediate_fence);
    }
    if (result == VK_SUCCESS) {
        result = fence_wait(gpu, gpu->immediate_fence);
    }
    return result == VK_SUCCESS || gpu_fail(gpu, error, result, "commands failed on", gpu->info.name);
}

VkResult fence_wait(struct gpu *gpu, VkFence fence)
{
    const VkResult result = gpu->vk.vkWaitForFences(gpu->device, 1, &fence, VK_TRUE, UINT64_MAX);
    gpu->is_lost |= result == VK_ERROR_DEVICE_LOST;
    if (result != VK_SUCCESS) {
        gpu->vk.vkDeviceWaitIdle(gpu->device);
    }
    return result;
}

struct gpu_buffer *gpu_buffer_create_filled(struct gpu *gpu, const char *name, const void *data, size_t size,
                                            bool acceleration_input, struct error *error)
{
    static const uint8_t zeros[BUFFER_ALIGNMENT];
    if (size == 0) {
        data = zeros;
        size = sizeof zeros;
    }
    const struct gpu_buffer_params params = {
        .name = name, .size = size, .acceleration_input = acceleration_input};
    const struct gpu_buffer_params staging_params = {
        .name = "staging",
        .size = size < FILL_CHUNK ? size : FILL_CHUNK,
        .memory = GPU_MEMORY_UPLOAD,
    };
    struct gpu_buffer *buffer = gpu_buffer_create(gpu, &params, error);
    struct gpu_buffer *staging = buffer ? gpu_buffer_create(gpu, &staging_params, error) : NULL;
    bool is_filled = staging != NULL;
    for (size_t done = 0; is_filled && done < size;) {
        const size_t part = size - done < staging_params.size ? size - done : staging_params.size;
        memcpy(staging->mapped, (const uint8_t *)data + done, part);
        const VkCommandBuffer commands = immediate_begin(gpu, error);
        is_filled = commands != VK_NULL_HANDLE;
        if (is_filled) {
            const VkBufferCopy region = {.dstOffset = done, .size = part};
            gpu->vk.vkCmdCopyBuffer(commands, staging->handle, buffer->handle, 1, &region);
            is_filled = immediate_end(gpu, error);
        }
        done += part;
    }
    gpu_buffer_destroy(&staging);
    if (!is_filled) {
        gpu_buffer_destroy(&buffer);
    }
    return buffer;
}
