/* frame.h: a rendered frame as it goes over the wire, made once and sent to any number of clients.
 *
 * Made by the render thread, from then on used by the network thread alone: the reference count is not
 * atomic.
 */
#ifndef CAUSTICD_FRAME_H
#define CAUSTICD_FRAME_H

#include "core/render/renderer.h"
#include "protocol/protocol.h"
#include "protocol/tiles.h"

/* What one kind of recipient wants of a frame. */
struct frame_request {
    uint32_t channels; /* bits 1 << enum channel */
    enum protocol_format format;
    enum protocol_encoding encoding;
};

struct frame {
    unsigned references;
    uint32_t view;
    uint64_t number;
    uint8_t *description; /* an encoded FRAME message whose request, sequence and dropped are set when it is
                             sent */
    size_t description_bytes;
    uint32_t channel_count;
    struct {
        uint8_t *bytes;
        uint32_t size;
    } channels[CHANNEL_COUNT];
    size_t bytes; /* of all the above */
};

/* Holds scratch memory and compression state; one thread at a time. */
struct frame_encoder;

struct frame_encoder *frame_encoder_create(struct error *error);
void frame_encoder_destroy(struct frame_encoder **encoder);

/* The requested channels of `result`, with one reference. */
struct frame *frame_encode(struct frame_encoder *encoder, const struct frame_result *result, uint32_t view,
                           uint32_t update_sequence, const struct frame_request *request,
                           struct error *error);

struct frame *frame_reference(struct frame *frame);
void frame_release(struct frame **frame); /* accepts a NULL pointee */

#endif
