/* Pictures from files: every format the same light, layers, crops, and files that are none. */
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/image/image_io.h"
#include "core/image/picture.h"
#include "tests/support/check.h"

enum { WIDTH = 12, HEIGHT = 5, COUNT = WIDTH * HEIGHT };

static char folder[200];

static const char *in_folder(const char *name)
{
    static char path[300];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

static void write_bytes(const char *name, const void *head, size_t head_size, const void *body,
                        size_t body_size)
{
    FILE *file = fopen(in_folder(name), "wb");
    assert_non_null(file);
    fwrite(head, 1, head_size, file);
    fwrite(body, 1, body_size, file);
    fclose(file);
}

static struct picture read_picture(const char *name, const char *layer)
{
    struct picture picture;
    struct error error;
    if (!picture_read(in_folder(name), &(struct picture_params){.layer = layer}, &picture, &error))
        fail_msg("%s", error.message);
    return picture;
}

static void assert_refused(const char *name, const char *layer, enum status status, const char *said)
{
    struct picture picture;
    struct error error;
    assert_false(picture_read(in_folder(name), &(struct picture_params){.layer = layer}, &picture, &error));
    assert_int_equal(error.status, status);
    assert_null(picture.values);
    if (!strstr(error.message, said) || !strstr(error.message, name))
        fail_msg("\"%s\" instead of \"%s\"", error.message, said);
}

/* Red, green and blue of a pixel tell where it is. */
static float value_at(int pixel, int component)
{
    return (float)(1 + pixel % WIDTH + 32 * (pixel / WIDTH)) * (float)(component + 1);
}

static void write_exr(const char *name, const char *const *channels, uint32_t count)
{
    static float values[8][COUNT];
    struct image_plane planes[8];
    struct error error;
    for (uint32_t c = 0; c < count; c++) {
        snprintf(planes[c].name, sizeof planes[c].name, "%s", channels[c]);
        planes[c].values = values[c];
        for (int i = 0; i < COUNT; i++)
            values[c][i] = c < 3 ? value_at(i, (int)c) : 7;
    }
    const struct image_write_params params = {
        .width = WIDTH, .height = HEIGHT, .planes = planes, .plane_count = count};
    assert_true(image_write_exr(in_folder(name), &params, &error));
}

static void write_pfm(const char *name, bool is_big)
{
    unsigned char bytes[COUNT * 12], *at = bytes;
    for (int y = HEIGHT; y-- > 0;) /* the bottom row first */
        for (int i = 0; i < 3 * WIDTH; i++) {
            float value = value_at(y * WIDTH + i / 3, i % 3);
            uint32_t bits;
            memcpy(&bits, &value, sizeof bits);
            for (int b = 0; b < 4; b++)
                *at++ = (unsigned char)(bits >> (is_big ? 24 - 8 * b : 8 * b));
        }
    const char *head = is_big ? "PF\n12 5\n1.0\n" : "PF\n12 5\n-1.0\n";
    write_bytes(name, head, strlen(head), bytes, sizeof bytes);
}

static void test_floats(void **state)
{
    (void)state;
    static const char *const rgb[] = {"R", "G", "B"};
    write_exr("plain.exr", rgb, 3);
    write_pfm("little.pfm", false);
    write_pfm("big.pfm", true);
    static const char *const files[] = {"plain.exr", "little.pfm", "big.pfm"};
    for (int k = 0; k < 3; k++) {
        struct picture picture = read_picture(files[k], "caustics"); /* without layers: taken as it is */
        assert_true(picture.width == WIDTH && picture.height == HEIGHT && !picture.is_display);
        for (int i = 0; i < 3 * COUNT; i++)
            assert_close(picture.values[i], value_at(i / 3, i % 3), 0);
        picture_free(&picture);
        assert_null(picture.values);
    }

    /* Grey, and what is no number is passed on. */
    const float grey[2] = {3, NAN};
    write_bytes("grey.pfm", "Pf\n1 2\n-1\n", 10, grey, sizeof grey);
    struct picture picture = read_picture("grey.pfm", NULL);
    assert_true(isnan(picture.values[0]) && isnan(picture.values[2]));
    assert_true(picture.values[3] == 3 && picture.values[4] == 3 && picture.values[5] == 3);
    picture_free(&picture);
}

/* RGBE: mantissas over 256 times 2^(exponent - 128). */
static void test_radiance(void **state)
{
    (void)state;
    unsigned char pixels[2 * 8 * 4];
    for (int i = 0; i < 16; i++) {
        const unsigned char rgbe[4] = {(unsigned char)(128 + 8 * i), 64, 0,
                                       (unsigned char)(i < 8 ? 130 : 121)};
        memcpy(pixels + 4 * i, rgbe, 4);
    }
    static const char head[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 8\n";
    write_bytes("light.hdr", head, sizeof head - 1, pixels, sizeof pixels);
    struct picture picture = read_picture("light.hdr", NULL);
    assert_true(picture.width == 8 && picture.height == 2 && !picture.is_display);
    for (int i = 0; i < 16; i++) {
        double unit = ldexp(1, i < 8 ? 2 : -7) / 256;
        /* Some readers take a mantissa's middle. */
        assert_close(picture.values[3 * i], (128 + 8 * i) * unit, 0.51 * unit);
        assert_close(picture.values[3 * i + 1], 64 * unit, 0.51 * unit);
    }
    picture_free(&picture);
}

/* Stored integers are sRGB-encoded unless said otherwise; alpha changes nothing. */
static void test_integers(void **state)
{
    (void)state;
    uint8_t pixels[4 * 256];
    struct error error;
    for (int i = 0; i < 256; i++) {
        pixels[4 * i] = (uint8_t)i;
        pixels[4 * i + 1] = 255;
        pixels[4 * i + 2] = 0;
        pixels[4 * i + 3] = (uint8_t)(i / 2);
    }
    assert_true(image_write_png(in_folder("ramp.png"), 16, 16, 4, pixels, &error));
    for (int is_linear = 0; is_linear < 2; is_linear++) {
        struct picture picture;
        const struct picture_params params = {.is_integer_linear = is_linear};
        assert_true(picture_read(in_folder("ramp.png"), &params, &picture, &error));
        assert_int_equal(picture.is_display, !is_linear);
        for (int i = 0; i < 256; i++) {
            double stored = i / 255.0;
            double linear = stored <= 0.04045 ? stored / 12.92 : pow((stored + 0.055) / 1.055, 2.4);
            assert_close(picture.values[3 * i], is_linear ? stored : linear, 1e-6);
            assert_close(picture.values[3 * i + 1], 1, 0);
            assert_close(picture_srgb_encode((float)linear), stored, 1e-6);
        }
        picture_free(&picture);
    }
}

static void test_layers(void **state)
{
    (void)state;
    static const char *const names[] = {"caustics.R", "caustics.G", "caustics.B", "Z", "R", "G", "B"};
    static const char *const normals[] = {"N.X", "N.Y", "N.Z", "Z"}, *const two[] = {"a.R", "a.G", "a.B",
                                                                                     "b.R"};
    write_exr("all.exr", names, 7);
    write_exr("caustics.exr", names, 4);
    write_exr("normals.exr", normals, 4);
    write_exr("two.exr", two, 4);
    write_exr("depth.exr", (const char *const[]){"Z"}, 1);

    struct picture picture = read_picture("all.exr", "caustics");
    assert_close(picture.values[3 * 17 + 1], value_at(17, 1), 0);
    picture_free(&picture);
    picture = read_picture("all.exr", NULL);
    assert_close(picture.values[3 * 17 + 1], 7, 0);
    picture_free(&picture);
    picture = read_picture("all.exr", "Z");
    assert_true(picture.values[0] == 7 && picture.values[1] == 7 && picture.values[2] == 7);
    picture_free(&picture);
    picture = read_picture("caustics.exr", NULL); /* the only layer */
    assert_close(picture.values[3 * 17 + 2], value_at(17, 2), 0);
    picture_free(&picture);
    picture = read_picture("normals.exr", "N");
    assert_close(picture.values[3 * 17 + 2], value_at(17, 2), 0);
    picture_free(&picture);
    picture = read_picture("depth.exr", NULL);
    assert_true(picture.values[3 * 17] == value_at(17, 0) && picture.values[3 * 17 + 2] == value_at(17, 0));
    picture_free(&picture);

    assert_refused("all.exr", "smoke", STATUS_NOT_FOUND, "has no layer \"smoke\"; it has ");
    assert_refused("two.exr", NULL, STATUS_NOT_FOUND, "has no channels R, G and B; name one of a, b");
}

static void test_crop(void **state)
{
    (void)state;
    struct error error;
    struct picture picture = read_picture("plain.exr", NULL);
    assert_false(picture_crop(&picture, 0, 0, 0, 1, &error));
    assert_false(picture_crop(&picture, WIDTH, 0, 1, 1, &error));
    assert_false(picture_crop(&picture, 1, 0, UINT32_MAX, 1, &error));
    assert_false(picture_crop(&picture, 0, 3, 2, 3, &error));
    assert_string_equal(error.message, "2x3 pixels from 0,3 are not within 12x5");
    assert_true(picture_crop(&picture, 4, 2, 5, 3, &error));
    assert_true(picture.width == 5 && picture.height == 3);
    for (int i = 0; i < 15; i++)
        assert_close(picture.values[3 * i + 1], value_at((2 + i / 5) * WIDTH + 4 + i % 5, 1), 0);
    picture_free(&picture);
}

static void test_refusals(void **state)
{
    (void)state;
    unsigned char body[64] = {0};
    write_bytes("empty.exr", "", 0, "", 0);
    write_bytes("text.exr", "this is no image", 16, "", 0);
    write_bytes("cut.png", "\x89PNG\r\n\x1a\n\0\0\0\xdIHDR", 16, "", 0);
    write_bytes("short.pfm", "PF\n2 3\n-1.0\n", 12, body, 63);
    write_bytes("wide.pfm", "PF\n99999 2\n-1.0\n", 16, body, 64);
    write_bytes("word.pfm", "PF\n24 x\n-1.0\n", 13, body, 64);
    write_bytes("minus.pfm", "PF\n-2 3\n-1.0\n", 13, body, 64);
    write_bytes("zero.pfm", "PF\n2 3\n0\n", 9, body, 64);
    mkdir(in_folder("folder"), 0700);
    assert_refused("missing.exr", NULL, STATUS_NOT_FOUND, "cannot open");
    assert_refused("empty.exr", NULL, STATUS_INVALID, "is empty");
    assert_refused("text.exr", NULL, STATUS_INVALID, "is no EXR, PFM, HDR, PNG or JPEG");
    assert_refused("cut.png", NULL, STATUS_INVALID, "the PNG is truncated");
    assert_refused("short.pfm", NULL, STATUS_INVALID, "the PFM is truncated");
    assert_refused("wide.pfm", NULL, STATUS_LIMIT, "has 99999 x 2 pixels; the most is 16384 x 16384");
    assert_refused("word.pfm", NULL, STATUS_INVALID, "damaged PFM header");
    assert_refused("minus.pfm", NULL, STATUS_INVALID, "damaged PFM header");
    assert_refused("zero.pfm", NULL, STATUS_INVALID, "damaged PFM header");
    assert_refused("folder", NULL, STATUS_IO, "cannot be read");

    /* An EXR cut anywhere is refused. */
    FILE *file = fopen(in_folder("plain.exr"), "rb");
    static unsigned char bytes[65536];
    assert_non_null(file);
    size_t size = fread(bytes, 1, sizeof bytes, file);
    fclose(file);
    for (size_t cut = 0; cut < size; cut += 1 + size / 25) {
        write_bytes("cut.exr", bytes, cut, "", 0);
        assert_refused("cut.exr", NULL, STATUS_INVALID, "");
    }
}

static int remove_files(void **state)
{
    (void)state;
    char command[300];
    snprintf(command, sizeof command, "rm -rf '%s'", folder);
    return system(command);
}

int main(void)
{
    struct error error = {0};
    const char *parent = getenv("TMPDIR");
    if (!image_read_exr("/nowhere/at/all.exr", &error) && error.status == STATUS_UNSUPPORTED)
        skip_program("this build reads and writes no images (CAUSTICD_IMAGES is off)");
    snprintf(folder, sizeof folder, "%s/causticd_picture_%ld", parent ? parent : "/tmp", (long)getpid());
    if (mkdir(folder, 0700) != 0)
        return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_floats), cmocka_unit_test(test_radiance), cmocka_unit_test(test_integers),
        cmocka_unit_test(test_layers), cmocka_unit_test(test_crop),     cmocka_unit_test(test_refusals),
    };
    return cmocka_run_group_tests(tests, NULL, remove_files);
}
