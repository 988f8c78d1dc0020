/* client.h: a client of causticd: connect, make views, change them, get frames.
 *
 *     struct error error;
 *     struct client *client = client_connect(&(struct client_params){.address = "tcp:127.0.0.1:7420"},
 * &error); uint32_t view; client_view_create(client, 480, 270, &view, &error); struct client_frame *frame =
 * client_render(client, view, &(struct client_render_params){.channels = 1}, &error);
 *     ... frame->values[0], frame->info ...
 *     client_frame_destroy(&frame);
 *     client_destroy(&client);
 *
 * Every call blocks until its reply is there or its time is up. After an error of status STATUS_IO the
 * connection is over: every further call fails likewise. Any other error is the server's refusal, and the
 * connection goes on. Ownership: frames belong to the caller, and outlive the client; x_destroy(&x) frees,
 * sets NULL, accepts a NULL pointee. Threads: one thread at a time per client.
 */
#ifndef CAUSTIC_CLIENT_H
#define CAUSTIC_CLIENT_H

#include "../../protocol/protocol.h"

struct client;

struct client_params {
    const char *address;      /* "tcp:HOST:PORT" or "unix:PATH"; NULL: tcp:127.0.0.1:7420 */
    const char *name;         /* for the server's log; NULL: "caustic client" */
    uint32_t timeout_ms;      /* to connect, and for the reply to any request but a render; 0: 30 s */
    uint32_t wait_ms;         /* keep trying to connect for so long while nobody listens; 0: try once */
    uint64_t max_frame_bytes; /* frames larger than this when decoded are refused; 0: 2 GiB */
};

struct client *client_connect(const struct client_params *params, struct error *error);
/* The same over a connected stream socket, which then belongs to the client, also when this fails. */
struct client *client_adopt(int socket, const struct client_params *params, struct error *error);
void client_destroy(struct client **client);

/* What the server said first. Belongs to the client. */
const struct protocol_hello *client_hello(const struct client *client);

/* By name; STATUS_NOT_FOUND with a list of what there is. */
bool client_find_setting(const struct client *client, const char *name, uint32_t *index, struct error *error);
bool client_find_light(const struct client *client, const char *name, uint32_t *index, struct error *error);
bool client_find_channel(const struct client *client, const char *name, uint32_t *index, struct error *error);

/* Reads a value as the setting's type wants it: a number, on/off/true/false/yes/no, or the name of a choice.
 */
bool client_setting_parse(const struct protocol_setting *setting, const char *text, double *value,
                          struct error *error);
/* The reverse. */
void client_setting_print(const struct protocol_setting *setting, double value, char *text, size_t size);

/* ---- views: each call is one request; the server applied it when the call returns ---------------------- */

bool client_view_create(struct client *client, uint32_t width, uint32_t height, uint32_t *view,
                        struct error *error);
bool client_view_resize(struct client *client, uint32_t view, uint32_t width, uint32_t height,
                        struct error *error);
bool client_view_destroy(struct client *client, uint32_t view, struct error *error);
bool client_view_share(struct client *client, uint32_t view, bool shared, struct error *error);
bool client_view_camera(struct client *client, uint32_t view, const struct protocol_camera *camera,
                        struct error *error);
bool client_view_follow(struct client *client, uint32_t view, const char *camera, struct error *error);
bool client_view_time(struct client *client, uint32_t view, double time, struct error *error);
bool client_view_light(struct client *client, const struct protocol_view_light *change, struct error *error);
bool client_view_setting(struct client *client, uint32_t view, uint32_t setting, double value,
                         struct error *error);
/* By name and text. */
bool client_view_set(struct client *client, uint32_t view, const char *name, const char *text,
                     struct error *error);
bool client_view_reset(struct client *client, uint32_t view, struct error *error);
bool client_ping(struct client *client, struct error *error);

/* ---- frames ------------------------------------------------------------------------------------------- */

struct client_frame {
    struct protocol_frame info;           /* its texts belong to the frame */
    uint32_t request;                     /* of the render or subscription it answers */
    uint64_t received_bytes;              /* of the channels as they came */
    float *values[PROTOCOL_MAX_CHANNELS]; /* per entry of info.channels: rows from the top, components
                                             interleaved */
    uint8_t *payload;                     /* memory behind info's texts */
};

struct client_render_params {
    uint32_t channels;               /* bit i: channel i of the HELLO; 0: statistics only */
    enum protocol_format format;     /* default f32 */
    enum protocol_encoding encoding; /* default raw */
    uint32_t timeout_ms;             /* 0: 10 minutes */
    uint32_t credit;                 /* subscriptions: frames the server may send ahead; 0: 2 */
};

/* Lock-step: one request, one frame. NULL on error. */
struct client_frame *client_render(struct client *client, uint32_t view,
                                   const struct client_render_params *params, struct error *error);

/* Live: frames come as the server makes them; client_next_frame hands them out in their order, of all
 * subscriptions, and gives the server credit for the next one. NULL on error: STATUS_LIMIT when none came
 * within `timeout_ms`, STATUS_NOT_FOUND when the server has ended a subscription. */
bool client_subscribe(struct client *client, uint32_t view, const struct client_render_params *params,
                      struct error *error);
bool client_unsubscribe(struct client *client, uint32_t view, struct error *error);
struct client_frame *client_next_frame(struct client *client, uint32_t timeout_ms, struct error *error);

void client_frame_destroy(struct client_frame **frame);

#endif
