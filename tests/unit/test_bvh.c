/* The CPU hierarchy against brute force in double precision, and against its own promises. */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/scene/bvh.h"
#include "core/scene/scene.h"
#include "tests/support/check.h"

/* ---- meshes ---------------------------------------------------------------------------------------- */

struct soup {
    struct scene scene;
    struct scene_mesh mesh;
};

static uint64_t random_state;

static uint32_t random_bits(void)
{
    random_state = random_state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(random_state >> 33);
}

/* In [-1, 1). */
static float random_unit(void)
{
    return (float)random_bits() / 1073741824.0f - 1.0f;
}

static void soup_begin(struct soup *soup, uint32_t vertex_count, uint32_t triangle_count)
{
    memset(soup, 0, sizeof *soup);
    soup->scene.meshes = &soup->mesh;
    soup->scene.mesh_count = 1;
    soup->scene.vertices = calloc(vertex_count + 1, sizeof *soup->scene.vertices);
    soup->scene.indices = calloc(3 * triangle_count + 1, sizeof *soup->scene.indices);
    assert_non_null(soup->scene.vertices);
    assert_non_null(soup->scene.indices);
    soup->mesh.vertex_count = soup->scene.vertex_count = vertex_count;
    soup->mesh.triangle_count = triangle_count;
    soup->scene.index_count = 3 * triangle_count;
}

static void soup_end(struct soup *soup)
{
    free(soup->scene.vertices);
    free(soup->scene.indices);
}

static void set_triangle(struct soup *soup, uint32_t triangle, uint32_t a, uint32_t b, uint32_t c)
{
    soup->scene.indices[3 * triangle] = a;
    soup->scene.indices[3 * triangle + 1] = b;
    soup->scene.indices[3 * triangle + 2] = c;
}

static void random_soup(struct soup *soup, uint32_t triangle_count, float size)
{
    soup_begin(soup, 3 * triangle_count, triangle_count);
    for (uint32_t i = 0; i < triangle_count; i++) {
        const float center[3] = {random_unit(), random_unit(), random_unit()};
        for (uint32_t k = 0; k < 3; k++)
            for (int a = 0; a < 3; a++)
                soup->scene.vertices[3 * i + k].position[a] = center[a] + size * random_unit();
        set_triangle(soup, i, 3 * i, 3 * i + 1, 3 * i + 2);
    }
}

/* A closed sphere of rings x segments quads, triangles in random order, vertices moved off the sphere by
 * `bump`. */
static void bumpy_sphere(struct soup *soup, uint32_t rings, uint32_t segments, float bump)
{
    uint32_t triangle_count = 2 * segments * (rings - 1);
    soup_begin(soup, (rings - 1) * segments + 2, triangle_count);
    struct scene_vertex *v = soup->scene.vertices;
    v[0].position[1] = 1;
    v[1].position[1] = -1;
    for (uint32_t r = 1; r < rings; r++)
        for (uint32_t s = 0; s < segments; s++) {
            double theta = M_PI * r / rings, phi = 2 * M_PI * s / segments;
            double radius = 1 + (double)(bump * random_unit());
            float *p = v[2 + (r - 1) * segments + s].position;
            p[0] = (float)(radius * sin(theta) * cos(phi));
            p[1] = (float)(radius * cos(theta));
            p[2] = (float)(radius * sin(theta) * sin(phi));
        }
    uint32_t t = 0;
    for (uint32_t s = 0; s < segments; s++) {
        uint32_t next = (s + 1) % segments, last = 2 + (rings - 2) * segments;
        set_triangle(soup, t++, 0, 2 + s, 2 + next);
        set_triangle(soup, t++, 1, last + next, last + s);
        for (uint32_t r = 0; r + 2 < rings; r++) {
            uint32_t a = 2 + r * segments, b = a + segments;
            set_triangle(soup, t++, a + s, b + s, b + next);
            set_triangle(soup, t++, a + s, b + next, a + next);
        }
    }
    assert_int_equal(t, triangle_count);
    for (uint32_t i = triangle_count - 1; i > 0; i--) {
        uint32_t j = random_bits() % (i + 1);
        for (uint32_t k = 0; k < 3; k++) {
            uint32_t moved = soup->scene.indices[3 * i + k];
            soup->scene.indices[3 * i + k] = soup->scene.indices[3 * j + k];
            soup->scene.indices[3 * j + k] = moved;
        }
    }
}

