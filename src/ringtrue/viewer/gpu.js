// The graphics card: one shared WebGL 2 context, its programs, and bodies of nodes with all that is drawn on them.
// Nodes, shapes and colours are textures that the vertex shader reads by number: a mode, a colour or a hidden element
// never sends geometry again, and animation is two uniforms.

const HEAD = `#version 300 es
precision highp float; precision highp int;
precision highp sampler2D; precision highp isampler2D; precision highp usampler2D;
uniform mat4 uView; uniform vec4 uMove; uniform vec4 uClip; uniform int uPass, uKind, uShade; uniform vec2 uRange;
uniform sampler2D uPoints, uState, uField; uniform isampler2D uReal, uImag; uniform usampler2D uPairs, uOwner;
out vec4 vColor; out float vValue, vCut; flat out uint vId;
ivec2 at(int k) { return ivec2(k & 2047, k >> 11); }
vec3 real(int n) { return uMove.z > 0. ? vec3(texelFetch(uReal, at(n), 0).xyz) * uMove.z : vec3(0.); }
vec3 moved(int n, vec3 d) {
  vec3 p = texelFetch(uPoints, at(n), 0).xyz + uMove.x * d;
  return uMove.w > 0. ? p - uMove.y * uMove.w * vec3(texelFetch(uImag, at(n), 0).xyz) : p;
}
// A value between 0 and 1 of what colours the body: 1 displacement, 2 field of nodes, 3 field of elements.
float value(int n, int e, vec3 d) {
  if (uShade == 1) return length(d);
  if (uShade == 0) return 0.;
  float v = texelFetch(uField, at(uShade == 2 ? n : e), 0).x;
  return (v - uRange.x) / (uRange.y - uRange.x);
}
bool left_out(vec4 c) { return c.a == 0. || uPass == 0 && c.a < 1. || uPass == 1 && c.a == 1.; }
uint tag(int k) { return uint(uKind) << 24 | uint(k + 1); }
`;

const MESH = `${HEAD}
layout(location = 0) in uint aNode;
uniform mat4 uTurn; out vec3 vPlace;
void main() {
  int face = gl_VertexID / 3, e = int(texelFetch(uOwner, at(face), 0).x), n = int(aNode);
  vColor = texelFetch(uState, at(e), 0);
  if (left_out(vColor)) { gl_Position = vec4(2., 2., 2., 1.); return; }
  vec3 d = real(n), p = moved(n, d);
  vValue = value(n, e, d); vCut = dot(uClip.xyz, p) - uClip.w; vId = tag(face);
  vPlace = (uTurn * vec4(p, 1.)).xyz;
  gl_Position = uView * vec4(p, 1.);
}`;

// A line is a quad of constant width on the screen: two triangles.
const LINE = `${HEAD}
uniform vec2 uSize; uniform float uWide, uLift; uniform vec4 uTint;
void main() {
  int k = gl_VertexID / 6, corner = gl_VertexID % 6, e = int(texelFetch(uOwner, at(k), 0).x);
  uvec2 ends = texelFetch(uPairs, at(k), 0).xy;
  vColor = texelFetch(uState, at(e), 0);
  if (left_out(vColor)) { gl_Position = vec4(2., 2., 2., 1.); return; }
  if (uTint.a > 0.) vColor = uTint;
  int i = int(ends.x), j = int(ends.y);
  bool far = corner == 1 || corner > 3;
  vec3 di = real(i), dj = real(j), pi = moved(i, di), pj = moved(j, dj);
  vec4 a = uView * vec4(pi, 1.), b = uView * vec4(pj, 1.), p = far ? b : a;
  vec2 along = (b.xy - a.xy) * uSize;
  float size = length(along);
  along = size > 1e-6 ? along / size : vec2(1., 0.);
  p.xy += vec2(-along.y, along.x) * (corner < 2 || corner == 4 ? -.5 : .5) * uWide / uSize;
  p.z -= uLift;
  vValue = far ? value(j, e, dj) : value(i, e, di);
  vCut = dot(uClip.xyz, far ? pj : pi) - uClip.w; vId = tag(k);
  gl_Position = p;
}`;

