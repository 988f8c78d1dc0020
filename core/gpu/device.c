/* device.c: finding a Vulkan device, opening and closing it. */
#define _GNU_SOURCE /* dl_iterate_phdr */
#include "gpu_internal.h"

#include <ctype.h>
#include <dlfcn.h>
#include <link.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define VALIDATION_LAYER "VK_LAYER_KHRONOS_validation"
#define MESA_HINT        "install a driver, on Debian and Ubuntu: apt install mesa-vulkan-drivers"

/* ---- messages ----------------------------------------------------------------------------------------- */

void gpu_log(const struct gpu *gpu, enum gpu_log_level level, const char *format, ...)
{
    char text[2048];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (gpu->log) {
        gpu->log(gpu->log_user, level, text);
    } else if (level != GPU_LOG_INFO) {
        fprintf(stderr, "gpu: %s: %s\n", level == GPU_LOG_ERROR ? "error" : "warning", text);
    }
}

static const char *result_text(VkResult result)
{
    switch (result) {
    case VK_ERROR_OUT_OF_HOST_MEMORY:
        return "out of host memory";
    case VK_ERROR_OUT_OF_DEVICE_MEMORY:
        return "out of device memory";
    case VK_ERROR_INITIALIZATION_FAILED:
        return "the driver could not be initialised";
    case VK_ERROR_DEVICE_LOST:
        return "the device was lost (crashed, reset or removed); it has to be opened again";
    case VK_ERROR_LAYER_NOT_PRESENT:
        return "a layer is missing";
    case VK_ERROR_EXTENSION_NOT_PRESENT:
        return "an extension is missing";
    case VK_ERROR_FEATURE_NOT_PRESENT:
        return "a feature is missing";
    case VK_ERROR_INCOMPATIBLE_DRIVER:
        return "no compatible driver";
    case VK_ERROR_TOO_MANY_OBJECTS:
        return "too many allocations";
    case VK_ERROR_OUT_OF_POOL_MEMORY:
    case VK_ERROR_FRAGMENTED_POOL:
        return "out of descriptors";
    default:
        return NULL;
    }
}

bool gpu_fail(struct gpu *gpu, struct error *error, VkResult result, const char *what, const char *name)
{
    const char *text = result_text(result);
    char number[32];
    if (!text) {
        snprintf(number, sizeof number, "Vulkan error %d", (int)result);
        text = number;
    }
    if (result == VK_ERROR_DEVICE_LOST) {
        gpu->is_lost = true;
    }
    const enum status status = result == VK_ERROR_OUT_OF_HOST_MEMORY ? STATUS_MEMORY : STATUS_DEVICE;
    if (name) {
        return error_set(error, status, "%s '%s': %s", what, name, text);
    }
    return error_set(error, status, "%s: %s", what, text);
}

void gpu_set_name(const struct gpu *gpu, VkObjectType type, uint64_t handle, const char *name)
{
    if (!gpu->has_debug_utils || !name) {
        return;
    }
    const VkDebugUtilsObjectNameInfoEXT info = {
        .sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_OBJECT_NAME_INFO_EXT,
        .objectType = type,
        .objectHandle = handle,
        .pObjectName = name,
    };
    vkSetDebugUtilsObjectNameEXT(gpu->device, &info);
}

static VKAPI_ATTR VkBool32 VKAPI_CALL on_message(VkDebugUtilsMessageSeverityFlagBitsEXT severity,
                                                 VkDebugUtilsMessageTypeFlagsEXT types,
                                                 const VkDebugUtilsMessengerCallbackDataEXT *data, void *user)
{
    struct gpu *gpu = user;
    /* The loader speaks through the same messenger (about other drivers' files, say); only what the layer
     * found counts. */
    const bool is_loader = data->pMessageIdName && strcmp(data->pMessageIdName, "Loader Message") == 0;
    const bool is_error = severity & VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
    (void)types;
    if (!is_loader) {
        __atomic_fetch_add(&gpu->validation_count, 1, __ATOMIC_RELAXED);
    }
    gpu_log(gpu, is_error && !is_loader ? GPU_LOG_ERROR : GPU_LOG_WARNING, "%s: %s",
            data->pMessageIdName ? data->pMessageIdName : "validation", data->pMessage);
    return VK_FALSE;
}

/* ---- instance ----------------------------------------------------------------------------------------- */

