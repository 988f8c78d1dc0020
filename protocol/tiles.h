/* tiles.h: a channel of a frame as bytes: f32 or f16, raw or zstd over 16x16 tiles (PROTOCOL.md, "Images").
 *
 * raw    rows from the top, components interleaved, no padding, little-endian.
 * zstd   one bit per tile, row by row, least significant first, set where the tile has a bit that is not 0,
 * padded to whole bytes; then, unless no bit is set, one zstd frame that holds the samples of those tiles,
 * tile after tile, each as raw rows. Tiles at the right and bottom edge are cut to the image.
 *
 * A struct tile_codec keeps the compression state and scratch memory, which grows to the largest image seen.
 * Threads: one thread at a time per codec.
 */
#ifndef CAUSTIC_PROTOCOL_TILES_H
#define CAUSTIC_PROTOCOL_TILES_H

#include "protocol.h"

#define TILE_SIZE 16u /* pixels along a side */

struct tile_codec;

struct tile_codec *tile_codec_create(struct error *error);
void tile_codec_destroy(struct tile_codec **codec);

/* Encodes width * height * components floats. Fills every field of *channel but `channel`, and *bytes with
 * channel->bytes bytes that belong to the codec until its next call. To f16 values are rounded to nearest,
 * ties to even; finite ones beyond 65504 become 65504 with their sign, infinities stay, NaN becomes 0x7e00.
 */
bool tiles_encode(struct tile_codec *codec, const float *values, uint32_t width, uint32_t height,
                  uint32_t components, enum protocol_format format, enum protocol_encoding encoding,
                  struct protocol_channel *channel, const uint8_t **bytes, struct error *error);

/* The reverse, into width * height * components floats. Refuses bytes whose amount or content do not fit the
 * description, before anything is written past it. */
bool tiles_decode(struct tile_codec *codec, const struct protocol_channel *channel, const uint8_t *bytes,
                  float *values, struct error *error);

/* IEEE 754 binary16. */
uint16_t half_from_float(float value);
float half_to_float(uint16_t half);

#endif
