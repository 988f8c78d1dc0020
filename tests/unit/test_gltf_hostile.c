/* Files made to do harm: each is refused, and the error names the thing. */
#include <math.h>
#include <string.h>

#include "tests/support/check.h"
#include "tests/support/glb.h"

static const struct triangle {
    float positions[9], normals[9];
    uint16_t indices[4];
} triangle = {{0, 0, 0, 1, 0, 0, 0, 1, 0}, {0, 0, 1, 0, 0, 1, 0, 0, 1}, {0, 1, 2, 0}};

#define HEAD   "{'asset':{'version':'2.0'},"
#define NODES  "'nodes':[{'mesh':0}],"
#define MESH   "'meshes':[{'name':'m','primitives':[{'attributes':{'POSITION':0,'NORMAL':1},'indices':2}]}],"
#define BUFFER "'buffers':[{'byteLength':80}],"
#define VIEWS                                                                                                \
    "'bufferViews':[{'buffer':0,'byteLength':36},{'buffer':0,'byteOffset':36,'byteLength':36},"              \
    "{'buffer':0,'byteOffset':72,'byteLength':6}],"
#define POSITIONS "{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3'}"
#define NORMALS   "{'bufferView':1,'componentType':5126,'count':3,'type':'VEC3'}"
#define INDICES   "{'bufferView':2,'componentType':5123,'count':3,'type':'SCALAR'}"
#define ACCESSORS "'accessors':[" POSITIONS "," NORMALS "," INDICES "]}"
#define DATA      BUFFER VIEWS ACCESSORS
/* One accessor in place of the positions. */
#define WITH_POSITIONS(accessor)                                                                             \
    HEAD NODES MESH BUFFER VIEWS "'accessors':[" accessor "," NORMALS "," INDICES "]}"
#define LIGHT(light, node)                                                                                   \
    HEAD "'extensions':{'KHR_lights_punctual':{'lights':[" light                                             \
         "]}},'nodes':[{'extensions':{'KHR_lights_punctual':{'light':" node "}}}]}"

