// Rendering recipe v1: one Gaussian as one oriented quad, for OpenGL and for WebGL2. Both stages stand
// here; context.py and program.js put the version, the recipe's constants and VERTEX_STAGE or
// FRAGMENT_STAGE in front.

#ifdef VERTEX_STAGE

// TEXELS texels for each Gaussian (upload.py says what is where).
#ifdef RESIDENT_BUFFER
layout(std430, binding = 0) readonly buffer Gaussians { uvec4 gaussians[]; };
#else
uniform usampler2D gaussians;   // COLUMNS Gaussians in a row
#endif

uniform mat3 rotation;      // world to camera
uniform vec3 translation;   // world to camera, metres
uniform vec3 position;      // of the camera in the world, metres
uniform vec2 focal_px;
uniform vec2 centre_px;
uniform vec2 limit;         // JACOBIAN_CLAMP * tan(fov / 2)
uniform vec2 size_px;
#if SH_DEGREE >= 2
uniform usampler2D colours; // of each slot, see colours.glsl
#endif
#ifdef STALE_ORDER
uniform float near_m;
#endif

in uint slot;               // one for each instance, farthest first

flat out vec2 splat_px;
flat out vec4 conic_opacity;
flat out vec3 colour;

uvec4 words(int n) {
#ifdef RESIDENT_BUFFER
    return gaussians[int(slot) * TEXELS + n];
#else
    int column = (int(slot) % COLUMNS) * TEXELS + n;
    return texelFetch(gaussians, ivec2(column, int(slot) / COLUMNS), 0);
#endif
}

vec4 texel(int n) {
    vec4 there = uintBitsToFloat(words(n));
#ifdef MOVING
    there = on_its_way(there, n);
#endif
    return there;
}

void main() {
#ifdef MOVING                   // what the renderer puts in front of this text
    set_out(int(slot), words(TEXELS - 1).zw);
#endif
    vec4 place = texel(0);      // mean, opacity
    vec4 cov_first = texel(1);  // xx xy xz yy, m^2
    vec4 cov_last = texel(2);   // yz zz, red, green
    vec4 rest = texel(3);       // blue, linear harmonics in y
    mat3 cov = mat3(
        cov_first.x, cov_first.y, cov_first.z,
        cov_first.y, cov_first.w, cov_last.x,
        cov_first.z, cov_last.x, cov_last.y);

    vec3 seen = rotation * place.xyz + translation;
    vec2 ratio = seen.xy / seen.z;
    vec2 clamped = clamp(ratio, -limit, limit);
    vec2 scale = focal_px / seen.z;
    // The rows of the Jacobian times the camera's rotation; transpose, because GLSL stores columns.
    mat3 rows = transpose(rotation);
    vec3 a = scale.x * (rows[0] - clamped.x * rows[2]);
    vec3 b = scale.y * (rows[1] - clamped.y * rows[2]);
    vec3 cov_a = cov * a;
    vec3 cov_b = cov * b;
    float xx = dot(a, cov_a) + LOW_PASS_PX2;
    float xy = dot(a, cov_b);
    float yy = dot(b, cov_b) + LOW_PASS_PX2;
    float det = xx * yy - xy * xy;

    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // outside: nothing is drawn
    splat_px = focal_px * ratio + centre_px;
    conic_opacity = vec4(0.0);
    colour = vec3(0.0);
    if (!(det > 0.0 && place.w >= ALPHA_MIN)) return;
#ifdef STALE_ORDER
    // The order is of a moment ago, when the camera looked elsewhere.
    if (seen.z <= near_m) return;
#endif

    conic_opacity = vec4(yy / det, -xy / det, xx / det, place.w);
#if SH_DEGREE >= 2
    ivec2 there = ivec2(int(slot) % COLOUR_COLUMNS, int(slot) / COLOUR_COLUMNS);
    colour = uintBitsToFloat(texelFetch(colours, there, 0).rgb);
#ifdef MOVING
    colour = colour_on_its_way(colour);
#endif
#else
    colour = vec3(cov_last.zw, rest.x);
#endif
#if SH_DEGREE == 1
    vec4 more = texel(4);       // linear harmonics in z, red of x
    vec2 last = texel(5).xy;    // green and blue of x
    vec3 towards = normalize(place.xyz - position) * SH_C1;
    colour += towards.z * more.xyz - towards.y * rest.yzw - towards.x * vec3(more.w, last);
#endif
    colour = max(colour, 0.0);
#ifdef DEPTH
    colour = vec3(seen.z);
#endif

    // The axes of the ellipse on which alpha falls to ALPHA_MIN, a hair longer against rounding.
    float extent = 1.001 * min(MAX_EXTENT_SIGMA, sqrt(2.0 * log(place.w / ALPHA_MIN)));
    float middle = 0.5 * (xx + yy);
    float half_difference = 0.5 * (xx - yy);
    float spread = length(vec2(half_difference, xy));
    float long_variance = middle + spread;
    float short_variance = max(det / long_variance, 0.0);
    // Of the two expressions for the long axis, the one that does not cancel.
    vec2 axis = half_difference > 0.0 ? vec2(half_difference + spread, xy)
                                      : vec2(xy, spread - half_difference);
    axis = spread > 0.0 ? normalize(axis) : vec2(1.0, 0.0);
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    vec2 at_px = splat_px
        + extent * corner.x * sqrt(long_variance) * axis
        + extent * corner.y * sqrt(short_variance) * vec2(-axis.y, axis.x);
    // Row 0 of the target is the top of the picture, so it is read without turning it over.
    gl_Position = vec4(2.0 * at_px / size_px - 1.0, 0.0, 1.0);
}

#else

flat in vec2 splat_px;
flat in vec4 conic_opacity;
flat in vec3 colour;

out vec4 blended;           // premultiplied

void main() {
    // From the pixel's own centre, not from an interpolated offset: as exact as the CPU renderer.
    vec2 d = gl_FragCoord.xy - splat_px;
    float q = (0.5 * conic_opacity.x * d.x + conic_opacity.y * d.y) * d.x
        + 0.5 * conic_opacity.z * d.y * d.y;
    float alpha = min(ALPHA_MAX, conic_opacity.w * exp(-q));
    if (alpha < ALPHA_MIN) discard;
    blended = vec4(alpha * colour, alpha);
}

#endif
