/* options.h: the command line of caustic-record. */
#ifndef CAUSTIC_RECORD_OPTIONS_H
#define CAUSTIC_RECORD_OPTIONS_H

#include "../../protocol/protocol.h"
#include "../lib/option_value.h"

#define RECORD_MAX_SETTINGS 128u

struct record_light {
    char name[PROTOCOL_MAX_TEXT_BYTES + 1];
    struct protocol_view_light change; /* view and light are filled in once the server is known */
};

struct record_options {
    const char *address;     /* NULL: the default port on this machine */
    double wait;             /* seconds to wait for a server that does not listen yet */
    uint32_t width, height;  /* 480x270 */
    uint32_t frames, warmup; /* 1, 0 */
    bool has_eye, has_at, has_up;
    struct protocol_camera camera;
    float fov; /* 0: 45, or the server's camera's own */
    const char *camera_name, *path_file;
    double time, rate; /* seconds; frames per second, 0: time stands still */
    bool has_time;
    struct record_light lights[PROTOCOL_MAX_LIGHTS];
    struct option_setting settings[RECORD_MAX_SETTINGS];
    uint32_t light_count, setting_count;
    const char *channels; /* caustics,irradiance,beauty */
    const char *folder;   /* out */
    enum protocol_format format;
    enum protocol_encoding encoding;
    bool png;
    bool has_exposure;
    double exposure; /* stops; without it found from the first frame */
    bool quiet;
    bool help, version; /* asked for; nothing else is checked then */
};

/* The texts point into argv. False with an error that names the option. */
bool record_options_parse(struct record_options *options, int argc, char **argv, struct error *error);

extern const char record_help[];

#endif
