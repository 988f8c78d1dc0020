/* Takes a stream of messages apart as server and client do, and an image as a client does.
 *
 * The first byte says how to read the rest: 0 as what a client sends, 1 as what a server sends, 2 as an
 * image, whose width, height, components, format and encoding are the next five bytes. Whatever is accepted
 * must be encoded back into the same bytes. */
#include <stdlib.h>
#include <string.h>

#include "protocol/tiles.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void take_stream(enum protocol_side from, const uint8_t *data, size_t size)
{
    static struct protocol_message message;
    static uint8_t again[PROTOCOL_HEADER_BYTES + PROTOCOL_MAX_PART_BYTES + 64];
    struct protocol_header header;
    struct error error;
    while (size >= PROTOCOL_HEADER_BYTES && protocol_header_read(data, from, &header, &error)) {
        if (header.length > size - PROTOCOL_HEADER_BYTES)
            return;
        size_t whole = PROTOCOL_HEADER_BYTES + header.length;
        if (protocol_decode(&header, data + PROTOCOL_HEADER_BYTES, &message, &error) &&
            (protocol_encode(&message, again, sizeof again, &error) != whole ||
             memcmp(again, data, whole) != 0))
            abort();
        data += whole;
        size -= whole;
    }
}

static void take_image(const uint8_t *data, size_t size)
{
    struct error error;
    if (size < 5)
        return;
    struct protocol_channel channel = {.width = data[0],
                                       .height = data[1],
                                       .components = data[2],
                                       .format = data[3],
                                       .encoding = data[4],
                                       .bytes = (uint32_t)size - 5};
    size_t count = (size_t)channel.width * channel.height * channel.components;
    struct tile_codec *codec = tile_codec_create(&error);
    float *values = malloc(count * sizeof *values + 1);
    uint8_t *bytes = malloc(size - 4); /* ends where the image ends, so that a read past it is seen */
    if (codec && values && bytes) {
        memcpy(bytes, data + 5, size - 5);
        tiles_decode(codec, &channel, bytes, values, &error);
    }
    free(bytes);
    free(values);
    tile_codec_destroy(&codec);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size == 0)
        return 0;
    if (data[0] == 2)
        take_image(data + 1, size - 1);
    else
        take_stream(data[0] == 1 ? PROTOCOL_SERVER : PROTOCOL_CLIENT, data + 1, size - 1);
    return 0;
}
