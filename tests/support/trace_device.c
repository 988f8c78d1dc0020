#include "trace_device.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "shaders/shader_table.h"
#include "shaders/shared/scene_layout.h"

struct trace_device {
    struct gpu *gpu;
    struct gpu_buffer *nodes, *triangles, *more_triangles, *instances, *vertices, *indices;
    uint32_t first_triangles; /* as core/render/renderer.c has it; 0: all are in `triangles` */
    struct gpu_accel **bottoms;
    uint32_t bottom_count;
    struct gpu_accel *top;
    struct gpu_pipeline *pipelines[2][2]; /* any, all lanes */
    struct gpu_buffer *upload, *rays, *hits, *readback;
    uint32_t capacity;
};

void transform_invert(const float m[12], float inverse[12])
{
    double a[3][3], c[3][3], t[3];
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++)
            a[r][k] = (double)m[4 * r + k];
        t[r] = (double)m[4 * r + 3];
    }
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++) {
            int r1 = (r + 1) % 3, r2 = (r + 2) % 3, k1 = (k + 1) % 3, k2 = (k + 2) % 3;
            c[k][r] = a[r1][k1] * a[r2][k2] - a[r1][k2] * a[r2][k1];
        }
    double determinant = a[0][0] * c[0][0] + a[0][1] * c[1][0] + a[0][2] * c[2][0];
    for (int r = 0; r < 3; r++) {
        double moved = 0;
        for (int k = 0; k < 3; k++) {
            inverse[4 * r + k] = (float)(c[r][k] / determinant);
            moved -= c[r][k] / determinant * t[k];
        }
        inverse[4 * r + 3] = (float)moved;
    }
}

static void transform_box(const float m[12], const float min[3], const float max[3], float box[6])
{
    for (int r = 0; r < 3; r++) {
        double low = (double)m[4 * r + 3], high = low;
        for (int k = 0; k < 3; k++) {
            double p = (double)m[4 * r + k] * (double)min[k], q = (double)m[4 * r + k] * (double)max[k];
            low += fmin(p, q);
            high += fmax(p, q);
        }
        box[r] = (float)low;
        box[3 + r] = (float)high;
    }
}

static bool upload_bvh(struct trace_device *device, const struct scene *scene, const struct scene_pose *pose,
                       struct error *error)
{
    bool is_done = false;
    struct bvh **meshes = calloc(scene->mesh_count + 1, sizeof *meshes);
    uint32_t *roots = calloc(scene->mesh_count + 1, sizeof *roots);
    uint32_t *firsts = calloc(scene->mesh_count + 1, sizeof *firsts);
    struct scene_instance_gpu *instances = calloc(scene->instance_count + 1, sizeof *instances);
    float(*boxes)[6] = calloc(scene->instance_count + 1, sizeof *boxes);
    struct bvh_node *nodes = NULL;
    struct bvh_triangle *triangles = NULL;
    struct bvh *top = NULL;
    uint32_t node_count = 2 * scene->instance_count + 1, triangle_count = 0;
    if (!meshes || !roots || !firsts || !instances || !boxes) {
        error_set(error, STATUS_MEMORY, "no memory for the hierarchies");
        goto done;
    }
    for (uint32_t m = 0; m < scene->mesh_count; m++) {
        meshes[m] = bvh_create_mesh(scene, m, error);
        if (!meshes[m])
            goto done;
        roots[m] = node_count;
        firsts[m] = triangle_count;
        node_count += meshes[m]->node_count;
        triangle_count += meshes[m]->item_count;
    }
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        uint32_t m = scene->instances[i].mesh;
        float inverse[12];
        transform_invert(pose->instance_to_world[i], inverse);
        memcpy(instances[i].to_world, pose->instance_to_world[i], sizeof instances[i].to_world);
        memcpy(instances[i].to_object, inverse, sizeof instances[i].to_object);
        instances[i].bvh_root = roots[m];
        instances[i].bvh_triangle = firsts[m];
        transform_box(pose->instance_to_world[i], meshes[m]->bounds_min, meshes[m]->bounds_max, boxes[i]);
    }
    top = bvh_create_boxes((const float(*)[6])boxes, scene->instance_count, error);
    nodes = calloc(node_count, sizeof *nodes);
    triangles = calloc(triangle_count + 1, sizeof *triangles);
    if (!top)
        goto done;
    if (!nodes || !triangles) {
        error_set(error, STATUS_MEMORY, "no memory for %u nodes", node_count);
        goto done;
    }
    memcpy(nodes, top->nodes, top->node_count * sizeof *nodes);
    for (uint32_t m = 0; m < scene->mesh_count; m++) {
        memcpy(nodes + roots[m], meshes[m]->nodes, meshes[m]->node_count * sizeof *nodes);
        memcpy(triangles + firsts[m], meshes[m]->triangles, meshes[m]->item_count * sizeof *triangles);
    }
    device->nodes =
        gpu_buffer_create_filled(device->gpu, "nodes", nodes, node_count * sizeof *nodes, false, error);
    uint32_t most = (uint32_t)(gpu_info(device->gpu)->max_storage_bytes / sizeof *triangles);
    device->first_triangles = triangle_count > most ? most : 0;
    uint32_t first = device->first_triangles ? most : triangle_count;
    device->triangles = gpu_buffer_create_filled(device->gpu, "triangles", triangles,
                                                 first * sizeof *triangles, false, error);
    device->more_triangles =
        gpu_buffer_create_filled(device->gpu, "more triangles", triangles + first,
                                 (triangle_count - first) * sizeof *triangles, false, error);
    device->instances = gpu_buffer_create_filled(device->gpu, "instances", instances,
                                                 scene->instance_count * sizeof *instances, false, error);
    is_done = device->nodes && device->triangles && device->more_triangles && device->instances;

