/* Images on the wire: half floats, empty tiles, both encodings, hostile bytes. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <cmocka.h>

#include "protocol/tiles.h"

static struct tile_codec *codec;

static int set_up(void **state)
{
    (void)state;
    struct error error;
    codec = tile_codec_create(&error);
    return codec ? 0 : -1;
}

static int tear_down(void **state)
{
    (void)state;
    tile_codec_destroy(&codec);
    return 0;
}

/* Half to float from the definition: sign, exponent, fraction. */
static double half_value(uint16_t half)
{
    int exponent = half >> 10 & 31, fraction = half & 1023;
    double magnitude = exponent ? ldexp(1024 + fraction, exponent - 25) : ldexp(fraction, -24);
    return half & 0x8000 ? -magnitude : magnitude;
}

static void halves_follow_their_definition(void **state)
{
    (void)state;
    for (uint32_t half = 0; half < 65536; half++) {
        float value = half_to_float((uint16_t)half);
        if ((half & 0x7fff) > 0x7c00) {
            assert_true(isnan(value));
            assert_int_equal(half_from_float(value), 0x7e00);
        } else if ((half & 0x7fff) == 0x7c00) {
            assert_true(isinf(value));
            assert_int_equal(half_from_float(value), half);
        } else {
            assert_true((double)value == half_value((uint16_t)half));
            assert_int_equal(half_from_float(value), half);
        }
    }
}

/* Between every two neighbouring halves: below, at and above the middle. */
static void rounding_is_to_nearest_even(void **state)
{
    (void)state;
    for (uint32_t half = 0; half < 0x7bff; half++) {
        double low = half_value((uint16_t)half), high = half_value((uint16_t)(half + 1));
        float middle = (float)((low + high) / 2); /* exact: eleven bits and one more */
        uint32_t even = half & 1 ? half + 1 : half;
        assert_int_equal(half_from_float(middle), even);
        assert_int_equal(half_from_float(-middle), even | 0x8000);
        assert_int_equal(half_from_float(nextafterf(middle, 0)), half);
        assert_int_equal(half_from_float(nextafterf(middle, INFINITY)), half + 1);
    }
    assert_int_equal(half_from_float(65504), 0x7bff);
    assert_int_equal(half_from_float(65520), 0x7bff);
    assert_int_equal(half_from_float(-1e30f), 0xfbff);
    assert_int_equal(half_from_float(1e-30f), 0);
    assert_int_equal(half_from_float(-0.0f), 0x8000);
}

static uint32_t random_state = 7;

static uint32_t random_u32(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 17;
    return random_state ^= random_state << 5;
}

/* A black picture with a few bright spots, as caustics are. */
static float *picture(uint32_t width, uint32_t height, uint32_t components)
{
    size_t count = (size_t)width * height * components;
    float *values = calloc(count, sizeof *values);
    assert_non_null(values);
    for (uint32_t spot = 0; spot < 5; spot++) {
        uint32_t x0 = random_u32() % width, y0 = random_u32() % height;
        for (uint32_t y = y0; y < height && y < y0 + 20; y++)
            for (uint32_t x = x0; x < width && x < x0 + 30; x++)
                for (uint32_t c = 0; c < components; c++)
                    values[((size_t)y * width + x) * components + c] = (float)(random_u32() % 100000) * 0.01f;
    }
    return values;
}

