#include "shapes.h"

#include <stdlib.h>
#include <string.h>

#define PI 3.14159265358979323846

/* Where the next mesh begins. */
struct start {
    uint32_t vertex, index;
};

static struct start start_here(const struct scene_builder *builder)
{
    if (!scene_builder_ok(builder))
        return (struct start){0};
    return (struct start){builder->scene->vertex_count, builder->scene->index_count};
}

static void set_vertex(struct scene_vertex *vertex, struct vec3 position, struct vec3 normal, double u,
                       double v)
{
    vec3_store(vertex->position, position);
    vec3_store(vertex->normal, vec3_unit(normal, vec3_make(0, 1, 0)));
    vertex->uv[0] = (float)u;
    vertex->uv[1] = (float)v;
}

uint32_t shape_quads(struct scene_builder *builder, const char *name, uint32_t material,
                     const struct shape_quad *quads, uint32_t count)
{
    struct start start = start_here(builder);
    struct scene_vertex *vertices = scene_builder_vertices(builder, 4 * count);
    uint32_t *indices = scene_builder_indices(builder, 6 * count);
    if (!vertices || !indices)
        return 0;
    for (uint32_t i = 0; i < count; i++) {
        struct vec3 a = quads[i].corner, u = quads[i].edge_u, v = quads[i].edge_v;
        struct vec3 normal = vec3_cross(u, v);
        set_vertex(vertices++, a, normal, 0, 0);
        set_vertex(vertices++, vec3_add(a, u), normal, 1, 0);
        set_vertex(vertices++, vec3_add(a, v), normal, 0, 1);
        set_vertex(vertices++, vec3_add(vec3_add(a, u), v), normal, 1, 1);
        const uint32_t corners[6] = {0, 1, 3, 0, 3, 2};
        for (int at = 0; at < 6; at++)
            *indices++ = 4 * i + corners[at];
    }
    return scene_builder_mesh(builder, name, material, start.vertex, start.index);
}

uint32_t shape_floor(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 center,
                     double side)
{
    struct shape_quad quad = {
        .corner = vec3_add(center, vec3_make(-side / 2, 0, side / 2)),
        .edge_u = vec3_make(side, 0, 0),
        .edge_v = vec3_make(0, 0, -side),
    };
    return shape_quads(builder, name, material, &quad, 1);
}

uint32_t shape_box(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 minimum,
                   struct vec3 maximum)
{
    struct vec3 size = vec3_sub(maximum, minimum);
    struct vec3 x = vec3_make(size.x, 0, 0), y = vec3_make(0, size.y, 0), z = vec3_make(0, 0, size.z);
    const struct shape_quad quads[6] = {
        {vec3_add(minimum, x), y, z}, {minimum, z, y}, {vec3_add(minimum, y), z, x}, {minimum, x, z},
        {vec3_add(minimum, z), x, y}, {minimum, y, x},
    };
    return shape_quads(builder, name, material, quads, 6);
}

/* ---- sphere ------------------------------------------------------------------------------------------- */

/* Midpoint of an edge, made once per edge: an open-addressing table of (low << 32 | high) -> vertex. */
struct midpoints {
    uint64_t *keys;
    uint32_t *vertices;
    uint32_t mask;
};

static uint32_t midpoint(struct midpoints *table, struct vec3 *points, uint32_t *point_count, uint32_t a,
                         uint32_t b)
{
    uint64_t key = a < b ? (uint64_t)a << 32 | b : (uint64_t)b << 32 | a;
    uint32_t slot = (uint32_t)((key * 0x9e3779b97f4a7c15ull) >> 32) & table->mask;
    while (table->keys[slot] && table->keys[slot] != key)
        slot = (slot + 1) & table->mask;
    if (!table->keys[slot]) {
        table->keys[slot] = key;
        table->vertices[slot] = *point_count;
        points[(*point_count)++] = vec3_unit(vec3_add(points[a], points[b]), vec3_make(0, 1, 0));
    }
    return table->vertices[slot];
}

