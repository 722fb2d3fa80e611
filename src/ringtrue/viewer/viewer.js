// The one 3D viewer: in reports, in notebooks, in the studio.
//
//   const view = mount(element, scene, options)
//
// scene     what is drawn. Arrays are typed arrays, or as `decode` and `unpack` of geometry.js read them.
//   model     points (n, 3) f4, node_id (n,) u4, triangles (t, 3) u4, face_element (t,) u4: position in the elements below,
//             lines (l, 2) u4 (equal ends: a spring without length, a point), line_element (l,) u4;
//             of each element: element_id u4, group u2: position in `groups`, and where known property u4, material u4
//   test      points (p, 3) f4, lines (l, 2) u4, names: a text a point
//   sensors   points (s, 3) f4, directions (s, 3) f4, names, colors: "#rrggbb" each, kinds: a text each (optional)
// options   theme "light" | "dark", controls true: buttons of directions, wheel "focus" (after a click) | "always",
//           pick: kinds of ["element", "node", "sensor", "point"] that are found under the pointer, drag false: sensors can be
//           moved to nodes, tips true, clock: a `Clock` that several views share
//
// view.shapes(name, shape, on = "model")  keeps a shape: Float32Array (n, 3), {real, imag} of such, or {peak, real, imag}
//                          with Int16Array parts of the peak; `on`: "model" or "test"
// view.field(name, field)  keeps a field that colours: {values: Float32Array, of: "node" | "element", ids: u4 numbers of
//                          these (all of the scene in its order without), unit, range: [low, high], signed}
// view.sensors(sensors)    puts other sensors in place of those of the scene
// view.show(state)         changes what it names:
//   mode      name of a shape of the model, null: at rest      test      name of a shape, true: moves with the model, false: hidden
//   model     true | false | "ghost": edges alone              still     true: the edges at rest, too
//   sensor    true | false                                     edges     "feature" | "mesh" | "none"
//   color     "group" | "property" | "material" | "plain" | "displacement"     field   name of a field, null
//   colors, alpha   of each group                              amplitude 1, and phase in radians (stops the clock)
//   hide, isolate, select   {element, property, material: numbers, group: names}, null; of `select` node and sensor, too
//   labels    {node: numbers, sensor: names, point: names}, null           clip   {normal, offset}: what lies beyond is cut off
//   camera    {at, az, el, zoom, pan}                          theme     "light" | "dark"
// view.on(event, f)        "pick", "hover", "menu" (right button) with {kind, id, group, ...} or null; "box" (drag with Ctrl) with
//                          {element, node, sensor, point: ids}; "drag" with {kind: "sensor", id, node, point}; "camera" with the
//                          camera. Returns what ends it.
// view.fly(selection)      moves the camera to what is named; to all without an argument
// view.snapshot()          a promise of a PNG
// view.destroy()
import { Body, context } from "./gpu.js";
import { ENDS, OBLIQUE, STROKES, boxOf, decode, edgesOf, fittingZoom, rgb } from "./geometry.js";
import { Clock } from "./clock.js";
import { extremes, make, nearestTo, quantised, save } from "./parts.js";
import { Picture, THEMES } from "./picture.js";
import { Pointer } from "./pointer.js";

export const PALETTE = ["#9fb4c7", "#d8b98a", "#a9c3a1", "#c9a7b8", "#d9cf9c", "#a7cbd6", "#b8a692", "#b9c0c8"];
const REST = {
  mode: null, test: true, model: true, sensor: true, still: false, edges: "feature", color: "group", field: null, colors: null, alpha: null,
  amplitude: 1, hide: null, isolate: null, select: null, labels: null, clip: null, theme: "light",
};
export const views = new Set();

// Draws a scene into an element of the page; see the head of this file.
export function mount(element, scene, options = {}) { return new View(element, scene, options); }

class View extends Picture {
  constructor(element, scene, options) {
    super();
    Object.assign(this, { element, options, listeners: {}, kept: { model: new Map(), test: new Map() }, fields: new Map(), coarse: 0, endings: [] });
    this.state = { ...REST, theme: options.theme || "light" };
    this.ctx = context();
    this.clock = options.clock || new Clock();
    this.build();
    this.read(decode(scene));
    this.home();
    views.add(this);
    if (!this.ctx) return;
    this.ctx.lost = () => { for (const view of views) view.info.textContent = "The graphics card was lost: load the page again."; };
    this.bodies();
    this.pointer = new Pointer(this);
    this.endings.push(this.clock.on(() => this.visible !== false && this.moves && this.draw()));
    const seen = new IntersectionObserver(([e]) => { this.visible = e.isIntersecting; if (this.visible) this.draw(); });
    const sized = new ResizeObserver(() => this.draw());
    seen.observe(element);
    sized.observe(this.stage);
    this.endings.push(() => seen.disconnect(), () => sized.disconnect());
    this.show({});
  }