static const struct {
    const char *what, *text, *said;
    enum status status;
} cases[] = {
    {"not JSON", "hello", "malformed", STATUS_INVALID},
    {"a list", "[1,2,3,4]", "not an object", STATUS_INVALID},
    {"no version", "{'asset':{}}", "version", STATUS_UNSUPPORTED},
    {"version 1", "{'asset':{'version':'1.0'}}", "version \"1.0\"", STATUS_UNSUPPORTED},
    {"number beyond double", HEAD "'nodes':[{'translation':[1e999,0,0]}]}", "malformed", STATUS_INVALID},
    {"draco", HEAD "'extensionsRequired':['KHR_draco_mesh_compression']}", "KHR_draco_mesh_compression",
     STATUS_UNSUPPORTED},
    {"meshopt", HEAD "'extensionsRequired':['EXT_meshopt_compression']}", "EXT_meshopt_compression",
     STATUS_UNSUPPORTED},
    {"unknown extension", HEAD "'extensionsRequired':['VENDOR_magic']}", "VENDOR_magic", STATUS_UNSUPPORTED},
    {"texture transform", HEAD "'extensionsRequired':['KHR_texture_transform']}", "KHR_texture_transform",
     STATUS_UNSUPPORTED},
    {"nodes no list", HEAD "'nodes':7}", "\"nodes\" is not a list", STATUS_INVALID},
    {"node no object", HEAD "'nodes':[7]}", "\"nodes\"[0]", STATUS_INVALID},
    {"mesh without primitives", HEAD "'meshes':[{}]}", "mesh 0 has no primitives", STATUS_INVALID},
    {"primitive without attributes", HEAD "'meshes':[{'primitives':[{}]}]}", "attributes", STATUS_INVALID},

    {"no such mesh", HEAD "'nodes':[{'name':'here','mesh':5}]}", "node \"here\": there is no mesh 5",
     STATUS_INVALID},
    {"no such child", HEAD "'nodes':[{'children':[9]}]}", "there is no node 9", STATUS_INVALID},
    {"negative child", HEAD "'nodes':[{'children':[-1]}]}", "there is no node -1", STATUS_INVALID},
    {"own child", HEAD "'nodes':[{'children':[0]}]}", "its own ancestor", STATUS_INVALID},
    {"cycle of three", HEAD "'nodes':[{'children':[1]},{'children':[2]},{'name':'back','children':[0]}]}",
     "its own ancestor", STATUS_INVALID},
    {"two parents", HEAD "'nodes':[{'children':[2]},{'children':[2]},{'name':'shared'}]}",
     "node \"shared\" has two parents", STATUS_INVALID},
    {"root with parent", HEAD "'scenes':[{'nodes':[1]}],'nodes':[{'children':[1]},{}]}", "is no root",
     STATUS_INVALID},
    {"no such root", HEAD "'scenes':[{'nodes':[4]}],'nodes':[{}]}", "there is no node 4", STATUS_INVALID},
    {"no such scene", HEAD "'scene':3,'scenes':[{}]}", "no scene 3", STATUS_INVALID},
    {"matrix of 15", HEAD "'nodes':[{'matrix':[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0]}]}", "matrix has 15",
     STATUS_INVALID},
    {"matrix with perspective", HEAD "'nodes':[{'name':'p','matrix':[1,0,0,1,0,1,0,0,0,0,1,0,0,0,0,1]}]}",
     "not affine", STATUS_INVALID},
    {"infinite matrix", HEAD "'nodes':[{'name':'far','translation':[1e300,0,0]}]}",
     "node \"far\": its translation is not finite", STATUS_INVALID},
    {"zero rotation", HEAD "'nodes':[{'rotation':[0,0,0,0]}]}", "rotation is zero", STATUS_INVALID},

    {"no such buffer", HEAD BUFFER "'bufferViews':[{'buffer':1,'byteLength':4}]}", "there is no buffer 1",
     STATUS_INVALID},
    {"view past buffer", HEAD BUFFER "'bufferViews':[{'buffer':0,'byteOffset':60,'byteLength':36}]}",
     "do not lie within", STATUS_INVALID},
    {"view that wraps",
     HEAD BUFFER "'bufferViews':[{'buffer':0,'byteOffset':18446744073709551600,'byteLength':36}]}",
     "do not lie within", STATUS_INVALID},
    {"negative offset", HEAD BUFFER "'bufferViews':[{'buffer':0,'byteOffset':-8,'byteLength':36}]}",
     "whole number", STATUS_INVALID},
    {"buffer past chunk", HEAD "'buffers':[{'byteLength':8000}]}", "binary chunk has 80", STATUS_INVALID},
    {"second chunk buffer", HEAD "'buffers':[{'byteLength':80},{'byteLength':80}]}",
     "buffer 1 has no \"uri\"", STATUS_INVALID},
    {"empty buffer", HEAD "'buffers':[{'byteLength':0}]}", "buffer 0 has 0 bytes", STATUS_INVALID},
    {"vast buffer", HEAD "'buffers':[{'byteLength':9007199254740993,'uri':'data:,x'}]}", "9007199254740993",
     STATUS_LIMIT},
    {"external buffer", HEAD "'buffers':[{'byteLength':8,'uri':'/etc/hostname'}]}", "no folder",
     STATUS_INVALID},
    {"short data URI", HEAD "'buffers':[{'byteLength':9,'uri':'data:application/octet-stream;base64,AAAA'}]}",
     "malformed", STATUS_INVALID},

    {"no positions", HEAD NODES "'meshes':[{'name':'m','primitives':[{'attributes':{'NORMAL':1}}]}]," DATA,
     "mesh \"m\" has no POSITION", STATUS_INVALID},
    {"no such accessor", HEAD NODES "'meshes':[{'primitives':[{'attributes':{'POSITION':44}}]}]," DATA,
     "no accessor 44", STATUS_INVALID},
    {"no such material",
     HEAD NODES "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'material':3}]}]," DATA,
     "there is no material 3", STATUS_INVALID},
    {"unknown mode", HEAD NODES "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'mode':77}]}]," DATA,
     "mode 77", STATUS_INVALID},
    {"vec2 positions", WITH_POSITIONS("{'bufferView':0,'componentType':5126,'count':3,'type':'VEC2'}"),
     "wrong number of components", STATUS_INVALID},
    {"doubles", WITH_POSITIONS("{'bufferView':0,'componentType':5130,'count':1,'type':'VEC3'}"),
     "component type 5130", STATUS_INVALID},
    {"component type of nothing",
     WITH_POSITIONS("{'bufferView':0,'componentType':5127,'count':1,'type':'VEC3'}"), "component type",
     STATUS_INVALID},
    {"count past view", WITH_POSITIONS("{'bufferView':0,'componentType':5126,'count':4,'type':'VEC3'}"),
     "POSITION: 4 elements from byte 0 on need 48 bytes", STATUS_INVALID},
    {"offset past view",
     WITH_POSITIONS("{'bufferView':0,'byteOffset':16,'componentType':5126,'count':3,'type':'VEC3'}"),
     "POSITION", STATUS_INVALID},
    {"offset that wraps",
     WITH_POSITIONS(
         "{'bufferView':0,'byteOffset':18446744073709551615,'componentType':5126,'count':3,'type':'VEC3'}"),
     "POSITION", STATUS_INVALID},
    {"absurd count", WITH_POSITIONS("{'bufferView':0,'componentType':5126,'count':4000000000,'type':'VEC3'}"),
     "4000000000 elements", STATUS_LIMIT},
    {"count beyond 64 bits' product",
     WITH_POSITIONS("{'bufferView':0,'componentType':5126,'count':1537228672809129302,'type':'VEC3'}"),
     "1537228672809129302", STATUS_LIMIT},
    {"vast without data", WITH_POSITIONS("{'componentType':5126,'count':50000000,'type':'VEC3'}"),
     "without data", STATUS_LIMIT},
    {"no elements", WITH_POSITIONS("{'bufferView':0,'componentType':5126,'count':0,'type':'VEC3'}"),
     "no elements", STATUS_INVALID},
    {"no such view", WITH_POSITIONS("{'bufferView':8,'componentType':5126,'count':3,'type':'VEC3'}"),
     "no buffer view 8", STATUS_INVALID},
    {"sparse index past the end",
     WITH_POSITIONS(
         "{'bufferView':0,'componentType':5126,'count':2,'type':'VEC3','sparse':{'count':1,'indices':"
         "{'bufferView':2,'byteOffset':4,'componentType':5123},'values':{'bufferView':1}}}"),
     "sparse index 0 is 2", STATUS_INVALID},
    {"sparse indices not rising",
     WITH_POSITIONS(
         "{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3','sparse':{'count':2,'indices':"
         "{'bufferView':0,'componentType':5121},'values':{'bufferView':1}}}"),
     "sparse index 1", STATUS_INVALID},
    {"sparse count above count",
     WITH_POSITIONS(
         "{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3','sparse':{'count':4,'indices':"
         "{'bufferView':2,'componentType':5121},'values':{'bufferView':1}}}"),
     "4 sparse values", STATUS_INVALID},
    {"sparse values past view",
     WITH_POSITIONS(
         "{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3','sparse':{'count':1,'indices':"
         "{'bufferView':2,'componentType':5121},'values':{'bufferView':1,'byteOffset':28}}}"),
     "POSITION", STATUS_INVALID},
    {"negative sparse offset",
     WITH_POSITIONS(
         "{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3','sparse':{'count':1,'indices':"
         "{'bufferView':2,'byteOffset':-2,'componentType':5121},'values':{'bufferView':1}}}"),
     "accessor 0, sparse: \"byteOffset\" is not a whole number", STATUS_INVALID},
    {"sparse offset that wraps",
     WITH_POSITIONS(
         "{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3','sparse':{'count':1,'indices':"
         "{'bufferView':2,'byteOffset':4294967296,'componentType':5121},'values':{'bufferView':1}}}"),
     "beyond any buffer", STATUS_INVALID},
    {"sparse without values",
     WITH_POSITIONS(
         "{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3','sparse':{'count':1,'indices':"
         "{'bufferView':2,'componentType':5121}}}"),
     "accessor 0, sparse has no \"values\"", STATUS_INVALID},
    {"half a count", WITH_POSITIONS("{'bufferView':0,'componentType':5126,'count':2.5,'type':'VEC3'}"),
     "accessor 0: \"count\" is not a whole number", STATUS_INVALID},
    {"float indices",
     HEAD NODES "'meshes':[{'primitives':[{'attributes':{'POSITION':1},'indices':0}]}]," BUFFER VIEWS
                "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'SCALAR'}," NORMALS "]}",
     "indices of component type 5126", STATUS_INVALID},
    {"stride below element",
     HEAD NODES MESH BUFFER
     "'bufferViews':[{'buffer':0,'byteLength':36,'byteStride':4},{'buffer':0,'byteLength':36},"
     "{'buffer':0,'byteLength':6}]," ACCESSORS,
     "stride of 4", STATUS_INVALID},
    {"stride of 253", HEAD BUFFER "'bufferViews':[{'buffer':0,'byteLength':36,'byteStride':253}]}",
     "byteStride", STATUS_INVALID},
    {"fewer normals",
     HEAD NODES MESH BUFFER VIEWS
     "'accessors':[" POSITIONS ",{'bufferView':1,'componentType':5126,'count':2,'type':'VEC3'}," INDICES "]}",
     "equally many", STATUS_INVALID},
    {"index out of range",
     HEAD NODES MESH BUFFER VIEWS
     "'accessors':[{'bufferView':0,'componentType':5126,'count':2,'type':'VEC3'},"
     "{'bufferView':1,'componentType':5126,'count':2,'type':'VEC3'}," INDICES "]}",
     "mesh \"m\", index 2: vertex 2 of 2", STATUS_INVALID},

    {"no such light", LIGHT("{'type':'point'}", "4"), "no light 4", STATUS_INVALID},
    {"light of no type", LIGHT("{'type':'laser'}", "0"), "type \"laser\"", STATUS_INVALID},
    {"negative light", LIGHT("{'type':'point','name':'dark','intensity':-1}", "0"), "light \"dark\"",
     STATUS_INVALID},
    {"endless light", LIGHT("{'type':'point','intensity':1e300}", "0"), "1e+300", STATUS_INVALID},
    {"spot inside out", LIGHT("{'type':'spot','spot':{'innerConeAngle':1,'outerConeAngle':0.5}}", "0"),
     "cone angles", STATUS_INVALID},
    {"spot too wide", LIGHT("{'type':'spot','spot':{'outerConeAngle':3}}", "0"), "cone angles",
     STATUS_INVALID},
    {"no such camera", HEAD "'nodes':[{'camera':0}]}", "no camera 0", STATUS_INVALID},
    {"wide camera",
     HEAD "'nodes':[{'camera':0}],'cameras':[{'type':'perspective','perspective':{'yfov':4,'znear':1}}]}",
     "field of view of 4", STATUS_INVALID},
    {"no such texture", HEAD "'materials':[{'pbrMetallicRoughness':{'baseColorTexture':{'index':0}}}]}",
     "no texture 0", STATUS_INVALID},
    {"no such image",
     HEAD
     "'textures':[{'source':6}],'materials':[{'pbrMetallicRoughness':{'baseColorTexture':{'index':0}}}]}",
     "no image 6", STATUS_INVALID},
    {"image view out of range", HEAD "'images':[{'bufferView':6,'mimeType':'image/png'}]}",
     "no buffer view 6", STATUS_INVALID},
};

