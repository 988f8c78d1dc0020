/* What is exported is imported again as the same scene, bit for bit. */
#include <string.h>
#include <unistd.h>

#include "tests/support/check.h"
#include "tests/support/glb.h"

static char path[256];

static struct scene *there_and_back(const struct scene *scene)
{
    struct error error = {0};
    if (!scene_export(scene, path, &error))
        print_error("%s\n", error.message);
    struct scene *again = scene_import(path, &error);
    if (!again)
        print_error("%s\n", error.message);
    remove(path);
    assert_non_null(again);
    return again;
}

#define assert_same_list(a, b, list, count)                                                                  \
    do {                                                                                                     \
        assert_int_equal((a)->count, (b)->count);                                                            \
        if ((a)->count)                                                                                      \
            assert_memory_equal((a)->list, (b)->list, (a)->count * sizeof *(a)->list);                       \
    } while (0)

static void assert_same(const struct scene *a, const struct scene *b)
{
    assert_same_list(a, b, vertices, vertex_count);
    assert_same_list(a, b, indices, index_count);
    assert_same_list(a, b, meshes, mesh_count);
    assert_same_list(a, b, materials, material_count);
    assert_same_list(a, b, nodes, node_count);
    assert_same_list(a, b, instances, instance_count);
    assert_same_list(a, b, lights, light_count);
    assert_same_list(a, b, cameras, camera_count);
    assert_int_equal(a->triangle_count, b->triangle_count);
    assert_true(a->duration == b->duration);
    assert_int_equal(a->channel_count, b->channel_count);
    for (uint32_t i = 0; i < a->channel_count; i++) {
        const struct scene_channel *x = &a->channels[i], *y = &b->channels[i];
        assert_true(x->node == y->node && x->path == y->path && x->interpolation == y->interpolation &&
                    x->key_count == y->key_count);
        size_t values = x->key_count * (x->path == ANIMATION_ROTATION ? 4u : 3u) *
                        (x->interpolation == ANIMATION_CUBIC ? 3u : 1u);
        assert_memory_equal(x->times, y->times, x->key_count * sizeof(float));
        assert_memory_equal(x->values, y->values, values * sizeof(float));
    }
}

static void test_builtin_scenes(void **state)
{
    (void)state;
    for (uint32_t i = 0; i < builtin_scene_count; i++) {
        struct error error = {0};
        struct scene *scene = scene_create_builtin(builtin_scenes[i].name, &error);
        assert_non_null(scene);
        struct scene *again = there_and_back(scene);
        assert_int_equal(again->warning_count, 0);
        assert_same(scene, again);
        scene_destroy(&again);
        scene_destroy(&scene);
    }
}

/* Everything the built-in scenes lack: hierarchy, two primitives shared by two nodes, all light types, an
 * emissive mesh, attenuation, animation of all kinds. */
