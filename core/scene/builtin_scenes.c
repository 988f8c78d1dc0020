#include "builtin_scenes.h"

#include "shapes.h"

#define PI 3.14159265358979323846

/* ---- the pieces every scene has ----------------------------------------------------------------------- */

static uint32_t add_diffuse(struct scene_builder *builder, const char *name, double red, double green,
                            double blue)
{
    struct scene_material material = scene_material_default(name);
    vec3_store(material.base_color, vec3_make(red, green, blue));
    material.double_sided = true;
    return scene_builder_material(builder, &material);
}

/* Index of refraction 1.5, as everything dielectric in the thesis. */
static uint32_t add_glass(struct scene_builder *builder, const char *name)
{
    struct scene_material material = scene_material_default(name);
    material.kind = MATERIAL_DIELECTRIC;
    material.roughness = 0;
    material.transmission = 1;
    return scene_builder_material(builder, &material);
}

/* The same, with the dispersion of dense flint (Abbe number 20), to show its colours. */
static uint32_t add_flint(struct scene_builder *builder, const char *name)
{
    struct scene_material material = scene_material_default(name);
    material.kind = MATERIAL_DIELECTRIC;
    material.roughness = 0;
    material.transmission = 1;
    material.dispersion = 1;
    return scene_builder_material(builder, &material);
}

/* A mesh at rest under a node of its own. */
static void place(struct scene_builder *builder, const char *name, uint32_t mesh)
{
    struct scene_node node = scene_node_default(name, SCENE_NONE);
    scene_builder_instance(builder, scene_builder_node(builder, &node), mesh);
}

/* A node at `eye` whose -Z points at `at`. */
static uint32_t add_looking(struct scene_builder *builder, const char *name, struct vec3 eye, struct vec3 at)
{
    struct scene_node node = scene_node_default(name, SCENE_NONE);
    struct vec3 back = vec3_unit(vec3_sub(eye, at), vec3_make(0, 0, 1));
    struct vec3 right = vec3_unit(vec3_cross(vec3_make(0, 1, 0), back), vec3_make(1, 0, 0));
    struct vec3 up = vec3_cross(back, right);
    node.has_matrix = true;
    vec3_store(node.matrix, right);
    vec3_store(node.matrix + 4, up);
    vec3_store(node.matrix + 8, back);
    vec3_store(node.matrix + 12, eye);
    node.matrix[15] = 1;
    return scene_builder_node(builder, &node);
}

static void add_camera_named(struct scene_builder *builder, const char *name, struct vec3 eye, struct vec3 at,
                             double fov_degrees)
{
    struct scene_camera camera = {.yfov = (float)(fov_degrees * PI / 180)};
    scene_name_copy(camera.name, name);
    camera.node = add_looking(builder, camera.name, eye, at);
    scene_builder_camera(builder, &camera);
}

static void add_camera(struct scene_builder *builder, struct vec3 eye, struct vec3 at, double fov_degrees)
{
    add_camera_named(builder, "camera", eye, at, fov_degrees);
}

static void add_lamp(struct scene_builder *builder, struct vec3 position, double intensity)
{
    struct scene_light light = {.type = LIGHT_POINT};
    scene_name_copy(light.name, "lamp");
    vec3_store(light.intensity, vec3_make(intensity, intensity, intensity));
    struct scene_node node = scene_node_default(light.name, SCENE_NONE);
    vec3_store(node.translation, position);
    light.node = scene_builder_node(builder, &node);
    scene_builder_light(builder, &light);
}

/* ---- one caster over a floor -------------------------------------------------------------------------- */

void builtin_sphere(struct scene_builder *builder)
{
    uint32_t floor = add_diffuse(builder, "floor", 0.7, 0.7, 0.7), glass = add_glass(builder, "glass");
    place(builder, "floor", shape_floor(builder, "floor", floor, vec3_make(0, 0, 0), 16));
    place(builder, "ball", shape_icosphere(builder, "ball", glass, vec3_make(0, 0.6, 0), 0.5, 5));
    add_lamp(builder, vec3_make(1.3, 3.6, -0.7), 40);
    add_camera(builder, vec3_make(-2, 2.6, 2.7), vec3_make(-0.15, 0.2, 0.1), 32);
}

void builtin_ring(struct scene_builder *builder)
{
    uint32_t floor = add_diffuse(builder, "floor", 0.7, 0.7, 0.7);
    struct scene_material metal = scene_material_default("metal");
    metal.kind = MATERIAL_MIRROR;
    metal.metallic = 1;
    metal.roughness = 0;
    uint32_t polished = scene_builder_material(builder, &metal);
    place(builder, "floor", shape_floor(builder, "floor", floor, vec3_make(0, 0, 0), 16));
    /* Two millimetres above the floor: no surface lies in another. */
    place(builder, "inside",
          shape_tube(builder, "inside", polished, vec3_make(0, 0.002, 0), 0.5, 0.248, 1024, true));
    place(builder, "outside",
          shape_tube(builder, "outside", polished, vec3_make(0, 0.002, 0), 0.54, 0.248, 1024, false));
    add_lamp(builder, vec3_make(2.4, 1.7, -0.6), 30);
    add_camera(builder, vec3_make(0, 2.6, 2), vec3_make(0, 0.05, 0), 32);
}