  build() {
    const { options } = this;
    this.element.classList.add("view");
    this.canvas = make("canvas", { tabIndex: 0, ariaLabel: "3D view: drag to turn, Shift and drag to move, wheel to zoom, Ctrl and drag to select" });
    this.tip = make("div", { className: "tip" });
    this.info = make("div", { className: "info" });
    this.marks = make("div", { className: "marks" });
    this.scale = make("div", { className: "scale" });
    this.stage = make("div", { className: "stage" }, this.canvas, this.marks, this.scale, this.tip, this.info);
    if (options.controls !== false) this.stage.append(this.directions());
    this.element.append(this.stage);
    if (!this.ctx) this.info.textContent = "3D figures need WebGL 2, which this browser does not offer.";
  }

  directions() {
    const box = make("div", { className: "directions" });
    const button = (textContent, title, onclick) => box.append(make("button", { type: "button", textContent, title, onclick }));
    for (const [name, az, el] of [["3D", OBLIQUE.az, OBLIQUE.el], ["X", 0, 0], ["Y", -Math.PI / 2, 0], ["Z", -Math.PI / 2, Math.PI / 2]]) {
      button(name, name === "3D" ? "Oblique view" : `View along ${name}`, () => { this.home({ az, el }); this.turned(); });
    }
    button("PNG", "Save the picture", async () => save(this.element, "png", await this.snapshot()));
    return box;
  }

  read({ model, test, sensors }) {
    Object.assign(this, { model, test, sensing: sensors });
    const placed = [model, test, sensors].filter((part) => part && part.points.length);
    const boxes = placed.map((part) => boxOf(part.points));
    const extreme = (f, side) => [0, 1, 2].map((c) => f(...boxes.map((b) => b[side][c])));
    this.box = boxes.length ? { low: extreme(Math.min, "low"), high: extreme(Math.max, "high") } : { low: [0, 0, 0], high: [1, 1, 1] };
    const { low, high } = this.box;
    this.size = Math.hypot(...high.map((h, c) => h - low[c])) / 2 || 1;
  }

  // The whole model from a direction.
  home({ az, el } = OBLIQUE) {
    const { low, high } = this.box;
    this.camera = { at: low.map((l, c) => (l + high[c]) / 2), az, el, zoom: 1.35, pan: [0, 0] };
  }

  // ------------------------------------------------------------------ what is drawn
  bodies() {
    const { model, test } = this;
    if (model) {
      this.body = new Body(this.ctx, model.points, model.element_id.length);
      this.body.strip("faces", "mesh", model.triangles, model.face_element);
      const joint = (k) => model.lines[2 * k] === model.lines[2 * k + 1];
      const some = (keep) => Uint32Array.from(model.line_element.keys()).filter(keep);
      this.lineAt = some((k) => !joint(k));
      this.pointAt = some(joint);
      for (const [name, kind, at] of [["lines", "line", this.lineAt], ["points", "point", this.pointAt]]) {
        const ends = Uint32Array.from({ length: 2 * at.length }, (_, k) => model.lines[2 * at[k >> 1] + (k & 1)]);
        this.body.strip(name, kind, ends, Uint32Array.from(at, (k) => model.line_element[k]));
      }
    }
    if (test) {
      const n = test.points.length / 3, own = (count) => new Uint32Array(count);
      for (const name of ["wire", "rest"]) {
        this[name] = new Body(this.ctx, test.points, 1);
        this[name].strip("lines", "line", test.lines, own(test.lines.length / 2));
        this[name].strip("points", "point", Uint32Array.from({ length: 2 * n }, (_, k) => k >> 1), own(n));
      }
    }
    if (this.sensing) this.sensors(this.sensing);
  }

