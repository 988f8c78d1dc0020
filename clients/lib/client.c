#include "client_internal.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "transport.h"

#define REQUEST_BYTES (PROTOCOL_HEADER_BYTES + PROTOCOL_MAX_REQUEST_BYTES)

/* ---- messages ----------------------------------------------------------------------------------------- */

static bool fail(struct client *client)
{
    client->is_over = true;
    return false;
}

bool client_send(struct client *client, struct protocol_message *message, struct error *error)
{
    if (client->is_over)
        return error_set(error, STATUS_IO, "the connection to the server is over");
    message->header.flags = 0;
    message->header.request = ++client->request;
    message->header.sequence = ++client->sequence;
    uint8_t bytes[REQUEST_BYTES];
    size_t size = protocol_encode(message, bytes, sizeof bytes, error);
    if (size == 0)
        return false;
    if (!transport_write(client->socket, bytes, size, transport_now_ms() + client->timeout_ms, error))
        return fail(client);
    return true;
}

/* One message into client->incoming, its payload into client->payload. */
static bool read_message(struct client *client, int64_t deadline_ms, struct error *error)
{
    uint8_t head[PROTOCOL_HEADER_BYTES];
    struct protocol_header header;
    if (client->is_over)
        return error_set(error, STATUS_IO, "the connection to the server is over");
    if (!transport_read(client->socket, head, sizeof head, deadline_ms, error))
        return fail(client);
    if (!protocol_header_read(head, PROTOCOL_SERVER, &header, error)) {
        error->status = STATUS_IO;
        return fail(client);
    }
    if (header.length > client->payload_size) {
        uint8_t *grown = realloc(client->payload, header.length);
        if (!grown) {
            error_set(error, STATUS_MEMORY, "no memory for a message of %u bytes", header.length);
            return fail(client);
        }
        client->payload = grown;
        client->payload_size = header.length;
    }
    /* A message that has begun is finished even when its beginning took all the time. */
    int64_t patience = transport_now_ms() + client->timeout_ms;
    if (!transport_read(client->socket, client->payload, header.length,
                        patience > deadline_ms ? patience : deadline_ms, error))
        return fail(client);
    if (!protocol_decode(&header, client->payload, &client->incoming, error)) {
        error->status = error->status == STATUS_UNSUPPORTED ? STATUS_UNSUPPORTED : STATUS_IO;
        return fail(client);
    }
    return true;
}

static bool take_notice(struct client *client, struct error *error)
{
    const struct protocol_notice *notice = &client->incoming.notice;
    char text[PROTOCOL_MAX_TEXT_BYTES + 1];
    protocol_text_copy(notice->text, text, sizeof text);
    if (notice->kind == PROTOCOL_NOTICE_CLOSING) {
        error_set(error, STATUS_IO, "the server closes the connection: %.400s", text);
        return fail(client);
    }
    if (notice->kind == PROTOCOL_NOTICE_VIEW_GONE || notice->kind == PROTOCOL_NOTICE_LIVE_ENDED) {
        client->has_notice = true;
        error_set(&client->notice, STATUS_NOT_FOUND, "view %u: %.400s", notice->view, text);
        for (uint32_t i = 0; i < client->live_count; i++)
            if (client->live[i].view == notice->view)
                client->live[i--] = client->live[--client->live_count];
    }
    return true;
}

enum client_event client_receive(struct client *client, int64_t deadline_ms, struct client_frame **frame,
                                 struct error *error)
{
    *frame = NULL;
    if (!read_message(client, deadline_ms, error))
        return CLIENT_EVENT_ERROR;
    switch (client->incoming.header.type) {
    case PROTOCOL_OK:
    case PROTOCOL_ERROR:
        return CLIENT_EVENT_REPLY;
    case PROTOCOL_NOTICE:
        return take_notice(client, error) ? CLIENT_EVENT_OTHER : CLIENT_EVENT_ERROR;
    case PROTOCOL_FRAME:
        if (!client_frame_begin(client, frame, error))
            break;
        return *frame ? CLIENT_EVENT_FRAME : CLIENT_EVENT_OTHER;
    case PROTOCOL_PART:
        if (!client_frame_part(client, frame, error))
            break;
        return *frame ? CLIENT_EVENT_FRAME : CLIENT_EVENT_OTHER;
    default:
        error_set(error, STATUS_IO, "the server sent %s where it has no place",
                  protocol_type_name(client->incoming.header.type));
        break;
    }
    client->is_over = true;
    return CLIENT_EVENT_ERROR;
}