static struct bvh *build(const struct soup *soup)
{
    struct error error;
    struct bvh *bvh = bvh_create_mesh(&soup->scene, 0, &error);
    assert_non_null(bvh);
    return bvh;
}

/* ---- brute force ----------------------------------------------------------------------------------- */

struct exact_hit {
    double t, margin; /* margin: distance of the barycentrics from the triangle's
                         border, negative outside */
};

/* Moeller-Trumbore in double; false where the triangle is seen edge-on. */
static bool exact_triangle(const struct soup *soup, uint32_t triangle, const float o[3], const float d[3],
                           struct exact_hit *hit)
{
    double p[3][3], e1[3], e2[3], s[3], h[3], q[3];
    for (uint32_t k = 0; k < 3; k++)
        for (int a = 0; a < 3; a++)
            p[k][a] = (double)soup->scene.vertices[soup->scene.indices[3 * triangle + k]].position[a];
    for (int a = 0; a < 3; a++) {
        e1[a] = p[1][a] - p[0][a];
        e2[a] = p[2][a] - p[0][a];
        s[a] = (double)o[a] - p[0][a];
    }
    for (int a = 0; a < 3; a++) {
        int b = (a + 1) % 3, c = (a + 2) % 3;
        h[a] = (double)d[b] * e2[c] - (double)d[c] * e2[b];
        q[a] = s[b] * e1[c] - s[c] * e1[b];
    }
    double det = e1[0] * h[0] + e1[1] * h[1] + e1[2] * h[2];
    double scale =
        sqrt((e1[0] * e1[0] + e1[1] * e1[1] + e1[2] * e1[2]) * (h[0] * h[0] + h[1] * h[1] + h[2] * h[2]));
    if (fabs(det) <= 1e-12 * scale)
        return false;
    double u = (s[0] * h[0] + s[1] * h[1] + s[2] * h[2]) / det;
    double v = ((double)d[0] * q[0] + (double)d[1] * q[1] + (double)d[2] * q[2]) / det;
    hit->t = (e2[0] * q[0] + e2[1] * q[1] + e2[2] * q[2]) / det;
    hit->margin = fmin(u, fmin(v, 1 - u - v));
    return true;
}

/* Traces one ray and compares with brute force: a hit must lie on its triangle where brute force sees it,
 * and nothing that brute force hits clearly may be nearer. `slack` in barycentrics and in t relative to
 * the farthest vertex. */
static bool check_ray(const struct soup *soup, const struct bvh *bvh, const float o[3], const float d[3],
                      double slack)
{
    float t = INFINITY, u = 0, v = 0;
    uint32_t triangle = 0;
    bool is_hit = bvh_trace(bvh, o, d, 1e30f, &t, &triangle, &u, &v);
    double nearest = INFINITY;
    for (uint32_t i = 0; i < soup->mesh.triangle_count; i++) {
        struct exact_hit hit;
        if (exact_triangle(soup, i, o, d, &hit) && hit.margin > slack && hit.t > slack && hit.t < nearest)
            nearest = hit.t;
    }
    if (is_hit) {
        struct exact_hit hit;
        assert_true(triangle < soup->mesh.triangle_count);
        assert_true(t > 0);
        if (exact_triangle(soup, triangle, o, d, &hit)) {
            assert_true(hit.margin > -slack);
            assert_close((double)t, hit.t, slack * fmax(1, fabs(hit.t)));
        }
        assert_true((double)t <= nearest + slack * fmax(1, nearest));
    } else {
        assert_true(nearest == INFINITY);
    }
    return is_hit;
}

static bool box_holds(const float box[6], const float p[3])
{
    for (int a = 0; a < 3; a++)
        if (p[a] < box[a] || p[a] > box[3 + a])
            return false;
    return true;
}

/* ---- tests ----------------------------------------------------------------------------------------- */

static void random_triangles_match_brute_force(void **state)
{
    (void)state;
    static const struct {
        uint32_t count;
        float size;
    } soups[] = {{1, 1}, {2, 0.5f}, {3, 1}, {17, 0.5f}, {300, 0.1f}, {2000, 0.05f}, {500, 2}};
    for (size_t k = 0; k < sizeof soups / sizeof *soups; k++) {
        random_state = k + 1;
        struct soup soup;
        random_soup(&soup, soups[k].count, soups[k].size);
        struct bvh *bvh = build(&soup);
        uint32_t hits = 0, rays = 4000000 / (soups[k].count + 1000);
        for (uint32_t i = 0; i < rays; i++) {
            float o[3], d[3];
            for (int a = 0; a < 3; a++) {
                o[a] = 2 * random_unit();
                d[a] = 0.7f * random_unit() - o[a];
            }
            /* Triangles as thin as needles turn float rounding into barycentrics: 1e-3 of a triangle. */
            hits += check_ray(&soup, bvh, o, d, 1e-3);
        }
        assert_true(hits > rays / 100);
        bvh_destroy(&bvh);
        soup_end(&soup);
    }
}