  sensors(sensors) {
    this.sensing = decode(sensors);
    if (this.arrows) this.arrows.destroy();
    this.arrows = null;
    const { points, names, colors } = this.sensing, n = points.length / 3;
    if (!n || !this.ctx) return this.draw();
    this.sensorAt = new Map(names.map((name, k) => [name, k]));
    const index = new Uint32Array(2 * STROKES * n);
    for (let k = 0; k < n; k++) index.set([0, 1, 1, 2, 1, 3, 1, 4, 1, 5].map((v) => ENDS * k + v), 2 * STROKES * k);
    this.arrows = new Body(this.ctx, this.arrowEnds(points), n);
    this.arrows.strip("lines", "line", index, Uint32Array.from({ length: STROKES * n }, (_, k) => Math.floor(k / STROKES)));
    this.arrowColors = Uint8Array.from(colors.flatMap((c) => [...rgb(c).map((v) => 255 * v), 255]));
    this.paintSelection();
    this.draw();
  }

  // Foot, tip and the four ends of the head of each arrow.
  arrowEnds(points) {
    const { directions } = this.sensing, long = 0.055 * this.size, out = new Float32Array(ENDS * points.length);
    for (let k = 0; k < points.length; k += 3) {
      const d = directions.subarray(k, k + 3), side = Math.abs(d[2]) > 0.7 ? [1, 0, 0] : [0, 0, 1];
      const other = [d[1] * side[2] - d[2] * side[1], d[2] * side[0] - d[0] * side[2], d[0] * side[1] - d[1] * side[0]];
      for (let c = 0; c < 3; c++) {
        const foot = points[k + c], head = foot + 0.68 * long * d[c], u = 0.16 * long * side[c], v = 0.16 * long * other[c];
        [foot, foot + long * d[c], head + u, head - u, head + v, head - v].forEach((x, e) => { out[ENDS * k + 3 * e + c] = x; });
      }
    }
    return out;
  }

  shapes(name, shape, on = "model") { this.kept[on].set(name, quantised(decode(shape))); }

  field(name, field) {
    this.fields.set(name, decode(field));
    if (this.state.field === name) this.show({ field: name });
  }

  // ------------------------------------------------------------------ state
  show(change) {
    const { state } = this, changed = (...names) => names.some((n) => n in change);
    const { camera, phase, ...rest } = change;
    Object.assign(state, rest);
    if (camera) Object.assign(this.camera, camera);
    if (phase !== undefined && phase !== null) this.clock.set(phase);
    this.element.classList.toggle("dark", state.theme === "dark");
    if (!this.ctx) return;
    const first = !this.ready;
    this.ready = true;
    if (this.body) {
      if (first || changed("hide", "isolate")) this.hidden();
      if (first || changed("hide", "isolate", "edges", "model")) this.edges();
      if (first || changed("hide", "isolate", "color", "colors", "alpha", "select", "theme")) this.paintElements();
      if (first || changed("field", "color")) this.shade();
    }
    if (first || changed("select", "theme")) this.paintSelection();
    if (first || changed("mode", "test")) this.move();
    if (first || changed("labels", "select")) this.labels();
    this.draw();
  }

  // Elements (e,) that a selection names, 1 where it does.
  mask(selection) {
    const { model } = this, out = new Uint8Array(model.element_id.length);
    const tell = (values, wanted) => {
      const set = new Set(wanted);
      for (let e = 0; e < out.length; e++) if (set.has(values[e])) out[e] = 1;
    };
    const { element, property, material, group } = selection;
    if (element) tell(model.element_id, element);
    if (property && model.property) tell(model.property, property);
    if (material && model.material) tell(model.material, material);
    if (group) tell(model.group, group.map((name) => model.groups.indexOf(name)));
    return out;
  }

  hidden() {
    const { hide, isolate } = this.state, count = this.model.element_id.length;
    this.shown = isolate ? this.mask(isolate) : new Uint8Array(count).fill(1);
    if (hide) this.mask(hide).forEach((h, e) => { if (h) this.shown[e] = 0; });
  }

  edges() {
    const wanted = this.state.edges !== "none" && this.state.model;
    const pairs = wanted ? edgesOf(this.model, this.shown, this.state.edges === "mesh") : new Uint32Array(0);
    // they are made of visible faces alone: their owner is any that is not hidden
    const owner = Math.max(this.shown.indexOf(1), 0);
    this.body.strip("edges", "line", pairs, new Uint32Array(pairs.length / 2).fill(owner));
  }

  colorOf() {
    const { state, model } = this, plain = rgb(THEMES[state.theme].plain);
    if (state.color === "plain" || state.color === "displacement") return () => plain;
    const values = state.color === "group" ? model.group : model[state.color] || model.group;
    if (state.color === "group" && state.colors) {
      const given = state.colors.map((c) => (c ? rgb(c) : plain));
      return (e) => given[values[e]];
    }
    const order = new Map([...new Set(values)].sort((a, b) => a - b).map((v, k) => [v, rgb(PALETTE[k % PALETTE.length])]));
    return (e) => order.get(values[e]);
  }