void builtin_prism(struct scene_builder *builder)
{
    uint32_t floor = add_diffuse(builder, "floor", 0.7, 0.7, 0.7), glass = add_flint(builder, "glass");
    place(builder, "floor", shape_floor(builder, "floor", floor, vec3_make(0, 0, 0), 12));
    /* Equilateral, side 0.7 m, on edge: the sun enters the upper left face and leaves through the right one.
     */
    double corners[3][2];
    for (int i = 0; i < 3; i++) {
        double angle = PI / 180 * (-90 + 120 * i), radius = 0.7 / sqrt(3.0);
        corners[i][0] = radius * cos(angle);
        corners[i][1] = 0.6 + radius * sin(angle);
    }
    place(builder, "prism", shape_prism(builder, "prism", glass, (const double(*)[2])corners, -0.6, 0.6));
    struct scene_light sun = {.type = LIGHT_DIRECTIONAL, .intensity = {3, 3, 3}};
    scene_name_copy(sun.name, "sun");
    sun.node = add_looking(builder, sun.name, vec3_make(-2, 2.6, 0.5), vec3_make(0, 0.6, 0));
    scene_builder_light(builder, &sun);
    add_camera(builder, vec3_make(1.7, 1.7, 1.9), vec3_make(0.25, 0.25, 0), 36);
}

void builtin_cube(struct scene_builder *builder)
{
    uint32_t floor = add_diffuse(builder, "floor", 0.7, 0.7, 0.7), glass = add_glass(builder, "glass"),
             yellow = add_diffuse(builder, "yellow", 0.9, 0.65, 0.05);
    place(builder, "floor", shape_floor(builder, "floor", floor, vec3_make(0, 0, 0), 12));
    place(builder, "cube",
          shape_box(builder, "cube", glass, vec3_make(-0.5, 0.3, -0.5), vec3_make(0.5, 1.3, 0.5)));
    struct vec3 axis = vec3_unit(vec3_make(0.35, 1, 0.8), vec3_make(0, 1, 0));
    place(builder, "torus",
          shape_torus(builder, "torus", yellow, vec3_make(0, 0.78, 0), axis, 0.27, 0.1, 128, 64));
    add_lamp(builder, vec3_make(1.1, 2.9, 0.4), 24);
    add_camera(builder, vec3_make(-1.3, 1.9, 3), vec3_make(-0.1, 0.5, 0), 34);
}

void builtin_no_caster(struct scene_builder *builder)
{
    uint32_t floor = add_diffuse(builder, "floor", 0.7, 0.7, 0.7),
             red = add_diffuse(builder, "red", 0.6, 0.15, 0.1),
             blue = add_diffuse(builder, "blue", 0.1, 0.2, 0.6);
    place(builder, "floor", shape_floor(builder, "floor", floor, vec3_make(0, 0, 0), 8));
    place(builder, "red box",
          shape_box(builder, "red box", red, vec3_make(-0.9, 0.01, -0.3), vec3_make(-0.3, 0.61, 0.3)));
    place(builder, "blue box",
          shape_box(builder, "blue box", blue, vec3_make(0.2, 0.01, -0.4), vec3_make(0.7, 1.01, 0.1)));
    add_lamp(builder, vec3_make(0.8, 2.6, 1.4), 20);
    add_camera(builder, vec3_make(-1.4, 2, 3), vec3_make(0, 0.3, 0), 36);
}

/* ---- the thesis' scenes -------------------------------------------------------------------------------- */

/* Base, stem, outside of the bowl, rim, inside of the bowl; m. The wall is some 2 cm thick. */
static const struct shape_profile_point wine_glass[] = {
    {0, 0},        {0.15, 0},      {0.265, 0},    {0.28, 0.012},  {0.265, 0.024}, {0.12, 0.035},
    {0.045, 0.07}, {0.026, 0.16},  {0.024, 0.3},  {0.04, 0.375},  {0.12, 0.425},  {0.215, 0.53},
    {0.25, 0.66},  {0.238, 0.8},   {0.205, 0.93}, {0.195, 0.942}, {0.185, 0.932}, {0.218, 0.8},
    {0.229, 0.66}, {0.195, 0.545}, {0.105, 0.45}, {0.04, 0.425},  {0, 0.42},
};

