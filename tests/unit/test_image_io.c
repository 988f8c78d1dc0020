/* Images in and out: bits that come back, sRGB against its formula, caps, and files made to do harm. */
#include <fcntl.h>
#include <math.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/image/image_io.h"
#include "tests/support/check.h"

static char folder[200];

static void in_folder(char path[256], const char *name)
{
    snprintf(path, 256, "%s/%s", folder, name);
}

static unsigned char *load(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    assert_non_null(file);
    unsigned char *bytes = malloc(1 << 20);
    assert_non_null(bytes);
    *size = fread(bytes, 1, 1 << 20, file);
    fclose(file);
    return bytes;
}

/* Named float channels come back bit for bit, NaN and infinities included, with their attributes. */
static void test_exr_round_trip(void **state)
{
    (void)state;
    enum { WIDTH = 37, HEIGHT = 19, COUNT = WIDTH * HEIGHT };
    static float values[5][COUNT];
    uint32_t random = 1;
    for (int plane = 0; plane < 5; plane++)
        for (int i = 0; i < COUNT; i++) {
            random = random * 1664525u + 1013904223u;
            values[plane][i] = ldexpf((float)random / 4294967296.0f - 0.3f, (int)(random % 60) - 30);
        }
    values[0][0] = INFINITY;
    values[0][1] = -INFINITY;
    values[1][2] = NAN;
    values[2][3] = 1e-40f;
    static const char *const names[5] = {"caustics.R", "caustics.G", "Z", "N.X", "R"};
    struct image_plane planes[5];
    for (int i = 0; i < 5; i++) {
        snprintf(planes[i].name, sizeof planes[i].name, "%s", names[i]);
        planes[i].values = values[i];
    }
    float matrix[16];
    for (int i = 0; i < 16; i++)
        matrix[i] = (float)i / 3;
    const struct image_attribute attributes[] = {
        {.name = "causticd.settings", .type = IMAGE_ATTRIBUTE_STRING, .string = "photons=131072 aa=filter"},
        {.name = "worldToCamera", .type = IMAGE_ATTRIBUTE_MATRIX, .matrix = matrix},
        {.name = "causticd.time", .type = IMAGE_ATTRIBUTE_FLOAT, .number = 1.25},
        {.name = "causticd.seed", .type = IMAGE_ATTRIBUTE_INT, .number = 7},
    };
    char path[256];
    in_folder(path, "round.exr");
    struct error error = {0};
    struct image_write_params params = {.width = WIDTH,
                                        .height = HEIGHT,
                                        .planes = planes,
                                        .plane_count = 5,
                                        .attributes = attributes,
                                        .attribute_count = 4};
    assert_true(image_write_exr(path, &params, &error));
    struct image_file *file = image_read_exr(path, &error);
    assert_non_null(file);
    assert_int_equal(file->width, WIDTH);
    assert_int_equal(file->height, HEIGHT);
    assert_int_equal(file->plane_count, 5);
    for (int i = 0; i < 5; i++) {
        const float *plane = image_file_plane(file, names[i]);
        assert_non_null(plane);
        assert_memory_equal(plane, values[i], sizeof values[i]);
    }
    assert_null(image_file_plane(file, "caustics.B"));
    image_file_destroy(&file);
    assert_null(file);

    char text[64];
    float read[16];
    assert_true(image_read_exr_string(path, "causticd.settings", text, sizeof text, &error));
    assert_string_equal(text, "photons=131072 aa=filter");
    assert_true(image_read_exr_matrix(path, "worldToCamera", read, &error));
    assert_memory_equal(read, matrix, sizeof matrix);
    assert_false(image_read_exr_string(path, "nothing", text, sizeof text, &error));
    assert_int_equal(error.status, STATUS_NOT_FOUND);
    remove(path);
}

static bool decode(const void *bytes, size_t size, bool is_srgb, struct image_texels *texels,
                   struct error *error)
{
    const struct image_decode_params params = {.name = "test image", .is_srgb = is_srgb};
    return image_decode(bytes, size, &params, texels, error);
}

