// The pointer over a view: turn, move, zoom, and find what lies under it in a picture of ids.
import { ENDS, STROKES } from "./geometry.js";

const REACH = 5; // px around the pointer in which something thin is found
const NODE = 12; // px within which a node is meant
const CLICK = 4; // px that a click may move
const CALM = 60; // ms that the pointer rests before what lies under it is sought

export class Pointer {
  constructor(view) {
    Object.assign(this, { view, touches: new Map(), apart: 0, kinds: view.options.pick || ["element", "sensor", "point"] });
    const { canvas } = view, off = [];
    const on = (name, f, how) => { canvas.addEventListener(name, f, how); off.push(() => canvas.removeEventListener(name, f, how)); };
    on("pointerdown", (e) => this.down(e));
    on("pointermove", (e) => this.move(e));
    on("pointerup", (e) => this.up(e));
    for (const name of ["pointercancel", "lostpointercapture"]) on(name, (e) => this.cancel(e));
    on("pointerleave", () => { clearTimeout(this.waiting); this.hover(null); });
    on("contextmenu", (e) => e.preventDefault());
    on("dblclick", (e) => { const found = this.find(...this.at(e)); view.fly(found && found.kind === "element" ? { element: [found.id] } : null); });
    on("wheel", (e) => this.wheel(e), { passive: false });
    on("keydown", (e) => this.key(e));
    this.off = off;
  }

  at(e) {
    const r = this.view.canvas.getBoundingClientRect();
    return [e.clientX - r.left, e.clientY - r.top];
  }

  // ------------------------------------------------------------------ turn, move, zoom
  down(e) {
    const { view, touches } = this, at = this.at(e);
    touches.set(e.pointerId, [e.clientX, e.clientY]);
    view.canvas.setPointerCapture(e.pointerId);
    view.canvas.focus({ preventScroll: true });
    this.hover(null);
    this.start = touches.size === 1 ? at : null;
    this.what = "turn";
    if (e.shiftKey || e.button > 0) this.what = "move";
    if (e.ctrlKey || e.metaKey) this.what = "box";
    const found = this.what === "turn" && view.options.drag && view.arrows ? this.find(...at) : null;
    if (found && found.kind === "sensor") Object.assign(this, { what: "drag", held: found, place: view.sensing.points.slice() });
  }

  move(e) {
    const { view, touches, what } = this, old = touches.get(e.pointerId), at = this.at(e);
    if (!old) {
      clearTimeout(this.waiting);
      this.waiting = setTimeout(() => this.hover(this.find(...at), at), CALM);
      return;
    }
    if (this.start && Math.hypot(at[0] - this.start[0], at[1] - this.start[1]) < CLICK) return;
    const dx = e.clientX - old[0], dy = e.clientY - old[1], { clientWidth: w, clientHeight: h } = view.canvas;
    touches.set(e.pointerId, [e.clientX, e.clientY]);
    this.start = touches.size === 1 && (what === "box" || what === "drag") ? this.start : null;
    if (touches.size > 1) this.pinch();
    else if (what === "box") return this.frame(at);
    else if (what === "drag") return this.drag(at);
    else if (what === "move") { view.camera.pan[0] += 2 * dx / w; view.camera.pan[1] -= 2 * dy / h; }
    else this.turn(-dx * 0.008, dy * 0.008);
    view.turned();
  }

  up(e) {
    const { view, what, start } = this, at = this.at(e);
    if (!this.touches.has(e.pointerId)) return;
    this.cancel(e);
    if (what === "box" && this.rubber) this.boxed(start, at);
    else if (what === "drag" && this.node !== undefined) this.dropped();
    else if (start) {
      const found = this.find(...at);
      view.tell(e.button === 2 ? "menu" : "pick", found && { ...found, shift: e.shiftKey, ctrl: e.ctrlKey || e.metaKey, x: at[0], y: at[1] });
    }
  }

  cancel(e) {
    this.touches.delete(e.pointerId);
    this.apart = 0;
  }

