/* What well-formed glTF becomes: geometry, hierarchy, materials, lights, cameras, animation, and the
 * warnings. */
#include <math.h>
#include <string.h>

#include "tests/support/check.h"
#include "tests/support/glb.h"

static struct scene *import_binary(const char *text, const void *binary, size_t size)
{
    struct error error = {0};
    struct scene *scene = glb_import(glb_quote(text), binary, size, &error);
    if (!scene)
        print_error("%s\n", error.message);
    assert_non_null(scene);
    return scene;
}

/* A unit right triangle in the xy plane: 36 bytes of positions; then 36 of normals along +z; then indices 0
 * 1 2. */
static const struct triangle {
    float positions[9], normals[9];
    uint16_t indices[4];
} triangle = {{0, 0, 0, 1, 0, 0, 0, 1, 0}, {0, 0, 1, 0, 0, 1, 0, 0, 1}, {0, 1, 2, 0}};

#define TRIANGLE_BUFFERS                                                                                     \
    "'buffers':[{'byteLength':80}],'bufferViews':[{'buffer':0,'byteLength':36},"                             \
    "{'buffer':0,'byteOffset':36,'byteLength':36},{'buffer':0,'byteOffset':72,'byteLength':6}],"             \
    "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3'},"                            \
    "{'bufferView':1,'componentType':5126,'count':3,'type':'VEC3'},"                                         \
    "{'bufferView':2,'componentType':5123,'count':3,'type':'SCALAR'}]"
#define TRIANGLE_MESH                                                                                        \
    "'meshes':[{'name':'m','primitives':[{'attributes':{'POSITION':0,'NORMAL':1},'indices':2}]}],"
#define TRIANGLE_MESH_OF(material)                                                                           \
    "'meshes':[{'name':'m','primitives':[{'attributes':{'POSITION':0,'NORMAL':1},'indices':2,'material'"     \
    ":" material "}]}],"

static struct scene *import_triangle(const char *text)
{
    return import_binary(text, &triangle, sizeof triangle);
}

static void test_triangle(void **state)
{
    (void)state;
    struct scene *scene = import_triangle(GLB_ONE_MESH TRIANGLE_MESH TRIANGLE_BUFFERS "}");
    assert_int_equal(scene->triangle_count, 1);
    assert_int_equal(scene->vertex_count, 3);
    assert_string_equal(scene->meshes[0].name, "m");
    assert_int_equal(scene->indices[2], 2);
    assert_true(scene->vertices[1].position[0] == 1 && scene->vertices[1].normal[2] == 1);
    assert_true(scene->meshes[0].bounds_max[0] == 1 && scene->meshes[0].bounds_max[1] == 1 &&
                scene->meshes[0].bounds_max[2] == 0);
    assert_int_equal(scene->materials[scene->meshes[0].material].kind, MATERIAL_DIFFUSE);
    scene_destroy(&scene);
}

/* Normals that are missing are flat and unshared, and lie on the side from which the corners wind
 * counter-clockwise. */
static void test_generates_normals(void **state)
{
    (void)state;
    struct scene *scene = import_triangle(
        GLB_ONE_MESH "'meshes':[{'primitives':[{'attributes':{'POSITION':0}}]}]," TRIANGLE_BUFFERS "}");
    assert_int_equal(scene->vertex_count, 3);
    for (int i = 0; i < 3; i++)
        assert_true(scene->vertices[i].normal[0] == 0 && scene->vertices[i].normal[2] == 1);
    scene_destroy(&scene);
}

/* Zero and NaN normals get the triangle's; unequal lengths become 1; both warned about where a direction was
 * missing. */
static void test_repairs_normals(void **state)
{
    (void)state;
    struct triangle broken = triangle;
    broken.normals[2] = 0;   /* vertex 0: zero */
    broken.normals[3] = NAN; /* vertex 1: NaN */
    broken.normals[8] = 5;   /* vertex 2: too long */
    struct scene *scene =
        import_binary(GLB_ONE_MESH TRIANGLE_MESH TRIANGLE_BUFFERS "}", &broken, sizeof broken);
    for (int i = 0; i < 3; i++) {
        assert_close((double)scene->vertices[i].normal[0], 0, 1e-7);
        assert_close((double)scene->vertices[i].normal[2], 1, 1e-7);
    }
    assert_true(scene_warns(scene, "2 normals have no direction"));
    scene_destroy(&scene);
}

