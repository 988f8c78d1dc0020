/* protocol.h: the wire contract of causticd as C structures, with encoder and decoder.
 *
 * PROTOCOL.md is the contract; this header is its C form. No I/O, no allocation, no state: bytes in,
 * structures out, and back. Nothing here knows the renderer.
 *
 *     receiving   read PROTOCOL_HEADER_BYTES -> protocol_header_read -> read header.length bytes ->
 * protocol_decode sending     fill a struct protocol_message -> protocol_encode
 *
 * One encoding per message: whatever protocol_decode accepts, protocol_encode turns back into the same bytes.
 * Texts and byte ranges of a decoded message point into the payload it was decoded from.
 * A struct protocol_message is some 50 KiB: keep one per connection or static to a thread, not many on the
 * stack.
 */
#ifndef CAUSTIC_PROTOCOL_H
#define CAUSTIC_PROTOCOL_H

#include <stddef.h>
#include <stdint.h>

#include "../core/status.h"

#define PROTOCOL_MAGIC        0x43545343u /* the bytes "CSTC" */
#define PROTOCOL_MAJOR        1u
#define PROTOCOL_MINOR        0u
#define PROTOCOL_HEADER_BYTES 16u
#define PROTOCOL_DEFAULT_PORT 7420u

/* Limits of the encoding itself; what a server allows is in its HELLO. */
#define PROTOCOL_MAX_REQUEST_BYTES 1024u   /* payload of a message to the server, of any type */
#define PROTOCOL_MAX_HELLO_BYTES   262144u /* payloads of messages to the client */
#define PROTOCOL_MAX_FRAME_BYTES   65536u
#define PROTOCOL_MAX_PART_BYTES    262144u /* image bytes in one PART */
#define PROTOCOL_MAX_TEXT_BYTES    512u    /* of any one text */
#define PROTOCOL_MAX_LIGHTS        64u
#define PROTOCOL_MAX_CAMERAS       256u /* described in HELLO; others can be followed by name */
#define PROTOCOL_MAX_SETTINGS      128u
#define PROTOCOL_MAX_STATISTICS    128u
#define PROTOCOL_MAX_CHANNELS      16u
#define PROTOCOL_MAX_PASSES        64u
#define PROTOCOL_MAX_PLAN_LINES    64u
#define PROTOCOL_MAX_IMAGE_SIZE    16384u     /* pixels along a side of a channel */
#define PROTOCOL_BY_NAME           UINT32_MAX /* VIEW_FOLLOW: the camera is given by name */

enum protocol_type {
    /* client to server: requests */
    PROTOCOL_CHOOSE = 1,
    PROTOCOL_PING = 2,
    PROTOCOL_VIEW_CREATE = 16,
    PROTOCOL_VIEW_RESIZE = 17,
    PROTOCOL_VIEW_DESTROY = 18,
    PROTOCOL_VIEW_SHARE = 19,
    PROTOCOL_VIEW_CAMERA = 20,
    PROTOCOL_VIEW_FOLLOW = 21,
    PROTOCOL_VIEW_TIME = 22,
    PROTOCOL_VIEW_LIGHT = 23,
    PROTOCOL_VIEW_SETTING = 24,
    PROTOCOL_VIEW_RESET = 25,
    PROTOCOL_RENDER = 32,
    PROTOCOL_SUBSCRIBE = 33,
    PROTOCOL_UNSUBSCRIBE = 34,
    PROTOCOL_CREDIT = 35,
    /* server to client */
    PROTOCOL_HELLO = 128,
    PROTOCOL_OK = 129,
    PROTOCOL_ERROR = 130,
    PROTOCOL_NOTICE = 131,
    PROTOCOL_FRAME = 132,
    PROTOCOL_PART = 133
};

enum protocol_side { PROTOCOL_CLIENT, PROTOCOL_SERVER };

/* Feature bits: what the server can do, and what the client picks of it. */
#define PROTOCOL_FEATURE_ZSTD  1u /* encoding zstd */
#define PROTOCOL_FEATURE_F16   2u /* format f16 */
#define PROTOCOL_FEATURE_LIVE  4u /* SUBSCRIBE */
#define PROTOCOL_FEATURE_SHARE 8u /* views that several connections watch */

enum protocol_format { PROTOCOL_F32, PROTOCOL_F16, PROTOCOL_FORMAT_COUNT };
enum protocol_encoding { PROTOCOL_RAW, PROTOCOL_ZSTD, PROTOCOL_ENCODING_COUNT };

/* UTF-8 without a terminating zero and without a zero inside; bytes may be NULL when length is 0. */
struct protocol_text {
    const char *bytes;
    uint16_t length;
};

/* Borrows `text`; NULL is empty; cut at PROTOCOL_MAX_TEXT_BYTES, between characters. */
struct protocol_text protocol_text_of(const char *text);
/* Copies with a terminating zero, cut to fit. */
void protocol_text_copy(struct protocol_text text, char *target, size_t size);
bool protocol_text_equals(struct protocol_text text, const char *other);

