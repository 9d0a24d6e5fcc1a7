#version 430
// One work group a tile: sums over its pixels of what a cost needs (see sums.py).
// LANES is defined by the program that loads this file.

layout(local_size_x = LANES) in;

layout(binding = 0) uniform sampler2D atlas;      // near / z, 0 where nothing is drawn
layout(binding = 1) uniform sampler2D observed;   // z of a target pixel, < 0 other reading, 0 no reading
layout(std430, binding = 1) writeonly buffer Sums { vec4 sums[]; };  // two a tile

layout(std430, binding = 3) readonly buffer Boxes { ivec4 boxes[]; };  // what a tile's mesh can cover

uniform ivec2 tile_size;
uniform int columns;  // of tiles in the atlas
uniform float near_mm;
uniform float clamp_mm;
uniform float match_mm;  // depths that differ by less agree

// the pixel's model (pixel_model.py); near_sd = 0: no misfits are asked for
uniform float near_sd;
uniform float sd_growth;
uniform float occluder_rate;
uniform float occluded_per_sd;
uniform float outlier_per_sd;

shared vec4 partial[LANES];
shared vec3 partial_more[LANES];

float misfit(float d, float y) {
    float sd = near_sd + sd_growth * d * d;
    float outlier = outlier_per_sd * sd;
    if (y < 0.0) {
        float front = 1.0 / (1.0 + exp(clamp(-1.702 * (d + y) / sd, -80.0, 80.0)));
        return -log(front + (1.0 - front) * outlier / (1.0 + outlier));
    }
    float t = (y - d) / sd;
    float far_end = exp(-occluder_rate * d);
    float hidden = occluded_per_sd * sd / (1.0 - far_end);
    float before = y <= d ? hidden * exp(-occluder_rate * y) : 0.0;
    return log((1.0 + hidden * far_end + outlier) / (exp(-0.5 * t * t) + before + outlier));
}

void main() {
    int tile = int(gl_WorkGroupID.x);
    int lane = int(gl_LocalInvocationIndex);
    ivec2 corner = ivec2(tile % columns, tile / columns) * tile_size;
    ivec4 box = boxes[tile];
    int width = max(box.z - box.x, 0);
    int pixels = width * max(box.w - box.y, 0);
    vec4 sum = vec4(0.0);
    vec3 more = vec3(0.0);  // sum of misfits, how many pixels are hidden, how many agree
    for (int i = lane; i < pixels; i += LANES) {
        ivec2 at = box.xy + ivec2(i % width, i / width);
        float inverse = texelFetch(atlas, corner + at, 0).x;
        if (inverse > 0.0) {
            float d = near_mm / inverse;
            float y = texelFetch(observed, at, 0).x;
            float error = min(abs(d - y), clamp_mm);
            sum += y > 0.0 ? vec4(error, 1.0, 0.0, 0.0) : vec4(0.0, 0.0, float(y < 0.0), float(y == 0.0));
            if (near_sd > 0.0 && y != 0.0) more.x += misfit(d, y);
            more.y += float(y < 0.0 && -y < d);
            more.z += float(y > 0.0 && abs(d - y) < match_mm);
        }
    }
    partial[lane] = sum;
    partial_more[lane] = more;
    barrier();
    for (int half_way = LANES / 2; half_way > 0; half_way >>= 1) {
        if (lane < half_way) {
            partial[lane] += partial[lane + half_way];
            partial_more[lane] += partial_more[lane + half_way];
        }
        barrier();
    }
    if (lane == 0) {
        sums[2 * tile] = partial[0];
        sums[2 * tile + 1] = vec4(partial_more[0], 0.0);
    }
}
