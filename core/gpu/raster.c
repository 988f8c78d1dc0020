/* raster.c: one off-screen colour attachment, blended additively, through dynamic rendering.
 *
 * The images belong to the raster alone, so their ordering is kept here with image barriers and not in the
 * hazard tracker: undefined -> attachment at a draw (which clears), attachment -> transfer source at its end.
 */
#include "gpu_internal.h"

#include <stdlib.h>

struct image {
    VkImage handle;
    VkImageView view;
    VkDeviceMemory allocation;
    uint64_t allocated_bytes;
};

struct gpu_raster {
    struct program program;
    struct image samples;  /* only when multisampled */
    struct image resolved; /* what is read back */
    VkFormat format;
    uint32_t width, height, sample_count;
    uint64_t drawn_serial; /* of the last frame that drew it */
};

static bool create_image(struct gpu_raster *raster, struct image *image, VkSampleCountFlagBits samples,
                         VkImageUsageFlags usage, struct error *error)
{
    struct gpu *gpu = raster->program.gpu;
    const char *name = raster->program.name;
    const VkImageCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO,
        .imageType = VK_IMAGE_TYPE_2D,
        .format = raster->format,
        .extent = {raster->width, raster->height, 1},
        .mipLevels = 1,
        .arrayLayers = 1,
        .samples = samples,
        .tiling = VK_IMAGE_TILING_OPTIMAL,
        .usage = usage,
        .sharingMode = VK_SHARING_MODE_EXCLUSIVE,
        .initialLayout = VK_IMAGE_LAYOUT_UNDEFINED,
    };
    VkResult result = gpu->vk.vkCreateImage(gpu->device, &info, NULL, &image->handle);
    if (result != VK_SUCCESS) {
        image->handle = VK_NULL_HANDLE;
        return gpu_fail(gpu, error, result, "cannot create the image of", name);
    }
    VkMemoryRequirements requirements;
    gpu->vk.vkGetImageMemoryRequirements(gpu->device, image->handle, &requirements);
    image->allocation =
        memory_allocate(gpu, &requirements, GPU_MEMORY_DEVICE, false, name, &image->allocated_bytes, error);
    if (!image->allocation) {
        return false;
    }
    result = gpu->vk.vkBindImageMemory(gpu->device, image->handle, image->allocation, 0);
    if (result == VK_SUCCESS) {
        const VkImageViewCreateInfo view = {
            .sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO,
            .image = image->handle,
            .viewType = VK_IMAGE_VIEW_TYPE_2D,
            .format = raster->format,
            .subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1},
        };
        result = gpu->vk.vkCreateImageView(gpu->device, &view, NULL, &image->view);
    }
    if (result != VK_SUCCESS) {
        return gpu_fail(gpu, error, result, "cannot create the image of", name);
    }
    gpu_set_name(gpu, VK_OBJECT_TYPE_IMAGE, (uint64_t)image->handle, name);
    return true;
}

static void destroy_image(struct gpu *gpu, struct image *image)
{
    gpu->vk.vkDestroyImageView(gpu->device, image->view, NULL);
    gpu->vk.vkDestroyImage(gpu->device, image->handle, NULL);
    memory_free(gpu, image->allocation, image->allocated_bytes);
}

bool gpu_raster_check(struct gpu *gpu, const struct gpu_raster_params *params, struct error *error)
{
    const char *name = params->name ? params->name : "raster";
    const uint32_t samples = params->samples ? params->samples : 1;
    const VkFormat format = params->half ? VK_FORMAT_R16G16B16A16_SFLOAT : VK_FORMAT_R32G32B32A32_SFLOAT;
    if (!gpu->has_graphics) {
        return error_set(error, STATUS_UNSUPPORTED, "'%s' needs a graphics queue, which %s does not have",
                         name, gpu->info.name);
    }
    if (params->width == 0 || params->height == 0 || params->width > gpu->info.max_image_size ||
        params->height > gpu->info.max_image_size) {
        return error_set(error, STATUS_LIMIT, "'%s' is %u x %u pixels; %s allows 1 to %u along a side", name,
                         params->width, params->height, gpu->info.name, gpu->info.max_image_size);
    }
    VkFormatProperties properties;
    vkGetPhysicalDeviceFormatProperties(gpu->physical, format, &properties);
    if (!(properties.optimalTilingFeatures & VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BLEND_BIT)) {
        return error_set(error, STATUS_UNSUPPORTED, "'%s' needs blending into %s, which %s does not have",
                         name, params->half ? "RGBA16F" : "RGBA32F", gpu->info.name);
    }
    VkImageFormatProperties image;
    const VkResult result = vkGetPhysicalDeviceImageFormatProperties(
        gpu->physical, format, VK_IMAGE_TYPE_2D, VK_IMAGE_TILING_OPTIMAL, VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT,
        0, &image);
    if (result != VK_SUCCESS || (samples & (samples - 1)) != 0 ||
        !(image.sampleCounts & gpu->limits.framebufferColorSampleCounts & samples)) {
        return error_set(error, STATUS_UNSUPPORTED,
                         "'%s' wants %u samples per pixel; %s allows powers of two up to %u", name, samples,
                         gpu->info.name, gpu->info.max_samples);
    }
    if (params->per_sample && !gpu->has_sample_shading) {
        return error_set(error, STATUS_UNSUPPORTED, "'%s' needs per-sample shading, which %s does not have",
                         name, gpu->info.name);
    }
    if (params->writes_buffers && !gpu->has_fragment_stores) {
        return error_set(error, STATUS_UNSUPPORTED,
                         "'%s' needs stores from fragment shaders, which %s does not have", name,
                         gpu->info.name);
    }
    return true;
}

