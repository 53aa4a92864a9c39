// The shaders of the 3D view.

export const VERTEX = `#version 300 es
  in vec3 refined, original, refinedNormal, originalNormal, colour, paint;
  in vec2 uv;
  in float relief;
  uniform mat3 turn;          // from the mesh to how it stands, y up
  uniform mat3 axes;          // rows: right, up, towards the viewer
  uniform vec3 eye;
  uniform vec2 lens;          // focal length over half the width and the height of the picture
  uniform vec2 depth;         // near and far
  uniform float shape;        // 0 original, 1 refined
  out vec3 n, c, at, painted;
  out vec2 place;
  out float r, height;
  void main() {
    at = mix(original, refined, shape);
    vec3 standing = turn * at;
    vec3 p = (standing - eye) * axes;
    n = (turn * mix(originalNormal, refinedNormal, shape)) * axes;
    c = colour;
    r = relief;
    place = uv;
    painted = paint;
    height = standing.y;
    gl_Position = vec4(lens * p.xy, ((depth.x + depth.y) * p.z + 2.0 * depth.x * depth.y) / (depth.x - depth.y), -p.z);
  }`;
export const FRAGMENT = `#version 300 es
  precision highp float;
  in vec3 n, c, at, painted;
  in vec2 place;
  in float r, height;
  uniform vec3 key, fill, up;  // towards the lights and the sky, in the frame of the camera
  uniform float albedo, ambient, key_weight, fill_weight, sharpness;  // as in the plugin twolight
  uniform int surface;         // 0 one colour, 1 texture, 2 relief, 3 one colour in layers
  uniform vec3 scale[9];       // colours of the relief, sRGB
  uniform vec3 plastic;
  uniform sampler2D image;
  uniform bool textured;
  uniform vec4 factor;
  uniform float cutoff;
  uniform vec2 layer;          // height of a layer, and how far a bead bulges in layers
  uniform vec4 brush;          // centre and radius
  out vec4 pixel;
  vec3 linear(vec3 s) { return mix(s / 12.92, pow((s + 0.055) / 1.055, vec3(2.4)), step(0.04045, s)); }
  vec3 srgb(vec3 l) { return mix(l * 12.92, 1.055 * pow(l, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, l)); }
  float lit(vec3 m);
  // Sides of beads and treads between them, averaged over what the pixel covers of a layer
  float layered(vec3 m) {
    float rise = dot(m, up), run = sqrt(max(1.0 - rise * rise, 1e-6)), sum = 0.0;
    vec3 outward = (m - rise * up) / run;
    float side = run / (run + abs(rise)), first = height / layer.x, width = min(fwidth(first), 1.0);
    for (int k = 0; k < 6; k++) {
      float f = fract(first + ((float(k) + 0.5) / 6.0 - 0.5) * width), s = clamp(2.0 * f / side - 1.0, -1.0, 1.0);
      vec3 bead = normalize(outward * (0.5 * sqrt(1.0 - 0.96 * s * s)) + up * (layer.y * s));
      sum += lit(f < side ? bead : sign(rise) * up);
    }
    return sum / 6.0;
  }
  vec3 seen() {
    vec4 texel = textured ? texture(image, place) : vec4(1.0);
    if (texel.a * factor.a < cutoff) discard;
    return texel.rgb * factor.rgb;
  }
  float softplus(float x) { return max(x, 0.0) + log(1.0 + exp(-abs(x))); }
  float diffuse(float x) { return softplus(sharpness * x) / softplus(sharpness); }
  float lit(vec3 m) { return mix(key_weight * diffuse(dot(m, key)) + fill_weight * diffuse(dot(m, fill)), 1.0, ambient); }
  void main() {
    vec3 paint = seen(), m = normalize(n);
    float shade = surface == 3 && layer.x > 0.0 ? layered(m) : lit(m);
    vec3 colour = albedo * (surface == 1 ? linear(c) * paint : plastic);
    if (surface == 2) {
      float place = (clamp(r, -1.0, 1.0) + 1.0) * 4.0;
      int i = int(min(place, 7.0));
      colour = linear(mix(scale[i], scale[i + 1], place - float(i)));
      shade = 0.45 + 0.55 * shade;
    }
    vec2 grid = gl_FragCoord.xy / 7.0;
    float stripes = smoothstep(0.35, 0.65, abs(fract(grid.x + grid.y) * 2.0 - 1.0)), dots = step(length(fract(grid) - 0.5), 0.32);
    colour = mix(colour, vec3(0.02, 0.33, 0.62), smoothstep(0.3, 0.7, painted.x) * (0.35 + 0.4 * stripes));
    colour = mix(colour, vec3(0.86, 0.22, 0.02), smoothstep(0.3, 0.7, painted.y) * 0.6);
    colour = mix(colour, vec3(0.05, 0.4, 0.12), smoothstep(0.3, 0.7, painted.z) * (0.3 + 0.45 * dots));
    float ring = abs(length(at - brush.xyz) - brush.w) / max(fwidth(length(at - brush.xyz)), 1e-9);
    if (brush.w > 0.0) colour = mix(colour, vec3(1.0), 1.0 - smoothstep(1.0, 2.2, ring));
    pixel = vec4(srgb(clamp(colour * shade, 0.0, 1.0)), 1.0);
  }`;