  paintElements() {
    const { state, model, shown } = this, { select, alpha } = state, out = new Uint8Array(4 * shown.length), color = this.colorOf();
    const chosen = select && this.mask(select), mark = rgb(THEMES[state.theme].select);
    this.clear = false; // whether something is seen through
    for (let e = 0; e < shown.length; e++) {
      const c = chosen && chosen[e] ? mark : color(e), a = alpha && !(chosen && chosen[e]) ? alpha[model.group[e]] : 1;
      if (a < 1 && shown[e]) this.clear = true;
      for (let k = 0; k < 3; k++) out[4 * e + k] = 255 * c[k];
      out[4 * e + 3] = shown[e] ? Math.max(1, 255 * a) : 0;
    }
    this.body.paint(out);
    this.painted = out;
  }

  // Chosen sensors and nodes.
  paintSelection() {
    const { select, theme } = this.state, mark = rgb(THEMES[theme].select).map((v) => 255 * v);
    if (this.arrows) {
      const colors = this.arrowColors.slice();
      for (const name of (select && select.sensor) || []) if (this.sensorAt.has(name)) colors.set(mark, 4 * this.sensorAt.get(name));
      this.arrows.paint(colors);
    }
    if (!this.body) return;
    const at = this.nodesAt((select && select.node) || []);
    this.body.strip("chosen", "point", Uint32Array.from(at.flatMap((k) => [k, k])), new Uint32Array(at.length).fill(this.anyShown()));
  }

  anyShown() { return this.shown ? Math.max(this.shown.indexOf(1), 0) : 0; }

  // Positions of node numbers.
  nodesAt(ids) {
    if (!this.nodeAt) this.nodeAt = new Map(Array.from(this.model.node_id, (id, k) => [id, k]));
    return ids.map((id) => this.nodeAt.get(id)).filter((k) => k !== undefined);
  }

  shade() {
    const { state } = this, field = state.field !== null && this.fields.get(state.field);
    this.scale.replaceChildren();
    if (!field) {
      this.look = { shade: state.color === "displacement" ? 1 : 0 };
      return this.body.color(null);
    }
    const values = this.spread(field), range = field.range || extremes(values), signed = field.signed ?? (range[0] < 0 && range[1] > 0);
    const wide = signed && !field.range ? [-1, 1].map((s) => s * Math.max(-range[0], range[1])) : range;
    this.body.color(values);
    this.look = { shade: field.of === "element" ? 3 : 2, signed, range: wide[0] < wide[1] ? wide : [wide[0] - 0.5, wide[0] + 0.5] };
    const number = (v) => String(+v.toPrecision(3)).replace("-", "−");
    const title = field.unit ? `${state.field}, ${field.unit}` : state.field;
    this.scale.append(make("b", { textContent: title }), make("span", { textContent: number(wide[0]) }),
      make("i", { className: signed ? "ramp signed" : "ramp" }), make("span", { textContent: number(wide[1]) }));
  }

  // The values of a field in the order of the scene; NaN where it has none.
  spread({ values, of, ids }) {
    if (!ids) return values;
    const at = new Map(Array.from(ids, (id, k) => [id, k]));
    return Float32Array.from(of === "element" ? this.model.element_id : this.model.node_id, (id) => (at.has(id) ? values[at.get(id)] : NaN));
  }

  // ------------------------------------------------------------------ motion
  move() {
    const { mode, test } = this.state, { kept } = this;
    const fe = (mode !== null && kept.model.get(mode)) || null;
    const rest = (mode !== null && kept.test.get(`${mode} at test`)) || null;
    const own = (typeof test === "string" && kept.test.get(test)) || null;
    const peaks = [fe, rest, own].filter(Boolean).map((s) => s.peak);
    this.moves = peaks.length > 0;
    const unit = this.moves ? Math.min(Math.max(...peaks), 1.6 * peaks[0]) : 1; // a runaway sensor does not shrink the rest
    const scaled = (shape) => shape && { ...shape, step: shape.peak / 32767 / unit };
    if (this.body) this.body.move(scaled(fe));
    if (!this.wire) return;
    this.wire.move(scaled(own || (fe && this.body && this.withModel(fe))));
    this.rest.move(scaled(rest));
    this.wired = Boolean(rest);
  }

