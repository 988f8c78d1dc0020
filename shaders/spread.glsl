// spread.glsl: what spreads a photon beyond its stratum: columns beside every ray, see render_layout.h. In scenes that have
// nothing to spread photons none of it is left.
// Source  design 6 (one covariance); Igehy 1999
const bool SPREAD_EMITTER = (FEATURES & (FEATURE_SOFT | FEATURE_ROUGH)) != 0u;
const bool SPREAD_LOBE = (FEATURES & FEATURE_ROUGH) != 0u;
const bool SPREAD_BAND = (FEATURES & FEATURE_DISPERSION) != 0u;
const bool SPREADS = (SPREAD_EMITTER || SPREAD_BAND) && AA != AA_PIXEL; // a single pixel has no footprint
const uint SPREAD_FLOATS = (SPREAD_EMITTER ? 12u : 0u) + (SPREAD_LOBE ? 12u : 0u) + (SPREAD_BAND ? 6u : 0u);

struct photon_spread {
    differential emitter; // with rough casters these and the next are any four columns of the same covariance
    differential lobe;
    vec3 band_p, band_d; // over the band: coherent, what one surface spreads another may gather
};

// Between a list of floats and the columns of one ray.
#define SPREAD_PUT(list, at, v)  \
    {                            \
        list[at] = (v).x;        \
        list[(at) + 1u] = (v).y; \
        list[(at) + 2u] = (v).z; \
        at += 3u;                \
    }
#define SPREAD_GET(list, at, v)                                  \
    {                                                            \
        v = vec3(list[at], list[(at) + 1u], list[(at) + 2u]);    \
        at += 3u;                                                \
    }

#define SPREAD_ALL(DO, list, slot, spread)          \
    if (SPREADS) {                                  \
        uint spread_at = SPREAD_FLOATS * (slot);    \
        if (SPREAD_EMITTER) {                       \
            DO(list, spread_at, spread.emitter.p_u) \
            DO(list, spread_at, spread.emitter.d_u) \
            DO(list, spread_at, spread.emitter.p_v) \
            DO(list, spread_at, spread.emitter.d_v) \
        }                                           \
        if (SPREAD_LOBE) {                          \
            DO(list, spread_at, spread.lobe.p_u)    \
            DO(list, spread_at, spread.lobe.d_u)    \
            DO(list, spread_at, spread.lobe.p_v)    \
            DO(list, spread_at, spread.lobe.d_v)    \
        }                                           \
        if (SPREAD_BAND) {                          \
            DO(list, spread_at, spread.band_p)      \
            DO(list, spread_at, spread.band_d)      \
        }                                           \
    }
#define SPREAD_STORE(list, slot, spread) SPREAD_ALL(SPREAD_PUT, list, slot, spread)
#define SPREAD_LOAD(list, slot, spread)  SPREAD_ALL(SPREAD_GET, list, slot, spread)

differential differential_zero()
{
    return differential(vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
}

photon_spread spread_zero()
{
    return photon_spread(differential_zero(), differential_zero(), vec3(0.0), vec3(0.0));
}
