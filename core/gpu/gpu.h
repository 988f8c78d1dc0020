/* gpu.h: the Vulkan layer. Everything that calls vk* lives behind this header.
 *
 * It offers storage buffers, compute pipelines, one off-screen raster pipeline kind, acceleration structures
 * and a ring of frames. Shaders are compute shaders over storage buffers; every binding of a dispatch
 * declares its access, and the barriers between dispatches, copies and host reads follow from those
 * declarations: no caller writes a barrier or a descriptor set.
 *
 * Ownership: who creates destroys; x_destroy(&x) frees, sets NULL and accepts a NULL pointee. Destroying an
 * object waits until no frame in flight uses it.
 * Threads: a struct gpu and everything made from it is used by one thread at a time.
 * Baseline: core Vulkan 1.3, no extension. Ray queries are used when the device offers them.
 */
#ifndef CAUSTIC_GPU_H
#define CAUSTIC_GPU_H

#include <stddef.h>
#include <stdint.h>

#include "../status.h"

/* ---- device ------------------------------------------------------------------------------------------- */

enum gpu_log_level { GPU_LOG_INFO, GPU_LOG_WARNING, GPU_LOG_ERROR };
typedef void (*gpu_log_fn)(void *user, enum gpu_log_level level, const char *text);

struct gpu_params {
    const char *device; /* a number (index in the device list) or part of a name, case-insensitive; NULL: the
                           best: discrete, then integrated, then virtual, then CPU */
    const char *cache_dir; /* where the pipeline cache is kept; NULL: $XDG_CACHE_HOME or ~/.cache, in
                              causticd/; an unusable folder is a warning, not an error */
    bool validation; /* load VK_LAYER_KHRONOS_validation with synchronisation validation; an error when it
                        is not installed */
    uint64_t max_storage_bytes; /* as if the device took no larger storage buffers than this, to see what a
                                   smaller one does; 0: what it takes */
    gpu_log_fn log;             /* NULL: stderr, warnings and errors only */
    void *log_user;
};

enum gpu_device_type {
    GPU_DEVICE_OTHER,
    GPU_DEVICE_INTEGRATED,
    GPU_DEVICE_DISCRETE,
    GPU_DEVICE_VIRTUAL,
    GPU_DEVICE_CPU
};

struct gpu_info {
    char name[256];   /* as the driver gives it */
    char driver[128]; /* driver name and version text */
    enum gpu_device_type type;
    bool has_ray_query; /* VK_KHR_ray_query, acceleration_structure and what they need are enabled */
    bool has_hardware_ray_tracing; /* has_ray_query on a device that is not a CPU */
    bool has_int64_atomics;     /* shaders may use 64-bit integers and atomics on them in storage buffers */
    uint64_t max_storage_bytes; /* largest storage buffer a shader can see */
    uint64_t memory_bytes;      /* largest device-local heap */
    uint32_t max_image_size;    /* pixels along one side */
    uint32_t max_samples;       /* highest framebuffer sample count of an RGBA32F attachment */
    uint32_t subgroup_size;
    double timestamp_period_ns; /* 0: no timestamps on the compute queue */
};

struct gpu;

/* NULL and *error when there is no Vulkan 1.3 device (the text says which Debian/Ubuntu package to install:
 * mesa-vulkan-drivers), when `device` matches none (the text lists what there is), or when creation fails. */
struct gpu *gpu_create(const struct gpu_params *params, struct error *error);
void gpu_destroy(struct gpu **gpu);
const struct gpu_info *gpu_info(const struct gpu *gpu);

/* Fills up to `capacity` entries with the devices of this machine, returns how many there are (0: none). */
uint32_t gpu_list(struct gpu_info *infos, uint32_t capacity);

/* Warnings and errors the validation layer has reported since creation; 0 without `validation`. */
uint64_t gpu_validation_count(const struct gpu *gpu);

/* Bytes of device memory now allocated through this gpu. */
uint64_t gpu_memory_in_use(const struct gpu *gpu);

/* ---- buffers ------------------------------------------------------------------------------------------ */

enum gpu_memory {
    GPU_MEMORY_DEVICE,  /* device-local; filled by copies and shaders */
    GPU_MEMORY_UPLOAD,  /* mapped, written by the host */
    GPU_MEMORY_READBACK /* mapped, cached, read by the host after gpu_frame_wait */
};

