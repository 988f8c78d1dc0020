/* cache.c: the pipeline cache on disk.
 *
 * One file per device and driver build: a header of ours (magic, size, hash) and the driver's bytes. Drivers
 * check only the first 32 of those, so a damaged file is recognised here, by the hash, and ignored.
 */
#include "gpu_internal.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define CACHE_MAGIC     0x3165686361637063u /* "cpcache1" */
#define CACHE_MAX_BYTES ((size_t)256 << 20)

struct cache_header {
    uint64_t magic, size, hash;
};

/* FNV-1a, 64 bits. */
static uint64_t hash_bytes(const void *bytes, size_t size)
{
    uint64_t hash = 0xcbf29ce484222325u;
    for (size_t i = 0; i < size; i++) {
        hash = (hash ^ ((const uint8_t *)bytes)[i]) * 0x100000001b3u;
    }
    return hash;
}

static bool make_folders(char *path)
{
    for (char *slash = strchr(path + 1, '/'); slash; slash = strchr(slash + 1, '/')) {
        *slash = '\0';
        const bool failed = mkdir(path, 0777) != 0 && errno != EEXIST;
        *slash = '/';
        if (failed) {
            return false;
        }
    }
    return true;
}

static char *cache_file_path(const struct gpu *gpu, const char *folder)
{
    char start[3072];
    const char *xdg = getenv("XDG_CACHE_HOME"), *home = getenv("HOME");
    int length;
    if (folder) {
        length = snprintf(start, sizeof start, "%s", folder);
    } else if (xdg && *xdg) {
        length = snprintf(start, sizeof start, "%s/causticd", xdg);
    } else if (home && *home) {
        length = snprintf(start, sizeof start, "%s/.cache/causticd", home);
    } else {
        return NULL;
    }
    if (length <= 0 || (size_t)length >= sizeof start) {
        return NULL;
    }
    VkPhysicalDeviceIDProperties id = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ID_PROPERTIES};
    VkPhysicalDeviceProperties2 properties = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2,
                                              .pNext = &id};
    vkGetPhysicalDeviceProperties2(gpu->physical, &properties);
    /* The driver's text too: lavapipe 22.3 gives every build the same UUID (docs/drivers.md). */
    char driver[2 * VK_UUID_SIZE + sizeof gpu->info.driver] = {0};
    memcpy(driver, properties.properties.pipelineCacheUUID, VK_UUID_SIZE);
    memcpy(driver + VK_UUID_SIZE, id.driverUUID, VK_UUID_SIZE);
    memcpy(driver + 2 * VK_UUID_SIZE, gpu->info.driver, sizeof gpu->info.driver);
    char path[4096];
    length = snprintf(path, sizeof path, "%s/pipelines-%04x-%04x-%016llx.bin", start,
                      properties.properties.vendorID, properties.properties.deviceID,
                      (unsigned long long)hash_bytes(driver, sizeof driver));
    return length > 0 && (size_t)length < sizeof path ? strdup(path) : NULL;
}

/* The driver's bytes out of the file, NULL when there is no usable file. */
static void *read_cache(const struct gpu *gpu, size_t *size)
{
    struct cache_header header;
    void *bytes = NULL;
    FILE *file = fopen(gpu->cache_path, "rb");
    if (!file) {
        return NULL;
    }
    bool is_good = fread(&header, sizeof header, 1, file) == 1 && header.magic == CACHE_MAGIC &&
                   header.size > 0 && header.size <= CACHE_MAX_BYTES &&
                   (bytes = malloc(header.size)) != NULL &&
                   fread(bytes, 1, header.size, file) == header.size && fgetc(file) == EOF &&
                   hash_bytes(bytes, header.size) == header.hash;
    fclose(file);
    if (!is_good) {
        gpu_log(gpu, GPU_LOG_INFO, "ignoring the damaged pipeline cache %s", gpu->cache_path);
        free(bytes);
        return NULL;
    }
    *size = header.size;
    return bytes;
}

void cache_open(struct gpu *gpu, const char *folder)
{
    gpu->cache_path = cache_file_path(gpu, folder);
    if (gpu->cache_path && !make_folders(gpu->cache_path)) {
        gpu_log(gpu, GPU_LOG_WARNING, "pipelines will not be kept: cannot create the folder of %s: %s",
                gpu->cache_path, strerror(errno));
        free(gpu->cache_path);
        gpu->cache_path = NULL;
    }
    size_t size = 0;
    void *bytes = gpu->cache_path ? read_cache(gpu, &size) : NULL;
    const VkPipelineCacheCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_CACHE_CREATE_INFO,
        .initialDataSize = bytes ? size : 0,
        .pInitialData = bytes,
    };
    /* Pipelines are made without a cache when there is none. */
    if (gpu->vk.vkCreatePipelineCache(gpu->device, &info, NULL, &gpu->cache) != VK_SUCCESS) {
        gpu->cache = VK_NULL_HANDLE;
    }
    gpu->cache_hash = bytes ? hash_bytes(bytes, size) : 0;
    free(bytes);
}

static bool write_cache(const char *path, const struct cache_header *header, const void *bytes)
{
    char temporary[4200];
    snprintf(temporary, sizeof temporary, "%s.XXXXXX", path);
    const int descriptor = mkstemp(temporary);
    if (descriptor < 0) {
        return false;
    }
    FILE *file = fdopen(descriptor, "wb");
    if (!file) {
        close(descriptor);
        unlink(temporary);
        return false;
    }
    bool is_written =
        fwrite(header, sizeof *header, 1, file) == 1 && fwrite(bytes, 1, header->size, file) == header->size;
    is_written = fclose(file) == 0 && is_written && rename(temporary, path) == 0;
    if (!is_written) {
        unlink(temporary);
    }
    return is_written;
}

void gpu_save_cache(struct gpu *gpu)
{
    size_t size = 0;
    if (!gpu->cache_path || !gpu->cache ||
        gpu->vk.vkGetPipelineCacheData(gpu->device, gpu->cache, &size, NULL) != VK_SUCCESS || size == 0 ||
        size > CACHE_MAX_BYTES) {
        return;
    }
    void *bytes = malloc(size);
    if (bytes && gpu->vk.vkGetPipelineCacheData(gpu->device, gpu->cache, &size, bytes) == VK_SUCCESS) {
        const struct cache_header header = {
            .magic = CACHE_MAGIC, .size = size, .hash = hash_bytes(bytes, size)};
        if (header.hash != gpu->cache_hash) {
            if (write_cache(gpu->cache_path, &header, bytes)) {
                gpu->cache_hash = header.hash;
            } else {
                gpu_log(gpu, GPU_LOG_WARNING, "cannot write the pipeline cache %s: %s", gpu->cache_path,
                        strerror(errno));
            }
        }
    }
    free(bytes);
}
