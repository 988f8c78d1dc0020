/* view_state.h: what the renderer, the view and its passes share; private to core/render.
 *
 * A view keeps its buffers in one table by number. A pass asks for the buffers it needs with view_buffer,
 * which makes or grows them; what no pass of the current plan asked for is freed. Passes record dispatches
 * with view_dispatch, naming shader and buffers; pipelines are looked up by shader and constants and shared
 * by all views of a renderer.
 */
#ifndef CAUSTIC_VIEW_STATE_H
#define CAUSTIC_VIEW_STATE_H

#include "governor.h"
#include "renderer.h"
#include "../scene/bvh.h"
#include "../scene/extent.h"
#include "../scene/solids.h"
#include "../../shaders/shared/lookup_layout.h"
#include "../../shaders/shared/render_layout.h"

/* ---- renderer ------------------------------------------------------------------------------------------ */

#define RENDERER_MAX_PIPELINES 256u /* several times what one frame uses */
#define MAX_CASTER_BOXES       4096u
#define TILES_MAX              64u /* of all lights, insets included; at least one for each of SCENE_MAX_LIGHTS */

/* Room per photon of the budget. Half of the rays of a glass scene end at every bounce and the others split:
 * four slots a photon let all of them split (measured on `sphere`, `square`, `cornell`); beyond it they
 * choose. */
#define RAYS_PER_PHOTON   4u
#define STORED_PER_PHOTON 5u

/* Where glass disperses every photon may become three, and theirs split as well. */
#define RAYS_PER_BAND_PHOTON   8u
#define STORED_PER_BAND_PHOTON 8u

struct renderer_pipeline {
    char shader[48];
    uint32_t constants[7];
    uint64_t last_used; /* renderer's pipeline_uses then */
    struct gpu_pipeline *pipeline;
};

struct renderer {
    struct gpu *gpu;
    const struct scene *scene;
    enum tracer tracer;
    struct renderer_limits limits;

    struct gpu_buffer *nodes, *triangles, *instances, *vertices, *indices, *materials, *texels;
    struct gpu_buffer *more_triangles; /* those past `first_triangles`; NULL where `triangles` holds all */
    uint32_t first_triangles;          /* 0 where `triangles` holds all */
    uint32_t top_node_capacity;        /* nodes reserved at the front of `nodes` */
    struct gpu_accel **bottoms;        /* per mesh, khr only */
    struct gpu_accel *top;
    struct bvh **trees;                  /* per mesh; bvh: for bounds; khr: NULL trees are possible */
    uint32_t *tree_node, *tree_triangle; /* where a mesh's tree starts in `nodes` and `triangles` */
    struct solids solids;
    struct scene_extent extent; /* positions are relative to its origin, here and on the device */
    float (*mesh_boxes)[6]; /* per mesh: frontier boxes of caster meshes, object space, island after island */
    uint32_t *mesh_islands; /* per box: number of its island, see boxes_by_island */
    uint32_t *mesh_first_box, *mesh_box_count;

    struct scene_pose *pose;
    double pose_time;
    bool has_pose;
    uint64_t pose_version;     /* grows when anything moved */
    uint64_t uploaded_version; /* pose_version that the device has */
    struct scene_instance_gpu *instance_data;
    float scene_min[3], scene_max[3]; /* at the current pose */
    struct caster_box *caster_boxes;  /* what their parts lie in */
    uint32_t caster_box_count;
    struct caster_box *casters; /* things that cast: instances, or islands of one */
    uint32_t caster_count;

    struct renderer_pipeline pipelines[RENDERER_MAX_PIPELINES];
    uint32_t pipeline_count;
    uint64_t pipeline_uses;
};

size_t renderer_rays_per_photon(const struct scene *scene);
size_t renderer_stored_per_photon(const struct scene *scene);

/* Brings instances, top level and caster boxes to `time`; uploads into `frame` what changed. */
bool renderer_set_time(struct renderer *renderer, double time, struct error *error);
bool renderer_upload_pose(struct renderer *renderer, struct gpu_frame *frame, struct error *error);

/* ---- view ---------------------------------------------------------------------------------------------- */

