/* balls.h: scenes of a white floor (y = 0), balls that cast and lights of any kind, rendered in this process:
 * what lights and task buffers do at their limits. Used with truth.h's truth_set, truth_render, truth_channel
 * and truth_close.
 */
#ifndef TEST_BALLS_H
#define TEST_BALLS_H

#include "truth.h"

struct ball {
    double centre[3], radius;
    enum material_kind kind; /* MATERIAL_DIELECTRIC (ior 1.5) or MATERIAL_MIRROR */
    double appears;          /* s; before that it lies 1 km below the floor. 0: it is always there */
};

struct ball_light {
    enum light_type type;
    double position[3];
    double direction[3]; /* {0, 0, 0}: down */
    double intensity[3];
    double inner, outer; /* half angles of a spot, rad */
};

struct balls_params {
    double floor_side;     /* 0: 16 m */
    uint32_t subdivisions; /* of a ball: 20 * 4^subdivisions triangles; 0: 4 */
    const struct ball *balls;
    uint32_t ball_count;
    const struct ball_light *lights;
    uint32_t light_count;
    struct view_camera camera;
    uint32_t width, height;
    const char *settings; /* as in truth_params */
};

struct scene *balls_scene(const struct balls_params *params, struct error *error);
/* Fails the test that calls it when something goes wrong. */
void balls_open(struct truth *stage, const struct balls_params *params);

/* The scene light's intensity from now on, the same in every channel. */
void balls_set_intensity(struct truth *stage, uint32_t light, double intensity);

/* Sum of a channel's first component over the pixels of columns [x0, x1), each times the floor it shows: with
 * the irradiance of a grey scene, W per channel. */
double balls_floor_flux(const struct truth *stage, const float *values, uint32_t x0, uint32_t x1);

/* Photons of every light in the frame that `result` is of (which holds the density channel). The cells of a
 * tile are all the same size, so these are what the budget was shared out into; up to the third frame after
 * a change, and with density=sqrt or uniform, they are what was drawn. */
void balls_light_photons(const struct frame_result *result, uint32_t light_count, double *photons);

#endif