done:
    for (uint32_t m = 0; meshes && m < scene->mesh_count; m++)
        bvh_destroy(&meshes[m]);
    bvh_destroy(&top);
    free(meshes);
    free(roots);
    free(firsts);
    free(instances);
    free(boxes);
    free(nodes);
    free(triangles);
    return is_done;
}

static bool upload_khr(struct trace_device *device, const struct scene *scene, const struct scene_pose *pose,
                       struct error *error)
{
    device->vertices = gpu_buffer_create_filled(device->gpu, "vertices", scene->vertices,
                                                scene->vertex_count * sizeof *scene->vertices, true, error);
    device->indices = gpu_buffer_create_filled(device->gpu, "indices", scene->indices,
                                               scene->index_count * sizeof *scene->indices, true, error);
    device->bottoms = calloc(scene->mesh_count + 1, sizeof(struct gpu_accel *));
    device->top =
        gpu_accel_create_top(device->gpu, "top", scene->instance_count ? scene->instance_count : 1, error);
    if (!device->bottoms || !device->vertices || !device->indices || !device->top)
        return false;
    for (uint32_t m = 0; m < scene->mesh_count; m++, device->bottom_count++) {
        const struct scene_mesh *mesh = &scene->meshes[m];
        device->bottoms[m] =
            gpu_accel_create_bottom(device->gpu, mesh->name,
                                    &(struct gpu_triangles){.vertices = device->vertices,
                                                            .vertex_stride = sizeof *scene->vertices,
                                                            .first_vertex = mesh->first_vertex,
                                                            .vertex_count = mesh->vertex_count,
                                                            .indices = device->indices,
                                                            .first_index = mesh->first_index,
                                                            .triangle_count = mesh->triangle_count},
                                    error);
        if (!device->bottoms[m])
            return false;
    }
    struct gpu_accel_instance *instances = calloc(scene->instance_count + 1, sizeof *instances);
    if (!instances)
        return error_set(error, STATUS_MEMORY, "no memory for %u instances", scene->instance_count);
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        instances[i].bottom = device->bottoms[scene->instances[i].mesh];
        instances[i].custom_index = i;
        memcpy(instances[i].object_to_world, pose->instance_to_world[i], sizeof instances[i].object_to_world);
    }
    struct gpu_frame *frame = gpu_frame_begin(device->gpu, error);
    if (frame)
        gpu_record_accel_build(frame, device->top, instances, scene->instance_count);
    bool is_done = frame && gpu_frame_submit(frame, error) && gpu_frame_wait(frame, error);
    free(instances);
    return is_done;
}

