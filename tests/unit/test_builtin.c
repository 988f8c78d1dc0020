/* The built-in scenes: the thesis' triangle counts, closed solids, outward normals, cameras that see, quick
 * to make. */
#include <math.h>
#include <string.h>
#include <time.h>

#include "tests/support/check.h"
#include "tests/support/glb.h"

static struct scene *make(const char *name)
{
    struct error error = {0};
    struct scene *scene = scene_create_builtin(name, &error);
    if (!scene)
        print_error("%s\n", error.message);
    assert_non_null(scene);
    return scene;
}

static const struct scene_mesh *mesh_named(const struct scene *scene, const char *name)
{
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        if (!strcmp(scene->meshes[i].name, name))
            return &scene->meshes[i];
    fail_msg("no mesh \"%s\"", name);
    return NULL;
}

static void get_triangle(const struct scene *scene, const struct scene_mesh *mesh, uint32_t triangle,
                         const struct scene_vertex *corners[3])
{
    for (int i = 0; i < 3; i++)
        corners[i] = &scene->vertices[mesh->first_vertex +
                                      scene->indices[mesh->first_index + 3 * triangle + (uint32_t)i]];
}

static void cross(const float a[3], const float b[3], const float c[3], double out[3])
{
    double u[3], v[3];
    for (int i = 0; i < 3; i++)
        u[i] = (double)b[i] - (double)a[i], v[i] = (double)c[i] - (double)a[i];
    for (int i = 0; i < 3; i++)
        out[i] = u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3];
}

/* aaps-thesis 4.1.1 to 4.1.3, and the icosphere's 20 * 4^n. */
static void test_triangle_counts(void **state)
{
    (void)state;
    struct scene *square = make("square"), *pool = make("pool"), *cornell = make("cornell"),
                 *sphere = make("sphere");
    assert_int_equal(square->triangle_count, 42668);
    assert_int_equal(mesh_named(square, "floor")->triangle_count, 2);
    assert_int_equal(mesh_named(square, "ball")->triangle_count, 20480);
    assert_int_equal(mesh_named(square, "wine glass")->triangle_count, 21218);
    assert_int_equal(mesh_named(square, "gem")->triangle_count, 968);
    assert_int_equal(pool->triangle_count, 781276);
    assert_int_equal(mesh_named(cornell, "ball")->triangle_count, 5120);
    assert_int_equal(mesh_named(cornell, "box")->triangle_count, 10);
    assert_int_equal(mesh_named(sphere, "ball")->triangle_count, 20480);
    scene_destroy(&square);
    scene_destroy(&pool);
    scene_destroy(&cornell);
    scene_destroy(&sphere);
}

static int compare_edges(const void *a, const void *b)
{
    const uint64_t *x = a, *y = b;
    return *x < *y ? -1 : *x > *y;
}

/* Vertices at the same place get the same number: faceted solids do not share theirs. */
static uint32_t *weld(const struct scene *scene, const struct scene_mesh *mesh)
{
    uint32_t *numbers = malloc(mesh->vertex_count * sizeof *numbers);
    assert_non_null(numbers);
    const struct scene_vertex *vertices = scene->vertices + mesh->first_vertex;
    bool is_shared = mesh->vertex_count < 3 * mesh->triangle_count;
    for (uint32_t i = 0; i < mesh->vertex_count; i++) {
        numbers[i] = i;
        for (uint32_t j = 0; (!is_shared || mesh->vertex_count < 3000) && j < i; j++)
            if (!memcmp(vertices[i].position, vertices[j].position, sizeof vertices[i].position)) {
                numbers[i] = numbers[j];
                break;
            }
    }
    return numbers;
}

/* Every edge is walked once in each direction: closed, and wound the same way all over. The divergence
 * theorem's volume is positive: wound outward. Returns it. */
static double assert_closed(const struct scene *scene, const char *name)
{
    const struct scene_mesh *mesh = mesh_named(scene, name);
    uint32_t *numbers = weld(scene, mesh);
    size_t count = 3 * (size_t)mesh->triangle_count;
    uint64_t *forward = malloc(count * sizeof *forward), *backward = malloc(count * sizeof *backward);
    assert_true(forward && backward);
    double volume = 0;
    for (uint32_t i = 0; i < mesh->triangle_count; i++) {
        const struct scene_vertex *corners[3];
        get_triangle(scene, mesh, i, corners);
        double area[3];
        cross(corners[0]->position, corners[1]->position, corners[2]->position, area);
        for (int axis = 0; axis < 3; axis++)
            volume += area[axis] * (double)corners[0]->position[axis] / 6;
        for (int edge = 0; edge < 3; edge++) {
            uint64_t from = numbers[corners[edge] - scene->vertices - mesh->first_vertex];
            uint64_t to = numbers[corners[(edge + 1) % 3] - scene->vertices - mesh->first_vertex];
            forward[3 * i + (uint32_t)edge] = from << 32 | to;
            backward[3 * i + (uint32_t)edge] = to << 32 | from;
        }
    }
    qsort(forward, count, sizeof *forward, compare_edges);
    qsort(backward, count, sizeof *backward, compare_edges);
    assert_memory_equal(forward, backward, count * sizeof *forward);
    for (size_t i = 1; i < count; i++)
        assert_true(forward[i] != forward[i - 1]);
    assert_true(volume > 0);
    free(numbers);
    free(forward);
    free(backward);
    return volume;
}

