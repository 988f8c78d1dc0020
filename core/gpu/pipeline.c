/* pipeline.c: shader modules, layouts and compute pipelines. */
#include "gpu_internal.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SPIRV_MAGIC         0x07230203u
#define SPIRV_OP_CAPABILITY 17u

/* Capabilities that only some devices have, by their number in the SPIR-V specification. A shader that asks
 * for one the device lacks would be undefined behaviour; here it becomes an error with a name. */
static const char *missing_capability(const struct gpu *gpu, uint32_t capability)
{
    switch (capability) {
    case 9:
        return gpu->has_float16 ? NULL : "16-bit floats";
    case 10:
        return gpu->has_float64 ? NULL : "64-bit floats";
    case 11:
    case 12:
        return gpu->info.has_int64_atomics ? NULL : "64-bit integers and atomics";
    case 22:
        return gpu->has_int16 ? NULL : "16-bit integers";
    case 35:
        return gpu->has_sample_shading ? NULL : "per-sample shading";
    case 39:
        return gpu->has_int8 ? NULL : "8-bit integers";
    case 4472:
        return gpu->info.has_ray_query ? NULL : "ray queries";
    default:
        return NULL;
    }
}

static bool check_spirv(const struct gpu *gpu, const char *name, const uint32_t *spirv, size_t bytes,
                        struct error *error)
{
    const size_t words = bytes / 4;
    if (!spirv || bytes % 4 != 0 || words < 5 || spirv[0] != SPIRV_MAGIC) {
        return error_set(error, STATUS_INVALID, "the shader of '%s' is not SPIR-V", name);
    }
    /* Capabilities come first in a module. */
    for (size_t i = 5; i < words && (spirv[i] & 0xffff) == SPIRV_OP_CAPABILITY;) {
        const uint32_t length = spirv[i] >> 16;
        const char *missing = length >= 2 && i + 1 < words ? missing_capability(gpu, spirv[i + 1]) : NULL;
        if (missing) {
            return error_set(error, STATUS_UNSUPPORTED, "the shader of '%s' needs %s, which %s does not have",
                             name, missing, gpu->info.name);
        }
        i += length > 0 ? length : 1;
    }
    return true;
}

VkShaderModule shader_module_create(struct gpu *gpu, const char *name, const uint32_t *spirv, size_t bytes,
                                    struct error *error)
{
    if (!check_spirv(gpu, name, spirv, bytes, error)) {
        return VK_NULL_HANDLE;
    }
    const VkShaderModuleCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO,
        .codeSize = bytes,
        .pCode = spirv,
    };
    VkShaderModule module = VK_NULL_HANDLE;
    const VkResult result = gpu->vk.vkCreateShaderModule(gpu->device, &info, NULL, &module);
    if (result != VK_SUCCESS) {
        gpu_fail(gpu, error, result, "cannot load the shader of", name);
        return VK_NULL_HANDLE;
    }
    return module;
}

bool specialisation_create(struct specialisation *specialisation, const struct gpu_constant *constants,
                           uint32_t count, struct error *error)
{
    *specialisation = (struct specialisation){0};
    if (count == 0) {
        return true;
    }
    specialisation->entries = calloc(count, sizeof *specialisation->entries);
    specialisation->values = calloc(count, sizeof *specialisation->values);
    if (!specialisation->entries || !specialisation->values) {
        specialisation_destroy(specialisation);
        return error_set(error, STATUS_MEMORY, "out of host memory for %u specialisation constants", count);
    }
    for (uint32_t i = 0; i < count; i++) {
        specialisation->values[i] = constants[i].value;
        specialisation->entries[i] = (VkSpecializationMapEntry){
            .constantID = constants[i].id,
            .offset = i * (uint32_t)sizeof(uint32_t),
            .size = sizeof(uint32_t),
        };
    }
    specialisation->info = (VkSpecializationInfo){
        .mapEntryCount = count,
        .pMapEntries = specialisation->entries,
        .dataSize = count * sizeof(uint32_t),
        .pData = specialisation->values,
    };
    return true;
}

void specialisation_destroy(struct specialisation *specialisation)
{
    free(specialisation->entries);
    free(specialisation->values);
    *specialisation = (struct specialisation){0};
}

