#include "client_internal.h"

#include <stdlib.h>
#include <string.h>

#include "transport.h"

#define RENDER_TIMEOUT_MS 600000u
#define LIVE_CREDIT       2u /* one frame on its way while another is looked at */

void client_frame_destroy(struct client_frame **frame)
{
    if (*frame) {
        for (uint32_t i = 0; i < PROTOCOL_MAX_CHANNELS; i++)
            free((*frame)->values[i]);
        free((*frame)->payload);
        free(*frame);
    }
    *frame = NULL;
}

/* ---- taking a frame in -------------------------------------------------------------------------------- */

/* Hands the frame over when it has all its channels; else makes room for the bytes of the next. */
static bool next_channel(struct client *client, struct client_frame **frame, struct error *error)
{
    struct frame_assembly *assembly = &client->assembly;
    assembly->received = 0;
    if (assembly->channel == assembly->frame->info.channel_count) {
        *frame = assembly->frame;
        assembly->frame = NULL;
        return true;
    }
    const struct protocol_channel *channel = &assembly->frame->info.channels[assembly->channel];
    assembly->frame->values[assembly->channel] =
        malloc((size_t)channel->width * channel->height * channel->components * sizeof(float));
    if (channel->bytes > assembly->bytes_size) {
        free(assembly->bytes);
        assembly->bytes = malloc(channel->bytes);
        assembly->bytes_size = assembly->bytes ? channel->bytes : 0;
    }
    if (!assembly->frame->values[assembly->channel] || !assembly->bytes)
        return error_set(error, STATUS_MEMORY, "no memory for a channel of %ux%u pixels", channel->width,
                         channel->height);
    return true;
}

bool client_frame_begin(struct client *client, struct client_frame **frame, struct error *error)
{
    struct frame_assembly *assembly = &client->assembly;
    const struct protocol_frame *info = &client->incoming.frame;
    if (assembly->frame)
        return error_set(error, STATUS_IO, "the server began a frame before the last one was complete");
    uint64_t bytes = 0;
    for (uint32_t i = 0; i < info->channel_count; i++) {
        const struct protocol_channel *channel = &info->channels[i];
        bytes += (uint64_t)channel->width * channel->height * channel->components * sizeof(float);
        if (channel->bytes == 0)
            return error_set(error, STATUS_IO, "the server sent a channel without bytes");
    }
    if (bytes > client->max_frame_bytes)
        return error_set(error, STATUS_LIMIT, "a frame of %llu bytes is more than the %llu this client takes",
                         (unsigned long long)bytes, (unsigned long long)client->max_frame_bytes);
    assembly->frame = calloc(1, sizeof *assembly->frame);
    if (!assembly->frame)
        return error_set(error, STATUS_MEMORY, "no memory for a frame");
    assembly->frame->info = *info;
    assembly->frame->request = client->incoming.header.request;
    assembly->frame->payload = client->payload; /* info's texts point into it */
    client->payload = NULL;
    client->payload_size = 0;
    assembly->channel = 0;
    return next_channel(client, frame, error);
}

bool client_frame_part(struct client *client, struct client_frame **frame, struct error *error)
{
    struct frame_assembly *assembly = &client->assembly;
    const struct protocol_part *part = &client->incoming.part;
    if (!assembly->frame || part->view != assembly->frame->info.view ||
        part->frame != assembly->frame->info.frame || part->channel != assembly->channel ||
        part->offset != assembly->received || client->incoming.header.request != assembly->frame->request)
        return error_set(error, STATUS_IO, "the server sent a part that does not continue its frame");
    const struct protocol_channel *channel = &assembly->frame->info.channels[assembly->channel];
    if (part->length > channel->bytes - assembly->received)
        return error_set(error, STATUS_IO, "the server sent more bytes than its channel has");
    memcpy(assembly->bytes + assembly->received, part->bytes, part->length);
    assembly->received += part->length;
    if (assembly->received < channel->bytes)
        return true;
    if (!tiles_decode(client->codec, channel, assembly->bytes, assembly->frame->values[assembly->channel],
                      error))
        return false;
    assembly->frame->received_bytes += channel->bytes;
    assembly->channel++;
    return next_channel(client, frame, error);
}

bool client_frame_queue(struct client *client, struct client_frame *frame, struct error *error)
{
    if (client->queue_count == CLIENT_MAX_QUEUED) {
        client_frame_destroy(&frame);
        return error_set(error, STATUS_IO, "the server sends more frames than it was given credit for");
    }
    client->queue[client->queue_count++] = frame;
    return true;
}

/* ---- lock-step ---------------------------------------------------------------------------------------- */

