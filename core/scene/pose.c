#include "scene.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "vec3.h"

/* A local or world transform: rows of 3x4. Double, because a deep hierarchy multiplies many. */
struct affine {
    double m[3][4];
};

/* struct scene_pose with what evaluating it needs. */
struct pose_storage {
    struct scene_pose pose;   /* first, so that the pointers convert */
    struct scene_node *nodes; /* the scene's, animated */
    struct affine *worlds;    /* per node */
    void *last;               /* instances, lights and cameras as they were, to see changes */
    size_t last_bytes;
    double origin[3];
    double time;
    bool is_set;
};

static size_t pose_bytes(const struct scene *scene)
{
    return scene->instance_count * sizeof(float[12]) + scene->light_count * sizeof(struct pose_light) +
           scene->camera_count * sizeof(struct pose_camera);
}

struct scene_pose *scene_pose_create(const struct scene *scene, struct error *error)
{
    struct pose_storage *storage = calloc(1, sizeof *storage);
    if (!storage)
        goto error;
    size_t bytes = pose_bytes(scene);
    storage->last_bytes = bytes;
    /* One block, so that a change shows in one comparison; all floats, so nothing needs more alignment. */
    storage->pose.instance_to_world = calloc(1, bytes + 1);
    storage->last = calloc(1, bytes + 1);
    storage->nodes = calloc((size_t)scene->node_count + 1, sizeof *storage->nodes);
    storage->worlds = calloc((size_t)scene->node_count + 1, sizeof *storage->worlds);
    if (!storage->pose.instance_to_world || !storage->last || !storage->nodes || !storage->worlds)
        goto error;
    storage->pose.lights = (struct pose_light *)(storage->pose.instance_to_world + scene->instance_count);
    storage->pose.cameras = (struct pose_camera *)(storage->pose.lights + scene->light_count);
    if (scene->node_count)
        memcpy(storage->nodes, scene->nodes, scene->node_count * sizeof *storage->nodes);
    scene_pose_set_time(scene, &storage->pose, 0);
    return &storage->pose;

error:
    error_set(error, STATUS_MEMORY, "out of memory for the pose of scene \"%s\"", scene->name);
    struct scene_pose *pose = storage ? &storage->pose : NULL;
    scene_pose_destroy(&pose);
    return NULL;
}

void scene_pose_destroy(struct scene_pose **pointer)
{
    struct pose_storage *storage = (struct pose_storage *)*pointer;
    if (!storage)
        return;
    free(storage->pose.instance_to_world);
    free(storage->last);
    free(storage->nodes);
    free(storage->worlds);
    free(storage);
    *pointer = NULL;
}

void scene_pose_set_origin(struct scene_pose *pose, const double origin[3])
{
    struct pose_storage *storage = (struct pose_storage *)pose;
    memcpy(storage->origin, origin, sizeof storage->origin);
    storage->is_set = false;
}

/* ---- keys --------------------------------------------------------------------------------------------- */

static void normalize4(double q[4])
{
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(length > 0) || !isfinite(length)) {
        q[0] = q[1] = q[2] = 0, q[3] = 1;
        return;
    }
    for (int i = 0; i < 4; i++)
        q[i] /= length;
}

static void slerp(const float a[4], const float b[4], double t, double out[4])
{
    double dot = 0;
    for (int i = 0; i < 4; i++)
        dot += (double)a[i] * (double)b[i];
    /* q and -q are the same rotation: the shorter way. */
    double sign = dot < 0 ? -1 : 1;
    dot = fmin(fabs(dot), 1);
    double weight_a = 1 - t, weight_b = t;
    /* sin(angle) vanishes for equal keys, where the straight line is exact to second order. */
    if (dot < 0.99999) {
        double angle = acos(dot);
        weight_a = sin((1 - t) * angle) / sin(angle);
        weight_b = sin(t * angle) / sin(angle);
    }
    for (int i = 0; i < 4; i++)
        out[i] = weight_a * (double)a[i] + weight_b * sign * (double)b[i];
    normalize4(out);
}

