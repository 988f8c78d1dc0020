/* render_layout.h: what passes hand to each other, as C and GLSL see it.
 *
 * Units: metres, W, W/sr, W/m^2; areas on screen in px^2. Positions are relative to the view's eye where a
 * name says `relative`, so that scenes far from the origin keep their precision.
 */
#ifndef RENDER_LAYOUT_H
#define RENDER_LAYOUT_H
#include "scene_layout.h"

#define NONE 0xffffffffu

/* Workgroup size of every list pass (design 12: 64 suits lavapipe and GPUs). */
#define GROUP_SIZE 64

/* ---- specialisation ------------------------------------------------------------------------------------ */

/* constant_id 0: what the scene and the settings have, as a bit set; dead code goes with cleared bits. */
#define FEATURE_DIELECTRIC    (1u << 0)
#define FEATURE_THIN          (1u << 1)
#define FEATURE_MIRROR        (1u << 2)
#define FEATURE_TEXTURE       (1u << 3)
#define FEATURE_ABSORPTION    (1u << 4)
#define FEATURE_EMISSION      (1u << 5)
#define FEATURE_CHROMATIC     (1u << 6) /* photons differ in colour: accumulate three channels, not one */
#define FEATURE_POINT         (1u << 7)
#define FEATURE_SPOT          (1u << 8)
#define FEATURE_DIRECTIONAL   (1u << 9)
#define FEATURE_CAUSTICS      (1u << 10)
#define FEATURE_VARIANCE      (1u << 11)
#define FEATURE_BEAUTY        (1u << 12) /* somebody asked for direct light */
#define FEATURE_TEXTURED_FLUX (1u << 13) /* photons carry the albedo they meet: aa=pixel */
#define FEATURE_CHAINS        (1u << 14) /* somebody looks through glass and mirrors */
#define FEATURE_INSETS        (1u << 15) /* some light has more than one tile */
#define FEATURE_SOFT          (1u << 20) /* some light is a sphere, disk or rectangle */
#define FEATURE_ROUGH         (1u << 21) /* some caster is not polished */
#define FEATURE_DISPERSION    (1u << 22) /* some glass refracts colours differently */
#define FEATURE_TINT          (1u << 23) /* some solid glass has a base colour */
#define FEATURE_LOOKUP        (1u << 24) /* and wants to see caustics there */
#define FEATURE_BRANCHES      (1u << 25) /* and both branches of the first glass */
#define FEATURE_SAMPLES       (1u << 26) /* and several camera rays where what is seen there breaks up */
#define FEATURE_NESTED        (1u << 30) /* solids overlap: rays keep a list of those they are in */
#define FEATURE_CONTACT       (1u << 31) /* surfaces of solids lie in other surfaces */
#define CONSTANT_FEATURES     0
#define CONSTANT_SPLIT        1 /* enum split_rule */
#define CONSTANT_DENSITY      2 /* enum density_rule */
#define CONSTANT_AA           3 /* enum splat_aa */
#define CONSTANT_DEPTH        4 /* enum depth_test */

#define SPLIT_ENERGY_RULE    0
#define SPLIT_ONCE_RULE      1
#define SPLIT_ROULETTE_RULE  2
#define DENSITY_SQRT_RULE    0
#define DENSITY_AREA_RULE    1
#define DENSITY_UNIFORM_RULE 2
#define DENSITY_ERROR_RULE   3
#define AA_FILTER            0
#define AA_NONE              1
#define AA_PIXEL             2
#define AA_MSAA              3
#define AA_MSAA_SAMPLE       4
#define AA_MSAA_SMALL        5
#define AA_COVERAGE          6
#define DEPTH_PLANE          0
#define DEPTH_MARGIN         1

/* ---- scene --------------------------------------------------------------------------------------------- */

#define KIND_DIFFUSE    0 /* enum material_kind */
#define KIND_DIELECTRIC 1
#define KIND_THIN       2
#define KIND_MIRROR     3

/* Roughness below which a caster counts as polished: its lobe is 0.02 degrees wide. */
#define ROUGHNESS_MIN 0.02f

