/* tiles.c: fits every light's tile to the casters, as the light sees them.
 *
 * Source: design 4. A tile keeps its place while it still holds the casters and is not much too large, so
 * that task buffers have something to rely on.
 */
#include <math.h>
#include <string.h>

#include "view_state.h"

#define CAP_MARGIN    1.02f /* on the half angle: bounding boxes move by rounding */
#define CAP_TOO_LARGE 1.25f /* half angle against the one needed: then it is worth a new tile */
#define CAP_WIDEST    1.9f  /* rad: above it a cap's map is stretched, the octahedron serves */
#define CAP_STEPS     48
#define PI_F          3.14159265f

static float dot3(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static bool normalise(float v[3])
{
    float length = sqrtf(dot3(v, v));
    if (!(length > 0) || !isfinite(length))
        return false;
    for (int i = 0; i < 3; i++)
        v[i] /= length;
    return true;
}

/* x, y perpendicular to the unit vector z; Duff et al. 2017, continuous but at z = -1. */
static void frame_about(const float z[3], float x[3], float y[3])
{
    float sign = copysignf(1.0f, z[2]);
    float a = -1.0f / (sign + z[2]), b = z[0] * z[1] * a;
    x[0] = 1.0f + sign * z[0] * z[0] * a;
    x[1] = sign * b;
    x[2] = -sign * z[0];
    y[0] = b;
    y[1] = sign + z[1] * z[1] * a;
    y[2] = -z[1];
}

static void box_corner(const struct caster_box *box, int corner, float p[3])
{
    p[0] = corner & 1 ? box->maximum.x : box->minimum.x;
    p[1] = corner & 2 ? box->maximum.y : box->minimum.y;
    p[2] = corner & 4 ? box->maximum.z : box->minimum.z;
}

/* 1 - cosine: a small angle keeps its digits. */
static float height_of(float half_angle)
{
    float s = sinf(0.5f * half_angle);
    return 2 * s * s;
}

static float half_angle_of(float height)
{
    return 2 * asinf(sqrtf(fminf(1, 0.5f * height)));
}

/* Largest 1 - cosine between `axis` and the corners of all boxes seen from `apex`; the corner's direction in
 * `farthest`. 2 when the apex is inside a box. */
static float widest_corner(const struct renderer *renderer, const float apex[3], const float axis[3],
                           float farthest[3])
{
    float largest = -1;
    for (uint32_t i = 0; i < renderer->caster_box_count; i++) {
        const struct caster_box *box = &renderer->caster_boxes[i];
        if (apex[0] >= box->minimum.x && apex[0] <= box->maximum.x && apex[1] >= box->minimum.y &&
            apex[1] <= box->maximum.y && apex[2] >= box->minimum.z && apex[2] <= box->maximum.z)
            return 2;
        for (int corner = 0; corner < 8; corner++) {
            float d[3];
            box_corner(box, corner, d);
            for (int k = 0; k < 3; k++)
                d[k] -= apex[k];
            if (!normalise(d))
                return 2;
            const float chord[3] = {d[0] - axis[0], d[1] - axis[1], d[2] - axis[2]};
            float height = 0.5f * dot3(chord, chord);
            if (height > largest) {
                largest = height;
                memcpy(farthest, d, sizeof d);
            }
        }
    }
    return largest;
}

/* A nearly smallest cone around the casters: the axis moves toward the farthest corner by ever smaller steps
 * (Badoiu and Clarkson 2003). Returns the half angle, pi when there is no such cone. */
static float fit_cone(const struct renderer *renderer, const float apex[3], float axis[3])
{
    float sum[3] = {0, 0, 0}, farthest[3] = {0, 0, 0};
    for (uint32_t i = 0; i < renderer->caster_box_count; i++) {
        const struct caster_box *box = &renderer->caster_boxes[i];
        float d[3] = {0.5f * (box->minimum.x + box->maximum.x) - apex[0],
                      0.5f * (box->minimum.y + box->maximum.y) - apex[1],
                      0.5f * (box->minimum.z + box->maximum.z) - apex[2]};
        if (normalise(d))
            for (int k = 0; k < 3; k++)
                sum[k] += d[k];
    }
    if (!normalise(sum))
        return PI_F;
    float best = 3;
    for (int step = 0; step < CAP_STEPS; step++) {
        float height = widest_corner(renderer, apex, sum, farthest);
        if (height >= 2)
            return PI_F;
        if (height < best) {
            best = height;
            memcpy(axis, sum, sizeof sum);
        }
        float weight = 1.0f / (float)(step + 2);
        for (int k = 0; k < 3; k++)
            sum[k] += weight * (farthest[k] - sum[k]);
        if (!normalise(sum))
            break;
    }
    return half_angle_of(best);
}

static void set_cap(struct light_tile *tile, const float axis[3], float half_angle)
{
    tile->map = TILE_CAP;
    memcpy(tile->z, axis, sizeof tile->z);
    frame_about(tile->z, tile->x, tile->y);
    tile->height = height_of(half_angle);
    tile->measure = 2 * PI_F * tile->height;
}

static void set_sphere(struct light_tile *tile)
{
    static const float axes[3][3] = {{1, 0, 0}, {0, 0, -1}, {0, 1, 0}};
    tile->map = TILE_SPHERE;
    memcpy(tile->x, axes[0], sizeof tile->x);
    memcpy(tile->y, axes[1], sizeof tile->y);
    memcpy(tile->z, axes[2], sizeof tile->z);
    tile->measure = 4 * PI_F;
}

/* The tile of a light with a position. */
static void fit_directions(const struct view *view, const struct light_gpu *light, struct light_tile *tile)
{
    const float apex[3] = {light->position.x, light->position.y, light->position.z};
    const float direction[3] = {light->direction.x, light->direction.y, light->direction.z};
    float cone = light->type == LIGHT_TYPE_SPOT     ? half_angle_of(light->position.w)
                 : light->type == LIGHT_TYPE_COSINE ? PI_F / 2
                                                    : PI_F;
    struct light_tile old = *tile;
    bool is_fitted = view->settings.tile == TILE_FIT_CASTERS;
    if (is_fitted && (tile->cone_pose != view->renderer->pose_version ||
                      memcmp(tile->cone_apex, apex, sizeof apex) != 0)) {
        tile->cone_half = fit_cone(view->renderer, apex, tile->cone_axis);
        tile->cone_pose = view->renderer->pose_version;
        memcpy(tile->cone_apex, apex, sizeof apex);
    }
    float half = is_fitted ? tile->cone_half : PI_F;
    float wider = emitter_widening(view, light);
    if (cone < PI_F)
        cone = fminf(cone + emitter_angle(light), PI_F);
    float wanted = fminf(half * CAP_MARGIN + wider + 1e-5f, PI_F);
    if (cone < PI_F && cone <= wanted)
        set_cap(tile, direction, cone);
    else if (wanted > CAP_WIDEST)
        set_sphere(tile);
    else {
        float unused[3];
        bool holds = old.is_valid && old.map == TILE_CAP &&
                     widest_corner(view->renderer, apex, old.z, unused) <=
                         (wider > 0 ? height_of(fmaxf(half_angle_of(old.height) - wider, 0)) : old.height) &&
                     half_angle_of(old.height) <= CAP_TOO_LARGE * wanted;
        if (!holds)
            set_cap(tile, tile->cone_axis, wanted);
    }
}

static void fit_beam(const struct view *view, const struct light_gpu *light, struct light_tile *tile)
{
    const struct renderer *renderer = view->renderer;
    struct light_tile fitted = {.map = TILE_RECT};
    const float direction[3] = {light->direction.x, light->direction.y, light->direction.z};
    memcpy(fitted.z, direction, sizeof fitted.z);
    frame_about(fitted.z, fitted.x, fitted.y);
    const float *low_end = renderer->scene_min, *high_end = renderer->scene_max;
    const struct caster_box whole = {{low_end[0], low_end[1], low_end[2], 0},
                                     {high_end[0], high_end[1], high_end[2], 0}};
    bool is_fitted = view->settings.tile == TILE_FIT_CASTERS;
    uint32_t count = is_fitted ? renderer->caster_box_count : 1;
    float low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, start = INFINITY, p[3];
    for (uint32_t i = 0; i < count; i++)
        for (int corner = 0; corner < 8; corner++) {
            box_corner(is_fitted ? &renderer->caster_boxes[i] : &whole, corner, p);
            float place[2] = {dot3(p, fitted.x), dot3(p, fitted.y)};
            for (int k = 0; k < 2; k++) {
                low[k] = fminf(low[k], place[k]);
                high[k] = fmaxf(high[k], place[k]);
            }
        }
    for (int corner = 0; corner < 8; corner++) {
        box_corner(&whole, corner, p);
        start = fminf(start, dot3(p, fitted.z));
    }
    float reach = fmaxf(high[0] - low[0], high[1] - low[1]);
    start -= 0.01f * reach + 1e-3f * fabsf(start);
    for (int k = 0; k < 2; k++)
        fitted.half[k] = fmaxf(0.5f * (high[k] - low[k]) * CAP_MARGIN, 1e-6f * reach + 1e-12f);
    for (int k = 0; k < 3; k++)
        fitted.origin[k] = 0.5f * (low[0] + high[0]) * fitted.x[k] + 0.5f * (low[1] + high[1]) * fitted.y[k] +
                           start * fitted.z[k];
    fitted.measure = 4 * fitted.half[0] * fitted.half[1];
    *tile = fitted;
}

static void put_vec4(vec4 *target, const float v[3], float w)
{
    *target = (vec4){v[0], v[1], v[2], w};
}

static uint32_t map_key(const struct light_tile *tile, float key[14])
{
    memcpy(key, tile->x, 3 * sizeof(float));
    memcpy(key + 3, tile->z, 3 * sizeof(float));
    memcpy(key + 6, tile->origin, 3 * sizeof(float));
    memcpy(key + 9, tile->half, 2 * sizeof(float));
    key[11] = tile->height;
    key[12] = tile->measure;
    key[13] = (float)tile->map;
    return 14;
}

/* False when the light had to shrink, see emitter_fit. */
static bool describe_light(const struct view *view, uint32_t index, struct light_gpu *light)
{
    const struct renderer *renderer = view->renderer;
    const struct scene_light *source = &renderer->scene->lights[index];
    const struct view_light *change = &view->light_changes[index];
    float position[3], direction[3], intensity[3];
    memcpy(position, renderer->pose->lights[index].position, sizeof position);
    memcpy(direction, renderer->pose->lights[index].direction, sizeof direction);
    memcpy(intensity, source->intensity, sizeof intensity);
    if (change->overrides & LIGHT_OVERRIDE_POSITION)
        memcpy(position, change->position, sizeof position);
    if (change->overrides & LIGHT_OVERRIDE_DIRECTION) {
        memcpy(direction, change->direction, sizeof direction);
        normalise(direction);
    }
    if (change->overrides & LIGHT_OVERRIDE_INTENSITY)
        memcpy(intensity, change->intensity, sizeof intensity);
    memset(light, 0, sizeof *light);
    light->type = source->is_emissive_mesh && source->type == LIGHT_SPOT ? LIGHT_TYPE_COSINE
                  : source->type == LIGHT_DIRECTIONAL                    ? LIGHT_TYPE_DIRECTIONAL
                  : source->type == LIGHT_SPOT                           ? LIGHT_TYPE_SPOT
                                                                         : LIGHT_TYPE_POINT;
    put_vec4(&light->position, position, height_of(source->outer_cone));
    put_vec4(&light->direction, direction, height_of(source->inner_cone));
    put_vec4(&light->intensity, intensity, intensity[0] + intensity[1] + intensity[2]);
    return emitter_fit(view, source->shape, source->half_size, renderer->pose->lights[index].side, light);
}

/* Irradiance of uncaustic light at the nearest caster: the scale of the accumulator. A caster that the light
 * touches tells nothing about where its light lands, so a distance below a 32nd of the scene does not count:
 * on a floor that far away the unit is still a millionth of what arrives. */
static float reference_irradiance(const struct view *view, const struct light_gpu *light)
{
    const struct renderer *renderer = view->renderer;
    if (light->type == LIGHT_TYPE_DIRECTIONAL)
        return light->intensity.w;
    float nearest = INFINITY, size2 = 0;
    for (int k = 0; k < 3; k++) {
        float side = renderer->scene_max[k] - renderer->scene_min[k];
        size2 += side * side;
    }
    for (uint32_t i = 0; i < renderer->caster_box_count; i++) {
        const struct caster_box *box = &renderer->caster_boxes[i];
        float d[3] = {0.5f * (box->minimum.x + box->maximum.x) - light->position.x,
                      0.5f * (box->minimum.y + box->maximum.y) - light->position.y,
                      0.5f * (box->minimum.z + box->maximum.z) - light->position.z};
        nearest = fminf(nearest, dot3(d, d));
    }
    return light->intensity.w / fmaxf(fmaxf(nearest, size2 / (32 * 32)), 1e-12f);
}

static vec4 place_in_square(const struct tile_part *part)
{
    return (vec4){part->low[0], part->low[1], part->high[0] - part->low[0], part->high[1] - part->low[1]};
}

/* Chooses insets anew where what they were chosen for has changed. */
static void update_insets(struct view *view, bool moved)
{
    const struct settings *settings = &view->settings;
    struct insets_key key;
    memset(&key, 0, sizeof key);
    key.pose = view->renderer->pose_version;
    key.photons = budget_most(view);
    key.lit_count = view->features.lit_count;
    key.min_samples = settings->min_samples;
    key.cells = settings->cells;
    key.fit = settings->tile;
    if (view->insets_are_full)
        memcpy(key.eye, view->camera.eye, sizeof key.eye);
    if (moved || memcmp(&key, &view->insets_key, sizeof key) != 0)
        insets_choose(view);
    view->insets_key = key;
}

/* Shape of the task buffers; a change of it, or of the rule, starts them anew. */
static void shape_task_buffers(struct view *view, uint32_t old_cells)
{
    uint32_t slots = 1;
    while (slots < view->part_count)
        slots *= 4;
    if (view->cells != old_cells || slots != view->tile_slots ||
        view->density_rule != (uint32_t)view->settings.density)
        view->has_density = view->has_feedback = false;
    view->tile_slots = slots;
    view->density_rule = (uint32_t)view->settings.density;
}

void tiles_update(struct view *view)
{
    struct renderer *renderer = view->renderer;
    uint32_t count = view->features.light_count;
    view->lights_shrunk = 0;
    float flux = 0, reference = 0, smallest = 1;
    bool changed = view->tiles_pose != renderer->pose_version;
    bool has_moved[SCENE_MAX_LIGHTS], is_same[SCENE_MAX_LIGHTS];
    for (uint32_t i = 0; i < count; i++) {
        struct light_gpu *light = &view->lights[i], before = *light;
        struct light_tile *tile = &view->tiles[i], old = *tile;
        view->lights_shrunk += describe_light(view, i, light) ? 0 : 1;
        has_moved[i] = memcmp(&before.position, &light->position, 2 * sizeof(vec4)) != 0;
        light->medium = before.medium;
        if (light->type != LIGHT_TYPE_DIRECTIONAL &&
            (has_moved[i] || !old.is_valid || view->tiles_pose != renderer->pose_version))
            light->medium =
                solids_at(&renderer->solids, renderer->scene, renderer->pose, renderer->trees,
                          (const float[3]){light->position.x, light->position.y, light->position.z});
        changed |= has_moved[i] || memcmp(&before.emitter_x, &light->emitter_x, 2 * sizeof(vec4)) != 0 ||
                   (before.intensity.w > 0) != (light->intensity.w > 0);
        if (light->type == LIGHT_TYPE_DIRECTIONAL)
            fit_beam(view, light, tile);
        else
            fit_directions(view, light, tile);
        tile->is_valid = true;
        float key[14], old_key[14];
        size_t key_size = map_key(tile, key) * sizeof(float);
        map_key(&old, old_key);
        is_same[i] = old.is_valid && memcmp(key, old_key, key_size) == 0;
        changed |= !is_same[i];
        light->has_previous = old.is_valid;
        light->map = tile->map;
        put_vec4(&light->tile_x, tile->x, tile->half[0]);
        put_vec4(&light->tile_y, tile->y, tile->half[1]);
        put_vec4(&light->tile_z, tile->z, tile->height);
        put_vec4(&light->tile_origin, tile->origin, tile->measure);
        light->old_map = old.map;
        put_vec4(&light->old_x, old.x, old.half[0]);
        put_vec4(&light->old_y, old.y, old.half[1]);
        put_vec4(&light->old_z, old.z, old.height);
        put_vec4(&light->old_origin, old.origin, old.measure);
        flux += light->intensity.w * tile->measure;
        reference = fmaxf(reference, reference_irradiance(view, light));
    }

    struct tile_part old_parts[TILES_MAX];
    uint32_t old_count = view->part_count, old_cells = view->cells;
    memcpy(old_parts, view->parts, sizeof old_parts);
    if (view->features.needs_caustics) {
        update_insets(view, changed);
        shape_task_buffers(view, old_cells);
    }
    /* what became of the parts of every light: shifted, or only moved with their casters */
    bool parts_differ[SCENE_MAX_LIGHTS] = {false}, parts_move[SCENE_MAX_LIGHTS] = {false};
    for (uint32_t i = 0; i < view->part_count || i < old_count; i++) {
        const struct tile_part *part = &view->parts[i], *old = &old_parts[i];
        bool is_new = i < view->part_count, was_there = i < old_count;
        bool differs = !is_new || !was_there || part->light != old->light || part->parent != old->parent;
        bool moves = !differs && (memcmp(part->low, old->low, sizeof part->low) != 0 ||
                                  memcmp(part->high, old->high, sizeof part->high) != 0);
        if (is_new) {
            parts_differ[part->light] |= differs;
            parts_move[part->light] |= moves;
            smallest = fminf(smallest, (part->high[0] - part->low[0]) * (part->high[1] - part->low[1]));
        }
        if (was_there)
            parts_differ[old->light] |= differs;
        changed |= differs || moves;
    }
    for (uint32_t i = 0; i < count; i++) {
        struct light_gpu *light = &view->lights[i];
        light->has_previous = light->has_previous && view->has_density;
        /* A tile that follows its moving light keeps its densities by place: they go with the caster. */
        light->changed = light->has_previous && light->old_map == light->map &&
                         (parts_differ[i] || (!has_moved[i] && (!is_same[i] || parts_move[i])));
    }
    view->old_part_count = old_count;
    for (uint32_t i = 0; i < view->part_count || i < old_count; i++) {
        struct light_gpu *light = &view->lights[i];
        if (i < view->part_count) {
            const struct tile_part *part = &view->parts[i];
            if (i >= count)
                *light = view->lights[part->light];
            light->part = place_in_square(part);
            light->part_light = part->light;
            light->part_parent = part->parent;
        }
        light->part_insets = 0;
        light->old_part = place_in_square(&old_parts[i]);
        light->old_light = i < old_count ? old_parts[i].light : NONE;
    }
    for (uint32_t i = count; i < view->part_count; i++)
        view->lights[view->parts[i].parent].part_insets++;
    view->features.bits |= view->features.needs_caustics && view->part_count > count ? FEATURE_INSETS : 0;
    view->mask_is_stale = changed || !view->has_density;
    view->tiles_pose = renderer->pose_version;

    struct frame_gpu *data = &view->data;
    data->flux_unit = fmaxf(flux, 1e-30f) * fmaxf(smallest, 0x1p-16f) * 0x1p-40f;
    data->irradiance_unit = fmaxf(reference, 1e-30f) * 0x1p-26f;
    data->cell_flux = fmaxf(flux, 1e-30f) * fmaxf(smallest, 1e-8f) /
                      (fmaxf((float)view->features.lit_count, 1) * (float)(view->cells * view->cells));
}