bool client_request(struct client *client, struct protocol_message *message, uint32_t *value,
                    struct error *error)
{
    if (!client_send(client, message, error))
        return false;
    uint32_t request = message->header.request;
    int64_t deadline = transport_now_ms() + client->timeout_ms;
    for (;;) {
        struct client_frame *frame;
        switch (client_receive(client, deadline, &frame, error)) {
        case CLIENT_EVENT_ERROR:
            return false;
        case CLIENT_EVENT_FRAME:
            if (!client_frame_queue(client, frame, error))
                return fail(client);
            break;
        case CLIENT_EVENT_OTHER:
            break;
        case CLIENT_EVENT_REPLY:
            if (client->incoming.header.request != request) {
                error_set(error, STATUS_IO, "the server answered request %u where %u was asked",
                          client->incoming.header.request, request);
                return fail(client);
            }
            if (client->incoming.header.type == PROTOCOL_ERROR) {
                char text[PROTOCOL_MAX_TEXT_BYTES + 1];
                protocol_text_copy(client->incoming.error.text, text, sizeof text);
                return error_set(error, (enum status)client->incoming.error.status, "%s", text);
            }
            if (value)
                *value = client->incoming.ok.value;
            return true;
        }
    }
}

/* ---- connection --------------------------------------------------------------------------------------- */

static bool shake_hands(struct client *client, const char *name, struct error *error)
{
    if (!read_message(client, transport_now_ms() + client->timeout_ms, error))
        return false;
    if (client->incoming.header.type == PROTOCOL_NOTICE) {
        take_notice(client, error);
        return error_set(error, STATUS_IO, "the server refuses the connection: %.*s",
                         client->incoming.notice.text.length, client->incoming.notice.text.bytes);
    }
    if (client->incoming.header.type != PROTOCOL_HELLO)
        return error_set(error, STATUS_IO, "the server did not begin with HELLO");
    client->hello = client->incoming.hello;
    client->hello_payload = client->payload; /* hello's texts point into it */
    client->payload = NULL;
    client->payload_size = 0;
    uint64_t wanted =
        PROTOCOL_FEATURE_ZSTD | PROTOCOL_FEATURE_F16 | PROTOCOL_FEATURE_LIVE | PROTOCOL_FEATURE_SHARE;
    struct protocol_message choose = {.header.type = PROTOCOL_CHOOSE};
    choose.choose = (struct protocol_choose){
        .major = PROTOCOL_MAJOR,
        .minor = PROTOCOL_MINOR, /* 0: no server's minor is below */
        .features = wanted & client->hello.features,
        .client = protocol_text_of(name ? name : "caustic client"),
    };
    return client_request(client, &choose, NULL, error);
}

struct client *client_adopt(int socket, const struct client_params *params, struct error *error)
{
    struct client *client = calloc(1, sizeof *client);
    if (!client) {
        close(socket);
        error_set(error, STATUS_MEMORY, "no memory for a client");
        return NULL;
    }
    client->socket = socket;
    client->timeout_ms = params->timeout_ms ? params->timeout_ms : 30000;
    client->max_frame_bytes = params->max_frame_bytes ? params->max_frame_bytes : (uint64_t)2 << 30;
    client->codec = tile_codec_create(error);
    if (!client->codec || !transport_set_nonblocking(socket, error) ||
        !shake_hands(client, params->name, error))
        client_destroy(&client);
    return client;
}

struct client *client_connect(const struct client_params *params, struct error *error)
{
    char fallback[32];
    snprintf(fallback, sizeof fallback, "tcp:127.0.0.1:%u", PROTOCOL_DEFAULT_PORT);
    int64_t now = transport_now_ms();
    uint32_t timeout = params->timeout_ms ? params->timeout_ms : 30000;
    int socket = transport_connect(params->address ? params->address : fallback,
                                   now + (timeout > params->wait_ms ? timeout : params->wait_ms),
                                   now + params->wait_ms, error);
    return socket < 0 ? NULL : client_adopt(socket, params, error);
}