/* Dispersion, in 1/um^2 of inverse squared wavelength. The ior is that of the d line, 587.6 nm; Abbe's number
 * spans the F and C lines, 486.1 and 656.3 nm. A photon that meets dispersive glass becomes three, one for
 * each channel, that tile 430 to 650 nm with edges at 500 and 575 nm. Their colours are (1,0,0), (0,1,0),
 * (0,0,1): they sum to white exactly. */
#define DISPERSION_MIDDLE 2.89624f
#define DISPERSION_F_TO_C 1.91042f
#define BAND_MIDDLES      vec3(2.69575f, 3.51229f, 4.70416f)
#define BAND_WIDTHS       vec3(0.65772f, 0.97543f, 1.40833f)

struct material_gpu {
    vec4 color_ior;  /* base colour, index of refraction */
    vec4 absorption; /* 1/m per channel; w: roughness */
    vec4 emission;   /* W/(m^2 sr); w: Cauchy's B, um^2: n = ior + B (1/wavelength^2 - DISPERSION_MIDDLE) */
    uint kind;
    uint color_first, color_width, color_height;
    uint emission_first, emission_width, emission_height;
    uint flags; /* clamped bits 0, 1: colour u, v; 2, 3: emission u, v. 8-15: solid number, 0: none
                   (media.glsl). 16-31: the material whose solid number is this one's index + 1 */
};
SHARED_SIZE(material_gpu, 80);

#define LIGHT_TYPE_POINT       0
#define LIGHT_TYPE_SPOT        1
#define LIGHT_TYPE_DIRECTIONAL 2
#define LIGHT_TYPE_COSINE      3 /* spot-like: I cos(theta) in the half space */

#define EMITTER_POINT     0 /* enum light_shape */
#define EMITTER_SPHERE    1
#define EMITTER_DISK      2
#define EMITTER_RECTANGLE 3

#define TILE_CAP    0 /* spherical cap: concentric map to the disk, equal area to the cap */
#define TILE_SPHERE 1 /* equal-area octahedron */
#define TILE_RECT   2 /* rectangle across a directional light's beam */

/* One for each tile: the list holds every light with its whole tile first, and then lights again with their
 * insets. */
struct light_gpu {
    vec4 position;    /* w: 1 - cosine of the spot's outer cone, which keeps the digits of a narrow one */
    vec4 direction;   /* way the light travels; w: 1 - cosine of the inner cone */
    vec4 intensity;   /* rgb; w: sum of the channels */
    vec4 tile_x;      /* tile frame, unit; w: half width of a TILE_RECT, m */
    vec4 tile_y;      /* w: half height of a TILE_RECT, m */
    vec4 tile_z;      /* axis of the cap or beam; w: 1 - cos(half angle) of a TILE_CAP */
    vec4 tile_origin; /* centre of a TILE_RECT; w: measure of the whole tile, sr or m^2 */
    uint type, map;
    uint changed; /* the tile differs from last frame's: remap the density */
    uint has_previous;
    vec4 old_x, old_y, old_z, old_origin; /* last frame's tile, for the remap */
    uint old_map;
    uint medium;       /* list of the solids it is in (media.glsl) */
    uint shape;        /* EMITTER_*; not a point: the tile holds points at pivot distance, which every part of
                          the emitter sends its light to, not directions */
    uint emitter_side; /* strata along a side of the emitter, a power of two; 1: one, its size left to
                          differentials */
    vec4 emitter_x;    /* half axis, m; w: pivot distance, m */
    vec4 emitter_y;    /* half axis, m; w: radius of the whole about the position, m */
    vec4 part;         /* which part of the light's unit square this tile is: corner, sides */
    uint part_light;   /* whose part: its number in the list */
    uint part_parent;  /* tile that it is an inset of; NONE: it is the whole square */
    uint part_insets;  /* how many it has itself */
    uint old_light; /* the tile of this number in the last frame: whose part it was; NONE: there was none */
    vec4 old_part;  /* and which */
};
SHARED_SIZE(light_gpu, 288);

