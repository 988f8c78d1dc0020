/* accel.c: acceleration structures of opaque triangles, and of instances of them.
 *
 * Bottom levels are built at once and never change. A top level owns its instance list and scratch memory and
 * is rebuilt inside a frame; the hazards of all three are tracked on its backing buffer.
 */
#include "gpu_internal.h"

#include <stdlib.h>
#include <string.h>

static bool check_ray_query(const struct gpu *gpu, const char *name, struct error *error)
{
    return gpu->info.has_ray_query ||
           error_set(error, STATUS_UNSUPPORTED, "'%s' needs ray queries, which %s does not have", name,
                     gpu->info.name);
}

/* A structure with room for `sizes`, and scratch memory to build it. */
static bool create_structure(struct gpu_accel *accel, const char *name, VkAccelerationStructureTypeKHR type,
                             const VkAccelerationStructureBuildSizesInfoKHR *sizes, struct error *error)
{
    struct gpu *gpu = accel->gpu;
    const struct gpu_buffer_params backing = {.name = name, .size = sizes->accelerationStructureSize};
    /* The scratch address is aligned by hand. */
    const struct gpu_buffer_params scratch = {
        .name = "acceleration structure scratch",
        .size = sizes->buildScratchSize + gpu->scratch_alignment,
    };
    accel->backing = buffer_create(gpu, &backing, BUFFER_STRUCTURE, error);
    accel->scratch = accel->backing ? buffer_create(gpu, &scratch, BUFFER_BUILD_SCRATCH, error) : NULL;
    if (!accel->scratch) {
        return false;
    }
    const VkAccelerationStructureCreateInfoKHR info = {
        .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_CREATE_INFO_KHR,
        .buffer = accel->backing->handle,
        .size = sizes->accelerationStructureSize,
        .type = type,
    };
    const VkResult result =
        gpu->vk.vkCreateAccelerationStructureKHR(gpu->device, &info, NULL, &accel->handle);
    if (result != VK_SUCCESS) {
        accel->handle = VK_NULL_HANDLE;
        return gpu_fail(gpu, error, result, "cannot create acceleration structure", name);
    }
    const VkAccelerationStructureDeviceAddressInfoKHR address = {
        .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_DEVICE_ADDRESS_INFO_KHR,
        .accelerationStructure = accel->handle,
    };
    accel->address = gpu->vk.vkGetAccelerationStructureDeviceAddressKHR(gpu->device, &address);
    gpu_set_name(gpu, VK_OBJECT_TYPE_ACCELERATION_STRUCTURE_KHR, (uint64_t)accel->handle, name);
    return true;
}

static void record_build(const struct gpu_accel *accel, VkCommandBuffer commands,
                         VkAccelerationStructureBuildGeometryInfoKHR *build, uint32_t primitive_count)
{
    const VkDeviceAddress alignment = accel->gpu->scratch_alignment ? accel->gpu->scratch_alignment : 1;
    const VkAccelerationStructureBuildRangeInfoKHR range = {.primitiveCount = primitive_count};
    const VkAccelerationStructureBuildRangeInfoKHR *const ranges = &range;
    build->dstAccelerationStructure = accel->handle;
    build->scratchData.deviceAddress = (accel->scratch->address + alignment - 1) / alignment * alignment;
    accel->gpu->vk.vkCmdBuildAccelerationStructuresKHR(commands, 1, build, &ranges);
}

static bool check_triangles(const char *name, const struct gpu_triangles *triangles, struct error *error)
{
    const struct gpu_buffer *vertices = triangles->vertices, *indices = triangles->indices;
    if (!vertices || !indices || !vertices->address || !indices->address) {
        return error_set(error, STATUS_INVALID,
                         "the vertices and indices of '%s' must be buffers made with acceleration_input",
                         name);
    }
    const uint64_t vertex_end = (uint64_t)triangles->first_vertex + triangles->vertex_count;
    const uint64_t index_end = (uint64_t)triangles->first_index + (uint64_t)triangles->triangle_count * 3;
    if (triangles->vertex_count == 0 || triangles->triangle_count == 0 || triangles->vertex_stride < 12 ||
        triangles->vertex_stride % 4 != 0 ||
        (vertex_end - 1) * triangles->vertex_stride + 12 > vertices->size ||
        index_end * sizeof(uint32_t) > indices->size) {
        return error_set(error, STATUS_INVALID, "the triangles of '%s' pass the end of their buffers", name);
    }
    return true;
}

