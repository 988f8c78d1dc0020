#include "protocol.h"

#include <string.h>

#include "codec.h"

#define PART_HEAD_BYTES 20u /* PART's fields before the image bytes */
#define REPLY_BYTES     1024u

static const struct {
    uint16_t type;
    enum protocol_side from;
    uint32_t limit;
    const char *name;
} types[] = {
#define REQUEST(name)                                                                                        \
    {                                                                                                        \
        PROTOCOL_##name, PROTOCOL_CLIENT, PROTOCOL_MAX_REQUEST_BYTES, #name                                  \
    }
#define REPLY(name, limit)                                                                                   \
    {                                                                                                        \
        PROTOCOL_##name, PROTOCOL_SERVER, limit, #name                                                       \
    }
    REQUEST(CHOOSE),
    REQUEST(PING),
    REQUEST(VIEW_CREATE),
    REQUEST(VIEW_RESIZE),
    REQUEST(VIEW_DESTROY),
    REQUEST(VIEW_SHARE),
    REQUEST(VIEW_CAMERA),
    REQUEST(VIEW_FOLLOW),
    REQUEST(VIEW_TIME),
    REQUEST(VIEW_LIGHT),
    REQUEST(VIEW_SETTING),
    REQUEST(VIEW_RESET),
    REQUEST(RENDER),
    REQUEST(SUBSCRIBE),
    REQUEST(UNSUBSCRIBE),
    REQUEST(CREDIT),
    REPLY(HELLO, PROTOCOL_MAX_HELLO_BYTES),
    REPLY(OK, REPLY_BYTES),
    REPLY(ERROR, REPLY_BYTES),
    REPLY(NOTICE, REPLY_BYTES),
    REPLY(FRAME, PROTOCOL_MAX_FRAME_BYTES),
    REPLY(PART, PART_HEAD_BYTES + PROTOCOL_MAX_PART_BYTES),
#undef REQUEST
#undef REPLY
};

static int type_index(uint16_t type)
{
    for (size_t i = 0; i < sizeof types / sizeof *types; i++)
        if (types[i].type == type)
            return (int)i;
    return -1;
}

uint32_t protocol_payload_limit(uint16_t type)
{
    int index = type_index(type);
    return index < 0 ? PROTOCOL_MAX_REQUEST_BYTES : types[index].limit;
}

const char *protocol_type_name(uint16_t type)
{
    int index = type_index(type);
    return index < 0 ? "unknown" : types[index].name;
}

struct protocol_text protocol_text_of(const char *text)
{
    if (!text)
        return (struct protocol_text){0};
    size_t length = strnlen(text, PROTOCOL_MAX_TEXT_BYTES + 1);
    if (length > PROTOCOL_MAX_TEXT_BYTES) {
        length = PROTOCOL_MAX_TEXT_BYTES;
        while (length > 0 && ((uint8_t)text[length] & 0xc0) == 0x80)
            length--;
    }
    return (struct protocol_text){text, (uint16_t)length};
}

void protocol_text_copy(struct protocol_text text, char *target, size_t size)
{
    if (size == 0)
        return;
    size_t length = text.length < size - 1 ? text.length : size - 1;
    if (length)
        memcpy(target, text.bytes, length);
    target[length] = 0;
}

bool protocol_text_equals(struct protocol_text text, const char *other)
{
    return strlen(other) == text.length && (text.length == 0 || memcmp(text.bytes, other, text.length) == 0);
}

/* ---- fields of each message, both ways ---------------------------------------------------------------- */