/* Normals decide which side is outside: a mesh that winds against them is turned round. */
static void test_turns_winding(void **state)
{
    (void)state;
    struct triangle turned = triangle;
    turned.indices[1] = 2, turned.indices[2] = 1;
    struct scene *scene =
        import_binary(GLB_ONE_MESH TRIANGLE_MESH TRIANGLE_BUFFERS "}", &turned, sizeof turned);
    assert_int_equal(scene->indices[1], 1);
    assert_int_equal(scene->indices[2], 2);
    assert_true(scene_warns(scene, "wind against its normals"));
    scene_destroy(&scene);
}

/* Five points of a strip and of a fan, as lists worked out by hand from glTF 2.0, 3.7.2.1. */
static void test_strips_and_fans(void **state)
{
    (void)state;
    static const float points[15] = {0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 1, 0, 2, 0, 0};
    static const uint32_t strip[9] = {0, 1, 2, 2, 1, 3, 2, 3, 4}, fan[9] = {0, 1, 2, 0, 2, 3, 0, 3, 4};
    for (int mode = 5; mode <= 6; mode++) {
        char text[1024];
        snprintf(text, sizeof text,
                 GLB_ONE_MESH "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'mode':%d}]}],"
                              "'buffers':[{'byteLength':60}],'bufferViews':[{'buffer':0,'byteLength':60}],"
                              "'accessors':[{'bufferView':0,'componentType':5126,'count':5,'type':'VEC3'}]}",
                 mode);
        struct scene *scene = import_binary(text, points, sizeof points);
        assert_int_equal(scene->triangle_count, 3);
        const uint32_t *expected = mode == 5 ? strip : fan;
        for (int i = 0; i < 9; i++)
            assert_memory_equal(scene->vertices[scene->indices[i]].position, points + 3 * expected[i],
                                3 * sizeof(float));
        scene_destroy(&scene);
    }
}

static void test_leaves_out_points(void **state)
{
    (void)state;
    struct scene *scene = import_triangle(
        GLB_ONE_MESH "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'mode':0}]}]," TRIANGLE_BUFFERS
                     "}");
    assert_int_equal(scene->instance_count, 0);
    assert_true(scene_warns(scene, "points or lines"));
    scene_destroy(&scene);
}

/* Two of three positions replaced through a sparse accessor, and interleaved data with a stride. */
static void test_sparse_and_stride(void **state)
{
    (void)state;
    static const struct {
        float interleaved[24]; /* position, normal */
        uint16_t indices[2];
        float values[6];
    } data = {{0, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 1}, {1, 2}, {3, 0, 0, 0, 4, 0}};
    struct scene *scene = import_binary(
        GLB_ONE_MESH
        "'meshes':[{'primitives':[{'attributes':{'POSITION':0,'NORMAL':1}}]}],"
        "'buffers':[{'byteLength':124}],'bufferViews':[{'buffer':0,'byteLength':96,'byteStride':24},"
        "{'buffer':0,'byteOffset':96,'byteLength':4},{'buffer':0,'byteOffset':100,'byteLength':24}],"
        "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3',"
        "'sparse':{'count':2,'indices':{'bufferView':1,'componentType':5123},'values':{'bufferView':2}}},"
        "{'bufferView':0,'byteOffset':12,'componentType':5126,'count':3,'type':'VEC3'}]}",
        &data, sizeof data);
    assert_true(scene->vertices[1].position[0] == 3 && scene->vertices[2].position[1] == 4);
    assert_true(scene->vertices[2].normal[2] == 1);
    scene_destroy(&scene);
}