struct gpu_accel *gpu_accel_create_bottom(struct gpu *gpu, const char *name,
                                          const struct gpu_triangles *triangles, struct error *error)
{
    name = name ? name : "bottom level";
    if (!check_ray_query(gpu, name, error) || !check_triangles(name, triangles, error)) {
        return NULL;
    }
    struct gpu_accel *accel = calloc(1, sizeof *accel);
    if (!accel) {
        error_set(error, STATUS_MEMORY, "out of host memory for acceleration structure '%s'", name);
        return NULL;
    }
    accel->gpu = gpu;
    const VkAccelerationStructureGeometryKHR geometry = {
        .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_KHR,
        .geometryType = VK_GEOMETRY_TYPE_TRIANGLES_KHR,
        .geometry.triangles =
            {
                .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_TRIANGLES_DATA_KHR,
                .vertexFormat = VK_FORMAT_R32G32B32_SFLOAT,
                .vertexData.deviceAddress =
                    triangles->vertices->address +
                    (VkDeviceAddress)triangles->first_vertex * triangles->vertex_stride,
                .vertexStride = triangles->vertex_stride,
                .maxVertex = triangles->vertex_count - 1,
                .indexType = VK_INDEX_TYPE_UINT32,
                .indexData.deviceAddress =
                    triangles->indices->address + (VkDeviceAddress)triangles->first_index * sizeof(uint32_t),
            },
        .flags = VK_GEOMETRY_OPAQUE_BIT_KHR,
    };
    VkAccelerationStructureBuildGeometryInfoKHR build = {
        .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_BUILD_GEOMETRY_INFO_KHR,
        .type = VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR,
        .flags = VK_BUILD_ACCELERATION_STRUCTURE_PREFER_FAST_TRACE_BIT_KHR,
        .mode = VK_BUILD_ACCELERATION_STRUCTURE_MODE_BUILD_KHR,
        .geometryCount = 1,
        .pGeometries = &geometry,
    };
    VkAccelerationStructureBuildSizesInfoKHR sizes = {
        .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_BUILD_SIZES_INFO_KHR};
    gpu->vk.vkGetAccelerationStructureBuildSizesKHR(gpu->device,
                                                    VK_ACCELERATION_STRUCTURE_BUILD_TYPE_DEVICE_KHR, &build,
                                                    &triangles->triangle_count, &sizes);
    bool is_built =
        create_structure(accel, name, VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR, &sizes, error);
    const VkCommandBuffer commands = is_built ? immediate_begin(gpu, error) : VK_NULL_HANDLE;
    is_built = commands != VK_NULL_HANDLE;
    if (is_built) {
        record_build(accel, commands, &build, triangles->triangle_count);
        is_built = immediate_end(gpu, error);
    }
    gpu_buffer_destroy(&accel->scratch);
    if (!is_built) {
        gpu_accel_destroy(&accel);
    }
    return accel;
}

/* The description of a top-level build; `geometry` must live as long as the result. */
static VkAccelerationStructureBuildGeometryInfoKHR top_build(const struct gpu_accel *accel,
                                                             VkAccelerationStructureGeometryKHR *geometry)
{
    *geometry = (VkAccelerationStructureGeometryKHR){
        .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_KHR,
        .geometryType = VK_GEOMETRY_TYPE_INSTANCES_KHR,
        .geometry.instances =
            {
                .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_GEOMETRY_INSTANCES_DATA_KHR,
                .data.deviceAddress = accel->instances->address,
            },
        .flags = VK_GEOMETRY_OPAQUE_BIT_KHR,
    };
    return (VkAccelerationStructureBuildGeometryInfoKHR){
        .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_BUILD_GEOMETRY_INFO_KHR,
        .type = VK_ACCELERATION_STRUCTURE_TYPE_TOP_LEVEL_KHR,
        .flags = VK_BUILD_ACCELERATION_STRUCTURE_PREFER_FAST_TRACE_BIT_KHR,
        .mode = VK_BUILD_ACCELERATION_STRUCTURE_MODE_BUILD_KHR,
        .geometryCount = 1,
        .pGeometries = geometry,
    };
}

