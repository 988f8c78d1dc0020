#include "frame.h"

#include <stdlib.h>
#include <string.h>

struct frame_encoder {
    struct tile_codec *tiles;
    struct protocol_message message;
};

struct frame_encoder *frame_encoder_create(struct error *error)
{
    struct frame_encoder *encoder = calloc(1, sizeof *encoder);
    if (!encoder) {
        error_set(error, STATUS_MEMORY, "out of memory for encoding frames");
        return NULL;
    }
    encoder->tiles = tile_codec_create(error);
    if (!encoder->tiles)
        frame_encoder_destroy(&encoder);
    return encoder;
}

void frame_encoder_destroy(struct frame_encoder **encoder)
{
    if (!*encoder)
        return;
    tile_codec_destroy(&(*encoder)->tiles);
    free(*encoder);
    *encoder = NULL;
}

_Static_assert(STAT_COUNT <= PROTOCOL_MAX_STATISTICS, "every statistic fits a FRAME");
_Static_assert(CHANNEL_COUNT <= PROTOCOL_MAX_CHANNELS, "every channel fits a FRAME");
_Static_assert(VIEW_MAX_PASSES <= PROTOCOL_MAX_PASSES, "every pass fits a FRAME");
_Static_assert(VIEW_MAX_PLAN_LINES <= PROTOCOL_MAX_PLAN_LINES, "the whole plan fits a FRAME");

static void describe(struct protocol_frame *target, const struct frame_result *result)
{
    target->frame = result->frame;
    target->time = result->time;
    memcpy(target->camera.eye, result->camera.eye, sizeof target->camera.eye);
    memcpy(target->camera.at, result->camera.at, sizeof target->camera.at);
    memcpy(target->camera.up, result->camera.up, sizeof target->camera.up);
    target->camera.fov = result->camera.fov;
    memcpy(target->world_to_camera, result->world_to_camera, sizeof target->world_to_camera);
    memcpy(target->camera_to_clip, result->camera_to_clip, sizeof target->camera_to_clip);
    target->black_reason = protocol_text_of(result->black_reason);
    target->pass_count = (uint16_t)result->pass_count;
    for (uint32_t i = 0; i < result->pass_count; i++)
        target->passes[i] = (struct protocol_pass){.name = protocol_text_of(result->passes[i].name),
                                                   .elapsed_ns = result->passes[i].elapsed_ns};
    target->statistic_count = STAT_COUNT;
    memcpy(target->statistics, result->stats, sizeof result->stats);
    target->plan_count = (uint16_t)result->plan_count;
    for (uint32_t i = 0; i < result->plan_count; i++)
        target->plan[i] = (struct protocol_plan_line){.name = protocol_text_of(result->plan[i].name),
                                                      .reason = protocol_text_of(result->plan[i].reason),
                                                      .is_used = result->plan[i].is_used};
}

static bool encode_channels(struct frame_encoder *encoder, struct frame *frame,
                            const struct frame_result *result, const struct frame_request *request,
                            struct error *error)
{
    struct protocol_frame *description = &encoder->message.frame;
    for (uint32_t i = 0; i < result->channel_count; i++) {
        const struct frame_channel *source = &result->channels[i];
        if (!(request->channels >> source->channel & 1))
            continue;
        struct protocol_channel *target = &description->channels[frame->channel_count];
        const uint8_t *bytes;
        if (!tiles_encode(encoder->tiles, source->values, source->width, source->height, source->components,
                          request->format, request->encoding, target, &bytes, error))
            return false;
        target->channel = (uint8_t)source->channel;
        uint8_t *copy = malloc(target->bytes ? target->bytes : 1);
        if (!copy)
            return error_set(error, STATUS_MEMORY, "out of memory for a frame");
        memcpy(copy, bytes, target->bytes);
        frame->channels[frame->channel_count].bytes = copy;
        frame->channels[frame->channel_count].size = target->bytes;
        frame->bytes += target->bytes;
        frame->channel_count++;
    }
    description->channel_count = (uint16_t)frame->channel_count;
    return true;
}

struct frame *frame_encode(struct frame_encoder *encoder, const struct frame_result *result, uint32_t view,
                           uint32_t update_sequence, const struct frame_request *request, struct error *error)
{
    struct frame *frame = calloc(1, sizeof *frame);
    if (!frame) {
        error_set(error, STATUS_MEMORY, "out of memory for a frame");
        return NULL;
    }
    frame->references = 1;
    frame->view = view;
    frame->number = result->frame;
    encoder->message.header = (struct protocol_header){.type = PROTOCOL_FRAME};
    encoder->message.frame.view = view;
    encoder->message.frame.update_sequence = update_sequence;
    encoder->message.frame.dropped = 0;
    describe(&encoder->message.frame, result);
    size_t size = 0;
    if (encode_channels(encoder, frame, result, request, error))
        size = protocol_encode(&encoder->message, NULL, 0, error);
    frame->description = size ? malloc(size) : NULL;
    if (size && !frame->description)
        error_set(error, STATUS_MEMORY, "out of memory for a frame");
    if (!frame->description) {
        frame_release(&frame);
        return NULL;
    }
    frame->description_bytes = protocol_encode(&encoder->message, frame->description, size, error);
    frame->bytes += frame->description_bytes;
    return frame;
}

struct frame *frame_reference(struct frame *frame)
{
    frame->references++;
    return frame;
}

void frame_release(struct frame **frame)
{
    if (*frame && --(*frame)->references == 0) {
        for (uint32_t i = 0; i < (*frame)->channel_count; i++)
            free((*frame)->channels[i].bytes);
        free((*frame)->description);
        free(*frame);
    }
    *frame = NULL;
}
