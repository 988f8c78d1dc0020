/* insets.c: which parts of a light's tile have cells of their own.
 *
 * A tile holds all casters as the light sees them. Where they are small against their distances, as a few
 * glasses in a square kilometre are, none of its cells is about one of them. Such casters get an inset: a
 * rectangle of the light's unit square with as many cells as the whole; those that are small even there get
 * an inset of that. A part leaves to its insets what they cover (caster_mask.comp, photon_emit.comp), so that
 * flux is exact wherever insets lie and they need not hold a caster to the last corner. As many as the budget
 * allows, first for the casters that the camera sees largest.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "view_state.h"

/* Cells across a caster, either way, below which it gets an inset; half a tile's where those are fewer. */
#define CELLS_ACROSS 8u
/* Insets that are there stay until their casters are that much wider: a tile that comes and goes starts anew.
 */
#define KEEP_INSETS 1.25f
/* Insets are not worth it where they make cells fewer than this along a side. */
#define LEAST_CELLS 8u
/* Around a caster, as a share of its width: boxes bend on the way to the unit square. */
#define INSET_MARGIN 0.05f
/* Of the unit square: floats have 16 steps in it. */
#define INSET_LEAST 1e-6f

/* ---- where a caster lies in the unit square ------------------------------------------------------------ */

/* The inverses of concentric_map and sphere_map (shaders/light.glsl). */
static void disk_place(float x, float y, float uv[2])
{
    float r = hypotf(x, y), o[2] = {0, 0};
    if (r > 1e-12f) {
        bool swapped = fabsf(y) > fabsf(x);
        o[swapped] = copysignf(r, swapped ? y : x);
        o[!swapped] = o[swapped] * atanf(swapped ? x / y : y / x) * 1.27323954f;
    }
    for (int k = 0; k < 2; k++)
        uv[k] = fminf(fmaxf(0.5f * o[k] + 0.5f, 0), 1);
}

static void sphere_place(const float d[3], float uv[2])
{
    float a = fabsf(d[0]), b = fabsf(d[1]), r = sqrtf(fmaxf(1 - fabsf(d[2]), 0));
    float phi = a > 0 || b > 0 ? atan2f(b, a) * 0.636619772f : 0;
    float o[2] = {r - phi * r, phi * r};
    if (d[2] < 0) {
        float first = o[0];
        o[0] = 1 - o[1];
        o[1] = 1 - first;
    }
    uv[0] = 0.5f * copysignf(o[0], d[0]) + 0.5f;
    uv[1] = 0.5f * copysignf(o[1], d[1]) + 0.5f;
}

/* False where the point is outside the tile; uv is then at its border. */
static bool place_of(const struct light_tile *tile, const vec4 *apex, const float p[3], float uv[2])
{
    const float from[3] = {tile->map == TILE_RECT ? tile->origin[0] : apex->x,
                           tile->map == TILE_RECT ? tile->origin[1] : apex->y,
                           tile->map == TILE_RECT ? tile->origin[2] : apex->z};
    float d[3] = {0, 0, 0}, length = 0;
    for (int k = 0; k < 3; k++) {
        float offset = p[k] - from[k];
        d[0] += offset * tile->x[k];
        d[1] += offset * tile->y[k];
        d[2] += offset * tile->z[k];
        length += offset * offset;
    }
    if (tile->map == TILE_RECT) {
        for (int k = 0; k < 2; k++)
            uv[k] = fminf(fmaxf(0.5f * d[k] / tile->half[k] + 0.5f, 0), 1);
        return fabsf(d[0]) <= tile->half[0] && fabsf(d[1]) <= tile->half[1];
    }
    length = sqrtf(fmaxf(length, 1e-30f));
    for (int k = 0; k < 3; k++)
        d[k] /= length;
    if (tile->map == TILE_SPHERE) {
        sphere_place(d, uv);
        return true;
    }
    float across = hypotf(d[0], d[1]);
    float height = d[2] > 0 ? across * across / (1 + d[2]) : 1 - d[2]; /* 1 - cosine, with its digits */
    float rho = sqrtf(fminf(height / tile->height, 1)) / fmaxf(across, 1e-30f);
    disk_place(d[0] * rho, d[1] * rho, uv);
    return height <= tile->height;
}