struct trace_device *trace_device_create(struct gpu *gpu, const struct scene *scene,
                                         const struct scene_pose *pose, bool with_ray_query,
                                         struct error *error)
{
    struct trace_device *device = calloc(1, sizeof *device);
    if (!device) {
        error_set(error, STATUS_MEMORY, "no memory for a device's scene");
        return NULL;
    }
    device->gpu = gpu;
    if (!(with_ray_query ? upload_khr(device, scene, pose, error) : upload_bvh(device, scene, pose, error)))
        goto fail;
    for (uint32_t variant = 0; variant < 4; variant++) {
        uint32_t any = variant & 1, all_lanes = variant >> 1;
        uint32_t rays_and_hits = 3u << BINDING_PASS;
        size_t bytes;
        const uint32_t *spirv =
            shader_find(with_ray_query ? "trace_rays.comp.khr" : "trace_rays.comp.bvh", &bytes);
        device->pipelines[any][all_lanes] = gpu_pipeline_create(
            gpu,
            &(struct gpu_pipeline_params){
                .name = "trace rays",
                .spirv = spirv,
                .spirv_bytes = bytes,
                .constants =
                    (const struct gpu_constant[]){
                        {0, any}, {1, all_lanes}, {CONSTANT_FIRST_TRIANGLES, device->first_triangles}},
                .constant_count = 3,
                .binding_mask = rays_and_hits | 1u << BINDING_NODES |
                                (with_ray_query ? 0
                                                : 1u << BINDING_TRIANGLES | 1u << BINDING_MORE_TRIANGLES |
                                                      1u << BINDING_INSTANCES),
                .accel_mask = with_ray_query ? 1u << BINDING_NODES : 0,
                .push_bytes = sizeof(struct trace_rays_push)},
            error);
        if (!device->pipelines[any][all_lanes])
            goto fail;
    }
    return device;

fail:
    trace_device_destroy(&device);
    return NULL;
}

void trace_device_destroy(struct trace_device **device)
{
    struct trace_device *d = *device;
    if (!d)
        return;
    for (uint32_t variant = 0; variant < 4; variant++)
        gpu_pipeline_destroy(&d->pipelines[variant & 1][variant >> 1]);
    gpu_accel_destroy(&d->top);
    for (uint32_t m = 0; m < d->bottom_count; m++)
        gpu_accel_destroy(&d->bottoms[m]);
    free(d->bottoms);
    struct gpu_buffer **buffers[] = {&d->nodes,    &d->triangles, &d->more_triangles, &d->instances,
                                     &d->vertices, &d->indices,   &d->upload,         &d->rays,
                                     &d->hits,     &d->readback};
    for (size_t i = 0; i < sizeof buffers / sizeof *buffers; i++)
        gpu_buffer_destroy(buffers[i]);
    free(d);
    *device = NULL;
}

static struct gpu_buffer *list_buffer(struct gpu *gpu, const char *name, size_t size, enum gpu_memory memory,
                                      struct error *error)
{
    return gpu_buffer_create(gpu, &(struct gpu_buffer_params){.name = name, .size = size, .memory = memory},
                             error);
}

static bool ensure_capacity(struct trace_device *device, uint32_t count, struct error *error)
{
    if (count <= device->capacity)
        return true;
    gpu_buffer_destroy(&device->upload);
    gpu_buffer_destroy(&device->rays);
    gpu_buffer_destroy(&device->hits);
    gpu_buffer_destroy(&device->readback);
    device->capacity = 0;
    size_t ray_bytes = count * sizeof(struct trace_ray_gpu), hit_bytes = count * sizeof(struct trace_hit_gpu);
    device->upload = list_buffer(device->gpu, "rays upload", ray_bytes, GPU_MEMORY_UPLOAD, error);
    device->rays = list_buffer(device->gpu, "rays", ray_bytes, GPU_MEMORY_DEVICE, error);
    device->hits = list_buffer(device->gpu, "hits", hit_bytes, GPU_MEMORY_DEVICE, error);
    device->readback = list_buffer(device->gpu, "hits readback", hit_bytes, GPU_MEMORY_READBACK, error);
    if (!device->upload || !device->rays || !device->hits || !device->readback)
        return false;
    device->capacity = count;
    return true;
}

