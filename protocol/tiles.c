#include "tiles.h"

#include <stdlib.h>
#include <string.h>
#include <zstd.h>

#define ZSTD_LEVEL 1

struct tile_codec {
    ZSTD_CCtx *compress;
    ZSTD_DCtx *decompress;
    uint8_t *samples; /* samples of the image in the wire format, in tile order when compressed */
    size_t samples_size;
    uint8_t *output;
    size_t output_size;
};

uint16_t half_from_float(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    uint32_t sign = bits >> 16 & 0x8000u, magnitude = bits & 0x7fffffffu;
    if (magnitude > 0x7f800000u)
        return 0x7e00u;
    if (magnitude == 0x7f800000u)
        return (uint16_t)(sign | 0x7c00u);
    if (magnitude >= 0x477ff000u) /* 65520 and above would round to infinity */
        return (uint16_t)(sign | 0x7bffu);
    if (magnitude < 0x38800000u) {
        /* Below 2^-14 halves are multiples of 2^-24: adding 0.5 puts the float's last place exactly there, so
         * that its own rounding, to nearest even, is the one wanted. */
        float shifted;
        memcpy(&shifted, &magnitude, sizeof shifted);
        shifted += 0.5f;
        memcpy(&bits, &shifted, sizeof bits);
        return (uint16_t)(sign | (bits - 0x3f000000u));
    }
    magnitude +=
        0xc8000fffu + (magnitude >> 13 & 1u); /* exponent bias 127 to 15, then half a unit, ties to even */
    return (uint16_t)(sign | magnitude >> 13);
}

float half_to_float(uint16_t half)
{
    uint32_t sign = (uint32_t)(half & 0x8000u) << 16, magnitude = half & 0x7fffu, bits;
    float value;
    if (magnitude >= 0x7c00u) {
        bits = sign | 0x7f800000u | (magnitude & 0x3ffu) << 13;
    } else if (magnitude >= 0x400u) {
        bits = sign | ((magnitude << 13) + 0x38000000u);
    } else {
        value = (float)magnitude * 0x1p-24f;
        memcpy(&bits, &value, sizeof bits);
        bits |= sign;
    }
    memcpy(&value, &bits, sizeof value);
    return value;
}

struct tile_codec *tile_codec_create(struct error *error)
{
    struct tile_codec *codec = calloc(1, sizeof *codec);
    if (codec) {
        codec->compress = ZSTD_createCCtx();
        codec->decompress = ZSTD_createDCtx();
    }
    if (!codec || !codec->compress || !codec->decompress) {
        error_set(error, STATUS_MEMORY, "no memory for the image codec");
        tile_codec_destroy(&codec);
        return NULL;
    }
    ZSTD_CCtx_setParameter(codec->compress, ZSTD_c_compressionLevel, ZSTD_LEVEL);
    return codec;
}

void tile_codec_destroy(struct tile_codec **codec)
{
    if (*codec) {
        ZSTD_freeCCtx((*codec)->compress);
        ZSTD_freeDCtx((*codec)->decompress);
        free((*codec)->samples);
        free((*codec)->output);
        free(*codec);
    }
    *codec = NULL;
}

static bool reserve(uint8_t **bytes, size_t *size, size_t wanted, struct error *error)
{
    if (wanted <= *size)
        return true;
    uint8_t *grown = realloc(*bytes, wanted);
    if (!grown)
        return error_set(error, STATUS_MEMORY, "no memory for an image of %zu bytes", wanted);
    *bytes = grown;
    *size = wanted;
    return true;
}

/* Converts `count` floats to the wire format and counts what the format could not say. */
static void pack(const float *values, size_t count, enum protocol_format format, uint8_t *target,
                 struct protocol_channel *channel)
{
    uint32_t not_a_number = 0, clamped = 0;
    for (size_t i = 0; i < count; i++)
        not_a_number += values[i] != values[i];
    if (format == PROTOCOL_F16) {
        for (size_t i = 0; i < count; i++) {
            uint16_t half = half_from_float(values[i]);
            memcpy(target + i * 2, &half, 2);
            uint32_t bits;
            memcpy(&bits, &values[i], sizeof bits);
            bits &= 0x7fffffffu;
            clamped += bits > 0x477fe000u && bits < 0x7f800000u;
        }
    } else {
        memcpy(target, values, count * 4);
    }
    channel->not_a_number += not_a_number;
    channel->clamped += clamped;
}

