/* gpu_internal.h: what the files of core/gpu share. Nothing outside this folder includes it.
 *
 * Hazards are tracked per resource and kind of access (enum usage), see barrier.c. Work that cannot wait for
 * a frame (filling a new buffer, building a bottom-level structure) goes through the immediate command
 * buffer, which begins and ends with a full barrier and is waited for.
 */
#ifndef CAUSTIC_GPU_INTERNAL_H
#define CAUSTIC_GPU_INTERNAL_H

#include <stdbool.h>

#include <volk.h>

#include "gpu.h"

#define FRAME_RING       2u
#define MAX_BINDINGS     32u
#define SPANS_PER_POOL   64u /* timestamp pairs in one query pool */
#define BUFFER_ALIGNMENT 16u /* sizes are rounded up to it, so that fills may touch the last word */
#define NAME_SIZE        64u

/* ---- hazards (barrier.c) ------------------------------------------------------------------------------ */

enum usage {
    USAGE_COMPUTE_READ,
    USAGE_COMPUTE_WRITE,
    USAGE_COMPUTE_TRACE, /* ray query through an acceleration structure */
    USAGE_DRAW_READ,
    USAGE_DRAW_WRITE,
    USAGE_INDIRECT,
    USAGE_COPY_READ,
    USAGE_COPY_WRITE,
    USAGE_BUILD_READ,
    USAGE_BUILD_WRITE,
    USAGE_COUNT
};

struct history {
    uint64_t last[USAGE_COUNT]; /* command number of the last access of each kind; 0: never */
    uint64_t serial;            /* of the last frame that used the resource; 0: none */
};

struct tracker {
    uint64_t command; /* number of the command being recorded; counts over all frames */
    /* ordered[a][b]: accesses of kind a up to this command number are ordered before, and visible to, every
     * access of kind b recorded from now on. */
    uint64_t ordered[USAGE_COUNT][USAGE_COUNT];
};

struct hazards {
    uint32_t sources, targets; /* bits of enum usage */
};

void tracker_next_command(struct tracker *tracker);
void tracker_require(const struct tracker *tracker, struct hazards *hazards, const struct history *history,
                     enum usage usage);
/* Records the barrier the hazards ask for, if any. */
void tracker_resolve(struct gpu *gpu, VkCommandBuffer commands, const struct hazards *hazards);
void tracker_mark(struct gpu_frame *frame, struct history *history, enum usage usage);
/* Everything before it is ordered before everything after it. */
void full_barrier(const struct gpu *gpu, VkCommandBuffer commands);
void tracker_full_barrier(struct gpu *gpu, VkCommandBuffer commands);
/* Makes device writes of the given kinds (bits of enum usage) visible to the host. */
void host_barrier(struct gpu *gpu, VkCommandBuffer commands, uint32_t sources);

/* ---- device (device.c) -------------------------------------------------------------------------------- */

struct staging_block {
    struct gpu_buffer *buffer;
    size_t used;
};

struct span {
    const char *name;
    bool is_closed;
};

enum frame_state { FRAME_IDLE, FRAME_RECORDING, FRAME_SUBMITTED, FRAME_DONE, FRAME_FAILED };

struct gpu_frame {
    struct gpu *gpu;
    enum frame_state state;
    uint64_t serial; /* counts frames from 1 */
    VkCommandPool command_pool;
    VkCommandBuffer commands;
    VkFence fence;

    struct error error; /* the first one met while recording */
    bool has_error;

    VkDescriptorPool *descriptor_pools;
    uint32_t descriptor_pool_count, descriptor_pool_used;

    struct staging_block *staging;
    uint32_t staging_count;

    VkQueryPool *query_pools;
    uint32_t query_pool_count;
    struct span *spans;
    uint32_t span_count, span_capacity;
    struct gpu_timing *timings;
    uint32_t timing_count;
    uint64_t total_ns;

    uint32_t readback_sources; /* kinds of access that wrote READBACK buffers */
};

struct gpu {
    struct gpu_info info;
    gpu_log_fn log;
    void *log_user;
    VkInstance instance;
    VkDebugUtilsMessengerEXT messenger;
    VkPhysicalDevice physical;
    VkPhysicalDeviceMemoryProperties memory_properties;
    VkPhysicalDeviceLimits limits;
    VkDevice device;
    struct VolkDeviceTable vk;
    VkQueue queue;
    uint32_t queue_family;
    uint32_t timestamp_bits;
    uint32_t scratch_alignment; /* of acceleration structure builds */
    bool has_debug_utils, has_graphics, has_sample_shading, has_fragment_stores;
    bool has_float16, has_float64, has_int16, has_int8;
    bool is_lost;
    uint64_t validation_count; /* atomic */

    uint64_t memory_in_use;
    uint32_t object_count; /* buffers, pipelines, structures and rasters not destroyed yet */

    struct tracker tracker;
    bool needs_full_barrier; /* recorded commands were never submitted: what the tracker knows is not so */

    VkCommandPool immediate_pool;
    VkCommandBuffer immediate_commands;
    VkFence immediate_fence;

    struct gpu_frame frames[FRAME_RING];
    uint64_t frame_serial; /* of the newest frame */

    VkPipelineCache cache;
    char *cache_path;    /* NULL: none */
    uint64_t cache_hash; /* of what is on disk */
};

/* Fills *error with "WHAT 'name': <meaning of result>", notes a lost device, returns false. */
bool gpu_fail(struct gpu *gpu, struct error *error, VkResult result, const char *what, const char *name);
void gpu_log(const struct gpu *gpu, enum gpu_log_level level, const char *format, ...)
    __attribute__((format(printf, 3, 4)));