static bool has_extension(const VkExtensionProperties *list, uint32_t count, const char *name)
{
    for (uint32_t i = 0; i < count; i++) {
        if (strcmp(list[i].extensionName, name) == 0) {
            return true;
        }
    }
    return false;
}

static bool instance_has_extension(const char *layer, const char *name)
{
    uint32_t count = 0;
    if (vkEnumerateInstanceExtensionProperties(layer, &count, NULL) != VK_SUCCESS || count == 0) {
        return false;
    }
    VkExtensionProperties *list = calloc(count, sizeof *list);
    const bool found = list && vkEnumerateInstanceExtensionProperties(layer, &count, list) >= VK_SUCCESS &&
                       has_extension(list, count, name);
    free(list);
    return found;
}

static bool instance_has_layer(const char *name)
{
    uint32_t count = 0;
    bool found = false;
    if (vkEnumerateInstanceLayerProperties(&count, NULL) != VK_SUCCESS || count == 0) {
        return false;
    }
    VkLayerProperties *list = calloc(count, sizeof *list);
    if (list && vkEnumerateInstanceLayerProperties(&count, list) >= VK_SUCCESS) {
        for (uint32_t i = 0; i < count && !found; i++) {
            found = strcmp(list[i].layerName, name) == 0;
        }
    }
    free(list);
    return found;
}

/* volk keeps the loader's entry points in globals; they are the same for every instance. */
static pthread_mutex_t loader_lock = PTHREAD_MUTEX_INITIALIZER;
static bool loader_is_open;

static bool open_loader(struct error *error)
{
    pthread_mutex_lock(&loader_lock);
    if (!loader_is_open) {
        loader_is_open = volkInitialize() == VK_SUCCESS;
    }
    const bool is_open = loader_is_open;
    pthread_mutex_unlock(&loader_lock);
    if (!is_open) {
        return error_set(
            error, STATUS_DEVICE,
            "the Vulkan loader (libvulkan.so.1) is not installed: on Debian and Ubuntu, apt install "
            "libvulkan1 mesa-vulkan-drivers");
    }
    if (volkGetInstanceVersion() < VK_API_VERSION_1_3) {
        return error_set(error, STATUS_DEVICE,
                         "the Vulkan loader is older than Vulkan 1.3: install a newer libvulkan1");
    }
    return true;
}

#ifdef __SANITIZE_ADDRESS__
static int pin_module(struct dl_phdr_info *module, size_t size, void *data)
{
    (void)size;
    (void)data;
    if (module->dlpi_name && *module->dlpi_name) {
        dlopen(module->dlpi_name, RTLD_LAZY | RTLD_NOLOAD | RTLD_NODELETE);
    }
    return 0;
}

/* Drivers and layers are unloaded with the instance; a leak report could then not name them, so that their
 * leaks could not be told from ours. */
static void pin_modules(void)
{
    dl_iterate_phdr(pin_module, NULL);
}
#else
static void pin_modules(void)
{
}
#endif