static void test_cases(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct error error = {0};
        struct scene *scene = glb_import(glb_quote(cases[i].text), &triangle, sizeof triangle, &error);
        if (scene || error.status != cases[i].status || !strstr(error.message, cases[i].said)) {
            print_error("%s: %s: %s\n", cases[i].what, scene ? "imported" : status_name(error.status),
                        error.message);
            scene_destroy(&scene);
            fail();
        }
    }
}

/* The file all the cases above deviate from is fine: they are refused for what they say. */
static void test_the_honest_file(void **state)
{
    (void)state;
    struct error error = {0};
    struct scene *scene = glb_import(glb_quote(HEAD NODES MESH DATA), &triangle, sizeof triangle, &error);
    assert_non_null(scene);
    assert_int_equal(scene->warning_count, 0);
    scene_destroy(&scene);
}

static void test_nonfinite_positions(void **state)
{
    (void)state;
    static const float values[] = {NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 3; i++) {
        struct triangle broken = triangle;
        broken.positions[5] = values[i];
        struct error error = {0};
        assert_null(glb_import(glb_quote(HEAD NODES MESH DATA), &broken, sizeof broken, &error));
        assert_non_null(strstr(error.message, "mesh \"m\", vertex 1: position is not finite"));
    }
}

/* Coordinates whose squares and areas leave the range of float: in a mesh an error, by a transform the node's
 * end. */