/* KHR_mesh_quantization: positions as signed bytes, normals normalised; glTF 2.0, 3.11 gives c / 127. */
static void test_quantized(void **state)
{
    (void)state;
    static const struct {
        int8_t positions[12], normals[12];
    } data = {{0, 0, 0, 0, 100, 0, 0, 0, 0, -128, 0, 0}, {0, 0, -127, 0, 0, 0, -127, 0, 0, 0, -128, 0}};
    struct scene *scene = import_binary(
        "{'asset':{'version':'2.0'},'extensionsUsed':['KHR_mesh_quantization'],"
        "'extensionsRequired':['KHR_mesh_quantization'],'nodes':[{'mesh':0}],"
        "'meshes':[{'primitives':[{'attributes':{'POSITION':0,'NORMAL':1}}]}],'buffers':[{'byteLength':24}],"
        "'bufferViews':[{'buffer':0,'byteLength':12,'byteStride':4},"
        "{'buffer':0,'byteOffset':12,'byteLength':12,'byteStride':4}],"
        "'accessors':[{'bufferView':0,'componentType':5120,'count':3,'type':'VEC3'},"
        "{'bufferView':1,'componentType':5120,'normalized':true,'count':3,'type':'VEC3'}]}",
        &data, sizeof data);
    assert_true(scene->vertices[1].position[0] == 100 && scene->vertices[2].position[1] == -128);
    assert_true(scene->vertices[0].normal[2] == -1 && scene->vertices[2].normal[2] == -1);
    scene_destroy(&scene);
}

