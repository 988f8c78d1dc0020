#include "fake_peer.h"

#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "protocol/tiles.h"

#define SETTINGS       5u
#define CHANNELS       3u
#define PART_BYTES     4096u /* small, so that frames come in many parts */
#define CONNECT_WAIT_S 20

struct fake_peer {
    pthread_t thread;
    int socket, listener;
    enum fake_fault fault;
    uint32_t sequence, requests, update_sequence, width, height, credit;
    uint64_t frame;
    double time, settings[SETTINGS];
    struct protocol_camera camera;
    struct protocol_view_light light;
    struct protocol_header live;      /* request of the subscription */
    struct protocol_render live_asks; /* view 0: none */
    struct protocol_message in, out;
    uint8_t payload[PROTOCOL_MAX_REQUEST_BYTES], bytes[PROTOCOL_MAX_HELLO_BYTES];
    struct tile_codec *codec;
};

static const struct protocol_channel_name channels[CHANNELS] = {
    {.components = 3}, {.components = 1}, {.components = 1}};
static const char *const channel_names[CHANNELS] = {"beauty", "depth", "density"};

float fake_peer_value(uint32_t channel, uint64_t frame, uint32_t x, uint32_t y, uint32_t c)
{
    if ((x / 16 + y / 16) % 2)
        return 0;
    return (float)(((x * 7 + y * 13 + c * 3 + channel * 5 + (uint32_t)frame * 11) % 512)) * 0.125f;
}

static bool send_all(struct fake_peer *peer, const uint8_t *bytes, size_t size)
{
    while (size) {
        ssize_t sent = send(peer->socket, bytes, size, MSG_NOSIGNAL);
        if (sent <= 0)
            return false;
        bytes += sent;
        size -= (size_t)sent;
    }
    return true;
}

static bool say(struct fake_peer *peer, uint16_t type, uint32_t request)
{
    struct error error;
    peer->out.header =
        (struct protocol_header){.type = type, .request = request, .sequence = peer->sequence++};
    size_t size = protocol_encode(&peer->out, peer->bytes, sizeof peer->bytes, &error);
    if (size == 0) {
        fprintf(stderr, "fake peer: %s\n", error.message);
        abort();
    }
    if (type == PROTOCOL_HELLO && peer->fault == FAKE_WRONG_MAGIC)
        peer->bytes[PROTOCOL_HEADER_BYTES] = 'X';
    if (type == PROTOCOL_HELLO && peer->fault == FAKE_WRONG_VERSION)
        peer->bytes[PROTOCOL_HEADER_BYTES + 4] = 2;
    return send_all(peer, peer->bytes, size);
}