/* A world box that holds a caster, or part of one. */
struct caster_box {
    vec4 minimum; /* of a whole caster; w: number of the first box of its parts */
    vec4 maximum; /* w: how many there are */
};

/* ---- the view's frame ---------------------------------------------------------------------------------- */

struct frame_gpu {
    vec4 eye;          /* w: time, s */
    vec4 ray_origin;   /* d(p) = ray_origin + p.x ray_x + p.y ray_y for a pixel position p in px, so that
                          dot(d, forward) = 1; jitter included */
    vec4 ray_x, ray_y; /* w of ray_x: px per unit of tangent, x; of ray_y: y */
    vec4 forward;      /* w: area of a pixel on the plane at distance 1 */
    vec4 right, up;    /* camera frame, unit */
    vec4 old_eye;      /* last frame's camera */
    vec4 old_forward, old_right, old_up;
    vec4 old_scale; /* px per unit of tangent x, y; centre x, y in px */
    vec4 center;    /* this frame's: px per unit of tangent x, y; centre x, y in px */
    vec4 tint;      /* rgb of every photon without FEATURE_CHROMATIC; the mean of its channels is 1 */
    uint width, height, light_count, cells; /* cells along a tile's side */
    uint tile_levels;                       /* log2(cells) */
    uint tile_slots;                        /* tiles in the atlas, a power of four */
    uint seed, subframe;
    uint photon_budget, ray_capacity, photon_capacity, max_bounces;
    uint camera_bounces, flags, caster_count, min_samples;
    float target_area, variance_gain, temporal_weight, cull_energy;
    float cull_magnification, kappa, max_anisotropy, max_radius;
    float filter_radius, flux_unit, irradiance_unit, subframe_weight;
    float cell_flux;      /* of a mean cell, W */
    uint eye_medium;      /* list of the solids the eye is in (media.glsl) */
    float msaa_threshold; /* px^2: with msaa_small, ellipses below it are multisampled */
    float offset_scale;   /* struct scene_extent: how near to coordinate planes rays are kept off surfaces */
    float lookup_base;    /* cells of the lookup grid's level 0, m, a power of two */
    float lookup_filter;  /* support radius of the pixel filter at chain points, px */
    uint lookup_slots;    /* of the grid, a power of two */
    uint camera_branches; /* chain points per pixel */
    uint part_count, old_part_count; /* tiles, insets included; of the last frame */
    float offset_steps;   /* struct scene_extent: how many floats rays are kept off surfaces elsewhere */
    uint camera_samples;  /* most camera rays of a pixel; 1: none but the one through its middle */
    uint sample_capacity; /* of all pixels together */
    float walk_alone;     /* cells of a lookup that one thread walks; above it eight do */
    uint pad0, pad1;
};
SHARED_SIZE(frame_gpu, 400);

#define FLAG_JITTER           (1u << 0)
#define FLAG_CASTER_MASK      (1u << 1)
#define FLAG_RADIANCE_SCALING (1u << 2)
#define FLAG_HAS_PREVIOUS     (1u << 3) /* last frame's irradiance is there */
#define FLAG_HOLD             (1u << 4) /* the view is at rest: cells keep their samples */
#define FLAG_SETTLE           (1u << 5) /* nothing changes: cells keep samples that serve */

/* ---- photons ------------------------------------------------------------------------------------------- */

/* A photon in flight, 112 bytes. Differentials are those of one stratum: the change over the photon's own
 * share of the light's tile. After its last hit the same record holds the deposit: origin is the hit point,
 * direction the receiver's geometric normal on the side the photon came from. */