void client_destroy(struct client **client)
{
    if (*client) {
        close((*client)->socket);
        for (uint32_t i = 0; i < (*client)->queue_count; i++)
            client_frame_destroy(&(*client)->queue[i]);
        client_frame_destroy(&(*client)->assembly.frame);
        free((*client)->assembly.bytes);
        tile_codec_destroy(&(*client)->codec);
        free((*client)->hello_payload);
        free((*client)->payload);
        free(*client);
    }
    *client = NULL;
}

const struct protocol_hello *client_hello(const struct client *client)
{
    return &client->hello;
}

/* ---- names -------------------------------------------------------------------------------------------- */

/* Appends ", name" while it fits. */
static void list_name(char *list, size_t size, struct protocol_text name)
{
    size_t used = strlen(list);
    if (used + name.length + 3 < size)
        snprintf(list + used, size - used, "%s%.*s", used ? ", " : "", name.length, name.bytes);
}

bool client_find_setting(const struct client *client, const char *name, uint32_t *index, struct error *error)
{
    char list[300] = "";
    for (*index = 0; *index < client->hello.setting_count; ++*index) {
        if (protocol_text_equals(client->hello.settings[*index].name, name))
            return true;
        list_name(list, sizeof list, client->hello.settings[*index].name);
    }
    return error_set(error, STATUS_NOT_FOUND, "no setting is called %.100s; there are %s", name, list);
}

bool client_find_light(const struct client *client, const char *name, uint32_t *index, struct error *error)
{
    char list[300] = "";
    for (*index = 0; *index < client->hello.light_count; ++*index) {
        if (protocol_text_equals(client->hello.lights[*index].name, name))
            return true;
        list_name(list, sizeof list, client->hello.lights[*index].name);
    }
    if (client->hello.light_count == 0)
        return error_set(error, STATUS_NOT_FOUND, "no light is called %.100s; the scene has no lights", name);
    return error_set(error, STATUS_NOT_FOUND, "no light is called %.100s; there are %s", name, list);
}

bool client_find_channel(const struct client *client, const char *name, uint32_t *index, struct error *error)
{
    char list[300] = "";
    for (*index = 0; *index < client->hello.channel_count; ++*index) {
        if (protocol_text_equals(client->hello.channels[*index].name, name))
            return true;
        list_name(list, sizeof list, client->hello.channels[*index].name);
    }
    return error_set(error, STATUS_NOT_FOUND, "no channel is called %.100s; there are %s", name, list);
}

/* The i-th of a comma-separated list, or an empty text past its end. */
static struct protocol_text choice_at(struct protocol_text choices, uint32_t index)
{
    const char *at = choices.bytes, *end = at + choices.length;
    for (; at && at < end; index--) {
        const char *comma = memchr(at, ',', (size_t)(end - at));
        const char *stop = comma ? comma : end;
        if (index == 0)
            return (struct protocol_text){at, (uint16_t)(stop - at)};
        at = comma ? comma + 1 : end;
    }
    return (struct protocol_text){0};
}

bool client_setting_parse(const struct protocol_setting *setting, const char *text, double *value,
                          struct error *error)
{
    char name[64], choices[200];
    protocol_text_copy(setting->name, name, sizeof name);
    protocol_text_copy(setting->choices, choices, sizeof choices);
    if (setting->type == PROTOCOL_CHOICE) {
        for (uint32_t i = 0;; i++) {
            struct protocol_text choice = choice_at(setting->choices, i);
            if (choice.length == 0)
                return error_set(error, STATUS_INVALID, "%s: %.100s is none of %s", name, text, choices);
            if (protocol_text_equals(choice, text)) {
                *value = i;
                return true;
            }
        }
    }
    if (setting->type == PROTOCOL_BOOL) {
        static const char *const words[] = {"off", "on", "false", "true", "no", "yes", "0", "1"};
        for (uint32_t i = 0; i < sizeof words / sizeof *words; i++) {
            if (strcasecmp(text, words[i]) == 0) {
                *value = i % 2;
                return true;
            }
        }
        return error_set(error, STATUS_INVALID, "%s: %.100s is neither on nor off", name, text);
    }
    char *end;
    *value = strtod(text, &end);
    if (end == text || *end || !isfinite(*value))
        return error_set(error, STATUS_INVALID, "%s: %.100s is not a number", name, text);
    if (setting->type == PROTOCOL_INT && *value != floor(*value))
        return error_set(error, STATUS_INVALID, "%s: %.100s is not a whole number", name, text);
    if (*value < setting->minimum || *value > setting->maximum)
        return error_set(error, STATUS_INVALID, "%s: %.100s is not between %.9g and %.9g", name, text,
                         setting->minimum, setting->maximum);
    return true;
}

