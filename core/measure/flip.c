#include "flip.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A pixel's colour is carried as y, x - y and y - z, with x, y and z relative to the white point: Cx and Cz
 * of YCxCz over 500 and 200, and Y without its offset. Every filter sums to 1, so the offset comes back by
 * itself.
 *
 * Rows are streamed: each is converted and filtered across once, into rings of as many rows as the filters
 * are high, and filtered down from there. Filters are even or odd, so that two taps share a product. */

#define DEFAULT_PIXELS_PER_DEGREE (3840 * (double)M_PI / 180)
#define COLOR_EXPONENT            0.7  /* q_c of the paper */
#define FEATURE_EXPONENT          0.5  /* q_f */
#define KNEE_IN                   0.4  /* p_c: this share of the largest difference ... */
#define KNEE_OUT                  0.95 /* p_t: ... uses this share of the output */
#define STRIP                     512u /* columns, whole blocks of a convolution; rings of 1 MB at 67 pixels per degree */
#define EDGE_WIDTH                0.082 /* w, degrees */

/* ---- filters ------------------------------------------------------------------------------------------- */

/* Half of a filter, from its centre outward. Odd ones are negative on the far side. */
struct filter {
    uint32_t radius;
    float *taps; /* radius + 1 */
};

enum filter_name {
    FILTER_Y,   /* contrast sensitivity, achromatic */
    FILTER_CX,  /* red-green */
    FILTER_CZ1, /* blue-yellow is a sum of two Gaussians: each is separable, the sum is not */
    FILTER_CZ2,
    FILTER_BLUR,  /* features: a Gaussian, */
    FILTER_POINT, /* its second derivative */
    FILTER_EDGE,  /* and its first, which is odd */
    FILTER_COUNT
};

struct filters {
    struct filter each[FILTER_COUNT];
    uint32_t radius; /* the largest */
    float *memory;
};

/* exp(-pi^2 x^2 / b) is the kernel of the paper's exp(-b f^2) in frequency, f in cycles per degree. */
static double contrast_gaussian(double degrees, double b)
{
    return exp(-M_PI * M_PI * degrees * degrees / b);
}

static bool filters_create(struct filters *filters, double pixels_per_degree, struct error *error)
{
    /* a1, b1, a2, b2 of table 1; the largest scale decides the size of all of them. */
    const double b_y = 0.0047, b_cx = 0.0053, a_cz1 = 34.1, b_cz1 = 0.04, a_cz2 = 13.5, b_cz2 = 0.025;
    double deviation = 0.5 * EDGE_WIDTH * pixels_per_degree;
    uint32_t contrast_radius = (uint32_t)ceil(3 * sqrt(b_cz1 / (2 * M_PI * M_PI)) * pixels_per_degree);
    uint32_t feature_radius = (uint32_t)ceil(3 * deviation);
    filters->radius = contrast_radius > feature_radius ? contrast_radius : feature_radius;
    filters->memory = calloc((size_t)FILTER_COUNT * (filters->radius + 1), sizeof *filters->memory);
    double *wide = calloc((size_t)FILTER_COUNT * (filters->radius + 1), sizeof *wide);
    if (!filters->memory || !wide) {
        free(wide);
        return error_set(error, STATUS_MEMORY, "no memory for FLIP's filters");
    }

    double *tap[FILTER_COUNT];
    for (uint32_t name = 0; name < FILTER_COUNT; name++) {
        tap[name] = wide + name * (filters->radius + 1);
        filters->each[name].radius = name < FILTER_BLUR ? contrast_radius : feature_radius;
        filters->each[name].taps = filters->memory + name * (filters->radius + 1);
    }
    for (uint32_t i = 0; i <= contrast_radius; i++) {
        double degrees = i / pixels_per_degree;
        tap[FILTER_Y][i] = contrast_gaussian(degrees, b_y);
        tap[FILTER_CX][i] = contrast_gaussian(degrees, b_cx);
        tap[FILTER_CZ1][i] = sqrt(a_cz1 * sqrt(M_PI / b_cz1)) * contrast_gaussian(degrees, b_cz1);
        tap[FILTER_CZ2][i] = sqrt(a_cz2 * sqrt(M_PI / b_cz2)) * contrast_gaussian(degrees, b_cz2);
    }
    for (uint32_t i = 0; i <= feature_radius; i++) {
        double x = i / deviation, gaussian = exp(-0.5 * x * x);
        tap[FILTER_BLUR][i] = gaussian;
        tap[FILTER_EDGE][i] = i * gaussian;
        tap[FILTER_POINT][i] = (x * x - 1) * gaussian;
    }

    /* Gaussians sum to 1, and so do the positive and the negative part of each derivative. The two of the
     * blue-yellow filter do so as a sum of products. */
    double above[FILTER_COUNT] = {0}, below[FILTER_COUNT] = {0};
    for (uint32_t name = 0; name < FILTER_COUNT; name++)
        for (uint32_t i = 0; i <= filters->each[name].radius; i++) {
            double sides = i && name != FILTER_EDGE ? 2 : 1;
            *(tap[name][i] > 0 ? &above[name] : &below[name]) += sides * fabs(tap[name][i]);
        }
    above[FILTER_CZ1] = above[FILTER_CZ2] = hypot(above[FILTER_CZ1], above[FILTER_CZ2]);
    for (uint32_t name = 0; name < FILTER_COUNT; name++)
        for (uint32_t i = 0; i <= filters->each[name].radius; i++)
            if (tap[name][i] != 0)
                filters->each[name].taps[i] =
                    (float)(tap[name][i] / (tap[name][i] > 0 ? above[name] : below[name]));
    free(wide);

    /* The narrow ones end where their weights are below a float's last digit. */
    for (uint32_t name = FILTER_Y; name <= FILTER_CX; name++)
        while (filters->each[name].radius > 1 && filters->each[name].taps[filters->each[name].radius] < 1e-9f)
            filters->each[name].radius--;
    return true;
}