/* `gpu` receives the messages of the validation layer, NULL: none are wanted. */
static bool create_instance(bool validation, struct gpu *gpu, VkInstance *instance, bool *has_debug_utils,
                            struct error *error)
{
    if (!open_loader(error)) {
        return false;
    }
    if (validation && !instance_has_layer(VALIDATION_LAYER)) {
        return error_set(error, STATUS_UNSUPPORTED,
                         "validation needs " VALIDATION_LAYER
                         ", which is not installed: on Debian and Ubuntu, "
                         "apt install vulkan-validationlayers");
    }
    const char *extensions[2];
    uint32_t extension_count = 0;
    *has_debug_utils =
        instance_has_extension(NULL, VK_EXT_DEBUG_UTILS_EXTENSION_NAME) ||
        (validation && instance_has_extension(VALIDATION_LAYER, VK_EXT_DEBUG_UTILS_EXTENSION_NAME));
    if (*has_debug_utils) {
        extensions[extension_count++] = VK_EXT_DEBUG_UTILS_EXTENSION_NAME;
    }
    if (validation) {
        extensions[extension_count++] = VK_EXT_VALIDATION_FEATURES_EXTENSION_NAME;
    }
    const VkApplicationInfo application = {
        .sType = VK_STRUCTURE_TYPE_APPLICATION_INFO,
        .pApplicationName = "causticd",
        .apiVersion = VK_API_VERSION_1_3,
    };
    static const VkValidationFeatureEnableEXT synchronisation =
        VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT;
    const VkDebugUtilsMessengerCreateInfoEXT messenger = {
        .sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT,
        .messageSeverity =
            VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT,
        .messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_GENERAL_BIT_EXT |
                       VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT |
                       VK_DEBUG_UTILS_MESSAGE_TYPE_PERFORMANCE_BIT_EXT,
        .pfnUserCallback = on_message,
        .pUserData = gpu,
    };
    const VkValidationFeaturesEXT features = {
        .sType = VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT,
        .pNext = *has_debug_utils ? &messenger : NULL,
        .enabledValidationFeatureCount = 1,
        .pEnabledValidationFeatures = &synchronisation,
    };
    const char *const layer = VALIDATION_LAYER;
    const VkInstanceCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO,
        .pNext = validation ? &features : NULL,
        .pApplicationInfo = &application,
        .enabledLayerCount = validation ? 1 : 0,
        .ppEnabledLayerNames = &layer,
        .enabledExtensionCount = extension_count,
        .ppEnabledExtensionNames = extensions,
    };
    const VkResult result = vkCreateInstance(&info, NULL, instance);
    if (result != VK_SUCCESS) {
        *instance = VK_NULL_HANDLE;
        const char *text = result_text(result);
        return error_set(error, result == VK_ERROR_OUT_OF_HOST_MEMORY ? STATUS_MEMORY : STATUS_DEVICE,
                         "there is no Vulkan device on this machine (%s): " MESA_HINT,
                         text ? text : "Vulkan failed");
    }
    pin_modules();
    pthread_mutex_lock(&loader_lock);
    volkLoadInstanceOnly(*instance);
    pthread_mutex_unlock(&loader_lock);
    if (validation && *has_debug_utils) {
        vkCreateDebugUtilsMessengerEXT(*instance, &messenger, NULL, &gpu->messenger);
    }
    return true;
}

/* ---- devices ------------------------------------------------------------------------------------------ */

struct candidate {
    VkPhysicalDevice physical;
    struct gpu_info info;
    uint32_t family;
    bool has_graphics;
    uint32_t timestamp_bits;
};

struct features {
    VkPhysicalDeviceFeatures2 core;
    VkPhysicalDeviceVulkan11Features v11;
    VkPhysicalDeviceVulkan12Features v12;
    VkPhysicalDeviceVulkan13Features v13;
    VkPhysicalDeviceAccelerationStructureFeaturesKHR acceleration;
    VkPhysicalDeviceRayQueryFeaturesKHR ray_query;
};

static void chain_features(struct features *features, bool with_ray_query)
{
    features->core.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
    features->core.pNext = &features->v11;
    features->v11.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_FEATURES;
    features->v11.pNext = &features->v12;
    features->v12.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES;
    features->v12.pNext = &features->v13;
    features->v13.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES;
    features->v13.pNext = with_ray_query ? &features->acceleration : NULL;
    features->acceleration.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ACCELERATION_STRUCTURE_FEATURES_KHR;
    features->acceleration.pNext = &features->ray_query;
    features->ray_query.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_RAY_QUERY_FEATURES_KHR;
}

static const char *const ray_query_extensions[] = {
    VK_KHR_ACCELERATION_STRUCTURE_EXTENSION_NAME,
    VK_KHR_RAY_QUERY_EXTENSION_NAME,
    VK_KHR_DEFERRED_HOST_OPERATIONS_EXTENSION_NAME,
};
#define RAY_QUERY_EXTENSION_COUNT (sizeof ray_query_extensions / sizeof *ray_query_extensions)

static bool device_has_ray_query(VkPhysicalDevice physical)
{
    uint32_t count = 0;
    if (vkEnumerateDeviceExtensionProperties(physical, NULL, &count, NULL) != VK_SUCCESS || count == 0) {
        return false;
    }
    VkExtensionProperties *list = calloc(count, sizeof *list);
    bool found = list && vkEnumerateDeviceExtensionProperties(physical, NULL, &count, list) >= VK_SUCCESS;
    for (uint32_t i = 0; found && i < RAY_QUERY_EXTENSION_COUNT; i++) {
        found = has_extension(list, count, ray_query_extensions[i]);
    }
    free(list);
    if (!found) {
        return false;
    }
    struct features features = {0};
    chain_features(&features, true);
    vkGetPhysicalDeviceFeatures2(physical, &features.core);
    return features.acceleration.accelerationStructure && features.ray_query.rayQuery &&
           features.v12.bufferDeviceAddress;
}

