/* bench_splat.c: how fast shaders/splat.comp draws photons, against instanced quads into RGBA32F.
 *
 * 250,000 ellipses of random size, direction and length lie on a tilted plane that fills 960 x 540 pixels.
 * Both ways test the same G-buffer and evaluate the same kernel; they run in turn, several rounds, and the
 * median of the rounds counts. `coherent` is the order of photons emitted along a Morton curve, `random` the
 * same shuffled. Every round of splat.comp must give the same bits, and both pictures the same flux.
 */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "bench/bench_shaders.h"
#include "bench/measure.h"
#include "core/gpu/gpu.h"
#include "shaders/shader_table.h"
#include "shaders/shared/render_layout.h"

#define WIDTH          960u
#define HEIGHT         540u
#define PIXELS         (WIDTH * HEIGHT)
#define PHOTONS        250000u
#define FOCAL_PX       800.0
#define DISTANCE       5.0
#define FILTER_RADIUS  0.75 /* px, the default setting */
#define MAX_ROUNDS     101u
#define FLUX_TOLERANCE 0.005

static const double plane_normal[3] = {0.08, -0.3, -0.95}; /* toward the camera; made unit where used */

/* ---- the picture's contents --------------------------------------------------------------------------- */

struct plane {
    double normal[3];
    uint32_t packed_normal;
};

static uint32_t random_state;

static double random_unit(void)
{
    random_state = random_state * 747796405u + 2891336453u;
    uint32_t word = ((random_state >> ((random_state >> 28) + 4)) ^ random_state) * 277803737u;
    return ((double)((word >> 22) ^ word) + 0.5) / 4294967296.0;
}

