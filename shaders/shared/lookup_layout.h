/* lookup_layout.h: what the lookup passes hand to each other: caustics seen through glass and mirrors.
 *
 * A chain point is the receiver that a pixel shows through glass or mirrors, with the pixel's own size there.
 * The grid holds chain points; every photon visits those within its footprint. Lengths in metres, positions
 * relative to the eye.
 *
 * Lists of chain points: one for every pixel, of the stronger branches; one for every pixel, of the weaker
 * ones, with FEATURE_BRANCHES; then, with FEATURE_SAMPLES, frame.sample_capacity of the samples of broken
 * pixels, and again as many of their weaker branches.
 */
#ifndef LOOKUP_LAYOUT_H
#define LOOKUP_LAYOUT_H
#include "shared.h"

/* A cell is at least this many times as wide as the pixel filter of its points reaches, and less than twice
 * as wide. */
#define LOOKUP_CELL_REACH 3.0f

/* Levels of the grid: cells of frame.lookup_base * 2^level. */
#define LOOKUP_LEVELS 32

/* Of what the picture shows of a photon through glass or mirrors, the part that counts in the feedback: chain
 * points see nothing smaller than their pixel's filter, and photons of target_area would be finer than it
 * takes. On `pool` from above at 480x270 this sends 50,000 photons and a quarter 95,000, at errors of 0.068
 * and 0.064. */
#define LOOKUP_AREA_PART 0.0625f

/* Slots looked at before a point settles for a coarser cell. */
#define LOOKUP_PROBES 16

/* Cells, and blocks of 2^1, 2^3, ... cells a side, have a bit each that says whether they may hold points, of
 * eight for every slot. With half a bit most levels seemed to have points everywhere, and walks over their
 * cells took half of the lookup's time (`pool` at 960x540). */
#define LOOKUP_BLOCK_MAX 7

/* Cells of its finest level that one photon may walk over; a larger footprint is made smaller, with its
 * energy. On `square` from behind 2048 took 20 % longer and lowered the error from 0.146 to 0.145. */
#define LOOKUP_WALK_MAX 512

/* Cells and points after which a walk is ended. Each is several rounds of loops, and Mesa 22.3's lavapipe
 * ends all loops silently after 65,535 (docs/drivers.md). */
#define LOOKUP_ROUNDS_MAX 12000

struct chain_point {
    vec4 position_normal; /* w: geometric normal on the side the chain comes from, octahedral 2x16 bits; NONE
                             where the pixel shows no receiver through a chain */
    uvec4 axes; /* the pixel filter's half axes on the surface over its reach, 6 halfs; w: reach, as the bits
                   of a float whose low 12 bits are the mean throughput, 0 to 4 in steps of 2^-10 */
};
SHARED_SIZE(chain_point, 32);

/* One word per point of the sorted list, enough to tell that a photon is too far from it: where it is, in
 * 32nds of a cell, 9 bits of each coordinate, so that places repeat after 16 cells; 4 bits of its reach, in
 * 32nds of the most that its cell holds, from half of that on; and whether it is the last one of its cell. */
#define LOOKUP_PLACE_STEPS 32
#define LOOKUP_PLACE_MASK  511u
#define LOOKUP_WIDE        7.0f /* cells: beyond 8 a place may be another's; most points in such cells are near */
#define LOOKUP_LAST        0x80000000u

struct lookup_cell {
    uint x, y, z;      /* coordinates as the bits of ints */
    uint owner;        /* chain point that claimed the slot: level << 27 | number + 1; 0: free */
    uint first, count; /* its points in the sorted list */
    uint pad0, pad1;
};
SHARED_SIZE(lookup_cell, 32);

/* A photon that reached a receiver, wherever that is. */
struct lookup_photon {
    vec4 position;   /* w: normal, octahedral 2x16 bits */
    vec4 covariance; /* of its footprint in the frame of tangent_frame(normal): xx, xy, yy, m^2; w: plane
                        slack, m */
    vec4 flux;       /* rgb, W; w: area of its stratum's image, m^2 */
    uint cell;       /* as in struct photon; NONE: not to be looked up */
    uint pad0, pad1, pad2;
};
SHARED_SIZE(lookup_photon, 64);

/* The tree of photons, where points look for photons and not the other way round: 8^TREE_LEVELS buckets, each
 * a part of space for footprints of one size, and boxes around eight and eight of them. */
#define TREE_LEVELS  5
#define TREE_BUCKETS (1u << 3 * TREE_LEVELS)
#define TREE_NODES   ((8u * TREE_BUCKETS - 1u) / 7u)

/* Photons that one lane may meet for a point, by its loops' rounds (docs/drivers.md). */
#define TREE_ROUNDS_MAX 60000

/* Corners as words that have the order of the floats (photon_tree.glsl), those of `low` inverted, so that
 * zeros are an empty box. Of buckets only: its photons in the order. */
struct tree_node {
    uint low_x, low_y, low_z, first;
    uint high_x, high_y, high_z, count;
};
SHARED_SIZE(tree_node, 32);

/* A photon in the tree's order: a ball around its footprint. */
struct tree_photon {
    float x, y, z, radius;
    uint number, pad0, pad1, pad2;
};
SHARED_SIZE(tree_photon, 32);

#define LOOKUP_COUNT_POINTS   0 /* chain points */
#define LOOKUP_COUNT_CELLS    1
#define LOOKUP_COUNT_PHOTONS  2 /* that can be looked up */
#define LOOKUP_COUNT_SEEN     3 /* that reached a chain point */
#define LOOKUP_COUNT_KERNEL   4 /* pairs of photon and point tested */
#define LOOKUP_COUNT_INSIDE   5
#define LOOKUP_COUNT_OVERFLOW 6
#define LOOKUP_COUNT_GUARD    7 /* footprints made smaller, walks ended, points without a slot */
#define LOOKUP_COUNT_COUNT    8

/* Zeroed at the start of a frame, read back whole. */
struct lookup_gpu {
    uint count[LOOKUP_COUNT_COUNT];
    uint levels;              /* bit set of levels that have points */
    uint first;               /* of the sorted list that is not handed out yet */
    uint broken;              /* pixels whose camera rays are several */
    uint listed;              /* chain points in the list of them */
    uint low_x, low_y, low_z; /* of all chain points with their reach, as in tree_node */
    uint high_x, high_y, high_z;
    uint long_walks;       /* photons on the list of them */
    uint shown;            /* pixels that show something through glass or mirrors, broken ones included */
    uint sample_groups[3]; /* with FEATURE_SAMPLES, indirect: workgroups over the samples of broken pixels */
    uint point_groups[3];  /* likewise over all numbers of chain points that are in use */
};
SHARED_SIZE(lookup_gpu, 104);
#endif