/* All 256 values of an 8-bit PNG against IEC 61966-2-1's decoding formula, to half a step of half floats. */
static void test_srgb(void **state)
{
    (void)state;
    uint8_t pixels[256 * 4];
    for (int i = 0; i < 256; i++) {
        pixels[4 * i] = (uint8_t)i;
        pixels[4 * i + 1] = (uint8_t)(255 - i);
        pixels[4 * i + 2] = 0;
        pixels[4 * i + 3] = (uint8_t)i; /* colour must not be multiplied by it */
    }
    char path[256];
    in_folder(path, "srgb.png");
    struct error error = {0};
    assert_true(image_write_png(path, 16, 16, 4, pixels, &error));
    size_t size;
    unsigned char *bytes = load(path, &size);
    for (int is_srgb = 0; is_srgb < 2; is_srgb++) {
        struct image_texels texels;
        assert_true(decode(bytes, size, is_srgb, &texels, &error));
        assert_true(texels.width == 16 && texels.height == 16 && texels.nonfinite_count == 0);
        for (int i = 0; i < 256; i++) {
            double encoded = i / 255.0;
            double linear = encoded <= 0.04045 ? encoded / 12.92 : pow((encoded + 0.055) / 1.055, 2.4);
            double expected = is_srgb ? linear : encoded;
            assert_close((double)image_half_to_float(texels.texels[4 * i]), expected,
                         fmax(expected / 2048, 3e-8));
            assert_close((double)image_half_to_float(texels.texels[4 * i + 3]), encoded,
                         fmax(encoded / 2048, 3e-8));
        }
        /* The first row is the image's top. */
        assert_int_equal(texels.texels[4 * 255 + 1], 0);
        free(texels.texels);
    }
    free(bytes);
    remove(path);
}

/* One and three components, an EXR as texture (linear already, NaN counted), a grey image spread over R, G
 * and B. */
static void test_kinds(void **state)
{
    (void)state;
    char path[256];
    struct error error = {0};
    struct image_texels texels;
    size_t size;
    const uint8_t grey[4] = {0, 255, 255, 0}, rgb[6] = {255, 0, 0, 0, 0, 255};
    in_folder(path, "grey.png");
    assert_true(image_write_png(path, 2, 2, 1, grey, &error));
    unsigned char *bytes = load(path, &size);
    assert_true(decode(bytes, size, true, &texels, &error));
    for (int channel = 0; channel < 4; channel++)
        assert_int_equal(texels.texels[4 + channel], 0x3c00);
    assert_int_equal(texels.texels[0], 0);
    assert_int_equal(texels.texels[3], 0x3c00);
    free(texels.texels);
    free(bytes);
    remove(path);

    in_folder(path, "rgb.png");
    assert_true(image_write_png(path, 2, 1, 3, rgb, &error));
    bytes = load(path, &size);
    assert_true(decode(bytes, size, true, &texels, &error));
    assert_int_equal(texels.texels[0], 0x3c00);
    assert_int_equal(texels.texels[4], 0);
    assert_int_equal(texels.texels[6], 0x3c00);
    free(texels.texels);
    free(bytes);
    remove(path);

    in_folder(path, "texture.exr");
    const float red[2] = {0.5f, NAN}, green[2] = {2, 0}, blue[2] = {0, 1e9f};
    const struct image_plane planes[3] = {{"R", red}, {"G", green}, {"B", blue}};
    const struct image_write_params params = {.width = 2, .height = 1, .planes = planes, .plane_count = 3};
    assert_true(image_write_exr(path, &params, &error));
    bytes = load(path, &size);
    assert_true(decode(bytes, size, true, &texels, &error));
    assert_int_equal(texels.texels[0], 0x3800);
    assert_int_equal(texels.texels[1], 0x4000);
    assert_int_equal(texels.nonfinite_count, 2); /* the NaN, and 1e9 as a half */
    free(texels.texels);
    free(bytes);
    remove(path);
}

