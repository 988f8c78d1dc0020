/* test_gpu_accel.c: acceleration structures and ray queries against every triangle in turn, in double
 * precision.
 *
 * Runs where the device has_ray_query; skipped elsewhere.
 */
#include <float.h>
#include <string.h>

#include "core/gpu/gpu.h"
#include "tests/support/check.h"
#include "tests/support/test_shaders.h"

enum { GRID = 24, RAYS = 8192, INSTANCES = 3 };

struct vertex {
    float position[3], unused[2]; /* a stride that is not the position's size */
};

struct device_hit {
    float t;
    uint32_t instance, triangle;
    float u, v;
    uint32_t unused[3];
};

static struct gpu *gpu;

/* One list for both meshes: a bumpy sheet, then a box. */
enum {
    SHEET_VERTICES = (GRID + 1) * (GRID + 1),
    SHEET_TRIANGLES = GRID * GRID * 2,
    BOX_VERTICES = 8,
    BOX_TRIANGLES = 12
};
static struct vertex vertices[SHEET_VERTICES + BOX_VERTICES];
static uint32_t indices[(SHEET_TRIANGLES + BOX_TRIANGLES) * 3];

static void make_meshes(void)
{
    for (uint32_t y = 0; y <= GRID; y++) {
        for (uint32_t x = 0; x <= GRID; x++) {
            const float u = (float)x / GRID * 2 - 1, v = (float)y / GRID * 2 - 1;
            vertices[y * (GRID + 1) + x] =
                (struct vertex){.position = {u, 0.2f * sinf(5 * u) * cosf(4 * v), v}};
        }
    }
    uint32_t count = 0;
    for (uint32_t y = 0; y < GRID; y++) {
        for (uint32_t x = 0; x < GRID; x++) {
            const uint32_t corner = y * (GRID + 1) + x;
            const uint32_t quad[6] = {corner,     corner + 1,        corner + GRID + 1,
                                      corner + 1, corner + GRID + 2, corner + GRID + 1};
            memcpy(indices + count, quad, sizeof quad);
            count += 6;
        }
    }
    for (uint32_t i = 0; i < BOX_VERTICES; i++) {
        vertices[SHEET_VERTICES + i] =
            (struct vertex){.position = {i & 1 ? 0.3f : -0.3f, i & 2 ? 0.4f : -0.4f, i & 4 ? 0.5f : -0.5f}};
    }
    const uint32_t box[36] = {0, 1, 2, 1, 3, 2, 4, 6, 5, 5, 6, 7, 0, 4, 1, 1, 4, 5,
                              2, 3, 6, 3, 7, 6, 0, 2, 4, 2, 6, 4, 1, 5, 3, 3, 5, 7};
    memcpy(indices + count, box, sizeof box);
}

/* Instances: the sheet twice, the box once, turned, scaled and moved by `step`. */
static void place(uint32_t step, float transforms[INSTANCES][12])
{
    for (uint32_t i = 0; i < INSTANCES; i++) {
        const float angle = 0.7f * (float)i + 0.31f * (float)step, scale = 1 - 0.25f * (float)i;
        const float c = cosf(angle) * scale, s = sinf(angle) * scale;
        const float matrix[12] = {c,    0,
                                  s,    0.4f * (float)i - 0.1f * (float)step,
                                  0,    scale * 1.1f,
                                  0.1f, (float)i - 1,
                                  -s,   0.05f,
                                  c,    0.2f * (float)i};
        memcpy(transforms[i], matrix, sizeof matrix);
    }
}

struct reference_hit {
    double t, u, v;
    double edge; /* smallest distance of any decision from its threshold: small ones may go either way */
    uint32_t instance, triangle;
};

static void transform_point(const float matrix[12], const float point[3], double result[3])
{
    for (uint32_t row = 0; row < 3; row++) {
        result[row] = (double)matrix[row * 4 + 3];
        for (uint32_t column = 0; column < 3; column++) {
            result[row] += (double)matrix[row * 4 + column] * (double)point[column];
        }
    }
}

