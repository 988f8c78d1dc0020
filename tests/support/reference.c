#include "reference.h"

#include <string.h>

#include "check.h"
#include "stage.h"

/* The most a device with 128 MiB of storage buffer takes. */
#define PHOTONS_A_FRAME 294912

static struct measure_image image_of(const struct reference *reference, const float *values)
{
    return (struct measure_image){values, reference->width, reference->height, 3};
}

static size_t value_count(const struct reference *reference)
{
    return (size_t)reference->width * reference->height * 3;
}

static float *new_values(const struct reference *reference)
{
    float *values = malloc(value_count(reference) * sizeof *values);
    assert_non_null(values);
    return values;
}

static double filtered(const struct reference *reference, const float *a, const float *b)
{
    float *smooth_a = new_values(reference), *smooth_b = new_values(reference);
    struct measure_image image_a = image_of(reference, a), image_b = image_of(reference, b);
    measure_box3(&image_a, smooth_a);
    measure_box3(&image_b, smooth_b);
    image_a.values = smooth_a;
    image_b.values = smooth_b;
    double error = measure_relative_l1(&image_a, &image_b);
    free(smooth_a);
    free(smooth_b);
    return error;
}

double reference_error(const struct reference *reference, const float *caustics)
{
    struct measure_image a = image_of(reference, caustics), b = image_of(reference, reference->values);
    return measure_relative_l1(&a, &b);
}

double reference_filtered_error(const struct reference *reference, const float *caustics)
{
    return filtered(reference, caustics, reference->values);
}

/* ---- cache --------------------------------------------------------------------------------------------- */

static uint64_t hash_bytes(uint64_t hash, const void *bytes, size_t size)
{
    const unsigned char *at = bytes;
    for (size_t i = 0; i < size; i++)
        hash = (hash ^ at[i]) * 0x100000001b3u;
    return hash;
}

static bool cache_path(const char *scene, const char *settings, const struct reference *reference, char *path,
                       size_t size)
{
    const char *folder = getenv("CAUSTICD_REFERENCE_CACHE");
    FILE *program = folder ? fopen("/proc/self/exe", "rb") : NULL;
    if (!program)
        return false;
    uint64_t hash = 0xcbf29ce484222325u;
    char block[4096];
    for (size_t n; (n = fread(block, 1, sizeof block, program)) > 0;)
        hash = hash_bytes(hash, block, n);
    fclose(program);
    hash = hash_bytes(hash, settings, strlen(settings));
    hash = hash_bytes(hash, scene, strlen(scene));
    const char *base = strrchr(scene, '/');
    snprintf(path, size, "%s/%s-%ux%u-%016llx.reference", folder, base ? base + 1 : scene, reference->width,
             reference->height, (unsigned long long)hash);
    return true;
}

static bool cache_read(const char *path, struct reference *reference)
{
    FILE *file = fopen(path, "rb");
    if (!file)
        return false;
    double head[3];
    bool is_whole =
        fread(head, sizeof head, 1, file) == 1 &&
        fread(reference->values, sizeof(float), value_count(reference), file) == value_count(reference);
    fclose(file);
    reference->photons = head[0];
    reference->noise = head[1];
    reference->filtered_noise = head[2];
    return is_whole;
}

static void cache_write(const char *path, const struct reference *reference)
{
    char part[600];
    snprintf(part, sizeof part, "%s.part", path);
    FILE *file = fopen(part, "wb");
    const double head[3] = {reference->photons, reference->noise, reference->filtered_noise};
    bool is_whole =
        file && fwrite(head, sizeof head, 1, file) == 1 &&
        fwrite(reference->values, sizeof(float), value_count(reference), file) == value_count(reference);
    if (file)
        is_whole = fclose(file) == 0 && is_whole;
    if (!is_whole || rename(part, path) != 0)
        print_message("the reference could not be kept as %s\n", path);
}

/* ---- rendering ----------------------------------------------------------------------------------------- */

struct reference reference_make(const char *scene, uint32_t width, uint32_t height, double photons,
                                const char *split)
{
    struct reference reference = {.width = width, .height = height};
    reference.values = new_values(&reference);
    char settings[128], path[512], key[160];
    snprintf(settings, sizeof settings, "photons=%d density=uniform aa=pixel split=%s", PHOTONS_A_FRAME,
             split);
    snprintf(key, sizeof key, "%s %.0f", settings, photons);
    bool is_kept = cache_path(scene, key, &reference, path, sizeof path);
    if (is_kept && cache_read(path, &reference))
        return reference;

    struct truth stage;
    stage_open(&stage, scene, width, height, settings);
    /* Emission has whole strata: a frame emits less than its budget. */
    double emitted = truth_render(&stage, 1, 0)->stats[STAT_photons_emitted];
    assert_true(emitted > 0);
    float *halves[2];
    /* two subframes at least: a single one is not jittered */
    for (int half = 0; half < 2; half++) {
        snprintf(settings, sizeof settings, "accumulate=%.0f seed=%d", fmax(ceil(0.5 * photons / emitted), 2),
                 half + 1);
        truth_set(&stage, settings);
        const struct frame_result *result = truth_render(&stage, 1, 1u << CHANNEL_CAUSTICS);
        const float *values = truth_channel(result, CHANNEL_CAUSTICS);
        halves[half] = new_values(&reference);
        memcpy(halves[half], values, value_count(&reference) * sizeof *values);
        reference.photons += result->stats[STAT_photons_emitted];
    }
    truth_close(&stage);
    assert_true(reference.photons >= photons);
    for (size_t i = 0; i < value_count(&reference); i++)
        reference.values[i] = 0.5f * (halves[0][i] + halves[1][i]);
    struct measure_image a = image_of(&reference, halves[0]), b = image_of(&reference, halves[1]);
    if (measure_non_finite(&a) + measure_non_finite(&b) > 0)
        fail_msg("%s: the reference is not finite", scene);
    reference.noise = 0.5 * measure_relative_l1(&a, &b);
    reference.filtered_noise = 0.5 * filtered(&reference, halves[0], halves[1]);
    free(halves[0]);
    free(halves[1]);
    if (is_kept)
        cache_write(path, &reference);
    return reference;
}

void reference_free(struct reference *reference)
{
    free(reference->values);
    *reference = (struct reference){0};
}