static enum gpu_device_type device_type(VkPhysicalDeviceType type)
{
    switch (type) {
    case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU:
        return GPU_DEVICE_INTEGRATED;
    case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU:
        return GPU_DEVICE_DISCRETE;
    case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU:
        return GPU_DEVICE_VIRTUAL;
    case VK_PHYSICAL_DEVICE_TYPE_CPU:
        return GPU_DEVICE_CPU;
    default:
        return GPU_DEVICE_OTHER;
    }
}

static uint32_t highest_bit(uint32_t bits)
{
    while (bits & (bits - 1)) {
        bits &= bits - 1;
    }
    return bits;
}

/* Fills *candidate; false when the device cannot serve: below Vulkan 1.3 or without a compute queue. */
static bool inspect(VkPhysicalDevice physical, struct candidate *candidate)
{
    VkPhysicalDeviceVulkan13Properties v13 = {.sType =
                                                  VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_PROPERTIES};
    VkPhysicalDeviceVulkan12Properties v12 = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_PROPERTIES, .pNext = &v13};
    VkPhysicalDeviceVulkan11Properties v11 = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_PROPERTIES, .pNext = &v12};
    VkPhysicalDeviceProperties2 properties = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2,
                                              .pNext = &v11};
    VkPhysicalDeviceProperties version;
    vkGetPhysicalDeviceProperties(physical, &version);
    if (version.apiVersion < VK_API_VERSION_1_3) {
        return false;
    }
    vkGetPhysicalDeviceProperties2(physical, &properties);
    *candidate = (struct candidate){.physical = physical};

    VkQueueFamilyProperties families[32];
    uint32_t family_count = sizeof families / sizeof *families;
    vkGetPhysicalDeviceQueueFamilyProperties(physical, &family_count, families);
    bool has_compute = false;
    for (uint32_t i = 0; i < family_count; i++) {
        const bool has_graphics = families[i].queueFlags & VK_QUEUE_GRAPHICS_BIT;
        if (!(families[i].queueFlags & VK_QUEUE_COMPUTE_BIT) || (has_compute && !has_graphics)) {
            continue;
        }
        has_compute = true;
        candidate->family = i;
        candidate->has_graphics = has_graphics;
        candidate->timestamp_bits = families[i].timestampValidBits;
        if (has_graphics) {
            break;
        }
    }

    struct gpu_info *info = &candidate->info;
    const VkPhysicalDeviceLimits *limits = &properties.properties.limits;
    snprintf(info->name, sizeof info->name, "%s", properties.properties.deviceName);
    snprintf(info->driver, sizeof info->driver, "%.60s, %.60s", v12.driverName, v12.driverInfo);
    info->type = device_type(properties.properties.deviceType);
    info->has_ray_query = device_has_ray_query(physical);
    info->has_hardware_ray_tracing = info->has_ray_query && info->type != GPU_DEVICE_CPU;
    struct features features = {0};
    chain_features(&features, false);
    vkGetPhysicalDeviceFeatures2(physical, &features.core);
    info->has_int64_atomics = features.core.features.shaderInt64 && features.v12.shaderBufferInt64Atomics;
    info->max_storage_bytes = limits->maxStorageBufferRange;
    if (v11.maxMemoryAllocationSize < info->max_storage_bytes) {
        info->max_storage_bytes = v11.maxMemoryAllocationSize;
    }
    if (v13.maxBufferSize < info->max_storage_bytes) {
        info->max_storage_bytes = v13.maxBufferSize;
    }
    info->max_storage_bytes = info->max_storage_bytes / BUFFER_ALIGNMENT * BUFFER_ALIGNMENT;
    VkPhysicalDeviceMemoryProperties memory;
    vkGetPhysicalDeviceMemoryProperties(physical, &memory);
    for (uint32_t i = 0; i < memory.memoryHeapCount; i++) {
        if ((memory.memoryHeaps[i].flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT) &&
            memory.memoryHeaps[i].size > info->memory_bytes) {
            info->memory_bytes = memory.memoryHeaps[i].size;
        }
    }
    info->max_image_size = limits->maxImageDimension2D;
    VkImageFormatProperties format;
    info->max_samples = 1;
    if (vkGetPhysicalDeviceImageFormatProperties(physical, VK_FORMAT_R32G32B32A32_SFLOAT, VK_IMAGE_TYPE_2D,
                                                 VK_IMAGE_TILING_OPTIMAL, VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT,
                                                 0, &format) == VK_SUCCESS) {
        info->max_samples = highest_bit(format.sampleCounts & limits->framebufferColorSampleCounts);
    }
    info->subgroup_size = v11.subgroupSize;
    info->timestamp_period_ns = candidate->timestamp_bits ? (double)limits->timestampPeriod : 0;
    return has_compute;
}