enum view_buffer {
    BUFFER_FRAME,
    BUFFER_LIGHTS,
    BUFFER_COUNTERS,
    BUFFER_BOXES,
    BUFFER_MASK,
    BUFFER_DENSITY, /* even and odd frames */
    BUFFER_DENSITY_OTHER,
    BUFFER_TREE,
    BUFFER_COLUMNS, /* strata of a cell in u; its leaf of the tree over it: in v */
    BUFFER_ASPECT,  /* density=error: log2 of wanted columns over rows */
    BUFFER_COSTS,   /* density=error: rays traced for a cell */
    BUFFER_PARTIALS,
    BUFFER_FEEDBACK,
    BUFFER_VARIANCE,
    BUFFER_RAYS, /* even and odd bounces */
    BUFFER_RAYS_OTHER,
    BUFFER_SPREADS, /* beside the rays */
    BUFFER_SPREADS_OTHER,
    BUFFER_QUEUE, /* even and odd bounces */
    BUFFER_QUEUE_OTHER,
    BUFFER_OUTCOMES,
    BUFFER_GROUPS,
    BUFFER_PHOTONS,
    BUFFER_SURFACES,
    BUFFER_TARGETS,
    BUFFER_SUMS,
    BUFFER_PIECES,
    BUFFER_PICTURE,    /* what quads drew */
    BUFFER_REACHED,    /* photons whose quad reached a pixel */
    BUFFER_IRRADIANCE, /* even and odd frames */
    BUFFER_IRRADIANCE_OTHER,
    BUFFER_BLENDED, /* irradiance with its history, even and odd frames */
    BUFFER_BLENDED_OTHER,
    BUFFER_OLD_TARGETS, /* what the history lies on */
    BUFFER_CHAINS,
    BUFFER_CHAIN_WEIGHTS,
    BUFFER_CHAIN_PLACES,
    BUFFER_BROKEN, /* pixels with several camera rays, and each pixel's place among them */
    BUFFER_LOOKUP,
    BUFFER_LOOKUP_CELLS,
    BUFFER_LOOKUP_MARKS,
    BUFFER_LOOKUP_WALKS,
    BUFFER_LOOKUP_POINTS,
    BUFFER_LOOKUP_CODES,
    BUFFER_LOOKUP_PHOTONS,
    BUFFER_LOOKUP_SUMS,
    BUFFER_TREE_NODES, /* of photons, where points look for them */
    BUFFER_TREE_PLACES,
    BUFFER_TREE_ORDER,
    BUFFER_TREE_POINTS,
    BUFFER_TREE_SHARES,
    BUFFER_INDIRECT,
    BUFFER_READBACK_LOOKUP,
    BUFFER_SOFT, /* irradiance by differentials, while soft=auto compares */
    BUFFER_OUTPUT,
    BUFFER_READBACK,
    BUFFER_READBACK_COUNTERS,
    BUFFER_COUNT
};

/* What scene, lights, settings and the asked channels amount to; computed anew every frame, cheap to compare.
 */
struct features {
    uint32_t bits; /* FEATURE_* */
    uint32_t light_count, caster_count, receiver_count;
    uint32_t lit_count;  /* lights that are not black */
    bool needs_caustics; /* some channel or statistic depends on photons */
    const char
        *no_lookup_reason; /* why caustics are not looked up through glass and mirrors; NULL: they are */
    const char *black_reason;
};

struct plan {
    struct plan_line lines[VIEW_MAX_PLAN_LINES];
    uint32_t line_count;
    bool has_gbuffer, has_photons, has_feedback, has_variance, has_lookup, has_spreads, has_output;
    bool has_temporal;
    bool has_sums;  /* splats add to fixed-point sums in compute */
    bool has_quads; /* splats are rasterised */
};

/* The raster that draws quads, and what it was made for; NULL when none are drawn. */
struct splat_quads {
    struct gpu_raster *raster;
    uint32_t width, height;
    int32_t aa, depth_test;
    uint32_t wanted, samples; /* of a pixel: by the budget, and what the device has of it */
};

/* soft=auto: which way the emitters' size is drawn. */
enum soft_stage {
    SOFT_UNMEASURED, /* this frame draws differentials and keeps the picture */
    SOFT_COMPARING,  /* this one draws samples, from the same place, and compares */
    SOFT_GUESSED,    /* the camera moved: by the emitter's angle, until it stands still */
    SOFT_MEASURED
};
struct soft_choice {
    enum soft_stage stage;
    bool errs;    /* differentials do */
    float angle;  /* of the widest emitter when it was measured, rad */
    double error; /* measured: relative L1 of differentials against samples */
};