  turn(az, el) {
    const { camera } = this.view;
    camera.az += az;
    camera.el = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, camera.el + el));
  }

  pinch() {
    const [a, b] = [...this.touches.values()], now = Math.hypot(a[0] - b[0], a[1] - b[1]);
    if (this.apart) this.zoom(now / this.apart);
    this.apart = now;
  }

  // What lies under a point of the stage (-1 to 1) stays there.
  zoom(factor, [x, y] = [0, 0]) {
    const { camera } = this.view, zoom = Math.min(2000, Math.max(0.2, camera.zoom * factor)), s = zoom / camera.zoom;
    camera.zoom = zoom;
    camera.pan = [x + s * (camera.pan[0] - x), y + s * (camera.pan[1] - y)];
  }

  // In a page the wheel scrolls until the view was clicked.
  wheel(e) {
    const { view } = this, { clientWidth: w, clientHeight: h } = view.canvas;
    if (view.options.wheel !== "always" && document.activeElement !== view.canvas && !e.ctrlKey) return;
    e.preventDefault();
    const [x, y] = this.at(e);
    this.zoom(Math.exp(-e.deltaY * 0.0012), [2 * x / w - 1, 1 - 2 * y / h]);
    view.turned();
  }

  key(e) {
    const { view } = this, turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[e.key];
    const zoom = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 }[e.key];
    if (e.key === " " && view.moves) { if (view.clock.playing) view.pause(); else view.play(); }
    else if (turn) this.turn(...turn);
    else if (zoom) this.zoom(zoom);
    else if (e.key === "f") view.fly(view.state.select);
    else return;
    e.preventDefault();
    view.turned();
  }

  // ------------------------------------------------------------------ what lies under the pointer
  // Ids (kind and position) in a rectangle of the stage, row by row from its lower edge.
  read(x, y, w, h, sensors = true) {
    const { view } = this, { gl } = view.ctx, out = new Uint8Array(4 * w * h);
    gl.bindFramebuffer(gl.FRAMEBUFFER, view.paintIds(sensors));
    gl.readPixels(x, view.stage.clientHeight - y - h, w, h, gl.RGBA, gl.UNSIGNED_BYTE, out);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return out;
  }

  // The nearest id within reach: [kind, position], null where there is none.
  nearest(x, y, sensors = true) {
    const side = 2 * REACH + 1, bytes = this.read(Math.round(x) - REACH, Math.round(y) - REACH, side, side, sensors);
    let best = null, least = Infinity;
    for (let k = 0; k < side * side; k++) {
      const far = (k % side - REACH) ** 2 + (Math.floor(k / side) - REACH) ** 2;
      if (bytes[4 * k + 3] && far < least && far <= REACH ** 2) { least = far; best = [bytes[4 * k + 3], idOf(bytes, k)]; }
    }
    return best;
  }

  // {kind, id, group, ...} at a place of the stage.
  find(x, y) {
    const { view, kinds } = this;
    if (!view.drawn) return null;
    const found = this.nearest(x, y);
    if (!found) return null;
    const [kind, k] = found, has = (name) => kinds.includes(name);
    if (kind === 5) return has("sensor") ? this.sensor(Math.floor(k / STROKES)) : null;
    if (kind === 4) return has("point") ? { kind: "point", id: view.test.names[k], group: "" } : null;
    const e = this.element(kind, k), near = this.nodeNear(kind, k, x, y);
    const about = { ...e, node: view.model.node_id[near.node] };
    if (has("node") && (near.far < NODE || !has("element"))) return { ...about, kind: "node", id: about.node, element: e.id };
    return has("element") ? about : null;
  }

  sensor(k) {
    const { names, kinds } = this.view.sensing;
    return { kind: "sensor", id: names[k], group: kinds ? kinds[k] : "" };
  }

  // Elements of the model by kind of what was drawn (1 face, 2 line, 3 point) and its position.
  element(kind, k) {
    const { model, lineAt, pointAt } = this.view;
    const e = kind === 1 ? model.face_element[k] : model.line_element[(kind === 2 ? lineAt : pointAt)[k]];
    const out = { kind: "element", id: model.element_id[e], group: model.groups[model.group[e]] };
    for (const name of ["property", "material"]) if (model[name]) out[name] = model[name][e];
    return out;
  }

  corners(kind, k) {
    const { model, lineAt, pointAt } = this.view;
    if (kind === 1) return model.triangles.subarray(3 * k, 3 * k + 3);
    const l = (kind === 2 ? lineAt : pointAt)[k];
    return model.lines.subarray(2 * l, 2 * l + 2);
  }

  nodeNear(kind, k, x, y) {
    let best = { node: 0, far: Infinity };
    for (const node of this.corners(kind, k)) {
      const p = this.view.project(this.view.body, node), far = Math.hypot(p[0] - x, p[1] - y);
      if (far < best.far) best = { node, far };
    }
    return best;
  }

  hover(found, at) {
    const { view } = this, same = (a, b) => (a && b ? a.kind === b.kind && a.id === b.id : a === b);
    if (same(found, view.hovered || null)) return;
    view.hovered = found;
    view.tip.style.display = found && view.options.tips !== false ? "block" : "none";
    if (found) {
      view.tip.textContent = described(found);
      Object.assign(view.tip.style, { left: `${at[0] + 12}px`, top: `${at[1] - 26}px` });
    }
    if (view.body) this.outline(found);
    view.tell("hover", found);
    view.draw();
  }

  // Edges of the element or the node under the pointer.
  outline(found) {
    const { view } = this, { model, body } = view, pairs = [], nodes = [];
    if (found && found.kind === "element") {
      const e = this.position(found.id);
      for (const t of e.faces) for (let k = 0; k < 3; k++) pairs.push(model.triangles[3 * t + k], model.triangles[3 * t + (k + 1) % 3]);
      for (const l of e.lines) pairs.push(model.lines[2 * l], model.lines[2 * l + 1]);
    }
    if (found && found.kind === "node") for (const k of view.nodesAt([found.id])) nodes.push(k, k);
    const owner = (list) => new Uint32Array(list.length / 2).fill(view.anyShown());
    body.strip("hover line", "line", Uint32Array.from(once(pairs)), owner(once(pairs)));
    body.strip("hover point", "point", Uint32Array.from(nodes), owner(nodes));
  }

  // Faces and lines of an element.
  position(id) {
    const { model } = this.view, e = model.element_id.indexOf(id), of = (owner) => {
      const out = [];
      for (let k = owner.indexOf(e); k >= 0; k = owner.indexOf(e, k + 1)) out.push(k);
      return out;
    };
    return { faces: of(model.face_element), lines: of(model.line_element) };
  }

  // ------------------------------------------------------------------ rectangle
  frame([x, y]) {
    const [a, b] = this.start, { stage } = this.view;
    this.rubber ||= stage.appendChild(Object.assign(document.createElement("div"), { className: "rubber" }));
    const side = (u, v) => [Math.min(u, v), Math.abs(u - v)], [left, width] = side(a, x), [top, height] = side(b, y);
    for (const [name, v] of Object.entries({ left, width, top, height })) this.rubber.style[name] = `${v}px`;
  }

  // What is seen inside: elements by the picture of ids, nodes of these and sensors by their place.
  boxed([a, b], [c, d]) {
    this.rubber.remove();
    this.rubber = null;
    const { view } = this, { clientWidth: w, clientHeight: h } = view.stage, clamp = (v, most) => Math.round(Math.min(Math.max(v, 0), most));
    const [x, X, y, Y] = [clamp(Math.min(a, c), w), clamp(Math.max(a, c), w), clamp(Math.min(b, d), h), clamp(Math.max(b, d), h)];
    if (X <= x || Y <= y) return;
    const bytes = this.read(x, y, X - x, Y - y), keys = new Set(), elements = new Set(), nodes = new Set(), points = new Set();
    const u32 = new Uint32Array(bytes.buffer);
    let last = 0;
    for (const v of u32) if (v !== last) { keys.add(v); last = v; }
    const inside = (body, k) => { const p = view.project(body, k); return p[0] >= x && p[0] <= X && p[1] >= y && p[1] <= Y; };
    for (const key of keys) {
      const kind = key >>> 24, k = (key & 0xffffff) - 1;
      if (kind === 4) points.add(view.test.names[k]);
      if (kind < 1 || kind > 3) continue;
      elements.add(this.element(kind, k).id);
      for (const n of this.corners(kind, k)) if (inside(view.body, n)) nodes.add(view.model.node_id[n]);
    }
    const names = view.arrows && view.state.sensor ? view.sensing.names : [];
    view.tell("box", { element: [...elements], node: [...nodes], point: [...points], sensor: names.filter((_, k) => inside(view.arrows, ENDS * k)) });
  }

  // ------------------------------------------------------------------ a sensor on its way to a node
  drag([x, y]) {
    const { view } = this, found = view.body ? this.nearest(x, y, false) : null, k = view.sensorAt.get(this.held.id), points = this.place.slice();
    this.node = undefined;
    if (found && found[0] < 4) {
      this.node = this.nodeNear(...found, x, y).node;
      points.set(view.model.points.subarray(3 * this.node, 3 * this.node + 3), 3 * k);
    }
    view.sensing.points = points;
    view.arrows.place(view.arrowEnds(points));
    view.tip.style.display = this.node === undefined ? "none" : "block";
    if (this.node !== undefined) view.tip.textContent = `${this.held.id} at node ${view.model.node_id[this.node]}`;
    Object.assign(view.tip.style, { left: `${x + 12}px`, top: `${y - 26}px` });
    view.draw();
  }

  dropped() {
    const { view, node } = this, point = Array.from(view.model.points.subarray(3 * node, 3 * node + 3));
    this.node = undefined;
    view.tip.style.display = "none";
    view.tell("drag", { kind: "sensor", id: this.held.id, node: view.model.node_id[node], point });
  }

  destroy() {
    clearTimeout(this.waiting);
    for (const f of this.off) f();
  }
}

const idOf = (bytes, k) => (bytes[4 * k] | bytes[4 * k + 1] << 8 | bytes[4 * k + 2] << 16) - 1;

function described({ kind, id, group, element, property, material }) {
  if (kind === "point") return `point ${id}`;
  if (kind === "sensor") return `${id}${group ? `, ${group}` : ""}`;
  const parts = [`${kind} ${id}`, element !== undefined && `element ${element}`, group, property !== undefined && group !== `property ${property}` && `property ${property}`];
  return [...parts, material && `material ${material}`].filter(Boolean).join(", ");
}

// Pairs that occur once: what two triangles of an element share is no edge of it.
function once(pairs) {
  const seen = new Map();
  for (let k = 0; k < pairs.length; k += 2) {
    const key = `${Math.min(pairs[k], pairs[k + 1])} ${Math.max(pairs[k], pairs[k + 1])}`;
    seen.set(key, seen.has(key) ? null : [pairs[k], pairs[k + 1]]);
  }
  return [...seen.values()].filter(Boolean).flat();
}