/* The devices that can serve, in the loader's order; free(*candidates). */
static bool find_devices(VkInstance instance, struct candidate **candidates, uint32_t *count,
                         struct error *error)
{
    *candidates = NULL;
    *count = 0;
    uint32_t total = 0;
    vkEnumeratePhysicalDevices(instance, &total, NULL);
    if (total == 0) {
        return true;
    }
    VkPhysicalDevice *physicals = calloc(total, sizeof(VkPhysicalDevice));
    *candidates = calloc(total, sizeof **candidates);
    if (!physicals || !*candidates) {
        free(physicals);
        free(*candidates);
        *candidates = NULL;
        return error_set(error, STATUS_MEMORY, "out of host memory while listing Vulkan devices");
    }
    if (vkEnumeratePhysicalDevices(instance, &total, physicals) < VK_SUCCESS) {
        total = 0;
    }
    for (uint32_t i = 0; i < total; i++) {
        if (inspect(physicals[i], &(*candidates)[*count])) {
            (*count)++;
        }
    }
    free(physicals);
    return true;
}

uint32_t gpu_list(struct gpu_info *infos, uint32_t capacity)
{
    struct error error;
    VkInstance instance;
    bool has_debug_utils;
    struct candidate *candidates;
    uint32_t count = 0;
    if (!create_instance(false, NULL, &instance, &has_debug_utils, &error)) {
        return 0;
    }
    if (find_devices(instance, &candidates, &count, &error)) {
        for (uint32_t i = 0; i < count && i < capacity; i++) {
            infos[i] = candidates[i].info;
        }
        free(candidates);
    }
    vkDestroyInstance(instance, NULL);
    return count;
}

static bool contains_ignoring_case(const char *text, const char *part)
{
    for (; *text; text++) {
        size_t i = 0;
        while (part[i] && tolower((unsigned char)text[i]) == tolower((unsigned char)part[i])) {
            i++;
        }
        if (!part[i]) {
            return true;
        }
    }
    return false;
}

/* Higher is better. */
static int device_rank(enum gpu_device_type type)
{
    switch (type) {
    case GPU_DEVICE_DISCRETE:
        return 4;
    case GPU_DEVICE_INTEGRATED:
        return 3;
    case GPU_DEVICE_VIRTUAL:
        return 2;
    case GPU_DEVICE_CPU:
        return 1;
    default:
        return 0;
    }
}

static const struct candidate *choose(const struct candidate *candidates, uint32_t count, const char *wish,
                                      struct error *error)
{
    if (count == 0) {
        error_set(error, STATUS_DEVICE, "there is no Vulkan 1.3 device on this machine: " MESA_HINT);
        return NULL;
    }
    char *end = NULL;
    const unsigned long index = wish && *wish ? strtoul(wish, &end, 10) : 0;
    const bool is_index = end && isdigit((unsigned char)*wish) && *end == '\0';
    const struct candidate *best = NULL;
    for (uint32_t i = 0; i < count; i++) {
        if (is_index ? index != i
                     : wish && !(*wish && contains_ignoring_case(candidates[i].info.name, wish))) {
            continue;
        }
        if (!best || device_rank(candidates[i].info.type) > device_rank(best->info.type)) {
            best = &candidates[i];
        }
    }
    if (!best) {
        char list[320] = "";
        size_t used = 0;
        for (uint32_t i = 0; i < count && used < sizeof list; i++) {
            used += (size_t)snprintf(list + used, sizeof list - used, "%s%u: %s", i ? "; " : "", i,
                                     candidates[i].info.name);
        }
        error_set(error, STATUS_NOT_FOUND, "no Vulkan device matches '%.100s'; there is %s", wish, list);
    }
    return best;
}