static const uint32_t icosahedron[20][3] = {
    {0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
    {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
    {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1},
};

uint32_t shape_icosphere(struct scene_builder *builder, const char *name, uint32_t material,
                         struct vec3 center, double radius, uint32_t subdivisions)
{
    struct start start = start_here(builder);
    uint32_t triangle_count = 20u << (2 * subdivisions);
    uint32_t final_points = triangle_count / 2 + 2;
    uint32_t slots = 64;
    while (slots < 4 * final_points)
        slots *= 2;
    uint32_t mesh = 0;
    struct vec3 *points = malloc(final_points * sizeof *points);
    uint32_t(*triangles)[3] = malloc(triangle_count * sizeof *triangles);
    struct midpoints table = {.keys = malloc(slots * sizeof(uint64_t)),
                              .vertices = malloc(slots * sizeof(uint32_t)),
                              .mask = slots - 1};
    if (!points || !triangles || !table.keys || !table.vertices) {
        scene_builder_fail(builder, STATUS_MEMORY, "out of memory for sphere \"%s\"", name);
        goto done;
    }
    double golden = (1 + sqrt(5.0)) / 2;
    uint32_t point_count = 0;
    for (int plane = 0; plane < 3; plane++)
        for (int i = 0; i < 4; i++) {
            double one = i & 1 ? 1 : -1, far = i & 2 ? -golden : golden;
            struct vec3 point = plane == 0   ? vec3_make(one, far, 0)
                                : plane == 1 ? vec3_make(0, one, far)
                                             : vec3_make(far, 0, one);
            points[point_count++] = vec3_unit(point, vec3_make(0, 1, 0));
        }
    memcpy(triangles, icosahedron, sizeof icosahedron);
    uint32_t count = 20;
    for (uint32_t level = 0; level < subdivisions; level++) {
        memset(table.keys, 0, slots * sizeof *table.keys);
        /* Each triangle stays where it is in the order, its four children together: neighbours stay close in
         * memory. */
        for (uint32_t i = count; i-- > 0;) {
            uint32_t a = triangles[i][0], b = triangles[i][1], c = triangles[i][2];
            uint32_t ab = midpoint(&table, points, &point_count, a, b);
            uint32_t bc = midpoint(&table, points, &point_count, b, c);
            uint32_t ca = midpoint(&table, points, &point_count, c, a);
            const uint32_t children[4][3] = {{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}};
            memcpy(triangles[4 * i], children, sizeof children);
        }
        count *= 4;
    }
    struct scene_vertex *vertices = scene_builder_vertices(builder, point_count);
    uint32_t *indices = scene_builder_indices(builder, 3 * count);
    if (!vertices || !indices)
        goto done;
    for (uint32_t i = 0; i < point_count; i++) {
        struct vec3 p = points[i];
        set_vertex(&vertices[i], vec3_add(center, vec3_scale(p, radius)), p, 0.5 + atan2(p.z, p.x) / (2 * PI),
                   acos(fmax(-1, fmin(1, p.y))) / PI);
    }
    memcpy(indices, triangles, (size_t)count * sizeof *triangles);
    mesh = scene_builder_mesh(builder, name, material, start.vertex, start.index);
done:
    free(points);
    free(triangles);
    free(table.keys);
    free(table.vertices);
    return mesh;
}

/* ---- surfaces about an axis ---------------------------------------------------------------------------- */

uint32_t shape_tube(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 center,
                    double radius, double height, uint32_t segments, bool is_inner)
{
    struct start start = start_here(builder);
    struct scene_vertex *vertices = scene_builder_vertices(builder, 2 * segments);
    uint32_t *indices = scene_builder_indices(builder, 6 * segments);
    if (!vertices || !indices)
        return 0;
    for (uint32_t i = 0; i < segments; i++) {
        double angle = 2 * PI * i / segments, c = cos(angle), s = sin(angle);
        struct vec3 normal = is_inner ? vec3_make(-c, 0, -s) : vec3_make(c, 0, s);
        for (uint32_t top = 0; top < 2; top++)
            set_vertex(vertices++, vec3_add(center, vec3_make(radius * c, height * top, radius * s)), normal,
                       (double)i / segments, top);
        uint32_t low = 2 * i, next = 2 * ((i + 1) % segments);
        uint32_t corners[6] = {low, next + 1, next, low, low + 1, next + 1};
        if (is_inner) {
            const uint32_t turned[6] = {low, next, next + 1, low, next + 1, low + 1};
            memcpy(corners, turned, sizeof corners);
        }
        for (int at = 0; at < 6; at++)
            *indices++ = corners[at];
    }
    return scene_builder_mesh(builder, name, material, start.vertex, start.index);
}

struct curve_point {
    double x, y, slope_x, slope_y;
};

/* Centripetal Catmull-Rom (Barry and Goldman 1988): knots at the square root of the chord, no loops or cusps.
 */
static struct curve_point curve_at(const struct shape_profile_point *points, uint32_t count, uint32_t segment,
                                   double t)
{
    double px[4], py[4];
    for (int i = 0; i < 4; i++) {
        int at = (int)segment + i - 1;
        /* The profile meets the axis at right angles: it continues as its mirror image. */
        bool is_outside = at < 0 || at >= (int)count;
        int inside = at < 0 ? -at : at >= (int)count ? 2 * ((int)count - 1) - at : at;
        px[i] = is_outside ? -points[inside].radius : points[inside].radius;
        py[i] = points[inside].height;
    }
    double knots[4] = {0};
    for (int i = 1; i < 4; i++)
        knots[i] = knots[i - 1] + fmax(sqrt(hypot(px[i] - px[i - 1], py[i] - py[i - 1])), 1e-6);
    /* As a cubic Hermite between points 1 and 2. */
    double span = knots[2] - knots[1];
    double slopes[2][2];
    for (int end = 0; end < 2; end++)
        for (int axis = 0; axis < 2; axis++) {
            const double *p = (axis ? py : px) + end;
            const double *k = knots + end;
            slopes[end][axis] = span * ((p[1] - p[0]) / (k[1] - k[0]) - (p[2] - p[0]) / (k[2] - k[0]) +
                                        (p[2] - p[1]) / (k[2] - k[1]));
        }
    double t2 = t * t, t3 = t2 * t;
    double h[4] = {2 * t3 - 3 * t2 + 1, t3 - 2 * t2 + t, -2 * t3 + 3 * t2, t3 - t2};
    double d[4] = {6 * t2 - 6 * t, 3 * t2 - 4 * t + 1, -6 * t2 + 6 * t, 3 * t2 - 2 * t};
    return (struct curve_point){
        .x = h[0] * px[1] + h[1] * slopes[0][0] + h[2] * px[2] + h[3] * slopes[1][0],
        .y = h[0] * py[1] + h[1] * slopes[0][1] + h[2] * py[2] + h[3] * slopes[1][1],
        .slope_x = d[0] * px[1] + d[1] * slopes[0][0] + d[2] * px[2] + d[3] * slopes[1][0],
        .slope_y = d[0] * py[1] + d[1] * slopes[0][1] + d[2] * py[2] + d[3] * slopes[1][1],
    };
}

/* Samples per profile segment for measuring arc length. */
#define CURVE_STEPS 64u

/* Arc length a turn of one radian counts for, m: a rim a few millimetres round still gets some rings. */
#define CURVE_TURN 0.05

/* Fills rings + 2 points along the whole profile, both ends included, closer where it bends. */
static bool cut_curve(const struct shape_profile_point *profile, uint32_t profile_count, uint32_t rings,
                      struct curve_point *out)
{
    uint32_t fine = (profile_count - 1) * CURVE_STEPS;
    double *lengths = malloc((fine + 1) * sizeof *lengths);
    if (!lengths)
        return false;
    lengths[0] = 0;
    struct curve_point last = curve_at(profile, profile_count, 0, 0);
    for (uint32_t i = 1; i <= fine; i++) {
        uint32_t segment = i == fine ? profile_count - 2 : i / CURVE_STEPS;
        struct curve_point here =
            curve_at(profile, profile_count, segment, (double)(i - segment * CURVE_STEPS) / CURVE_STEPS);
        double along = here.slope_x * last.slope_x + here.slope_y * last.slope_y;
        double across = here.slope_x * last.slope_y - here.slope_y * last.slope_x;
        lengths[i] = lengths[i - 1] + hypot(here.x - last.x, here.y - last.y) +
                     CURVE_TURN * fabs(atan2(across, along));
        last = here;
    }
    uint32_t at = 0;
    for (uint32_t ring = 0; ring < rings + 2; ring++) {
        double wanted = lengths[fine] * ring / (rings + 1);
        while (at + 1 < fine && lengths[at + 1] < wanted)
            at++;
        double within = (wanted - lengths[at]) / (lengths[at + 1] - lengths[at]);
        double place = (at + within) / CURVE_STEPS;
        uint32_t segment = (uint32_t)fmin(floor(place), profile_count - 2);
        out[ring] = curve_at(profile, profile_count, segment, place - segment);
    }
    free(lengths);
    return true;
}

uint32_t shape_revolution(struct scene_builder *builder, const char *name, uint32_t material,
                          struct vec3 center, const struct shape_profile_point *profile,
                          uint32_t profile_count, uint32_t rings, uint32_t segments)
{
    struct start start = start_here(builder);
    struct curve_point *cuts = malloc((rings + 2) * sizeof *cuts);
    if (!cuts || !cut_curve(profile, profile_count, rings, cuts)) {
        scene_builder_fail(builder, STATUS_MEMORY, "out of memory for \"%s\"", name);
        free(cuts);
        return 0;
    }
    /* Vertices: the bottom on the axis, the rings, the top on the axis. */
    struct scene_vertex *vertices = scene_builder_vertices(builder, rings * segments + 2);
    uint32_t *indices = scene_builder_indices(builder, 6 * segments * rings);
    if (!vertices || !indices) {
        free(cuts);
        return 0;
    }
    uint32_t bottom = 0, top = rings * segments + 1;
    set_vertex(&vertices[bottom], vec3_add(center, vec3_make(0, cuts[0].y, 0)), vec3_make(0, -1, 0), 0.5, 0);
    /* The profile ends going inward: there the outside is above. */
    set_vertex(&vertices[top], vec3_add(center, vec3_make(0, cuts[rings + 1].y, 0)), vec3_make(0, 1, 0), 0.5,
               1);
    for (uint32_t ring = 0; ring < rings; ring++) {
        const struct curve_point *cut = &cuts[ring + 1];
        for (uint32_t i = 0; i < segments; i++) {
            double angle = 2 * PI * i / segments, c = cos(angle), s = sin(angle);
            /* The outside is to the right of the profile's direction of travel. */
            set_vertex(&vertices[1 + ring * segments + i],
                       vec3_add(center, vec3_make(cut->x * c, cut->y, cut->x * s)),
                       vec3_make(cut->slope_y * c, -cut->slope_x, cut->slope_y * s), (double)i / segments,
                       (ring + 1.0) / (rings + 1.0));
        }
    }
    for (uint32_t i = 0; i < segments; i++) {
        uint32_t next = (i + 1) % segments;
        *indices++ = bottom, *indices++ = 1 + i, *indices++ = 1 + next;
    }
    for (uint32_t ring = 0; ring + 1 < rings; ring++)
        for (uint32_t i = 0; i < segments; i++) {
            uint32_t low = 1 + ring * segments, high = low + segments, next = (i + 1) % segments;
            const uint32_t corners[6] = {low + i, high + next, low + next, low + i, high + i, high + next};
            for (int at = 0; at < 6; at++)
                *indices++ = corners[at];
        }
    for (uint32_t i = 0; i < segments; i++) {
        uint32_t last = 1 + (rings - 1) * segments, next = (i + 1) % segments;
        *indices++ = last + i, *indices++ = top, *indices++ = last + next;
    }
    free(cuts);
    return scene_builder_mesh(builder, name, material, start.vertex, start.index);
}

uint32_t shape_torus(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 center,
                     struct vec3 axis, double ring_radius, double tube_radius, uint32_t segments,
                     uint32_t sides)
{
    struct start start = start_here(builder);
    struct scene_vertex *vertices = scene_builder_vertices(builder, segments * sides);
    uint32_t *indices = scene_builder_indices(builder, 6 * segments * sides);
    if (!vertices || !indices)
        return 0;
    struct vec3 other = fabs(axis.y) < 0.9 ? vec3_make(0, 1, 0) : vec3_make(1, 0, 0);
    struct vec3 u = vec3_unit(vec3_cross(other, axis), vec3_make(1, 0, 0));
    struct vec3 v = vec3_cross(axis, u);
    for (uint32_t i = 0; i < segments; i++) {
        double angle = 2 * PI * i / segments;
        struct vec3 out = vec3_add(vec3_scale(u, cos(angle)), vec3_scale(v, sin(angle)));
        for (uint32_t j = 0; j < sides; j++) {
            double turn = 2 * PI * j / sides;
            struct vec3 normal = vec3_add(vec3_scale(out, cos(turn)), vec3_scale(axis, sin(turn)));
            struct vec3 position =
                vec3_add(center, vec3_add(vec3_scale(out, ring_radius), vec3_scale(normal, tube_radius)));
            set_vertex(vertices++, position, normal, (double)i / segments, (double)j / sides);
            uint32_t here = i * sides, next = ((i + 1) % segments) * sides, up = (j + 1) % sides;
            const uint32_t corners[6] = {here + j, next + j, next + up, here + j, next + up, here + up};
            for (int at = 0; at < 6; at++)
                *indices++ = corners[at];
        }
    }
    return scene_builder_mesh(builder, name, material, start.vertex, start.index);
}

/* ---- flat-faced solids -------------------------------------------------------------------------------- */

static void add_flat_triangle(struct scene_vertex **vertices, uint32_t **indices, uint32_t *count,
                              struct vec3 a, struct vec3 b, struct vec3 c)
{
    struct vec3 normal = vec3_cross(vec3_sub(b, a), vec3_sub(c, a));
    const struct vec3 corners[3] = {a, b, c};
    for (int i = 0; i < 3; i++) {
        set_vertex((*vertices)++, corners[i], normal, i == 1, i == 2);
        *(*indices)++ = (*count)++;
    }
}

/* Direction to a point of the lumpy sphere. The lobes were chosen by eye: a few broad bumps, no overhang. */
static struct vec3 gem_point(struct vec3 center, double radius, struct vec3 p)
{
    p = vec3_unit(p, vec3_make(0, 1, 0));
    double swell =
        1 + 0.13 * sin(3 * p.x + 1) * cos(2 * p.z - 0.5) + 0.10 * sin(4 * p.y - 2 * p.x) - 0.08 * p.y * p.y;
    return vec3_add(center, vec3_scale(p, radius * swell));
}

uint32_t shape_gem(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 center,
                   double radius, uint32_t frequency)
{
    struct start start = start_here(builder);
    uint32_t triangles = 8 * frequency * frequency, count = 0;
    struct scene_vertex *vertices = scene_builder_vertices(builder, 3 * triangles);
    uint32_t *indices = scene_builder_indices(builder, 3 * triangles);
    if (!vertices || !indices)
        return 0;
    for (int face = 0; face < 8; face++) {
        double sx = face & 1 ? -1 : 1, sy = face & 2 ? -1 : 1, sz = face & 4 ? -1 : 1;
        bool is_turned = sx * sy * sz < 0;
        struct vec3 x = vec3_make(sx, 0, 0), y = vec3_make(0, is_turned ? 0 : sy, is_turned ? sz : 0),
                    z = vec3_make(0, is_turned ? sy : 0, is_turned ? 0 : sz);
        /* Rows of the face from corner x towards the edge yz. */
        for (uint32_t row = 0; row < frequency; row++)
            for (uint32_t at = 0; at < 2 * row + 1; at++) {
                struct vec3 corner[3];
                uint32_t step = at / 2;
                bool is_odd = at & 1; /* these point back to corner x */
                const uint32_t r[3] = {row, row + 1, is_odd ? row : row + 1};
                const uint32_t c[3] = {step, is_odd ? step + 1 : step, step + 1};
                for (int i = 0; i < 3; i++) {
                    struct vec3 p = vec3_scale(x, frequency - r[i]);
                    p = vec3_add(p, vec3_scale(y, r[i] - c[i]));
                    corner[i] = gem_point(center, radius, vec3_add(p, vec3_scale(z, c[i])));
                }
                add_flat_triangle(&vertices, &indices, &count, corner[0], corner[1], corner[2]);
            }
    }
    return scene_builder_mesh(builder, name, material, start.vertex, start.index);
}

uint32_t shape_prism(struct scene_builder *builder, const char *name, uint32_t material,
                     const double corners[3][2], double z_minimum, double z_maximum)
{
    struct start start = start_here(builder);
    struct scene_vertex *vertices = scene_builder_vertices(builder, 24);
    uint32_t *indices = scene_builder_indices(builder, 24);
    if (!vertices || !indices)
        return 0;
    uint32_t count = 0;
    struct vec3 back[3], front[3];
    for (int i = 0; i < 3; i++) {
        back[i] = vec3_make(corners[i][0], corners[i][1], z_minimum);
        front[i] = vec3_make(corners[i][0], corners[i][1], z_maximum);
    }
    add_flat_triangle(&vertices, &indices, &count, front[0], front[1], front[2]);
    add_flat_triangle(&vertices, &indices, &count, back[0], back[2], back[1]);
    for (int i = 0; i < 3; i++) {
        int next = (i + 1) % 3;
        add_flat_triangle(&vertices, &indices, &count, back[i], back[next], front[next]);
        add_flat_triangle(&vertices, &indices, &count, back[i], front[next], front[i]);
    }
    return scene_builder_mesh(builder, name, material, start.vertex, start.index);
}

/* ---- water -------------------------------------------------------------------------------------------- */

uint32_t shape_water(struct scene_builder *builder, const char *name, uint32_t material, struct vec3 center,
                     double side, uint32_t cells, const struct shape_wave *waves, uint32_t wave_count)
{
    struct start start = start_here(builder);
    uint32_t points = cells + 1;
    struct scene_vertex *vertices = scene_builder_vertices(builder, points * points);
    uint32_t *indices = scene_builder_indices(builder, 6 * cells * cells);
    if (!vertices || !indices)
        return 0;
    for (uint32_t row = 0; row < points; row++)
        for (uint32_t column = 0; column < points; column++) {
            double x = side * ((double)column / cells - 0.5), z = side * ((double)row / cells - 0.5);
            double height = 0, slope_x = 0, slope_z = 0;
            for (uint32_t i = 0; i < wave_count; i++) {
                double angle = waves[i].wave_x * x + waves[i].wave_z * z + waves[i].phase;
                height += waves[i].amplitude * sin(angle);
                slope_x += waves[i].amplitude * waves[i].wave_x * cos(angle);
                slope_z += waves[i].amplitude * waves[i].wave_z * cos(angle);
            }
            set_vertex(vertices++, vec3_add(center, vec3_make(x, height, z)),
                       vec3_make(-slope_x, 1, -slope_z), (double)column / cells, (double)row / cells);
        }
    for (uint32_t row = 0; row < cells; row++)
        for (uint32_t column = 0; column < cells; column++) {
            uint32_t here = row * points + column, below = here + points;
            const uint32_t corners[6] = {here, below, below + 1, here, below + 1, here + 1};
            for (int at = 0; at < 6; at++)
                *indices++ = corners[at];
        }
    return scene_builder_mesh(builder, name, material, start.vertex, start.index);
}
