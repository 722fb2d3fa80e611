// Geometry without a graphics card: arrays as they travel, edges worth drawing, the camera.

const TYPES = { f4: Float32Array, u4: Uint32Array, u2: Uint16Array, i2: Int16Array, u1: Uint8Array };

function bytesOf(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let k = 0; k < raw.length; k++) out[k] = raw.charCodeAt(k);
  return out.buffer;
}

// Arrays travel as {f4: base64} in a page, or as {f4: [offset, count]} into a block of bytes. Both become typed arrays.
export function decode(value, block = null) {
  if (ArrayBuffer.isView(value) || value === null || typeof value !== "object") return value;
  if (Array.isArray(value)) return value.map((v) => decode(v, block));
  const [name, ...more] = Object.keys(value);
  const Type = more.length === 0 && TYPES[name];
  if (Type && typeof value[name] === "string") return new Type(bytesOf(value[name]));
  if (Type && block) return new Type(block, ...value[name]);
  return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, decode(v, block)]));
}

// A block: length of its head as uint32, the head as JSON, the arrays. Offsets of arrays count from the end of the head.
export function unpack(bytes) {
  const buffer = ArrayBuffer.isView(bytes) ? bytes.buffer : bytes, start = ArrayBuffer.isView(bytes) ? bytes.byteOffset : 0;
  const size = new DataView(buffer).getUint32(start, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, start + 4, size)));
  return decode(head, buffer.slice(start + 4 + size));
}

export const ENDS = 6; // points of an arrow: foot, tip, four of its head
export const STROKES = 5; // lines of it

export const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);

// Edges of the visible skin worth drawing: free ones, sharp ones, borders between groups; with `mesh` all but those
// within a face of one element. Returns pairs of nodes.
export function edgesOf({ points, triangles, face_element: owner, group }, shown, mesh = false) {
  const count = triangles.length / 3, normal = new Float32Array(3 * count);
  let size = 1024;
  while (size < 4.5 * count) size *= 2;
  const low = new Uint32Array(size), high = new Uint32Array(size), first = new Int32Array(size).fill(-1), state = new Uint8Array(size);
  for (let t = 0; t < count; t++) if (shown[owner[t]]) unitNormal(points, triangles, t, normal);
  const flat = (s, t) => Math.abs(normal[3 * s] * normal[3 * t] + normal[3 * s + 1] * normal[3 * t + 1] + normal[3 * s + 2] * normal[3 * t + 2]) > 0.86;
  // state of an edge: 1 seen once, 2 seen twice and not drawn, 3 drawn
  for (let t = 0; t < count; t++) {
    if (!shown[owner[t]]) continue;
    for (let k = 0; k < 3; k++) {
      const a = triangles[3 * t + k], b = triangles[3 * t + (k + 1) % 3], i = Math.min(a, b), j = Math.max(a, b);
      let slot = (Math.imul(i, 0x9e3779b1) ^ Math.imul(j, 0x85ebca6b)) >>> 0;
      for (slot &= size - 1; first[slot] >= 0 && (low[slot] !== i || high[slot] !== j); slot = (slot + 1) & (size - 1));
      const s = first[slot];
      if (s < 0) {
        first[slot] = t; low[slot] = i; high[slot] = j; state[slot] = 1;
      } else if (state[slot] !== 1 || !flat(s, t) || group[owner[s]] !== group[owner[t]] || (mesh && owner[s] !== owner[t])) state[slot] = 3;
      else state[slot] = 2;
    }
  }
  const out = [];
  for (let slot = 0; slot < size; slot++) if (first[slot] >= 0 && state[slot] !== 2) out.push(low[slot], high[slot]);
  return Uint32Array.from(out);
}

