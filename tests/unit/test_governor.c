/* The frame time governor against a plant it does not know: time = fixed + slope * photons with noise,
 * hitches and steps, densities that follow a larger budget by halves and a smaller one at once. */
#include <math.h>

#include "core/render/governor.h"
#include "tests/support/check.h"

#define LEAST 4096.0
#define MOST  131072.0

static uint64_t noise_state;

/* Uniform in [-1, 1], the same numbers every time. */
static double noise(void)
{
    noise_state = noise_state * 6364136223846793005u + 1442695040888963407u;
    return (double)(noise_state >> 11) * 0x1p-52 - 1;
}

struct plant {
    struct governor governor;
    double fixed_ns, slope_ns, noise, fill; /* fill: share of a budget that is emitted */
    double host_share;                      /* of fixed_ns: what is not in the photons' passes */
    double emitted;
    double most_rays, ray_ns; /* of camera rays in pixels that break up; 0: there are none */
    uint32_t rays, rays_changes;
    double most_samples, sample_ns; /* of multisampled splats; 0: they are not */
    uint32_t samples, samples_changes;
    uint32_t changes, turns; /* of the budget; a turn is a step up after one down, or down after one up */
    double budget, largest_step, last_step;
    bool is_at_rest;
};

static struct plant plant_of(double fixed_ns, double slope_ns, double amplitude)
{
    noise_state = 1;
    return (struct plant){
        .fixed_ns = fixed_ns, .slope_ns = slope_ns, .noise = amplitude, .fill = 0.9, .host_share = 0.5};
}

/* One frame; its time without noise, which is what the governor is there to hold. */
static double run(struct plant *plant, double target_ns, double hitch_ns)
{
    double budget = governor_photons(&plant->governor, LEAST, MOST);
    if (plant->budget > 0) {
        double step = budget / plant->budget;
        plant->largest_step = fmax(plant->largest_step, fmax(step, 1 / step));
        if (step != 1) {
            plant->turns += plant->last_step > 0 && (step > 1) != (plant->last_step > 1);
            plant->last_step = step;
        }
    }
    plant->budget = budget;
    double settled = plant->fill * budget;
    plant->emitted =
        plant->emitted > 0 && settled > plant->emitted ? 0.5 * (settled + plant->emitted) : settled;
    double most_rays = fmax(plant->most_rays, 1);
    uint32_t rays = governor_count(&plant->governor, GOVERNOR_RAYS, most_rays);
    plant->rays_changes += plant->rays > 0 && rays != plant->rays;
    plant->rays = rays;
    /* The lookup has a part that does not grow with the rays. */
    double rays_ns = plant->ray_ns * (4 + rays);
    double most_samples = fmax(plant->most_samples, 1);
    uint32_t samples = governor_count(&plant->governor, GOVERNOR_SAMPLES, most_samples);
    plant->samples_changes += plant->samples > 0 && samples != plant->samples;
    plant->samples = samples;
    double samples_ns = plant->sample_ns * (0.5 + samples);
    double time = plant->fixed_ns + rays_ns + samples_ns + plant->slope_ns * plant->emitted;
    double factor = 1 + plant->noise * noise();
    plant->changes += governor_step(
        &plant->governor, &(struct governor_frame){
                              .measured_ns = time * factor + hitch_ns,
                              .device_ns = (time - 0.5 * plant->host_share * plant->fixed_ns) * factor,
                              .photons_ns = (time - plant->host_share * plant->fixed_ns) * factor,
                              .target_ns = target_ns,
                              .emitted = plant->emitted,
                              .least = LEAST,
                              .most = MOST,
                              .knobs[GOVERNOR_RAYS] = {most_rays, rays_ns},
                              .knobs[GOVERNOR_SAMPLES] = {most_samples, samples_ns},
                              .is_at_rest = plant->is_at_rest,
                          });
    return time;
}

/* The first frame from which the time stays within 10 % of the target; the largest time over it. */
static uint32_t settle(struct plant *plant, double target_ns, uint32_t frames, double *largest)
{
    uint32_t settled = 0;
    *largest = 0;
    for (uint32_t i = 0; i < frames; i++) {
        double ratio = run(plant, target_ns, 0) / target_ns;
        if (fabs(ratio - 1) > 0.1)
            settled = i + 1;
        *largest = fmax(*largest, ratio);
    }
    return settled;
}