/* Of N equal triangles with their corners on the sphere. A side L has L^2 = 16 pi r^2 / (sqrt 3 N), the
 * triangle's mean sagitta is L^2 / 8r, and three times that over r is the share of the volume that is
 * missing: 2 pi sqrt 3 / N. */
static double inscribed_volume(double radius, double triangles)
{
    const double pi = 3.14159265358979323846;
    return 4 * pi / 3 * radius * radius * radius * (1 - 2 * pi * sqrt(3.0) / triangles);
}

/* Closed solids, their volumes against closed forms where there is one. */
static void test_solids(void **state)
{
    (void)state;
    const double pi = 3.14159265358979323846;
    struct scene *sphere = make("sphere"), *square = make("square"), *cornell = make("cornell"),
                 *cube = make("cube"), *prism = make("prism");
    assert_close(assert_closed(sphere, "ball"), inscribed_volume(0.5, 20480), 2e-5 * 0.5236);
    assert_close(assert_closed(cornell, "ball"), inscribed_volume(0.36, 5120), 8e-5 * 0.1954);
    assert_close(assert_closed(cube, "cube"), 1, 1e-6);
    /* Pappus: 2 pi^2 R r^2; the polygons of 128 by 64 lack some 0.2 %. */
    assert_close(assert_closed(cube, "torus"), 2 * pi * pi * 0.27 * 0.01, 3e-3 * 0.0533);
    assert_close(assert_closed(prism, "prism"), sqrt(3.0) / 4 * 0.49 * 1.2, 1e-6);
    assert_closed(square, "ball");
    assert_closed(square, "gem");
    double glass = assert_closed(square, "wine glass");
    /* A wall of about 2 cm, not a filled bowl: the bowl alone would hold some 60 litres. */
    assert_true(glass > 0.005 && glass < 0.03);
    scene_destroy(&sphere);
    scene_destroy(&square);
    scene_destroy(&cornell);
    scene_destroy(&cube);
    scene_destroy(&prism);
}

/* Unit normals everywhere, on the side from which the triangles wind counter-clockwise; no flat triangles. */
static void test_normals(void **state)
{
    (void)state;
    for (uint32_t s = 0; s < builtin_scene_count; s++) {
        struct scene *scene = make(builtin_scenes[s].name);
        for (uint32_t i = 0; i < scene->vertex_count; i++) {
            const float *n = scene->vertices[i].normal;
            assert_close(sqrt((double)(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])), 1, 1e-6);
        }
        for (uint32_t m = 0; m < scene->mesh_count; m++)
            for (uint32_t i = 0; i < scene->meshes[m].triangle_count; i++) {
                const struct scene_vertex *corners[3];
                get_triangle(scene, &scene->meshes[m], i, corners);
                double area[3], length = 0, dot = 0;
                cross(corners[0]->position, corners[1]->position, corners[2]->position, area);
                for (int axis = 0; axis < 3; axis++) {
                    length += area[axis] * area[axis];
                    for (int corner = 0; corner < 3; corner++)
                        dot += area[axis] * (double)corners[corner]->normal[axis] / 3;
                }
                /* Shading may lean, but never over the edge: 0.5 is 60 degrees. */
                if (!(length > 1e-18 && dot > 0.5 * sqrt(length))) {
                    print_error("%s, mesh %s, triangle %u: area %g, cosine %g\n", scene->name,
                                scene->meshes[m].name, i, sqrt(length) / 2, dot / sqrt(length));
                    fail();
                }
            }
        scene_destroy(&scene);
    }
}

