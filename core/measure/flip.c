#include "flip.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

/* A pixel's colour is carried as y, x - y and y - z, with x, y and z relative to the white point: Cx and Cz
 * of YCxCz over 500 and 200, and Y without its offset. Every filter sums to 1, so the offset comes back by
 * itself.
 *
 * Rows are streamed: each is converted and filtered across once, into rings of as many rows as the filters
 * are high, and filtered down from there. Filters are even or odd, so that two taps share a product. */

#define DEFAULT_PIXELS_PER_DEGREE (3840 * (double)M_PI / 180)
#define COLOR_EXPONENT            0.7   /* q_c of the paper */
#define FEATURE_EXPONENT          0.5   /* q_f */
#define KNEE_IN                   0.4   /* p_c: this share of the largest difference ... */
#define KNEE_OUT                  0.95  /* p_t: ... uses this share of the output */
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
    FILTER_BLUR,  /* features: Gaussian, */
    FILTER_EDGE,  /* its first derivative, odd */
    FILTER_POINT, /* and its second */
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
        free(filters->memory);
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

/* `from` has `radius` values before and after the row. */
static void filter_even(const struct filter *filter, const float *from, float *to, uint32_t count)
{
    const float *taps = filter->taps;
    for (uint32_t x = 0; x < count; x++)
        to[x] = taps[0] * from[x];
    for (uint32_t i = 1; i <= filter->radius; i++) {
        const float *before = from - i, *after = from + i;
        for (uint32_t x = 0; x < count; x++)
            to[x] += taps[i] * (before[x] + after[x]);
    }
}

