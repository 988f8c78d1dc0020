#define _GNU_SOURCE
#include "wire.h"

#include "check.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#define WAIT_SECONDS 60.0

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static bool is_readable(const struct wire *wire, double seconds)
{
    struct pollfd poll_fd = {.fd = wire->fd, .events = POLLIN};
    return poll(&poll_fd, 1, seconds > 0 ? (int)(seconds * 1000) : 0) > 0;
}

struct wire *wire_connect(const char *address)
{
    struct wire *wire = calloc(1, sizeof *wire);
    assert_non_null(wire);
    if (strncmp(address, "unix:", 5) == 0) {
        struct sockaddr_un name = {.sun_family = AF_UNIX};
        snprintf(name.sun_path, sizeof name.sun_path, "%s", address + 5);
        wire->fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
        assert_int_equal(connect(wire->fd, (struct sockaddr *)&name, sizeof name), 0);
    } else {
        struct sockaddr_in name = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
        name.sin_port = htons((uint16_t)atoi(strrchr(address, ':') + 1));
        wire->fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
        assert_int_equal(connect(wire->fd, (struct sockaddr *)&name, sizeof name), 0);
    }
    return wire;
}

struct wire *wire_open(const char *address)
{
    struct wire *wire = wire_connect(address);
    assert_int_equal(wire_receive(wire)->header.type, PROTOCOL_HELLO);
    struct protocol_message choose = {.header.type = PROTOCOL_CHOOSE,
                                      .choose = {.major = PROTOCOL_MAJOR,
                                                 .minor = PROTOCOL_MINOR,
                                                 .features = wire->message.hello.features,
                                                 .client = protocol_text_of("test")}};
    wire_expect_ok(wire, wire_send(wire, &choose));
    return wire;
}

void wire_close(struct wire **wire)
{
    if (*wire)
        close((*wire)->fd);
    free(*wire);
    *wire = NULL;
}

void wire_send_bytes(struct wire *wire, const void *bytes, size_t size)
{
    const uint8_t *next = bytes;
    while (size) {
        ssize_t sent = send(wire->fd, next, size, MSG_NOSIGNAL);
        assert_true(sent > 0);
        next += sent;
        size -= (size_t)sent;
    }
}

uint32_t wire_send(struct wire *wire, struct protocol_message *message)
{
    uint8_t bytes[PROTOCOL_HEADER_BYTES + PROTOCOL_MAX_REQUEST_BYTES];
    struct error error = {0};
    message->header.sequence = ++wire->sequence;
    if (!message->header.request)
        message->header.request = wire->sequence;
    size_t size = protocol_encode(message, bytes, sizeof bytes, &error);
    if (!size)
        fail_msg("%s", error.message);
    wire_send_bytes(wire, bytes, size);
    return message->header.request;
}

static void receive_bytes(struct wire *wire, uint8_t *bytes, size_t size)
{
    double end = now() + WAIT_SECONDS;
    while (size) {
        if (!is_readable(wire, end - now()))
            fail_msg("the server says nothing for %g s", WAIT_SECONDS);
        ssize_t got = recv(wire->fd, bytes, size, 0);
        if (got <= 0)
            fail_msg("the server closed the connection: %s", got ? strerror(errno) : "end");
        bytes += got;
        size -= (size_t)got;
    }
}

const struct protocol_message *wire_receive(struct wire *wire)
{
    uint8_t bytes[PROTOCOL_HEADER_BYTES];
    struct protocol_header header;
    struct error error = {0};
    receive_bytes(wire, bytes, sizeof bytes);
    if (!protocol_header_read(bytes, PROTOCOL_SERVER, &header, &error))
        fail_msg("%s", error.message);
    receive_bytes(wire, wire->payload, header.length);
    if (!protocol_decode(&header, wire->payload, &wire->message, &error))
        fail_msg("%s", error.message);
    wire->message.header = header;
    assert_int_equal(header.sequence, wire->received);
    wire->received++;
    return &wire->message;
}

bool wire_is_silent(struct wire *wire, double seconds)
{
    return !is_readable(wire, seconds);
}

void wire_expect_end(struct wire *wire, double seconds)
{
    uint8_t byte;
    if (!is_readable(wire, seconds))
        fail_msg("the server keeps the connection");
    ssize_t got = recv(wire->fd, &byte, 1, 0);
    if (got != 0)
        fail_msg("not an orderly end: %s", got < 0 ? strerror(errno) : "more bytes");
}

uint32_t wire_expect_ok(struct wire *wire, uint32_t request)
{
    const struct protocol_message *message = wire_receive(wire);
    if (message->header.type == PROTOCOL_ERROR)
        fail_msg("request %u was refused: %.*s", request, (int)message->error.text.length,
                 message->error.text.bytes);
    assert_int_equal(message->header.type, PROTOCOL_OK);
    assert_int_equal(message->header.request, request);
    return message->ok.value;
}

static const char *terminate(struct wire *wire, struct protocol_text text)
{
    static char copy[PROTOCOL_MAX_TEXT_BYTES + 1];
    (void)wire;
    protocol_text_copy(text, copy, sizeof copy);
    return copy;
}

