"""GLSL additions to VTK's physically based shader: refraction, growth rings, a film curve.

The pieces run inside VTK's fragment shader and use its names: ``diffuseColor``, ``color`` (linear radiance),
``N`` and ``V`` (normal and direction to the camera), ``NdV`` (their product), ``roughness``, ``envMatrix`` and
``prefilterTex`` (the studio's light, blurred more at each level).
"""

from __future__ import annotations

#: Film curve: colours up to 0.6 stay linear, brighter ones approach white smoothly.
FILM = """
  vec3 over = max(color - vec3(0.6), vec3(0.0));
  color = min(color, vec3(0.6)) + 0.4 * over / (over + 0.4);
  fragOutput0.rgb = pow(color, vec3(1.0 / 2.2));
"""

#: Refraction into the body and out again, as if the body were locally a ball: the outward normal at the exit is that at
#: the entry, mirrored at the ray. Straight ahead the ray then meets the backdrop, elsewhere the studio. Half of the far
#: side, drawn first, shines through the near side.
CLEAR = """
  vec3 ray = refract(-V, N, 1.0 / 1.5);
  vec3 farNormal = N - 2.0 * dot(N, ray) * ray;
  vec3 leaving = refract(ray, -farNormal, 1.5);
  vec3 through = textureLod(prefilterTex, normalize(envMatrix * leaving), roughness * prefilterMaxLevel).rgb;
  through = mix(through, vec3(BACKDROP), smoothstep(0.75, 1.0, dot(leaving, -V)));
  through *= pow(diffuseColorUniform, vec3(-dot(ray, N)));
  float mirrored = 0.04 + 0.96 * pow(1.0 - NdV, 5.0);
  color = mix(through, prefilteredSpecularColor, mirrored);
  fragOutput0.a = gl_FrontFacing ? mix(0.5, 1.0, mirrored) : 1.0;
"""

WOOD_DECLARATIONS = """
in vec3 bodyPosition;
float lattice(vec3 p) { return fract(sin(dot(p, vec3(127.1, 311.7, 74.7))) * 43758.5453); }
float noise(vec3 p)
{
  vec3 i = floor(p), f = fract(p);
  f = f * f * (3.0 - 2.0 * f);
  vec2 o = vec2(0.0, 1.0);
  vec4 low = vec4(lattice(i), lattice(i + o.yxx), lattice(i + o.xyx), lattice(i + o.yyx));
  vec4 high = vec4(lattice(i + o.xxy), lattice(i + o.yxy), lattice(i + o.xyy), lattice(i + o.yyy));
  vec4 level = mix(low, high, f.z);
  return mix(mix(level.x, level.y, f.x), mix(level.z, level.w, f.x), f.y);
}
"""

#: Growth rings around a trunk beside the body, tilted so that every face shows curved lines. Late wood is the dark end
#: of each ring; fibres run along the trunk.
WOOD = """
  vec3 trunk = bodyPosition + vec3(0.9 + 0.18 * bodyPosition.z, 0.6 - 0.12 * bodyPosition.z, 0.0);
  float ring = fract(9.0 * length(trunk.xy) + 1.1 * noise(vec3(1.6 * trunk.xy, 0.7 * trunk.z)));
  float late = smoothstep(0.25, 0.88, ring) * (1.0 - smoothstep(0.9, 1.0, ring));
  float fibre = noise(vec3(70.0 * trunk.xy, 5.0 * trunk.z));
  diffuseColor = mix(diffuseColor, vec3(LATE), 0.75 * late) * (0.88 + 0.24 * fibre);
"""


def dress(actor, kind: str, backdrop, late) -> None:
    """Add the shader code of a look to an actor with physically based shading; colours are linear RGB."""
    shader = actor.GetShaderProperty()

    def after(tag, code, add):
        add(tag, True, f"{tag}\n{code}\n", False)

    fragment, vertex = shader.AddFragmentShaderReplacement, shader.AddVertexShaderReplacement
    if kind == "wood":
        after("//VTK::PositionVC::Dec", "out vec3 bodyPosition;", vertex)
        after("//VTK::PositionVC::Impl", "bodyPosition = vertexMC.xyz;", vertex)
        after("//VTK::PositionVC::Dec", WOOD_DECLARATIONS, fragment)
        after("//VTK::PBR::Impl", WOOD.replace("LATE", _numbers(late)), fragment)
    clear = CLEAR.replace("BACKDROP", _numbers(backdrop)) if kind == "clear" else ""
    after("//VTK::Light::Impl", clear + FILM, fragment)


def _numbers(colour) -> str:
    return ", ".join(f"{channel:.6f}" for channel in colour)
