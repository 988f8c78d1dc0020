/* codec.h: one field after another, written or read by the same code, so that encoder and decoder cannot
 * disagree.
 *
 * A codec runs in one of three modes: decoding from `read`, encoding to `write`, or measuring (neither). The
 * first failure sticks: later calls do nothing and set what they would have read to 0. Errors name the
 * message and the field. Internal to protocol/.
 */
#ifndef CAUSTIC_PROTOCOL_CODEC_H
#define CAUSTIC_PROTOCOL_CODEC_H

#include "protocol.h"

struct codec {
    const char *message; /* name of the message, for errors */
    const char *list;    /* list being walked, or NULL */
    uint32_t index;      /* element of the list */
    bool decoding;
    const uint8_t *read; /* decoding: `size` bytes */
    uint8_t *write;      /* encoding: `size` bytes; NULL: measuring */
    size_t size, at;
    bool failed;
    struct error *error;
};

/* Fails with "MESSAGE: FIELD TEXT". */
void codec_fail(struct codec *codec, const char *field, const char *text);
void codec_check(struct codec *codec, bool condition, const char *field, const char *text);

void codec_u8(struct codec *codec, const char *field, uint8_t *value);
void codec_u16(struct codec *codec, const char *field, uint16_t *value);
void codec_u32(struct codec *codec, const char *field, uint32_t *value);
void codec_u64(struct codec *codec, const char *field, uint64_t *value);
void codec_bool(struct codec *codec, const char *field, bool *value);                   /* one byte, 0 or 1 */
void codec_enum(struct codec *codec, const char *field, uint8_t *value, uint8_t count); /* below count */
void codec_f64(struct codec *codec, const char *field, double *value);                  /* finite */
void codec_f32(struct codec *codec, const char *field, float *values, size_t count);    /* finite */
void codec_f32_any(struct codec *codec, const char *field, float *values, size_t count);
void codec_f64_any(struct codec *codec, const char *field, double *values, size_t count);
void codec_text(struct codec *codec, const char *field, struct protocol_text *text);
void codec_count(struct codec *codec, const char *list, uint16_t *count, uint32_t limit);
/* The rest of the payload; at least one byte, at most `limit`. */
void codec_rest(struct codec *codec, const char *field, const uint8_t **bytes, uint32_t *length,
                uint32_t limit);

#endif