static void test_far_away(void **state)
{
    (void)state;
    struct triangle far_off = triangle;
    far_off.positions[3] = 1.1e9f;
    struct error error = {0};
    assert_null(glb_import(glb_quote(HEAD NODES MESH DATA), &far_off, sizeof far_off, &error));
    assert_non_null(strstr(error.message, "mesh \"m\", vertex 1: a coordinate of 1.1e+09"));
    struct scene *scene = glb_import(glb_quote(HEAD "'nodes':[{'mesh':0},{'name':'far','mesh':0,'translation'"
                                                    ":[0,2e9,0]},{'mesh':0,'scale':[1e30,1e30,"
                                                    "1e30],'name':'vast'}]," MESH DATA),
                                     &triangle, sizeof triangle, &error);
    assert_non_null(scene);
    assert_int_equal(scene->instance_count, 1);
    assert_true(scene_warns(scene, "\"far\"") && scene_warns(scene, "\"vast\""));
    scene_destroy(&scene);
}

/* Cut at every length, nothing of it is accepted and nothing outside it is read (a sanitizer build would
 * say). */
static void test_truncated(void **state)
{
    (void)state;
    struct glb glb = glb_make(glb_quote(HEAD NODES MESH DATA), &triangle, sizeof triangle);
    for (size_t size = 0; size < glb.size; size++) {
        unsigned char *cut = malloc(size + 1);
        assert_non_null(cut);
        memcpy(cut, glb.bytes, size);
        struct error error = {0};
        assert_null(scene_import_memory(cut, size, &error));
        assert_true(error.status != STATUS_OK && *error.message);
        free(cut);
    }
    free(glb.bytes);
}