  // Where the test has no such mode its points move as the nearest node of the model.
  withModel(shape) {
    const from = this.model.points, to = this.test.points, n = to.length / 3;
    if (!this.nearest) this.nearest = Uint32Array.from({ length: n }, (_, p) => nearestTo(from, to.subarray(3 * p, 3 * p + 3)));
    const gathered = (values) => values && Int16Array.from({ length: 3 * n }, (_, k) => values[3 * this.nearest[Math.floor(k / 3)] + k % 3]);
    return { peak: shape.peak, real: gathered(shape.real), imag: gathered(shape.imag) };
  }

  play() { this.clock.play(); }
  pause() { this.clock.pause(); }

  // ------------------------------------------------------------------ labels
  labels() {
    const { labels } = this.state, out = [];
    if (labels && this.body) for (const id of labels.node || []) for (const k of this.nodesAt([id])) out.push([this.body, k, String(id)]);
    if (labels && this.arrows) for (const n of labels.sensor || []) if (this.sensorAt.has(n)) out.push([this.arrows, ENDS * this.sensorAt.get(n) + 1, n]);
    if (labels && this.wire) for (const n of labels.point || []) if (this.test.names.includes(n)) out.push([this.wire, this.test.names.indexOf(n), n]);
    this.marked = out.map(([body, k, textContent]) => [body, k, make("span", { textContent })]);
    this.marks.replaceChildren(...this.marked.map(([, , e]) => e));
  }

  placeMarks() {
    for (const [body, k, e] of this.marked || []) {
      const [x, y] = this.project(body, k);
      e.style.transform = `translate(${Math.round(x) + 7}px, ${Math.round(y) - 9}px)`;
    }
  }

  // ------------------------------------------------------------------ camera and events
  turned() {
    this.draw(true);
    this.tell("camera", { ...this.camera });
  }

  fly(selection = null) {
    const to = selection ? this.around(selection) : null, from = { ...this.camera }, begin = performance.now();
    if (selection && !to) return;
    if (!to) this.home(from);
    const aim = to || this.camera, calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const step = (t) => {
      const s = calm ? 1 : Math.min(Math.max((t - begin) / 350, 0), 1), u = s * s * (3 - 2 * s), mix = (a, b) => a + u * (b - a);
      this.camera = {
        ...from, at: from.at.map((v, c) => mix(v, aim.at[c])), pan: from.pan.map((v) => mix(v, 0)),
        zoom: Math.exp(mix(Math.log(from.zoom), Math.log(aim.zoom))),
      };
      this.turned();
      if (s < 1 && !this.gone) requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  // Centre and zoom of what a selection names, null where it names nothing.
  around(selection) {
    const { model } = this, points = [];
    const add = (array, k) => points.push(array[3 * k], array[3 * k + 1], array[3 * k + 2]);
    if (model) {
      const mask = this.mask(selection);
      for (let t = 0; t < model.face_element.length; t++) if (mask[model.face_element[t]]) for (let k = 0; k < 3; k++) add(model.points, model.triangles[3 * t + k]);
      for (let l = 0; l < model.line_element.length; l++) if (mask[model.line_element[l]]) for (let k = 0; k < 2; k++) add(model.points, model.lines[2 * l + k]);
      for (const k of this.nodesAt(selection.node || [])) add(model.points, k);
    }
    for (const name of (this.arrows && selection.sensor) || []) if (this.sensorAt.has(name)) add(this.sensing.points, this.sensorAt.get(name));
    if (!points.length) return null;
    const { low, high } = boxOf(points), radius = Math.max(Math.hypot(...high.map((h, c) => h - low[c])) / 2, 0.03 * this.size);
    const fitted = fittingZoom(this.box, this.camera.at, this.size, this.stage.clientWidth / this.stage.clientHeight);
    return { at: low.map((l, c) => (l + high[c]) / 2), zoom: 0.7 * this.size / radius / fitted };
  }

  on(event, f) {
    (this.listeners[event] ||= new Set()).add(f);
    return () => this.listeners[event].delete(f);
  }

  tell(event, value) { for (const f of this.listeners[event] || []) f(value); }

  snapshot() {
    if (this.ctx) this.paint();
    return new Promise((done) => this.canvas.toBlob(done));
  }

  destroy() {
    this.gone = true;
    views.delete(this);
    clearTimeout(this.settling);
    for (const end of this.endings) end();
    if (this.pointer) this.pointer.destroy();
    for (const body of [this.body, this.wire, this.rest, this.arrows]) if (body) body.destroy();
    this.element.replaceChildren();
  }
}