/* ---- the server speaks first: HELLO ------------------------------------------------------------------- */

struct protocol_limits {
    uint32_t max_clients;       /* connections at a time */
    uint32_t max_views;         /* of one connection */
    uint32_t max_size;          /* pixels along a side of a view */
    uint32_t max_pixels;        /* width * height of a view */
    uint32_t max_photons;       /* largest `photons` setting on this device */
    uint32_t max_request_bytes; /* payload of one request */
    uint64_t max_output_bytes;  /* unsent bytes after which the server stops rendering for a connection */
};

enum protocol_light_type { PROTOCOL_LIGHT_POINT, PROTOCOL_LIGHT_SPOT, PROTOCOL_LIGHT_DIRECTIONAL };

struct protocol_light {
    struct protocol_text name;
    uint8_t type;                    /* enum protocol_light_type */
    float intensity[3];              /* W/sr; directional W/m^2 */
    float position[3], direction[3]; /* at time 0 */
};

struct protocol_camera_name {
    struct protocol_text name;
    float fov; /* vertical, degrees */
};

enum protocol_setting_type { PROTOCOL_BOOL, PROTOCOL_INT, PROTOCOL_FLOAT, PROTOCOL_CHOICE };

struct protocol_setting {
    struct protocol_text name, choices, help; /* choices: comma-separated; empty for numbers */
    uint8_t type;                             /* enum protocol_setting_type */
    double minimum, maximum, value;           /* value: the default */
};

struct protocol_statistic {
    struct protocol_text name, unit, help;
};

struct protocol_channel_name {
    struct protocol_text name, help;
    uint8_t components;
};

struct protocol_hello {
    uint16_t major, minor;
    uint64_t features;
    struct protocol_text version; /* of the server, for people */
    struct protocol_text device, driver, tracer;
    struct protocol_limits limits;
    struct protocol_text scene;
    uint32_t triangles;
    double duration;       /* seconds; 0: still */
    uint32_t camera_total; /* cameras in the scene; the first PROTOCOL_MAX_CAMERAS are listed */
    uint16_t light_count, camera_count, setting_count, statistic_count, channel_count;
    struct protocol_light lights[PROTOCOL_MAX_LIGHTS];
    struct protocol_camera_name cameras[PROTOCOL_MAX_CAMERAS];
    struct protocol_setting settings[PROTOCOL_MAX_SETTINGS];
    struct protocol_statistic statistics[PROTOCOL_MAX_STATISTICS];
    struct protocol_channel_name channels[PROTOCOL_MAX_CHANNELS];
};

/* ---- requests ----------------------------------------------------------------------------------------- */

struct protocol_choose {
    uint16_t major, minor;
    uint64_t features;           /* subset of the server's */
    struct protocol_text client; /* name and version, for the server's log */
};

struct protocol_view_size { /* VIEW_CREATE (view is 0) and VIEW_RESIZE */
    uint32_t view, width, height;
};

struct protocol_view { /* VIEW_DESTROY, VIEW_RESET, UNSUBSCRIBE */
    uint32_t view;
};

struct protocol_share {
    uint32_t view;
    bool shared;
};

struct protocol_camera {
    float eye[3], at[3], up[3]; /* metres */
    float fov;                  /* vertical, degrees */
};

struct protocol_view_camera {
    uint32_t view;
    struct protocol_camera camera;
};

struct protocol_follow {
    uint32_t view;
    uint32_t camera;           /* index, or PROTOCOL_BY_NAME */
    struct protocol_text name; /* empty unless PROTOCOL_BY_NAME */
};

struct protocol_time {
    uint32_t view;
    double time; /* seconds */
};

#define PROTOCOL_LIGHT_INTENSITY 1u
#define PROTOCOL_LIGHT_POSITION  2u
#define PROTOCOL_LIGHT_DIRECTION 4u

struct protocol_view_light {
    uint32_t view, light;
    uint32_t overrides; /* bits of PROTOCOL_LIGHT_*; 0 returns the light to the scene's own */
    float intensity[3], position[3], direction[3]; /* 0 where not overridden */
};

struct protocol_view_setting {
    uint32_t view, setting; /* index in the HELLO's list */
    double value;           /* a bool is 0 or 1, a choice the index of its name */
};

struct protocol_render { /* RENDER and SUBSCRIBE */
    uint32_t view;
    uint32_t channels; /* bit i: channel i of the HELLO's list; 0: statistics only */
    uint8_t format, encoding;
    uint32_t
        credit; /* SUBSCRIBE: frames the server may send before the first CREDIT, at least 1. RENDER: 0 */
};

struct protocol_credit {
    uint32_t view, frames; /* frames more, 1 or more */
};

/* ---- replies and frames ------------------------------------------------------------------------------- */

struct protocol_ok {
    uint32_t value; /* VIEW_CREATE: the new view's id, never 0. Others: 0 */
};

struct protocol_error {
    uint32_t status; /* enum status; never STATUS_OK */
    struct protocol_text text;
};