const POINT = `${HEAD}
uniform float uWide, uLift; uniform vec4 uTint;
void main() {
  int e = int(texelFetch(uOwner, at(gl_VertexID), 0).x), n = int(texelFetch(uPairs, at(gl_VertexID), 0).x);
  vColor = texelFetch(uState, at(e), 0);
  if (left_out(vColor)) { gl_Position = vec4(2., 2., 2., 1.); return; }
  if (uTint.a > 0.) vColor = uTint;
  vec3 d = real(n), p = moved(n, d);
  vValue = value(n, e, d); vCut = dot(uClip.xyz, p) - uClip.w; vId = tag(gl_VertexID);
  gl_Position = uView * vec4(p, 1.);
  gl_Position.z -= uLift; gl_PointSize = uWide;
}`;

const PAINT = `#version 300 es
precision highp float; precision highp int;
in vec4 vColor; in float vValue, vCut; flat in uint vId; out vec4 o;
uniform int uPick, uShade, uSigned;
vec3 four(vec3 a, vec3 b, vec3 c, vec3 d, float t) {
  return t < .333 ? mix(a, b, t * 3.) : t < .667 ? mix(b, c, t * 3. - 1.) : mix(c, d, t * 3. - 2.);
}
vec3 ramp(float t) {
  if (uSigned == 2) t = 1. - t; // what is large stands out from a dark page, too
  if (uSigned == 1) return t < .5 ? mix(vec3(.129, .400, .675), vec3(.95, .95, .93), t * 2.)
    : mix(vec3(.95, .95, .93), vec3(.698, .094, .169), t * 2. - 1.);
  return four(vec3(.949, .953, .918), vec3(.561, .816, .729), vec3(.169, .549, .745), vec3(.145, .204, .580), t);
}
vec3 tint() {
  if (uShade == 0) return vColor.rgb;
  if (isnan(vValue)) return vec3(.62);
  return ramp(clamp(vValue, 0., 1.));
}
vec4 id() { return vec4(uvec4(vId, vId >> 8, vId >> 16, vId >> 24) & 255u) / 255.; }
`;
const MESH_PAINT = `${PAINT}
in vec3 vPlace;
void main() {
  if (vCut > 0.) discard;
  if (uPick == 1) { o = id(); return; }
  vec3 n = normalize(cross(dFdx(vPlace), dFdy(vPlace)));
  o = vec4(tint() * (.62 + .38 * abs(dot(n, vec3(.254, .356, .899)))), vColor.a);
}`;
const FLAT_PAINT = `${PAINT}
uniform int uRound;
void main() {
  if (vCut > 0. || uRound == 1 && length(gl_PointCoord - .5) > .5) discard;
  o = uPick == 1 ? id() : vec4(tint(), vColor.a);
}`;

let shared = null;

// The context that all views share, null where there is no WebGL 2.
export function context() {
  if (shared) return shared;
  const canvas = document.createElement("canvas");
  const gl = canvas.getContext("webgl2", { antialias: false, alpha: true, preserveDrawingBuffer: true });
  if (!gl) return null;
  canvas.addEventListener("webglcontextlost", () => shared.lost && shared.lost());
  shared = { canvas, gl, mesh: compile(gl, MESH, MESH_PAINT), line: compile(gl, LINE, FLAT_PAINT), point: compile(gl, POINT, FLAT_PAINT) };
  shared.none = texture(gl, new Float32Array(1), 1);
  shared.noInts = texture(gl, new Int16Array(3), 3);
  shared.noPairs = texture(gl, new Uint32Array(2), 2);
  shared.frame = target(gl, 4);
  shared.ids = target(gl, 0);
  return shared;
}