static bool say_hello(struct fake_peer *peer)
{
    static const struct {
        const char *name, *choices;
        enum protocol_setting_type type;
        double maximum, value;
    } settings[SETTINGS] = {{"photons", "", PROTOCOL_INT, 1000000, 100},
                            {"gain", "", PROTOCOL_FLOAT, 10, 1},
                            {"aa", "filter,none,pixel", PROTOCOL_CHOICE, 2, 0},
                            {"jitter", "", PROTOCOL_BOOL, 1, 0},
                            {"seed", "", PROTOCOL_INT, 1000000, 1}};
    if (peer->fault == FAKE_REFUSES) {
        peer->out.notice = (struct protocol_notice){.kind = PROTOCOL_NOTICE_CLOSING,
                                                    .status = STATUS_LIMIT,
                                                    .text = protocol_text_of("enough clients")};
        return say(peer, PROTOCOL_NOTICE, 0) && false;
    }
    struct protocol_hello *hello = &peer->out.hello;
    memset(hello, 0, sizeof *hello);
    hello->major = PROTOCOL_MAJOR;
    hello->features = 15;
    hello->version = protocol_text_of("fake 1.2.3");
    hello->device = protocol_text_of("no device");
    hello->tracer = protocol_text_of("bvh");
    hello->scene = protocol_text_of("fake");
    hello->duration = 2;
    hello->camera_total = hello->camera_count = 1;
    hello->cameras[0] = (struct protocol_camera_name){protocol_text_of("main"), 40};
    hello->light_count = 1;
    hello->lights[0].name = protocol_text_of("lamp.one");
    hello->setting_count = SETTINGS;
    for (uint32_t i = 0; i < SETTINGS; i++) {
        hello->settings[i] = (struct protocol_setting){.name = protocol_text_of(settings[i].name),
                                                       .choices = protocol_text_of(settings[i].choices),
                                                       .type = (uint8_t)settings[i].type,
                                                       .maximum = settings[i].maximum,
                                                       .value = settings[i].value};
        peer->settings[i] = settings[i].value;
    }
    hello->statistic_count = 3;
    hello->statistics[0].name = protocol_text_of("photons_emitted");
    hello->statistics[0].unit = protocol_text_of("count");
    hello->statistics[1].name = protocol_text_of("flux_emitted");
    hello->statistics[1].unit = protocol_text_of("W");
    hello->statistics[2].name = protocol_text_of("guard_density");
    hello->statistics[2].unit = protocol_text_of("count");
    hello->channel_count = CHANNELS;
    for (uint32_t i = 0; i < CHANNELS; i++) {
        hello->channels[i] = channels[i];
        hello->channels[i].name = protocol_text_of(channel_names[i]);
    }
    return say(peer, PROTOCOL_HELLO, 0);
}

static bool say_ok(struct fake_peer *peer, uint32_t value)
{
    peer->out.ok.value = value;
    return say(peer, PROTOCOL_OK, peer->in.header.request);
}

static bool say_error(struct fake_peer *peer, enum status status, const char *text)
{
    peer->out.error = (struct protocol_error){.status = status, .text = protocol_text_of(text)};
    return say(peer, PROTOCOL_ERROR, peer->in.header.request);
}

static bool say_part(struct fake_peer *peer, uint32_t request, uint32_t channel, const uint8_t *bytes,
                     uint32_t offset, uint32_t length)
{
    peer->out.part = (struct protocol_part){.view = 1,
                                            .frame = peer->frame,
                                            .channel = channel,
                                            .offset = offset,
                                            .bytes = bytes + offset,
                                            .length = length};
    return say(peer, PROTOCOL_PART, request);
}

static bool say_channel(struct fake_peer *peer, uint32_t request, uint32_t index, const uint8_t *bytes,
                        uint32_t size)
{
    for (uint32_t offset = 0; offset < size;) {
        uint32_t length = size - offset < PART_BYTES ? size - offset : PART_BYTES;
        if (peer->fault == FAKE_CLOSES_IN_FRAME && offset >= size / 2)
            return false;
        if (peer->fault == FAKE_PART_TOO_LONG && offset + length == size)
            length++;
        if (peer->fault == FAKE_PART_OUT_OF_ORDER && offset == 0 && size > 2 * PART_BYTES) {
            if (!say_part(peer, request, index, bytes, PART_BYTES, PART_BYTES))
                return false;
        }
        if (!say_part(peer, request, index, bytes, offset, length))
            return false;
        offset += length;
    }
    return true;
}

