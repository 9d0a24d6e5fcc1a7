#version 430
// Lambertian diffuse and Blinn specular reflection of LIGHTS directional lights, and ambient light.

in vec3 at;
in vec3 facing;
in vec2 texel;

uniform sampler2D surface;      // red: reflectance, green: gloss
uniform vec3 eye;               // the camera's centre, mm, reference axes
uniform vec4 light[LIGHTS];     // xyz: unit direction towards the light; w: strength
uniform vec4 ambient;           // ambient light: w + dot(xyz, normal)
uniform float shininess;

out float grey;

void main() {
    vec2 material = texture(surface, texel).rg;
    if (dot(facing, facing) < 1e-12) {
        grey = material.r;
        return;
    }
    vec3 towards = normalize(eye - at);
    vec3 n = normalize(facing);
    n = dot(n, towards) < 0.0 ? -n : n;
    float diffuse = max(ambient.w + dot(ambient.xyz, n), 0.0);
    float specular = 0.0;
    for (int k = 0; k < LIGHTS; k++) {
        float lit = dot(n, light[k].xyz);
        diffuse += light[k].w * max(lit, 0.0);
        float half_way = max(dot(n, normalize(light[k].xyz + towards)), 0.0);
        specular += light[k].w * pow(half_way, shininess) * smoothstep(0.0, 0.2, lit);
    }
    grey = material.r * diffuse + material.g * specular;
}