/* Lengths in the GLB's headers that do not tell the truth. */
static void test_lying_lengths(void **state)
{
    (void)state;
    static const size_t places[] = {8, 12};
    static const uint32_t lies[] = {0, 19, 0x7fffffff, 0xfffffff0, 0xffffffff};
    struct glb glb = glb_make(glb_quote(HEAD NODES MESH DATA), &triangle, sizeof triangle);
    uint32_t json_size = 0;
    memcpy(&json_size, glb.bytes + 12, 4);
    const size_t all[] = {places[0], places[1], 20 + json_size};
    for (int place = 0; place < 3; place++)
        for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
            unsigned char *copy = malloc(glb.size);
            assert_non_null(copy);
            memcpy(copy, glb.bytes, glb.size);
            memcpy(copy + all[place], &lies[i], 4);
            struct error error = {0};
            struct scene *scene = scene_import_memory(copy, glb.size, &error);
            if (scene)
                print_error("length %u at byte %zu was believed\n", lies[i], all[place]);
            assert_null(scene);
            free(copy);
        }
    free(glb.bytes);
}

/* Half a million brackets, in places where a recursive parser would follow them. */
static void test_nesting_bombs(void **state)
{
    (void)state;
    const size_t depth = 500000;
    static const char *const openings[] = {"[", "{\"a\":"};
    for (int kind = 0; kind < 2; kind++) {
        size_t length = strlen(openings[kind]);
        char *text = malloc(depth * length + 128);
        assert_non_null(text);
        size_t at = (size_t)sprintf(text, "{\"asset\":{\"version\":\"2.0\"},\"extras\":");
        for (size_t i = 0; i < depth; i++, at += length)
            memcpy(text + at, openings[kind], length);
        text[at] = 0;
        struct error error = {0};
        assert_null(glb_import(text, NULL, 0, &error));
        assert_int_equal(error.status, STATUS_LIMIT);
        assert_non_null(strstr(error.message, "nested"));
        free(text);
    }
}