enum protocol_notice_kind {
    PROTOCOL_NOTICE_CLOSING = 1,   /* this connection closes now: broken framing, too slow, shutdown */
    PROTOCOL_NOTICE_VIEW_GONE = 2, /* a watched view was destroyed or is no longer shared */
    PROTOCOL_NOTICE_LIVE_ENDED = 3 /* a live subscription ended because its view cannot be rendered */
};

struct protocol_notice {
    uint16_t kind;
    uint32_t view;   /* 0 when it is about no view */
    uint32_t status; /* enum status; STATUS_OK for an orderly shutdown */
    struct protocol_text text;
};

struct protocol_channel {
    uint8_t channel; /* index in the HELLO's list */
    uint8_t format, encoding, components;
    uint32_t width, height;
    uint32_t bytes;        /* as sent, over all its parts */
    uint32_t clamped;      /* f16: finite values beyond 65504, sent as 65504 with their sign */
    uint32_t not_a_number; /* NaN values among the channel's */
};

struct protocol_pass {
    struct protocol_text name;
    uint64_t elapsed_ns;
};

struct protocol_plan_line {
    struct protocol_text name, reason;
    bool is_used;
};

struct protocol_frame {
    uint32_t view;
    uint64_t frame;           /* number of the view's frame, from 0 */
    uint32_t update_sequence; /* header sequence of the owner's last update that is in this frame; 0: none */
    uint32_t dropped;         /* live: frames of this view rendered and not sent since the last one sent */
    double time;
    struct protocol_camera camera;
    float world_to_camera[16], camera_to_clip[16]; /* column-major; Vulkan clip space */
    struct protocol_text black_reason;             /* empty, or why there is no caustic light at all */
    uint16_t channel_count, pass_count, statistic_count, plan_count;
    struct protocol_channel channels[PROTOCOL_MAX_CHANNELS];
    struct protocol_pass passes[PROTOCOL_MAX_PASSES];
    double statistics[PROTOCOL_MAX_STATISTICS]; /* in the HELLO's order */
    struct protocol_plan_line plan[PROTOCOL_MAX_PLAN_LINES];
};

/* Follows its FRAME; parts come in order of channel and offset, without gaps, and are never empty. */
struct protocol_part {
    uint32_t view;
    uint64_t frame;
    uint32_t channel; /* index in the frame's channel list */
    uint32_t offset;  /* of `bytes` within the channel's bytes */
    const uint8_t *bytes;
    uint32_t length;
};

/* ---- messages ----------------------------------------------------------------------------------------- */

struct protocol_header {
    uint32_t length; /* of the payload */
    uint16_t type;   /* enum protocol_type; a type this version does not know is possible */
    uint16_t flags;  /* 0 */
    uint32_t
        request; /* chosen by the client, not 0; in replies the request they answer; in HELLO and NOTICE 0 */
    uint32_t
        sequence; /* to the server: rises with every message, from 1. To the client: counts messages from 0 */
};

struct protocol_message {
    struct protocol_header header; /* protocol_encode ignores header.length */
    union {
        struct protocol_hello hello;
        struct protocol_choose choose;
        struct protocol_view_size size;
        struct protocol_view view;
        struct protocol_share share;
        struct protocol_view_camera camera;
        struct protocol_follow follow;
        struct protocol_time time;
        struct protocol_view_light light;
        struct protocol_view_setting setting;
        struct protocol_render render;
        struct protocol_credit credit;
        struct protocol_ok ok;
        struct protocol_error error;
        struct protocol_notice notice;
        struct protocol_frame frame;
        struct protocol_part part;
    };
};

/* Reads the header of a message sent by `from`. False means broken framing: the payload would be longer than
 * its type allows, or the type belongs to the other side; say so with a NOTICE and close. Types this version
 * does not know pass, up to PROTOCOL_MAX_REQUEST_BYTES, so that they can be skipped and answered with an
 * error. */
bool protocol_header_read(const uint8_t bytes[PROTOCOL_HEADER_BYTES], enum protocol_side from,
                          struct protocol_header *header, struct error *error);

/* Decodes `header->length` bytes. False and an error that names message and field when the payload is
 * truncated, has bytes left over, or holds a value no message may hold; STATUS_UNSUPPORTED for a type this
 * version does not know. Such a request is answered with its error; the connection stays. Checks form:
 * counts, finite numbers, UTF-8, enumerations. Ranges that depend on scene and device are the renderer's to
 * check. */
bool protocol_decode(const struct protocol_header *header, const uint8_t *payload,
                     struct protocol_message *message, struct error *error);

/* Writes header and payload to `bytes` and returns their size; `bytes` NULL: the size alone. 0 and an error
 * when the message breaks the rules protocol_decode checks, or does not fit `capacity`. */
size_t protocol_encode(const struct protocol_message *message, uint8_t *bytes, size_t capacity,
                       struct error *error);

/* Largest payload of a type; PROTOCOL_MAX_REQUEST_BYTES for types this version does not know. */
uint32_t protocol_payload_limit(uint16_t type);

/* "VIEW_CREATE", ...; "unknown" for others. */
const char *protocol_type_name(uint16_t type);

#endif