struct light_tile {
    uint32_t map;
    float x[3], y[3], z[3]; /* frame */
    float half[2];          /* TILE_RECT */
    float height;           /* TILE_CAP: 1 - cos(half angle) */
    float origin[3];
    float measure; /* sr or m^2 */
    bool is_valid;
    /* the casters' cone, which stays while they and the light do */
    float cone_apex[3], cone_axis[3], cone_half;
    uint64_t cone_pose; /* pose_version it was found at; 0: never */
};

/* A rectangle of a light's unit square that has cells of its own: the whole square, or an inset (insets.c).
 */
struct tile_part {
    uint32_t light, parent; /* parent: the part that it is an inset of; NONE: it is the whole */
    float low[2], high[2];  /* in the light's unit square */
    float least[2];         /* an inset: sides of the narrowest caster it is for */
};

struct view {
    struct renderer *renderer;
    uint32_t width, height;
    struct settings settings;
    struct view_camera camera; /* relative to the extent's origin, as are changed lights */
    uint32_t follow_camera;    /* SCENE_NONE: own camera */
    double time;
    struct view_light *light_changes; /* per light of the scene */

    struct features features;
    struct plan plan;
    uint32_t channel_mask;

    struct gpu_buffer *buffers[BUFFER_COUNT];
    size_t asked[BUFFER_COUNT]; /* bytes this plan asked for; 0: not used */
    struct splat_quads quads;

    /* temporal state */
    uint64_t frame;             /* frames rendered */
    uint32_t subframe;          /* rendered since the last reset: parity of the ping-pong buffers */
    uint32_t cells, tile_slots; /* the task buffers' shape; 0: none yet */
    uint32_t min_samples;       /* what the budget allows of the setting */
    bool has_density, has_feedback, has_previous;
    bool has_history;      /* the last frame's blended irradiance still holds */
    uint64_t history_pose; /* pose_version that it was made at */
    uint32_t still_frames; /* since anything was changed about the view */
    uint32_t density_rule;
    struct light_tile *tiles;          /* per light */
    struct tile_part parts[TILES_MAX]; /* of the tiles: the whole of each light's, then insets */
    uint32_t part_count, old_part_count;
    bool insets_are_full; /* some caster should have one and has not */
    struct insets_key {
        uint64_t pose;
        uint32_t photons, lit_count;
        int32_t min_samples, cells, fit;
        float eye[3];    /* while insets are full */
    } insets_key;        /* what they were chosen for */
    uint64_t tiles_pose; /* pose_version they were fitted to */
    bool mask_is_stale;
    uint64_t eye_pose; /* pose_version that data.eye_medium belongs to */
    struct soft_choice soft;
    struct governor governor; /* of budget_ms */
    uint32_t lights_shrunk;   /* emitters with a caster within them, drawn smaller */
    struct light_gpu *lights; /* per part, those of lights first */
    struct frame_gpu data;
    struct frame_gpu last_data;

    struct frame_result result;
    float *host_values; /* zeros for frames without device work; NULL when the readback buffer serves */
    size_t host_size;
    float *atlas_values;
    size_t atlas_size;
    struct error error; /* first error while recording */
    bool failed;
};

/* Asks for a device buffer of at least `size` bytes for the current plan. Contents are lost when it grows. */
bool view_buffer(struct view *view, enum view_buffer id, size_t size);

struct view_use {
    uint32_t binding;
    enum gpu_access access;
    enum view_buffer buffer;
};

struct view_dispatch {
    const char *shader; /* file name; ".bvh" or ".khr" is added when it traces */
    bool traces;        /* binds the whole scene */
    bool lights;        /* binds the lights */
    uint32_t phase;     /* constant_id 8 */
    const struct view_use *uses;
    uint32_t use_count;
    uint32_t push; /* one word of push constants */
    bool has_push;
    uint32_t groups[2];
    enum view_buffer indirect; /* used when indirect_offset is not 0 */
    size_t indirect_offset;
};

#define USES(...)                                                                                            \
    .uses = (const struct view_use[]){__VA_ARGS__},                                                          \
    .use_count = sizeof((const struct view_use[]){__VA_ARGS__}) / sizeof(struct view_use)

void view_dispatch(struct view *view, struct gpu_frame *frame, const struct view_dispatch *dispatch);

static inline uint32_t groups_of(uint32_t count)
{
    return (count + GROUP_SIZE - 1) / GROUP_SIZE;
}

/* Unit, orthogonal axes of a camera; false when it has none. */
bool view_camera_axes(const struct view_camera *camera, float forward[3], float right[3], float up[3]);