const char *wire_expect_error(struct wire *wire, uint32_t request, enum status status)
{
    const struct protocol_message *message = wire_receive(wire);
    assert_int_equal(message->header.type, PROTOCOL_ERROR);
    assert_int_equal(message->header.request, request);
    const char *text = terminate(wire, message->error.text);
    if (message->error.status != status)
        fail_msg("status %u, not %u: %s", message->error.status, (unsigned)status, text);
    return text;
}

const char *wire_expect_notice(struct wire *wire, enum protocol_notice_kind kind, enum status status)
{
    const struct protocol_message *message = wire_receive(wire);
    assert_int_equal(message->header.type, PROTOCOL_NOTICE);
    assert_int_equal(message->header.request, 0);
    assert_int_equal(message->notice.kind, kind);
    assert_int_equal(message->notice.status, status);
    return terminate(wire, message->notice.text);
}

struct wire_frame wire_take_frame(struct wire *wire)
{
    const struct protocol_message *message = &wire->message;
    assert_int_equal(message->header.type, PROTOCOL_FRAME);
    struct wire_frame frame = {.view = message->frame.view,
                               .request = message->header.request,
                               .update_sequence = message->frame.update_sequence,
                               .dropped = message->frame.dropped,
                               .number = message->frame.frame,
                               .hash = 0xcbf29ce484222325u};
    uint32_t count = message->frame.channel_count, bytes[PROTOCOL_MAX_CHANNELS];
    for (uint32_t i = 0; i < count; i++)
        bytes[i] = message->frame.channels[i].bytes;
    for (uint32_t i = 0; i < count; i++)
        for (uint32_t offset = 0; offset < bytes[i]; offset += message->part.length) {
            wire_receive(wire);
            assert_int_equal(message->header.type, PROTOCOL_PART);
            assert_int_equal(message->header.request, frame.request);
            assert_int_equal(message->part.view, frame.view);
            assert_int_equal(message->part.frame, frame.number);
            assert_int_equal(message->part.channel, i);
            assert_int_equal(message->part.offset, offset);
            assert_true(message->part.length <= bytes[i] - offset);
            for (uint32_t j = 0; j < message->part.length; j++)
                frame.hash = (frame.hash ^ message->part.bytes[j]) * 0x100000001b3u;
            frame.bytes += message->part.length;
        }
    return frame;
}

struct wire_frame wire_expect_frame(struct wire *wire, uint32_t request)
{
    const struct protocol_message *message = wire_receive(wire);
    if (message->header.type == PROTOCOL_ERROR)
        fail_msg("request %u was refused: %s", request, terminate(wire, message->error.text));
    assert_int_equal(message->header.type, PROTOCOL_FRAME);
    assert_int_equal(message->header.request, request);
    return wire_take_frame(wire);
}

/* ---- requests ----------------------------------------------------------------------------------------- */

uint32_t wire_create(struct wire *wire, uint32_t width, uint32_t height)
{
    return wire_send(wire, &(struct protocol_message){.header.type = PROTOCOL_VIEW_CREATE,
                                                      .size = {.width = width, .height = height}});
}

uint32_t wire_view(struct wire *wire, enum protocol_type type, uint32_t view)
{
    return wire_send(wire, &(struct protocol_message){.header.type = (uint16_t)type, .view = {.view = view}});
}

uint32_t wire_share(struct wire *wire, uint32_t view, bool shared)
{
    return wire_send(wire, &(struct protocol_message){.header.type = PROTOCOL_VIEW_SHARE,
                                                      .share = {.view = view, .shared = shared}});
}

uint32_t wire_ping(struct wire *wire)
{
    return wire_send(wire, &(struct protocol_message){.header.type = PROTOCOL_PING});
}

uint32_t wire_time(struct wire *wire, uint32_t view, double time)
{
    return wire_send(wire, &(struct protocol_message){.header.type = PROTOCOL_VIEW_TIME,
                                                      .time = {.view = view, .time = time}});
}

uint32_t wire_setting(struct wire *wire, uint32_t view, uint32_t setting, double value)
{
    return wire_send(
        wire, &(struct protocol_message){.header.type = PROTOCOL_VIEW_SETTING,
                                         .setting = {.view = view, .setting = setting, .value = value}});
}

uint32_t wire_render(struct wire *wire, uint32_t view, uint32_t channels)
{
    return wire_send(wire, &(struct protocol_message){.header.type = PROTOCOL_RENDER,
                                                      .render = {.view = view, .channels = channels}});
}

uint32_t wire_subscribe(struct wire *wire, uint32_t view, uint32_t channels, uint32_t credit)
{
    return wire_send(
        wire, &(struct protocol_message){.header.type = PROTOCOL_SUBSCRIBE,
                                         .render = {.view = view, .channels = channels, .credit = credit}});
}

uint32_t wire_credit(struct wire *wire, uint32_t view, uint32_t frames)
{
    return wire_send(wire, &(struct protocol_message){.header.type = PROTOCOL_CREDIT,
                                                      .credit = {.view = view, .frames = frames}});
}

uint32_t wire_new_view(struct wire *wire, uint32_t width, uint32_t height)
{
    return wire_expect_ok(wire, wire_create(wire, width, height));
}