/* Nine million small values in ten megabytes of text. */
static void test_too_many_values(void **state)
{
    (void)state;
    const size_t count = 9000000;
    char *text = malloc(2 * count + 128);
    assert_non_null(text);
    size_t at = (size_t)sprintf(text, "{\"asset\":{\"version\":\"2.0\"},\"extras\":[0");
    for (size_t i = 0; i < count; i++, at += 2)
        memcpy(text + at, ",0", 2);
    strcpy(text + at, "]}");
    struct error error = {0};
    assert_null(glb_import(text, NULL, 0, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    free(text);
}

/* One small accessor drawn by many primitives on many nodes: instances are cheap, but there is an end to
 * them. */
static void test_too_many_instances(void **state)
{
    (void)state;
    const int count = SCENE_MAX_INSTANCES + 1;
    char *text = malloc((size_t)count * 16 + 2048);
    assert_non_null(text);
    size_t at = (size_t)sprintf(text, "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"mesh\":0}");
    for (int i = 1; i < count; i++)
        at += (size_t)sprintf(text + at, ",{\"mesh\":0}");
    strcpy(text + at, "],");
    strcat(text + at, glb_quote(MESH DATA));
    struct error error = {0};
    assert_null(glb_import(text, &triangle, sizeof triangle, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_non_null(strstr(error.message, "65536 instances"));
    free(text);
}

/* Primitives that each name four million positions and draw nothing with them: no vertex is kept, but reading
 * has an end. */
static void test_too_much_reading(void **state)
{
    (void)state;
    const int count = 100000;
    static const char primitive[] = "{\"attributes\":{\"POSITION\":0},\"indices\":1,\"mode\":5},";
    char *text = malloc((size_t)count * sizeof primitive + 1024);
    assert_non_null(text);
    size_t at = (size_t)sprintf(text, "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"mesh\":0}],"
                                      "\"meshes\":[{\"primitives\":[");
    for (int i = 0; i < count; i++, at += sizeof primitive - 1)
        memcpy(text + at, primitive, sizeof primitive);
    strcpy(text + at - 1, glb_quote("]}]," BUFFER "'bufferViews':[{'buffer':0,'byteLength':80}],'accessors':["
                                    "{'componentType':5126,'count':4000000,'type':'VEC3'},"
                                    "{'bufferView':0,'componentType':5121,'count':3,'type':'SCALAR'}]}"));
    static const unsigned char zeros[80];
    struct error error = {0};
    assert_null(glb_import(text, zeros, sizeof zeros, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_non_null(strstr(error.message, "numbers to read"));
    free(text);
}

/* Names with escape sequences, and longer than any field, come out harmless. */
static void test_hostile_names(void **state)
{
    (void)state;
    char text[4096], name[1024];
    memset(name, 'x', sizeof name - 1);
    name[sizeof name - 1] = 0;
    memcpy(name, "\\u001b[2Jé", 11);
    snprintf(
        text, sizeof text,
        "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"name\":\"%s\",\"camera\":0}],\"cameras\":[{\"type\":"
        "\"perspective\",\"perspective\":{\"yfov\":1,\"znear\":1}}]}",
        name);
    struct error error = {0};
    struct scene *scene = glb_import(text, NULL, 0, &error);
    assert_non_null(scene);
    assert_memory_equal(scene->nodes[0].name, "?[2Jé", 6);
    assert_int_equal(strlen(scene->cameras[0].name), SCENE_NAME_SIZE - 1);
    scene_destroy(&scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_the_honest_file),
        cmocka_unit_test(test_cases),
        cmocka_unit_test(test_nonfinite_positions),
        cmocka_unit_test(test_truncated),
        cmocka_unit_test(test_lying_lengths),
        cmocka_unit_test(test_nesting_bombs),
        cmocka_unit_test(test_too_many_values),
        cmocka_unit_test(test_too_many_instances),
        cmocka_unit_test(test_too_much_reading),
        cmocka_unit_test(test_hostile_names),
        cmocka_unit_test(test_far_away),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
