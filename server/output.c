#include "server.h"

#include <stdlib.h>
#include <string.h>

#define SEQUENCE_OFFSET 12u /* in a message header */

_Static_assert(NETWORK_MAX_WRITE >= PROTOCOL_HEADER_BYTES + PROTOCOL_MAX_HELLO_BYTES,
               "the scratch holds a HELLO");
_Static_assert(NETWORK_MAX_WRITE >= PROTOCOL_HEADER_BYTES + PROTOCOL_MAX_PART_BYTES + 64, "and a PART");

void output_init(struct output *output)
{
    *output = (struct output){0};
    output->end = &output->first;
}

static void pop(struct output *output)
{
    struct output_item *item = output->first;
    output->first = item->next;
    if (!output->first)
        output->end = &output->first;
    output->bytes -= sizeof *item + item->bytes;
    frame_release(&item->frame);
    free(item);
}

void output_clear(struct output *output)
{
    while (output->first)
        pop(output);
}

static struct output_item *push(struct session *session, size_t bytes, size_t message_bytes)
{
    struct output_item *item = malloc(sizeof *item + message_bytes);
    if (!item) {
        connection_abort(session->connection);
        return NULL;
    }
    *item = (struct output_item){.bytes = bytes};
    *session->output.end = item;
    session->output.end = &item->next;
    session->output.bytes += sizeof *item + bytes;
    connection_want_output(session->connection);
    return item;
}

void output_message(struct session *session, const uint8_t *bytes, size_t size)
{
    struct output_item *item = push(session, size, size);
    if (item)
        memcpy(item->message, bytes, size);
}

void output_frame(struct session *session, struct frame *frame, uint32_t request, uint32_t dropped,
                  struct subscription *subscription)
{
    struct output_item *item = push(session, frame->bytes, 0);
    if (!item)
        return;
    item->frame = frame_reference(frame);
    item->request = request;
    item->dropped = dropped;
    item->subscription = subscription;
}

static void set_sequence(struct output *output, uint8_t *message)
{
    uint32_t sequence = output->sequence++;
    for (unsigned i = 0; i < 4; i++)
        message[SEQUENCE_OFFSET + i] = (uint8_t)(sequence >> 8 * i);
}

/* As many waiting messages as fit: one write for a burst of replies. */
static size_t take_messages(struct session *session, uint8_t *bytes)
{
    struct output *output = &session->output;
    size_t size = 0;
    while (output->first && !output->first->frame && size + output->first->bytes <= NETWORK_MAX_WRITE) {
        memcpy(bytes + size, output->first->message, output->first->bytes);
        set_sequence(output, bytes + size);
        size += output->first->bytes;
        pop(output);
    }
    return size;
}

static size_t take_description(struct session *session, uint8_t *bytes)
{
    struct output *output = &session->output;
    struct output_item *item = output->first;
    struct protocol_message *message = &session->server->outgoing;
    struct error error;
    const uint8_t *description = item->frame->description;
    size_t size = 0;
    if (protocol_header_read(description, PROTOCOL_SERVER, &message->header, &error)) {
        struct protocol_header header = message->header;
        if (protocol_decode(&header, description + PROTOCOL_HEADER_BYTES, message, &error)) {
            message->header.request = item->request;
            message->header.sequence = output->sequence;
            message->frame.dropped = item->dropped;
            size = protocol_encode(message, bytes, NETWORK_MAX_WRITE, &error);
        }
    }
    if (!size) {
        log_line(LOG_LEVEL_ERROR, "a frame cannot be described: %s", error.message);
        connection_abort(session->connection);
        return 0;
    }
    output->sequence++;
    output->has_described = true;
    output->channel = output->offset = 0;
    return size;
}

static size_t take_part(struct session *session, uint8_t *bytes)
{
    struct output *output = &session->output;
    const struct frame *frame = output->first->frame;
    uint32_t left = frame->channels[output->channel].size - output->offset;
    uint32_t length = left < PROTOCOL_MAX_PART_BYTES ? left : PROTOCOL_MAX_PART_BYTES;
    struct protocol_message *message = &session->server->outgoing;
    message->header = (struct protocol_header){
        .type = PROTOCOL_PART, .request = output->first->request, .sequence = output->sequence};
    message->part = (struct protocol_part){.view = frame->view,
                                           .frame = frame->number,
                                           .channel = output->channel,
                                           .offset = output->offset,
                                           .bytes = frame->channels[output->channel].bytes + output->offset,
                                           .length = length};
    struct error error;
    size_t size = protocol_encode(message, bytes, NETWORK_MAX_WRITE, &error);
    if (!size) {
        log_line(LOG_LEVEL_ERROR, "a part of a frame cannot be sent: %s", error.message);
        connection_abort(session->connection);
        return 0;
    }
    output->sequence++;
    output->offset += length;
    return size;
}

/* The next channel that has bytes left; false: the frame is out. */
static bool find_part(struct output *output)
{
    const struct frame *frame = output->first->frame;
    while (output->channel < frame->channel_count &&
           output->offset == frame->channels[output->channel].size) {
        output->channel++;
        output->offset = 0;
    }
    return output->channel < frame->channel_count;
}

/* Room has come: what was held back for lack of it goes on. */
static void go_on(struct session *session)
{
    for (struct subscription *subscription = session->subscriptions; subscription;
         subscription = subscription->next_of_session)
        subscription_pump(subscription);
    session_resume(session);
    views_schedule(session->server);
}

static void finish_frame(struct session *session)
{
    struct subscription *subscription = session->output.first->subscription;
    pop(&session->output);
    session->output.has_described = false;
    if (subscription) {
        subscription->is_sending = false;
        go_on(session);
    }
}

static size_t take(struct session *session, uint8_t *bytes)
{
    struct output *output = &session->output;
    while (output->first) {
        if (!output->first->frame)
            return take_messages(session, bytes);
        if (!output->has_described)
            return take_description(session, bytes);
        if (find_part(output))
            return take_part(session, bytes);
        finish_frame(session);
    }
    return 0;
}

size_t output_next(struct session *session, const uint8_t **bytes)
{
    *bytes = session->server->bytes;
    bool was_full = session_is_full(session);
    size_t size = take(session, session->server->bytes);
    if (was_full && !session_is_full(session))
        go_on(session);
    return size;
}
