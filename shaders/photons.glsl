// photons.glsl: what the photon passes share: counters, ray records, the flux ledger.
// Source  design 3 (photons ordered by task and branch), 13
// See photon_ray.state.
const uint STATE_HIDDEN = 1u << 19; // of a deposit: the camera does not see it (aa=pixel)
const uint STATE_BAND_SHIFT = 20u;
const uint STATE_SPACING_SHIFT = 22u, STATE_SPACING = 3u << STATE_SPACING_SHIFT;
const uint STATE_FOLLOWS = 14u; // of bits: spacing 2, 4
const uint STATE_FOLLOWS_ALL = 1u << 16;
const uint STATE_KEPT = 0xf1c000u; // from ray to ray: what it follows, band, spacing

layout(std430, binding = BINDING_PASS) buffer counter_buffer { counters_gpu counters; };

// Areas the sqrt rule tells apart, px^2: below a pixel's half more photons only calm the pixel's sum.
const float ROOT_AREA_MIN = 0.5, ROOT_AREA_MAX = 1000.0;
const float AREA_MAX = 1e9; // px^2: feedback of a singular footprint stays finite

float photon_area(float area)
{
    return min(area, AREA_MAX);
}

float photon_root(float area, float flux)
{
    return sqrt(clamp(area, ROOT_AREA_MIN, ROOT_AREA_MAX) * flux / frame.cell_flux);
}

// The cell that hears of the photon, and how many strata its branch's photons lie apart.
uint photon_cell(photon_ray ray)
{
    return ray.cell | (((ray.state >> STATE_SPACING_SHIFT) & 3u) << CELL_SPACING_SHIFT);
}

differential ray_differential(photon_ray ray)
{
    differential x;
    x.p_u = ray.dp_u_v0.xyz;
    x.p_v = vec3(ray.dp_u_v0.w, ray.dp_v1_dd_u.xy);
    x.d_u = vec3(ray.dp_v1_dd_u.zw, ray.dd_u2_dd_v.x);
    x.d_v = ray.dd_u2_dd_v.yzw;
    return x;
}

void ray_set_differential(inout photon_ray ray, differential x)
{
    ray.dp_u_v0 = vec4(x.p_u, x.p_v.x);
    ray.dp_v1_dd_u = vec4(x.p_v.yz, x.d_u.xy);
    ray.dd_u2_dd_v = vec4(x.d_u.z, x.d_v);
}

// The ledger of a workgroup: every thread hands in one fate with its flux and what was absorbed on the way; the
// sums are taken in a fixed order and added to 64-bit counters.
shared uint ledger_fate[GROUP_SIZE];
shared float ledger_flux[GROUP_SIZE];
shared float ledger_absorbed[GROUP_SIZE];

void ledger_add(uint fate, float flux, float absorbed)
{
    uint i = gl_LocalInvocationIndex;
    ledger_fate[i] = fate;
    ledger_flux[i] = flux;
    ledger_absorbed[i] = absorbed;
    barrier();
    if (i < FATE_COUNT) {
        float sum = 0.0;
        for (uint k = 0u; k < GROUP_SIZE; k++) {
            sum += ledger_fate[k] == i ? ledger_flux[k] : 0.0;
            sum += i == FATE_ABSORBED ? ledger_absorbed[k] : 0.0;
        }
        bool is_exact;
        float units = sum / frame.flux_unit;
        ADD_FIXED(counters.flux_low[i], counters.flux_high[i], units, is_exact);
    }
    barrier();
}

// Adds up small counts of a workgroup, several per word.
shared uint group_counts[GROUP_SIZE];

uint group_count(uint value)
{
    uint i = gl_LocalInvocationIndex;
    barrier();
    group_counts[i] = value;
    barrier();
    uint sum = 0u;
    if (i == 0u)
        for (uint k = 0u; k < GROUP_SIZE; k++)
            sum += group_counts[k];
    return sum; // thread 0 only
}