function compile(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    throw new Error(gl.getAttachedShaders(program).map((s) => gl.getShaderInfoLog(s)).join("") + gl.getProgramInfoLog(program));
  }
  const at = {};
  for (let k = 0; k < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); k++) {
    const { name } = gl.getActiveUniform(program, k);
    at[name] = gl.getUniformLocation(program, name);
  }
  return { program, at };
}

const WIDTH = 2048; // of a texture of numbers, as the shaders have it

// A texture that holds an array, so many parts an entry.
function texture(gl, data, parts) {
  const kinds = {
    Float32Array: [gl.FLOAT, [gl.R32F, 0, gl.RGB32F], [gl.RED, 0, gl.RGB]],
    Int16Array: [gl.SHORT, [0, 0, gl.RGB16I], [0, 0, gl.RGB_INTEGER]],
    Uint32Array: [gl.UNSIGNED_INT, [gl.R32UI, gl.RG32UI], [gl.RED_INTEGER, gl.RG_INTEGER]],
    Uint8Array: [gl.UNSIGNED_BYTE, [0, 0, 0, gl.RGBA8], [0, 0, 0, gl.RGBA]],
  };
  const [type, inner, outer] = kinds[data.constructor.name];
  const count = Math.max(data.length / parts, 1), rows = Math.ceil(count / WIDTH), width = Math.min(count, WIDTH);
  const id = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, id);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texStorage2D(gl.TEXTURE_2D, 1, inner[parts - 1], width, rows);
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
  const made = { id, width, rows, parts, type, outer: outer[parts - 1] };
  fill(gl, made, data);
  return made;
}

function fill(gl, made, data) {
  const { width, parts, type, outer } = made;
  const whole = Math.floor(data.length / parts / width), rest = data.length / parts - whole * width, cut = whole * width * parts;
  gl.bindTexture(gl.TEXTURE_2D, made.id);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  if (whole) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, whole, outer, type, data.subarray(0, cut));
  if (rest) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, whole, rest, 1, outer, type, data.subarray(cut));
}

// A picture that is not on the screen: with samples to smooth edges, or of ids to be read back.
function target(gl, samples) {
  const frame = gl.createFramebuffer(), color = gl.createRenderbuffer(), depth = gl.createRenderbuffer();
  let width = 0, height = 0;
  const grow = (buffer, format) => {
    gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
    gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, format, width, height);
  };
  return (w, h) => {
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    if (w <= width && h <= height) return frame;
    width = Math.max(width, w);
    height = Math.max(height, h);
    grow(color, gl.RGBA8);
    grow(depth, gl.DEPTH_COMPONENT24);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, color);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depth);
    return frame;
  };
}

const UNITS = ["uPoints", "uReal", "uImag", "uOwner", "uState", "uField", "uPairs"];

// Nodes in space with what is drawn on them. `owners` is the number of elements (or sensors) that own what is drawn:
// each has a colour, and is hidden where its alpha is 0.
export class Body {
  constructor(ctx, points, owners) {
    Object.assign(this, { ctx, gl: ctx.gl, points, owners, strips: new Map(), shape: null });
    this.pointsTexture = texture(this.gl, points, 3);
    this.state = texture(this.gl, new Uint8Array(4 * Math.max(owners, 1)).fill(255), 4);
  }

  // Triangles (mesh), pairs of nodes (line) or pairs of equal nodes (point), with the owner of each.
  strip(name, kind, index, owner) {
    const { gl } = this;
    this.drop(name);
    const count = index.length / (kind === "mesh" ? 3 : 2);
    if (!count) return;
    const made = { kind, count, owner: texture(gl, owner, 1) };
    if (kind === "mesh") {
      made.array = gl.createVertexArray();
      gl.bindVertexArray(made.array);
      made.buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, made.buffer);
      gl.bufferData(gl.ARRAY_BUFFER, index, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(0);
      gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
      gl.bindVertexArray(null);
    } else made.pairs = texture(gl, index, 2);
    this.strips.set(name, made);
  }