/* One that has had 30 frames to find what takes 10 ms. */
static struct plant settled_plant(double fixed_ns, double slope_ns, double amplitude)
{
    struct plant plant = plant_of(fixed_ns, slope_ns, amplitude);
    double largest;
    settle(&plant, 1e7, 30, &largest);
    return plant;
}

/* No frame is off the target by more than 10 %, with a hitch every 50. */
static void expect_held(struct plant *plant, double target_ns, int frames)
{
    for (int i = 0; i < frames; i++)
        assert_in_bound(fabs(run(plant, target_ns, i % 50 == 7 ? 5e7 : 0) / target_ns - 1), 0.1);
}

static void it_settles_from_a_cold_start(void **state)
{
    (void)state;
    for (int share = 1; share <= 9; share += 2)
        for (int k = 0; k < 5; k++) {
            /* The target takes 8 to 90 % of the photons that may be used; the first budget is 18 % of them.
             */
            const double parts[] = {0.08, 0.15, 0.3, 0.6, 0.9};
            double photons = 0.9 * MOST * parts[k], target = 1e7, largest;
            struct plant plant = plant_of(target * (1 - 0.1 * share), target * 0.1 * share / photons, 0.02);
            double first = run(&plant, target, 3e8) / target; /* pipelines are compiled */
            uint32_t settled = settle(&plant, target, 60, &largest);
            print_message(
                "%d0 %% in photons, target at %2.0f %% of them: settled after %u frames, largest %.3f\n",
                share, 100 * parts[k], settled, largest);
            assert_true(settled <= 16);
            assert_true(largest <= fmax(first, 1.1));
        }
}

/* Camera rays that would leave hardly any photons are given up; they come back when there is time again, and
 * do neither more than once. */
static void camera_rays_are_steered(void **state)
{
    (void)state;
    struct plant plant = plant_of(1e6, 100, 0.03);
    plant.most_rays = 12;
    plant.ray_ns = 6e5; /* all of them: 9.6 ms of 10 */
    double largest;
    uint32_t settled = settle(&plant, 1e7, 60, &largest);
    print_message("costly rays: settled after %u frames, %u rays, %.0f photons emitted, largest %.2f\n",
                  settled, plant.rays, plant.emitted, largest);
    assert_true(settled <= 24);
    assert_int_equal(plant.rays, 4);
    assert_true(plant.emitted > MOST / 8);
    plant.rays_changes = 0;
    expect_held(&plant, 1e7, 400);
    assert_int_equal(plant.rays_changes, 0);

    plant.ray_ns = 5e4; /* less glass in view */
    settle(&plant, 1e7, 60, &largest);
    assert_int_equal(plant.rays, 12);
    assert_int_equal(plant.rays_changes, 1);

    plant.ray_ns = 3e6; /* there is no time even for one */
    settle(&plant, 1e7, 60, &largest);
    assert_int_equal(plant.rays, 1);
    assert_true(plant.budget <= LEAST + 1);
    assert_int_equal(plant.rays_changes, 3);
}

/* Samples of splats as well, by quarters; of two that take time the dearer one gives way. */
static void samples_are_steered(void **state)
{
    (void)state;
    struct plant plant = plant_of(1e6, 100, 0.03);
    plant.most_samples = 8;
    plant.sample_ns = 1e6; /* all of them: 8.5 ms of 10 */
    double largest;
    uint32_t settled = settle(&plant, 1e7, 60, &largest);
    print_message("costly samples: settled after %u frames, %u samples, %.0f photons emitted\n", settled,
                  plant.samples, plant.emitted);
    assert_true(settled <= 24);
    assert_int_equal(plant.samples, 2);
    assert_true(plant.emitted > MOST / 8);
    plant.samples_changes = 0;
    expect_held(&plant, 1e7, 400);
    assert_int_equal(plant.samples_changes, 0);
    plant.sample_ns = 5e4;
    settle(&plant, 1e7, 60, &largest);
    assert_int_equal(plant.samples, 8);
    assert_int_equal(plant.samples_changes, 1);

    plant = plant_of(1e6, 100, 0.03);
    plant.most_samples = 4;
    plant.most_rays = 12;
    plant.sample_ns = 1.8e6; /* all: 8.1 ms */
    plant.ray_ns = 4e4;      /* all: 0.6 ms */
    settle(&plant, 1e7, 60, &largest);
    assert_int_equal(plant.samples, 1);
    assert_int_equal(plant.rays, 12);
}