struct photon_ray {
    vec4 origin;     /* w: 1 / its stratum, 1/sr; negative, 1/m^2, from a directional light */
    vec4 direction;  /* w: distance flown from the light, m */
    vec4 flux;       /* rgb, W; w: rgb sum at emission */
    vec4 dp_u_v0;    /* dP/du, dP/dv.x */
    vec4 dp_v1_dd_u; /* dP/dv.yz, dD/du.xy */
    vec4 dd_u2_dd_v; /* dD/du.z, dD/dv */
    uint cell;       /* in the atlas, Morton order */
    uint hash;       /* of its fixed place: light, cell, sample, branches */
    uint medium;     /* list of the solids it is in, 0: air (media.glsl) */
    uint state;      /* bits 0-7 bounces, 8-11 splits, 12-13 last interaction, 14-16 which dim branches it
                        follows, 19 hidden, 20-21 band: 0 white, 1 to 3 red, green, blue, 22-23
                        log2 of its branch's spacing (branches.glsl) */
};
SHARED_SIZE(photon_ray, 112);

/* Beside a ray's own differential, in a list of its own for scenes that have such lights or materials:
 * columns of six floats (change of the origin, change of the direction) whose sum of squares is the
 * covariance of what spreads a photon beyond its stratum: two over the emitter, two more for rough casters
 * (four hold any covariance of a ray), one over the band of wavelengths (spread.glsl). A column c adds c c^T
 * to a footprint, whose kernel has a sixth of it for variance. */

/* A stored photon, ready to be drawn, 80 bytes. For a pixel at offset o from `center`, on its tangent plane,
 * r^2 = |U o|^2 / (1 + w.o)^2 is the squared radius in its ellipse: exact under perspective. */
struct photon {
    vec4 position; /* relative to the eye; w: normal, octahedral 2x16 bits */
    vec4 ellipse;  /* U, upper triangular: u00, u01, u11, 1/px; w: half height of its box, px. w < 0: a box of
                      sides x, y px instead, at most 1 px each */
    vec4 center;   /* px; zw: w */
    vec4 density;  /* rgb irradiance of the kernel at its middle, W/m^2, or flux for aa=pixel; w: plane slack,
                      m */
    uint cell;     /* in the atlas, and see CELL_SPACING_SHIFT; NONE: not drawn */
    float area;    /* projected, px^2, without filter and limits */
    float root;    /* sqrt(area * flux / flux of a mean cell), px */
    uint shape;    /* bits 0-15 share of its cell's flux, half float; 16-23 how much of the ellipse's major
                      axis comes from u, of 255 */
};
SHARED_SIZE(photon, 80);

/* A photon's cell: above the index log2 of its branch's spacing (branches.glsl). */
#define CELL_SPACING_SHIFT 30
#define CELL_INDEX_MASK    0x3fffffffu

/* What the trace pass says of a ray. */
#define OUTCOME_CHILD0 1u
#define OUTCOME_CHILD1 2u
#define OUTCOME_PHOTON 4u
#define OUTCOME_BANDS  8u /* with CHILD0: the ray as it came, to be traced again once per band */

/* A queue's entry: the ray's slot, and which band of it. */
#define QUEUE_BAND_SHIFT 30
#define QUEUE_SLOT_MASK  0x3fffffffu

/* Fates in the flux ledger; the order is that of the flux_* statistics. */
#define FATE_EMITTED            0
#define FATE_SPLATTED           1
#define FATE_CULLED_VISIBILITY  2
#define FATE_CULLED_SOLID_ANGLE 3
#define FATE_CULLED_ENERGY      4
#define FATE_DIRECT             5
#define FATE_ABSORBED           6
#define FATE_ESCAPED            7
#define FATE_BOUNCE_LIMIT       8
#define FATE_SPLIT_ONCE         9
#define FATE_THINNED_OUT        10 /* weaker branches left to a neighbour on the lattice, */
#define FATE_THINNED_IN         11 /* and what those neighbours carry for others */
#define FATE_BUFFER             12
#define FATE_COUNT              13
#define FATE_NONE               15

/* Sums that are no flux, in the ledger's last places: irradiance, see soft_compare.comp. */
#define SUM_SOFT_DIFFERENCE 13
#define SUM_SOFT_TOTAL      14

