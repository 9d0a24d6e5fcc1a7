#version 430
// One work group a tile: sums over its pixels of what a cost needs (see sums.py).
// LANES is defined by the program that loads this file.

layout(local_size_x = LANES) in;

layout(binding = 0) uniform sampler2D atlas;      // near / z, 0 where nothing is drawn
layout(binding = 1) uniform sampler2D observed;   // z of a target pixel, < 0 other reading, 0 no reading
layout(std430, binding = 1) writeonly buffer Sums { vec4 sums[]; };

layout(std430, binding = 3) readonly buffer Boxes { ivec4 boxes[]; };  // what a tile's mesh can cover

uniform ivec2 tile_size;
uniform int columns;  // of tiles in the atlas
uniform float near_mm;
uniform float clamp_mm;

shared vec4 partial[LANES];

void main() {
    int tile = int(gl_WorkGroupID.x);
    int lane = int(gl_LocalInvocationIndex);
    ivec2 corner = ivec2(tile % columns, tile / columns) * tile_size;
    ivec4 box = boxes[tile];
    int width = max(box.z - box.x, 0);
    int pixels = width * max(box.w - box.y, 0);
    vec4 sum = vec4(0.0);
    for (int i = lane; i < pixels; i += LANES) {
        ivec2 at = box.xy + ivec2(i % width, i / width);
        float inverse = texelFetch(atlas, corner + at, 0).x;
        if (inverse > 0.0) {
            float y = texelFetch(observed, at, 0).x;
            float error = min(abs(near_mm / inverse - y), clamp_mm);
            sum += y > 0.0 ? vec4(error, 1.0, 0.0, 0.0) : vec4(0.0, 0.0, float(y < 0.0), float(y == 0.0));
        }
    }
    partial[lane] = sum;
    barrier();
    for (int half_way = LANES / 2; half_way > 0; half_way >>= 1) {
        if (lane < half_way) partial[lane] += partial[lane + half_way];
        barrier();
    }
    if (lane == 0) sums[tile] = partial[0];
}