static VkResult create_device(struct gpu *gpu)
{
    struct features supported = {0};
    chain_features(&supported, gpu->info.has_ray_query);
    vkGetPhysicalDeviceFeatures2(gpu->physical, &supported.core);
    gpu->has_float64 = supported.core.features.shaderFloat64;
    gpu->has_int16 = supported.core.features.shaderInt16;
    gpu->has_float16 = supported.v12.shaderFloat16;
    gpu->has_int8 = supported.v12.shaderInt8;
    gpu->has_sample_shading = supported.core.features.sampleRateShading;
    gpu->has_fragment_stores = supported.core.features.fragmentStoresAndAtomics;

    struct features features = {0};
    chain_features(&features, gpu->info.has_ray_query);
    /* Scenes and settings come from outside: an access past a buffer must stay harmless. */
    features.core.features.robustBufferAccess = VK_TRUE;
    features.core.features.shaderInt64 = supported.core.features.shaderInt64;
    features.core.features.shaderFloat64 = supported.core.features.shaderFloat64;
    features.core.features.shaderInt16 = supported.core.features.shaderInt16;
    features.core.features.sampleRateShading = supported.core.features.sampleRateShading;
    features.core.features.vertexPipelineStoresAndAtomics =
        supported.core.features.vertexPipelineStoresAndAtomics;
    features.core.features.fragmentStoresAndAtomics = supported.core.features.fragmentStoresAndAtomics;
    features.v11.storageBuffer16BitAccess = supported.v11.storageBuffer16BitAccess;
    features.v12.storageBuffer8BitAccess = supported.v12.storageBuffer8BitAccess;
    features.v12.shaderBufferInt64Atomics = supported.v12.shaderBufferInt64Atomics;
    features.v12.shaderFloat16 = supported.v12.shaderFloat16;
    features.v12.shaderInt8 = supported.v12.shaderInt8;
    features.v12.scalarBlockLayout = supported.v12.scalarBlockLayout;
    features.v12.vulkanMemoryModel = supported.v12.vulkanMemoryModel;
    features.v12.vulkanMemoryModelDeviceScope = supported.v12.vulkanMemoryModelDeviceScope;
    features.v13.synchronization2 = VK_TRUE;
    features.v13.dynamicRendering = VK_TRUE;
    features.v13.maintenance4 = VK_TRUE;
    if (gpu->info.has_ray_query) {
        features.v12.bufferDeviceAddress = VK_TRUE;
        features.acceleration.accelerationStructure = VK_TRUE;
        features.ray_query.rayQuery = VK_TRUE;
        VkPhysicalDeviceAccelerationStructurePropertiesKHR acceleration = {
            .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ACCELERATION_STRUCTURE_PROPERTIES_KHR};
        VkPhysicalDeviceProperties2 properties = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2,
                                                  .pNext = &acceleration};
        vkGetPhysicalDeviceProperties2(gpu->physical, &properties);
        gpu->scratch_alignment = acceleration.minAccelerationStructureScratchOffsetAlignment;
    }
    const float priority = 1;
    const VkDeviceQueueCreateInfo queue = {
        .sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO,
        .queueFamilyIndex = gpu->queue_family,
        .queueCount = 1,
        .pQueuePriorities = &priority,
    };
    const VkDeviceCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO,
        .pNext = &features.core,
        .queueCreateInfoCount = 1,
        .pQueueCreateInfos = &queue,
        .enabledExtensionCount = gpu->info.has_ray_query ? (uint32_t)RAY_QUERY_EXTENSION_COUNT : 0,
        .ppEnabledExtensionNames = ray_query_extensions,
    };
    const VkResult result = vkCreateDevice(gpu->physical, &info, NULL, &gpu->device);
    if (result == VK_SUCCESS) {
        volkLoadDeviceTable(&gpu->vk, gpu->device);
        gpu->vk.vkGetDeviceQueue(gpu->device, gpu->queue_family, 0, &gpu->queue);
    }
    return result;
}

static bool create_immediate(struct gpu *gpu, struct error *error)
{
    const VkCommandPoolCreateInfo pool = {
        .sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO,
        .flags = VK_COMMAND_POOL_CREATE_TRANSIENT_BIT,
        .queueFamilyIndex = gpu->queue_family,
    };
    VkResult result = gpu->vk.vkCreateCommandPool(gpu->device, &pool, NULL, &gpu->immediate_pool);
    if (result == VK_SUCCESS) {
        const VkCommandBufferAllocateInfo commands = {
            .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
            .commandPool = gpu->immediate_pool,
            .level = VK_COMMAND_BUFFER_LEVEL_PRIMARY,
            .commandBufferCount = 1,
        };
        result = gpu->vk.vkAllocateCommandBuffers(gpu->device, &commands, &gpu->immediate_commands);
    }
    if (result == VK_SUCCESS) {
        const VkFenceCreateInfo fence = {.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO};
        result = gpu->vk.vkCreateFence(gpu->device, &fence, NULL, &gpu->immediate_fence);
    }
    return result == VK_SUCCESS ||
           gpu_fail(gpu, error, result, "cannot create command buffers on", gpu->info.name);
}