struct gpu_accel *gpu_accel_create_top(struct gpu *gpu, const char *name, uint32_t max_instances,
                                       struct error *error)
{
    name = name ? name : "top level";
    if (!check_ray_query(gpu, name, error)) {
        return NULL;
    }
    struct gpu_accel *accel = calloc(1, sizeof *accel);
    if (!accel) {
        error_set(error, STATUS_MEMORY, "out of host memory for acceleration structure '%s'", name);
        return NULL;
    }
    accel->gpu = gpu;
    accel->max_instances = max_instances ? max_instances : 1;
    const struct gpu_buffer_params instances = {
        .name = "acceleration structure instances",
        .size = accel->max_instances * sizeof(VkAccelerationStructureInstanceKHR),
        .acceleration_input = true,
    };
    accel->instances = gpu_buffer_create(gpu, &instances, error);
    bool is_created = accel->instances != NULL;
    if (is_created) {
        VkAccelerationStructureGeometryKHR geometry;
        VkAccelerationStructureBuildSizesInfoKHR sizes = {
            .sType = VK_STRUCTURE_TYPE_ACCELERATION_STRUCTURE_BUILD_SIZES_INFO_KHR};
        const VkAccelerationStructureBuildGeometryInfoKHR build = top_build(accel, &geometry);
        gpu->vk.vkGetAccelerationStructureBuildSizesKHR(gpu->device,
                                                        VK_ACCELERATION_STRUCTURE_BUILD_TYPE_DEVICE_KHR,
                                                        &build, &accel->max_instances, &sizes);
        is_created =
            create_structure(accel, name, VK_ACCELERATION_STRUCTURE_TYPE_TOP_LEVEL_KHR, &sizes, error);
    }
    if (!is_created) {
        gpu_accel_destroy(&accel);
    }
    return accel;
}

void gpu_accel_destroy(struct gpu_accel **pointer)
{
    struct gpu_accel *accel = *pointer;
    if (!accel) {
        return;
    }
    *pointer = NULL;
    struct gpu *gpu = accel->gpu;
    /* A bottom level is used by every frame that uses a top level with it, which nobody notes. */
    frames_wait_all(gpu);
    if (accel->handle) {
        gpu->vk.vkDestroyAccelerationStructureKHR(gpu->device, accel->handle, NULL);
    }
    gpu_buffer_destroy(&accel->backing);
    gpu_buffer_destroy(&accel->instances);
    gpu_buffer_destroy(&accel->scratch);
    free(accel);
}

void gpu_record_accel_build(struct gpu_frame *frame, struct gpu_accel *top,
                            const struct gpu_accel_instance *instances, uint32_t count)
{
    struct gpu *gpu = frame->gpu;
    struct gpu_buffer *staging;
    size_t offset;
    if (!frame_is_recording(frame)) {
        return;
    }
    if (!top->instances || count > top->max_instances) {
        frame_fail(frame, STATUS_LIMIT, "'%s' cannot hold %u instances: it was made for %u",
                   top->backing->name, count, top->max_instances);
        return;
    }
    if (count > 0) {
        const size_t size = count * sizeof(VkAccelerationStructureInstanceKHR);
        VkAccelerationStructureInstanceKHR *list = frame_stage(frame, size, &staging, &offset);
        if (!list) {
            return;
        }
        for (uint32_t i = 0; i < count; i++) {
            list[i] = (VkAccelerationStructureInstanceKHR){
                .instanceCustomIndex = instances[i].custom_index & 0xffffffu,
                .mask = 0xff,
                .accelerationStructureReference = instances[i].bottom->address,
            };
            memcpy(&list[i].transform, instances[i].object_to_world, sizeof list[i].transform);
        }
        frame_begin_transfer(frame, top->instances, NULL);
        const VkBufferCopy region = {.srcOffset = offset, .size = size};
        gpu->vk.vkCmdCopyBuffer(frame->commands, staging->handle, top->instances->handle, 1, &region);
    }
    struct hazards hazards = {0};
    tracker_next_command(&gpu->tracker);
    tracker_require(&gpu->tracker, &hazards, &top->instances->history, USAGE_BUILD_READ);
    tracker_require(&gpu->tracker, &hazards, &top->backing->history, USAGE_BUILD_WRITE);
    tracker_resolve(gpu, frame->commands, &hazards);
    VkAccelerationStructureGeometryKHR geometry;
    VkAccelerationStructureBuildGeometryInfoKHR build = top_build(top, &geometry);
    record_build(top, frame->commands, &build, count);
    frame_mark(frame, top->instances, USAGE_BUILD_READ);
    frame_mark(frame, top->backing, USAGE_BUILD_WRITE);
    frame_mark(frame, top->scratch, USAGE_BUILD_WRITE);
}