struct gpu_buffer_params {
    const char *name; /* debug name, copied */
    size_t size;      /* bytes, at least 1, at most gpu_info.max_storage_bytes */
    enum gpu_memory memory;
    bool acceleration_input; /* also vertex, index or instance input of an acceleration structure */
};

struct gpu_buffer; /* contents are undefined until written */

struct gpu_buffer *gpu_buffer_create(struct gpu *gpu, const struct gpu_buffer_params *params,
                                     struct error *error);
void gpu_buffer_destroy(struct gpu_buffer **buffer);
size_t gpu_buffer_size(const struct gpu_buffer *buffer);
void *gpu_buffer_map(struct gpu_buffer *buffer); /* persistent, coherent; NULL for GPU_MEMORY_DEVICE */

/* Creates a device buffer and fills it, waiting for the copy. `size` 0 makes a 16-byte buffer of zeros, so
 * that an empty list can be bound. */
struct gpu_buffer *gpu_buffer_create_filled(struct gpu *gpu, const char *name, const void *data, size_t size,
                                            bool acceleration_input, struct error *error);

/* ---- acceleration structures (only with has_ray_query) ------------------------------------------------ */

struct gpu_accel; /* a bottom- or top-level acceleration structure with its backing buffer */

struct gpu_triangles {
    struct gpu_buffer *vertices; /* acceleration_input; float x, y, z at `vertex_stride` bytes */
    uint32_t vertex_stride, first_vertex, vertex_count;
    struct gpu_buffer *indices; /* acceleration_input; uint32, relative to first_vertex */
    uint32_t first_index, triangle_count;
};

struct gpu_accel_instance {
    struct gpu_accel *bottom;
    float object_to_world[12]; /* row-major 3x4 */
    uint32_t custom_index;     /* 24 bits */
};

/* Built before the call returns. Opaque geometry. */
struct gpu_accel *gpu_accel_create_bottom(struct gpu *gpu, const char *name,
                                          const struct gpu_triangles *triangles, struct error *error);
struct gpu_accel *gpu_accel_create_top(struct gpu *gpu, const char *name, uint32_t max_instances,
                                       struct error *error);
void gpu_accel_destroy(struct gpu_accel **accel);

/* ---- pipelines ---------------------------------------------------------------------------------------- */

struct gpu_constant {
    uint32_t id;    /* constant_id of the shader */
    uint32_t value; /* the 32 bits of an int, uint, bool or float */
};

struct gpu_pipeline_params {
    const char *name;      /* debug name, copied */
    const uint32_t *spirv; /* compute shader with entry point "main" */
    size_t spirv_bytes;
    const struct gpu_constant *constants;
    uint32_t constant_count;
    uint32_t binding_mask; /* bit i: set 0, binding i is used; a storage buffer unless in accel_mask */
    uint32_t accel_mask;   /* bit i: binding i is a top-level acceleration structure */
    uint32_t push_bytes;   /* push constants, at most 128 */
};

struct gpu_pipeline;

struct gpu_pipeline *gpu_pipeline_create(struct gpu *gpu, const struct gpu_pipeline_params *params,
                                         struct error *error);
void gpu_pipeline_destroy(struct gpu_pipeline **pipeline);

/* Writes the pipeline cache to disk when it has changed (atomically: temporary file, rename). Also done by
 * gpu_destroy. */
void gpu_save_cache(struct gpu *gpu);

/* ---- frames ------------------------------------------------------------------------------------------- */

enum gpu_access {
    GPU_READ = 1,      /* storage buffer read, or acceleration structure */
    GPU_WRITE = 2,     /* storage buffer written, old contents of what is not written stay */
    GPU_READ_WRITE = 3 /* both, atomics included */
};

struct gpu_bind {
    uint32_t binding;
    enum gpu_access access;
    struct gpu_buffer *buffer; /* whole buffer */
    struct gpu_accel *accel;   /* instead of buffer, where the pipeline's accel_mask says so */
};

struct gpu_dispatch {
    struct gpu_pipeline *pipeline;
    const struct gpu_bind *binds; /* one for every bit of binding_mask; others are ignored */
    uint32_t bind_count;
    const void *push;            /* push_bytes of the pipeline */
    uint32_t groups[3];          /* 0 counts as 1 */
    struct gpu_buffer *indirect; /* groups from three uint32 here, instead of `groups`; NULL: direct */
    size_t indirect_offset;      /* bytes, multiple of 4 */
};