static void images_round_trip(void **state)
{
    (void)state;
    static const uint32_t sizes[][3] = {{1, 1, 1},     {16, 16, 3}, {17, 15, 3}, {15, 33, 1},
                                        {480, 270, 3}, {1, 500, 4}, {257, 2, 2}, {128, 128, 1}};
    struct error error;
    for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
        uint32_t width = sizes[s][0], height = sizes[s][1], components = sizes[s][2];
        size_t count = (size_t)width * height * components;
        float *values = picture(width, height, components), *back = malloc(count * sizeof *back);
        assert_non_null(back);
        for (int format = 0; format < PROTOCOL_FORMAT_COUNT; format++) {
            for (int encoding = 0; encoding < PROTOCOL_ENCODING_COUNT; encoding++) {
                struct protocol_channel channel = {.channel = 5};
                const uint8_t *bytes;
                assert_true(tiles_encode(codec, values, width, height, components,
                                         (enum protocol_format)format, (enum protocol_encoding)encoding,
                                         &channel, &bytes, &error));
                assert_int_equal(channel.channel, 5);
                assert_int_equal(channel.not_a_number, 0);
                if (encoding == PROTOCOL_RAW)
                    assert_int_equal(channel.bytes, count * (format == PROTOCOL_F16 ? 2 : 4));
                uint8_t *copy = malloc(channel.bytes); /* the codec's memory goes with the next call */
                assert_non_null(copy);
                memcpy(copy, bytes, channel.bytes);
                memset(back, 0xcc, count * sizeof *back);
                assert_true(tiles_decode(codec, &channel, copy, back, &error));
                for (size_t i = 0; i < count; i++) {
                    float expected =
                        format == PROTOCOL_F16 ? half_to_float(half_from_float(values[i])) : values[i];
                    assert_true(back[i] == expected);
                }
                /* The description a frame carries passes the frame's own check. */
                static struct protocol_message message;
                message.header.type = PROTOCOL_FRAME;
                message.frame.channel_count = 1;
                message.frame.channels[0] = channel;
                assert_true(protocol_encode(&message, NULL, 0, &error) > 0);
                free(copy);
            }
        }
        free(values);
        free(back);
    }
}

static size_t read_golden(const char *name, uint8_t *bytes, size_t capacity)
{
    const char *folder = getenv("CAUSTICD_SOURCE_DIR");
    char path[1024], line[512];
    snprintf(path, sizeof path, "%s/protocol/golden/%s.hex", folder ? folder : ".", name);
    FILE *file = fopen(path, "r");
    if (!file)
        fail_msg("%s is missing", path);
    size_t count = 0;
    while (fgets(line, sizeof line, file)) {
        line[strcspn(line, "#\n")] = 0;
        for (char *at = strtok(line, " "); at; at = strtok(NULL, " ")) {
            assert_true(count < capacity);
            bytes[count++] = (uint8_t)strtoul(at, NULL, 16);
        }
    }
    fclose(file);
    return count;
}

static void golden_images(void **state)
{
    (void)state;
    struct error error;
    uint8_t golden[64];
    float values[17], expected[17] = {0};
    struct protocol_channel channel = {.width = 17, .height = 1, .components = 1, .encoding = PROTOCOL_ZSTD};
    channel.bytes = (uint32_t)read_golden("image_empty", golden, sizeof golden);
    assert_true(tiles_decode(codec, &channel, golden, values, &error));
    assert_memory_equal(values, expected, sizeof values);
    const uint8_t *bytes;
    struct protocol_channel written;
    assert_true(
        tiles_encode(codec, expected, 17, 1, 1, PROTOCOL_F32, PROTOCOL_ZSTD, &written, &bytes, &error));
    assert_int_equal(written.bytes, channel.bytes);
    assert_memory_equal(bytes, golden, channel.bytes);

    expected[16] = 1;
    channel.bytes = (uint32_t)read_golden("image_tiles", golden, sizeof golden);
    assert_true(tiles_decode(codec, &channel, golden, values, &error));
    assert_memory_equal(values, expected, sizeof values);
    /* What zstd makes of four bytes is its own affair; the map and the content are not. */
    assert_true(
        tiles_encode(codec, expected, 17, 1, 1, PROTOCOL_F32, PROTOCOL_ZSTD, &written, &bytes, &error));
    assert_int_equal(bytes[0], 2);
    assert_memory_equal(bytes + 1, golden + 1, 4);
}

static void what_a_format_cannot_say_is_counted(void **state)
{
    (void)state;
    struct error error;
    float values[8] = {1, NAN, INFINITY, -INFINITY, 65504, 65505, -1e9f, -0.0f}, back[8];
    for (int encoding = 0; encoding < PROTOCOL_ENCODING_COUNT; encoding++) {
        struct protocol_channel channel;
        const uint8_t *bytes;
        assert_true(tiles_encode(codec, values, 4, 2, 1, PROTOCOL_F16, (enum protocol_encoding)encoding,
                                 &channel, &bytes, &error));
        assert_int_equal(channel.clamped, 2);
        assert_int_equal(channel.not_a_number, 1);
        uint8_t copy[256];
        memcpy(copy, bytes, channel.bytes);
        assert_true(tiles_decode(codec, &channel, copy, back, &error));
        assert_true(back[0] == 1 && isnan(back[1]) && back[2] == INFINITY && back[3] == -INFINITY);
        assert_true(back[4] == 65504 && back[5] == 65504 && back[6] == -65504);
        assert_true(back[7] == 0 && signbit(back[7])); /* a tile of -0 is not empty */
        assert_true(tiles_encode(codec, values, 4, 2, 1, PROTOCOL_F32, (enum protocol_encoding)encoding,
                                 &channel, &bytes, &error));
        assert_int_equal(channel.clamped, 0);
        assert_int_equal(channel.not_a_number, 1);
    }
}

