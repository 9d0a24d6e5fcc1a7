#version 430
// Skins one vertex of one instance and projects it into that instance's tile of the atlas.
// INFLUENCES (maximum bones per vertex) and BONES are defined by the program that loads this file.

layout(std430, binding = 0) readonly buffer Transforms { vec4 row[]; };  // per instance and bone: 3 rows

layout(std430, binding = 2) readonly buffer Influences { vec2 influence[]; };  // per vertex: bone, weight

in vec3 rest;

uniform vec4 to_tile;     // x: tile_x = to_tile.x * x / z + to_tile.y, likewise y with .z and .w
uniform vec2 tile_size;   // pixels
uniform ivec2 grid;       // tiles per row and column of the atlas
uniform float near_mm;

void main() {
    int first = gl_InstanceID * BONES * 3;
    vec4 r = vec4(rest, 1.0);
    vec3 p = vec3(0.0);
    for (int k = 0; k < INFLUENCES; k++) {
        vec2 bone = influence[gl_VertexID * INFLUENCES + k];
        int at = first + int(bone.x) * 3;
        p += bone.y * vec3(dot(row[at], r), dot(row[at + 1], r), dot(row[at + 2], r));
    }
    // tile coordinates times z: clip space is homogeneous, so no division is needed
    vec2 t = to_tile.xz * p.xy + to_tile.yw * p.z;
    vec2 corner = vec2(gl_InstanceID % grid.x, gl_InstanceID / grid.x) * tile_size;
    vec2 ndc = 2.0 * (t + corner * p.z) / (tile_size * vec2(grid)) - p.z;
    // depth value near / z: linear in screen space, hence interpolated exactly; 0 is at infinity
    gl_Position = vec4(ndc, 2.0 * near_mm - p.z, p.z);
    gl_ClipDistance[0] = t.x;
    gl_ClipDistance[1] = tile_size.x * p.z - t.x;
    gl_ClipDistance[2] = t.y;
    gl_ClipDistance[3] = tile_size.y * p.z - t.y;
}