/* ---- convolutions -------------------------------------------------------------------------------------- */

#define LANES     8u
#define MAX_BLOCK 4u /* vectors that a convolution does at a time; rows are padded to as many */
typedef float lanes __attribute__((vector_size(LANES * sizeof(float)), aligned(sizeof(float)), may_alias));

#define READ(from)      (*(const lanes *)(from))
#define WRITE(to, what) (*(lanes *)(to) = (what))

/* Compiled once more for processors with wide registers, and chosen when the program is loaded. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
#define WIDE __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define WIDE
#endif

/* Weighs rows by filters, `even_count` even ones and one that is odd or NULL. rows[-radius] to rows[radius]
 * are the places that the taps go with: shifts of one row, or the rows above and below it. `block` vectors
 * are done at a time, as many as have room in registers. */
static inline __attribute__((always_inline)) void convolve(const float *const *rows, uint32_t radius,
                                                           const float *const *even, uint32_t even_count,
                                                           const float *odd, uint32_t block, float *const *to,
                                                           uint32_t width)
{
    for (uint32_t x = 0; x < width; x += block * LANES) {
        lanes sums[3][MAX_BLOCK] = {0};
        for (uint32_t j = 0; j < block; j++)
            for (uint32_t i = 0; i < even_count; i++)
                sums[i][j] = even[i][0] * READ(rows[0] + x + j * LANES);
        for (int k = 1; k <= (int)radius; k++) {
            const float *above = rows[-k] + x, *below = rows[k] + x;
            for (uint32_t j = 0; j < block; j++) {
                lanes both = READ(below + j * LANES) + READ(above + j * LANES);
                for (uint32_t i = 0; i < even_count; i++)
                    sums[i][j] += even[i][k] * both;
                if (odd)
                    sums[even_count][j] += odd[k] * (READ(below + j * LANES) - READ(above + j * LANES));
            }
        }
        for (uint32_t j = 0; j < block; j++)
            for (uint32_t i = 0; i < even_count + (odd ? 1 : 0); i++)
                WRITE(to[i] + x + j * LANES, sums[i][j]);
    }
}

WIDE static void convolve_even(const float *const *rows, const struct filter *even, float *to, uint32_t width)
{
    convolve(rows, even->radius, (const float *const[]){even->taps}, 1, NULL, MAX_BLOCK, (float *const[]){to},
             width);
}

WIDE static void convolve_two(const float *const *rows, const struct filter *one, const struct filter *other,
                              float *const *to, uint32_t width)
{
    convolve(rows, one->radius, (const float *const[]){one->taps, other->taps}, 2, NULL, 2, to, width);
}