/* False where the light is in the caster or its tile does not hold any of it. */
static bool caster_rect(const struct view *view, uint32_t light, const struct caster_box *caster, float wider,
                        struct tile_part *part)
{
    const struct renderer *renderer = view->renderer;
    const struct light_tile *tile = &view->tiles[light];
    const vec4 *apex = &view->lights[light].position;
    bool is_in = false;
    for (int k = 0; k < 2; k++) {
        part->low[k] = 1;
        part->high[k] = 0;
    }
    for (uint32_t i = 0; i < (uint32_t)caster->maximum.w; i++) {
        const struct caster_box *box = &renderer->caster_boxes[(uint32_t)caster->minimum.w + i];
        if (tile->map != TILE_RECT && apex->x >= box->minimum.x && apex->x <= box->maximum.x &&
            apex->y >= box->minimum.y && apex->y <= box->maximum.y && apex->z >= box->minimum.z &&
            apex->z <= box->maximum.z)
            return false;
        for (int corner = 0; corner < 8; corner++) {
            const float p[3] = {corner & 1 ? box->maximum.x : box->minimum.x,
                                corner & 2 ? box->maximum.y : box->minimum.y,
                                corner & 4 ? box->maximum.z : box->minimum.z};
            float uv[2];
            is_in |= place_of(tile, apex, p, uv);
            for (int k = 0; k < 2; k++) {
                part->low[k] = fminf(part->low[k], uv[k]);
                part->high[k] = fmaxf(part->high[k], uv[k]);
            }
        }
    }
    for (int k = 0; k < 2; k++) {
        float margin = INSET_MARGIN * (part->high[k] - part->low[k]) + wider + INSET_LEAST;
        part->low[k] = fmaxf(part->low[k] - margin, 0);
        part->high[k] = fminf(part->high[k] + margin, 1);
        part->least[k] = part->high[k] - part->low[k];
    }
    return is_in;
}

/* ---- insets of a light --------------------------------------------------------------------------------- */

static bool holds(const struct tile_part *outer, const struct tile_part *inner)
{
    return outer->low[0] <= inner->low[0] && outer->high[0] >= inner->high[0] &&
           outer->low[1] <= inner->low[1] && outer->high[1] >= inner->high[1];
}

static bool overlap(const struct tile_part *a, const struct tile_part *b)
{
    return a->low[0] < b->high[0] && b->low[0] < a->high[0] && a->low[1] < b->high[1] &&
           b->low[1] < a->high[1];
}

/* Whether a caster of these sides is wide enough for the part: `least` is a share of the part's sides. */
static bool resolves(const struct tile_part *part, const float side[2], float least)
{
    for (int k = 0; k < 2; k++)
        if (side[k] < least * (part->high[k] - part->low[k]))
            return false;
    return true;
}

static struct tile_part united(const struct tile_part *a, const struct tile_part *b)
{
    struct tile_part u = *a;
    for (int k = 0; k < 2; k++) {
        u.low[k] = fminf(a->low[k], b->low[k]);
        u.high[k] = fmaxf(a->high[k], b->high[k]);
    }
    return u;
}

/* Finds the caster a place: in a part that has enough cells for it, in an inset that can grow to hold it, or
 * in a new one; as it is where there is none. */
static void place_caster(struct view *view, const struct tile_part *caster, uint32_t root, uint32_t first,
                         uint32_t most, float least)
{
    struct tile_part *parts = view->parts;
    uint32_t at = root;
    for (;;) {
        if (resolves(&parts[at], caster->least, least)) {
            for (int k = 0; k < 2 && at != root; k++)
                parts[at].least[k] = fminf(parts[at].least[k], caster->least[k]);
            return;
        }
        uint32_t within = NONE, touched = NONE, partly = 0, joined = NONE;
        float smallest = INFINITY;
        for (uint32_t i = first; i < view->part_count; i++) {
            if (parts[i].parent != at)
                continue;
            struct tile_part u = united(&parts[i], caster);
            if (holds(&parts[i], caster))
                within = i;
            else if (overlap(&parts[i], caster) && !holds(caster, &parts[i])) {
                touched = i;
                partly++;
            }
            bool is_free = resolves(&u, parts[i].least, least) && resolves(&u, caster->least, least);
            for (uint32_t k = first; k < view->part_count && is_free; k++)
                is_free = k == i || parts[k].parent != at || !overlap(&u, &parts[k]);
            float area = (u.high[0] - u.low[0]) * (u.high[1] - u.low[1]);
            if (is_free && area < smallest) {
                smallest = area;
                joined = i;
            }
        }
        if (within != NONE) {
            at = within;
            continue;
        }
        if (joined != NONE && partly <= (joined == touched ? 1u : 0u)) {
            parts[joined] = united(&parts[joined], caster);
            at = joined;
            continue;
        }
        if (partly == 1) {
            struct tile_part u = united(&parts[touched], caster);
            bool is_free = resolves(&u, parts[touched].least, least);
            for (uint32_t k = first; k < view->part_count && is_free; k++)
                is_free = k == touched || parts[k].parent != at || !overlap(&u, &parts[k]);
            if (!is_free)
                return;
            parts[touched] = u;
            at = touched;
            continue;
        }
        if (partly > 0 || view->part_count - first >= most) {
            view->insets_are_full = true;
            return;
        }
        for (uint32_t i = first; i < view->part_count; i++)
            if (parts[i].parent == at && holds(caster, &parts[i]))
                parts[i].parent = view->part_count;
        parts[view->part_count] = *caster;
        parts[view->part_count].light = root;
        parts[view->part_count++].parent = at;
        return;
    }
}