static void hello_fields(struct codec *c, struct protocol_hello *m)
{
    uint32_t magic = PROTOCOL_MAGIC;
    codec_u32(c, "magic", &magic);
    codec_check(c, magic == PROTOCOL_MAGIC, "magic", "is not CSTC: this is no caustics server");
    codec_u16(c, "major", &m->major);
    codec_u16(c, "minor", &m->minor);
    if (c->decoding && !c->failed && m->major != PROTOCOL_MAJOR) {
        /* What follows may have another shape. */
        c->failed = true;
        error_set(c->error, STATUS_UNSUPPORTED, "HELLO: the server speaks protocol %u.%u, this client %u.%u",
                  m->major, m->minor, PROTOCOL_MAJOR, PROTOCOL_MINOR);
        return;
    }
    codec_u64(c, "features", &m->features);
    codec_text(c, "version", &m->version);
    codec_text(c, "device", &m->device);
    codec_text(c, "driver", &m->driver);
    codec_text(c, "tracer", &m->tracer);
    codec_u32(c, "max_clients", &m->limits.max_clients);
    codec_u32(c, "max_views", &m->limits.max_views);
    codec_u32(c, "max_size", &m->limits.max_size);
    codec_u32(c, "max_pixels", &m->limits.max_pixels);
    codec_u32(c, "max_photons", &m->limits.max_photons);
    codec_u32(c, "max_request_bytes", &m->limits.max_request_bytes);
    codec_u64(c, "max_output_bytes", &m->limits.max_output_bytes);
    codec_text(c, "scene", &m->scene);
    codec_u32(c, "triangles", &m->triangles);
    codec_f64(c, "duration", &m->duration);
    codec_u32(c, "camera_total", &m->camera_total);
    codec_count(c, "lights", &m->light_count, PROTOCOL_MAX_LIGHTS);
    for (; c->index < m->light_count && !c->failed; c->index++) {
        struct protocol_light *light = &m->lights[c->index];
        codec_text(c, "name", &light->name);
        codec_enum(c, "type", &light->type, PROTOCOL_LIGHT_DIRECTIONAL + 1);
        codec_f32(c, "intensity", light->intensity, 3);
        codec_f32(c, "position", light->position, 3);
        codec_f32(c, "direction", light->direction, 3);
    }
    codec_count(c, "cameras", &m->camera_count, PROTOCOL_MAX_CAMERAS);
    for (; c->index < m->camera_count && !c->failed; c->index++) {
        codec_text(c, "name", &m->cameras[c->index].name);
        codec_f32(c, "fov", &m->cameras[c->index].fov, 1);
    }
    codec_count(c, "settings", &m->setting_count, PROTOCOL_MAX_SETTINGS);
    for (; c->index < m->setting_count && !c->failed; c->index++) {
        struct protocol_setting *setting = &m->settings[c->index];
        codec_text(c, "name", &setting->name);
        codec_enum(c, "type", &setting->type, PROTOCOL_CHOICE + 1);
        codec_f64(c, "minimum", &setting->minimum);
        codec_f64(c, "maximum", &setting->maximum);
        codec_f64(c, "default", &setting->value);
        codec_text(c, "choices", &setting->choices);
        codec_text(c, "help", &setting->help);
    }
    codec_count(c, "statistics", &m->statistic_count, PROTOCOL_MAX_STATISTICS);
    for (; c->index < m->statistic_count && !c->failed; c->index++) {
        codec_text(c, "name", &m->statistics[c->index].name);
        codec_text(c, "unit", &m->statistics[c->index].unit);
        codec_text(c, "help", &m->statistics[c->index].help);
    }
    codec_count(c, "channels", &m->channel_count, PROTOCOL_MAX_CHANNELS);
    for (; c->index < m->channel_count && !c->failed; c->index++) {
        struct protocol_channel_name *channel = &m->channels[c->index];
        codec_text(c, "name", &channel->name);
        codec_u8(c, "components", &channel->components);
        codec_check(c, channel->components >= 1 && channel->components <= 4, "components", "must be 1 to 4");
        codec_text(c, "help", &channel->help);
    }
}

static void camera_fields(struct codec *c, struct protocol_camera *camera)
{
    codec_f32(c, "eye", camera->eye, 3);
    codec_f32(c, "at", camera->at, 3);
    codec_f32(c, "up", camera->up, 3);
    codec_f32(c, "fov", &camera->fov, 1);
}