/* The last key at or before `time`. */
static uint32_t find_key(const struct scene_channel *channel, double time)
{
    uint32_t low = 0, high = channel->key_count;
    while (high - low > 1) {
        uint32_t middle = low + (high - low) / 2;
        if ((double)channel->times[middle] <= time)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static void evaluate(const struct scene_channel *channel, double time, float *target)
{
    uint32_t size = channel->path == ANIMATION_ROTATION ? 4 : 3;
    bool is_cubic = channel->interpolation == ANIMATION_CUBIC;
    uint32_t stride = is_cubic ? 3 * size : size;
    uint32_t key = find_key(channel, time);
    const float *here = channel->values + (size_t)key * stride + (is_cubic ? size : 0);
    double out[4] = {0};
    for (uint32_t i = 0; i < size; i++)
        out[i] = (double)here[i];
    double start = (double)channel->times[key];
    if (key + 1 < channel->key_count && time > start && channel->interpolation != ANIMATION_STEP) {
        double span = (double)channel->times[key + 1] - start;
        double t = (time - start) / span;
        const float *next = here + stride;
        if (is_cubic) {
            /* glTF 2.0, appendix C.5 */
            double t2 = t * t, t3 = t2 * t;
            for (uint32_t i = 0; i < size; i++)
                out[i] = (2 * t3 - 3 * t2 + 1) * (double)here[i] +
                         span * (t3 - 2 * t2 + t) * (double)here[size + i] +
                         (-2 * t3 + 3 * t2) * (double)next[i] +
                         span * (t3 - t2) * (double)channel->values[(size_t)(key + 1) * stride + i];
        } else if (size == 4) {
            slerp(here, next, t, out);
        } else {
            for (uint32_t i = 0; i < size; i++)
                out[i] = (1 - t) * (double)here[i] + t * (double)next[i];
        }
    }
    if (size == 4)
        normalize4(out);
    for (uint32_t i = 0; i < size; i++)
        target[i] = (float)out[i];
}

/* ---- transforms --------------------------------------------------------------------------------------- */

static struct affine local_transform(const struct scene_node *node)
{
    struct affine local;
    if (node->has_matrix) {
        for (int row = 0; row < 3; row++)
            for (int column = 0; column < 4; column++)
                local.m[row][column] = (double)node->matrix[column * 4 + row];
        return local;
    }
    double x = (double)node->rotation[0], y = (double)node->rotation[1], z = (double)node->rotation[2],
           w = (double)node->rotation[3];
    const double rotation[3][3] = {
        {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
        {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
        {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)},
    };
    for (int row = 0; row < 3; row++) {
        for (int column = 0; column < 3; column++)
            local.m[row][column] = rotation[row][column] * (double)node->scale[column];
        local.m[row][3] = (double)node->translation[row];
    }
    return local;
}

static struct affine multiply(const struct affine *a, const struct affine *b)
{
    struct affine out;
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 4; column++) {
            double sum = column == 3 ? a->m[row][3] : 0;
            for (int i = 0; i < 3; i++)
                sum += a->m[row][i] * b->m[i][column];
            out.m[row][column] = sum;
        }
    return out;
}

static bool is_finite(const struct affine *a)
{
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 4; column++)
            if (!(fabs(a->m[row][column]) < 1e12))
                return false;
    return true;
}

static struct affine relative_to(const struct affine *a, const double origin[3])
{
    struct affine moved = *a;
    for (int row = 0; row < 3; row++)
        moved.m[row][3] -= origin[row];
    return moved;
}

static struct vec3 column(const struct affine *a, int index)
{
    return vec3_make(a->m[0][index], a->m[1][index], a->m[2][index]);
}

static void place_light(const struct affine *world, struct pose_light *light)
{
    vec3_store(light->position, column(world, 3));
    struct vec3 direction = vec3_unit(vec3_scale(column(world, 2), -1), vec3_make(0, 0, -1));
    struct vec3 across = fabs(direction.x) < 0.9 ? vec3_make(1, 0, 0) : vec3_make(0, 1, 0);
    vec3_store(light->direction, direction);
    vec3_store(light->side, vec3_unit(vec3_across(column(world, 0), direction),
                                      vec3_unit(vec3_across(across, direction), across)));
}

static void place_camera(const struct affine *world, struct pose_camera *camera)
{
    struct vec3 forward = vec3_unit(vec3_scale(column(world, 2), -1), vec3_make(0, 0, -1));
    struct vec3 up = column(world, 1);
    /* A scaled or sheared node: up is what remains of its y axis across the view. */
    up = vec3_across(up, forward);
    struct vec3 across = fabs(forward.y) < 0.9 ? vec3_make(0, 1, 0) : vec3_make(0, 0, -1);
    up = vec3_unit(up, vec3_unit(vec3_across(across, forward), vec3_make(0, 1, 0)));
    vec3_store(camera->eye, column(world, 3));
    vec3_store(camera->forward, forward);
    vec3_store(camera->up, up);
}

bool scene_pose_set_time(const struct scene *scene, struct scene_pose *pose, double time)
{
    struct pose_storage *storage = (struct pose_storage *)pose;
    double duration = (double)scene->duration;
    time = duration > 0 && isfinite(time) ? fmod(time, duration) : 0;
    if (time < 0)
        time += duration;
    if (storage->is_set && time == storage->time)
        return false;

    for (uint32_t i = 0; i < scene->channel_count; i++) {
        const struct scene_channel *channel = &scene->channels[i];
        struct scene_node *node = &storage->nodes[channel->node];
        evaluate(channel, time,
                 channel->path == ANIMATION_TRANSLATION ? node->translation
                 : channel->path == ANIMATION_ROTATION  ? node->rotation
                                                        : node->scale);
    }
    for (uint32_t i = 0; i < scene->node_count; i++) {
        struct affine world = local_transform(&storage->nodes[i]);
        if (storage->nodes[i].parent != SCENE_NONE)
            world = multiply(&storage->worlds[storage->nodes[i].parent], &world);
        /* A transform beyond all use keeps its last value (zeros at first): squares of it must fit a float.
         */
        if (is_finite(&world))
            storage->worlds[i] = world;
    }
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        struct affine world = relative_to(&storage->worlds[scene->instances[i].node], storage->origin);
        for (int at = 0; at < 12; at++)
            pose->instance_to_world[i][at] = (float)world.m[at / 4][at % 4];
    }
    for (uint32_t i = 0; i < scene->light_count; i++) {
        struct affine world = relative_to(&storage->worlds[scene->lights[i].node], storage->origin);
        place_light(&world, &pose->lights[i]);
    }
    for (uint32_t i = 0; i < scene->camera_count; i++) {
        struct affine world = relative_to(&storage->worlds[scene->cameras[i].node], storage->origin);
        place_camera(&world, &pose->cameras[i]);
    }

    bool has_changed =
        !storage->is_set || memcmp(storage->last, pose->instance_to_world, storage->last_bytes) != 0;
    memcpy(storage->last, pose->instance_to_world, storage->last_bytes);
    storage->time = time;
    storage->is_set = true;
    return has_changed;
}