/* ---- all lights ---------------------------------------------------------------------------------------- */

struct rank {
    int size; /* power of two of the solid angle the camera sees it under */
    uint32_t caster;
};

static int compare_ranks(const void *a, const void *b)
{
    const struct rank *x = a, *y = b;
    return x->size != y->size ? (x->size < y->size) - (x->size > y->size)
                              : (x->caster > y->caster) - (x->caster < y->caster);
}

/* Casters in the order in which they get insets. */
static void rank_casters(const struct view *view, struct rank *ranks)
{
    const struct renderer *renderer = view->renderer;
    for (uint32_t i = 0; i < renderer->caster_count; i++) {
        const float *low = &renderer->casters[i].minimum.x, *high = &renderer->casters[i].maximum.x;
        float size2 = 0, far2 = 0;
        for (int k = 0; k < 3; k++) {
            float side = high[k] - low[k];
            float way = 0.5f * (high[k] + low[k]) - view->camera.eye[k];
            size2 += side * side;
            far2 += way * way;
        }
        ranks[i] = (struct rank){.caster = i};
        frexpf(fminf(size2 / fmaxf(far2, 1e-30f), 16), &ranks[i].size);
    }
    qsort(ranks, renderer->caster_count, sizeof *ranks, compare_ranks);
}

/* Cells along a tile's side, and the least samples of each, so that what so many lit tiles keep everywhere
 * takes at most a quarter of the budget and the rest can go where it shows. On `sphere` with 32,768 photons
 * tiles of 128 cells, half the budget, had an error of 0.0167 and those of 64 cells 0.0125. */
static uint32_t cells_within_budget(const struct view *view, uint32_t tiles, uint32_t *min_samples)
{
    uint32_t cells = emitter_cells(view), photons = budget_most(view);
    uint64_t least = (uint64_t)view->settings.min_samples * tiles;
    while (cells > 1 && 4 * least * cells * cells > photons)
        cells /= 2;
    *min_samples = least * cells * cells > photons ? photons / tiles : (uint32_t)view->settings.min_samples;
    return cells;
}

static void choose(struct view *view, const struct rank *ranks, float least, uint32_t most)
{
    const struct renderer *renderer = view->renderer;
    view->part_count = view->features.light_count;
    view->insets_are_full = false;
    for (uint32_t light = 0; light < view->features.light_count; light++) {
        if (!(view->lights[light].intensity.w > 0))
            continue;
        uint32_t first = view->part_count;
        /* what a light with a size sends to a caster passes beside its outline by an angle */
        float wider = emitter_widening(view, &view->lights[light]) / sqrtf(view->tiles[light].measure);
        for (uint32_t i = 0; i < renderer->caster_count; i++) {
            struct tile_part rect = {0};
            if (caster_rect(view, light, &renderer->casters[ranks[i].caster], wider, &rect))
                place_caster(view, &rect, light, first, most, least);
        }
    }
}

/* With `scale` times the cells across a caster. More tiles have fewer cells, with which more casters are
 * small. */
static void choose_for_cells(struct view *view, const struct rank *ranks, float scale, uint32_t most)
{
    uint32_t lights = view->features.light_count, lit = view->features.lit_count, cells;
    view->cells = cells_within_budget(view, lit, &view->min_samples);
    do {
        cells = view->cells;
        uint32_t across = cells < 2 * CELLS_ACROSS ? cells / 2 : CELLS_ACROSS;
        choose(view, ranks, fminf(scale * (float)across / (float)cells, 1), most);
        view->cells = cells_within_budget(view, lit + view->part_count - lights, &view->min_samples);
    } while (view->cells < cells);
}

void insets_choose(struct view *view)
{
    const struct renderer *renderer = view->renderer;
    uint32_t before = view->part_count, lights = view->features.light_count, lit = view->features.lit_count;
    for (uint32_t i = 0; i < lights; i++)
        view->parts[i] = (struct tile_part){.light = i, .parent = NONE, .high = {1, 1}};
    view->part_count = lights;
    view->insets_are_full = false;
    view->cells = cells_within_budget(view, lit, &view->min_samples);
    uint32_t photons = budget_most(view) / (4 * (uint32_t)view->settings.min_samples);
    uint32_t most = photons / (LEAST_CELLS * LEAST_CELLS);
    most = most < TILES_MAX ? most : TILES_MAX;
    if (view->settings.tile != TILE_FIT_CASTERS || renderer->caster_count < 2 || lit == 0 || most <= lights)
        return;
    struct rank *ranks = malloc(renderer->caster_count * sizeof *ranks);
    if (!ranks)
        return; /* the picture is right without insets */
    rank_casters(view, ranks);
    most = (most - lights) / lit;
    choose_for_cells(view, ranks, 1, most);
    if (view->part_count < before) {
        choose_for_cells(view, ranks, KEEP_INSETS, most);
        if (view->part_count != before)
            choose_for_cells(view, ranks, 1, most);
    }
    free(ranks);
}