static double hold(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

static uint32_t snorm16(double value)
{
    return (uint32_t)(uint16_t)(int16_t)lrint(hold(value, -1, 1) * 32767);
}

/* As pack_normal of shaders/frame.glsl. */
static uint32_t pack_normal(const double n[3])
{
    double sum = fabs(n[0]) + fabs(n[1]) + fabs(n[2]);
    double x = n[0] / sum, y = n[1] / sum;
    if (n[2] < 0) {
        double folded_x = (1 - fabs(y)) * (x >= 0 ? 1 : -1);
        y = (1 - fabs(x)) * (y >= 0 ? 1 : -1);
        x = folded_x;
    }
    return snorm16(x) | snorm16(y) << 16;
}

static struct plane make_plane(void)
{
    struct plane plane;
    double length = sqrt(plane_normal[0] * plane_normal[0] + plane_normal[1] * plane_normal[1] +
                         plane_normal[2] * plane_normal[2]);
    for (int i = 0; i < 3; i++)
        plane.normal[i] = plane_normal[i] / length;
    plane.packed_normal = pack_normal(plane.normal);
    return plane;
}

/* The plane's point in a pixel, its normal in w. Camera space: x right, y down, z forward. */
static vec4 plane_point(const struct plane *plane, double x, double y)
{
    double ray[3] = {(x - WIDTH / 2.0) / FOCAL_PX, (y - HEIGHT / 2.0) / FOCAL_PX, 1};
    double along = plane->normal[0] * ray[0] + plane->normal[1] * ray[1] + plane->normal[2] * ray[2];
    double z = -DISTANCE / along;
    vec4 point = {(float)(ray[0] * z), (float)(ray[1] * z), (float)z, 0};
    memcpy(&point.w, &plane->packed_normal, sizeof point.w);
    return point;
}

/* A footprint's half axes before the pixel filter, px, for scale 1: sizes
 * within a factor of four and lengths up to sixteen widths. */
static void random_axes(double axes[2])
{
    double size = exp2(2 * random_unit() - 1), stretch = exp2(2 * random_unit());
    axes[0] = size * stretch;
    axes[1] = size / stretch;
}

static double mean_area(double scale)
{
    double sum = 0;
    random_state = 1;
    for (uint32_t i = 0; i < 4096; i++) {
        double axes[2];
        random_axes(axes);
        sum += M_PI * hypot(scale * axes[0], FILTER_RADIUS) * hypot(scale * axes[1], FILTER_RADIUS);
    }
    return sum / 4096;
}

/* The scale of footprints that makes their mean area `area_px2`, filter included. */
static double footprint_scale(double area_px2)
{
    double low = 0, high = 64;
    for (int i = 0; i < 60; i++) {
        double middle = 0.5 * (low + high);
        *(mean_area(middle) < area_px2 ? &low : &high) = middle;
    }
    return low;
}

static uint32_t every_other_bit(uint32_t code)
{
    uint32_t value = 0;
    for (uint32_t b = 0; b < 16; b++)
        value |= (code >> (2 * b) & 1) << b;
    return value;
}

static struct photon make_photon(const struct plane *plane, uint32_t index, double scale)
{
    uint32_t code = (uint32_t)((uint64_t)index * (1u << 18) / PHOTONS);
    double u = (every_other_bit(code) + random_unit()) / 512,
           v = (every_other_bit(code >> 1) + random_unit()) / 512;
    double x = WIDTH * (u + 0.03 * sin(9 * v)), y = HEIGHT * (v + 0.03 * sin(11 * u));
    double axes[2], angle = M_PI * random_unit();
    random_axes(axes);
    double a = hypot(scale * axes[0], FILTER_RADIUS), b = hypot(scale * axes[1], FILTER_RADIUS);
    double c = cos(angle), s = sin(angle);
    double cxx = a * a * c * c + b * b * s * s, cyy = a * a * s * s + b * b * c * c,
           cxy = (a * a - b * b) * c * s, determinant = a * a * b * b;

    struct photon photon = {.position = plane_point(plane, x, y)};
    /* 1 / depth is linear on screen: its slope over its value bends the ellipse. */
    double w[2];
    double depth = (double)photon.position.z;
    for (int i = 0; i < 2; i++)
        w[i] = -plane->normal[i] * depth / (FOCAL_PX * DISTANCE);
    double bend = sqrt(w[0] * w[0] * cxx + 2 * w[0] * w[1] * cxy + w[1] * w[1] * cyy);
    double u00 = sqrt(cyy / determinant);
    double peak = 2 / (M_PI * a * b);
    photon.ellipse = (vec4){(float)u00, (float)(-cxy / (determinant * u00)), (float)(1 / sqrt(cyy)),
                            (float)(sqrt(cyy) / (1 - bend))};
    photon.center = (vec4){(float)x, (float)y, (float)w[0], (float)w[1]};
    double red = 0.5 + random_unit(), green = 0.5 + random_unit(); /* used by the three-channel variant */
    photon.density =
        (vec4){(float)(peak * red), (float)(peak * green), (float)(peak * (3 - red - green)), 0.5f};
    return photon;
}

static struct photon *make_photons(const struct plane *plane, double area_px2, bool is_shuffled)
{
    struct photon *photons = measure_allocate(PHOTONS, sizeof *photons);
    double scale = footprint_scale(area_px2);
    random_state = 7;
    for (uint32_t i = 0; i < PHOTONS; i++)
        photons[i] = make_photon(plane, i, scale);
    for (uint32_t i = PHOTONS - 1; is_shuffled && i > 0; i--) {
        uint32_t other = (uint32_t)(random_unit() * (i + 1));
        struct photon kept = photons[i];
        photons[i] = photons[other];
        photons[other] = kept;
    }
    return photons;
}

/* ---- the two ways ------------------------------------------------------------------------------------- */

struct bench {
    struct gpu *gpu;
    struct plane plane;
    struct frame_gpu frame;
    struct gpu_buffer *frame_buffer, *targets, *counters, *photons, *pieces, *sums, *sums_read,
        *counters_read, *picture_read;
    struct gpu_pipeline *compute[2][2]; /* of one and three channels: photons, pieces */
    struct gpu_raster *raster;
};

static struct gpu_buffer *make_buffer(struct gpu *gpu, const char *name, size_t size, enum gpu_memory memory)
{
    struct error error;
    struct gpu_buffer *buffer = gpu_buffer_create(
        gpu, &(struct gpu_buffer_params){.name = name, .size = size, .memory = memory}, &error);
    if (!buffer)
        measure_die(&error);
    return buffer;
}

static void bench_create(struct bench *bench, const struct gpu_params *params)
{
    struct error error;
    *bench = (struct bench){.gpu = gpu_create(params, &error), .plane = make_plane()};
    if (!bench->gpu)
        measure_die(&error);
    struct gpu *gpu = bench->gpu;
    bench->frame = (struct frame_gpu){.width = WIDTH,
                                      .height = HEIGHT,
                                      .photon_capacity = PHOTONS,
                                      .irradiance_unit = 0x1p-26f,
                                      .tint = {1, 1, 1, 0}};
    vec4 *targets = measure_allocate(PIXELS, sizeof *targets);
    for (uint32_t i = 0; i < PIXELS; i++)
        targets[i] = plane_point(&bench->plane, i % WIDTH + 0.5, i / WIDTH + 0.5);
    bench->targets =
        gpu_buffer_create_filled(gpu, "targets", targets, PIXELS * sizeof *targets, false, &error);
    free(targets);
    bench->frame_buffer =
        gpu_buffer_create_filled(gpu, "frame", &bench->frame, sizeof bench->frame, false, &error);
    if (!bench->targets || !bench->frame_buffer)
        measure_die(&error);
    bench->counters = make_buffer(gpu, "counters", sizeof(struct counters_gpu), GPU_MEMORY_DEVICE);
    bench->counters_read =
        make_buffer(gpu, "counters read", sizeof(struct counters_gpu), GPU_MEMORY_READBACK);
    bench->photons = make_buffer(gpu, "photons", PHOTONS * sizeof(struct photon), GPU_MEMORY_DEVICE);
    bench->pieces = make_buffer(gpu, "pieces", 2 * PHOTONS * sizeof(struct splat_piece), GPU_MEMORY_DEVICE);
    bench->sums = make_buffer(gpu, "sums", PIXELS * 6 * sizeof(uint32_t), GPU_MEMORY_DEVICE);
    bench->sums_read = make_buffer(gpu, "sums read", PIXELS * 6 * sizeof(uint32_t), GPU_MEMORY_READBACK);
    bench->picture_read = make_buffer(gpu, "picture read", PIXELS * sizeof(vec4), GPU_MEMORY_READBACK);

    for (uint32_t i = 0; i < 2; i++) {
        for (uint32_t phase = 0; phase < 2; phase++) {
            const struct gpu_constant constants[] = {{CONSTANT_FEATURES, i ? FEATURE_CHROMATIC : 0},
                                                     {CONSTANT_AA, AA_FILTER},
                                                     {CONSTANT_DEPTH, DEPTH_PLANE},
                                                     {8, phase}};
            struct gpu_pipeline_params pipeline = {.name = "splat.comp",
                                                   .constants = constants,
                                                   .constant_count = 4,
                                                   .binding_mask = 1u << BINDING_FRAME | 31u << BINDING_PASS};
            pipeline.spirv = shader_find("splat.comp", &pipeline.spirv_bytes);
            bench->compute[i][phase] = gpu_pipeline_create(gpu, &pipeline, &error);
            if (!bench->compute[i][phase])
                measure_die(&error);
        }
    }
    const struct gpu_constant depth = {CONSTANT_DEPTH, DEPTH_PLANE};
    struct gpu_raster_params raster = {.name = "splat_quad",
                                       .constants = &depth,
                                       .constant_count = 1,
                                       .binding_mask = 1u << BINDING_FRAME | 6u << BINDING_PASS,
                                       .width = WIDTH,
                                       .height = HEIGHT};
    raster.vertex_spirv = bench_shader_find("splat_quad.vert", &raster.vertex_bytes);
    raster.fragment_spirv = bench_shader_find("splat_quad.frag", &raster.fragment_bytes);
    bench->raster = gpu_raster_create(gpu, &raster, &error);
    if (!bench->raster)
        measure_die(&error);
}

static void bench_destroy(struct bench *bench)
{
    gpu_raster_destroy(&bench->raster);
    for (uint32_t i = 0; i < 4; i++)
        gpu_pipeline_destroy(&bench->compute[i / 2][i % 2]);
    struct gpu_buffer **buffers[] = {&bench->frame_buffer, &bench->targets,       &bench->counters,
                                     &bench->photons,      &bench->pieces,        &bench->sums,
                                     &bench->sums_read,    &bench->counters_read, &bench->picture_read};
    for (size_t i = 0; i < sizeof buffers / sizeof *buffers; i++)
        gpu_buffer_destroy(buffers[i]);
    gpu_destroy(&bench->gpu);
}

static struct gpu_frame *begin(struct bench *bench)
{
    struct error error;
    struct gpu_frame *frame = gpu_frame_begin(bench->gpu, &error);
    if (!frame)
        measure_die(&error);
    return frame;
}

/* Milliseconds of the frame's only pass. */
static double finish(struct gpu_frame *frame)
{
    struct error error;
    if (!gpu_frame_submit(frame, &error) || !gpu_frame_wait(frame, &error))
        measure_die(&error);
    uint32_t count;
    uint64_t total_ns;
    const struct gpu_timing *timings = gpu_frame_timings(frame, &count, &total_ns);
    return 1e-6 * (double)timings[0].elapsed_ns;
}

/* What the renderer does: sums to zero, one thread a photon, then the pieces of wide ones. */
static double run_compute(struct bench *bench, bool is_chromatic)
{
    struct gpu_frame *frame = begin(bench);
    struct counters_gpu counters = {.photon_count = PHOTONS};
    size_t bytes = PIXELS * (is_chromatic ? 6 : 2) * sizeof(uint32_t);
    const struct gpu_bind binds[] = {
        {.binding = BINDING_FRAME, .access = GPU_READ, .buffer = bench->frame_buffer},
        {.binding = BINDING_PASS, .access = GPU_READ_WRITE, .buffer = bench->counters},
        {.binding = BINDING_PASS + 1, .access = GPU_READ, .buffer = bench->targets},
        {.binding = BINDING_PASS + 2, .access = GPU_READ, .buffer = bench->photons},
        {.binding = BINDING_PASS + 3, .access = GPU_READ_WRITE, .buffer = bench->sums},
        {.binding = BINDING_PASS + 4, .access = GPU_READ_WRITE, .buffer = bench->pieces}};
    gpu_record_upload(frame, bench->counters, 0, &counters, sizeof counters);
    gpu_pass_begin(frame, "splat");
    gpu_record_fill(frame, bench->sums, 0, bytes, 0);
    for (uint32_t phase = 0; phase < 2; phase++)
        gpu_record_dispatch(
            frame,
            &(struct gpu_dispatch){.pipeline = bench->compute[is_chromatic][phase],
                                   .binds = binds,
                                   .bind_count = sizeof binds / sizeof *binds,
                                   .groups = {phase ? 1024 : (PHOTONS + GROUP_SIZE - 1) / GROUP_SIZE, 1, 1}});
    gpu_pass_end(frame);
    gpu_record_copy(frame, bench->sums_read, 0, bench->sums, 0, bytes);
    gpu_record_copy(frame, bench->counters_read, 0, bench->counters, 0, sizeof counters);
    return finish(frame);
}

static double run_raster(struct bench *bench)
{
    struct gpu_frame *frame = begin(bench);
    const struct gpu_bind binds[] = {
        {.binding = BINDING_FRAME, .access = GPU_READ, .buffer = bench->frame_buffer},
        {.binding = BINDING_PASS + 1, .access = GPU_READ, .buffer = bench->targets},
        {.binding = BINDING_PASS + 2, .access = GPU_READ, .buffer = bench->photons}};
    gpu_pass_begin(frame, "quads");
    gpu_record_draw(frame, &(struct gpu_draw){.raster = bench->raster,
                                              .binds = binds,
                                              .bind_count = 3,
                                              .vertex_count = 6,
                                              .instance_count = PHOTONS});
    gpu_pass_end(frame);
    gpu_record_raster_read(frame, bench->raster, bench->picture_read);
    return finish(frame);
}

/* ---- table -------------------------------------------------------------------------------------------- */

/* Both pictures' flux, the channels' mean, px of unit irradiance. */
static double compute_flux(struct bench *bench, bool is_chromatic)
{
    const uint32_t *sums = gpu_buffer_map(bench->sums_read);
    uint32_t channels = is_chromatic ? 3 : 1;
    double flux = 0;
    for (uint32_t i = 0; i < PIXELS * channels; i++)
        flux += ((double)sums[2 * i + 1] * 4294967296.0 + (double)sums[2 * i]) *
                (double)bench->frame.irradiance_unit;
    return flux / channels;
}

static double raster_flux(struct bench *bench)
{
    const vec4 *picture = gpu_buffer_map(bench->picture_read);
    double flux = 0;
    for (uint32_t i = 0; i < PIXELS; i++)
        flux += ((double)picture[i].x + (double)picture[i].y + (double)picture[i].z) / 3;
    return flux;
}

static bool measure(struct bench *bench, double area_px2, bool is_shuffled, uint32_t rounds)
{
    struct photon *photons = make_photons(&bench->plane, area_px2, is_shuffled);
    struct gpu_frame *frame = begin(bench);
    gpu_pass_begin(frame, "photons");
    gpu_record_upload(frame, bench->photons, 0, photons, PHOTONS * sizeof *photons);
    gpu_pass_end(frame);
    finish(frame);
    free(photons);

    double times[3][MAX_ROUNDS], flux[3] = {0};
    uint32_t *first[2] = {measure_allocate(PIXELS * 2, sizeof(uint32_t)),
                          measure_allocate(PIXELS * 6, sizeof(uint32_t))};
    bool is_same = true;
    double pixels_inside = 0, evaluations = 0;
    for (uint32_t round = 0; round < rounds + 1; round++) /* the first, which compiles, does not count */
        for (uint32_t way = 0; way < 3; way++) {
            double elapsed_ms = way < 2 ? run_compute(bench, way == 1) : run_raster(bench);
            if (round > 0)
                times[way][round - 1] = elapsed_ms;
            if (way < 2) {
                const void *sums = gpu_buffer_map(bench->sums_read);
                size_t bytes = PIXELS * (way ? 6 : 2) * sizeof(uint32_t);
                if (round == 0)
                    memcpy(first[way], sums, bytes);
                is_same = is_same && memcmp(first[way], sums, bytes) == 0;
                const struct counters_gpu *counters = gpu_buffer_map(bench->counters_read);
                evaluations = counters->count[COUNT_KERNEL];
                pixels_inside = counters->count[COUNT_KERNEL_INSIDE];
            }
            if (round == 0)
                flux[way] = way < 2 ? compute_flux(bench, way == 1) : raster_flux(bench);
        }
    free(first[0]);
    free(first[1]);
    double quads = measure_median(times[2], rounds), one = measure_median(times[0], rounds),
           three = measure_median(times[1], rounds);
    double off = fmax(fabs(flux[0] / flux[2] - 1), fabs(flux[1] / flux[2] - 1));
    printf("| %.0f px, %s | %.1f | %.2f | %.1f | %.1f | %.1f | %.2f | %.2f | %.1e | %s |\n", area_px2,
           is_shuffled ? "random" : "coherent", pixels_inside / PHOTONS, evaluations / pixels_inside, quads,
           one, three, quads / one, quads / three, off, is_same ? "yes" : "NO");
    fflush(stdout);
    return is_same && off < FLUX_TOLERANCE;
}

static const char usage[] = "usage: bench-splat [--device NAME] [--rounds N]\n"
                            "Milliseconds to draw 250,000 photons at 960x540: instanced quads into RGBA32F, "
                            "and shaders/splat.comp with\n"
                            "one and with three channels: medians of N alternating rounds (15). Ends with 1 "
                            "when two runs differ in a bit\n"
                            "or the two ways in flux by 0.5 %.\n";

int main(int argc, char **argv)
{
    struct gpu_params params = {0};
    uint32_t rounds = 15;
    bool is_help = argc == 2 && strcmp(argv[1], "--help") == 0, is_good = argc % 2 == 1;
    for (int i = 1; i + 1 < argc; i += 2) {
        if (strcmp(argv[i], "--device") == 0)
            params.device = argv[i + 1];
        else if (strcmp(argv[i], "--rounds") == 0)
            rounds = (uint32_t)strtoul(argv[i + 1], NULL, 10);
        else
            is_good = false;
    }
    if (!is_good || rounds < 1 || rounds > MAX_ROUNDS) {
        fputs(usage, is_help ? stdout : stderr);
        return is_help ? 0 : 2;
    }
    struct bench bench;
    bench_create(&bench, &params);
    if (gpu_info(bench.gpu)->timestamp_period_ns <= 0)
        measure_die(&(struct error){STATUS_UNSUPPORTED, "the device has no timestamps"});
    printf("%s, %s, %u rounds\n\n", gpu_info(bench.gpu)->name, gpu_info(bench.gpu)->driver, rounds);
    puts("| mean ellipse, order | pixels inside | evaluations per pixel inside | quads, ms | splat, ms | "
         "splat rgb, ms "
         "| quads / splat | quads / splat rgb | flux differs by | same bits |");
    puts("|---|---|---|---|---|---|---|---|---|---|");
    const double areas[] = {4, 16, 64};
    bool passed = true;
    for (int order = 0; order < 2; order++)
        for (size_t i = 0; i < sizeof areas / sizeof *areas; i++)
            passed = measure(&bench, areas[i], order == 1, rounds) && passed;
    bench_destroy(&bench);
    return passed ? 0 : 1;
}
