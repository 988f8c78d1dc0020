/* pass_device.h: runs one shader of the renderer on small lists, for the comparison of a pass with its plain
 * C reference.
 *
 * Every list is uploaded, the shader dispatched once, and what it writes read back into the caller's memory.
 * Shaders are specialised as core/render/view.c does it.
 */
#ifndef PASS_DEVICE_H
#define PASS_DEVICE_H

#include "core/gpu/gpu.h"
#include "shaders/shared/render_layout.h"

struct pass_device;

/* Fails the running test when there is no device. */
struct pass_device *pass_device_create(void);
void pass_device_destroy(struct pass_device **device);

/* One for a whole test program: setup and teardown of a group of tests. */
extern struct pass_device *pass_shared;
int pass_shared_set_up(void **state);
int pass_shared_tear_down(void **state);

struct pass_list {
    uint32_t binding;
    enum gpu_access access; /* with GPU_WRITE, `data` gets the contents after the run */
    void *data;
    size_t size; /* bytes; 0 binds an empty list */
};

struct pass_run {
    const char *shader;
    uint32_t features;                  /* FEATURE_* */
    uint32_t split, density, aa, depth; /* ..._RULE, AA_*, DEPTH_*; 0 is the default of each */
    uint32_t phase;                     /* constant 8 */
    bool has_push;
    uint32_t push;
    uint32_t threads; /* rounded up to whole workgroups */
    const struct pass_list *lists;
    uint32_t list_count;
};

#define PASS_LISTS(...)                                                                                      \
    .lists = (const struct pass_list[]){__VA_ARGS__},                                                        \
    .list_count = sizeof((const struct pass_list[]){__VA_ARGS__}) / sizeof(struct pass_list)

/* Fails the running test on any error. */
void pass_device_run(struct pass_device *device, const struct pass_run *run);

/* A draw of triangles, cleared, blended and resolved; shaders are specialised by `aa` and `depth`. */
struct pass_draw {
    const char *vertex_shader, *fragment_shader;
    uint32_t aa, depth;
    uint32_t width, height, samples;
    bool per_sample;
    uint32_t vertices;
    const struct pass_list *lists;
    uint32_t list_count;
    vec4 *picture; /* gets width * height pixels */
};

void pass_device_draw(struct pass_device *device, const struct pass_draw *draw);

/* Samples a pixel of the device's multisampled RGBA32F. */
uint32_t pass_device_samples(const struct pass_device *device);

/* Value of a 64-bit fixed-point number kept as two words. */
static inline double pass_fixed(uint32_t low, uint32_t high)
{
    return (double)high * 4294967296.0 + (double)low;
}

/* The same numbers on every run, in [0, 1). */
double pass_random(uint64_t *state);
double pass_between(uint64_t *state, double low, double high);

/* Octahedral unit vector, 2 x 16 bits, as shaders/frame.glsl packs it; and floats by their bits. */
uint32_t pass_pack_normal(const double n[3]);
void pass_unpack_normal(uint32_t bits, double n[3]);
float pass_bits_float(uint32_t bits);
uint32_t pass_float_bits(float value);

/* Cells of a tile along the Morton curve: bits of x and y in turn, x first. */
uint32_t pass_morton(uint32_t x, uint32_t y);
void pass_morton_place(uint32_t code, uint32_t *x, uint32_t *y);

/* Words of a quadtree over `cells` leaves (a power of four), and its node sums made from tree[0..cells-1]. */
uint32_t pass_tree_size(uint32_t cells);
void pass_tree_fill(uint32_t *tree, uint32_t cells);

#endif
