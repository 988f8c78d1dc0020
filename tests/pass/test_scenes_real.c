/* Files that others made load and render. */

#include <dirent.h>
#include <string.h>

#include "core/measure/image_measure.h"
#include "tests/support/check.h"
#include "tests/support/stage.h"
#include "tests/support/truth.h"

enum { SIDE = 256 }; /* their pictures are square */

static char folder[512];
static size_t non_finite; /* values in the channels of all files */

static void render(const char *name)
{
    char path[800];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    struct truth stage;
    stage_open(&stage, path, SIDE, SIDE, NULL);
    const uint32_t every = (1u << CHANNEL_COUNT) - 1;
    const struct frame_result *result = truth_render(&stage, 1, every);
    assert_int_equal(result->channel_count, CHANNEL_COUNT);
    for (uint32_t i = 0; i < result->channel_count; i++) {
        const struct frame_channel *channel = &result->channels[i];
        struct measure_image image = {channel->values, channel->width, channel->height, channel->components};
        if (channel->channel != CHANNEL_DEPTH) {
            size_t count = measure_non_finite(&image);
            non_finite += count;
            if (count > 0)
                print_error("%s: %zu values of %s are not finite\n", name, count,
                            channel_infos[channel->channel].name);
        } else
            for (size_t k = 0; k < (size_t)SIDE * SIDE; k++)
                assert_true(channel->values[k] > 0); /* infinite where nothing is */
    }
    const float *beauty = truth_channel(result, CHANNEL_BEAUTY),
                *depth = truth_channel(result, CHANNEL_DEPTH);
    size_t lit = 0, hit = 0;
    for (size_t k = 0; k < (size_t)SIDE * SIDE; k++) {
        lit += beauty[3 * k] + beauty[3 * k + 1] + beauty[3 * k + 2] > 0;
        hit += isfinite(depth[k]);
    }
    print_message(
        "%s: %u triangles, %u lights, %.0f photons, caustic flux %.4g of %.4g W in view, %.1f %% of "
        "the pixels lit, %.1f %% show something%s%s\n",
        name, stage.scene->triangle_count, stage.scene->light_count, result->stats[STAT_photons_emitted],
        result->stats[STAT_flux_splatted], result->stats[STAT_flux_emitted],
        100.0 * (double)lit / (SIDE * SIDE), 100.0 * (double)hit / (SIDE * SIDE),
        result->black_reason ? "; no caustics: " : "", result->black_reason ? result->black_reason : "");
    for (uint32_t i = 0; i < stage.scene->warning_count; i++)
        print_message("  %s\n", stage.scene->warnings[i]);
    /* Both are of a lit room or pool that fills the picture. */
    assert_true(hit > SIDE * SIDE / 2);
    assert_true(lit > SIDE * SIDE / 20);
    /* Both were made to show caustics. */
    assert_null(result->black_reason);
    assert_true(result->stats[STAT_flux_splatted] > 0);
    truth_close(&stage);
}

static void every_file_renders(void **state)
{
    (void)state;
    DIR *directory = opendir(folder);
    assert_non_null(directory);
    uint32_t count = 0;
    for (struct dirent *entry; (entry = readdir(directory));) {
        size_t length = strlen(entry->d_name);
        if (length > 4 && !strcmp(entry->d_name + length - 4, ".glb")) {
            render(entry->d_name);
            count++;
        }
    }
    closedir(directory);
    assert_true(count > 0);
    assert_int_equal(non_finite, 0);
}

int main(void)
{
    if (!stage_shared_file("scenes", folder, sizeof folder))
        skip_program(
            "the scenes of others are not there: set CAUSTICD_SHARED to the folder that holds scenes/");
    const struct CMUnitTest tests[] = {cmocka_unit_test(every_file_renders)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
