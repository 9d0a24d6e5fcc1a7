#version 430
// Projects a vertex, given in the reference camera's axes, into one camera's image.

in vec3 position;   // mm, reference axes
in vec3 normal;     // reference axes, any length; zero: not shaded
in vec2 texcoord;

uniform mat4x3 camera_T_reference;  // columns: rotation, then translation, mm
uniform vec4 to_image;    // x: u + 0.5 = to_image.x * x / z + to_image.y, likewise v with .z and .w
uniform vec2 image_size;  // pixels
uniform vec2 range_mm;    // near and far clipping depth

out vec3 at;
out vec3 facing;
out vec2 texel;

void main() {
    at = position;
    facing = normal;
    texel = texcoord;
    vec3 p = camera_T_reference * vec4(position, 1.0);
    vec2 t = to_image.xz * p.xy + to_image.yw * p.z;
    float n = range_mm.x, f = range_mm.y;
    gl_Position = vec4(2.0 * t / image_size - p.z, (p.z * (f + n) - 2.0 * f * n) / (f - n), p.z);
}
