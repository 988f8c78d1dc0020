/* fake_peer.h: a server of the protocol that renders nothing: the client library and its programs against
 * known pixels.
 *
 * One thread, one connection. It speaks protocol.h honestly, except for what `fault` asks for.
 *   scene     "fake": a light "lamp.one", a camera "main"
 *   settings  photons (int, 1 to 1000000, 100), gain (float, 0 to 10, 1), aa (choice filter,none,pixel),
 * jitter (bool), seed (int) channels  beauty (3), depth (1), density (1, 20x12) pixels    fake_peer_value
 */
#ifndef TEST_FAKE_PEER_H
#define TEST_FAKE_PEER_H

#include "protocol/protocol.h"

enum fake_fault {
    FAKE_HONEST,
    FAKE_WRONG_MAGIC,       /* HELLO is something else */
    FAKE_WRONG_VERSION,     /* HELLO of protocol 2.0 */
    FAKE_REFUSES,           /* NOTICE instead of HELLO */
    FAKE_SILENT,            /* never says anything */
    FAKE_CLOSES_IN_FRAME,   /* closes after half of a frame's bytes */
    FAKE_PART_OUT_OF_ORDER, /* the second part comes first */
    FAKE_PART_TOO_LONG,     /* more bytes than the channel has */
    FAKE_HUGE_FRAME,        /* a FRAME that announces 16384x16384 pixels */
    FAKE_REPLIES_TWICE,
    FAKE_LIVE_ENDS, /* a live subscription ends after its first frame */
};

struct fake_peer;

/* Serves one connection: `socket` when it is not -1, else the first that comes to "unix:PATH". */
struct fake_peer *fake_peer_start(int socket, const char *path, enum fake_fault fault);
/* Waits for the connection's end. Returns the requests it took. */
uint32_t fake_peer_stop(struct fake_peer **peer);

/* Component `c` of pixel (x, y) of a channel in frame `frame`: exact in half precision, 0 in whole tiles. */
float fake_peer_value(uint32_t channel, uint64_t frame, uint32_t x, uint32_t y, uint32_t c);

#endif