/* A 1 x 2 Radiance file written by hand: mantissas over 256 times two to the exponent less 128. */
static void test_radiance(void **state)
{
    (void)state;
    static const char file[] =
        "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 1\n\x80\x40\x00\x81\x00\x80\xff\x80";
    struct error error = {0};
    struct image_texels texels;
    if (!decode(file, sizeof file - 1, true, &texels, &error))
        fail_msg("%s", error.message);
    assert_true(texels.width == 1 && texels.height == 2);
    /* 128/256 * 2 = 1, 64/256 * 2 = 0.5, to one step of the mantissa, 2/256: readers differ by half of it. */
    assert_close((double)image_half_to_float(texels.texels[0]), 1, 2.0 / 256);
    assert_close((double)image_half_to_float(texels.texels[1]), 0.5, 2.0 / 256);
    assert_close((double)image_half_to_float(texels.texels[5]), 0.5, 2.0 / 256);
    assert_close((double)image_half_to_float(texels.texels[6]), 1, 2.0 / 256);
    free(texels.texels);
}

static void test_caps(void **state)
{
    (void)state;
    char path[256];
    struct error error = {0};
    uint8_t pixels[64 * 8] = {0};
    in_folder(path, "wide.png");
    assert_true(image_write_png(path, 64, 8, 1, pixels, &error));
    size_t size;
    unsigned char *bytes = load(path, &size);
    struct image_texels texels;
    struct image_decode_params params = {.name = "wide", .max_size = 63};
    assert_false(image_decode(bytes, size, &params, &texels, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_non_null(strstr(error.message, "wide has 64 x 8 pixels"));
    params = (struct image_decode_params){.name = "wide", .max_size = 64, .max_texels = 511};
    assert_false(image_decode(bytes, size, &params, &texels, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    params.max_texels = 512;
    assert_true(image_decode(bytes, size, &params, &texels, &error));
    free(texels.texels);
    /* A header that promises 2^31 - 1 pixels a side, with its checksum made right. */
    static const unsigned char bomb[] =
        "\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR\x7f\xff\xff\xff\x7f\xff\xff\xff\x08\x06\0\0\0"
        "\x14\xc9\x0b\x66\0\0\0\0IDAT\x35\xaf\x06\x1e";
    assert_false(decode(bomb, sizeof bomb - 1, true, &texels, &error));
    free(bytes);
    remove(path);
}

/* Cut at every length and with every byte damaged: an error or an image, never a crash. */
static void test_damaged(void **state)
{
    (void)state;
    char path[256];
    struct error error = {0};
    uint8_t pixels[7 * 5 * 3];
    for (size_t i = 0; i < sizeof pixels; i++)
        pixels[i] = (uint8_t)(i * 37);
    float plane[35];
    for (int i = 0; i < 35; i++)
        plane[i] = (float)i;
    double least_refused = 2; /* of two trials per byte */
    const struct image_plane planes[1] = {{"Y", plane}};
    const struct image_write_params params = {.width = 7, .height = 5, .planes = planes, .plane_count = 1};
    /* libpng writes every complaint to stderr, a line for each of some 600 files. */
    int stderr_copy = dup(2), nowhere = open("/dev/null", O_WRONLY);
    dup2(nowhere, 2);
    for (int kind = 0; kind < 2; kind++) {
        in_folder(path, kind ? "damaged.exr" : "damaged.png");
        assert_true(kind ? image_write_exr(path, &params, &error)
                         : image_write_png(path, 7, 5, 3, pixels, &error));
        size_t size;
        unsigned char *bytes = load(path, &size);
        int refused = 0;
        for (size_t i = 0; i < size; i++) {
            unsigned char *copy = malloc(size);
            assert_non_null(copy);
            memcpy(copy, bytes, size);
            copy[i] ^= 0xff;
            for (int is_cut = 0; is_cut < 2; is_cut++) {
                struct image_texels texels = {0};
                if (decode(copy, is_cut ? i : size, true, &texels, &error))
                    free(texels.texels);
                else
                    refused++;
            }
            free(copy);
        }
        least_refused = fmin(least_refused, (double)refused / (double)size);
        free(bytes);
        remove(path);
    }
    dup2(stderr_copy, 2);
    close(stderr_copy);
    close(nowhere);
    /* Every cut and most damages show; some bytes carry nothing. */
    assert_true(least_refused > 1);
}

static void test_refusals(void **state)
{
    (void)state;
    struct error error = {0};
    struct image_texels texels;
    assert_false(decode("GIF89a and so on", 16, true, &texels, &error));
    assert_string_equal(error.message, "test image is no PNG, JPEG, EXR or HDR");
    assert_false(decode("", 0, true, &texels, &error));
    uint8_t pixel[4] = {0};
    assert_false(image_write_png("/nowhere/at/all.png", 1, 1, 4, pixel, &error));
    assert_int_equal(error.status, STATUS_IO);
    assert_false(image_write_png("x.png", 0, 1, 4, pixel, &error));
    assert_int_equal(error.status, STATUS_INVALID);
    assert_null(image_read_exr("/nowhere/at/all.exr", &error));
    assert_int_equal(error.status, STATUS_NOT_FOUND);
}

/* Every half against itself, and rounding at the places where it is decided. */
static void test_half(void **state)
{
    (void)state;
    for (uint32_t half = 0; half < 65536; half++) {
        float value = image_half_to_float((uint16_t)half);
        bool is_nan = (half & 0x7c00) == 0x7c00 && (half & 0x3ff);
        assert_int_equal(isnan(value) != 0, is_nan);
        if (!is_nan) {
            double expected = (half & 0x7c00) == 0x7c00 ? (double)INFINITY
                              : (half & 0x7c00) ? ldexp(1024 + (half & 0x3ff), (int)(half >> 10 & 31) - 25)
                                                : ldexp(half & 0x3ff, -24);
            assert_true((double)value == (half & 0x8000 ? -expected : expected));
            assert_int_equal(image_half_from_float(value), half);
        }
    }
    assert_int_equal(image_half_from_float(65519.99f), 0x7bff);
    assert_int_equal(image_half_from_float(65520), 0x7c00);
    assert_int_equal(image_half_from_float(1 + 1.0f / 2048), 0x3c00); /* tie: even */
    assert_int_equal(image_half_from_float(1 + 3.0f / 2048), 0x3c02); /* tie: even */
    assert_int_equal(image_half_from_float(ldexpf(1, -25)), 0);       /* tie: even */
    assert_int_equal(image_half_from_float(ldexpf(1.5f, -25)), 1);
    assert_int_equal(image_half_from_float(ldexpf(1023.75f, -24)), 0x0400); /* up into the normals */
    assert_true(isnan(image_half_to_float(image_half_from_float(NAN))));
}

int main(void)
{
    struct error error = {0};
    const char *parent = getenv("TMPDIR");
    snprintf(folder, sizeof folder, "%s", parent ? parent : "/tmp");
    if (!image_read_exr("/nowhere/at/all.exr", &error) && error.status == STATUS_UNSUPPORTED)
        skip_program("this build reads and writes no images (CAUSTICD_IMAGES is off)");
    snprintf(folder, sizeof folder, "%s/causticd_images_%ld", parent ? parent : "/tmp", (long)getpid());
    if (mkdir(folder, 0700) != 0)
        return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_exr_round_trip), cmocka_unit_test(test_srgb), cmocka_unit_test(test_kinds),
        cmocka_unit_test(test_radiance),       cmocka_unit_test(test_caps), cmocka_unit_test(test_damaged),
        cmocka_unit_test(test_refusals),       cmocka_unit_test(test_half),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    rmdir(folder);
    return failed;
}