struct gpu_frame; /* one of the ring; valid from begin to the next begin of the same slot */

/* Waits for the slot's last use, then starts recording. NULL on device loss. One frame records at a time: one
 * that was begun and not submitted is dropped. */
struct gpu_frame *gpu_frame_begin(struct gpu *gpu, struct error *error);

/* A pass is a named span: a debug label and a timestamp pair. Passes do not nest. A name may occur several
 * times in a frame: its times add up. `name` must stay valid until the frame is read (string literals). */
void gpu_pass_begin(struct gpu_frame *frame, const char *name);
void gpu_pass_end(struct gpu_frame *frame);

void gpu_record_dispatch(struct gpu_frame *frame, const struct gpu_dispatch *dispatch);
/* Writes `value` to `size` bytes. Offset and size are multiples of 4, save for a fill to the buffer's end. A
 * fill, copy or upload of 0 bytes does nothing. */
void gpu_record_fill(struct gpu_frame *frame, struct gpu_buffer *buffer, size_t offset, size_t size,
                     uint32_t value);
void gpu_record_copy(struct gpu_frame *frame, struct gpu_buffer *target, size_t target_offset,
                     struct gpu_buffer *source, size_t source_offset, size_t size);
/* Copies `size` bytes of host memory now, through the frame's staging memory (grows as needed). */
void gpu_record_upload(struct gpu_frame *frame, struct gpu_buffer *target, size_t offset, const void *data,
                       size_t size);
/* Rebuilds a top-level structure from `count` instances. */
void gpu_record_accel_build(struct gpu_frame *frame, struct gpu_accel *top,
                            const struct gpu_accel_instance *instances, uint32_t count);

/* Ends recording and submits. An error met while recording (out of memory in a record call) is reported here.
 */
bool gpu_frame_submit(struct gpu_frame *frame, struct error *error);
bool gpu_frame_wait(struct gpu_frame *frame, struct error *error);

struct gpu_timing {
    const char *name;
    uint64_t elapsed_ns; /* 0 when the device has no timestamps */
};

/* After gpu_frame_wait: passes in the order of their first begin; owned by the frame. `total_ns` is from the
 * first begin to the last end. */
const struct gpu_timing *gpu_frame_timings(struct gpu_frame *frame, uint32_t *count, uint64_t *total_ns);

/* ---- raster ------------------------------------------------------------------------------------------- */

/* One off-screen colour attachment, RGBA32F or RGBA16F, 1 or more samples, additive blending, no depth: what
 * the papers' rasterised splats need. Vertices come from storage buffers (no vertex input). */
struct gpu_raster_params {
    const char *name;
    const uint32_t *vertex_spirv, *fragment_spirv;
    size_t vertex_bytes, fragment_bytes;
    const struct gpu_constant *constants; /* for both stages */
    uint32_t constant_count;
    uint32_t binding_mask;
    uint32_t push_bytes;
    uint32_t width, height, samples; /* samples 0 counts as 1 */
    bool per_sample;                 /* sample shading */
    bool half;                       /* RGBA16F instead of RGBA32F */
    bool writes_buffers;             /* the fragment shader writes to storage buffers */
};

struct gpu_raster; /* pipeline and its attachment */

/* Whether the device has what gpu_raster_create would ask of it for these sizes, samples and features;
 * shaders are not looked at. The error names what is missing. */
bool gpu_raster_check(struct gpu *gpu, const struct gpu_raster_params *params, struct error *error);

struct gpu_raster *gpu_raster_create(struct gpu *gpu, const struct gpu_raster_params *params,
                                     struct error *error);
void gpu_raster_destroy(struct gpu_raster **raster);

struct gpu_draw {
    struct gpu_raster *raster;
    const struct gpu_bind *binds;
    uint32_t bind_count;
    const void *push;
    uint32_t vertex_count, instance_count;
    struct gpu_buffer *indirect; /* VkDrawIndirectCommand, instead of the counts; NULL: direct */
    size_t indirect_offset;
};

/* Clears the attachment to 0, draws a triangle list additively, resolves when multisampled. */
void gpu_record_draw(struct gpu_frame *frame, const struct gpu_draw *draw);
/* Copies what this frame drew, resolved, as tight rows of 4 float (or half) to `target`. */
void gpu_record_raster_read(struct gpu_frame *frame, struct gpu_raster *raster, struct gpu_buffer *target);

#endif