WIDE static void convolve_even_odd(const float *const *rows, const struct filter *even,
                                   const struct filter *odd, float *const *to, uint32_t width)
{
    convolve(rows, even->radius, (const float *const[]){even->taps}, 1, odd->taps, 2, to, width);
}

WIDE static void convolve_two_odd(const float *const *rows, const struct filter *one,
                                  const struct filter *other, const struct filter *odd, float *const *to,
                                  uint32_t width)
{
    convolve(rows, one->radius, (const float *const[]){one->taps, other->taps}, 2, odd->taps, 2, to, width);
}

/* ---- colour -------------------------------------------------------------------------------------------- */

/* Linear Rec. 709 to XYZ, and the white point that the authors divide by. */
static const double rgb_to_xyz[3][3] = {
    {10135552.0 / 24577794, 8788810.0 / 24577794, 4435075.0 / 24577794},
    {2613072.0 / 12288897, 8788810.0 / 12288897, 887015.0 / 12288897},
    {1425312.0 / 73733382, 8788810.0 / 73733382, 70074185.0 / 73733382},
};
static const double white_xyz[3] = {0.950428545, 1, 1.088900371};

struct color {
    float to_white[3][3];   /* linear RGB to XYZ over the white point */
    float from_white[3][3]; /* back */
    float largest;          /* the largest colour difference, raised to q_c: green against blue */
};

static void invert(const double m[3][3], double inverse[3][3])
{
    double determinant = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
            inverse[j][i] = m[i1][j1] * m[i2][j2] - m[i1][j2] * m[i2][j1];
        }
    for (int j = 0; j < 3; j++)
        determinant += m[0][j] * inverse[j][0];
    for (int i = 0; i < 9; i++)
        inverse[i / 3][i % 3] /= determinant;
}

static inline void transform(const float m[3][3], const float from[3], float to[3])
{
    for (int i = 0; i < 3; i++)
        to[i] = m[i][0] * from[0] + m[i][1] * from[1] + m[i][2] * from[2];
}

/* The next four are arithmetic alone, so that a loop over them is turned into vectors; 2e-7 off at most. */

