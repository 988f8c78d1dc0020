/* Real files, which are not part of the project: they lie in CAUSTICD_SHARED, or in ../shared beside the
 * checkout. */
#include <math.h>
#include <string.h>
#include <unistd.h>

#include "tests/support/check.h"
#include "tests/support/glb.h"

static char shared[512];

static struct scene *import(const char *name)
{
    char path[600];
    snprintf(path, sizeof path, "%s/%s", shared, name);
    struct error error = {0};
    struct scene *scene = scene_import(path, &error);
    if (!scene)
        print_error("%s\n", error.message);
    assert_non_null(scene);
    return scene;
}

static uint32_t count_kind(const struct scene *scene, enum material_kind kind)
{
    uint32_t triangles = 0;
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        const struct scene_mesh *mesh = &scene->meshes[scene->instances[i].mesh];
        triangles += scene->materials[mesh->material].kind == kind ? mesh->triangle_count : 0;
    }
    return triangles;
}

/* truth/sphere.json and ring.json state all of these; the camera's direction follows from its eye and target.
 */
static void test_truth(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        uint32_t triangles;
        enum material_kind caster;
        double intensity, light[3], eye[3], at[3];
    } scenes[] = {
        {"truth/sphere.glb",
         20480,
         MATERIAL_DIELECTRIC,
         40,
         {1.3, 3.6, -0.7},
         {-2, 2.6, 2.7},
         {-0.15, 0.2, 0.1}},
        {"truth/ring.glb", 4096, MATERIAL_MIRROR, 30, {2.4, 1.7, -0.6}, {0, 2.6, 2}, {0, 0.05, 0}},
    };
    for (int i = 0; i < 2; i++) {
        struct scene *scene = import(scenes[i].name);
        assert_int_equal(scene->warning_count, 0);
        assert_int_equal(count_kind(scene, scenes[i].caster), scenes[i].triangles);
        assert_int_equal(count_kind(scene, MATERIAL_DIFFUSE), 2);
        assert_close((double)scene->materials[0].base_color[0], 0.7, 1e-7);
        assert_true((double)scene->lights[0].intensity[0] == scenes[i].intensity);
        assert_close((double)scene->cameras[0].yfov, 32 * 3.14159265358979 / 180, 1e-6);
        struct error error = {0};
        struct scene_pose *pose = scene_pose_create(scene, &error);
        double length = 0;
        for (int axis = 0; axis < 3; axis++)
            length += (scenes[i].at[axis] - scenes[i].eye[axis]) * (scenes[i].at[axis] - scenes[i].eye[axis]);
        for (int axis = 0; axis < 3; axis++) {
            assert_close((double)pose->lights[0].position[axis], scenes[i].light[axis], 1e-6);
            assert_close((double)pose->cameras[0].eye[axis], scenes[i].eye[axis], 1e-6);
            assert_close((double)pose->cameras[0].forward[axis],
                         (scenes[i].at[axis] - scenes[i].eye[axis]) / sqrt(length), 1e-6);
        }
        scene_pose_destroy(&pose);
        scene_destroy(&scene);
    }
}

/* scenes/README.md states triangles, the ior of 1.8 and the hemispherical spot. */
static void test_water_caustic(void **state)
{
    (void)state;
    struct scene *scene = import("scenes/water-caustic.glb");
    assert_int_equal(scene->triangle_count, 103485);
    assert_int_equal(scene->light_count, 1);
    assert_int_equal(scene->lights[0].type, LIGHT_SPOT);
    assert_close((double)scene->lights[0].outer_cone, 1.5707,
                 1e-7); /* as the file says it: a little under pi/2 */
    assert_true(count_kind(scene, MATERIAL_DIELECTRIC) > 100000);
    for (uint32_t i = 0; i < scene->material_count; i++)
        if (scene->materials[i].kind == MATERIAL_DIELECTRIC)
            assert_true(scene->materials[i].ior == 1.8f);
    scene_destroy(&scene);
}

/* Two emissive quads: each gets a light of emission times area along its normal, and a warning. */
static void test_veach(void **state)
{
    (void)state;
    struct scene *scene = import("scenes/veach-bidir.glb");
    assert_int_equal(scene->triangle_count, 11544);
    assert_int_equal(scene->light_count, 2);
    assert_true(scene->lights[0].is_emissive_mesh && scene->lights[1].is_emissive_mesh);
    assert_true(scene_warns(scene, "emissive mesh"));
    assert_true(scene_warns(scene, "\"Lamp\": metal of roughness 0.5"));
    assert_true(count_kind(scene, MATERIAL_DIELECTRIC) > 0);
    /* Emission 523.2578 over the quad's area, as its two edges give it. */
    for (uint32_t i = 0; i < 2; i++) {
        const struct scene_mesh *mesh = NULL;
        for (uint32_t m = 0; m < scene->instance_count; m++)
            if (!strncmp(scene->nodes[scene->instances[m].node].name, scene->lights[i].name, 8))
                mesh = &scene->meshes[scene->instances[m].mesh];
        assert_non_null(mesh);
        const struct scene_material *material = &scene->materials[mesh->material];
        double area = 0;
        for (uint32_t t = 0; t < mesh->triangle_count; t++) {
            const float *p[3];
            for (uint32_t c = 0; c < 3; c++)
                p[c] = scene->vertices[mesh->first_vertex + scene->indices[mesh->first_index + 3 * t + c]]
                           .position;
            double sides[3]; /* Heron */
            for (int c = 0; c < 3; c++)
                sides[c] =
                    hypot(hypot((double)(p[c][0] - p[(c + 1) % 3][0]), (double)(p[c][1] - p[(c + 1) % 3][1])),
                          (double)(p[c][2] - p[(c + 1) % 3][2]));
            double s = (sides[0] + sides[1] + sides[2]) / 2;
            area += sqrt(s * (s - sides[0]) * (s - sides[1]) * (s - sides[2]));
        }
        for (int channel = 0; channel < 3; channel++)
            assert_close((double)scene->lights[i].intensity[channel],
                         (double)material->emission[channel] * area,
                         1e-4 * (double)material->emission[channel] * area);
    }
    scene_destroy(&scene);
}

int main(void)
{
    const char *given = getenv("CAUSTICD_SHARED"), *source = getenv("CAUSTICD_SOURCE_DIR");
    if (given)
        snprintf(shared, sizeof shared, "%s", given);
    else
        snprintf(shared, sizeof shared, "%s/../shared", source ? source : ".");
    char probe[600];
    snprintf(probe, sizeof probe, "%s/scenes/veach-bidir.glb", shared);
    if (access(probe, R_OK) != 0)
        skip_program("the real scene files are not here (CAUSTICD_SHARED, or ../shared beside the checkout)");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_truth),
        cmocka_unit_test(test_water_caustic),
        cmocka_unit_test(test_veach),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