static void a_direction_need_not_be_unit(void **state)
{
    (void)state;
    random_state = 5;
    struct soup soup;
    random_soup(&soup, 200, 0.3f);
    struct bvh *bvh = build(&soup);
    for (uint32_t i = 0; i < 2000; i++) {
        float o[3], d[3], e[3], t[2], u[2], v[2];
        uint32_t triangle[2];
        for (int a = 0; a < 3; a++) {
            o[a] = 2 * random_unit();
            d[a] = 0.5f * random_unit() - o[a];
            e[a] = 1024 * d[a]; /* a power of two: nothing rounds */
        }
        bool first = bvh_trace(bvh, o, d, 1e20f, &t[0], &triangle[0], &u[0], &v[0]);
        bool second = bvh_trace(bvh, o, e, 1e20f, &t[1], &triangle[1], &u[1], &v[1]);
        assert_int_equal(first, second);
        if (first) {
            assert_int_equal(triangle[0], triangle[1]);
            assert_true(t[0] == 1024 * t[1]);
        }
    }
    bvh_destroy(&bvh);
    soup_end(&soup);
}

/* Only the open interval (0, t_max) counts. */
static void distance_limits_hold(void **state)
{
    (void)state;
    struct soup soup;
    soup_begin(&soup, 3, 1);
    const float corners[3][3] = {{-1, -1, 0}, {3, -1, 0}, {-1, 3, 0}};
    for (uint32_t k = 0; k < 3; k++)
        memcpy(soup.scene.vertices[k].position, corners[k], sizeof corners[k]);
    set_triangle(&soup, 0, 0, 1, 2);
    struct bvh *bvh = build(&soup);
    const float down[3] = {0, 0, -1}, up[3] = {0, 0, 1};
    const float above[3] = {0, 0, 2}, on[3] = {0.25f, 0.25f, 0};
    float t, u, v;
    uint32_t triangle;
    assert_true(bvh_trace(bvh, above, down, 2.001f, &t, &triangle, &u, &v));
    assert_close((double)t, 2, 1e-6);
    assert_close((double)u, 0.25, 1e-6);
    assert_close((double)v, 0.25, 1e-6);
    assert_false(bvh_trace(bvh, above, down, 2, &t, &triangle, &u, &v));
    assert_false(bvh_trace(bvh, above, down, 1.999f, &t, &triangle, &u, &v));
    assert_false(bvh_trace(bvh, above, up, 1e30f, &t, &triangle, &u, &v));
    assert_false(bvh_trace(bvh, on, down, 1e30f, &t, &triangle, &u, &v));
    assert_false(bvh_trace(bvh, on, up, 1e30f, &t, &triangle, &u, &v));
    const float below[3] = {0, 0, -2};
    assert_true(bvh_trace(bvh, below, up, 1e30f, &t, &triangle, &u, &v)); /* both faces */
    bvh_destroy(&bvh);
    soup_end(&soup);
}

static uint32_t count_cracks(const struct bvh *bvh, const float o[3], const float d[3])
{
    float t, u, v;
    uint32_t triangle;
    return !bvh_trace(bvh, o, d, 1e30f, &t, &triangle, &u, &v);
}

/* A ray that starts inside a closed mesh leaves it: aimed at vertices, along edges, and anywhere. */
static void closed_meshes_have_no_cracks(void **state)
{
    (void)state;
    for (uint32_t k = 0; k < 2; k++) {
        random_state = 11 + k;
        struct soup soup;
        bumpy_sphere(&soup, 40, 60, k ? 0.02f : 0);
        struct bvh *bvh = build(&soup);
        const struct scene_vertex *vertices = soup.scene.vertices;
        uint32_t rays = 0, cracks = 0;
        while (rays < 500000) {
            float o[3], d[3];
            for (int a = 0; a < 3; a++)
                o[a] = 0.5f * random_unit();
            const uint32_t *corner = &soup.scene.indices[3 * (random_bits() % soup.mesh.triangle_count)];
            float along = 0.5f + 0.5f * random_unit();
            const float *p = vertices[corner[0]].position, *q = vertices[corner[1]].position;
            switch (rays % 3) {
            case 0: /* a vertex */
                for (int a = 0; a < 3; a++)
                    d[a] = p[a] - o[a];
                break;
            case 1: /* a point of an edge */
                for (int a = 0; a < 3; a++)
                    d[a] = p[a] + along * (q[a] - p[a]) - o[a];
                break;
            default:
                for (int a = 0; a < 3; a++)
                    d[a] = random_unit();
            }
            if (d[0] == 0 && d[1] == 0 && d[2] == 0)
                continue;
            cracks += count_cracks(bvh, o, d);
            rays++;
        }
        assert_int_equal(cracks, 0);
        bvh_destroy(&bvh);
        soup_end(&soup);
    }
}