static void noise_and_hitches_do_not_pump(void **state)
{
    (void)state;
    struct plant plant = settled_plant(3e6, 200, 0.04);
    uint32_t changes = plant.changes;
    expect_held(&plant, 1e7, 1000);
    print_message("1,000 frames with 4 %% noise and 20 hitches: %u changes of the budget\n",
                  plant.changes - changes);
    assert_true(plant.changes - changes <= 10);
}

/* Other programs take the machine: frames of the same work differ by up to a half. */
static void a_busy_machine_is_not_followed(void **state)
{
    (void)state;
    struct plant plant = plant_of(3e6, 200, 0.5);
    double mean = 0;
    for (int i = 0; i < 50; i++)
        run(&plant, 1e7, 0);
    uint32_t changes = plant.changes;
    plant.largest_step = 0;
    for (int i = 0; i < 1000; i++)
        mean += run(&plant, 1e7, 0) / 1e10;
    print_message(
        "50 %% noise: %u changes in 1,000 frames, largest step %.3f, mean time %.3f of the target\n",
        plant.changes - changes, plant.largest_step, mean);
    assert_true(plant.changes - changes <= 100);
    assert_in_bound(plant.largest_step, GOVERNOR_STEP + 1e-3);
    assert_in_bound(fabs(mean - 1), 0.1);
}

/* Slope and fixed part swing by 40 % along a path of 200 frames, 1.3 % a frame at most. */
static void a_path_is_followed_in_small_steps(void **state)
{
    (void)state;
    struct plant plant = settled_plant(3e6, 200, 0.02);
    double error = 0;
    plant.largest_step = 0;
    uint32_t outside = 0;
    for (int i = 0; i < 400; i++) {
        double swing = 1 + 0.4 * sin(6.2831853 * i / 200);
        plant.fixed_ns = 3e6 * swing;
        plant.slope_ns = 200 * swing;
        double off = fabs(run(&plant, 1e7, 0) / 1e7 - 1);
        error = fmax(error, off);
        outside += off > 0.1;
    }
    print_message(
        "path: largest error %.1f %%, %u of 400 frames above 10 %%, %u changes, largest step %.3f\n",
        100 * error, outside, plant.changes, plant.largest_step);
    assert_int_equal(outside, 0);
    assert_in_bound(plant.largest_step, GOVERNOR_STEP + 1e-3);
}

/* On a GPU: photons are a tenth of the time, the other work swings by 15 % along the path, and frames differ
 * by 2 %. A tenth of the target is all the photons there are: they go from few to many and back, once a
 * swing. */
static void little_of_the_time_does_not_pump(void **state)
{
    (void)state;
    struct plant plant = plant_of(9e6, 1e6 / (0.3 * MOST), 0.02);
    plant.host_share = 0.8;
    double largest;
    settle(&plant, 1e7, 30, &largest);
    plant.largest_step = plant.last_step = 0;
    plant.turns = 0;
    uint32_t outside = 0;
    for (int i = 0; i < 400; i++) {
        plant.fixed_ns = 9e6 * (1 + 0.15 * sin(6.2831853 * i / 200));
        outside += fabs(run(&plant, 1e7, i % 50 == 7 ? 5e6 : 0) / 1e7 - 1) > 0.1;
    }
    print_message("photons a tenth of the time: %u of 400 frames above 10 %%, %u changes, %u turns, largest "
                  "step %.2f\n",
                  outside, plant.changes, plant.turns, plant.largest_step);
    assert_in_bound(plant.turns, 4); /* the path's own */
    assert_in_bound(plant.largest_step, 2);
    assert_int_equal(outside, 0);
}

/* The caster leaves the picture for a while: nothing wants photons, and no budget says anything about time.
 */