struct gpu *gpu_create(const struct gpu_params *params, struct error *error)
{
    struct candidate *candidates = NULL;
    uint32_t count = 0;
    struct gpu *gpu = calloc(1, sizeof *gpu);
    if (!gpu) {
        error_set(error, STATUS_MEMORY, "out of host memory while opening a Vulkan device");
        return NULL;
    }
    gpu->log = params->log;
    gpu->log_user = params->log_user;
    if (!create_instance(params->validation, gpu, &gpu->instance, &gpu->has_debug_utils, error) ||
        !find_devices(gpu->instance, &candidates, &count, error)) {
        goto fail;
    }
    const struct candidate *chosen = choose(candidates, count, params->device, error);
    if (!chosen) {
        goto fail;
    }
    gpu->info = chosen->info;
    if (params->max_storage_bytes > 0 && params->max_storage_bytes < gpu->info.max_storage_bytes) {
        gpu->info.max_storage_bytes = params->max_storage_bytes / BUFFER_ALIGNMENT * BUFFER_ALIGNMENT;
    }
    gpu->physical = chosen->physical;
    gpu->queue_family = chosen->family;
    gpu->has_graphics = chosen->has_graphics;
    gpu->timestamp_bits = chosen->timestamp_bits;
    vkGetPhysicalDeviceMemoryProperties(gpu->physical, &gpu->memory_properties);
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(gpu->physical, &properties);
    gpu->limits = properties.limits;

    const VkResult result = create_device(gpu);
    if (result != VK_SUCCESS) {
        gpu->device = VK_NULL_HANDLE;
        gpu_fail(gpu, error, result, "cannot open the Vulkan device", gpu->info.name);
        goto fail;
    }
    if (!create_immediate(gpu, error)) {
        goto fail;
    }
    for (uint32_t i = 0; i < FRAME_RING; i++) {
        if (!frame_init(&gpu->frames[i], gpu, error)) {
            goto fail;
        }
    }
    cache_open(gpu, params->cache_dir);
    gpu_log(gpu, GPU_LOG_INFO, "%s (%s), ray query: %s", gpu->info.name, gpu->info.driver,
            gpu->info.has_ray_query ? "yes" : "no");
    free(candidates);
    return gpu;

fail:
    free(candidates);
    gpu_destroy(&gpu);
    return NULL;
}

void gpu_destroy(struct gpu **pointer)
{
    struct gpu *gpu = *pointer;
    if (!gpu) {
        return;
    }
    *pointer = NULL;
    if (gpu->device) {
        gpu->vk.vkDeviceWaitIdle(gpu->device);
        gpu_save_cache(gpu);
        for (uint32_t i = 0; i < FRAME_RING; i++) {
            frame_finish(&gpu->frames[i]);
        }
        if (gpu->object_count) {
            gpu_log(gpu, GPU_LOG_ERROR, "%u objects made from the device outlive it", gpu->object_count);
        }
        gpu->vk.vkDestroyFence(gpu->device, gpu->immediate_fence, NULL);
        gpu->vk.vkDestroyCommandPool(gpu->device, gpu->immediate_pool, NULL);
        gpu->vk.vkDestroyPipelineCache(gpu->device, gpu->cache, NULL);
        gpu->vk.vkDestroyDevice(gpu->device, NULL);
    }
    if (gpu->messenger) {
        vkDestroyDebugUtilsMessengerEXT(gpu->instance, gpu->messenger, NULL);
    }
    if (gpu->instance) {
        vkDestroyInstance(gpu->instance, NULL);
    }
    free(gpu->cache_path);
    free(gpu);
}

const struct gpu_info *gpu_info(const struct gpu *gpu)
{
    return &gpu->info;
}

uint64_t gpu_validation_count(const struct gpu *gpu)
{
    return __atomic_load_n(&gpu->validation_count, __ATOMIC_RELAXED);
}

uint64_t gpu_memory_in_use(const struct gpu *gpu)
{
    return gpu->memory_in_use;
}