/* Directions with components of 0 and -0, from origins that lie in the planes of boxes and triangles. */
static void axis_aligned_rays_hit_a_grid(void **state)
{
    (void)state;
    struct soup soup;
    const uint32_t n = 16;
    soup_begin(&soup, (n + 1) * (n + 1), 2 * n * n);
    for (uint32_t j = 0; j <= n; j++)
        for (uint32_t i = 0; i <= n; i++) {
            float *p = soup.scene.vertices[j * (n + 1) + i].position;
            p[0] = (float)i;
            p[1] = (float)j;
        }
    for (uint32_t j = 0, t = 0; j < n; j++)
        for (uint32_t i = 0; i < n; i++) {
            uint32_t a = j * (n + 1) + i;
            set_triangle(&soup, t++, a, a + 1, a + n + 2);
            set_triangle(&soup, t++, a, a + n + 2, a + n + 1);
        }
    struct bvh *bvh = build(&soup);
    for (uint32_t sign = 0; sign < 4; sign++)
        for (uint32_t j = 0; j <= 4 * n; j++)
            for (uint32_t i = 0; i <= 4 * n; i++) {
                /* every vertex, edge and diagonal of the grid, and between */
                const float o[3] = {0.25f * (float)i, 0.25f * (float)j, 3};
                const float d[3] = {sign & 1 ? -0.0f : 0.0f, sign & 2 ? -0.0f : 0.0f, -1};
                float t, u, v;
                uint32_t triangle;
                assert_true(bvh_trace(bvh, o, d, 1e30f, &t, &triangle, &u, &v));
                assert_true(t == 3);
                const float outside[3] = {o[0] + (float)n + 0.25f, o[1], 3};
                assert_false(bvh_trace(bvh, outside, d, 1e30f, &t, &triangle, &u, &v));
            }
    /* within the plane of all triangles: edge-on, so no hit, and no hang */
    for (uint32_t i = 0; i <= 4 * n; i++) {
        const float o[3] = {-1, 0.25f * (float)i, 0}, x[3] = {1, 0, 0}, slanted[3] = {1, 0.3f, -0.0f};
        float t, u, v;
        uint32_t triangle;
        assert_false(bvh_trace(bvh, o, x, 1e30f, &t, &triangle, &u, &v));
        assert_false(bvh_trace(bvh, o, slanted, 1e30f, &t, &triangle, &u, &v));
    }
    bvh_destroy(&bvh);
    soup_end(&soup);
}

static void degenerate_meshes_are_harmless(void **state)
{
    (void)state;
    const float o[3] = {0.2f, 0.3f, 5}, d[3] = {0, 0, -1};
    float t, u, v;
    uint32_t triangle;
    struct soup soup;

    soup_begin(&soup, 0, 0); /* no triangles at all */
    struct bvh *bvh = build(&soup);
    assert_int_equal(bvh->item_count, 0);
    assert_false(bvh_trace(bvh, o, d, INFINITY, &t, &triangle, &u, &v));
    float boxes[4][6];
    assert_int_equal(bvh_frontier(bvh, boxes, 4), 0);
    bvh_destroy(&bvh);
    soup_end(&soup);

    /* the same triangle 1,000 times: no plane separates the centroids */
    soup_begin(&soup, 3, 1000);
    const float corners[3][3] = {{-1, -1, 0}, {3, -1, 0}, {-1, 3, 0}};
    for (uint32_t k = 0; k < 3; k++)
        memcpy(soup.scene.vertices[k].position, corners[k], sizeof corners[k]);
    for (uint32_t i = 0; i < 1000; i++)
        set_triangle(&soup, i, 0, 1, 2);
    bvh = build(&soup);
    assert_true(bvh->depth <= BVH_MAX_DEPTH);
    assert_true(bvh_trace(bvh, o, d, 1e30f, &t, &triangle, &u, &v));
    assert_true(t == 5);
    bvh_destroy(&bvh);
    soup_end(&soup);

    /* triangles without area: points and segments in the ray's way */
    soup_begin(&soup, 3, 600);
    const float line[3][3] = {{0.2f, 0.3f, 0}, {0.2f, 0.3f, 1}, {0.2f, 0.3f, 2}};
    for (uint32_t k = 0; k < 3; k++)
        memcpy(soup.scene.vertices[k].position, line[k], sizeof line[k]);
    for (uint32_t i = 0; i < 600; i++)
        set_triangle(&soup, i, i % 3, (i / 3) % 3, (i / 9) % 3);
    bvh = build(&soup);
    const float slanted[3] = {0.01f, 0.02f, -1};
    assert_false(bvh_trace(bvh, o, d, 1e30f, &t, &triangle, &u, &v));
    assert_false(bvh_trace(bvh, o, slanted, 1e30f, &t, &triangle, &u, &v));
    bvh_destroy(&bvh);
    soup_end(&soup);
}