static bool say_frame(struct fake_peer *peer, uint32_t request, const struct protocol_render *asks)
{
    struct error error;
    uint8_t *payloads[CHANNELS] = {0};
    uint32_t sizes[CHANNELS], count = 0;
    bool is_sent = true;
    static struct protocol_frame frame;
    memset(&frame, 0, sizeof frame);
    frame = (struct protocol_frame){.view = 1,
                                    .frame = peer->frame,
                                    .update_sequence = peer->update_sequence,
                                    .time = peer->time,
                                    .camera = peer->camera,
                                    .pass_count = 2,
                                    .statistic_count = 3,
                                    .plan_count = 1};
    for (uint32_t i = 0; i < 16; i++) {
        frame.world_to_camera[i] = (float)i;
        frame.camera_to_clip[i] = (float)(100 + i);
    }
    frame.passes[0] = (struct protocol_pass){protocol_text_of("trace"), 1000000 + peer->frame};
    frame.passes[1] = (struct protocol_pass){protocol_text_of("splat"), 3000000};
    frame.statistics[0] = peer->settings[0];
    frame.statistics[1] = 0.5;
    frame.plan[0] =
        (struct protocol_plan_line){protocol_text_of("water"), protocol_text_of("no water"), false};
    for (uint32_t c = 0; c < CHANNELS; c++) {
        if (!(asks->channels >> c & 1))
            continue;
        uint32_t width = c == 2 ? 20 : peer->width, height = c == 2 ? 12 : peer->height,
                 n = channels[c].components;
        float *values = malloc((size_t)width * height * n * sizeof *values);
        for (uint32_t i = 0; values && i < width * height * n; i++)
            values[i] = fake_peer_value(c, peer->frame, i / n % width, i / n / width, i % n);
        const uint8_t *bytes;
        if (!values ||
            !tiles_encode(peer->codec, values, width, height, n, (enum protocol_format)asks->format,
                          (enum protocol_encoding)asks->encoding, &frame.channels[count], &bytes, &error))
            abort();
        frame.channels[count].channel = (uint8_t)c;
        sizes[count] = frame.channels[count].bytes;
        payloads[count] = malloc(sizes[count] + 1u);
        if (!payloads[count])
            abort();
        memcpy(payloads[count], bytes, sizes[count]);
        free(values);
        count++;
    }
    frame.channel_count = (uint16_t)count;
    if (peer->fault == FAKE_HUGE_FRAME && count) {
        frame.channels[0].width = frame.channels[0].height = PROTOCOL_MAX_IMAGE_SIZE;
        frame.channels[0].encoding = PROTOCOL_ZSTD;
        frame.channels[0].bytes = 1 << 17;
    }
    peer->out.frame = frame;
    is_sent = say(peer, PROTOCOL_FRAME, request);
    for (uint32_t i = 0; i < count; i++) {
        is_sent = is_sent && say_channel(peer, request, i, payloads[i], sizes[i]);
        free(payloads[i]);
    }
    peer->frame++;
    return is_sent;
}

static bool send_live(struct fake_peer *peer)
{
    while (peer->live_asks.view && peer->credit) {
        peer->credit--;
        if (!say_frame(peer, peer->live.request, &peer->live_asks))
            return false;
        if (peer->fault == FAKE_LIVE_ENDS) {
            peer->live_asks.view = 0;
            peer->out.notice = (struct protocol_notice){.kind = PROTOCOL_NOTICE_LIVE_ENDED,
                                                        .view = 1,
                                                        .status = STATUS_DEVICE,
                                                        .text = protocol_text_of("device lost")};
            return say(peer, PROTOCOL_NOTICE, 0);
        }
    }
    return true;
}