// Faces with few of the nodes, to be drawn while a large model moves: the nodes of a cubic cell become the one nearest to
// their mean (Rossignac, Borrel 1993), faces that collapse go. Cells are made larger until at most `most` are taken.
export function thinned({ points, triangles, face_element: owner }, most) {
  const count = points.length / 3, { low, high } = boxOf(points), cell = new Uint32Array(count);
  let taken = Infinity;
  for (let side = Math.max(...high.map((h, c) => h - low[c])) / 160 || 1; taken > most; side *= 1.3) {
    const seen = new Map(), [nx, ny] = [0, 1].map((c) => Math.floor((high[c] - low[c]) / side) + 1);
    for (let k = 0; k < count; k++) {
      const [i, j, l] = [0, 1, 2].map((c) => Math.floor((points[3 * k + c] - low[c]) / side)), key = (l * ny + j) * nx + i;
      let at = seen.get(key);
      if (at === undefined) seen.set(key, at = seen.size);
      cell[k] = at;
    }
    taken = seen.size;
  }
  const mean = new Float64Array(4 * taken), best = new Uint32Array(taken), least = new Float64Array(taken).fill(Infinity);
  for (let k = 0; k < count; k++) {
    for (let c = 0; c < 3; c++) mean[4 * cell[k] + c] += points[3 * k + c];
    mean[4 * cell[k] + 3]++;
  }
  for (let k = 0; k < count; k++) {
    const m = 4 * cell[k], d = [0, 1, 2].reduce((sum, c) => sum + (points[3 * k + c] - mean[m + c] / mean[m + 3]) ** 2, 0);
    if (d < least[cell[k]]) { least[cell[k]] = d; best[cell[k]] = k; }
  }
  const out = [], of = [];
  for (let t = 0; t < owner.length; t++) {
    const [a, b, c] = [cell[triangles[3 * t]], cell[triangles[3 * t + 1]], cell[triangles[3 * t + 2]]];
    if (a === b || b === c || a === c) continue;
    out.push(best[a], best[b], best[c]);
    of.push(owner[t]);
  }
  return { triangles: Uint32Array.from(out), owner: Uint32Array.from(of) };
}

function unitNormal(points, triangles, t, out) {
  const a = 3 * triangles[3 * t], b = 3 * triangles[3 * t + 1], c = 3 * triangles[3 * t + 2];
  const ux = points[b] - points[a], uy = points[b + 1] - points[a + 1], uz = points[b + 2] - points[a + 2];
  const vx = points[c] - points[a], vy = points[c + 1] - points[a + 1], vz = points[c + 2] - points[a + 2];
  const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx, size = Math.hypot(x, y, z) || 1;
  out[3 * t] = x / size;
  out[3 * t + 1] = y / size;
  out[3 * t + 2] = z / size;
}

// Corners of the box around points (n, 3), of those in `some` where it is given.
export function boxOf(points, some = null) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  const count = some ? some.length : points.length / 3;
  for (let k = 0; k < count; k++) for (let c = 0; c < 3; c++) {
    const v = points[3 * (some ? some[k] : k) + c];
    if (v < low[c]) low[c] = v;
    if (v > high[c]) high[c] = v;
  }
  return { low, high };
}

export const OBLIQUE = { az: -1.05, el: 0.42 };

// The camera: a turntable with z upward, orthographic. Matrices of a view of `size` (half the diagonal of what is drawn).
export function matrices({ at, az, el, zoom, pan }, size, aspect) {
  const ca = Math.cos(az), sa = Math.sin(az), ce = Math.cos(el), se = Math.sin(el);
  const right = [-sa, ca, 0], up = [-se * ca, -se * sa, ce], out = [ce * ca, ce * sa, se];
  const dot = (v) => v[0] * at[0] + v[1] * at[1] + v[2] * at[2];
  const sx = zoom / size / Math.max(aspect, 1), sy = sx * aspect, depth = 4 * size;
  const turn = [right[0], up[0], out[0], 0, right[1], up[1], out[1], 0, right[2], up[2], out[2], 0, 0, 0, 0, 1];
  const matrix = [0, 1, 2].flatMap((k) => [sx * right[k], sy * up[k], -out[k] / depth, 0]);
  return { turn, matrix: [...matrix, pan[0] - sx * dot(right), pan[1] - sy * dot(up), dot(out) / depth, 1] };
}

// Zoom that fills the canvas whatever its aspect, from the box seen obliquely.
export function fittingZoom({ low, high }, at, size, aspect) {
  const { matrix } = matrices({ ...OBLIQUE, at, zoom: 1, pan: [0, 0] }, size, aspect);
  let most = 0;
  for (let k = 0; k < 8; k++) {
    const p = [0, 1, 2].map((c) => (k >> c & 1 ? high[c] : low[c]));
    for (const c of [0, 1]) most = Math.max(most, Math.abs(matrix[c] * p[0] + matrix[4 + c] * p[1] + matrix[8 + c] * p[2] + matrix[12 + c]));
  }
  return 0.66 / (most || 1);
}