static void a_picture_without_photons_keeps_the_budget(void **state)
{
    (void)state;
    struct plant plant = settled_plant(3e6, 200, 0.02);
    const double budget = plant.budget;
    for (int i = 0; i < 60; i++) {
        plant.fill = fmax(0.5 * plant.fill, 0.01);
        run(&plant, 1e7, 0);
    }
    plant.fill = 0.9;
    double largest;
    uint32_t settled = settle(&plant, 1e7, 60, &largest);
    print_message("out of view for 60 frames: budget %.0f, then %.0f; settled after %u, largest %.2f\n",
                  budget, plant.budget, settled, largest);
    assert_in_bound(largest, 1.1);
    assert_true(settled <= 6); /* densities follow by halves */
    assert_in_bound(fabs(plant.budget / budget - 1), 0.1);
}

/* Other programs hold up the copy to the host for ten frames, again and again: photons would not mend it.
 * What lasts is answered. */
static void a_host_that_is_held_up_is_waited_for(void **state)
{
    (void)state;
    struct plant plant = settled_plant(5e6, 200, 0.01);
    const double budget = plant.budget;
    double farthest = 1;
    for (int i = 0; i < 400; i++) {
        run(&plant, 1e7, i % 80 < 10 ? 7e6 * pow(0.7, i % 80) : 0);
        farthest = fmax(farthest, fmax(plant.budget / budget, budget / plant.budget));
    }
    print_message("held up 5 times: the budget is at most a factor of %.2f away\n", farthest);
    assert_in_bound(farthest, GOVERNOR_STEP);

    uint32_t last_outside = 0;
    for (uint32_t i = 0; i < 60; i++)
        if (fabs((run(&plant, 1e7, 2e6) + 2e6) / 1e7 - 1) > 0.1)
            last_outside = i + 1;
    print_message("and by 20 %% for good: settled after %u frames\n", last_outside);
    assert_true(last_outside <= 30);
}

static void it_settles_after_a_cut(void **state)
{
    (void)state;
    const double factors[] = {0.4, 0.75, 1.35, 2.5};
    for (int k = 0; k < 4; k++) {
        struct plant plant = settled_plant(2e6, 200, 0.02);
        plant.fixed_ns *= factors[k];
        plant.slope_ns *= factors[k];
        double largest;
        uint32_t settled = settle(&plant, 1e7, 60, &largest);
        print_message("cost times %.2f: settled after %u frames\n", factors[k], settled);
        assert_true(settled <= 8);
        assert_in_bound(largest, fmax(1.1, factors[k] * 1.11));
    }
}

static void limits_hold(void **state)
{
    (void)state;
    const struct {
        double target_ns, photons;
    } cases[] = {{1e3, LEAST}, {3.6e12, MOST}};
    for (int k = 0; k < 2; k++) {
        struct plant plant = plant_of(3e6, 200, 0.02);
        for (int i = 0; i < 40; i++)
            run(&plant, cases[k].target_ns, 0);
        assert_close(plant.budget, cases[k].photons, 0);
        uint32_t changes = plant.changes;
        for (int i = 0; i < 40; i++)
            run(&plant, cases[k].target_ns, 0);
        assert_int_equal(plant.changes, changes);
    }
}

static void rest_is_left_only_for_a_reason(void **state)
{
    (void)state;
    struct plant plant = settled_plant(3e6, 200, 0.02);
    uint32_t changes = plant.changes;
    plant.is_at_rest = true;
    for (int i = 0; i < 200; i++) {
        plant.fixed_ns = 3e6 + (i < 100 ? 0 : 3e5);
        run(&plant, 1e7, 0);
    }
    assert_int_equal(plant.changes, changes);
    plant.slope_ns *= 1.3;
    double largest;
    settle(&plant, 1e7, 30, &largest);
    assert_true(plant.changes > changes);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(it_settles_from_a_cold_start),
        cmocka_unit_test(camera_rays_are_steered),
        cmocka_unit_test(samples_are_steered),
        cmocka_unit_test(noise_and_hitches_do_not_pump),
        cmocka_unit_test(a_path_is_followed_in_small_steps),
        cmocka_unit_test(little_of_the_time_does_not_pump),
        cmocka_unit_test(a_picture_without_photons_keeps_the_budget),
        cmocka_unit_test(a_host_that_is_held_up_is_waited_for),
        cmocka_unit_test(it_settles_after_a_cut),
        cmocka_unit_test(limits_hold),
        cmocka_unit_test(a_busy_machine_is_not_followed),
        cmocka_unit_test(rest_is_left_only_for_a_reason),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