/* Coordinates at both ends of what a float holds: whatever is hit, nothing overflows into undefined
 * behaviour. */
static void extreme_coordinates_are_harmless(void **state)
{
    (void)state;
    static const float sizes[] = {FLT_MAX, 1e38f, 1e30f, 1e-30f, 1e-38f, 1e-44f, 0};
    for (size_t k = 0; k < sizeof sizes / sizeof *sizes; k++) {
        random_state = 21;
        struct soup soup;
        random_soup(&soup, 200, 0.5f);
        for (uint32_t i = 0; i < soup.mesh.vertex_count; i++)
            for (int a = 0; a < 3; a++) {
                float *p = &soup.scene.vertices[i].position[a];
                *p = *p / 1.5f * sizes[k];
                assert_true(isfinite(*p));
            }
        struct bvh *bvh = build(&soup);
        assert_true(bvh->depth <= BVH_MAX_DEPTH);
        float boxes[32][6];
        uint32_t count = bvh_frontier(bvh, boxes, 32);
        for (uint32_t i = 0; i < soup.mesh.vertex_count; i++) {
            bool is_held = false;
            for (uint32_t b = 0; b < count && !is_held; b++)
                is_held = box_holds(boxes[b], soup.scene.vertices[i].position);
            assert_true(is_held);
        }
        for (uint32_t i = 0; i < 500; i++) {
            const float o[3] = {random_unit() * sizes[k], random_unit() * sizes[k], random_unit() * sizes[k]};
            const float d[3] = {random_unit(), random_unit(), random_unit()};
            float t, u, v;
            uint32_t triangle;
            if (bvh_trace(bvh, o, d, INFINITY, &t, &triangle, &u, &v))
                assert_true(t > 0 && triangle < soup.mesh.triangle_count);
        }
        bvh_destroy(&bvh);
        soup_end(&soup);
    }
}

/* Boxes each eight times as large as the last: a bin holds all but the largest, so the heuristic alone
 * would peel off one per level, 80 levels deep. */
static void depth_is_limited(void **state)
{
    (void)state;
    enum { COUNT = 80 };
    float boxes[COUNT][6];
    for (int i = 0; i < COUNT; i++)
        for (int a = 0; a < 3; a++) {
            boxes[i][a] = ldexpf(1, 3 * i - 120);
            boxes[i][3 + a] = ldexpf(1.5f, 3 * i - 120);
        }
    struct error error;
    struct bvh *bvh = bvh_create_boxes((const float(*)[6])boxes, COUNT, &error);
    assert_non_null(bvh);
    assert_true(bvh->depth > BVH_MAX_DEPTH / 2);
    assert_true(bvh->depth <= BVH_MAX_DEPTH);
    assert_int_equal(bvh->node_count, COUNT); /* with the header */
    bvh_destroy(&bvh);
}

static void same_input_gives_the_same_tree(void **state)
{
    (void)state;
    random_state = 3;
    struct soup soup;
    random_soup(&soup, 5000, 0.02f);
    struct bvh *a = build(&soup), *b = build(&soup);
    assert_int_equal(a->node_count, b->node_count);
    assert_memory_equal(a->nodes, b->nodes, a->node_count * sizeof *a->nodes);
    assert_memory_equal(a->triangles, b->triangles, a->item_count * sizeof *a->triangles);
    bvh_destroy(&a);
    bvh_destroy(&b);
    soup_end(&soup);
}