/* Counts beside the ledger. */
#define COUNT_EMITTED            0
#define COUNT_RAYS               1
#define COUNT_HITS               2
#define COUNT_SPLIT              3
#define COUNT_STORED             4
#define COUNT_SPLATTED           5
#define COUNT_CONTRIBUTING       6
#define COUNT_CULLED_VISIBILITY  7
#define COUNT_CULLED_SOLID_ANGLE 8
#define COUNT_CULLED_ENERGY      9
#define COUNT_KERNEL             10
#define COUNT_KERNEL_INSIDE      11
#define COUNT_GUARD_DENSITY      12
#define COUNT_GUARD_DIFFERENTIAL 13
#define COUNT_GUARD_FOOTPRINT    14
#define COUNT_GUARD_TRAVERSAL    15
#define COUNT_GUARD_OVERFLOW     16
#define COUNT_GUARD_SPLIT        17
#define COUNT_CELLS              18
#define COUNT_LIMITED            19 /* footprints longer than max_radius or max_anisotropy allow */
#define COUNT_COUNT              20

/* One per view, read back whole every frame. The first part is zeroed at the start of a frame. */
struct counters_gpu {
    uint count[COUNT_COUNT];
    uint flux_low[16];  /* ledger, 64-bit fixed point in flux_unit: low words */
    uint flux_high[16]; /* and high words */
    /* the photon loop */
    uint task_count;   /* photons to emit */
    uint photon_count; /* stored so far */
    uint photon_base;  /* stored before this bounce */
    uint splat_pieces; /* of wide footprints, handed out; may exceed their list */
    uint queue[8];     /* of even and odd bounces: indirect dispatch x, y, z, then the number of rays */
    uint stride[2];    /* child slots per ray, even and odd: 2 while splitting is allowed, 1 otherwise */
    uint pad1, pad2;
    uint photon_groups[4]; /* indirect dispatch over all stored photons; [3] unused */
    uint photon_quads[4];  /* indirect draw of a quad for each: vertices, instances, firsts */
    /* the density control loop */
    float density_total; /* before the budget */
    float density_largest;
    float density_scale;    /* budget: D = min + (D' - min) scale */
    float suggestion_scale; /* sqrt rule: makes the total that of the area rule */
};
#define QUEUE_COUNT 3 /* in queue[4 parity + ...] */
SHARED_SIZE(counters_gpu, 320);

/* Rows of a wide footprint that a workgroup draws. */
struct splat_piece {
    uint photon; /* NONE: nothing */
    uint part;   /* number among the photon's pieces, 16 bits; then how many there are; top bit of the first
                    one: the photon has reached a pixel */
};
SHARED_SIZE(splat_piece, 8);

/* Accumulators of one cell's feedback, 64-bit fixed point as low and high word. Errors are flux put in the
 * wrong place, in parts of a mean cell's flux. */
struct feedback_gpu {
    uint area_low, area_high;       /* sum of projected areas, 2^-16 px^2 */
    uint root_low, root_high;       /* sum of sqrt(area * share), 2^-20 px */
    uint change_low, change_high;   /* sum of share * relative change, 2^-24 */
    uint error_u_low, error_u_high; /* density=error: by the strata's size in u, 2^-30 */
    uint error_v_low, error_v_high; /* and in v */
};
SHARED_SIZE(feedback_gpu, 40);

/* ---- camera side --------------------------------------------------------------------------------------- */

/* The surface a pixel shows, 64 bytes. */
struct surface_gpu {
    vec4 relative_position; /* from the eye, m, of the surface settled on; w: depth of the first hit along
                               forward */
    vec4 normal;   /* shading normal; w: 1 receiver seen directly, 2 through a chain, 0 nothing to light */
    vec4 albedo;   /* rgb; w: unused */
    vec4 radiance; /* direct light and emission toward the camera, chain included, W/(m^2 sr) */
};
SHARED_SIZE(surface_gpu, 64);

/* What splats test, 16 bytes: position relative to the eye, and the geometric normal facing the camera as
 * octahedral 2x16 bits; NONE where no photon may land. */
struct target_gpu {
    vec4 position_normal;
};

#endif
