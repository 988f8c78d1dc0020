/* truth.h: small scenes with a closed form, rendered in this process, and where their pixels lie on the floor
 * (y = 0). */
#ifndef TEST_TRUTH_H
#define TEST_TRUTH_H

#include "core/render/renderer.h"
#include "core/scene/scene_builder.h"

/* A white floor of `floor_side` metres at y = 0 around the origin, one caster and one light. */
enum truth_caster {
    TRUTH_INTERFACE, /* horizontal sheet of `size` metres a side at y = height, dielectric below */
    TRUTH_SPHERE,    /* glass sphere of radius `size` around (0, height, 0), 81,920 triangles */
    TRUTH_RING /* mirror on the inside of an upright cylinder of radius `size` and height `height`, 4,096
                  segments */
};

struct truth_params {
    enum truth_caster caster;
    double size, height;
    double ior;        /* 0: 1.5 */
    double floor_side; /* 0: 16 */
    bool is_directional;
    double light[3];  /* position, or the direction light travels in */
    double intensity; /* W/sr or W/m^2 */
    struct view_camera camera;
    uint32_t width, height_px;
    const char *settings; /* "name=value name=value ..."; NULL: defaults */
};

struct truth {
    struct scene *scene;
    struct gpu *gpu;
    struct renderer *renderer;
    struct view *view;
    struct view_camera camera;
    uint32_t width, height;
};

/* These fail the test that calls them when something goes wrong. */
void truth_open(struct truth *truth, const struct truth_params *params);
/* The same with a scene of the caller's, which truth_close destroys. */
void truth_open_scene(struct truth *truth, struct scene *scene, const struct view_camera *camera,
                      uint32_t width, uint32_t height, const char *settings);
void truth_close(struct truth *truth);
/* A node whose -Z looks along `direction`. */
uint32_t truth_aimed_node(struct scene_builder *builder, const char *name, const double position[3],
                          const double direction[3]);
/* Settings as in truth_params. */
void truth_set(struct truth *truth, const char *settings);
/* Renders `frames` frames; the last one's result. */
const struct frame_result *truth_render(struct truth *truth, uint32_t frames, uint32_t channel_mask);
const float *truth_channel(const struct frame_result *result, enum channel channel);

/* Where on the floor the image point (x, y) lies, in pixels from the top left corner (pixel centres at .5).
 * False when it shows no floor. */
bool truth_floor_point(const struct truth *truth, double x, double y, double floor[2]);
/* The other way round: floor (x, z) to image point. */
void truth_image_point(const struct truth *truth, const double floor[2], double image[2]);
/* Area of floor in m^2 that one pixel centred at (x, y) shows; 0 when it shows none. */
double truth_pixel_area(const struct truth *truth, double x, double y);

/* Whether the pixel in column x and row y and its eight neighbours show nothing but floor. */
bool truth_shows_floor(const struct truth *truth, const float *depth, uint32_t x, uint32_t y);

#endif