static bool create_pipeline(struct gpu_raster *raster, const struct gpu_raster_params *params,
                            VkShaderModule vertex, VkShaderModule fragment,
                            const VkSpecializationInfo *constants, struct error *error)
{
    struct gpu *gpu = raster->program.gpu;
    const VkPipelineShaderStageCreateInfo stages[] = {
        {
            .sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
            .stage = VK_SHADER_STAGE_VERTEX_BIT,
            .module = vertex,
            .pName = "main",
            .pSpecializationInfo = constants,
        },
        {
            .sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
            .stage = VK_SHADER_STAGE_FRAGMENT_BIT,
            .module = fragment,
            .pName = "main",
            .pSpecializationInfo = constants,
        },
    };
    const VkPipelineVertexInputStateCreateInfo vertex_input = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO,
    };
    const VkPipelineInputAssemblyStateCreateInfo assembly = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO,
        .topology = VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST,
    };
    const VkViewport area = {0, 0, (float)raster->width, (float)raster->height, 0, 1};
    const VkRect2D scissor = {.extent = {raster->width, raster->height}};
    const VkPipelineViewportStateCreateInfo viewport = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_VIEWPORT_STATE_CREATE_INFO,
        .viewportCount = 1,
        .pViewports = &area,
        .scissorCount = 1,
        .pScissors = &scissor,
    };
    const VkPipelineRasterizationStateCreateInfo rasterisation = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_RASTERIZATION_STATE_CREATE_INFO,
        .polygonMode = VK_POLYGON_MODE_FILL,
        .cullMode = VK_CULL_MODE_NONE,
        .lineWidth = 1,
    };
    const VkPipelineMultisampleStateCreateInfo multisample = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_MULTISAMPLE_STATE_CREATE_INFO,
        .rasterizationSamples = (VkSampleCountFlagBits)raster->sample_count,
        .sampleShadingEnable = params->per_sample,
        .minSampleShading = 1,
    };
    const VkPipelineColorBlendAttachmentState additive = {
        .blendEnable = VK_TRUE,
        .srcColorBlendFactor = VK_BLEND_FACTOR_ONE,
        .dstColorBlendFactor = VK_BLEND_FACTOR_ONE,
        .colorBlendOp = VK_BLEND_OP_ADD,
        .srcAlphaBlendFactor = VK_BLEND_FACTOR_ONE,
        .dstAlphaBlendFactor = VK_BLEND_FACTOR_ONE,
        .alphaBlendOp = VK_BLEND_OP_ADD,
        .colorWriteMask = VK_COLOR_COMPONENT_R_BIT | VK_COLOR_COMPONENT_G_BIT | VK_COLOR_COMPONENT_B_BIT |
                          VK_COLOR_COMPONENT_A_BIT,
    };
    const VkPipelineColorBlendStateCreateInfo blend = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_COLOR_BLEND_STATE_CREATE_INFO,
        .attachmentCount = 1,
        .pAttachments = &additive,
    };
    const VkPipelineRenderingCreateInfo rendering = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_RENDERING_CREATE_INFO,
        .colorAttachmentCount = 1,
        .pColorAttachmentFormats = &raster->format,
    };
    const VkGraphicsPipelineCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_GRAPHICS_PIPELINE_CREATE_INFO,
        .pNext = &rendering,
        .stageCount = 2,
        .pStages = stages,
        .pVertexInputState = &vertex_input,
        .pInputAssemblyState = &assembly,
        .pViewportState = &viewport,
        .pRasterizationState = &rasterisation,
        .pMultisampleState = &multisample,
        .pColorBlendState = &blend,
        .layout = raster->program.layout,
    };
    const VkResult result =
        gpu->vk.vkCreateGraphicsPipelines(gpu->device, gpu->cache, 1, &info, NULL, &raster->program.handle);
    if (result != VK_SUCCESS) {
        raster->program.handle = VK_NULL_HANDLE;
        return gpu_fail(gpu, error, result, "cannot create pipeline", raster->program.name);
    }
    gpu_set_name(gpu, VK_OBJECT_TYPE_PIPELINE, (uint64_t)raster->program.handle, raster->program.name);
    return true;
}

