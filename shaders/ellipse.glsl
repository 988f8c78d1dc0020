// ellipse.glsl: a photon's footprint as the ellipse it is on screen, its perspective worked in.
// Source  design 6; aaps-thesis 5.1
struct screen_ellipse {
    vec2 middle;      // px; perspective puts it beside the photon's own place
    float xx, xy, yy; // covariance: (o - middle)^T C^-1 (o - middle) < 1 inside, px^2
    float det;
};

// |U o|^2 < (1 + w.o)^2 is a conic in the offset o: its square completed. w^T C w is at most 1/4 (photon_compact.comp).
screen_ellipse ellipse_on_screen(photon p)
{
    vec2 w = p.center.zw;
    precise float slope = p.ellipse.y / p.ellipse.x;
    precise float xx_flat = 1.0 / (p.ellipse.x * p.ellipse.x), yy = 1.0 / (p.ellipse.z * p.ellipse.z);
    precise float xx = xx_flat + slope * slope * yy, xy = -slope * yy;
    precise vec2 bent = vec2(xx * w.x + xy * w.y, xy * w.x + yy * w.y);
    precise float rest = 1.0 - dot(w, bent);
    precise screen_ellipse e;
    e.middle = p.center.xy + bent / rest;
    e.xx = (xx + bent.x * bent.x / rest) / rest;
    e.xy = (xy + bent.x * bent.y / rest) / rest;
    e.yy = (yy + bent.y * bent.y / rest) / rest;
    e.det = xx_flat * yy / (rest * rest * rest);
    return e;
}

// With aa=msaa_small: is this one among the small ones?
bool ellipse_is_small(photon p)
{
    return PI < frame.msaa_threshold * p.ellipse.x * p.ellipse.z;
}

// Area of the unit disk where n1.q < d1 and n2.q < d2, by Green's theorem: arc and two chords. The unit normals are turned
// apart by an angle in [0, pi] of this cosine and sine; distances are within [-1, 1].
float disk_wedge(float d1, float d2, float turn, float cosine, float sine)
{
    precise float h1 = sqrt((1.0 - d1) * (1.0 + d1)), h2 = sqrt((1.0 - d2) * (1.0 + d2)); // half chords
    precise float w1 = atan(h1, -d1), w2 = atan(h2, -d2);                                 // half arcs
    precise float arc = max(min(w1, turn + w2) - max(-w1, turn - w2), 0.0) + max(w1 + w2 + turn - 2.0 * PI, 0.0);
    precise float chord1 = clamp((d2 - d1 * cosine) / sine, -h1, h1) + h1;
    precise float chord2 = clamp((d1 - d2 * cosine) / sine, -h2, h2) + h2;
    precise float area = 0.5 * (arc + d1 * chord1 + d2 * chord2);
    return area;
}