bool program_create_layout(struct program *program, struct gpu *gpu, const char *name, uint32_t binding_mask,
                           uint32_t accel_mask, uint32_t push_bytes, VkShaderStageFlags stages,
                           struct error *error)
{
    program->gpu = gpu;
    program->binding_mask = binding_mask;
    program->accel_mask = accel_mask;
    program->push_bytes = push_bytes;
    program->stages = stages;
    snprintf(program->name, sizeof program->name, "%s", name ? name : "pipeline");
    gpu->object_count++;
    if (push_bytes > 128 || push_bytes % 4 != 0) {
        return error_set(error, STATUS_LIMIT,
                         "'%s' has %u bytes of push constants; a multiple of 4 up to 128 is possible",
                         program->name, push_bytes);
    }
    if (accel_mask & ~binding_mask) {
        return error_set(error, STATUS_INVALID,
                         "'%s' has acceleration structures at bindings it does not use", program->name);
    }
    if (accel_mask && !gpu->info.has_ray_query) {
        return error_set(error, STATUS_UNSUPPORTED, "'%s' needs ray queries, which %s does not have",
                         program->name, gpu->info.name);
    }
    VkDescriptorSetLayoutBinding bindings[MAX_BINDINGS];
    uint32_t count = 0, storage_count = 0;
    for (uint32_t i = 0; i < MAX_BINDINGS; i++) {
        if (!(binding_mask & 1u << i)) {
            continue;
        }
        const bool is_accel = accel_mask & 1u << i;
        bindings[count++] = (VkDescriptorSetLayoutBinding){
            .binding = i,
            .descriptorType =
                is_accel ? VK_DESCRIPTOR_TYPE_ACCELERATION_STRUCTURE_KHR : VK_DESCRIPTOR_TYPE_STORAGE_BUFFER,
            .descriptorCount = 1,
            .stageFlags = stages,
        };
        storage_count += is_accel ? 0 : 1;
    }
    const uint32_t storage_limit =
        gpu->limits.maxPerStageDescriptorStorageBuffers < gpu->limits.maxDescriptorSetStorageBuffers
            ? gpu->limits.maxPerStageDescriptorStorageBuffers
            : gpu->limits.maxDescriptorSetStorageBuffers;
    if (storage_count > storage_limit) {
        return error_set(error, STATUS_LIMIT, "'%s' binds %u storage buffers; %s allows %u", program->name,
                         storage_count, gpu->info.name, storage_limit);
    }
    const VkDescriptorSetLayoutCreateInfo set = {
        .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO,
        .bindingCount = count,
        .pBindings = bindings,
    };
    VkResult result = gpu->vk.vkCreateDescriptorSetLayout(gpu->device, &set, NULL, &program->set_layout);
    if (result == VK_SUCCESS) {
        const VkPushConstantRange range = {.stageFlags = stages, .size = push_bytes};
        const VkPipelineLayoutCreateInfo layout = {
            .sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO,
            .setLayoutCount = 1,
            .pSetLayouts = &program->set_layout,
            .pushConstantRangeCount = push_bytes ? 1 : 0,
            .pPushConstantRanges = &range,
        };
        result = gpu->vk.vkCreatePipelineLayout(gpu->device, &layout, NULL, &program->layout);
    }
    return result == VK_SUCCESS || gpu_fail(gpu, error, result, "cannot create the layout of", program->name);
}

void program_destroy(struct program *program)
{
    struct gpu *gpu = program->gpu;
    frames_release(gpu, program->serial, program->name);
    gpu->vk.vkDestroyPipeline(gpu->device, program->handle, NULL);
    gpu->vk.vkDestroyPipelineLayout(gpu->device, program->layout, NULL);
    gpu->vk.vkDestroyDescriptorSetLayout(gpu->device, program->set_layout, NULL);
    gpu->object_count--;
}

struct gpu_pipeline *gpu_pipeline_create(struct gpu *gpu, const struct gpu_pipeline_params *params,
                                         struct error *error)
{
    const char *name = params->name ? params->name : "pipeline";
    struct gpu_pipeline *pipeline = calloc(1, sizeof *pipeline);
    if (!pipeline) {
        error_set(error, STATUS_MEMORY, "out of host memory for pipeline '%s'", name);
        return NULL;
    }
    struct specialisation specialisation = {0};
    VkShaderModule module = VK_NULL_HANDLE;
    bool is_created =
        program_create_layout(&pipeline->program, gpu, name, params->binding_mask, params->accel_mask,
                              params->push_bytes, VK_SHADER_STAGE_COMPUTE_BIT, error) &&
        specialisation_create(&specialisation, params->constants, params->constant_count, error) &&
        (module = shader_module_create(gpu, name, params->spirv, params->spirv_bytes, error));
    if (is_created) {
        const VkComputePipelineCreateInfo info = {
            .sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO,
            .stage =
                {
                    .sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
                    .stage = VK_SHADER_STAGE_COMPUTE_BIT,
                    .module = module,
                    .pName = "main",
                    .pSpecializationInfo = params->constant_count ? &specialisation.info : NULL,
                },
            .layout = pipeline->program.layout,
        };
        const VkResult result = gpu->vk.vkCreateComputePipelines(gpu->device, gpu->cache, 1, &info, NULL,
                                                                 &pipeline->program.handle);
        is_created = result == VK_SUCCESS || gpu_fail(gpu, error, result, "cannot create pipeline", name);
    }
    gpu->vk.vkDestroyShaderModule(gpu->device, module, NULL);
    specialisation_destroy(&specialisation);
    if (!is_created) {
        pipeline->program.handle = VK_NULL_HANDLE;
        gpu_pipeline_destroy(&pipeline);
        return NULL;
    }
    gpu_set_name(gpu, VK_OBJECT_TYPE_PIPELINE, (uint64_t)pipeline->program.handle, name);
    return pipeline;
}

void gpu_pipeline_destroy(struct gpu_pipeline **pointer)
{
    struct gpu_pipeline *pipeline = *pointer;
    if (!pipeline) {
        return;
    }
    *pointer = NULL;
    program_destroy(&pipeline->program);
    free(pipeline);
}