bool trace_device_write_nodes(struct trace_device *device, size_t offset, const void *data, size_t size,
                              struct error *error)
{
    struct gpu_frame *frame = gpu_frame_begin(device->gpu, error);
    if (!frame)
        return false;
    gpu_record_upload(frame, device->nodes, offset, data, size);
    return gpu_frame_submit(frame, error) && gpu_frame_wait(frame, error);
}

bool trace_device_run(struct trace_device *device, const struct trace_run *run, struct trace_hit_gpu *hits,
                      uint64_t *elapsed_ns, struct error *error)
{
    uint32_t count = run->count;
    if (!ensure_capacity(device, count, error))
        return false;
    memcpy(gpu_buffer_map(device->upload), run->rays, count * sizeof *run->rays);
    struct gpu_frame *frame = gpu_frame_begin(device->gpu, error);
    if (!frame)
        return false;
    struct gpu_bind binds[6] = {{BINDING_PASS, GPU_READ, device->rays, NULL},
                                {BINDING_PASS + 1, GPU_WRITE, device->hits, NULL},
                                {BINDING_NODES, GPU_READ, device->nodes, device->top},
                                {BINDING_TRIANGLES, GPU_READ, device->triangles, NULL},
                                {BINDING_MORE_TRIANGLES, GPU_READ, device->more_triangles, NULL},
                                {BINDING_INSTANCES, GPU_READ, device->instances, NULL}};
    gpu_pass_begin(frame, "copy");
    gpu_record_copy(frame, device->rays, 0, device->upload, 0, count * sizeof *run->rays);
    gpu_pass_end(frame);
    gpu_pass_begin(frame, "trace");
    gpu_record_dispatch(
        frame, &(struct gpu_dispatch){.pipeline = device->pipelines[run->any][run->all_lanes],
                                      .binds = binds,
                                      .bind_count = device->top ? 3 : 6,
                                      .push = &(struct trace_rays_push){count, run->stride ? run->stride : 1},
                                      .groups = {(count + 63) / 64, 1, 1}});
    gpu_pass_end(frame);
    gpu_pass_begin(frame, "copy");
    gpu_record_copy(frame, device->readback, 0, device->hits, 0, count * sizeof *hits);
    gpu_pass_end(frame);
    if (!gpu_frame_submit(frame, error) || !gpu_frame_wait(frame, error))
        return false;
    memcpy(hits, gpu_buffer_map(device->readback), count * sizeof *hits);
    if (elapsed_ns) {
        uint32_t pass_count;
        uint64_t total_ns;
        const struct gpu_timing *timings = gpu_frame_timings(frame, &pass_count, &total_ns);
        *elapsed_ns = 0;
        for (uint32_t i = 0; i < pass_count; i++)
            if (strcmp(timings[i].name, "trace") == 0)
                *elapsed_ns = timings[i].elapsed_ns;
    }
    return true;
}

void trace_scene_reference(const struct scene *scene, const struct scene_pose *pose,
                           struct bvh *const *meshes, const struct trace_ray_gpu *ray,
                           struct trace_hit_gpu *hit)
{
    const float o[3] = {ray->origin_t_max.x, ray->origin_t_max.y, ray->origin_t_max.z};
    const float d[3] = {ray->direction.x, ray->direction.y, ray->direction.z};
    float nearest = ray->origin_t_max.w;
    memset(hit, 0, sizeof *hit);
    hit->hit.y = TRACE_DEVICE_MISS;
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        float m[12], origin[3], direction[3], t, u, v;
        uint32_t triangle;
        transform_invert(pose->instance_to_world[i], m);
        for (int r = 0; r < 3; r++) {
            direction[r] = m[4 * r] * d[0] + m[4 * r + 1] * d[1] + m[4 * r + 2] * d[2];
            origin[r] = m[4 * r] * o[0] + m[4 * r + 1] * o[1] + m[4 * r + 2] * o[2] + m[4 * r + 3];
        }
        if (!bvh_trace(meshes[scene->instances[i].mesh], origin, direction, nearest, &t, &triangle, &u, &v))
            continue;
        nearest = t;
        memcpy(&hit->hit.x, &t, sizeof t);
        hit->hit.y = i;
        hit->hit.z = triangle;
        hit->barycentrics.x = u;
        hit->barycentrics.y = v;
    }
}
