/* wire.h: a bare connection for tests: single messages and raw bytes, where a client library would be too
 * polite.
 *
 * Every wait is bounded; what fails here fails the running cmocka test.
 */
#ifndef TEST_WIRE_H
#define TEST_WIRE_H

#include "protocol/protocol.h"

struct wire {
    int fd;
    uint32_t sequence, received;     /* messages sent, and received */
    struct protocol_message message; /* the last one received; its texts point into `payload` */
    uint8_t payload[PROTOCOL_MAX_HELLO_BYTES + 4096];
};

/* Connects to "tcp:HOST:PORT" or "unix:PATH"; free with wire_close. Says nothing. */
struct wire *wire_connect(const char *address);
/* Also takes HELLO and answers with a CHOOSE of every feature. */
struct wire *wire_open(const char *address);
void wire_close(struct wire **wire);

void wire_send_bytes(struct wire *wire, const void *bytes, size_t size);
/* Encodes and sends; header.sequence is set to the next one, header.request to the same unless it is set.
 * Returns the request. */
uint32_t wire_send(struct wire *wire, struct protocol_message *message);
/* The next message; asserts that the server's sequence counts on. */
const struct protocol_message *wire_receive(struct wire *wire);
/* True when nothing comes within `seconds`. */
bool wire_is_silent(struct wire *wire, double seconds);
/* Asserts that the server closes the connection within `seconds`, with nothing more to read. */
void wire_expect_end(struct wire *wire, double seconds);

/* The next message must be OK or ERROR to `request`. Returns OK's value. */
uint32_t wire_expect_ok(struct wire *wire, uint32_t request);
/* Returns the text; it stays until the next message. */
const char *wire_expect_error(struct wire *wire, uint32_t request, enum status status);
const char *wire_expect_notice(struct wire *wire, enum protocol_notice_kind kind, enum status status);

/* What a FRAME and its parts were. */
struct wire_frame {
    uint32_t view, request, update_sequence, dropped;
    uint64_t number;
    uint64_t bytes; /* of all channels */
    uint64_t hash;  /* of these bytes */
};
/* Takes a FRAME, the current message, and its PARTs, checking that they have no gaps. */
struct wire_frame wire_take_frame(struct wire *wire);
/* Receives the frame that answers `request`. */
struct wire_frame wire_expect_frame(struct wire *wire, uint32_t request);

/* Requests that tests need all the time; each returns its request and waits for nothing. */
uint32_t wire_create(struct wire *wire, uint32_t width, uint32_t height);
uint32_t wire_view(struct wire *wire, enum protocol_type type,
                   uint32_t view); /* DESTROY, RESET, UNSUBSCRIBE */
uint32_t wire_share(struct wire *wire, uint32_t view, bool shared);
uint32_t wire_ping(struct wire *wire);
uint32_t wire_time(struct wire *wire, uint32_t view, double time);
uint32_t wire_setting(struct wire *wire, uint32_t view, uint32_t setting, double value);
uint32_t wire_render(struct wire *wire, uint32_t view, uint32_t channels);
uint32_t wire_subscribe(struct wire *wire, uint32_t view, uint32_t channels, uint32_t credit);
uint32_t wire_credit(struct wire *wire, uint32_t view, uint32_t frames);
/* Creates a view and waits for its id. */
uint32_t wire_new_view(struct wire *wire, uint32_t width, uint32_t height);

#endif