static bool is_zero(const uint8_t *bytes, size_t size)
{
    uint64_t any = 0, word;
    size_t at = 0;
    for (; at + 8 <= size; at += 8) {
        memcpy(&word, bytes + at, 8);
        any |= word;
    }
    for (; at < size; at++)
        any |= bytes[at];
    return any == 0;
}

static uint32_t smaller(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

static bool description_fits(const struct protocol_channel *channel, struct error *error)
{
    if (channel->width < 1 || channel->width > PROTOCOL_MAX_IMAGE_SIZE || channel->height < 1 ||
        channel->height > PROTOCOL_MAX_IMAGE_SIZE || channel->components < 1 || channel->components > 4 ||
        channel->format >= PROTOCOL_FORMAT_COUNT || channel->encoding >= PROTOCOL_ENCODING_COUNT)
        return error_set(
            error, STATUS_INVALID, "no image has %ux%u pixels, %u components, format %u and encoding %u",
            channel->width, channel->height, channel->components, channel->format, channel->encoding);
    return true;
}

bool tiles_encode(struct tile_codec *codec, const float *values, uint32_t width, uint32_t height,
                  uint32_t components, enum protocol_format format, enum protocol_encoding encoding,
                  struct protocol_channel *channel, const uint8_t **bytes, struct error *error)
{
    channel->format = (uint8_t)format;
    channel->encoding = (uint8_t)encoding;
    channel->components = (uint8_t)(components <= 4 ? components : 0);
    channel->width = width;
    channel->height = height;
    channel->clamped = channel->not_a_number = 0;
    if (!description_fits(channel, error))
        return false;

    size_t sample_bytes = format == PROTOCOL_F16 ? 2 : 4;
    size_t total = (size_t)width * height * components * sample_bytes;
    if (total > UINT32_MAX / 2)
        return error_set(error, STATUS_LIMIT, "an image of %ux%u pixels is too large to send", width, height);
    if (!reserve(&codec->samples, &codec->samples_size, total, error))
        return false;
    if (encoding == PROTOCOL_RAW) {
        pack(values, (size_t)width * height * components, format, codec->samples, channel);
        channel->bytes = (uint32_t)total;
        *bytes = codec->samples;
        return true;
    }

    uint32_t columns = (width + TILE_SIZE - 1) / TILE_SIZE, rows = (height + TILE_SIZE - 1) / TILE_SIZE;
    size_t map_bytes = ((size_t)columns * rows + 7) / 8;
    if (!reserve(&codec->output, &codec->output_size, map_bytes + ZSTD_compressBound(total), error))
        return false;
    memset(codec->output, 0, map_bytes);
    size_t used = 0;
    for (uint32_t tile_y = 0, tile = 0; tile_y < rows; tile_y++) {
        for (uint32_t tile_x = 0; tile_x < columns; tile_x++, tile++) {
            uint32_t x = tile_x * TILE_SIZE, y = tile_y * TILE_SIZE;
            uint32_t tile_width = smaller(TILE_SIZE, width - x), tile_height = smaller(TILE_SIZE, height - y);
            size_t row = (size_t)tile_width * components;
            uint8_t *target = codec->samples + used;
            for (uint32_t line = 0; line < tile_height; line++)
                pack(values + ((size_t)(y + line) * width + x) * components, row, format,
                     target + line * row * sample_bytes, channel);
            size_t size = row * tile_height * sample_bytes;
            if (is_zero(target, size))
                continue;
            codec->output[tile / 8] |= (uint8_t)(1u << tile % 8);
            used += size;
        }
    }
    size_t compressed = 0;
    if (used) {
        compressed = ZSTD_compress2(codec->compress, codec->output + map_bytes,
                                    codec->output_size - map_bytes, codec->samples, used);
        if (ZSTD_isError(compressed))
            return error_set(error, STATUS_MEMORY, "zstd: %s", ZSTD_getErrorName(compressed));
    }
    channel->bytes = (uint32_t)(map_bytes + compressed);
    *bytes = codec->output;
    return true;
}

static void unpack(const uint8_t *samples, size_t count, enum protocol_format format, float *values)
{
    if (format == PROTOCOL_F32) {
        memcpy(values, samples, count * 4);
        return;
    }
    for (size_t i = 0; i < count; i++) {
        uint16_t half;
        memcpy(&half, samples + i * 2, 2);
        values[i] = half_to_float(half);
    }
}

bool tiles_decode(struct tile_codec *codec, const struct protocol_channel *channel, const uint8_t *bytes,
                  float *values, struct error *error)
{
    if (!description_fits(channel, error))
        return false;
    uint32_t width = channel->width, height = channel->height, components = channel->components;
    enum protocol_format format = (enum protocol_format)channel->format;
    size_t sample_bytes = format == PROTOCOL_F16 ? 2 : 4;
    size_t total = (size_t)width * height * components * sample_bytes;
    if (channel->encoding == PROTOCOL_RAW) {
        if (channel->bytes != total)
            return error_set(error, STATUS_INVALID, "image: %u bytes where %zu belong", channel->bytes,
                             total);
        unpack(bytes, (size_t)width * height * components, format, values);
        return true;
    }

    uint32_t columns = (width + TILE_SIZE - 1) / TILE_SIZE, rows = (height + TILE_SIZE - 1) / TILE_SIZE;
    uint32_t tiles = columns * rows;
    size_t map_bytes = ((size_t)tiles + 7) / 8;
    if (channel->bytes < map_bytes)
        return error_set(error, STATUS_INVALID, "image: %u bytes are too few for the map of %u tiles",
                         channel->bytes, tiles);
    if (tiles % 8 && bytes[map_bytes - 1] >> tiles % 8)
        return error_set(error, STATUS_INVALID, "image: the tile map has bits past its last tile");
    size_t used = 0;
    for (uint32_t tile = 0; tile < tiles; tile++) {
        if (!(bytes[tile / 8] >> tile % 8 & 1))
            continue;
        uint32_t x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
        used += (size_t)smaller(TILE_SIZE, width - x) * smaller(TILE_SIZE, height - y) * components *
                sample_bytes;
    }
    const uint8_t *packed = bytes + map_bytes;
    size_t packed_bytes = channel->bytes - map_bytes;
    if (used == 0) {
        if (packed_bytes)
            return error_set(error, STATUS_INVALID, "image: bytes follow an empty tile map");
    } else {
        if (ZSTD_getFrameContentSize(packed, packed_bytes) != used ||
            ZSTD_findFrameCompressedSize(packed, packed_bytes) != packed_bytes)
            return error_set(error, STATUS_INVALID, "image: the zstd frame does not hold %zu bytes", used);
        if (!reserve(&codec->samples, &codec->samples_size, total, error))
            return false;
        size_t size = ZSTD_decompressDCtx(codec->decompress, codec->samples, used, packed, packed_bytes);
        if (size != used)
            return error_set(error, STATUS_INVALID, "image: zstd: %s",
                             ZSTD_isError(size) ? ZSTD_getErrorName(size) : "too few bytes");
    }
    size_t at = 0;
    for (uint32_t tile = 0; tile < tiles; tile++) {
        uint32_t x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
        uint32_t tile_height = smaller(TILE_SIZE, height - y);
        size_t row = (size_t)smaller(TILE_SIZE, width - x) * components;
        bool is_present = bytes[tile / 8] >> tile % 8 & 1;
        for (uint32_t line = 0; line < tile_height; line++) {
            float *target = values + ((size_t)(y + line) * width + x) * components;
            if (is_present) {
                unpack(codec->samples + at, row, format, target);
                at += row * sample_bytes;
            } else {
                memset(target, 0, row * sizeof *target);
            }
        }
    }
    return true;
}
