// A view with its controls and its legend, as reports, pages of results and notebooks have it.
//
//   figure(element, data)    data: {scene, colors, alpha, legend: [{name, color, note}], modes: [{stage, label, info, fe, wire, test}]},
//                            of a mode the shape of the model, that of the model at the points of the test, that of the test
import { Clock } from "./clock.js";
import { decode } from "./geometry.js";
import { make, save } from "./parts.js";
import { mount, views } from "./viewer.js";

const TEST_COLOR = "#d55e00";

export function figure(element, data, options = {}) { return new Figure(element, decode(data), options); }

class Figure {
  constructor(element, data, options) {
    const { scene, modes, colors, alpha } = data, single = modes && modes.length === 1;
    Object.assign(this, { element, data, clock: options.clock || new Clock(), single });
    this.bar = make("div", { className: "bar" });
    element.append(this.bar);
    this.view = mount(element, scene, { ...options, clock: this.clock });
    this.view.figure = this;
    this.view.show({ colors: colors || null, alpha: alpha || null, color: modes ? "displacement" : "group", amplitude: 1 });
    if (modes && !single) this.modeControls();
    this.switches();
    if (!this.bar.children.length) this.bar.remove();
    this.legend();
    if (!modes) return;
    this.setStage(0);
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) this.clock.play();
  }

  get playing() { return this.clock.playing; }
  play(on) { if (on) this.clock.play(); else this.clock.pause(); }

  modeControls() {
    const button = (textContent, title, onclick) => make("button", { type: "button", textContent, title, onclick });
    this.stages = [...new Set(this.data.modes.map((m) => m.stage))];
    this.stageBox = make("select", { onchange: () => this.setStage(this.stageBox.selectedIndex), ariaLabel: "Stage" }, ...entries(this.stages));
    this.modeBox = make("select", { onchange: () => this.setMode(), ariaLabel: "Mode" });
    const step = (d) => () => { const n = this.modeBox.length; this.modeBox.selectedIndex = (this.modeBox.selectedIndex + d + n) % n; this.setMode(); };
    const playing = button("Play", "Play or pause", () => this.play(!this.playing));
    this.view.endings.push(this.clock.on(() => { const text = this.playing ? "Pause" : "Play"; if (playing.textContent !== text) playing.textContent = text; }));
    const amplitude = make("input", { type: "range", min: 0, max: 3, step: 0.02, value: 1, ariaLabel: "Amplitude", oninput: () => this.view.show({ amplitude: +amplitude.value }) });
    const video = button("WebM", "Save two cycles as a video", () => this.record(video));
    this.bar.append(this.stageBox, this.modeBox, button("‹", "Previous mode", step(-1)), button("›", "Next mode", step(1)), playing, video, make("label", {}, "Amplitude ", amplitude));
  }

  switches() {
    const { modes, scene } = this.data;
    if (this.single) return;
    const box = (name, text, on) => {
      const input = make("input", { type: "checkbox", checked: on, onchange: () => { this[name] = input.checked; this.shown(); } });
      this[name] = on;
      this.bar.append(make("label", {}, input, text));
    };
    if (modes && scene.model) box("withModel", "model", true);
    if (scene.test || scene.sensors) box("withTest", modes ? "test" : "sensors", true);
    if (modes) box("still", "at rest", false);
  }

  shown() {
    const { mode, view } = this, on = this.withTest !== false;
    const ghost = this.data.modes && mode && !mode.fe;
    view.show({
      model: ghost ? "ghost" : this.withModel !== false, still: Boolean(this.still), sensor: on,
      test: on && (mode && mode.test ? "test" : true),
    });
  }

  legend() {
    const { scene, legend, modes } = this.data, { sensors } = scene;
    const swatch = (color, text, note) => make("span", {}, make("i", { style: `background:${color}` }), text, note ? make("b", { textContent: note }) : "");
    const kinds = new Map();
    if (sensors) sensors.names.forEach((_, k) => { const at = sensors.kinds[k]; kinds.set(at, [sensors.colors[k], (kinds.get(at)?.[1] || 0) + 1]); });
    // sensors first: hundreds of properties are scrolled
    const box = make("div", { className: "legend" }, ...[...kinds].map(([kind, [color, count]]) => swatch(color, `${kind} (${count})`)),
      ...(legend || []).map((k) => swatch(k.color, k.name, k.note)));
    if (modes) {
      if (scene.model) box.append(make("span", {}, "displacement, relative: 0", make("i", { className: "ramp" }), "1"));
      if (scene.test) box.append(swatch(TEST_COLOR, "test"));
    }
    if (box.children.length) this.element.append(box);
  }

  // ------------------------------------------------------------------ modes
  setStage(k) {
    const stage = this.stages ? this.stages[k] : this.data.modes[0].stage;
    this.list = this.data.modes.filter((m) => m.stage === stage);
    if (this.modeBox) this.modeBox.replaceChildren(...entries(this.list.map((m) => m.label)));
    this.setMode();
  }

  setMode() {
    const mode = decode(this.list[this.modeBox ? this.modeBox.selectedIndex : 0]), { view } = this;
    this.mode = mode;
    if (!view.ctx) return;
    view.info.textContent = mode.info;
    for (const kept of Object.values(view.kept)) kept.clear();
    if (mode.fe) view.shapes("shape", mode.fe);
    if (mode.wire) view.shapes("shape at test", mode.wire, "test");
    if (mode.test) view.shapes("test", mode.test, "test");
    view.show({ mode: "shape" });
    this.shown();
  }

  record(button) {
    const video = new MediaRecorder(this.view.canvas.captureStream(30), { mimeType: "video/webm" }), parts = [], { playing, clock } = this;
    video.ondataavailable = (e) => parts.push(e.data);
    video.onstop = () => {
      save(this.element, "webm", new Blob(parts, { type: "video/webm" }));
      button.disabled = false;
      if (!playing) clock.pause();
    };
    button.disabled = true;
    clock.phase = 0;
    clock.play();
    video.start();
    setTimeout(() => video.stop(), 2000 / clock.pace);
  }

  // All modes of the chosen stage in a sheet, for paper.
  sheet() {
    if (!this.modeBox) return;
    if (this.thumbs) this.thumbs.remove();
    const { view, modeBox } = this, at = modeBox.selectedIndex, big = view.canvas, box = make("div", { className: "sheet" });
    this.list.forEach((mode, k) => {
      modeBox.selectedIndex = k;
      this.setMode();
      view.canvas = make("canvas");
      view.paint({ width: 220, height: 150 });
      box.append(make("div", {}, view.canvas, mode.label));
    });
    view.canvas = big;
    modeBox.selectedIndex = at;
    this.setMode();
    this.thumbs = box;
    this.element.append(box);
    this.element.closest("figure")?.classList.add("long");
  }
}

const entries = (texts) => texts.map((textContent) => make("option", { textContent }));

// Redraws every view for paper of this width (at its largest deflection), or with 0 for the screen again.
export function still(width) {
  for (const view of views) {
    if (!view.ctx) continue;
    if (width && view.figure) view.figure.sheet();
    view.paint({ width: width && view.element.closest(".columns") ? (width - 34) / 2 : width });
  }
}