static bool answer(struct fake_peer *peer)
{
    const struct protocol_message *in = &peer->in;
    if (in->header.type >= PROTOCOL_VIEW_CAMERA && in->header.type <= PROTOCOL_VIEW_SETTING)
        peer->update_sequence = in->header.sequence;
    switch (in->header.type) {
    case PROTOCOL_VIEW_CREATE:
        if (in->size.width == 0 || in->size.width > 8192)
            return say_error(peer, STATUS_INVALID, "width: must be 1 to 8192");
        peer->width = in->size.width;
        peer->height = in->size.height;
        return say_ok(peer, 1);
    case PROTOCOL_VIEW_RESIZE:
        peer->width = in->size.width;
        peer->height = in->size.height;
        return say_ok(peer, 0);
    case PROTOCOL_VIEW_CAMERA:
        peer->camera = in->camera.camera;
        return say_ok(peer, 0);
    case PROTOCOL_VIEW_FOLLOW:
        peer->camera.fov = 40;
        return say_ok(peer, 0);
    case PROTOCOL_VIEW_TIME:
        peer->time = in->time.time;
        return say_ok(peer, 0);
    case PROTOCOL_VIEW_LIGHT:
        peer->light = in->light;
        return say_ok(peer, 0);
    case PROTOCOL_VIEW_SETTING:
        if (in->setting.setting >= SETTINGS)
            return say_error(peer, STATUS_NOT_FOUND, "setting: there are 5");
        peer->settings[in->setting.setting] = in->setting.value;
        return say_ok(peer, 0);
    case PROTOCOL_RENDER:
        return say_frame(peer, in->header.request, &in->render);
    case PROTOCOL_SUBSCRIBE:
        peer->live = in->header;
        peer->live_asks = in->render;
        peer->credit = in->render.credit;
        return say_ok(peer, 0) && send_live(peer);
    case PROTOCOL_CREDIT:
        peer->credit += in->credit.frames;
        return say_ok(peer, 0) && send_live(peer);
    case PROTOCOL_UNSUBSCRIBE:
        peer->live_asks.view = 0;
        return say_ok(peer, 0);
    case PROTOCOL_PING:
        return say_ok(peer, 0) && (peer->fault != FAKE_REPLIES_TWICE || say_ok(peer, 0));
    default:
        return say_ok(peer, 0);
    }
}

static bool take_all(struct fake_peer *peer, void *bytes, size_t size)
{
    for (uint8_t *at = bytes; size;) {
        ssize_t got = recv(peer->socket, at, size, 0);
        if (got <= 0)
            return false;
        at += got;
        size -= (size_t)got;
    }
    return true;
}

static void *serve(void *argument)
{
    struct fake_peer *peer = argument;
    struct error error;
    uint8_t head[PROTOCOL_HEADER_BYTES];
    struct protocol_header header;
    if (peer->socket < 0) {
        struct pollfd waiting = {.fd = peer->listener, .events = POLLIN};
        if (poll(&waiting, 1, CONNECT_WAIT_S * 1000) == 1)
            peer->socket = accept(peer->listener, NULL, NULL);
        if (peer->socket < 0)
            return NULL;
    }
    bool goes_on = peer->fault == FAKE_SILENT || say_hello(peer);
    while (goes_on && take_all(peer, head, sizeof head)) {
        if (!protocol_header_read(head, PROTOCOL_CLIENT, &header, &error) ||
            !take_all(peer, peer->payload, header.length))
            break;
        peer->requests++;
        if (!protocol_decode(&header, peer->payload, &peer->in, &error)) {
            peer->in.header = header;
            goes_on = say_error(peer, error.status, error.message);
        } else {
            goes_on = peer->fault == FAKE_SILENT || answer(peer);
        }
    }
    close(peer->socket);
    return NULL;
}

struct fake_peer *fake_peer_start(int socket_, const char *path, enum fake_fault fault)
{
    struct error error;
    struct fake_peer *peer = calloc(1, sizeof *peer);
    if (!peer || !(peer->codec = tile_codec_create(&error)))
        abort();
    peer->socket = socket_;
    peer->listener = -1;
    peer->fault = fault;
    if (socket_ < 0) {
        struct sockaddr_un address = {.sun_family = AF_UNIX};
        snprintf(address.sun_path, sizeof address.sun_path, "%s", path);
        peer->listener = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
        if (peer->listener < 0 || bind(peer->listener, (struct sockaddr *)&address, sizeof address) < 0 ||
            listen(peer->listener, 1) < 0) {
            fprintf(stderr, "fake peer: %s: %s\n", path, strerror(errno));
            abort();
        }
    }
    if (pthread_create(&peer->thread, NULL, serve, peer) != 0)
        abort();
    return peer;
}

uint32_t fake_peer_stop(struct fake_peer **peer)
{
    pthread_join((*peer)->thread, NULL);
    uint32_t requests = (*peer)->requests;
    if ((*peer)->listener >= 0)
        close((*peer)->listener);
    tile_codec_destroy(&(*peer)->codec);
    free(*peer);
    *peer = NULL;
    return requests;
}