void gpu_set_name(const struct gpu *gpu, VkObjectType type, uint64_t handle, const char *name);

/* ---- memory (memory.c) -------------------------------------------------------------------------------- */

struct gpu_buffer {
    struct gpu *gpu;
    char name[NAME_SIZE];
    size_t size; /* as asked for */
    size_t padded_size;
    enum gpu_memory memory;
    VkBuffer handle;
    VkDeviceMemory allocation;
    uint64_t allocated_bytes;
    void *mapped;
    VkDeviceAddress address; /* 0 unless it was created with one */
    struct history history;
};

enum buffer_role {
    BUFFER_STORAGE,     /* what gpu_buffer_create makes */
    BUFFER_BUILD_INPUT, /* storage, and input of an acceleration structure build */
    BUFFER_STRUCTURE,   /* backing store of an acceleration structure */
    BUFFER_BUILD_SCRATCH
};

struct gpu_buffer *buffer_create(struct gpu *gpu, const struct gpu_buffer_params *params,
                                 enum buffer_role role, struct error *error);

/* Device memory that is not a buffer's: images. */
VkDeviceMemory memory_allocate(struct gpu *gpu, const VkMemoryRequirements *requirements,
                               enum gpu_memory memory, bool with_address, const char *name,
                               uint64_t *allocated_bytes, struct error *error);
void memory_free(struct gpu *gpu, VkDeviceMemory allocation, uint64_t allocated_bytes);

/* Immediate commands: record between the two; end submits and waits. */
VkCommandBuffer immediate_begin(struct gpu *gpu, struct error *error);
bool immediate_end(struct gpu *gpu, struct error *error);

/* Waits for a submission. Whatever the result, the device no longer works on it: who could not wait for the
 * fence (out of memory, say) waits for everything, as its caller goes on to reuse or free what the commands
 * used. */
VkResult fence_wait(struct gpu *gpu, VkFence fence);

/* ---- pipelines (pipeline.c, cache.c) ------------------------------------------------------------------ */

/* What compute and raster pipelines have in common. */
struct program {
    struct gpu *gpu;
    char name[NAME_SIZE];
    uint32_t binding_mask, accel_mask, push_bytes;
    VkShaderStageFlags stages;
    VkDescriptorSetLayout set_layout;
    VkPipelineLayout layout;
    VkPipeline handle;
    uint64_t serial; /* of the last frame that used it */
};

struct gpu_pipeline {
    struct program program;
};

bool program_create_layout(struct program *program, struct gpu *gpu, const char *name, uint32_t binding_mask,
                           uint32_t accel_mask, uint32_t push_bytes, VkShaderStageFlags stages,
                           struct error *error);
void program_destroy(struct program *program);
VkShaderModule shader_module_create(struct gpu *gpu, const char *name, const uint32_t *spirv, size_t bytes,
                                    struct error *error);

/* Specialisation info over `constants`; entries and values are owned by the struct. */
struct specialisation {
    VkSpecializationMapEntry *entries;
    uint32_t *values;
    VkSpecializationInfo info;
};
bool specialisation_create(struct specialisation *specialisation, const struct gpu_constant *constants,
                           uint32_t count, struct error *error);
void specialisation_destroy(struct specialisation *specialisation);

void cache_open(struct gpu *gpu, const char *folder);

/* ---- frames (frame.c) --------------------------------------------------------------------------------- */

/* False when the frame is not recording or has failed already. */
bool frame_is_recording(const struct gpu_frame *frame);
void frame_fail(struct gpu_frame *frame, enum status status, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Checks the binds against the program, collects their hazards, resolves them together with those already in
 * *hazards, and binds a descriptor set and push constants. False after frame_fail. */
bool frame_bind(struct gpu_frame *frame, struct program *program, const struct gpu_bind *binds,
                uint32_t bind_count, const void *push, struct hazards *hazards);
/* Notes the accesses of the binds, after the command was recorded. */
void frame_mark_binds(struct gpu_frame *frame, struct program *program, const struct gpu_bind *binds,
                      uint32_t bind_count);
/* Notes one access of a buffer. */
void frame_mark(struct gpu_frame *frame, struct gpu_buffer *buffer, enum usage usage);
bool frame_check_range(struct gpu_frame *frame, const struct gpu_buffer *buffer, size_t offset, size_t size,
                       const char *what);
/* Orders and notes a transfer command that is recorded next; `source` may be NULL. */
void frame_begin_transfer(struct gpu_frame *frame, struct gpu_buffer *target, struct gpu_buffer *source);
/* Room for `size` bytes in the frame's staging memory. NULL after frame_fail. */
void *frame_stage(struct gpu_frame *frame, size_t size, struct gpu_buffer **buffer, size_t *offset);

/* Waits until no frame in flight uses what was last used by frame `serial`; a frame that is still recording
 * commands with it can then no longer be submitted. */
void frames_release(struct gpu *gpu, uint64_t serial, const char *name);
void frames_wait_all(struct gpu *gpu);
bool frame_init(struct gpu_frame *frame, struct gpu *gpu, struct error *error);
void frame_finish(struct gpu_frame *frame);

/* ---- acceleration structures (accel.c) ---------------------------------------------------------------- */

struct gpu_accel {
    struct gpu *gpu;
    struct gpu_buffer *backing; /* carries the history */
    VkAccelerationStructureKHR handle;
    VkDeviceAddress address;
    /* top level only */
    struct gpu_buffer *instances, *scratch;
    uint32_t max_instances;
};

#endif