static void filter_odd(const struct filter *filter, const float *from, float *to, uint32_t count)
{
    const float *taps = filter->taps;
    for (uint32_t x = 0; x < count; x++)
        to[x] = 0;
    for (uint32_t i = 1; i <= filter->radius; i++) {
        const float *before = from - i, *after = from + i;
        for (uint32_t x = 0; x < count; x++)
            to[x] += taps[i] * (after[x] - before[x]);
    }
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

static inline float lab_curve(float value)
{
    const float delta = 6.0f / 29;
    return value > delta * delta * delta ? cbrtf(value) : value / (3 * delta * delta) + 4.0f / 29;
}

/* Linear RGB in 0..1 to CIELAB with Hunt's adjustment: colours look stronger where they are brighter. */
static inline void hunt_lab(const struct color *color, const float rgb[3], float lab[3])
{
    float xyz[3];
    transform(color->to_white, rgb, xyz);
    for (int i = 0; i < 3; i++)
        xyz[i] = lab_curve(xyz[i]);
    lab[0] = 116 * xyz[1] - 16;
    lab[1] = 0.01f * lab[0] * 500 * (xyz[0] - xyz[1]);
    lab[2] = 0.01f * lab[0] * 200 * (xyz[1] - xyz[2]);
}

/* HyAB, raised to q_c. */
static inline float lab_distance(const float a[3], const float b[3])
{
    float lightness = fabsf(a[0] - b[0]), red = a[1] - b[1], yellow = a[2] - b[2];
    return powf(lightness + sqrtf(red * red + yellow * yellow), (float)COLOR_EXPONENT);
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
    hunt_lab(color, (const float[3]){0, 1, 0}, green);
    hunt_lab(color, (const float[3]){0, 0, 1}, blue);
    color->largest = lab_distance(green, blue);
}

/* ---- exposures ----------------------------------------------------------------------------------------- */

/* The ACES curve with its pre-exposure of 0.6 undone: (k0 x^2 + k1 x) / (k2 x^2 + k3 x + k4). In floats and
 * in this order as the authors do it, since the number of exposures is the ceiling of a difference of
 * logarithms, and pictures whose brightest pixel is a power of two times the median are not rare. */
static const float aces[5] = {0.6f * 0.6f * 2.51f, 0.6f * 0.03f, 0.6f * 0.6f * 2.43f, 0.6f * 0.59f, 0.14f};

static inline float tone_map(float value)
{
    float x = fminf(fmaxf(value, 0), 1e9f); /* its square stays a float */
    float mapped = (x * x * aces[0] + x * aces[1]) / (x * x * aces[2] + x * aces[3] + aces[4]);
    return fminf(mapped, 1);
}

static int compare_floats(const void *left, const void *right)
{
    float a = *(const float *)left, b = *(const float *)right;
    return (a > b) - (a < b);
}

bool flip_exposures_of(const struct measure_image *reference, struct flip_exposures *exposures,
                       struct error *error)
{
    size_t pixels = (size_t)reference->width * reference->height, dark = 0;
    float *luminances = malloc((pixels ? pixels : 1) * sizeof *luminances);
    if (!luminances)
        return error_set(error, STATUS_MEMORY, "no memory for %zu luminances", pixels);
    for (size_t i = 0; i < pixels; i++) {
        const float *value = reference->values + i * reference->components;
        luminances[i] = reference->components < 3
                            ? value[0]
                            : 0.2126f * value[0] + 0.7152f * value[1] + 0.0722f * value[2];
        dark += luminances[i] > 0 ? 0 : 1;
    }
    qsort(luminances, pixels, sizeof *luminances, compare_floats);
    *exposures = (struct flip_exposures){.count = 2};
    if (dark < pixels) {
        size_t middle = pixels / 2;
        if (middle < dark)
            middle = dark + (pixels - dark) / 2;
        /* Where the curve reaches 0.85: a x^2 + b x + c = 0. */
        float a = aces[0] - 0.85f * aces[2], b = aces[1] - 0.85f * aces[3], c = -0.85f * aces[4];
        float half = -0.5f * (b / a), bright = half + sqrtf(half * half - c / a);
        float start = (float)log2((double)(bright / luminances[pixels - 1]));
        float stop = (float)log2((double)(bright / luminances[middle]));
        *exposures =
            (struct flip_exposures){(double)start, (double)stop, (uint32_t)fmaxf(2, ceilf(stop - start))};
    }
    free(luminances);
    return true;
}

/* ---- rows ---------------------------------------------------------------------------------------------- */

enum plane { PLANE_Y, PLANE_CX, PLANE_CZ, PLANE_COUNT };
enum feature { EDGE_X, EDGE_Y, POINT_X, POINT_Y, FEATURE_COUNT };

/* One of the two images on its way through the filters. */
struct stream {
    float *line[PLANE_COUNT];  /* the row being filtered across, repeated at both ends */
    float *ring[FILTER_COUNT]; /* ring_height rows; row y is at y % ring_height */
    float *color[PLANE_COUNT]; /* one row, filtered both ways */
    float *feature[FEATURE_COUNT];
    float *scratch;
};

struct comparison {
    struct filters filters;
    struct color color;
    struct stream streams[2];
    uint32_t width, height, pad, ring_height;
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
    work->pad = work->filters.radius;
    work->ring_height = 2 * work->filters.radius + 1;
    size_t line = (size_t)width + 2 * work->pad;
    size_t rows = FILTER_COUNT * (size_t)work->ring_height + PLANE_COUNT + FEATURE_COUNT + 1;
    size_t each = PLANE_COUNT * line + rows * width;
    work->memory = malloc(2 * each * sizeof *work->memory);
    if (!work->memory) {
        free(work->filters.memory);
        return error_set(error, STATUS_MEMORY, "no memory for FLIP of %u pixels a row", width);
    }
    for (uint32_t side = 0; side < 2; side++) {
        struct stream *stream = &work->streams[side];
        float *next = work->memory + side * each;
        for (uint32_t i = 0; i < PLANE_COUNT; i++, next += line)
            stream->line[i] = next + work->pad;
        for (uint32_t i = 0; i < FILTER_COUNT; i++, next += (size_t)work->ring_height * width)
            stream->ring[i] = next;
        for (uint32_t i = 0; i < PLANE_COUNT; i++, next += width)
            stream->color[i] = next;
        for (uint32_t i = 0; i < FEATURE_COUNT; i++, next += width)
            stream->feature[i] = next;
        stream->scratch = next;
    }
    return true;
}

static void comparison_destroy(struct comparison *work)
{
    free(work->filters.memory);
    free(work->memory);
}

/* Row `y` of the image as y, x - y, y - z. `gain` 0: clamped to 0..1; else exposed by it and tone-mapped. */
static void read_row(const struct comparison *work, const struct measure_image *image, uint32_t y, float gain,
                     struct stream *stream)
{
    const float *values = image->values + (size_t)y * image->width * image->components;
    float *const *line = stream->line;
    for (uint32_t x = 0; x < work->width; x++) {
        float rgb[3], xyz[3];
        for (uint32_t c = 0; c < 3; c++) {
            float value = image->components < 3 ? values[x] : values[3 * x + c];
            rgb[c] = gain > 0 ? tone_map(value * gain) : fminf(fmaxf(value, 0), 1);
        }
        transform(work->color.to_white, rgb, xyz);
        line[PLANE_Y][x] = xyz[1];
        line[PLANE_CX][x] = xyz[0] - xyz[1];
        line[PLANE_CZ][x] = xyz[1] - xyz[2];
    }
    for (uint32_t plane = 0; plane < PLANE_COUNT; plane++)
        for (uint32_t i = 1; i <= work->pad; i++) {
            *(line[plane] - i) = line[plane][0];
            line[plane][work->width - 1 + i] = line[plane][work->width - 1];
        }
}

static void filter_across(const struct comparison *work, uint32_t y, struct stream *stream)
{
    static const enum plane source[FILTER_COUNT] = {PLANE_Y, PLANE_CX, PLANE_CZ, PLANE_CZ,
                                                    PLANE_Y, PLANE_Y,  PLANE_Y};
    for (uint32_t name = 0; name < FILTER_COUNT; name++) {
        float *to = stream->ring[name] + (size_t)(y % work->ring_height) * work->width;
        (name == FILTER_EDGE ? filter_odd : filter_even)(&work->filters.each[name],
                                                         stream->line[source[name]], to, work->width);
    }
}

static const float *ring_row(const struct comparison *work, const struct stream *stream,
                             enum filter_name name, int64_t y)
{
    int64_t last = (int64_t)work->height - 1, row = y < 0 ? 0 : y > last ? last : y;
    return stream->ring[name] + (size_t)(row % work->ring_height) * work->width;
}

/* Filters what `across` has filtered by `down`, at row y. */
static void filter_down(const struct comparison *work, const struct stream *stream, enum filter_name across,
                        enum filter_name down, uint32_t y, float *to)
{
    const struct filter *filter = &work->filters.each[down];
    const float *centre = ring_row(work, stream, across, y);
    float sign = down == FILTER_EDGE ? -1 : 1;
    for (uint32_t x = 0; x < work->width; x++)
        to[x] = filter->taps[0] * centre[x];
    for (uint32_t i = 1; i <= filter->radius; i++) {
        const float *above = ring_row(work, stream, across, (int64_t)y - i);
        const float *below = ring_row(work, stream, across, (int64_t)y + i);
        float tap = filter->taps[i];
        for (uint32_t x = 0; x < work->width; x++)
            to[x] += tap * (below[x] + sign * above[x]);
    }
}

static void filter_row_down(const struct comparison *work, uint32_t y, struct stream *stream)
{
    filter_down(work, stream, FILTER_Y, FILTER_Y, y, stream->color[PLANE_Y]);
    filter_down(work, stream, FILTER_CX, FILTER_CX, y, stream->color[PLANE_CX]);
    filter_down(work, stream, FILTER_CZ1, FILTER_CZ1, y, stream->color[PLANE_CZ]);
    filter_down(work, stream, FILTER_CZ2, FILTER_CZ2, y, stream->scratch);
    for (uint32_t x = 0; x < work->width; x++)
        stream->color[PLANE_CZ][x] += stream->scratch[x];
    filter_down(work, stream, FILTER_EDGE, FILTER_BLUR, y, stream->feature[EDGE_X]);
    filter_down(work, stream, FILTER_BLUR, FILTER_EDGE, y, stream->feature[EDGE_Y]);
    filter_down(work, stream, FILTER_POINT, FILTER_BLUR, y, stream->feature[POINT_X]);
    filter_down(work, stream, FILTER_BLUR, FILTER_POINT, y, stream->feature[POINT_Y]);
}

/* ---- differences --------------------------------------------------------------------------------------- */

static inline void filtered_lab(const struct comparison *work, const struct stream *stream, uint32_t x,
                                float lab[3])
{
    float y = stream->color[PLANE_Y][x];
    float xyz[3] = {y + stream->color[PLANE_CX][x], y, y - stream->color[PLANE_CZ][x]}, rgb[3];
    transform(work->color.from_white, xyz, rgb);
    for (int i = 0; i < 3; i++)
        rgb[i] = fminf(fmaxf(rgb[i], 0), 1);
    hunt_lab(&work->color, rgb, lab);
}

static inline float magnitude(const struct stream *stream, enum feature first, uint32_t x)
{
    float across = stream->feature[first][x], down = stream->feature[first + 1][x];
    return sqrtf(across * across + down * down);
}

static void difference_row(const struct comparison *work, float *map)
{
    const struct stream *a = &work->streams[0], *b = &work->streams[1];
    float largest = work->color.largest, knee = (float)KNEE_IN * largest, knee_out = (float)KNEE_OUT;
    for (uint32_t x = 0; x < work->width; x++) {
        float lab_a[3], lab_b[3];
        filtered_lab(work, a, x, lab_a);
        filtered_lab(work, b, x, lab_b);
        float distance = lab_distance(lab_a, lab_b);
        float color = distance < knee ? distance * (knee_out / knee)
                                      : knee_out + (distance - knee) / (largest - knee) * (1 - knee_out);
        float edge = fabsf(magnitude(a, EDGE_X, x) - magnitude(b, EDGE_X, x));
        float point = fabsf(magnitude(a, POINT_X, x) - magnitude(b, POINT_X, x));
        float feature = powf((float)M_SQRT1_2 * fmaxf(edge, point), (float)FEATURE_EXPONENT);
        map[x] = powf(color, 1 - feature);
    }
}

/* One exposure: every pixel of `map` becomes the larger of itself and the difference. */
static void compare_once(struct comparison *work, const struct measure_image *const images[2], float gain,
                         float *row, float *map)
{
    uint32_t filtered = 0, radius = work->filters.radius;
    for (uint32_t y = 0; y < work->height; y++) {
        for (; filtered <= y + radius && filtered < work->height; filtered++)
            for (uint32_t side = 0; side < 2; side++) {
                read_row(work, images[side], filtered, gain, &work->streams[side]);
                filter_across(work, filtered, &work->streams[side]);
            }
        for (uint32_t side = 0; side < 2; side++)
            filter_row_down(work, y, &work->streams[side]);
        difference_row(work, row);
        float *to = map + (size_t)y * work->width;
        for (uint32_t x = 0; x < work->width; x++)
            to[x] = fmaxf(to[x], row[x]);
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
    float *row = malloc(image->width * sizeof *row);
    struct comparison work = {0};
    bool is_done = false;
    if (!row || !(map || own_map)) {
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
            compare_once(&work, images, fminf(fmaxf(exp2f(start + (float)i * step), FLT_MIN), FLT_MAX), row,
                         map);
    } else {
        compare_once(&work, images, 0, row, map);
    }
    comparison_destroy(&work);

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
    free(row);
    return is_done;
}