/* ---- steps of a frame, in order ------------------------------------------------------------------------ */

void features_find(const struct view *view, uint32_t channel_mask, struct features *features);
void plan_make(const struct view *view, const struct features *features, uint32_t channel_mask,
               struct plan *plan);

/* budget.c: the most photons a frame may have by the settings; buffers are made for them. */
uint32_t budget_most(const struct view *view);
/* Why budget_ms does not steer this frame; NULL: it does. */
const char *budget_reason_against(const struct view *view, const struct plan *plan);
/* Budget, target area and camera samples of this frame. */
void budget_fill(struct view *view, struct frame_gpu *data);
/* After it: what it took, and what that makes of the next. */
uint32_t budget_samples(struct view *view); /* of multisampled splats, of the current plan */
void budget_measure(struct view *view, uint64_t elapsed_ns);

/* tiles.c: fits light tiles to casters and shapes the task buffers; fills view->lights. Before buffers are
 * asked for, and again for every further subframe. */
void tiles_update(struct view *view);

/* insets.c: which parts of the fitted tiles have cells of their own (view->parts), how many cells
 * (view->cells) and how many samples each of them keeps at least (view->min_samples). Needs view->lights and
 * view->tiles. */
void insets_choose(struct view *view);

/* emitter.c: lights with a size. `emitter_fit` describes one to the shaders, given position, direction and
 * type; false when its casters are so near that it had to shrink. */
bool emitter_fit(const struct view *view, enum light_shape shape, const float half_size[2],
                 const float side[3], struct light_gpu *light);
/* Cells along a tile's side that the view needs when every light of it has a size: one photon per cell is the
 * least, and large footprints need few. settings.cells otherwise. */
uint32_t emitter_cells(const struct view *view);
bool emitter_uses_samples(const struct view *view);
/* soft=auto measures: while the frame is recorded, and after it was read back. */
bool emitter_prepare(struct view *view);
void emitter_record(struct view *view, struct gpu_frame *frame);
void emitter_measure(struct view *view, const struct counters_gpu *counters);
/* Half the angle under which a caster sees the emitter. */
float emitter_angle(const struct light_gpu *light);
/* How much wider a cone about the casters, as seen from the light's middle, has to be for every part of it.
 */
float emitter_widening(const struct view *view, const struct light_gpu *light);

/* A pass: `prepare` asks for buffers, `record` records. */
bool gbuffer_prepare(struct view *view);
void gbuffer_record(struct view *view, struct gpu_frame *frame);
/* The camera rays of broken pixels, once lookup.c found them. */
void gbuffer_record_samples(struct view *view, struct gpu_frame *frame);
bool density_prepare(struct view *view);
void density_record(struct view *view, struct gpu_frame *frame);
bool photons_prepare(struct view *view);
void photons_record(struct view *view, struct gpu_frame *frame);
/* Whether the device has what this anti-aliasing (enum splat_aa) needs; the error names it. */
bool splat_check_aa(const struct renderer *renderer, int32_t aa, struct error *error);
bool splat_prepare(struct view *view);
uint32_t splat_samples(const struct view *view);            /* per pixel, of the current plan */
enum view_buffer splat_irradiance(const struct view *view); /* what this frame resolves into */
void splat_record(struct view *view, struct gpu_frame *frame);
bool lookup_prepare(struct view *view);
void lookup_record(struct view *view, struct gpu_frame *frame);
void lookup_add_counters(struct view *view);
/* Why no caustic can be seen through glass or mirrors by this camera at the current pose; NULL: one may be.
 */
const char *lookup_reason_against(const struct view *view, uint32_t channel_mask, uint32_t caster_count);
/* Grid and filter of this frame, after its camera. */
void lookup_fill(const struct view *view, uint32_t subframe_count, struct frame_gpu *data);
void feedback_record(struct view *view, struct gpu_frame *frame);
/* temporal.c: the caustics shown, blended with the frames before. */
bool temporal_prepare(struct view *view);
void temporal_record(struct view *view, struct gpu_frame *frame);
enum view_buffer temporal_output(const struct view *view);
bool compose_prepare(struct view *view);
void compose_record(struct view *view, struct gpu_frame *frame);

/* result.c: takes a subframe's statistics, weighted, and pass times into view->result; and, after the last
 * one, its channels. */
void result_add_counters(struct view *view, double weight);
void result_add_timings(struct view *view, struct gpu_frame *frame);
bool result_collect_channels(struct view *view, struct error *error);

#endif