static void cross(const double a[3], const double b[3], double result[3])
{
    result[0] = a[1] * b[2] - a[2] * b[1];
    result[1] = a[2] * b[0] - a[0] * b[2];
    result[2] = a[0] * b[1] - a[1] * b[0];
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Moeller and Trumbore 1997. */
static void trace_triangle(const double corners[3][3], const double origin[3], const double direction[3],
                           uint32_t instance, uint32_t triangle, struct reference_hit *best)
{
    double edge1[3], edge2[3], to_origin[3], p[3], q[3];
    for (uint32_t k = 0; k < 3; k++) {
        edge1[k] = corners[1][k] - corners[0][k];
        edge2[k] = corners[2][k] - corners[0][k];
        to_origin[k] = origin[k] - corners[0][k];
    }
    cross(direction, edge2, p);
    cross(to_origin, edge1, q);
    const double determinant = dot(edge1, p);
    if (fabs(determinant) < 1e-15) {
        return;
    }
    const double u = dot(to_origin, p) / determinant, v = dot(direction, q) / determinant;
    const double t = dot(edge2, q) / determinant;
    const double inside = fmin(u, fmin(v, 1 - u - v));
    if (t <= 0) {
        return;
    }
    if (inside > -1e-3 && t < best->t * (1 + 1e-3)) {
        best->edge = fmin(best->edge, fabs(inside));
        if (fabs(t / best->t - 1) < 1e-3) {
            best->edge = 0; /* two surfaces at nearly the same distance */
        }
    }
    if (inside >= 0 && t < best->t) {
        *best = (struct reference_hit){
            .t = t, .u = u, .v = v, .edge = best->edge, .instance = instance, .triangle = triangle};
    }
}

static struct reference_hit trace_reference(const float ray[8], const float transforms[INSTANCES][12])
{
    struct reference_hit best = {.t = DBL_MAX, .edge = 1, .instance = UINT32_MAX};
    const double origin[3] = {(double)ray[0], (double)ray[1], (double)ray[2]};
    const double direction[3] = {(double)ray[4], (double)ray[5], (double)ray[6]};
    for (uint32_t i = 0; i < INSTANCES; i++) {
        const bool is_box = i == 1;
        const uint32_t first = is_box ? SHEET_TRIANGLES : 0, count = is_box ? BOX_TRIANGLES : SHEET_TRIANGLES;
        for (uint32_t triangle = 0; triangle < count; triangle++) {
            double corners[3][3];
            for (uint32_t k = 0; k < 3; k++) {
                const uint32_t vertex = indices[(first + triangle) * 3 + k] + (is_box ? SHEET_VERTICES : 0);
                transform_point(transforms[i], vertices[vertex].position, corners[k]);
            }
            trace_triangle((const double(*)[3])corners, origin, direction, i, triangle, &best);
        }
    }
    return best;
}

static void check(bool done, const struct error *error)
{
    if (!done) {
        print_error("%s\n", error->message);
    }
    assert_true(done);
}

static void rays_hit_what_they_should(void **state)
{
    (void)state;
    struct error error;
    static float rays[RAYS][8];
    uint32_t random = 1;
    for (uint32_t i = 0; i < RAYS; i++) {
        /* From anywhere in a cube of 3 m to anywhere in one of 1.5 m. */
        for (uint32_t k = 0; k < 8; k++) {
            random = random * 1664525u + 1013904223u;
            const float number = (float)(random >> 8) / (1 << 24) - 0.5f;
            rays[i][k] = k < 4 ? number * 3 : number * 1.5f - rays[i][k - 4];
        }
    }
    make_meshes();
    assert_true(gpu_memory_in_use(gpu) == 0);
    struct gpu_buffer *vertex_buffer =
        gpu_buffer_create_filled(gpu, "vertices", vertices, sizeof vertices, true, &error);
    check(vertex_buffer != NULL, &error);
    struct gpu_buffer *index_buffer =
        gpu_buffer_create_filled(gpu, "indices", indices, sizeof indices, true, &error);
    check(index_buffer != NULL, &error);
    struct gpu_buffer *ray_buffer = gpu_buffer_create_filled(gpu, "rays", rays, sizeof rays, false, &error);
    check(ray_buffer != NULL, &error);
    const struct gpu_buffer_params read_params = {
        .name = "hits", .size = RAYS * sizeof(struct device_hit), .memory = GPU_MEMORY_READBACK};
    struct gpu_buffer *hits = gpu_buffer_create(gpu, &read_params, &error);
    check(hits != NULL, &error);

    struct gpu_triangles triangles = {
        .vertices = vertex_buffer,
        .vertex_stride = sizeof(struct vertex),
        .vertex_count = SHEET_VERTICES,
        .indices = index_buffer,
        .triangle_count = SHEET_TRIANGLES,
    };
    struct gpu_accel *sheet = gpu_accel_create_bottom(gpu, "sheet", &triangles, &error);
    check(sheet != NULL, &error);
    triangles.first_vertex = SHEET_VERTICES;
    triangles.vertex_count = BOX_VERTICES;
    triangles.first_index = SHEET_TRIANGLES * 3;
    triangles.triangle_count = BOX_TRIANGLES;
    struct gpu_accel *box = gpu_accel_create_bottom(gpu, "box", &triangles, &error);
    check(box != NULL, &error);

    struct gpu_triangles bad = triangles;
    bad.triangle_count++;
    assert_null(gpu_accel_create_bottom(gpu, "too many", &bad, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    bad = triangles;
    bad.vertex_count++;
    assert_null(gpu_accel_create_bottom(gpu, "too far", &bad, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    bad = triangles;
    bad.vertices = ray_buffer;
    assert_null(gpu_accel_create_bottom(gpu, "wrong kind", &bad, &error));
    assert_int_equal(error.status, STATUS_INVALID);

    struct gpu_accel *top = gpu_accel_create_top(gpu, "top", INSTANCES, &error);
    check(top != NULL, &error);
    struct gpu_pipeline_params pipeline_params = {.name = "trace", .binding_mask = 7, .accel_mask = 1};
    pipeline_params.spirv = test_shader_find("gpu_trace.comp", &pipeline_params.spirv_bytes);
    struct gpu_pipeline *pipeline = gpu_pipeline_create(gpu, &pipeline_params, &error);
    check(pipeline != NULL, &error);

    float transforms[INSTANCES][12];
    const struct gpu_bind binds[] = {{.binding = 0, .access = GPU_READ, .accel = top},
                                     {.binding = 1, .access = GPU_READ, .buffer = ray_buffer},
                                     {.binding = 2, .access = GPU_WRITE, .buffer = hits}};
    const struct gpu_dispatch trace = {
        .pipeline = pipeline, .binds = binds, .bind_count = 3, .groups = {RAYS / 64}};
    struct gpu_frame *frame = NULL;
    /* Five poses, each built while the frame before may still trace; the last one is looked at. */
    for (uint32_t step = 0; step < 5; step++) {
        struct gpu_accel_instance instances[INSTANCES];
        place(step, transforms);
        for (uint32_t i = 0; i < INSTANCES; i++) {
            instances[i] =
                (struct gpu_accel_instance){.bottom = i == 1 ? box : sheet, .custom_index = 1000 + i};
            memcpy(instances[i].object_to_world, transforms[i], sizeof transforms[i]);
        }
        frame = gpu_frame_begin(gpu, &error);
        check(frame != NULL, &error);
        gpu_pass_begin(frame, "build");
        gpu_record_accel_build(frame, top, instances, INSTANCES);
        gpu_pass_end(frame);
        gpu_pass_begin(frame, "trace");
        gpu_record_dispatch(frame, &trace);
        gpu_pass_end(frame);
        check(gpu_frame_submit(frame, &error), &error);
    }
    check(gpu_frame_wait(frame, &error), &error);

    const struct device_hit *found = gpu_buffer_map(hits);
    uint32_t hit_count = 0, compared = 0;
    double worst_distance = 0, worst_uv = 0;
    for (uint32_t i = 0; i < RAYS; i++) {
        const struct reference_hit expected = trace_reference(rays[i], (const float(*)[12])transforms);
        if (expected.edge < 1e-4) {
            continue;
        }
        compared++;
        if (expected.instance == UINT32_MAX) {
            assert_true(found[i].instance == UINT32_MAX);
            continue;
        }
        hit_count++;
        assert_int_equal(found[i].instance, 1000 + expected.instance);
        assert_int_equal(found[i].triangle, expected.triangle);
        const float *direction = &rays[i][4];
        const double length = (double)sqrtf(direction[0] * direction[0] + direction[1] * direction[1] +
                                            direction[2] * direction[2]);
        worst_distance = fmax(worst_distance, fabs((double)found[i].t - expected.t) * length);
        worst_uv = fmax(worst_uv,
                        fmax(fabs((double)found[i].u - expected.u), fabs((double)found[i].v - expected.v)));
    }
    print_message("%u of %d rays compared, %u hit; distances within %.2g m, barycentrics within %.2g\n",
                  compared, RAYS, hit_count, worst_distance, worst_uv);
    assert_true(compared > RAYS * 9 / 10 && hit_count > RAYS / 4);
    assert_true(worst_distance < 1e-5);
    assert_true(worst_uv < 1e-4);

    /* No instance: nothing to hit. One too many: refused. */
    frame = gpu_frame_begin(gpu, &error);
    check(frame != NULL, &error);
    gpu_record_accel_build(frame, top, NULL, 0);
    gpu_record_dispatch(frame, &trace);
    check(gpu_frame_submit(frame, &error) && gpu_frame_wait(frame, &error), &error);
    for (uint32_t i = 0; i < RAYS; i++) {
        assert_true(found[i].instance == UINT32_MAX);
    }
    frame = gpu_frame_begin(gpu, &error);
    check(frame != NULL, &error);
    gpu_record_accel_build(frame, top, NULL, INSTANCES + 1);
    assert_false(gpu_frame_submit(frame, &error));
    assert_int_equal(error.status, STATUS_LIMIT);

    gpu_accel_destroy(&top);
    gpu_accel_destroy(&sheet);
    gpu_accel_destroy(&box);
    gpu_pipeline_destroy(&pipeline);
    gpu_buffer_destroy(&vertex_buffer);
    gpu_buffer_destroy(&index_buffer);
    gpu_buffer_destroy(&ray_buffer);
    gpu_buffer_destroy(&hits);
    assert_null(top);
    assert_int_equal(gpu_validation_count(gpu), 0);
}

int main(void)
{
    struct error error;
    const struct gpu_params params = {.cache_dir = "cache", .validation = true};
    gpu = gpu_create(&params, &error);
    if (!gpu) {
        print_error("%s\n", error.message);
        return 1;
    }
    if (!gpu_info(gpu)->has_ray_query) {
        gpu_destroy(&gpu);
        skip_program("the device has no ray query");
    }
    const struct CMUnitTest tests[] = {cmocka_unit_test(rays_hit_what_they_should)};
    const int failures = cmocka_run_group_tests(tests, NULL, NULL);
    gpu_destroy(&gpu);
    return failures;
}
