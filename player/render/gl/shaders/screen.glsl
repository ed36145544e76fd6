// Brings a finished picture onto a part of the screen: its row 0, the top, goes to the part's last row.

#ifdef VERTEX_STAGE

void main() {
    // One triangle that covers everything.
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0;
    gl_Position = vec4(corner, 0.0, 1.0);
}

#else

uniform sampler2D picture;
uniform ivec2 corner_px;    // lower left of the part
uniform vec3 background;

out vec4 shown;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy) - corner_px;
    at.y = textureSize(picture, 0).y - 1 - at.y;
    vec4 drawn = texelFetch(picture, at, 0);
    shown = vec4(drawn.rgb + (1.0 - drawn.a) * background, 1.0);
}

#endif