  drop(name) {
    const { gl } = this, old = this.strips.get(name);
    if (!old) return;
    gl.deleteTexture(old.owner.id);
    if (old.pairs) gl.deleteTexture(old.pairs.id);
    if (old.array) { gl.deleteVertexArray(old.array); gl.deleteBuffer(old.buffer); }
    this.strips.delete(name);
  }

  // Colours (owner, 4) bytes.
  paint(colors) { fill(this.gl, this.state, colors); }

  // Nodes that have moved, in the same number.
  place(points) { this.points = points; fill(this.gl, this.pointsTexture, points); }

  // {real, imag}: Int16Array (node, 3) and the length of their unit in `step`; null: at rest.
  move(shape) {
    const { gl } = this;
    this.shape = shape;
    for (const [part, at] of [["real", "realTexture"], ["imag", "imagTexture"]]) {
      const values = shape && shape[part];
      if (values && this[at]) fill(gl, this[at], values);
      else if (values) this[at] = texture(gl, values, 3);
    }
  }

  // Values (node,) or (owner,) Float32Array that colour the body.
  color(values) {
    if (this.field) this.gl.deleteTexture(this.field.id);
    this.field = values && texture(this.gl, values, 1);
  }

  draw(name, scene, look = {}) {
    const strip = this.strips.get(name);
    if (!strip) return;
    const { gl, ctx, shape } = this, { program, at } = ctx[strip.kind];
    const still = look.still || !shape;
    gl.useProgram(program);
    const bound = [this.pointsTexture, still ? ctx.noInts : this.realTexture, !still && shape.imag ? this.imagTexture : ctx.noInts,
      strip.owner, this.state, this.field || ctx.none, strip.pairs || ctx.noPairs];
    bound.forEach((t, k) => {
      if (at[UNITS[k]] === undefined) return;
      gl.activeTexture(gl.TEXTURE0 + k);
      gl.bindTexture(gl.TEXTURE_2D, t.id);
      gl.uniform1i(at[UNITS[k]], k);
    });
    gl.uniformMatrix4fv(at.uView, false, scene.matrix);
    if (at.uTurn) gl.uniformMatrix4fv(at.uTurn, false, scene.turn);
    const step = still ? 0 : shape.step;
    gl.uniform4f(at.uMove, scene.cos, scene.sin, step, !still && shape.imag ? step : 0);
    gl.uniform4fv(at.uClip, look.whole ? [0, 0, 0, 0] : scene.clip);
    gl.uniform1i(at.uPass, look.pass ?? 2);
    gl.uniform1i(at.uKind, look.kind || 0);
    gl.uniform1i(at.uPick, scene.pick ? 1 : 0);
    gl.uniform1i(at.uShade, look.shade || 0);
    gl.uniform1i(at.uSigned, look.signed ? 1 : look.dark ? 2 : 0);
    gl.uniform2fv(at.uRange, look.range || [0, 1]);
    if (at.uSize) gl.uniform2f(at.uSize, scene.width / 2, scene.height / 2);
    if (at.uWide) gl.uniform1f(at.uWide, (look.wide || 1) * scene.ratio);
    if (at.uLift) gl.uniform1f(at.uLift, look.lift || 0);
    if (at.uTint) gl.uniform4fv(at.uTint, look.tint || [0, 0, 0, 0]);
    if (at.uRound) gl.uniform1i(at.uRound, strip.kind === "point" ? 1 : 0);
    gl.depthMask(look.pass !== 1);
    gl.bindVertexArray(strip.array || null);
    const size = { mesh: 3, line: 6, point: 1 }[strip.kind];
    gl.drawArrays(strip.kind === "point" ? gl.POINTS : gl.TRIANGLES, 0, size * strip.count);
    gl.bindVertexArray(null);
    gl.depthMask(true);
  }

  destroy() {
    for (const name of [...this.strips.keys()]) this.drop(name);
    for (const t of [this.pointsTexture, this.state, this.realTexture, this.imagTexture, this.field]) if (t) this.gl.deleteTexture(t.id);
  }
}