static void light_fields(struct codec *c, struct protocol_view_light *m)
{
    codec_u32(c, "view", &m->view);
    codec_u32(c, "light", &m->light);
    codec_u32(c, "overrides", &m->overrides);
    codec_check(c, m->overrides < 8, "overrides", "has bits without meaning");
    codec_f32(c, "intensity", m->intensity, 3);
    codec_f32(c, "position", m->position, 3);
    codec_f32(c, "direction", m->direction, 3);
}

static void render_fields(struct codec *c, struct protocol_render *m, bool is_live)
{
    codec_u32(c, "view", &m->view);
    codec_u32(c, "channels", &m->channels);
    codec_check(c, m->channels < 1u << PROTOCOL_MAX_CHANNELS, "channels", "has bits without meaning");
    codec_enum(c, "format", &m->format, PROTOCOL_FORMAT_COUNT);
    codec_enum(c, "encoding", &m->encoding, PROTOCOL_ENCODING_COUNT);
    codec_u32(c, "credit", &m->credit);
    if (is_live)
        codec_check(c, m->credit >= 1, "credit", "must be at least 1");
    else
        codec_check(c, m->credit == 0, "credit", "must be 0: a render request is answered once");
}

/* Bytes a channel may claim: exactly its pixels when raw; what tiles.h can produce at most when compressed.
 */
static bool channel_bytes_fit(const struct protocol_channel *channel)
{
    uint64_t raw = (uint64_t)channel->width * channel->height * channel->components *
                   (channel->format == PROTOCOL_F16 ? 2 : 4);
    if (channel->encoding == PROTOCOL_RAW)
        return channel->bytes == raw;
    uint64_t tiles = ((uint64_t)channel->width + 15) / 16 * (((uint64_t)channel->height + 15) / 16);
    return channel->bytes <= (tiles + 7) / 8 + raw + raw / 256 + 64;
}

static void frame_fields(struct codec *c, struct protocol_frame *m)
{
    codec_u32(c, "view", &m->view);
    codec_u64(c, "frame", &m->frame);
    codec_u32(c, "update_sequence", &m->update_sequence);
    codec_u32(c, "dropped", &m->dropped);
    codec_f64(c, "time", &m->time);
    camera_fields(c, &m->camera);
    codec_f32_any(c, "world_to_camera", m->world_to_camera, 16);
    codec_f32_any(c, "camera_to_clip", m->camera_to_clip, 16);
    codec_text(c, "black_reason", &m->black_reason);
    codec_count(c, "channels", &m->channel_count, PROTOCOL_MAX_CHANNELS);
    for (; c->index < m->channel_count && !c->failed; c->index++) {
        struct protocol_channel *channel = &m->channels[c->index];
        codec_u8(c, "channel", &channel->channel);
        codec_enum(c, "format", &channel->format, PROTOCOL_FORMAT_COUNT);
        codec_enum(c, "encoding", &channel->encoding, PROTOCOL_ENCODING_COUNT);
        codec_u8(c, "components", &channel->components);
        codec_check(c, channel->components >= 1 && channel->components <= 4, "components", "must be 1 to 4");
        codec_u32(c, "width", &channel->width);
        codec_check(c, channel->width >= 1 && channel->width <= PROTOCOL_MAX_IMAGE_SIZE, "width",
                    "must be 1 to 16384");
        codec_u32(c, "height", &channel->height);
        codec_check(c, channel->height >= 1 && channel->height <= PROTOCOL_MAX_IMAGE_SIZE, "height",
                    "must be 1 to 16384");
        codec_u32(c, "bytes", &channel->bytes);
        codec_check(c, channel_bytes_fit(channel), "bytes",
                    "does not fit width, height, components and format");
        codec_u32(c, "clamped", &channel->clamped);
        codec_u32(c, "not_a_number", &channel->not_a_number);
    }
    codec_count(c, "passes", &m->pass_count, PROTOCOL_MAX_PASSES);
    for (; c->index < m->pass_count && !c->failed; c->index++) {
        codec_text(c, "name", &m->passes[c->index].name);
        codec_u64(c, "elapsed_ns", &m->passes[c->index].elapsed_ns);
    }
    codec_count(c, "statistics", &m->statistic_count, PROTOCOL_MAX_STATISTICS);
    codec_f64_any(c, "values", m->statistics, m->statistic_count);
    codec_count(c, "plan", &m->plan_count, PROTOCOL_MAX_PLAN_LINES);
    for (; c->index < m->plan_count && !c->failed; c->index++) {
        codec_text(c, "name", &m->plan[c->index].name);
        codec_bool(c, "is_used", &m->plan[c->index].is_used);
        codec_text(c, "reason", &m->plan[c->index].reason);
    }
}