static void test_a_full_scene(void **state)
{
    (void)state;
    static const struct {
        float points[9], times[2], moves[6], turns[8], scales[18];
    } data = {{0, 0, 0, 1, 0, 0, 0, 1, 0},
              {0.25f, 1.0f / 3},
              {0, 0, 0, 0.1f, 0.2f, 0.3f},
              {0, 0, 0, 1, 0, 1, 0, 0},
              {0, 0, 0, 1, 1, 1, 1, 0, 0, 0, 1, 0, 2, 2, 2, 0, 0, 0}};
    struct error error = {0};
    struct scene *scene = glb_import(
        glb_quote(
            "{'asset':{'version':'2.0'},'extensions':{'KHR_lights_punctual':{'lights':["
            "{'type':'point','color':[0.1,0.7,0.3],'intensity':12.3,'extras':{'radius':0.3}},"
            "{'type':'spot','name':'beam','spot':{'innerConeAngle':0.1,'outerConeAngle':0.6}},"
            "{'type':'directional','intensity':0.3}]}},"
            "'materials':[{'name':'liquid','pbrMetallicRoughness':{'metallicFactor':0,'roughnessFactor':0},"
            "'extensions':{'KHR_materials_transmission':{'transmissionFactor':1},'KHR_materials_ior':{'ior':"
            "1.1},"
            "'KHR_materials_dispersion':{'dispersion':0.37},"
            "'KHR_materials_volume':{'thicknessFactor':1,'attenuationDistance':0.3,"
            "'attenuationColor':[0.9,0.8,0.1]}}},{'name':'glow','emissiveFactor':[0.3,1,0.7],'extensions':{"
            "'KHR_materials_emissive_strength':{'emissiveStrength':17.3}}},"
            "{'name':'foil','doubleSided':true,'pbrMetallicRoughness':{'roughnessFactor':0.1}}],"
            "'nodes':[{'name':'top','children':[1,2,3],'rotation':[0.5,0.5,0.5,0.5]},{'name':'a','mesh':0},"
            "{'name':'b','mesh':0,'translation':[0.1,0.2,0.3]},{'name':'c','mesh':1,'scale':[0.3,-0.7,2],"
            "'extensions':{'KHR_lights_punctual':{'light':1}}},{'extensions':{'KHR_lights_punctual':{'light':"
            "0}}},"
            "{'extensions':{'KHR_lights_punctual':{'light':2}},'camera':0}],"
            "'cameras':[{'type':'perspective','perspective':{'yfov':0.7,'znear':0.1,'aspectRatio':1.7}}],"
            "'meshes':[{'name':'pair','primitives':[{'attributes':{'POSITION':0},'material':0},"
            "{'attributes':{'POSITION':0},'material':2}]},"
            "{'name':'lit','primitives':[{'attributes':{'POSITION':0},'material':1}]}],"
            "'buffers':[{'byteLength':172}],'bufferViews':[{'buffer':0,'byteLength':36},"
            "{'buffer':0,'byteOffset':36,'byteLength':8},{'buffer':0,'byteOffset':44,'byteLength':24},"
            "{'buffer':0,'byteOffset':68,'byteLength':32},{'buffer':0,'byteOffset':100,'byteLength':72}],"
            "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3'},"
            "{'bufferView':1,'componentType':5126,'count':2,'type':'SCALAR'},"
            "{'bufferView':2,'componentType':5126,'count':2,'type':'VEC3'},"
            "{'bufferView':3,'componentType':5126,'count':2,'type':'VEC4'},"
            "{'bufferView':4,'componentType':5126,'count':6,'type':'VEC3'}],"
            "'animations':[{'samplers':[{'input':1,'output':2,'interpolation':'STEP'},{'input':1,'output':3},"
            "{'input':1,'output':4,'interpolation':'CUBICSPLINE'}],'channels':["
            "{'sampler':0,'target':{'node':2,'path':'translation'}},"
            "{'sampler':1,'target':{'node':0,'path':'rotation'}},"
            "{'sampler':2,'target':{'node':1,'path':'scale'}}]}]}"),
        &data, sizeof data, &error);
    if (!scene)
        print_error("%s\n", error.message);
    assert_non_null(scene);
    assert_int_equal(scene->instance_count, 5);
    assert_int_equal(scene->mesh_count, 3);
    assert_int_equal(scene->light_count, 4);
    assert_int_equal(scene->channel_count, 3);
    struct scene *again = there_and_back(scene);
    assert_same(scene, again);
    scene_destroy(&again);
    scene_destroy(&scene);
}

static void test_says_why_not(void **state)
{
    (void)state;
    struct error error = {0};
    struct scene *scene = scene_create_builtin("no-caster", &error);
    assert_non_null(scene);
    assert_false(scene_export(scene, "/nowhere/at/all.glb", &error));
    assert_int_equal(error.status, STATUS_IO);
    assert_non_null(strstr(error.message, "/nowhere/at/all.glb"));
    scene_destroy(&scene);
}

int main(void)
{
    const char *folder = getenv("TMPDIR");
    snprintf(path, sizeof path, "%s/causticd_export_%ld.glb", folder ? folder : "/tmp", (long)getpid());
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_builtin_scenes),
        cmocka_unit_test(test_a_full_scene),
        cmocka_unit_test(test_says_why_not),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