static void a_frontier_holds_every_triangle(void **state)
{
    (void)state;
    random_state = 9;
    struct soup soup;
    bumpy_sphere(&soup, 30, 40, 0.01f);
    struct bvh *bvh = build(&soup);
    float(*boxes)[6] = calloc(300, sizeof *boxes);
    double last_area = INFINITY;
    for (uint32_t capacity = 1; capacity <= 256; capacity *= 2) {
        uint32_t count = bvh_frontier(bvh, boxes, capacity);
        assert_int_equal(count, capacity);
        for (uint32_t i = 0; i < soup.mesh.triangle_count; i++) {
            /* one box holds a triangle whole */
            bool is_held = false;
            for (uint32_t k = 0; k < count && !is_held; k++)
                is_held = box_holds(boxes[k], soup.scene.vertices[soup.scene.indices[3 * i]].position) &&
                          box_holds(boxes[k], soup.scene.vertices[soup.scene.indices[3 * i + 1]].position) &&
                          box_holds(boxes[k], soup.scene.vertices[soup.scene.indices[3 * i + 2]].position);
            assert_true(is_held);
        }
        double volume = 0;
        for (uint32_t k = 0; k < count; k++)
            volume += (double)(boxes[k][3] - boxes[k][0]) * (double)(boxes[k][4] - boxes[k][1]) *
                      (double)(boxes[k][5] - boxes[k][2]);
        assert_true(volume <= last_area);
        last_area = volume;
    }
    assert_true(last_area < 2); /* the sphere's box has 8: the frontier does follow the surface */
    free(boxes);
    bvh_destroy(&bvh);
    soup_end(&soup);
}

/* Every instance is in exactly one leaf, and every box lies within its parents'. */
static void top_levels_name_each_instance_once(void **state)
{
    (void)state;
    for (uint32_t count = 0; count < 40; count++) {
        random_state = count + 1;
        float(*boxes)[6] = calloc(count + 1, sizeof *boxes);
        for (uint32_t i = 0; i < count; i++)
            for (int a = 0; a < 3; a++) {
                boxes[i][a] = random_unit();
                boxes[i][3 + a] = boxes[i][a] + (random_bits() % 4 ? 0.2f : 0);
            }
        struct error error;
        struct bvh *bvh = bvh_create_boxes((const float(*)[6])boxes, count, &error);
        assert_non_null(bvh);
        assert_true(bvh->node_count <= (count ? count : 1)); /* the renderer reserves more */
        uint32_t seen[40] = {0}, stack[64] = {bvh_header(bvh)->root}, size = 1;
        const float whole[6] = {-INFINITY, -INFINITY, -INFINITY, INFINITY, INFINITY, INFINITY};
        float box_of[64][6];
        memcpy(box_of[0], whole, sizeof whole);
        while (size) {
            uint32_t reference = stack[--size];
            float box[6];
            memcpy(box, box_of[size], sizeof box);
            if (reference == BVH_DONE) {
                assert_int_equal(count, 0);
            } else if (reference & BVH_LEAF) {
                uint32_t instance = reference & BVH_INDEX_MASK;
                assert_int_equal(reference >> BVH_COUNT_SHIFT & BVH_COUNT_MASK, 0);
                assert_true(instance < count);
                assert_true(box_holds(box, boxes[instance]) && box_holds(box, boxes[instance] + 3));
                seen[instance]++;
            } else {
                for (uint32_t side = 0; side < 2; side++, size++) {
                    stack[size] = bvh_child(bvh, reference, side, box_of[size]);
                    assert_true(box_holds(box, box_of[size]) && box_holds(box, box_of[size] + 3));
                }
            }
        }
        for (uint32_t i = 0; i < count; i++)
            assert_int_equal(seen[i], 1);
        bvh_destroy(&bvh);
        free(boxes);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(random_triangles_match_brute_force),
        cmocka_unit_test(a_direction_need_not_be_unit),
        cmocka_unit_test(distance_limits_hold),
        cmocka_unit_test(closed_meshes_have_no_cracks),
        cmocka_unit_test(axis_aligned_rays_hit_a_grid),
        cmocka_unit_test(degenerate_meshes_are_harmless),
        cmocka_unit_test(extreme_coordinates_are_harmless),
        cmocka_unit_test(depth_is_limited),
        cmocka_unit_test(same_input_gives_the_same_tree),
        cmocka_unit_test(a_frontier_holds_every_triangle),
        cmocka_unit_test(top_levels_name_each_instance_once),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