/* Children listed before their parents are moved behind them; transforms multiply down the tree. */
static void test_hierarchy(void **state)
{
    (void)state;
    struct scene *scene = import_triangle(
        "{'asset':{'version':'2.0'},'scene':0,'scenes':[{'nodes':[2]}],'nodes':["
        "{'name':'leaf','mesh':0,'translation':[1,0,0]},"
        "{'name':'middle','children':[0],'rotation':[0,0,0.7071067811865476,0.7071067811865476]},"
        "{'name':'root','children':[1],'scale':[2,2,2],'translation':[0,0,5]},"
        "{'name':'elsewhere','mesh':0}]," TRIANGLE_MESH TRIANGLE_BUFFERS "}");
    assert_int_equal(scene->node_count, 3);
    for (uint32_t i = 0; i < scene->node_count; i++)
        assert_true(scene->nodes[i].parent == SCENE_NONE || scene->nodes[i].parent < i);
    assert_int_equal(scene->instance_count, 1);
    struct error error = {0};
    struct scene_pose *pose = scene_pose_create(scene, &error);
    /* leaf's origin: (1,0,0) turned a quarter about z, doubled, moved 5 along z. */
    assert_close((double)pose->instance_to_world[0][3], 0, 1e-6);
    assert_close((double)pose->instance_to_world[0][7], 2, 1e-6);
    assert_close((double)pose->instance_to_world[0][11], 5, 1e-6);
    assert_close((double)pose->instance_to_world[0][4], 2, 1e-6); /* x axis becomes 2 y */
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

/* A chain of 100,000 nodes: nothing may recurse once per node. The last one is 100,000 steps away. */
static void test_deep_chain(void **state)
{
    (void)state;
    const int count = 100000;
    size_t size = (size_t)count * 64 + 2048, at = 0;
    char *text = malloc(size);
    assert_non_null(text);
    at += (size_t)snprintf(text, size, "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[");
    for (int i = 0; i < count - 1; i++)
        at += (size_t)snprintf(text + at, size - at, "{\"children\":[%d],\"translation\":[1,0,0]},", i + 1);
    snprintf(text + at, size - at,
             "{\"camera\":0,\"translation\":[1,0,0]}],\"cameras\":[{\"type\":\"perspective\","
             "\"perspective\":{\"yfov\":1,\"znear\":0.1}}]}");
    struct error error = {0};
    struct scene *scene = glb_import(text, NULL, 0, &error);
    free(text);
    assert_non_null(scene);
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_true(pose->cameras[0].eye[0] == 100000);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

static void test_materials(void **state)
{
    (void)state;
    struct scene *scene = import_triangle(
        GLB_ONE_MESH
        "'materials':["
        "{'name':'plain','pbrMetallicRoughness':{'baseColorFactor':[0.5,0.25,1,1],'metallicFactor':0}},"
        "{'name':'glass','pbrMetallicRoughness':{'metallicFactor':0,'roughnessFactor':0},'extensions':{"
        "'KHR_materials_transmission':{'transmissionFactor':1},'KHR_materials_ior':{'ior':1.33},"
        "'KHR_materials_volume':{'thicknessFactor':0.5,'attenuationDistance':2,'attenuationColor':[0.5,1,0."
        "25]}}},"
        "{'name':'pane','pbrMetallicRoughness':{'metallicFactor':0,'roughnessFactor':0},'extensions':{"
        "'KHR_materials_transmission':{'transmissionFactor':1}}},"
        "{'name':'mirror','pbrMetallicRoughness':{'metallicFactor':1,'roughnessFactor':0.25}},"
        "{'name':'brushed','pbrMetallicRoughness':{'metallicFactor':1,'roughnessFactor':0.26}},"
        "{'name':'lamp','emissiveFactor':[1,0.5,0],'extensions':{"
        "'KHR_materials_emissive_strength':{'emissiveStrength':8}}}]," TRIANGLE_MESH TRIANGLE_BUFFERS "}");
    static const enum material_kind kinds[6] = {MATERIAL_DIFFUSE, MATERIAL_DIELECTRIC, MATERIAL_THIN,
                                                MATERIAL_MIRROR,  MATERIAL_DIFFUSE,    MATERIAL_DIFFUSE};
    for (int i = 0; i < 6; i++)
        assert_int_equal(scene->materials[i].kind, kinds[i]);
    assert_true(scene->materials[0].base_color[1] == 0.25f && scene->materials[0].ior == 1.5f);
    assert_true(scene->materials[1].ior == 1.33f && scene->materials[1].attenuation_distance == 2 &&
                scene->materials[1].attenuation_color[2] == 0.25f);
    assert_true(scene->materials[5].emission[0] == 8 && scene->materials[5].emission[1] == 4);
    assert_true(scene_warns(scene, "\"brushed\": metal of roughness 0.26"));
    scene_destroy(&scene);
}

static void test_lights_and_cameras(void **state)
{
    (void)state;
    struct scene *scene = import_triangle(
        "{'asset':{'version':'2.0'},'extensionsUsed':['KHR_lights_punctual'],'extensions':{'KHR_lights_"
        "punctual':"
        "{'lights':[{'type':'point','name':'lamp','color':[1,0.5,0.25],'intensity':10},"
        "{'type':'spot','intensity':3,'spot':{'innerConeAngle':0.1,'outerConeAngle':0.5}},"
        "{'type':'directional','intensity':2}]}},'nodes':["
        "{'extensions':{'KHR_lights_punctual':{'light':0}},'translation':[1,2,3]},"
        "{'extensions':{'KHR_lights_punctual':{'light':0}}},"
        "{'name':'beam','extensions':{'KHR_lights_punctual':{'light':1}},"
        "'rotation':[-0.7071067811865476,0,0,0.7071067811865476]},"
        "{'extensions':{'KHR_lights_punctual':{'light':2}}},"
        "{'name':'eye','camera':0,'translation':[0,0,4],'scale':[1,3,-2]},{'name':'flat','camera':1}],'"
        "cameras':["
        "{'type':'perspective','perspective':{'yfov':0.75,'znear':0.1,'aspectRatio':1.5}},"
        "{'type':'orthographic','orthographic':{'xmag':1,'ymag':1,'znear':0,'zfar':1}}]," TRIANGLE_BUFFERS
        "}");
    assert_int_equal(scene->light_count, 4);
    static const char *const names[4] = {"lamp", "lamp.1", "beam", "light"};
    for (int i = 0; i < 4; i++)
        assert_string_equal(scene->lights[i].name, names[i]);
    assert_true(scene->lights[0].intensity[1] == 5 && scene->lights[0].intensity[2] == 2.5f);
    assert_true(scene->lights[2].outer_cone == 0.5f && scene->lights[2].inner_cone == 0.1f);
    assert_int_equal(scene->lights[3].type, LIGHT_DIRECTIONAL);
    assert_int_equal(scene->camera_count, 1);
    assert_string_equal(scene->cameras[0].name, "eye");
    assert_true(scene->cameras[0].yfov == 0.75f && scene->cameras[0].aspect == 1.5f);
    assert_true(scene_warns(scene, "not a perspective camera"));
    struct error error = {0};
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_true(pose->lights[0].position[0] == 1 && pose->lights[0].position[2] == 3);
    /* -Z turned by -90 degrees about x points down. */
    assert_close((double)pose->lights[2].direction[1], -1, 1e-6);
    assert_true(pose->lights[3].direction[2] == -1);
    /* A mirrored node looks the other way; up stays across. */
    assert_true(pose->cameras[0].forward[2] == 1 && pose->cameras[0].up[1] == 1);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

/* A unit quad's half (area 0.5) scaled by 2 and mirrored in x: area 2, and the light leaves along the
 * transformed normal. */
static void test_emissive_mesh(void **state)
{
    (void)state;
    struct scene *scene = import_triangle(
        "{'asset':{'version':'2.0'},'nodes':[{'name':'panel','mesh':0,'scale':[-2,2,2],'translation':[0,0,3]}"
        "],"
        "'materials':[{'emissiveFactor':[1,0.5,0.25]}]," TRIANGLE_MESH_OF("0") TRIANGLE_BUFFERS "}");
    assert_int_equal(scene->light_count, 1);
    const struct scene_light *light = &scene->lights[0];
    assert_true(light->is_emissive_mesh && light->type == LIGHT_SPOT);
    assert_close((double)light->outer_cone, 1.5707963267948966, 1e-7);
    assert_close((double)light->intensity[0], 2, 1e-6);
    assert_close((double)light->intensity[2], 0.5, 1e-6);
    struct error error = {0};
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_close((double)pose->lights[0].direction[2], 1, 1e-6);
    assert_close((double)pose->lights[0].position[0], -2.0 / 3, 1e-6);
    assert_close((double)pose->lights[0].position[1], 2.0 / 3, 1e-6);
    /* Before the surface, by a thousandth of its size. */
    assert_close((double)pose->lights[0].position[2], 3 + 1e-3 * sqrt(2.0), 1e-5);
    /* A triangle is no rectangle: the ellipse with its area. */
    assert_int_equal(light->shape, LIGHT_SHAPE_DISK);
    assert_close(3.14159265358979 * (double)(light->half_size[0] * light->half_size[1]), 2, 1e-5);
    assert_close((double)(light->half_size[0] / light->half_size[1]), sqrt(3.0), 1e-4);
    assert_true(scene_warns(scene, "flat disk"));
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

/* A closed tetrahedron: a point light of L * area / 4 in its middle, and no surface to shut it in. */
static void test_closed_emissive_mesh(void **state)
{
    (void)state;
    static const struct {
        float points[12];
        uint16_t corners[12];
    } data = {{1, 1, 1, 1, -1, -1, -1, 1, -1, -1, -1, 1}, {0, 1, 2, 0, 3, 1, 0, 2, 3, 1, 3, 2}};
    struct scene *scene = import_binary(
        GLB_ONE_MESH "'materials':[{'emissiveFactor':[1,1,1]}],"
                     "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'indices':1,'material':0}]}],"
                     "'buffers':[{'byteLength':72}],'bufferViews':[{'buffer':0,'byteLength':48},"
                     "{'buffer':0,'byteOffset':48,'byteLength':24}],"
                     "'accessors':[{'bufferView':0,'componentType':5126,'count':4,'type':'VEC3'},"
                     "{'bufferView':1,'componentType':5123,'count':12,'type':'SCALAR'}]}",
        &data, sizeof data);
    assert_int_equal(scene->light_count, 1);
    assert_int_equal(scene->lights[0].type, LIGHT_POINT);
    assert_false(scene->lights[0].is_emissive_mesh);
    /* Four equilateral triangles of side 2 sqrt 2: area 8 sqrt 3. */
    assert_close((double)scene->lights[0].intensity[0], 2 * sqrt(3.0), 1e-5);
    assert_int_equal(scene->lights[0].shape, LIGHT_SHAPE_SPHERE);
    assert_close((double)scene->lights[0].half_size[0], sqrt(8 * sqrt(3.0) / (4 * 3.14159265358979)), 1e-5);
    assert_int_equal(scene->instance_count, 0);
    struct error error = {0};
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_close((double)pose->lights[0].position[0], 0, 1e-6);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

/* A quad of 2 by 1, turned by 30 degrees in its plane: its own sides, whichever edges its triangles have. */
static void test_emissive_rectangle(void **state)
{
    (void)state;
    float points[12];
    const double c = cos(0.5235987755982988), s = sin(0.5235987755982988);
    for (int i = 0; i < 4; i++) {
        double x = i == 1 || i == 2 ? 1 : -1, y = i >= 2 ? 0.5 : -0.5;
        points[3 * i] = (float)(c * x - s * y);
        points[3 * i + 1] = (float)(s * x + c * y);
        points[3 * i + 2] = 5;
    }
    struct {
        float points[12];
        uint16_t corners[6];
    } data = {.corners = {0, 1, 2, 0, 2, 3}};
    memcpy(data.points, points, sizeof points);
    struct scene *scene = import_binary(
        GLB_ONE_MESH "'materials':[{'emissiveFactor':[1,1,1]}],"
                     "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'indices':1,'material':0}]}],"
                     "'buffers':[{'byteLength':60}],'bufferViews':[{'buffer':0,'byteLength':48},"
                     "{'buffer':0,'byteOffset':48,'byteLength':12}],"
                     "'accessors':[{'bufferView':0,'componentType':5126,'count':4,'type':'VEC3'},"
                     "{'bufferView':1,'componentType':5123,'count':6,'type':'SCALAR'}]}",
        &data, sizeof data);
    assert_int_equal(scene->light_count, 1);
    const struct scene_light *light = &scene->lights[0];
    assert_int_equal(light->shape, LIGHT_SHAPE_RECTANGLE);
    struct error error = {0};
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_non_null(pose);
    const float *side = pose->lights[0].side;
    double along = fabs((double)side[0] * c + (double)side[1] * s);
    bool is_long = along > 0.5;
    assert_close(is_long ? along : 1 - along, 1, 1e-6);
    assert_close((double)light->half_size[is_long ? 0 : 1], 1, 1e-5);
    assert_close((double)light->half_size[is_long ? 1 : 0], 0.5, 1e-5);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

/* Radii from the light's extras and from the node's; what is no radius is named and left. */
static void test_light_radius(void **state)
{
    (void)state;
    struct scene *scene = import_triangle(
        "{'asset':{'version':'2.0'},'extensions':{'KHR_lights_punctual':{'lights':["
        "{'type':'point','extras':{'radius':0.25}},{'type':'spot','spot':{},'extras':{'radius':0.5}},"
        "{'type':'point','name':'none','extras':{'radius':0}},{'type':'point','name':'less','"
        "extras':{'radius':"
        "-1}},{'type':'point','name':'word','extras':{'radius':'big'}},"
        "{'type':'directional','name':'sun','extras':{'radius':1}},"
        "{'type':'point','name':'huge','extras':{'radius':1e30}},{'type':'point','extras':7}]}},"
        "'nodes':[{'extensions':{'KHR_lights_punctual':{'light':0}}},"
        "{'extras':{'radius':0.125},'extensions':{'KHR_lights_punctual':{'light':1}}},"
        "{'extensions':{'KHR_lights_punctual':{'light':2}}},{'extensions':{'KHR_lights_punctual':"
        "{'light':3}}},"
        "{'extensions':{'KHR_lights_punctual':{'light':4}}},{'extensions':{'KHR_lights_punctual':"
        "{'light':5}}},"
        "{'extensions':{'KHR_lights_punctual':{'light':6}}},"
        "{'extensions':{'KHR_lights_punctual':{'light':7}}}]}");
    static const struct {
        enum light_shape shape;
        double radius;
    } wanted[8] = {{LIGHT_SHAPE_SPHERE, 0.25}, {LIGHT_SHAPE_DISK, 0.125}, {LIGHT_SHAPE_POINT, 0},
                   {LIGHT_SHAPE_POINT, 0},     {LIGHT_SHAPE_POINT, 0},    {LIGHT_SHAPE_POINT, 0},
                   {LIGHT_SHAPE_SPHERE, 1e6},  {LIGHT_SHAPE_POINT, 0}};
    assert_int_equal(scene->light_count, 8);
    for (int i = 0; i < 8; i++) {
        assert_int_equal(scene->lights[i].shape, wanted[i].shape);
        assert_close((double)scene->lights[i].half_size[0], wanted[i].radius, 0);
        assert_close((double)scene->lights[i].half_size[1], wanted[i].radius, 0);
    }
    assert_int_equal(scene->warning_count, 4);
    assert_true(scene_warns(scene, "\"less\": its radius is -1"));
    assert_true(scene_warns(scene, "\"word\": its radius is ignored, it is no number"));
    assert_true(scene_warns(scene, "\"sun\": its radius is ignored, a directional light has none"));
    assert_true(scene_warns(scene, "\"huge\": its radius is 1e+30"));
    scene_destroy(&scene);
}

/* KHR_materials_dispersion: as it is within its range; beyond it a warning; nothing on what does not refract.
 */
static void test_dispersion(void **state)
{
    (void)state;
    struct scene *scene = import_triangle("{'asset':{'version':'2.0'},'nodes':[{'mesh':0}]," TRIANGLE_MESH_OF(
        "0") TRIANGLE_BUFFERS ","
                              "'materials':["
                              "{'pbrMetallicRoughness':{'roughnessFactor':0},'extensions':{'KHR_materials_"
                              "transmission':{'transmissionFactor':1},'KHR_materials_volume':{"
                              "'thicknessFactor':1},'KHR_materials_dispersion':{'dispersion':0.36}}},"
                              "{'name':'less','pbrMetallicRoughness':{'roughnessFactor':0},'extensions':{'"
                              "KHR_materials_transmission':{'transmissionFactor':1},'KHR_materials_"
                              "volume':{"
                              "'thicknessFactor':1},'KHR_materials_dispersion':{'dispersion':-3}}},"
                              "{'name':'more','pbrMetallicRoughness':{'roughnessFactor':0},'extensions':{'"
                              "KHR_materials_transmission':{'transmissionFactor':1},'KHR_materials_"
                              "volume':{"
                              "'thicknessFactor':1},'KHR_materials_dispersion':{'dispersion':1e9}}},"
                              "{'pbrMetallicRoughness':{'metallicFactor':0},'extensions':{'KHR_materials_"
                              "dispersion':{'dispersion':1}}},"
                              "{'pbrMetallicRoughness':{'roughnessFactor':0},'extensions':{'KHR_materials_"
                              "transmission':{'transmissionFactor':1},'KHR_materials_volume':{"
                              "'thicknessFactor':1},'KHR_materials_dispersion':{'dispersion':'much'}}}]}");
    static const double wanted[5] = {0.36, 0, 10, 0, 0};
    assert_int_equal(scene->material_count, 5);
    for (int i = 0; i < 5; i++)
        assert_close((double)scene->materials[i].dispersion, wanted[i], 1e-6);
    assert_true(scene_warns(scene, "\"less\": dispersion is -3"));
    assert_true(scene_warns(scene, "\"more\": dispersion is 1e+09"));
    assert_int_equal(scene->warning_count, 2);
    scene_destroy(&scene);
}

static void test_collapsed_instance(void **state)
{
    (void)state;
    struct scene *scene = import_triangle("{'asset':{'version':'2.0'},'nodes':[{'name':'gone','mesh':0,'"
                                          "scale':[1,0,1]},{'mesh':0}]," TRIANGLE_MESH TRIANGLE_BUFFERS "}");
    assert_int_equal(scene->instance_count, 1);
    assert_true(scene_warns(scene, "node \"gone\": its transform has no volume"));
    scene_destroy(&scene);
}

/* Three keys of a translation and two of a rotation; a channel for a node outside the scene is dropped. */
static void test_animation(void **state)
{
    (void)state;
    static const struct {
        float times[3], moves[9], turn_times[2], turns[8];
    } data = {{0, 1, 3}, {0, 0, 0, 2, 0, 0, 2, 6, 0}, {0, 3}, {0, 0, 0, 1, 0, 1, 0, 0}};
    struct scene *scene = import_binary(
        "{'asset':{'version':'2.0'},'nodes':[{'camera':0}],'cameras':[{'type':'perspective','perspective':{'"
        "yfov':1,"
        "'znear':0.1}}],'buffers':[{'byteLength':88}],'bufferViews':[{'buffer':0,'byteLength':12},"
        "{'buffer':0,'byteOffset':12,'byteLength':36},{'buffer':0,'byteOffset':48,'byteLength':8},"
        "{'buffer':0,'byteOffset':56,'byteLength':32}],"
        "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'SCALAR'},"
        "{'bufferView':1,'componentType':5126,'count':3,'type':'VEC3'},"
        "{'bufferView':2,'componentType':5126,'count':2,'type':'SCALAR'},"
        "{'bufferView':3,'componentType':5126,'count':2,'type':'VEC4'}],"
        "'animations':[{'samplers':[{'input':0,'output':1},{'input':2,'output':3,'interpolation':'LINEAR'}],"
        "'channels':[{'sampler':0,'target':{'node':0,'path':'translation'}},"
        "{'sampler':1,'target':{'node':0,'path':'rotation'}},{'sampler':0,'target':{'node':0,'path':'"
        "translation'}}]}]}",
        &data, sizeof data);
    assert_int_equal(scene->channel_count, 2);
    assert_true(scene->duration == 3);
    assert_true(scene_warns(scene, "animated twice"));
    struct error error = {0};
    struct scene_pose *pose = scene_pose_create(scene, &error);
    assert_true(scene_pose_set_time(scene, pose, 2));
    assert_close((double)pose->cameras[0].eye[0], 2, 1e-6);
    assert_close((double)pose->cameras[0].eye[1], 3, 1e-6);
    /* Two thirds of a half turn about y: -Z turned by 120 degrees. */
    assert_close((double)pose->cameras[0].forward[0], -sin(2 * 3.14159265358979 / 3), 1e-6);
    assert_close((double)pose->cameras[0].forward[2], -cos(2 * 3.14159265358979 / 3), 1e-6);
    scene_pose_destroy(&pose);
    scene_destroy(&scene);
}

/* A 1 x 1 PNG, sRGB (255, 128, 0), in a data URI: linear 1, 0.2158605, 0. */
static void test_texture(void **state)
{
    (void)state;
    const char *text = GLB_ONE_MESH
        "'images':[{'uri':'data:image/png;base64,"
        "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAIAAACQd1PeAAAADElEQVR4nGP438AAAAQBAYDFKhhdAAAAAElFTkSuQmCC'}],"
        "'textures':[{'source':0,'sampler':0}],'samplers':[{'wrapS':33071}],"
        "'materials':[{'pbrMetallicRoughness':{'baseColorTexture':{'index':0},'metallicFactor':0}}]"
        "," TRIANGLE_MESH_OF("0") TRIANGLE_BUFFERS "}";
    struct error error = {0};
    struct scene *scene = glb_import(glb_quote(text), &triangle, sizeof triangle, &error);
    assert_non_null(scene);
    if (scene_warns(scene, "CAUSTICD_IMAGES")) {
        assert_int_equal(scene->image_count, 0);
        scene_destroy(&scene);
        return;
    }
    assert_int_equal(scene->image_count, 1);
    assert_true(scene->images[0].clamp_u && !scene->images[0].clamp_v);
    assert_int_equal(scene->materials[0].base_color_image, 0);
    assert_int_equal(scene->images[0].texels[0], 0x3c00);
    assert_int_equal(scene->images[0].texels[1], 0x32e8); /* the half nearest 0.2158605 */
    assert_int_equal(scene->images[0].texels[2], 0);
    assert_int_equal(scene->images[0].texels[3], 0x3c00);
    scene_destroy(&scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_triangle),           cmocka_unit_test(test_generates_normals),
        cmocka_unit_test(test_repairs_normals),    cmocka_unit_test(test_turns_winding),
        cmocka_unit_test(test_strips_and_fans),    cmocka_unit_test(test_leaves_out_points),
        cmocka_unit_test(test_sparse_and_stride),  cmocka_unit_test(test_quantized),
        cmocka_unit_test(test_hierarchy),          cmocka_unit_test(test_deep_chain),
        cmocka_unit_test(test_materials),          cmocka_unit_test(test_lights_and_cameras),
        cmocka_unit_test(test_emissive_mesh),      cmocka_unit_test(test_closed_emissive_mesh),
        cmocka_unit_test(test_emissive_rectangle), cmocka_unit_test(test_light_radius),
        cmocka_unit_test(test_dispersion),         cmocka_unit_test(test_collapsed_instance),
        cmocka_unit_test(test_animation),          cmocka_unit_test(test_texture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