struct gpu_raster *gpu_raster_create(struct gpu *gpu, const struct gpu_raster_params *params,
                                     struct error *error)
{
    const char *name = params->name ? params->name : "raster";
    const uint32_t samples = params->samples ? params->samples : 1;
    const VkFormat format = params->half ? VK_FORMAT_R16G16B16A16_SFLOAT : VK_FORMAT_R32G32B32A32_SFLOAT;
    if (!gpu_raster_check(gpu, params, error)) {
        return NULL;
    }
    struct gpu_raster *raster = calloc(1, sizeof *raster);
    if (!raster) {
        error_set(error, STATUS_MEMORY, "out of host memory for pipeline '%s'", name);
        return NULL;
    }
    raster->format = format;
    raster->width = params->width;
    raster->height = params->height;
    raster->sample_count = samples;
    struct specialisation specialisation = {0};
    VkShaderModule vertex = VK_NULL_HANDLE, fragment = VK_NULL_HANDLE;
    const VkImageUsageFlags readable = VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT | VK_IMAGE_USAGE_TRANSFER_SRC_BIT;
    const bool is_created =
        program_create_layout(&raster->program, gpu, name, params->binding_mask, 0, params->push_bytes,
                              VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT, error) &&
        create_image(raster, &raster->resolved, VK_SAMPLE_COUNT_1_BIT, readable, error) &&
        (samples == 1 || create_image(raster, &raster->samples, (VkSampleCountFlagBits)samples,
                                      VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT, error)) &&
        specialisation_create(&specialisation, params->constants, params->constant_count, error) &&
        (vertex = shader_module_create(gpu, name, params->vertex_spirv, params->vertex_bytes, error)) &&
        (fragment = shader_module_create(gpu, name, params->fragment_spirv, params->fragment_bytes, error)) &&
        create_pipeline(raster, params, vertex, fragment,
                        params->constant_count ? &specialisation.info : NULL, error);
    gpu->vk.vkDestroyShaderModule(gpu->device, vertex, NULL);
    gpu->vk.vkDestroyShaderModule(gpu->device, fragment, NULL);
    specialisation_destroy(&specialisation);
    if (!is_created) {
        gpu_raster_destroy(&raster);
    }
    return raster;
}

void gpu_raster_destroy(struct gpu_raster **pointer)
{
    struct gpu_raster *raster = *pointer;
    if (!raster) {
        return;
    }
    *pointer = NULL;
    struct gpu *gpu = raster->program.gpu;
    program_destroy(&raster->program);
    destroy_image(gpu, &raster->samples);
    destroy_image(gpu, &raster->resolved);
    free(raster);
}

static VkImageMemoryBarrier2 image_barrier(const struct image *image)
{
    return (VkImageMemoryBarrier2){
        .sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER_2,
        .srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
        .dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
        .image = image->handle,
        .subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1},
    };
}

static void begin_rendering(struct gpu_frame *frame, const struct gpu_raster *raster)
{
    const struct gpu *gpu = frame->gpu;
    const bool is_multisampled = raster->sample_count > 1;
    const struct image *images[] = {&raster->resolved, &raster->samples};
    VkImageMemoryBarrier2 barriers[2];
    for (uint32_t i = 0; i < 2; i++) {
        /* The last contents are discarded, but what wrote and read them must be over. */
        barriers[i] = image_barrier(images[i]);
        barriers[i].srcStageMask =
            VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT | VK_PIPELINE_STAGE_2_ALL_TRANSFER_BIT;
        barriers[i].srcAccessMask = VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT;
        barriers[i].dstStageMask = VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT;
        barriers[i].dstAccessMask =
            VK_ACCESS_2_COLOR_ATTACHMENT_READ_BIT | VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT;
        barriers[i].oldLayout = VK_IMAGE_LAYOUT_UNDEFINED;
        barriers[i].newLayout = VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL;
    }
    const VkDependencyInfo dependency = {
        .sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO,
        .imageMemoryBarrierCount = is_multisampled ? 2 : 1,
        .pImageMemoryBarriers = barriers,
    };
    gpu->vk.vkCmdPipelineBarrier2(frame->commands, &dependency);
    const VkRenderingAttachmentInfo attachment = {
        .sType = VK_STRUCTURE_TYPE_RENDERING_ATTACHMENT_INFO,
        .imageView = is_multisampled ? raster->samples.view : raster->resolved.view,
        .imageLayout = VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL,
        .resolveMode = is_multisampled ? VK_RESOLVE_MODE_AVERAGE_BIT : VK_RESOLVE_MODE_NONE,
        .resolveImageView = is_multisampled ? raster->resolved.view : VK_NULL_HANDLE,
        .resolveImageLayout = VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL,
        .loadOp = VK_ATTACHMENT_LOAD_OP_CLEAR,
        .storeOp = is_multisampled ? VK_ATTACHMENT_STORE_OP_DONT_CARE : VK_ATTACHMENT_STORE_OP_STORE,
    };
    const VkRenderingInfo rendering = {
        .sType = VK_STRUCTURE_TYPE_RENDERING_INFO,
        .renderArea = {.extent = {raster->width, raster->height}},
        .layerCount = 1,
        .colorAttachmentCount = 1,
        .pColorAttachments = &attachment,
    };
    gpu->vk.vkCmdBeginRendering(frame->commands, &rendering);
}

