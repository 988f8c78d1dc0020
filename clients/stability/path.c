#include "path.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define RADIANS  0.01745329251994329577
#define CUT_NEAR 0.75 /* a cut comes this much closer: nearer is free space more often than farther */

const struct path_info path_infos[PATH_COUNT] = {
    {"still", "nothing moves: static flicker, and how the task buffers settle", PATH_RESTS, 64, 16},
    {"orbit", "the camera circles the caustic slowly", PATH_MOVES, 48, 16},
    {"cut", "the camera jumps: how fast the new picture is there", PATH_STEPS, 32, 16},
    {"light-step", "a light jumps: how fast the caustic follows, and what ghost it leaves", PATH_STEPS, 32,
     16},
    {"light-sweep", "a light circles the caustic slowly", PATH_MOVES, 48, 16},
    {"object", "objects pass: the scene's animation, or the camera pans off the caustic and back", PATH_MOVES,
     48, 16},
    {"settings-flicker", "two settings in turn: how much the picture jumps between them", PATH_ALTERNATES, 64,
     16},
    {"drift", "nothing moves, for long: where the task buffers and the picture go", PATH_RESTS, 5000, 64},
};

bool path_find(const char *name, enum path_id *id, struct error *error)
{
    char list[200] = "";
    for (int i = 0; i < PATH_COUNT; i++) {
        *id = (enum path_id)i;
        if (strcmp(path_infos[i].name, name) == 0)
            return true;
        snprintf(list + strlen(list), sizeof list - strlen(list), "%s%s", i ? ", " : "", path_infos[i].name);
    }
    return error_set(error, STATUS_NOT_FOUND, "no path is called %.60s; there are %s", name, list);
}

/* Turns `vector` about a unit axis (Rodrigues). */
static void turn(const double axis[3], double degrees, double vector[3])
{
    double c = cos(degrees * RADIANS), s = sin(degrees * RADIANS), along = 0, turned[3];
    for (int k = 0; k < 3; k++)
        along += axis[k] * vector[k];
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        double across = axis[i] * vector[j] - axis[j] * vector[i];
        turned[k] = c * vector[k] + s * across + (1 - c) * along * axis[k];
    }
    memcpy(vector, turned, sizeof turned);
}

/* Turns a point about an axis through `pivot` and scales its distance from it. */
static void turn_point(const float pivot[3], const double axis[3], double degrees, double scale,
                       float point[3])
{
    double from[3];
    for (int k = 0; k < 3; k++)
        from[k] = ((double)point[k] - (double)pivot[k]) * scale;
    turn(axis, degrees, from);
    for (int k = 0; k < 3; k++)
        point[k] = (float)((double)pivot[k] + from[k]);
}

static void unit_up(const struct protocol_camera *camera, double up[3])
{
    double length = 0;
    for (int k = 0; k < 3; k++)
        length += (double)camera->up[k] * (double)camera->up[k];
    for (int k = 0; k < 3; k++)
        up[k] = (double)camera->up[k] / sqrt(length);
}

static void circle_camera(const struct path_base *base, double degrees, double scale,
                          struct path_state *state)
{
    double up[3];
    unit_up(&base->camera, up);
    state->has_camera = true;
    turn_point(base->pivot, up, degrees, scale, state->camera.eye);
    turn_point(base->pivot, up, degrees, scale, state->camera.at);
}

static void pan_camera(const struct path_base *base, double degrees, struct path_state *state)
{
    double up[3];
    unit_up(&base->camera, up);
    state->has_camera = true;
    turn_point(base->camera.eye, up, degrees, 1, state->camera.at);
}

static bool circle_light(enum path_id id, const struct path_base *base, double degrees,
                         struct path_state *state, struct error *error)
{
    const double vertical[3] = {0, 1, 0};
    const float origin[3] = {0, 0, 0};
    if (!base->has_light)
        return error_set(error, STATUS_INVALID, "path %s moves a light, and the scene has none",
                         path_infos[id].name);
    state->has_light = true;
    if (base->light.type != PROTOCOL_LIGHT_DIRECTIONAL)
        turn_point(base->pivot, vertical, degrees, 1, state->position);
    if (base->light.type != PROTOCOL_LIGHT_POINT)
        turn_point(origin, vertical, degrees, 1, state->direction);
    return true;
}

/* The picture's width as an angle: a pan by one and a half of it has left everything behind. */
static double pan_angle(const struct path_base *base)
{
    double half = tan(0.5 * (double)base->camera.fov * RADIANS) * base->width_over_height;
    return 1.5 * 2 * atan(half) / RADIANS;
}

bool path_at(enum path_id id, const struct path_base *base, int64_t frame, uint32_t frames,
             struct path_state *state, struct error *error)
{
    *state = (struct path_state){.camera = base->camera};
    memcpy(state->position, base->light.position, sizeof state->position);
    memcpy(state->direction, base->light.direction, sizeof state->direction);
    bool is_warming = frame < 0;
    double at = is_warming ? 0 : (double)frame;
    switch (id) {
    case PATH_ORBIT: /* half to either side of the scene's own camera, so that it goes the least way */
        circle_camera(base, base->orbit_step * (at - 0.5 * (frames - 1.0)), 1, state);
        return true;
    case PATH_CUT:
        circle_camera(base, is_warming ? 0 : base->cut_angle, is_warming ? 1 : CUT_NEAR, state);
        return true;
    case PATH_LIGHT_STEP:
        return circle_light(id, base, is_warming ? 0 : base->light_angle, state, error);
    case PATH_LIGHT_SWEEP:
        return circle_light(id, base, base->sweep_step * (at - 0.5 * (frames - 1.0)), state, error);
    case PATH_OBJECT:
        if (base->duration > 0)
            state->time = at / base->rate;
        else { /* out and back, gently at both ends */
            double s = sin(RADIANS * 180 * at / (frames - 1.0));
            pan_camera(base, pan_angle(base) * s * s, state);
        }
        return true;
    case PATH_SETTINGS_FLICKER:
        state->is_second = !is_warming && (frame / base->flicker_period) % 2 == 1;
        return true;
    case PATH_STILL:
    case PATH_DRIFT:
    case PATH_COUNT:
        break;
    }
    return true;
}

void path_describe(enum path_id id, const struct path_base *base, char *text, size_t size)
{
    char light[80];
    protocol_text_copy(base->light.name, light, sizeof light);
    switch (id) {
    case PATH_ORBIT:
        snprintf(text, size, "the camera circles the caustic by %g degrees a frame", base->orbit_step);
        break;
    case PATH_CUT:
        snprintf(text, size, "the camera jumps by %g degrees about the caustic and a quarter closer",
                 base->cut_angle);
        break;
    case PATH_LIGHT_STEP:
        snprintf(text, size, "light %s jumps by %g degrees about the caustic's vertical", light,
                 base->light_angle);
        break;
    case PATH_LIGHT_SWEEP:
        snprintf(text, size, "light %s circles the caustic's vertical by %g degrees a frame", light,
                 base->sweep_step);
        break;
    case PATH_OBJECT:
        if (base->duration > 0)
            snprintf(text, size, "the scene's animation runs at %g frames a second", base->rate);
        else
            snprintf(text, size,
                     "the scene has no animation, so the camera makes everything pass: it pans %.0f degrees "
                     "off the caustic and back",
                     pan_angle(base));
        break;
    case PATH_SETTINGS_FLICKER:
        snprintf(text, size, "two settings in turn, %u frames each", base->flicker_period);
        break;
    case PATH_STILL:
    case PATH_DRIFT:
    case PATH_COUNT:
        snprintf(text, size, "nothing moves");
        break;
    }
}
