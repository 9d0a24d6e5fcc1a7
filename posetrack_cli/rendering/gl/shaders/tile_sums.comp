#version 430
// Sums over the pixels of a tile, one work group per tile; see TileSums in rendering/port.py.
// LANES and MIXTURE (whether to compute misfits) are defined by the program that loads this file.

layout(local_size_x = LANES) in;

layout(binding = 0) uniform sampler2D atlas;      // near / z, 0 where empty
// x: z of a target pixel, < 0 other reading, 0 no reading; y: distance to the nearest target pixel, pixels
layout(binding = 1) uniform sampler2D observed;
layout(std430, binding = 1) writeonly buffer Sums { vec4 sums[]; };  // two per tile

layout(std430, binding = 3) readonly buffer Boxes { ivec4 boxes[]; };  // possibly covered pixels of a tile

uniform ivec2 tile_size;
uniform int columns;  // tile columns of the atlas
uniform float near_mm;
uniform float clamp_mm;
uniform float match_mm;  // depths that differ by less match

#if MIXTURE  // compile-time switch: in software OpenGL even an untaken branch costs time
// pixel model (pixel_model.py)
uniform float near_sd;
uniform float sd_growth;
uniform float occluder_rate;
uniform float occluded_per_sd;
uniform float outlier_per_sd;
uniform float outline_sd;
uniform float unread_weight;
uniform float slope;  // width of a pixel, mm, per mm of depth

const float NEIGHBOUR_MISFIT = 2.0;  // misfit above which an outline error is considered
const ivec2 NEAR[12] = ivec2[](
    ivec2(-1, 0), ivec2(1, 0), ivec2(0, -1), ivec2(0, 1),
    ivec2(-1, -1), ivec2(1, -1), ivec2(-1, 1), ivec2(1, 1),
    ivec2(-2, 0), ivec2(2, 0), ivec2(0, -2), ivec2(0, 2));

// probability b(x) of an outline error of off mm, including outliers
float beside(float off, float outlier) {
    float t = off / outline_sd;
    return (exp(-0.5 * t * t) + outlier) / (1.0 + outlier);
}

float pow2(float x) { return x * x; }

float outlier_at(float d) { return outlier_per_sd * (near_sd + sd_growth * d * d); }

float misfit_of_other(float d, float y, float off) {
    float sd = near_sd + sd_growth * d * d;
    float left = beside(off, outlier_per_sd * sd);
    if (y == 0.0) return -unread_weight * log(left);
    float front = 1.0 / (1.0 + exp(clamp(-1.702 * (d + y) / sd, -80.0, 80.0)));
    return -log(front + (1.0 - front) * left);
}

float misfit(float d, float y, float off) {
    float sd = near_sd + sd_growth * d * d;
    float outlier = outlier_per_sd * sd;
    float t = (y - d) / sd;
    float s = off / outline_sd;
    float far_end = exp(-occluder_rate * d);
    float hidden = occluded_per_sd * sd / (1.0 - far_end);
    float before = y <= d ? hidden * exp(-occluder_rate * y) : 0.0;
    return log((1.0 + hidden * far_end + outlier) / (exp(-0.5 * (t * t + s * s)) + before + outlier));
}

// misfit of a target pixel with the best-fitting surface next to it
float misfit_with_neighbours(float y, ivec2 at, ivec2 corner) {
    float per_sd2 = 1.0 / pow2(near_sd + sd_growth * y * y);
    float per_outline2 = pow2(slope * y / outline_sd);
    float least = 1e30, best_depth = 0.0, best_off2 = 0.0;
    for (int k = 0; k < 12; k++) {
        ivec2 there = at + NEAR[k];
        if (any(lessThan(there, ivec2(0))) || any(greaterThanEqual(there, tile_size))) continue;
        float inverse = texelFetch(atlas, corner + there, 0).x;
        if (inverse == 0.0) continue;
        float d = near_mm / inverse;
        float off2 = float(NEAR[k].x * NEAR[k].x + NEAR[k].y * NEAR[k].y);
        float square = pow2(y - d) * per_sd2 + off2 * per_outline2;
        if (square < least) {
            least = square;
            best_depth = d;
            best_off2 = off2;
        }
    }
    return best_depth > 0.0 ? misfit(best_depth, y, sqrt(best_off2) * slope * y) : 1e9;
}
#endif

shared vec4 partial[LANES];
shared vec4 partial_more[LANES];

void main() {
    int tile = int(gl_WorkGroupID.x);
    int lane = int(gl_LocalInvocationIndex);
    ivec2 corner = ivec2(tile % columns, tile / columns) * tile_size;
    ivec4 box = boxes[tile];
#if MIXTURE
    if (box.z > box.x) {  // uncovered pixels next to the surface contribute relief
        box = ivec4(max(box.xy - 2, ivec2(0)), min(box.zw + 2, tile_size));
    }
#endif
    int width = max(box.z - box.x, 0);
    int pixels = width * max(box.w - box.y, 0);
    vec4 sum = vec4(0.0);
    vec4 more = vec4(0.0);  // misfit, occluded, matched, relief
    for (int i = lane; i < pixels; i += LANES) {
        ivec2 at = box.xy + ivec2(i % width, i / width);
        float inverse = texelFetch(atlas, corner + at, 0).x;
        vec2 reading = texelFetch(observed, at, 0).xy;
        float y = reading.x;
        if (inverse > 0.0) {
            float d = near_mm / inverse;
            float error = min(abs(d - y), clamp_mm);
            sum += y > 0.0 ? vec4(error, 1.0, 0.0, 0.0) : vec4(0.0, 0.0, float(y < 0.0), float(y == 0.0));
            more.y += float(y < 0.0 && -y < d);
            more.z += float(y > 0.0 && abs(d - y) < match_mm);
        }
#if MIXTURE
        bool drawn = inverse > 0.0;
        if (!drawn && y <= 0.0) continue;
        float d = drawn ? near_mm / inverse : y;
        float alone = !drawn ? log(1.0 + 1.0 / outlier_at(y))
                    : y > 0.0 ? misfit(d, y, 0.0) : misfit_of_other(d, y, reading.y * slope * d);
        float rho = alone;
        if (y > 0.0 && alone > NEIGHBOUR_MISFIT) rho = min(rho, misfit_with_neighbours(y, at, corner));
        more.x += drawn ? rho : 0.0;
        more.w += drawn ? 0.0 : alone - rho;
#endif
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
        sums[2 * tile + 1] = partial_more[0];
    }
}
