// optics.glsl: Fresnel terms, directions and their differentials at specular surfaces.
// Source  Igehy 1999, "Tracing ray differentials"; design 6; aaps-thesis 3.3.2

// Unpolarised reflectance of a dielectric; eta = n_from / n_to, cos_i = cosine of incidence, >= 0.
// cos_t returns the cosine of transmission, 0 at total internal reflection.
float fresnel_dielectric(float cos_i, float eta, out float cos_t)
{
    if (eta == 1.0) { // no interface, at grazing incidence either
        cos_t = cos_i;
        return 0.0;
    }
    float sin2_t = eta * eta * max(0.0, 1.0 - cos_i * cos_i);
    if (sin2_t >= 1.0) {
        cos_t = 0.0;
        return 1.0;
    }
    cos_t = sqrt(1.0 - sin2_t);
    float parallel = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    float perpendicular = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    return clamp(0.5 * (parallel * parallel + perpendicular * perpendicular), 0.0, 1.0);
}

// Reflectance of a plane-parallel thin wall, all internal reflections summed.
float fresnel_thin(float cos_i, float ior)
{
    float cos_t;
    float r = fresnel_dielectric(cos_i, 1.0 / ior, cos_t);
    return 2.0 * r / (1.0 + r);
}

vec3 fresnel_metal(float cos_i, vec3 base_color)
{
    float m = clamp(1.0 - cos_i, 0.0, 1.0);
    float m2 = m * m;
    return base_color + (1.0 - base_color) * (m2 * m2 * m);
}

// The differential of a ray: how its origin and direction change over one stratum in u and v.
struct differential {
    vec3 p_u, p_v, d_u, d_v;
};

void differential_scale(inout differential x, float scale)
{
    x.p_u *= scale;
    x.p_v *= scale;
    x.d_u *= scale;
    x.d_v *= scale;
}

void differential_scale_both(inout differential x, vec2 scale)
{
    x.p_u *= scale.x;
    x.p_v *= scale.y;
    x.d_u *= scale.x;
    x.d_v *= scale.y;
}

// Below these cosines the linearisation is meaningless: grazing transfer and grazing exit are clamped and counted.
const float TRANSFER_COS_MIN = 1e-4;
const float REFRACT_COS_MIN = 1e-3;

// To the plane with unit normal n at distance t along unit direction d.
void differential_transfer(inout differential x, vec3 d, float t, vec3 n, inout uint guard)
{
    float cosine = dot(d, n);
    if (abs(cosine) < TRANSFER_COS_MIN) {
        cosine = cosine < 0.0 ? -TRANSFER_COS_MIN : TRANSFER_COS_MIN;
        guard++;
    }
    vec3 moved_u = x.p_u + t * x.d_u;
    vec3 moved_v = x.p_v + t * x.d_v;
    x.p_u = moved_u - (dot(moved_u, n) / cosine) * d;
    x.p_v = moved_v - (dot(moved_v, n) / cosine) * d;
}

// n opposes d: dot(d, n) < 0.
vec3 differential_reflect_one(vec3 d_change, vec3 n_change, vec3 d, vec3 n)
{
    float dot_change = dot(d_change, n) + dot(d, n_change);
    return d_change - 2.0 * (dot(d, n) * n_change + dot_change * n);
}

vec3 differential_refract_one(vec3 d_change, vec3 n_change, vec3 d, vec3 n, float eta, float cos_t)
{
    float dn = dot(d, n);
    float mu = eta * dn + cos_t;
    float dot_change = dot(d_change, n) + dot(d, n_change);
    float mu_change = (eta + eta * eta * dn / max(cos_t, REFRACT_COS_MIN)) * dot_change;
    return eta * d_change - (mu * n_change + mu_change * n);
}
