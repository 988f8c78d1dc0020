// spread.glsl: what spreads a photon beyond its stratum: columns beside every ray, see render_layout.h. In scenes that have
// nothing to spread photons none of it is left.
// Source  design 6 (one covariance); Igehy 1999
const bool SPREADS = (FEATURES & FEATURE_SOFT) != 0u && AA != AA_PIXEL; // a single pixel has no footprint
const uint SPREAD_FLOATS = 12u;

struct photon_spread {
    differential emitter;
};

// Between a list of floats and the columns of one ray.
#define SPREAD_PUT(list, at, v)  \
    {                            \
        list[at] = (v).x;        \
        list[(at) + 1u] = (v).y; \
        list[(at) + 2u] = (v).z; \
    }
#define SPREAD_GET(list, at) vec3(list[at], list[(at) + 1u], list[(at) + 2u])

#define SPREAD_STORE(list, slot, spread)                       \
    if (SPREADS) {                                             \
        uint spread_at = SPREAD_FLOATS * (slot);               \
        SPREAD_PUT(list, spread_at, spread.emitter.p_u);       \
        SPREAD_PUT(list, spread_at + 3u, spread.emitter.d_u);  \
        SPREAD_PUT(list, spread_at + 6u, spread.emitter.p_v);  \
        SPREAD_PUT(list, spread_at + 9u, spread.emitter.d_v);  \
    }

#define SPREAD_LOAD(list, slot, spread)                        \
    if (SPREADS) {                                             \
        uint spread_at = SPREAD_FLOATS * (slot);               \
        spread.emitter.p_u = SPREAD_GET(list, spread_at);      \
        spread.emitter.d_u = SPREAD_GET(list, spread_at + 3u); \
        spread.emitter.p_v = SPREAD_GET(list, spread_at + 6u); \
        spread.emitter.d_v = SPREAD_GET(list, spread_at + 9u); \
    }