static void message_fields(struct codec *c, struct protocol_message *message)
{
    switch (message->header.type) {
    case PROTOCOL_CHOOSE:
        codec_u16(c, "major", &message->choose.major);
        codec_u16(c, "minor", &message->choose.minor);
        codec_u64(c, "features", &message->choose.features);
        codec_text(c, "client", &message->choose.client);
        break;
    case PROTOCOL_PING:
        break;
    case PROTOCOL_VIEW_CREATE:
    case PROTOCOL_VIEW_RESIZE:
        codec_u32(c, "view", &message->size.view);
        if (message->header.type == PROTOCOL_VIEW_CREATE)
            codec_check(c, message->size.view == 0, "view", "must be 0: the server chooses the id");
        codec_u32(c, "width", &message->size.width);
        codec_u32(c, "height", &message->size.height);
        break;
    case PROTOCOL_VIEW_DESTROY:
    case PROTOCOL_VIEW_RESET:
    case PROTOCOL_UNSUBSCRIBE:
        codec_u32(c, "view", &message->view.view);
        break;
    case PROTOCOL_VIEW_SHARE:
        codec_u32(c, "view", &message->share.view);
        codec_bool(c, "shared", &message->share.shared);
        break;
    case PROTOCOL_VIEW_CAMERA:
        codec_u32(c, "view", &message->camera.view);
        camera_fields(c, &message->camera.camera);
        break;
    case PROTOCOL_VIEW_FOLLOW:
        codec_u32(c, "view", &message->follow.view);
        codec_u32(c, "camera", &message->follow.camera);
        codec_text(c, "name", &message->follow.name);
        codec_check(c, (message->follow.name.length > 0) == (message->follow.camera == PROTOCOL_BY_NAME),
                    "name", "must be given when camera is 0xffffffff, and only then");
        break;
    case PROTOCOL_VIEW_TIME:
        codec_u32(c, "view", &message->time.view);
        codec_f64(c, "time", &message->time.time);
        break;
    case PROTOCOL_VIEW_LIGHT:
        light_fields(c, &message->light);
        break;
    case PROTOCOL_VIEW_SETTING:
        codec_u32(c, "view", &message->setting.view);
        codec_u32(c, "setting", &message->setting.setting);
        codec_f64(c, "value", &message->setting.value);
        break;
    case PROTOCOL_RENDER:
    case PROTOCOL_SUBSCRIBE:
        render_fields(c, &message->render, message->header.type == PROTOCOL_SUBSCRIBE);
        break;
    case PROTOCOL_CREDIT:
        codec_u32(c, "view", &message->credit.view);
        codec_u32(c, "frames", &message->credit.frames);
        codec_check(c, message->credit.frames >= 1, "frames", "must be at least 1");
        break;
    case PROTOCOL_HELLO:
        hello_fields(c, &message->hello);
        break;
    case PROTOCOL_OK:
        codec_u32(c, "value", &message->ok.value);
        break;
    case PROTOCOL_ERROR:
        codec_u32(c, "status", &message->error.status);
        codec_check(c, message->error.status >= 1 && message->error.status <= STATUS_MEMORY, "status",
                    "is none of the statuses of an error");
        codec_text(c, "text", &message->error.text);
        break;
    case PROTOCOL_NOTICE:
        codec_u16(c, "kind", &message->notice.kind);
        codec_u32(c, "view", &message->notice.view);
        codec_u32(c, "status", &message->notice.status);
        codec_check(c, message->notice.status <= STATUS_MEMORY, "status", "is no status");
        codec_text(c, "text", &message->notice.text);
        break;
    case PROTOCOL_FRAME:
        frame_fields(c, &message->frame);
        break;
    case PROTOCOL_PART:
        codec_u32(c, "view", &message->part.view);
        codec_u64(c, "frame", &message->part.frame);
        codec_u32(c, "channel", &message->part.channel);
        codec_check(c, message->part.channel < PROTOCOL_MAX_CHANNELS, "channel",
                    "is not in the frame's list");
        codec_u32(c, "offset", &message->part.offset);
        codec_rest(c, "bytes", &message->part.bytes, &message->part.length, PROTOCOL_MAX_PART_BYTES);
        break;
    default:
        if (!c->failed)
            error_set(c->error, STATUS_UNSUPPORTED, "message type %u is not known to protocol %u.%u",
                      message->header.type, PROTOCOL_MAJOR, PROTOCOL_MINOR);
        c->failed = true;
    }
}

