/* path.h: the deterministic paths: where camera, light, time and settings are at every frame.
 *
 * A path is a function of the frame's number alone. Frames below 0 are its warm-up: a path that moves waits
 * at its beginning, a step waits on its old side. Everything turns about the middle of the caustic light that
 * the first picture shows, so that a path fits a scene of any size.
 */
#ifndef CAUSTIC_STABILITY_PATH_H
#define CAUSTIC_STABILITY_PATH_H

#include "../../protocol/protocol.h"

enum path_id {
    PATH_STILL,
    PATH_ORBIT,
    PATH_CUT,
    PATH_LIGHT_STEP,
    PATH_LIGHT_SWEEP,
    PATH_OBJECT,
    PATH_SETTINGS_FLICKER,
    PATH_DRIFT,
    PATH_COUNT
};

/* What is measured follows from how the path goes. */
enum path_kind {
    PATH_RESTS,     /* nothing changes: flicker, drift */
    PATH_MOVES,     /* changes every frame: differences against the reference's own */
    PATH_STEPS,     /* one change before frame 0: the response to it */
    PATH_ALTERNATES /* two settings in turn: flicker, and the response to every change */
};

struct path_info {
    const char *name, *help;
    enum path_kind kind;
    uint32_t frames, minimum; /* by default, and at least: fewer say nothing of what it measures */
};
extern const struct path_info path_infos[PATH_COUNT];

/* STATUS_NOT_FOUND with a list of what there is. */
bool path_find(const char *name, enum path_id *id, struct error *error);

/* What the paths of one run start from. */
struct path_base {
    struct protocol_camera camera;
    float pivot[3]; /* the middle of the caustic light, m */
    bool has_light;
    struct protocol_light light; /* the one that moves */
    double duration;             /* of the scene's animation, s; 0: it has none */
    /* chosen by the caller */
    double orbit_step;        /* degrees per frame of orbit */
    double cut_angle;         /* degrees the camera jumps about the pivot; it also comes a quarter closer */
    double light_angle;       /* degrees the light jumps about the pivot's vertical */
    double sweep_step;        /* degrees per frame of light-sweep */
    double rate;              /* frames per second of the animation */
    uint32_t flicker_period;  /* frames that settings-flicker stays with one setting */
    double width_over_height; /* of the picture */
};

struct path_state {
    bool has_camera; /* otherwise the camera is not touched */
    struct protocol_camera camera;
    bool has_light;
    float position[3], direction[3];
    double time;
    bool is_second; /* settings-flicker: the second setting */
};

/* The state at `frame` of `frames`; false when the scene has not what the path needs. */
bool path_at(enum path_id id, const struct path_base *base, int64_t frame, uint32_t frames,
             struct path_state *state, struct error *error);

/* What the path does with this scene, in one sentence. */
void path_describe(enum path_id id, const struct path_base *base, char *text, size_t size);

#endif