static void end_rendering(struct gpu_frame *frame, const struct gpu_raster *raster)
{
    const struct gpu *gpu = frame->gpu;
    gpu->vk.vkCmdEndRendering(frame->commands);
    VkImageMemoryBarrier2 barrier = image_barrier(&raster->resolved);
    barrier.srcStageMask = VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT;
    barrier.srcAccessMask = VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT;
    barrier.dstStageMask = VK_PIPELINE_STAGE_2_ALL_TRANSFER_BIT;
    barrier.dstAccessMask = VK_ACCESS_2_TRANSFER_READ_BIT;
    barrier.oldLayout = VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL;
    barrier.newLayout = VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL;
    const VkDependencyInfo dependency = {
        .sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO,
        .imageMemoryBarrierCount = 1,
        .pImageMemoryBarriers = &barrier,
    };
    gpu->vk.vkCmdPipelineBarrier2(frame->commands, &dependency);
}

void gpu_record_draw(struct gpu_frame *frame, const struct gpu_draw *draw)
{
    struct gpu *gpu = frame->gpu;
    if (!frame_is_recording(frame)) {
        return;
    }
    struct gpu_raster *raster = draw->raster;
    struct program *program = &raster->program;
    struct hazards hazards = {0};
    tracker_next_command(&gpu->tracker);
    if (draw->indirect) {
        if (draw->indirect_offset % 4 != 0) {
            frame_fail(frame, STATUS_INVALID, "'%s': the indirect offset %zu is not a multiple of 4",
                       program->name, draw->indirect_offset);
            return;
        }
        if (!frame_check_range(frame, draw->indirect, draw->indirect_offset, sizeof(VkDrawIndirectCommand),
                               program->name)) {
            return;
        }
        tracker_require(&gpu->tracker, &hazards, &draw->indirect->history, USAGE_INDIRECT);
    }
    if (!frame_bind(frame, program, draw->binds, draw->bind_count, draw->push, &hazards)) {
        return;
    }
    begin_rendering(frame, raster);
    if (draw->indirect) {
        gpu->vk.vkCmdDrawIndirect(frame->commands, draw->indirect->handle, draw->indirect_offset, 1,
                                  sizeof(VkDrawIndirectCommand));
        frame_mark(frame, draw->indirect, USAGE_INDIRECT);
    } else {
        gpu->vk.vkCmdDraw(frame->commands, draw->vertex_count, draw->instance_count, 0, 0);
    }
    end_rendering(frame, raster);
    frame_mark_binds(frame, program, draw->binds, draw->bind_count);
    raster->drawn_serial = frame->serial;
}

void gpu_record_raster_read(struct gpu_frame *frame, struct gpu_raster *raster, struct gpu_buffer *target)
{
    const size_t pixel_bytes = raster->format == VK_FORMAT_R32G32B32A32_SFLOAT ? 16 : 8;
    const size_t size = (size_t)raster->width * raster->height * pixel_bytes;
    if (!frame_is_recording(frame) || !frame_check_range(frame, target, 0, size, raster->program.name)) {
        return;
    }
    if (raster->drawn_serial != frame->serial) {
        frame_fail(frame, STATUS_INVALID, "'%s' is read in a frame that has not drawn it",
                   raster->program.name);
        return;
    }
    frame_begin_transfer(frame, target, NULL);
    raster->program.serial = frame->serial;
    const VkBufferImageCopy region = {
        .imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1},
        .imageExtent = {raster->width, raster->height, 1},
    };
    frame->gpu->vk.vkCmdCopyImageToBuffer(frame->commands, raster->resolved.handle,
                                          VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, target->handle, 1, &region);
}
