/* trace_device.h: a scene on a device, and lists of rays traced through it; for tests and the benchmark.
 *
 * The rays go through shaders/trace_rays.comp, so through the same shaders/trace.glsl as every pass.
 */
#ifndef TRACE_DEVICE_H
#define TRACE_DEVICE_H

#include "core/gpu/gpu.h"
#include "core/scene/bvh.h"
#include "core/scene/scene.h"
#include "shaders/shared/trace_rays_layout.h"

#define TRACE_DEVICE_MISS 0xffffffffu

struct trace_device;

/* `with_ray_query`: the khr tracer, else bvh, whose triangles go into two buffers where the gpu takes no
 * larger one. `gpu` is borrowed; scene and pose are read now. */
struct trace_device *trace_device_create(struct gpu *gpu, const struct scene *scene,
                                         const struct scene_pose *pose, bool with_ray_query,
                                         struct error *error);
void trace_device_destroy(struct trace_device **device);

struct trace_run {
    const struct trace_ray_gpu *rays;
    uint32_t count;  /* at least one */
    uint32_t stride; /* only every stride-th ray is traced, the other lanes idle;
                        0 counts as 1 */
    bool all_lanes;  /* idle lanes take part without a ray (TRACE_ALL_LANES in
                        shaders/trace_bvh.glsl) */
    bool any;        /* only whether there is a hit: hits[i].hit.y is 0 or
                        TRACE_DEVICE_MISS */
};

/* Fills hits[i] for the rays traced. `elapsed_ns` (may be NULL) gets the dispatch's time on the device. */
bool trace_device_run(struct trace_device *device, const struct trace_run *run, struct trace_hit_gpu *hits,
                      uint64_t *elapsed_ns, struct error *error);

/* Overwrites part of the node buffer, to see what damage does; bvh tracer only.
 */
bool trace_device_write_nodes(struct trace_device *device, size_t offset, const void *data, size_t size,
                              struct error *error);

/* The plain C reference over the same scene: every instance in turn. `hit` as the shader gives it. */
void trace_scene_reference(const struct scene *scene, const struct scene_pose *pose,
                           struct bvh *const *meshes, const struct trace_ray_gpu *ray,
                           struct trace_hit_gpu *hit);

/* Inverse of a row-major 3x4 matrix. */
void transform_invert(const float matrix[12], float inverse[12]);

#endif