static void hostile_images_are_refused(void **state)
{
    (void)state;
    struct error error;
    float *values = picture(100, 50, 3), *back = calloc(100 * 50 * 3, sizeof *back);
    struct protocol_channel channel;
    const uint8_t *bytes;
    assert_true(
        tiles_encode(codec, values, 100, 50, 3, PROTOCOL_F32, PROTOCOL_ZSTD, &channel, &bytes, &error));
    uint8_t *good = malloc(channel.bytes);
    assert_non_null(good);
    memcpy(good, bytes, channel.bytes);
    /* Cut anywhere: refused. Exact allocations, so that a sanitizer sees a read past the end. */
    for (uint32_t cut = 0; cut < channel.bytes; cut += cut < 64 ? 1 : 37) {
        uint8_t *short_bytes = malloc(cut ? cut : 1);
        assert_non_null(short_bytes);
        memcpy(short_bytes, good, cut);
        struct protocol_channel shorter = channel;
        shorter.bytes = cut;
        assert_false(tiles_decode(codec, &shorter, short_bytes, back, &error));
        free(short_bytes);
    }
    /* Damaged: refused or another picture, never a crash. A changed map changes what zstd must hold: refused.
     */
    for (uint32_t i = 0; i < 3000; i++) {
        uint32_t at = random_u32() % channel.bytes;
        uint8_t old = good[at];
        good[at] ^= (uint8_t)(1u << random_u32() % 8);
        bool is_accepted = tiles_decode(codec, &channel, good, back, &error);
        assert_false(is_accepted && at < 3);
        good[at] = old;
    }
    struct protocol_channel lie = channel;
    lie.width = 101;
    assert_false(tiles_decode(codec, &lie, good, back, &error));
    lie = channel;
    lie.components = 5;
    assert_false(tiles_decode(codec, &lie, good, back, &error));
    lie = channel;
    lie.format = 7;
    assert_false(tiles_decode(codec, &lie, good, back, &error));
    lie = channel;
    lie.encoding = PROTOCOL_RAW;
    assert_false(tiles_decode(codec, &lie, good, back, &error));
    free(good);
    free(values);
    free(back);
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + (double)now.tv_nsec * 1e-9;
}

/* Prints what a 480x270 RGB frame costs; the bound is loose, it catches a slow path, not a slow machine. */
static void encoding_takes_milliseconds(void **state)
{
    (void)state;
    struct error error;
    enum { WIDTH = 480, HEIGHT = 270, COUNT = WIDTH * HEIGHT * 3 };
    float *values = malloc(COUNT * sizeof *values);
    assert_non_null(values);
    for (uint32_t i = 0; i < COUNT; i++)
        values[i] = (float)(random_u32() % 100000) * 0.01f; /* noise without an empty tile: the worst case */
    for (int format = 0; format < PROTOCOL_FORMAT_COUNT; format++) {
        for (int encoding = 0; encoding < PROTOCOL_ENCODING_COUNT; encoding++) {
            double best = 1e9;
            struct protocol_channel channel = {0};
            for (int run = 0; run < 5; run++) {
                const uint8_t *bytes;
                double start = seconds();
                assert_true(tiles_encode(codec, values, WIDTH, HEIGHT, 3, (enum protocol_format)format,
                                         (enum protocol_encoding)encoding, &channel, &bytes, &error));
                double elapsed = seconds() - start;
                best = elapsed < best ? elapsed : best;
            }
            printf("480x270x3 noise, %s %s: %.2f ms, %u bytes\n", format ? "f16" : "f32",
                   encoding ? "zstd" : "raw", best * 1e3, channel.bytes);
            assert_true(best < 0.5);
        }
    }
    free(values);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(halves_follow_their_definition),
        cmocka_unit_test(rounding_is_to_nearest_even),
        cmocka_unit_test(images_round_trip),
        cmocka_unit_test(golden_images),
        cmocka_unit_test(what_a_format_cannot_say_is_counted),
        cmocka_unit_test(hostile_images_are_refused),
        cmocka_unit_test(encoding_takes_milliseconds),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
