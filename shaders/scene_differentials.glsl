// scene_differentials.glsl: what a surface of the scene does to the differential of a ray, a photon's or the camera's.
// Source  Igehy 1999; design 6

void reflect_differential(inout differential x, vec3 d, vec3 n, surface s)
{
    float side = dot(n, s.normal) < 0.0 ? -1.0 : 1.0;
    x.d_u = differential_reflect_one(x.d_u, side * surface_normal_change(s, x.p_u), d, n);
    x.d_v = differential_reflect_one(x.d_v, side * surface_normal_change(s, x.p_v), d, n);
}

void refract_differential(inout differential x, vec3 d, vec3 n, surface s, float eta, float cos_t, inout uint guard)
{
    if (eta == 1.0)
        return; // no interface
    if (cos_t < REFRACT_COS_MIN)
        guard++;
    float side = dot(n, s.normal) < 0.0 ? -1.0 : 1.0;
    x.d_u = differential_refract_one(x.d_u, side * surface_normal_change(s, x.p_u), d, n, eta, cos_t);
    x.d_v = differential_refract_one(x.d_v, side * surface_normal_change(s, x.p_v), d, n, eta, cos_t);
}