static inline float float_from_bits(int32_t bits)
{
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline int32_t bits_of_float(float value)
{
    int32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* Of normal numbers above 0: the exponent, and a series in z = (m - 1) / (m + 1) for m from 1/sqrt 2 to
 * sqrt 2. */
static inline float log2_of(float value)
{
    const int32_t root_half = 0x3f3504f3;
    int32_t bits = bits_of_float(value), exponent = (bits - root_half) >> 23;
    float m = float_from_bits(bits - exponent * (1 << 23)), z = (m - 1) / (m + 1), z2 = z * z;
    float series = 2.8853900818f + z2 * (0.9617966939f + z2 * (0.5770780164f + z2 * 0.4121985831f));
    return (float)exponent + z * series;
}

/* From -126 to 127: the nearest integer to the exponent, and a series for the rest. */
static inline float exp2_of(float value)
{
    const float shifter = 12582912; /* 1.5 * 2^23: its last digit is 1 */
    float shifted = value + shifter, rest = value - (shifted - shifter);
    int32_t scale = (bits_of_float(shifted) - bits_of_float(shifter) + 127) * (1 << 23);
    float series =
        1 + rest * (0.69314718056f +
                    rest * (0.24022650696f +
                            rest * (0.055504108665f +
                                    rest * (0.0096181291076f +
                                            rest * (0.0013333558146f + rest * 0.00015403530393f)))));
    return series * float_from_bits(scale);
}

/* `value` from 0 on: 0 stays 0. */
static inline float power_of(float value, float exponent)
{
    float logarithm = exponent * log2_of(value > 1e-30f ? value : 1e-30f);
    float power = exp2_of(logarithm > -126 ? logarithm : -126);
    return value > 1e-30f ? power : 0;
}

/* Of normal numbers above 0: a third of the exponent, then two steps of Halley's rule, each of which cubes
 * the error of 3 % that is there at first. */
static inline float cube_root_of(float value)
{
    float root = float_from_bits((int32_t)((float)bits_of_float(value) * (1.0f / 3)) + 709921077);
    for (int i = 0; i < 2; i++) {
        float cube = root * root * root;
        root *= (cube + 2 * value) / (2 * cube + value);
    }
    return root;
}

static inline float lab_curve(float value)
{
    const float delta = 6.0f / 29, bend = delta * delta * delta;
    float root = cube_root_of(value > bend ? value : bend);
    return value > bend ? root : value * (1 / (3 * delta * delta)) + 4.0f / 29;
}

static inline float clamp01(float value)
{
    return value > 0 ? (value < 1 ? value : 1) : 0;
}

/* Linear RGB in 0..1 to CIELAB with Hunt's adjustment: colours look stronger where they are brighter. */
static inline void hunt_lab(const float to_white[3][3], const float rgb[3], float lab[3])
{
    float xyz[3];
    transform(to_white, rgb, xyz);
    for (int i = 0; i < 3; i++)
        xyz[i] = lab_curve(xyz[i]);
    lab[0] = 116 * xyz[1] - 16;
    lab[1] = 5 * lab[0] * (xyz[0] - xyz[1]);
    lab[2] = 2 * lab[0] * (xyz[1] - xyz[2]);
}

/* HyAB, raised to q_c. */
static inline float lab_distance(const float a[3], const float b[3])
{
    float lightness = fabsf(a[0] - b[0]), red = a[1] - b[1], yellow = a[2] - b[2];
    return power_of(lightness + sqrtf(red * red + yellow * yellow), (float)COLOR_EXPONENT);
}

static void color_prepare(struct color *color)
{
    double to_white[3][3], from_white[3][3];
    for (int i = 0; i < 9; i++)
        to_white[i / 3][i % 3] = rgb_to_xyz[i / 3][i % 3] / white_xyz[i / 3];
    invert(to_white, from_white);
    for (int i = 0; i < 9; i++) {
        color->to_white[i / 3][i % 3] = (float)to_white[i / 3][i % 3];
        color->from_white[i / 3][i % 3] = (float)from_white[i / 3][i % 3];
    }
    float green[3], blue[3];
    hunt_lab(color->to_white, (const float[3]){0, 1, 0}, green);
    hunt_lab(color->to_white, (const float[3]){0, 0, 1}, blue);
    color->largest = lab_distance(green, blue);
}

/* ---- exposures ----------------------------------------------------------------------------------------- */

/* The ACES curve with its pre-exposure of 0.6 undone: (k0 x^2 + k1 x) / (k2 x^2 + k3 x + k4). In floats and
 * in this order as the authors do it, since the number of exposures is the ceiling of a difference of
 * logarithms, and pictures whose brightest pixel is a power of two times the median are not rare. */
static const float aces[5] = {0.6f * 0.6f * 2.51f, 0.6f * 0.03f, 0.6f * 0.6f * 2.43f, 0.6f * 0.59f, 0.14f};

static inline float tone_map(float value)
{
    float x = value > 0 ? value < 1e9f ? value : 1e9f : 0; /* its square stays a float */
    float mapped = (x * x * aces[0] + x * aces[1]) / (x * x * aces[2] + x * aces[3] + aces[4]);
    return mapped < 1 ? mapped : 1;
}

bool flip_exposures_of(const struct measure_image *reference, struct flip_exposures *exposures,
                       struct error *error)
{
    size_t pixels = (size_t)reference->width * reference->height, dark = 0;
    float *luminances = malloc((pixels ? pixels : 1) * sizeof *luminances), brightest = 0;
    *exposures = (struct flip_exposures){.count = 2};
    if (!luminances)
        return error_set(error, STATUS_MEMORY, "no memory for %zu luminances", pixels);
    for (size_t i = 0; i < pixels; i++) {
        const float *value = reference->values + i * reference->components;
        luminances[i] = reference->components < 3
                            ? value[0]
                            : 0.2126f * value[0] + 0.7152f * value[1] + 0.0722f * value[2];
        dark += luminances[i] > 0 ? 0 : 1;
        brightest = luminances[i] > brightest ? luminances[i] : brightest;
    }
    if (dark < pixels) {
        size_t rank = pixels / 2 >= dark ? pixels / 2 - dark : (pixels - dark) / 2;
        float median = measure_rank_above_zero(luminances, pixels, rank);
        if (isnan(median)) {
            free(luminances);
            return error_set(error, STATUS_MEMORY, "no memory for the median of %zu luminances", pixels);
        }
        /* Where the curve reaches 0.85: a x^2 + b x + c = 0. */
        float a = aces[0] - 0.85f * aces[2], b = aces[1] - 0.85f * aces[3], c = -0.85f * aces[4];
        float half = -0.5f * (b / a), bright = half + sqrtf(half * half - c / a);
        float start = (float)log2((double)(bright / brightest));
        float stop = (float)log2((double)(bright / median));
        *exposures =
            (struct flip_exposures){(double)start, (double)stop, (uint32_t)fmaxf(2, ceilf(stop - start))};
    }
    free(luminances);
    return true;
}

/* ---- rows ---------------------------------------------------------------------------------------------- */

enum plane { PLANE_Y, PLANE_CX, PLANE_CZ, PLANE_COUNT };
enum feature { EDGE_X, POINT_X, POINT_Y, EDGE_Y, FEATURE_COUNT }; /* the last two come from one convolution */

/* One of the two images on its way through the filters. */
struct stream {
    float *line[PLANE_COUNT];  /* the row being filtered across, repeated at both ends */
    float *ring[FILTER_COUNT]; /* ring_height rows; row y is at y % ring_height */
    float *color[PLANE_COUNT]; /* one row, filtered both ways; then CIELAB */
    float *feature[FEATURE_COUNT];
    float *scratch;
};

struct comparison {
    struct filters filters;
    struct color color;
    struct stream streams[2];
    const float **rows; /* 2 * radius + 1, for convolve */
    uint32_t width, height, pad, ring_height;
    uint32_t first, strip, stride; /* this strip's first column and columns; those, padded to whole blocks */
    float *memory;
};

static bool comparison_create(struct comparison *work, uint32_t width, uint32_t height,
                              double pixels_per_degree, struct error *error)
{
    if (!filters_create(&work->filters, pixels_per_degree, error))
        return false;
    color_prepare(&work->color);
    work->width = width;
    work->height = height;
    work->stride =
        width < STRIP ? (width + MAX_BLOCK * LANES - 1) / (MAX_BLOCK * LANES) * (MAX_BLOCK * LANES) : STRIP;
    work->pad = work->filters.radius;
    work->ring_height = 2 * work->filters.radius + 1;
    size_t line = (size_t)work->stride + 2 * work->pad;
    size_t rows = FILTER_COUNT * (size_t)work->ring_height + PLANE_COUNT + FEATURE_COUNT + 1;
    size_t each = PLANE_COUNT * line + rows * work->stride;
    work->memory = calloc(2 * each, sizeof *work->memory);
    work->rows = calloc(work->ring_height, sizeof *work->rows);
    if (!work->memory || !work->rows)
        return error_set(error, STATUS_MEMORY, "no memory for FLIP of %u pixels a row", width);
    for (uint32_t side = 0; side < 2; side++) {
        struct stream *stream = &work->streams[side];
        float *next = work->memory + side * each;
        for (uint32_t i = 0; i < PLANE_COUNT; i++, next += line)
            stream->line[i] = next + work->pad;
        for (uint32_t i = 0; i < FILTER_COUNT; i++, next += (size_t)work->ring_height * work->stride)
            stream->ring[i] = next;
        for (uint32_t i = 0; i < PLANE_COUNT; i++, next += work->stride)
            stream->color[i] = next;
        for (uint32_t i = 0; i < FEATURE_COUNT; i++, next += work->stride)
            stream->feature[i] = next;
        stream->scratch = next;
    }
    return true;
}

static void comparison_destroy(struct comparison *work)
{
    free(work->filters.memory);
    free(work->rows);
    free(work->memory);
}

/* What is shown of `values`, as y, x - y and y - z. */
static inline __attribute__((always_inline)) void
show(const float to_white[3][3], const float *restrict values, uint32_t components, bool is_hdr, float gain,
     uint32_t width, float *restrict y, float *restrict cx, float *restrict cz)
{
    uint32_t green = components < 3 ? 0 : 1, blue = components < 3 ? 0 : 2;
    for (uint32_t x = 0; x < width; x++) {
        const float *value = values + (size_t)x * components;
        float rgb[3] = {value[0], value[green], value[blue]}, xyz[3];
        for (uint32_t c = 0; c < 3; c++)
            rgb[c] = is_hdr ? tone_map(rgb[c] * gain) : clamp01(rgb[c]);
        transform(to_white, rgb, xyz);
        y[x] = xyz[1];
        cx[x] = xyz[0] - xyz[1];
        cz[x] = xyz[1] - xyz[2];
    }
}

/* `gain` 0: clamped to 0..1; else exposed by it and tone-mapped. */
WIDE static void show_row(const struct color *color, const float *values, uint32_t components, float gain,
                          uint32_t width, float *y, float *cx, float *cz)
{
    const struct color local = *color;
    if (components == 3 && gain > 0)
        show(local.to_white, values, 3, true, gain, width, y, cx, cz);
    else if (components == 3)
        show(local.to_white, values, 3, false, gain, width, y, cx, cz);
    else
        show(local.to_white, values, 1, gain > 0, gain, width, y, cx, cz);
}

/* The strip's part of row y, and `pad` pixels beyond on either side: the image's own as far as it goes. */
static void read_row(const struct comparison *work, const struct measure_image *image, uint32_t y, float gain,
                     struct stream *stream)
{
    uint32_t end = work->first + work->strip;
    uint32_t left = work->pad < work->first ? work->pad : work->first;
    uint32_t right = work->pad < work->width - end ? work->pad : work->width - end;
    uint32_t width = left + work->strip + right;
    const float *values = image->values + ((size_t)y * work->width + work->first - left) * image->components;
    float *const *line = stream->line;
    show_row(&work->color, values, image->components, gain, width, line[PLANE_Y] - left,
             line[PLANE_CX] - left, line[PLANE_CZ] - left);
    for (uint32_t plane = 0; plane < PLANE_COUNT; plane++) {
        float *first = line[plane] - left, *last = first + width - 1;
        for (uint32_t i = 1; i <= work->pad - left; i++)
            *(first - i) = *first;
        for (uint32_t i = 1; i <= work->pad - right; i++)
            last[i] = *last;
    }
}

static void filter_across(const struct comparison *work, uint32_t y, struct stream *stream)
{
    const struct filter *filter = work->filters.each;
    const float **rows = work->rows + work->pad;
    float *to[FILTER_COUNT];
    int pad = (int)work->pad;
    for (uint32_t name = 0; name < FILTER_COUNT; name++)
        to[name] = stream->ring[name] + (size_t)(y % work->ring_height) * work->stride;
    for (int k = -pad; k <= pad; k++)
        rows[k] = stream->line[PLANE_Y] + k;
    convolve_even(rows, &filter[FILTER_Y], to[FILTER_Y], work->stride);
    convolve_two_odd(rows, &filter[FILTER_BLUR], &filter[FILTER_POINT], &filter[FILTER_EDGE],
                     &to[FILTER_BLUR], work->stride);
    for (int k = -pad; k <= pad; k++)
        rows[k] = stream->line[PLANE_CX] + k;
    convolve_even(rows, &filter[FILTER_CX], to[FILTER_CX], work->stride);
    for (int k = -pad; k <= pad; k++)
        rows[k] = stream->line[PLANE_CZ] + k;
    convolve_two(rows, &filter[FILTER_CZ1], &filter[FILTER_CZ2], &to[FILTER_CZ1], work->stride);
}

/* The rows about y of what was filtered across by `name`. */
static const float *const *rows_about(const struct comparison *work, const struct stream *stream,
                                      enum filter_name name, uint32_t y)
{
    int64_t last = (int64_t)work->height - 1, pad = (int64_t)work->pad;
    for (int64_t k = -pad; k <= pad; k++) {
        int64_t row = (int64_t)y + k < 0 ? 0 : (int64_t)y + k > last ? last : (int64_t)y + k;
        work->rows[k + pad] = stream->ring[name] + (size_t)(row % work->ring_height) * work->stride;
    }
    return work->rows + pad;
}

static void filter_down(const struct comparison *work, uint32_t y, struct stream *stream)
{
    const struct filter *filter = work->filters.each;
    uint32_t width = work->stride;
    float *const *color = stream->color;
    convolve_even(rows_about(work, stream, FILTER_Y, y), &filter[FILTER_Y], color[PLANE_Y], width);
    convolve_even(rows_about(work, stream, FILTER_CX, y), &filter[FILTER_CX], color[PLANE_CX], width);
    convolve_even(rows_about(work, stream, FILTER_CZ1, y), &filter[FILTER_CZ1], color[PLANE_CZ], width);
    convolve_even(rows_about(work, stream, FILTER_CZ2, y), &filter[FILTER_CZ2], stream->scratch, width);
    for (uint32_t x = 0; x < width; x++)
        color[PLANE_CZ][x] += stream->scratch[x];
    convolve_even(rows_about(work, stream, FILTER_EDGE, y), &filter[FILTER_BLUR], stream->feature[EDGE_X],
                  width);
    convolve_even(rows_about(work, stream, FILTER_POINT, y), &filter[FILTER_BLUR], stream->feature[POINT_X],
                  width);
    convolve_even_odd(rows_about(work, stream, FILTER_BLUR, y), &filter[FILTER_POINT], &filter[FILTER_EDGE],
                      &stream->feature[POINT_Y], width);
}

/* ---- differences --------------------------------------------------------------------------------------- */

/* A filtered row, clamped to what a display can show, becomes CIELAB in place. */
WIDE static void lab_row(const struct color *color, uint32_t width, float *restrict y, float *restrict cx,
                         float *restrict cz)
{
    const struct color local = *color;
    for (uint32_t x = 0; x < width; x++) {
        float xyz[3] = {y[x] + cx[x], y[x], y[x] - cz[x]}, rgb[3], lab[3];
        transform(local.from_white, xyz, rgb);
        for (int i = 0; i < 3; i++)
            rgb[i] = clamp01(rgb[i]);
        hunt_lab(local.to_white, rgb, lab);
        y[x] = lab[0];
        cx[x] = lab[1];
        cz[x] = lab[2];
    }
}

static inline float magnitude_difference(const float *restrict ax, const float *restrict ay,
                                         const float *restrict bx, const float *restrict by, uint32_t x)
{
    return fabsf(sqrtf(ax[x] * ax[x] + ay[x] * ay[x]) - sqrtf(bx[x] * bx[x] + by[x] * by[x]));
}

/* Every pixel of `map` becomes the larger of itself and the difference. */
WIDE static void difference_row(const struct comparison *work, float *restrict map)
{
    const struct stream a = work->streams[0], b = work->streams[1];
    float largest = work->color.largest, knee = (float)KNEE_IN * largest, knee_out = (float)KNEE_OUT;
    float below = knee_out / knee, above = (1 - knee_out) / (largest - knee);
    for (uint32_t x = 0; x < work->strip; x++) {
        float lab_a[3] = {a.color[0][x], a.color[1][x], a.color[2][x]};
        float lab_b[3] = {b.color[0][x], b.color[1][x], b.color[2][x]};
        float distance = lab_distance(lab_a, lab_b);
        float color = distance < knee ? distance * below : knee_out + (distance - knee) * above;
        float edge = magnitude_difference(a.feature[EDGE_X], a.feature[EDGE_Y], b.feature[EDGE_X],
                                          b.feature[EDGE_Y], x);
        float point = magnitude_difference(a.feature[POINT_X], a.feature[POINT_Y], b.feature[POINT_X],
                                           b.feature[POINT_Y], x);
        float feature = sqrtf((float)M_SQRT1_2 * (edge > point ? edge : point)); /* q_f = 0.5 */
        float value = power_of(color, 1 - feature);
        map[x] = value > map[x] ? value : map[x];
    }
}

static void compare_strip(struct comparison *work, const struct measure_image *const images[2], float gain,
                          float *map)
{
    uint32_t filtered = 0, radius = work->filters.radius;
    for (uint32_t y = 0; y < work->height; y++) {
        for (; filtered <= y + radius && filtered < work->height; filtered++)
            for (uint32_t side = 0; side < 2; side++) {
                read_row(work, images[side], filtered, gain, &work->streams[side]);
                filter_across(work, filtered, &work->streams[side]);
            }
        for (uint32_t side = 0; side < 2; side++) {
            struct stream *stream = &work->streams[side];
            filter_down(work, y, stream);
            lab_row(&work->color, work->stride, stream->color[PLANE_Y], stream->color[PLANE_CX],
                    stream->color[PLANE_CZ]);
        }
        difference_row(work, map + (size_t)y * work->width + work->first);
    }
}

/* One exposure. */
static void compare_once(struct comparison *work, const struct measure_image *const images[2], float gain,
                         float *map)
{
    for (work->first = 0; work->first < work->width; work->first += work->strip) {
        uint32_t left = work->width - work->first;
        work->strip = left < STRIP ? left : STRIP;
        compare_strip(work, images, gain, map);
    }
}

static bool check(const struct measure_image *image, const struct measure_image *reference,
                  const struct flip_params *params, double pixels_per_degree, struct error *error)
{
    if (image->width != reference->width || image->height != reference->height || !image->width ||
        !image->height)
        return error_set(error, STATUS_INVALID, "FLIP of %ux%u pixels against %ux%u", image->width,
                         image->height, reference->width, reference->height);
    if (image->components != reference->components || (image->components != 3 && image->components != 1))
        return error_set(error, STATUS_INVALID, "FLIP of images of %u and %u components, not 3 or 1",
                         image->components, reference->components);
    if (!(pixels_per_degree >= 5 && pixels_per_degree <= 500))
        return error_set(error, STATUS_INVALID, "FLIP at %g pixels per degree; 5 to 500 can be",
                         pixels_per_degree);
    const struct flip_exposures *exposures = &params->exposures;
    if (params->is_hdr && exposures->count &&
        !(exposures->count >= 2 && fabs(exposures->start) <= 200 && fabs(exposures->stop) <= 200 &&
          exposures->start <= exposures->stop))
        return error_set(error, STATUS_INVALID, "FLIP at %u exposures from %g to %g", exposures->count,
                         exposures->start, exposures->stop);
    size_t bad = measure_non_finite_pixels(image) + measure_non_finite_pixels(reference);
    if (bad)
        return error_set(error, STATUS_INVALID, "FLIP of %zu pixels that are not finite", bad);
    return true;
}

bool flip_compare(const struct measure_image *image, const struct measure_image *reference,
                  const struct flip_params *params, float *map, struct flip_result *result,
                  struct error *error)
{
    double pixels_per_degree =
        params->pixels_per_degree == 0 ? DEFAULT_PIXELS_PER_DEGREE : params->pixels_per_degree;
    if (!check(image, reference, params, pixels_per_degree, error))
        return false;
    *result = (struct flip_result){.exposures = params->exposures};
    if (params->is_hdr && !params->exposures.count &&
        !flip_exposures_of(reference, &result->exposures, error))
        return false;

    size_t pixels = (size_t)image->width * image->height, counted = 0;
    float *own_map = map ? NULL : malloc(pixels * sizeof *own_map);
    struct comparison work = {0};
    bool is_done = false;
    if (!(map || own_map)) {
        error_set(error, STATUS_MEMORY, "no memory for a map of %zu pixels", pixels);
        goto cleanup;
    }
    if (!comparison_create(&work, image->width, image->height, pixels_per_degree, error))
        goto cleanup;
    map = map ? map : own_map;
    for (size_t i = 0; i < pixels; i++)
        map[i] = 0;

    const struct measure_image *const images[2] = {image, reference};
    if (params->is_hdr) {
        const struct flip_exposures *exposures = &result->exposures;
        float start = (float)exposures->start;
        float step = ((float)exposures->stop - start) / (float)(exposures->count - 1);
        for (uint32_t i = 0; i < exposures->count; i++)
            compare_once(&work, images, fminf(fmaxf(exp2f(start + (float)i * step), FLT_MIN), FLT_MAX), map);
    } else {
        compare_once(&work, images, 0, map);
    }

    for (size_t i = 0; i < pixels; i++)
        if (!params->mask || params->mask[i]) {
            result->mean += (double)map[i];
            result->largest = fmax(result->largest, (double)map[i]);
            counted++;
        }
    result->mean /= (double)(counted ? counted : 1);
    is_done = counted || error_set(error, STATUS_INVALID, "the mask leaves no pixel");

cleanup:
    free(own_map);
    comparison_destroy(&work);
    return is_done;
}
