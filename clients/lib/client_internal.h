/* client_internal.h: what client.c (requests) and client_frames.c (frames) share. */
#ifndef CAUSTIC_CLIENT_INTERNAL_H
#define CAUSTIC_CLIENT_INTERNAL_H

#include "../../protocol/tiles.h"
#include "client.h"

#define CLIENT_MAX_QUEUED 64u /* frames of live subscriptions that wait to be taken */
#define CLIENT_MAX_LIVE   64u

/* A frame on its way in. */
struct frame_assembly {
    struct client_frame *frame; /* NULL: none */
    uint8_t *bytes;             /* of the channel being received */
    size_t bytes_size;
    uint32_t channel, received;
};

struct client_live {
    uint32_t view, request;
};

struct client {
    int socket;
    bool is_over;
    uint32_t timeout_ms, request, sequence;
    uint64_t max_frame_bytes;
    uint8_t *hello_payload, *payload;
    size_t payload_size;
    struct protocol_hello hello;
    struct protocol_message incoming;
    struct tile_codec *codec;
    struct frame_assembly assembly;
    struct client_frame *queue[CLIENT_MAX_QUEUED];
    uint32_t queue_count;
    struct client_live live[CLIENT_MAX_LIVE];
    uint32_t live_count;
    bool has_notice; /* a subscription ended; told by the next client_next_frame */
    struct error notice;
};

/* Fills header.request and sequence and sends. `message` may be client->incoming's neighbour, not itself. */
bool client_send(struct client *client, struct protocol_message *message, struct error *error);

enum client_event { CLIENT_EVENT_ERROR, CLIENT_EVENT_REPLY, CLIENT_EVENT_FRAME, CLIENT_EVENT_OTHER };

/* Takes one message in. REPLY: an OK or ERROR lies in client->incoming. FRAME: *frame is complete. OTHER: a
 * part, or a notice that is kept. ERROR: the connection is over. */
enum client_event client_receive(struct client *client, int64_t deadline_ms, struct client_frame **frame,
                                 struct error *error);

/* Sends a request and waits for its OK. */
bool client_request(struct client *client, struct protocol_message *message, uint32_t *value,
                    struct error *error);

/* One FRAME or PART in client->incoming; *frame when it is the last one. */
bool client_frame_begin(struct client *client, struct client_frame **frame, struct error *error);
bool client_frame_part(struct client *client, struct client_frame **frame, struct error *error);
/* Keeps a frame of a live subscription until it is taken. */
bool client_frame_queue(struct client *client, struct client_frame *frame, struct error *error);

#endif
