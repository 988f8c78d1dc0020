// spread_surface.glsl: what surfaces do to the columns of spread.glsl.
// Source  Igehy 1999; Walter et al. 2007 (Beckmann's lobe); design 6

void spread_transfer(inout photon_spread spread, vec3 d, float t, vec3 n)
{
    uint unused = 0u; // singular places are counted with the photon's own differential
    if (SPREADS && SPREAD_EMITTER)
        differential_transfer(spread.emitter, d, t, n, unused);
    if (SPREADS && SPREAD_LOBE)
        differential_transfer(spread.lobe, d, t, n, unused);
    if (SPREADS && SPREAD_BAND) {
        differential x = differential(spread.band_p, vec3(0.0), spread.band_d, vec3(0.0));
        differential_transfer(x, d, t, n, unused);
        spread.band_p = x.p_u;
    }
}

// Adds a lobe to a ray that leaves along `way`: its direction varies by d1 and d2, two columns of their own. The covariance
// of place and direction across the ray, 4 x 4, is taken apart into four columns again (Cholesky).
void spread_roughen(inout photon_spread spread, vec3 way, vec3 d1, vec3 d2)
{
    vec3 e1 = normalize(abs(way.y) < 0.9 ? cross(way, vec3(0.0, 1.0, 0.0)) : cross(way, vec3(1.0, 0.0, 0.0)));
    vec3 e2 = cross(way, e1);
    mat4 m = mat4(0.0); // symmetric
    for (uint k = 0u; k < 6u; k++) {
        vec3 p = k == 0u ? spread.emitter.p_u : k == 1u ? spread.emitter.p_v : k == 2u ? spread.lobe.p_u : k == 3u ? spread.lobe.p_v : vec3(0.0);
        vec3 d = k == 0u ? spread.emitter.d_u : k == 1u ? spread.emitter.d_v : k == 2u ? spread.lobe.d_u : k == 3u ? spread.lobe.d_v : k == 4u ? d1 : d2;
        vec4 c = vec4(dot(p, e1), dot(p, e2), dot(d, e1), dot(d, e2));
        m += outerProduct(c, c);
    }
    mat4 column = mat4(0.0);
    for (uint k = 0u; k < 4u; k++) {
        float pivot = m[k][k];
        for (uint i = 0u; i < k; i++)
            pivot -= column[i][k] * column[i][k];
        if (!(pivot > 1e-6 * m[k][k]))
            continue; // nothing left along this axis but rounding
        float inverse = inversesqrt(pivot);
        for (uint row = k; row < 4u; row++) {
            float value = m[k][row];
            for (uint i = 0u; i < k; i++)
                value -= column[i][k] * column[i][row];
            column[k][row] = value * inverse;
        }
    }
    spread.emitter.p_u = e1 * column[0].x + e2 * column[0].y;
    spread.emitter.d_u = e1 * column[0].z + e2 * column[0].w;
    spread.emitter.p_v = e2 * column[1].y;
    spread.emitter.d_v = e1 * column[1].z + e2 * column[1].w;
    spread.lobe.p_u = spread.lobe.p_v = vec3(0.0);
    spread.lobe.d_u = e1 * column[2].z + e2 * column[2].w;
    spread.lobe.d_v = e2 * column[3].w;
}

// A rough surface is one whose normal is uncertain: slopes of variance alpha^2 / 2, alpha = roughness^2 (Beckmann). The
// columns of the normal, with a sixth of their squares for variance.
void rough_normals(vec3 n, float roughness, out vec3 n1, out vec3 n2)
{
    n1 = normalize(abs(n.y) < 0.9 ? cross(n, vec3(0.0, 1.0, 0.0)) : cross(n, vec3(1.0, 0.0, 0.0)));
    n2 = cross(n, n1);
    float size = sqrt(3.0) * roughness * roughness;
    n1 *= size;
    n2 *= size;
}

void spread_reflect(inout photon_spread spread, vec3 d, vec3 n, surface s, vec3 way, float roughness)
{
    if (!SPREADS)
        return;
    if (SPREAD_EMITTER)
        reflect_differential(spread.emitter, d, n, s);
    if (SPREAD_BAND) {
        float side = dot(n, s.normal) < 0.0 ? -1.0 : 1.0;
        spread.band_d = differential_reflect_one(spread.band_d, side * surface_normal_change(s, spread.band_p), d, n);
    }
    if (SPREAD_LOBE) {
        reflect_differential(spread.lobe, d, n, s);
        if (roughness > ROUGHNESS_MIN) {
            vec3 n1, n2;
            rough_normals(n, roughness, n1, n2);
            spread_roughen(spread, way, differential_reflect_one(vec3(0.0), n1, d, n), differential_reflect_one(vec3(0.0), n2, d, n));
        }
    }
}

// `eta_change`: of eta, over the photon's band.
void spread_refract(inout photon_spread spread, vec3 d, vec3 n, surface s, float eta, float cos_t, vec3 way, float roughness,
                    float eta_change)
{
    if (!SPREADS)
        return;
    uint unused = 0u;
    if (SPREAD_EMITTER)
        refract_differential(spread.emitter, d, n, s, eta, cos_t, unused);
    if (SPREAD_BAND && eta != 1.0) {
        float side = dot(n, s.normal) < 0.0 ? -1.0 : 1.0;
        float cos_i = -dot(d, n);
        spread.band_d = differential_refract_one(spread.band_d, side * surface_normal_change(s, spread.band_p), d, n, eta, cos_t);
        spread.band_d += eta_change * (d + (cos_i + eta * (1.0 - cos_i * cos_i) / max(cos_t, REFRACT_COS_MIN)) * n);
    }
    if (SPREAD_LOBE) {
        refract_differential(spread.lobe, d, n, s, eta, cos_t, unused);
        if (roughness > ROUGHNESS_MIN && eta != 1.0) {
            vec3 n1, n2;
            rough_normals(n, roughness, n1, n2);
            spread_roughen(spread, way, differential_refract_one(vec3(0.0), n1, d, n, eta, cos_t),
                           differential_refract_one(vec3(0.0), n2, d, n, eta, cos_t));
        }
    }
}

// Straight through a thin wall whose lobe is that of its reflection, mirrored (KHR_materials_transmission).
void spread_pass(inout photon_spread spread, vec3 d, vec3 n, float roughness)
{
    if (!SPREADS || !SPREAD_LOBE || !(roughness > ROUGHNESS_MIN))
        return;
    vec3 n1, n2;
    rough_normals(n, roughness, n1, n2);
    vec3 d1 = differential_reflect_one(vec3(0.0), n1, d, n), d2 = differential_reflect_one(vec3(0.0), n2, d, n);
    spread_roughen(spread, d, d1 - 2.0 * dot(d1, n) * n, d2 - 2.0 * dot(d2, n) * n);
}