static void header_fields(struct codec *c, struct protocol_header *header)
{
    codec_u32(c, "length", &header->length);
    codec_u16(c, "type", &header->type);
    codec_u16(c, "flags", &header->flags);
    codec_u32(c, "request", &header->request);
    codec_u32(c, "sequence", &header->sequence);
}

/* ---- the public face ---------------------------------------------------------------------------------- */

bool protocol_header_read(const uint8_t bytes[PROTOCOL_HEADER_BYTES], enum protocol_side from,
                          struct protocol_header *header, struct error *error)
{
    struct codec codec = {
        .message = "header", .decoding = true, .read = bytes, .size = PROTOCOL_HEADER_BYTES, .error = error};
    header_fields(&codec, header);
    int index = type_index(header->type);
    if (index >= 0 && types[index].from != from)
        return error_set(error, STATUS_INVALID, "broken framing: %s is a message of the other side",
                         types[index].name);
    uint32_t limit = protocol_payload_limit(header->type);
    if (header->length > limit)
        return error_set(error, STATUS_LIMIT,
                         "broken framing: %u bytes of payload announced for %s (type %u), at most %u",
                         header->length, protocol_type_name(header->type), header->type, limit);
    return true;
}

bool protocol_decode(const struct protocol_header *header, const uint8_t *payload,
                     struct protocol_message *message, struct error *error)
{
    struct codec codec = {.message = protocol_type_name(header->type),
                          .decoding = true,
                          .read = payload,
                          .size = header->length,
                          .error = error};
    message->header = *header;
    codec_check(&codec, header->flags == 0, "flags", "must be 0");
    message_fields(&codec, message);
    codec.list = NULL;
    codec_check(&codec, codec.failed || codec.at == codec.size, "payload", "is longer than its fields");
    return !codec.failed;
}

size_t protocol_encode(const struct protocol_message *message, uint8_t *bytes, size_t capacity,
                       struct error *error)
{
    struct codec codec = {.message = protocol_type_name(message->header.type),
                          .write = bytes,
                          .size = capacity,
                          .error = error};
    /* Encoding only reads the message; the fields are shared with decoding, which writes it. */
    struct protocol_message *fields = (struct protocol_message *)message;
    struct protocol_header header = message->header;
    codec_check(&codec, header.flags == 0, "flags", "must be 0");
    header.length = 0;
    header_fields(&codec, &header);
    message_fields(&codec, fields);
    codec.list = NULL;
    size_t length = codec.at - PROTOCOL_HEADER_BYTES;
    codec_check(&codec, codec.failed || length <= protocol_payload_limit(header.type), "payload",
                "is longer than the protocol allows");
    if (codec.failed)
        return 0;
    if (bytes) {
        header.length = (uint32_t)length;
        struct codec head = {
            .message = codec.message, .write = bytes, .size = PROTOCOL_HEADER_BYTES, .error = error};
        header_fields(&head, &header);
    }
    return codec.at;
}