/* The wall of the wine glass: at heights across the bowl, outer less inner radius. */
static void test_wine_glass_wall(void **state)
{
    (void)state;
    struct scene *scene = make("square");
    const struct scene_mesh *mesh = mesh_named(scene, "wine glass");
    for (double height = 0.55; height < 0.92; height += 0.02) {
        double outer = 0, inner = 10;
        for (uint32_t i = 0; i < mesh->vertex_count; i++) {
            const struct scene_vertex *vertex = &scene->vertices[mesh->first_vertex + i];
            if (fabs((double)vertex->position[1] - height) > 0.03)
                continue;
            double x = (double)vertex->position[0], z = (double)vertex->position[2] + 0.35;
            bool is_outside = x * (double)vertex->normal[0] + z * (double)vertex->normal[2] > 0;
            double radius = hypot(x, z);
            if (is_outside && radius > outer)
                outer = radius;
            if (!is_outside && radius < inner)
                inner = radius;
        }
        assert_true(outer - inner > 0.005 && outer - inner < 0.08);
    }
    scene_destroy(&scene);
}

/* Names that clients use; each camera sees the middle of what it should, and nothing but `empty` lacks a
 * light. */
static void test_lights_and_cameras(void **state)
{
    (void)state;
    for (uint32_t s = 0; s < builtin_scene_count; s++) {
        struct scene *scene = make(builtin_scenes[s].name);
        bool is_empty = !strcmp(builtin_scenes[s].name, "empty");
        assert_int_equal(scene->light_count, is_empty ? 0 : 1);
        bool has_second_view = !strcmp(scene->name, "square") || !strcmp(scene->name, "pool");
        assert_int_equal(scene->camera_count, is_empty ? 0 : has_second_view ? 2 : 1);
        assert_int_equal(scene->warning_count, 0);
        if (!is_empty) {
            assert_string_equal(scene->lights[0].name, strcmp(scene->name, "prism") ? "lamp" : "sun");
            assert_string_equal(scene->cameras[0].name, "camera");
        } else {
            assert_int_equal(scene->triangle_count, 0);
            assert_int_equal(scene->node_count, 0);
        }
        uint32_t casters = 0;
        for (uint32_t i = 0; i < scene->instance_count; i++)
            casters +=
                scene->materials[scene->meshes[scene->instances[i].mesh].material].kind != MATERIAL_DIFFUSE;
        assert_int_equal(casters > 0, !is_empty && strcmp(builtin_scenes[s].name, "no-caster") != 0);
        scene_destroy(&scene);
    }
}

/* The pool: lamp above every wave, camera below every wave, the sheet's edge inside the walls. */
static void test_pool(void **state)
{
    (void)state;
    struct scene *scene = make("pool");
    const struct scene_mesh *water = mesh_named(scene, "water"), *walls = mesh_named(scene, "pool");
    struct error error = {0};
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_non_null(pose);
    assert_true(pose->lights[0].position[1] > water->bounds_max[1]);
    assert_true(pose->cameras[0].eye[1] < water->bounds_min[1]);
    assert_string_equal(scene->cameras[1].name, "above");
    assert_true(pose->cameras[1].eye[1] > walls->bounds_max[1]);
    assert_true(water->bounds_max[0] > 2 && water->bounds_max[0] < walls->bounds_max[0]);
    assert_true(water->bounds_min[2] < -2 && water->bounds_min[2] > walls->bounds_min[2]);
    assert_true(water->bounds_max[1] < walls->bounds_max[1]);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

static void test_deterministic_and_quick(void **state)
{
    (void)state;
    for (uint32_t s = 0; s < builtin_scene_count; s++) {
        struct timespec begin, end;
        clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &begin);
        struct scene *a = make(builtin_scenes[s].name);
        clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &end);
        double elapsed = (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec);
        print_message("%s: %.0f ms\n", builtin_scenes[s].name, 1e3 * elapsed);
#ifdef NDEBUG /* an unoptimised build is no measure */
        assert_in_bound(elapsed, 1.0);
#endif
        struct scene *b = make(builtin_scenes[s].name);
        assert_int_equal(a->vertex_count, b->vertex_count);
        if (a->vertex_count) {
            assert_memory_equal(a->vertices, b->vertices, a->vertex_count * sizeof *a->vertices);
            assert_memory_equal(a->indices, b->indices, a->index_count * sizeof *a->indices);
        }
        scene_destroy(&a);
        scene_destroy(&b);
    }
}

static void test_unknown_name(void **state)
{
    (void)state;
    struct error error = {0};
    assert_null(scene_create_builtin("spher", &error));
    assert_int_equal(error.status, STATUS_NOT_FOUND);
    assert_non_null(strstr(error.message, "\"spher\""));
    assert_non_null(strstr(error.message, "no-caster"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_triangle_counts),
        cmocka_unit_test(test_solids),
        cmocka_unit_test(test_normals),
        cmocka_unit_test(test_wine_glass_wall),
        cmocka_unit_test(test_lights_and_cameras),
        cmocka_unit_test(test_pool),
        cmocka_unit_test(test_deterministic_and_quick),
        cmocka_unit_test(test_unknown_name),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