void builtin_square(struct scene_builder *builder)
{
    uint32_t floor = add_diffuse(builder, "floor", 0.7, 0.7, 0.7), glass = add_glass(builder, "glass");
    place(builder, "floor", shape_floor(builder, "floor", floor, vec3_make(0, 0, 0), 4));
    place(builder, "ball", shape_icosphere(builder, "ball", glass, vec3_make(-0.85, 0.45, 0.1), 0.35, 5));
    /* 103 rings of 103 segments are the thesis' 21,218 triangles. */
    place(builder, "wine glass",
          shape_revolution(builder, "wine glass", glass, vec3_make(0, 0.004, -0.35), wine_glass,
                           sizeof wine_glass / sizeof *wine_glass, 103, 103));
    /* In place of the monkey head, with its 968 triangles. */
    place(builder, "gem", shape_gem(builder, "gem", glass, vec3_make(0.85, 0.47, 0.15), 0.36, 11));
    add_lamp(builder, vec3_make(0.2, 2.4, -1.3), 18);
    add_camera(builder, vec3_make(0, 2.3, 3.6), vec3_make(0, 0.25, 0.15), 36);
    /* The thesis' second view: from behind the glass, through which the caustics are seen. */
    add_camera_named(builder, "behind", vec3_make(0.35, 0.95, -2.9), vec3_make(0, 0.3, 0.4), 36);
}

void builtin_cornell(struct scene_builder *builder)
{
    uint32_t white = add_diffuse(builder, "white", 0.75, 0.75, 0.75), glass = add_glass(builder, "glass");
    const struct shape_quad walls[5] = {
        {{-1, 0, 1}, {2, 0, 0}, {0, 0, -2}}, /* floor */
        {{-1, 2, -1}, {2, 0, 0}, {0, 0, 2}}, /* ceiling */
        {{-1, 0, -1}, {2, 0, 0}, {0, 2, 0}}, /* back */
        {{-1, 0, 1}, {0, 0, -2}, {0, 2, 0}}, /* left */
        {{1, 0, -1}, {0, 0, 2}, {0, 2, 0}},  /* right */
    };
    place(builder, "box", shape_quads(builder, "box", white, walls, 5));
    place(builder, "ball", shape_icosphere(builder, "ball", glass, vec3_make(0.1, 0.8, 0), 0.36, 4));
    add_lamp(builder, vec3_make(-0.25, 1.85, 0.15), 3);
    add_camera(builder, vec3_make(0, 1.25, 3.9), vec3_make(0, 0.92, 0), 39);
}

/* Wave lengths of 0.5 to 1.6 m, in no common direction. Where crests meet, the curvature is 3.6 per metre at
 * most, and light of a lamp 1.7 m above comes together from about the pool's depth on (n / depth = (n - 1)
 * curvature - 1 / 1.7). */
static const struct shape_wave ripples[] = {
    {5.1, 2.3, 0.018, 0.3},  {-3.4, 6.2, 0.0135, 1.9},  {8.3, -4.1, 0.0081, 4.2},
    {1.9, -3.6, 0.029, 2.6}, {-9.6, -6.4, 0.0045, 5.5}, {11.2, 7.7, 0.0029, 0.9},
};

void builtin_pool(struct scene_builder *builder)
{
    const double inner = 2, outer = 2.2, level = 1.5, rim = 1.65;
    uint32_t tiles = add_diffuse(builder, "tiles", 0.65, 0.72, 0.75), water = add_glass(builder, "water");
    struct shape_quad quads[13] = {{{-inner, 0, inner}, {2 * inner, 0, 0}, {0, 0, -2 * inner}}};
    /* Each side turned a quarter: inner wall, rim, outer wall. */
    for (int side = 0; side < 4; side++) {
        const double turns[4][2] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};
        double c = turns[side][0], s = turns[side][1];
        struct vec3 out = vec3_make(c, 0, s), along = vec3_make(-s, 0, c), up = vec3_make(0, 1, 0);
        struct vec3 inner_corner = vec3_sub(vec3_scale(out, inner), vec3_scale(along, inner));
        struct vec3 outer_corner = vec3_sub(vec3_scale(out, outer), vec3_scale(along, outer));
        struct shape_quad *quad = &quads[1 + 3 * side];
        quad[0] = (struct shape_quad){inner_corner, vec3_scale(along, 2 * inner), vec3_scale(up, rim)};
        /* The rim runs on along one outer side only, so that the four do not overlap at the corners. */
        quad[1] = (struct shape_quad){vec3_add(inner_corner, vec3_scale(up, rim)),
                                      vec3_scale(along, inner + outer), vec3_scale(out, outer - inner)};
        quad[2] = (struct shape_quad){outer_corner, vec3_scale(up, rim), vec3_scale(along, 2 * outer)};
    }
    place(builder, "pool", shape_quads(builder, "pool", tiles, quads, 13));
    /* An open sheet: a dielectric's inside is the side its normals point away from, so what is under the
     * sheet is water. It ends inside the walls, where no light comes. 625 cells a side and the 26 triangles
     * of the pool are the thesis' 781,276. */
    place(builder, "water",
          shape_water(builder, "water", water, vec3_make(0, level, 0), inner + outer, 625, ripples,
                      sizeof ripples / sizeof *ripples));
    add_lamp(builder, vec3_make(0.5, 3.2, -0.4), 25);
    add_camera(builder, vec3_make(1.75, 1.15, 1.75), vec3_make(-0.5, 0.1, -0.5), 62);
    /* The thesis' second view: everything is seen through the water. */
    add_camera_named(builder, "above", vec3_make(1.6, 4.6, 3), vec3_make(0, 0, 0), 42);
}
