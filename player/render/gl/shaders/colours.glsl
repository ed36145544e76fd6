// Colours from harmonics of degree 2 or 3 as a camera sees them: one point for each Gaussian, into the
// texel of its slot.

#ifdef VERTEX_STAGE

// TEXELS texels for each Gaussian (upload.py says what is where).
#ifdef RESIDENT_BUFFER
layout(std430, binding = 0) readonly buffer Gaussians { uvec4 gaussians[]; };
#else
uniform usampler2D gaussians;   // COLUMNS Gaussians in a row
#endif

uniform vec3 position;          // of the camera in the world, metres
uniform vec2 size_px;           // of the texture of colours

flat out uvec4 seen;

vec4 texel(int slot, int n) {
#ifdef RESIDENT_BUFFER
    return uintBitsToFloat(gaussians[slot * TEXELS + n]);
#else
    return uintBitsToFloat(texelFetch(gaussians, ivec2((slot % COLUMNS) * TEXELS + n, slot / COLUMNS), 0));
#endif
}

#ifdef STAGED_WIDTH_PX
uniform usampler2D staged;      // Gaussians that came last, as WebGL2 uploads them
uniform int item_words;         // of one of them; 0: all slots in turn
uniform int slot_word;          // which of these names the slot
#endif

int slot_of(int vertex) {
#ifdef STAGED_WIDTH_PX
    if (item_words > 0) {
        int at = vertex * item_words + slot_word;
        ivec2 there = ivec2(at / 4 % STAGED_WIDTH_PX, at / 4 / STAGED_WIDTH_PX);
        return int(texelFetch(staged, there, 0)[at % 4] & 0xffffffu);
    }
#endif
    return vertex;
}

void main() {
    int slot = slot_of(gl_VertexID);
    vec3 d = normalize(texel(slot, 0).xyz - position);
    float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
    vec4 t3 = texel(slot, 3), t4 = texel(slot, 4), t5 = texel(slot, 5), t6 = texel(slot, 6);
    vec4 t7 = texel(slot, 7), t8 = texel(slot, 8), t9 = texel(slot, 9);
    vec3 colour = vec3(texel(slot, 2).zw, t3.x);
    colour += SH_C1 * (d.z * t4.xyz - d.y * t3.yzw - d.x * vec3(t4.w, t5.xy));
    colour += SH_C2_0 * (d.x * d.y * vec3(t5.zw, t6.x) - d.y * d.z * t6.yzw);
    colour += SH_C2_1 * (2.0 * zz - xx - yy) * t7.xyz;
    colour -= SH_C2_0 * d.x * d.z * vec3(t7.w, t8.xy);
    colour += SH_C2_2 * (xx - yy) * vec3(t8.zw, t9.x);
#if SH_DEGREE >= 3
    vec4 t10 = texel(slot, 10), t11 = texel(slot, 11), t12 = texel(slot, 12), t13 = texel(slot, 13);
    vec2 last = texel(slot, 14).xy;
    colour -= SH_C3_0 * d.y * (3.0 * xx - yy) * t9.yzw;
    colour += SH_C3_1 * d.x * d.y * d.z * t10.xyz;
    colour -= SH_C3_2 * d.y * (4.0 * zz - xx - yy) * vec3(t10.w, t11.xy);
    colour += SH_C3_3 * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * vec3(t11.zw, t12.x);
    colour -= SH_C3_2 * d.x * (4.0 * zz - xx - yy) * t12.yzw;
    colour += SH_C3_4 * d.z * (xx - yy) * t13.xyz;
    colour -= SH_C3_0 * d.x * (xx - 3.0 * yy) * vec3(t13.w, last);
#endif
    seen = floatBitsToUint(vec4(max(colour, 0.0), 1.0));
    vec2 at_px = vec2(slot % COLOUR_COLUMNS, slot / COLOUR_COLUMNS) + 0.5;
    gl_Position = vec4(2.0 * at_px / size_px - 1.0, 0.0, 1.0);
    gl_PointSize = 1.0;
}

#else

flat in uvec4 seen;

out uvec4 stored;

void main() {
    stored = seen;
}

#endif
