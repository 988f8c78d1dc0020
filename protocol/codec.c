#include "codec.h"

#include <math.h>
#include <string.h>

#if !defined(__BYTE_ORDER__) || __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the codec copies little-endian numbers as they are"
#endif

void codec_fail(struct codec *codec, const char *field, const char *text)
{
    if (codec->failed)
        return;
    codec->failed = true;
    if (codec->list)
        error_set(codec->error, STATUS_INVALID, "%s: %s[%u].%s %s", codec->message, codec->list, codec->index,
                  field, text);
    else
        error_set(codec->error, STATUS_INVALID, "%s: %s %s", codec->message, field, text);
}

void codec_check(struct codec *codec, bool condition, const char *field, const char *text)
{
    if (!condition)
        codec_fail(codec, field, text);
}

/* The one place that moves bytes: everything else goes through its bounds check. */
static void codec_move(struct codec *codec, const char *field, void *value, size_t bytes)
{
    if (!codec->failed && (codec->decoding || codec->write) && bytes > codec->size - codec->at)
        codec_fail(codec, field,
                   codec->decoding ? "is cut off by the end of the payload" : "does not fit the buffer");
    if (codec->failed) {
        if (codec->decoding)
            memset(value, 0, bytes);
        return;
    }
    if (codec->decoding)
        memcpy(value, codec->read + codec->at, bytes);
    else if (codec->write)
        memcpy(codec->write + codec->at, value, bytes);
    codec->at += bytes;
}

void codec_u8(struct codec *codec, const char *field, uint8_t *value)
{
    codec_move(codec, field, value, sizeof *value);
}

void codec_u16(struct codec *codec, const char *field, uint16_t *value)
{
    codec_move(codec, field, value, sizeof *value);
}

void codec_u32(struct codec *codec, const char *field, uint32_t *value)
{
    codec_move(codec, field, value, sizeof *value);
}

void codec_u64(struct codec *codec, const char *field, uint64_t *value)
{
    codec_move(codec, field, value, sizeof *value);
}

void codec_bool(struct codec *codec, const char *field, bool *value)
{
    uint8_t byte = codec->decoding ? 0 : *value;
    codec_move(codec, field, &byte, 1);
    codec_check(codec, byte <= 1, field, "must be 0 or 1");
    if (codec->decoding)
        *value = byte == 1;
}

void codec_enum(struct codec *codec, const char *field, uint8_t *value, uint8_t count)
{
    codec_u8(codec, field, value);
    codec_check(codec, *value < count, field, "is none of the values it may have");
}

void codec_f32_any(struct codec *codec, const char *field, float *values, size_t count)
{
    codec_move(codec, field, values, count * sizeof *values);
}

void codec_f64_any(struct codec *codec, const char *field, double *values, size_t count)
{
    codec_move(codec, field, values, count * sizeof *values);
}

void codec_f32(struct codec *codec, const char *field, float *values, size_t count)
{
    codec_f32_any(codec, field, values, count);
    for (size_t i = 0; i < count; i++)
        codec_check(codec, isfinite(values[i]), field, "must be finite");
}

void codec_f64(struct codec *codec, const char *field, double *value)
{
    codec_f64_any(codec, field, value, 1);
    codec_check(codec, isfinite(*value), field, "must be finite");
}

/* Well-formed UTF-8 (RFC 3629: no overlong forms, no surrogates) without zeros. */
static bool is_text(const uint8_t *bytes, size_t length)
{
    size_t at = 0;
    while (at < length) {
        uint8_t lead = bytes[at++];
        if (lead == 0)
            return false;
        if (lead < 0x80)
            continue;
        uint32_t more = lead >= 0xf0 ? 3 : lead >= 0xe0 ? 2 : 1;
        if (lead < 0xc2 || lead > 0xf4 || more > length - at)
            return false;
        uint32_t code = lead & (0x3fu >> more);
        for (uint32_t i = 0; i < more; i++, at++) {
            if ((bytes[at] & 0xc0) != 0x80)
                return false;
            code = code << 6 | (bytes[at] & 0x3fu);
        }
        static const uint32_t smallest[] = {0, 0x80, 0x800, 0x10000};
        if (code < smallest[more] || code > 0x10ffff || (code >= 0xd800 && code < 0xe000))
            return false;
    }
    return true;
}

void codec_text(struct codec *codec, const char *field, struct protocol_text *text)
{
    codec_u16(codec, field, &text->length);
    codec_check(codec, text->length <= PROTOCOL_MAX_TEXT_BYTES, field, "is longer than 512 bytes");
    if (codec->decoding) {
        if (!codec->failed && text->length > codec->size - codec->at)
            codec_fail(codec, field, "is cut off by the end of the payload");
        if (codec->failed) {
            *text = (struct protocol_text){0};
            return;
        }
        text->bytes = text->length ? (const char *)codec->read + codec->at : NULL;
        codec->at += text->length;
    } else if (codec->write && text->length) {
        if (!codec->failed && text->length > codec->size - codec->at)
            codec_fail(codec, field, "does not fit the buffer");
        if (codec->failed)
            return;
        memcpy(codec->write + codec->at, text->bytes, text->length);
        codec->at += text->length;
    } else {
        codec->at += text->length;
    }
    codec_check(codec, codec->failed || is_text((const uint8_t *)text->bytes, text->length), field,
                "must be UTF-8 without zeros");
}

void codec_count(struct codec *codec, const char *list, uint16_t *count, uint32_t limit)
{
    codec->list = NULL;
    codec_u16(codec, list, count);
    codec_check(codec, *count <= limit, list, "has more entries than the protocol allows");
    if (codec->failed && codec->decoding)
        *count = 0;
    codec->list = list;
    codec->index = 0;
}

void codec_rest(struct codec *codec, const char *field, const uint8_t **bytes, uint32_t *length,
                uint32_t limit)
{
    if (codec->decoding) {
        size_t left = codec->failed ? 0 : codec->size - codec->at;
        *length = (uint32_t)left;
        *bytes = left ? codec->read + codec->at : NULL;
    }
    codec_check(codec, *length >= 1, field, "must not be empty");
    codec_check(codec, *length <= limit, field, "is longer than the protocol allows");
    if (!codec->failed && !codec->decoding && codec->write) {
        codec_check(codec, *length <= codec->size - codec->at, field, "does not fit the buffer");
        if (!codec->failed)
            memcpy(codec->write + codec->at, *bytes, *length);
    }
    if (!codec->failed)
        codec->at += *length;
}