void client_setting_print(const struct protocol_setting *setting, double value, char *text, size_t size)
{
    if (setting->type == PROTOCOL_CHOICE && value >= 0 && value < 65536) {
        struct protocol_text choice = choice_at(setting->choices, (uint32_t)value);
        if (choice.length) {
            protocol_text_copy(choice, text, size);
            return;
        }
    }
    if (setting->type == PROTOCOL_BOOL)
        snprintf(text, size, "%s", value != 0 ? "on" : "off");
    else
        snprintf(text, size, "%.9g", value);
}

/* ---- views -------------------------------------------------------------------------------------------- */

bool client_view_create(struct client *client, uint32_t width, uint32_t height, uint32_t *view,
                        struct error *error)
{
    struct protocol_message message = {.header.type = PROTOCOL_VIEW_CREATE};
    message.size = (struct protocol_view_size){.width = width, .height = height};
    return client_request(client, &message, view, error);
}

bool client_view_resize(struct client *client, uint32_t view, uint32_t width, uint32_t height,
                        struct error *error)
{
    struct protocol_message message = {.header.type = PROTOCOL_VIEW_RESIZE};
    message.size = (struct protocol_view_size){.view = view, .width = width, .height = height};
    return client_request(client, &message, NULL, error);
}

static bool request_view(struct client *client, enum protocol_type type, uint32_t view, struct error *error)
{
    struct protocol_message message = {.header.type = (uint16_t)type};
    message.view.view = view;
    return client_request(client, &message, NULL, error);
}

bool client_view_destroy(struct client *client, uint32_t view, struct error *error)
{
    return request_view(client, PROTOCOL_VIEW_DESTROY, view, error);
}

bool client_view_reset(struct client *client, uint32_t view, struct error *error)
{
    return request_view(client, PROTOCOL_VIEW_RESET, view, error);
}

bool client_ping(struct client *client, struct error *error)
{
    return request_view(client, PROTOCOL_PING, 0, error);
}

bool client_view_share(struct client *client, uint32_t view, bool shared, struct error *error)
{
    struct protocol_message message = {.header.type = PROTOCOL_VIEW_SHARE};
    message.share = (struct protocol_share){.view = view, .shared = shared};
    return client_request(client, &message, NULL, error);
}

bool client_view_camera(struct client *client, uint32_t view, const struct protocol_camera *camera,
                        struct error *error)
{
    struct protocol_message message = {.header.type = PROTOCOL_VIEW_CAMERA};
    message.camera = (struct protocol_view_camera){.view = view, .camera = *camera};
    return client_request(client, &message, NULL, error);
}

bool client_view_follow(struct client *client, uint32_t view, const char *camera, struct error *error)
{
    struct protocol_message message = {.header.type = PROTOCOL_VIEW_FOLLOW};
    message.follow =
        (struct protocol_follow){.view = view, .camera = PROTOCOL_BY_NAME, .name = protocol_text_of(camera)};
    return client_request(client, &message, NULL, error);
}

bool client_view_time(struct client *client, uint32_t view, double time, struct error *error)
{
    struct protocol_message message = {.header.type = PROTOCOL_VIEW_TIME};
    message.time = (struct protocol_time){.view = view, .time = time};
    return client_request(client, &message, NULL, error);
}

bool client_view_light(struct client *client, const struct protocol_view_light *change, struct error *error)
{
    struct protocol_message message = {.header.type = PROTOCOL_VIEW_LIGHT};
    message.light = *change;
    return client_request(client, &message, NULL, error);
}

bool client_view_setting(struct client *client, uint32_t view, uint32_t setting, double value,
                         struct error *error)
{
    struct protocol_message message = {.header.type = PROTOCOL_VIEW_SETTING};
    message.setting = (struct protocol_view_setting){.view = view, .setting = setting, .value = value};
    return client_request(client, &message, NULL, error);
}

bool client_view_set(struct client *client, uint32_t view, const char *name, const char *text,
                     struct error *error)
{
    uint32_t setting;
    double value;
    return client_find_setting(client, name, &setting, error) &&
           client_setting_parse(&client->hello.settings[setting], text, &value, error) &&
           client_view_setting(client, view, setting, value, error);
}