struct client_frame *client_render(struct client *client, uint32_t view,
                                   const struct client_render_params *params, struct error *error)
{
    struct protocol_message message = {.header.type = PROTOCOL_RENDER};
    message.render = (struct protocol_render){.view = view,
                                              .channels = params->channels,
                                              .format = (uint8_t)params->format,
                                              .encoding = (uint8_t)params->encoding};
    if (!client_send(client, &message, error))
        return NULL;
    int64_t deadline = transport_now_ms() + (params->timeout_ms ? params->timeout_ms : RENDER_TIMEOUT_MS);
    for (;;) {
        struct client_frame *frame;
        switch (client_receive(client, deadline, &frame, error)) {
        case CLIENT_EVENT_ERROR:
            return NULL;
        case CLIENT_EVENT_OTHER:
            break;
        case CLIENT_EVENT_FRAME:
            if (frame->request == message.header.request)
                return frame;
            if (!client_frame_queue(client, frame, error)) {
                client->is_over = true;
                return NULL;
            }
            break;
        case CLIENT_EVENT_REPLY:
            if (client->incoming.header.type == PROTOCOL_ERROR &&
                client->incoming.header.request == message.header.request) {
                char text[PROTOCOL_MAX_TEXT_BYTES + 1];
                protocol_text_copy(client->incoming.error.text, text, sizeof text);
                error_set(error, (enum status)client->incoming.error.status, "%s", text);
                return NULL;
            }
            client->is_over = true;
            error_set(error, STATUS_IO, "the server answered RENDER with no frame");
            return NULL;
        }
    }
}

/* ---- live --------------------------------------------------------------------------------------------- */

bool client_subscribe(struct client *client, uint32_t view, const struct client_render_params *params,
                      struct error *error)
{
    uint32_t slot = 0;
    while (slot < client->live_count && client->live[slot].view != view)
        slot++;
    if (slot == CLIENT_MAX_LIVE)
        return error_set(error, STATUS_LIMIT, "at most %u subscriptions at a time", CLIENT_MAX_LIVE);
    struct protocol_message message = {.header.type = PROTOCOL_SUBSCRIBE};
    message.render = (struct protocol_render){.view = view,
                                              .channels = params->channels,
                                              .format = (uint8_t)params->format,
                                              .encoding = (uint8_t)params->encoding,
                                              .credit = params->credit ? params->credit : LIVE_CREDIT};
    if (!client_request(client, &message, NULL, error))
        return false;
    client->live[slot] = (struct client_live){.view = view, .request = message.header.request};
    if (slot == client->live_count)
        client->live_count++;
    return true;
}

bool client_unsubscribe(struct client *client, uint32_t view, struct error *error)
{
    struct protocol_message message = {.header.type = PROTOCOL_UNSUBSCRIBE};
    message.view.view = view;
    if (!client_request(client, &message, NULL, error))
        return false;
    for (uint32_t i = 0; i < client->live_count; i++)
        if (client->live[i].view == view)
            client->live[i--] = client->live[--client->live_count];
    uint32_t kept = 0;
    for (uint32_t i = 0; i < client->queue_count; i++) {
        if (client->queue[i]->info.view == view)
            client_frame_destroy(&client->queue[i]);
        else
            client->queue[kept++] = client->queue[i];
    }
    client->queue_count = kept;
    return true;
}

/* Whether `frame` is of a subscription that still exists, whose next frame needs credit. */
static bool is_live(const struct client *client, const struct client_frame *frame)
{
    for (uint32_t i = 0; i < client->live_count; i++)
        if (client->live[i].request == frame->request)
            return true;
    return false;
}

struct client_frame *client_next_frame(struct client *client, uint32_t timeout_ms, struct error *error)
{
    struct client_frame *frame = NULL;
    int64_t deadline = transport_now_ms() + timeout_ms;
    while (!frame) {
        if (client->queue_count) {
            frame = client->queue[0];
            client->queue_count--;
            memmove(client->queue, client->queue + 1, client->queue_count * sizeof *client->queue);
            break;
        }
        if (client->has_notice) {
            client->has_notice = false;
            *error = client->notice;
            return NULL;
        }
        if (!client->is_over && !transport_wait(client->socket, deadline)) {
            error_set(error, STATUS_LIMIT, "no frame within %u ms", timeout_ms);
            return NULL;
        }
        switch (client_receive(client, deadline, &frame, error)) {
        case CLIENT_EVENT_ERROR:
            return NULL;
        case CLIENT_EVENT_REPLY:
            client->is_over = true;
            error_set(error, STATUS_IO, "the server sent a reply to no request");
            return NULL;
        case CLIENT_EVENT_FRAME:
        case CLIENT_EVENT_OTHER:
            break;
        }
    }
    if (is_live(client, frame)) {
        struct protocol_message message = {.header.type = PROTOCOL_CREDIT};
        message.credit = (struct protocol_credit){.view = frame->info.view, .frames = 1};
        /* A view that went meanwhile has no use for credit; its notice tells. A broken connection shows at
         * the next call: this frame is good. */
        struct error ignored;
        (void)client_request(client, &message, NULL, &ignored);
    }
    return frame;
}
