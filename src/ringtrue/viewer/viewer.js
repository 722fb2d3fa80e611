"use strict";
// The 3D viewer: one shared WebGL 2 context draws every view, each copied to its own 2D canvas (so printing works).
(() => {
  const RAMP = "vec3 ramp(float t){vec3 a=vec3(.949,.953,.918),b=vec3(.561,.816,.729),c=vec3(.169,.549,.745),d=vec3(.145,.204,.580);" +
    "return t<.333?mix(a,b,t*3.):t<.667?mix(b,c,t*3.-1.):mix(c,d,t*3.-2.);}";
  const HEAD = "#version 300 es\nprecision highp float;\nuniform mat4 uM;uniform float uCos,uSin,uAmp;\n";
  const MESH_V = HEAD + "in vec3 aP,aD;in vec4 aC;out vec3 vP;out vec4 vC;out float vD;uniform mat4 uR;" +
    "void main(){vec3 p=aP+uAmp*uCos*aD;vP=(uR*vec4(p,1.)).xyz;vC=aC;vD=length(aD);gl_Position=uM*vec4(p,1.);}";
  const MESH_F = "#version 300 es\nprecision highp float;in vec3 vP;in vec4 vC;in float vD;out vec4 o;uniform float uColor;" + RAMP +
    "void main(){vec3 n=normalize(cross(dFdx(vP),dFdy(vP)));float l=.62+.38*abs(dot(n,normalize(vec3(.25,.35,.9))));" +
    "vec3 c=uColor>.5?ramp(clamp(vD,0.,1.)):vC.rgb;o=vec4(c*l,vC.a);}";
  // A line is a quad of constant width on the screen: two triangles, as instances take software renderers a millisecond each.
  const QUAD = [0, -0.5, 1, -0.5, 0, 0.5, 0, 0.5, 1, -0.5, 1, 0.5];
  const LINE_V = HEAD + "in vec2 aQ;in vec3 aA,aB,aDA,aDB,aIA,aIB;in vec4 aC;out vec4 vC;uniform vec2 uSize;uniform float uWide,uLift;" +
    "void main(){vec4 a=uM*vec4(aA+uAmp*(uCos*aDA-uSin*aIA),1.),b=uM*vec4(aB+uAmp*(uCos*aDB-uSin*aIB),1.);" +
    "vec2 d=(b.xy/b.w-a.xy/a.w)*uSize;float n=length(d);d=n>1e-6?d/n:vec2(1.,0.);" +
    "vec4 p=aQ.x<.5?a:b;p.xy+=vec2(-d.y,d.x)*aQ.y*uWide/uSize*p.w;p.z-=uLift*p.w;vC=aC;gl_Position=p;}";
  const POINT_V = HEAD + "in vec3 aP,aD,aI;in vec4 aC;out vec4 vC;uniform float uWide,uLift;" +
    "void main(){vC=aC;gl_Position=uM*vec4(aP+uAmp*(uCos*aD-uSin*aI),1.);gl_Position.z-=uLift;gl_PointSize=uWide;}";
  const FLAT_F = "#version 300 es\nprecision highp float;in vec4 vC;out vec4 o;uniform float uRound;" +
    "void main(){if(uRound>.5&&length(gl_PointCoord-.5)>.5)discard;o=vC;}";

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const f32 = (t) => new Float32Array(bytes(t));
  const u32 = (t) => new Uint32Array(bytes(t));
  const u16 = (t) => new Uint16Array(bytes(t));
  const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);
  const TEST = rgb("#d55e00"), INK = [0.16, 0.22, 0.28];

  let shared = null;
  function context() {
    if (shared) return shared;
    const canvas = document.createElement("canvas");
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, preserveDrawingBuffer: true });
    if (!gl) return null;
    const program = (v, f) => {
      const p = gl.createProgram();
      for (const [kind, text] of [[gl.VERTEX_SHADER, v], [gl.FRAGMENT_SHADER, f]]) {
        const s = gl.createShader(kind);
        gl.shaderSource(s, text);
        gl.compileShader(s);
        if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
        gl.attachShader(p, s);
      }
      gl.linkProgram(p);
      if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
      const out = { p, a: {}, u: {} };
      for (let k = 0; k < gl.getProgramParameter(p, gl.ACTIVE_ATTRIBUTES); k++) {
        const n = gl.getActiveAttrib(p, k).name;
        out.a[n] = gl.getAttribLocation(p, n);
      }
      for (let k = 0; k < gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS); k++) {
        const n = gl.getActiveUniform(p, k).name;
        out.u[n] = gl.getUniformLocation(p, n);
      }
      return out;
    };
    shared = { canvas, gl, mesh: program(MESH_V, MESH_F), line: program(LINE_V, FLAT_F), point: program(POINT_V, FLAT_F) };
    return shared;
  }

  // ------------------------------------------------------------------ geometry
  const gather = (values, index, out) => {
    for (let k = 0; k < index.length; k++) for (let c = 0; c < 3; c++) out[3 * k + c] = values[3 * index[k] + c];
    return out;
  };

  // Edges of the skin worth drawing: free ones, sharp ones, borders between groups.
  function featureEdges(xyz, tri, group) {
    const count = tri.length / 3, normal = new Float32Array(tri.length), seen = new Map(), out = [];
    for (let t = 0; t < count; t++) {
      const [a, b, c] = [tri[3 * t] * 3, tri[3 * t + 1] * 3, tri[3 * t + 2] * 3];
      const u = [0, 1, 2].map((k) => xyz[b + k] - xyz[a + k]), v = [0, 1, 2].map((k) => xyz[c + k] - xyz[a + k]);
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      const size = Math.hypot(...n) || 1;
      for (let k = 0; k < 3; k++) normal[3 * t + k] = n[k] / size;
    }
    const dot = (s, t) => Math.abs(normal[3 * s] * normal[3 * t] + normal[3 * s + 1] * normal[3 * t + 1] + normal[3 * s + 2] * normal[3 * t + 2]);
    for (let t = 0; t < count; t++) for (let k = 0; k < 3; k++) {
      const i = tri[3 * t + k], j = tri[3 * t + (k + 1) % 3], key = Math.min(i, j) * 1048576 + Math.max(i, j);
      const s = seen.get(key);
      if (s === undefined) seen.set(key, [t, i, j, 1]);
      else { s[3] += 1; if (dot(s[0], t) < 0.86 || group[s[0]] !== group[t] || s[3] > 2) s[4] = true; }
    }
    for (const [, i, j, n, keep] of seen.values()) if (n === 1 || keep) out.push(i, j);
    return Uint32Array.from(out);
  }

  // ------------------------------------------------------------------ camera: turntable, orthographic, z up
  function matrices(cam, size, aspect, pan) {
    const ca = Math.cos(cam.az), sa = Math.sin(cam.az), ce = Math.cos(cam.el), se = Math.sin(cam.el);
    const right = [-sa, ca, 0], up = [-se * ca, -se * sa, ce], out = [ce * ca, ce * sa, se], c = cam.at;
    const dot = (v) => v[0] * c[0] + v[1] * c[1] + v[2] * c[2];
    const s = cam.zoom / size, sx = s / Math.max(aspect, 1) * 1, sy = sx * aspect;
    const R = [right[0], up[0], out[0], 0, right[1], up[1], out[1], 0, right[2], up[2], out[2], 0, 0, 0, 0, 1];
    const M = [
      sx * right[0], sy * up[0], -out[0] / (4 * size), 0, sx * right[1], sy * up[1], -out[1] / (4 * size), 0,
      sx * right[2], sy * up[2], -out[2] / (4 * size), 0,
      -sx * dot(right) + pan[0], -sy * dot(up) + pan[1], dot(out) / (4 * size), 1];
    return { R, M, right, up };
  }

  // Saves a file named after the figure: figure-12.png.
  window.ringtrueSave = (div, ending, blob) => {
    const caption = div.closest("figure")?.querySelector("figcaption b"), link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${caption ? caption.textContent.toLowerCase().replace(/\s+/g, "-") : "view"}.${ending}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };

  const all = [];
  const PACE = 0.7; // cycles of a mode in a second
  class Viewer {
    constructor(div, data) {
      Object.assign(this, { div, data, phase: 0, amp: 1, playing: false, parts: [], show: { skin: true, test: true, still: false } });
      this.ctx = context();
      this.read();
      this.build();
      if (data.modes) this.setStage(0);
      else this.upload();
      this.observe();
      this.draw();
    }

    read() {
      const { skin, test } = this.data;
      if (skin) {
        Object.assign(this, { xyz: f32(skin.xyz), tri: u32(skin.tri), lines: u32(skin.line), tgroup: u16(skin.tgroup), lgroup: u16(skin.lgroup) });
        this.edges = featureEdges(this.xyz, this.tri, this.tgroup);
        this.colors = skin.colors.map((c, k) => [...rgb(c), skin.alpha[k]]);
      }
      if (test) Object.assign(this, { txyz: f32(test.xyz), tlines: u32(test.line), tnames: test.names });
      const low = [1e30, 1e30, 1e30], high = [-1e30, -1e30, -1e30];
      for (const a of [this.xyz, this.txyz]) if (a) for (let k = 0; k < a.length; k++) {
        low[k % 3] = Math.min(low[k % 3], a[k]);
        high[k % 3] = Math.max(high[k % 3], a[k]);
      }
      this.size = Math.hypot(...high.map((h, k) => h - low[k])) / 2 || 1;
      this.low = low; this.high = high;
      this.cam = { at: low.map((l, k) => (l + high[k]) / 2), az: -1.05, el: 0.42, zoom: 1.35 };
      this.pan = [0, 0];
    }

    // ---------------------------------------------------------------- controls
    build() {
      const el = (tag, props = {}, ...kids) => { const e = Object.assign(document.createElement(tag), props); e.append(...kids); return e; };
      const button = (text, title, run) => el("button", { type: "button", textContent: text, title, onclick: run });
      const bar = el("div", { className: "bar" });
      if (this.data.modes) {
        this.stages = [...new Set(this.data.modes.map((m) => m.stage))];
        this.stageBox = el("select", { onchange: () => this.setStage(this.stageBox.selectedIndex), ariaLabel: "Stage" }, ...this.stages.map((s) => el("option", { textContent: s })));
        this.modeBox = el("select", { onchange: () => this.setMode(), ariaLabel: "Mode" });
        const step = (d) => () => { const n = this.modeBox.length; this.modeBox.selectedIndex = (this.modeBox.selectedIndex + d + n) % n; this.setMode(); };
        this.playButton = button("Pause", "Play or pause", () => this.play(!this.playing));
        const amp = el("input", { type: "range", min: 0, max: 3, step: 0.02, value: 1, ariaLabel: "Amplitude", oninput: () => { this.amp = +amp.value; this.draw(); } });
        const video = button("WebM", "Save two cycles as a video", () => this.record(video));
        bar.append(this.stageBox, this.modeBox, button("‹", "Previous mode", step(-1)), button("›", "Next mode", step(1)), this.playButton, video, el("label", {}, "Amplitude ", amp));
      }
      const box = (name, text) => {
        const c = el("input", { type: "checkbox", checked: this.show[name], onchange: () => { this.show[name] = c.checked; this.draw(); } });
        return el("label", {}, c, text);
      };
      if (this.data.modes && this.data.modes.length === 1) bar.replaceChildren();
      else if (this.data.modes && this.xyz) bar.append(box("skin", "model"));
      if (this.txyz && !(this.data.modes && this.data.modes.length === 1)) bar.append(box("test", this.data.modes ? "test" : "sensors"));
      if (this.data.modes && this.data.modes.length > 1) bar.append(box("still", "at rest"));
      const directions = el("div", { className: "directions" });
      for (const [name, az, e] of [["3D", -1.05, 0.42], ["X", 0, 0], ["Y", -Math.PI / 2, 0], ["Z", -Math.PI / 2, Math.PI / 2]])
        directions.append(button(name, name === "3D" ? "Oblique view" : `View along ${name}`, () => { Object.assign(this.cam, { az, el: e, zoom: 1.35 }); this.pan = [0, 0]; this.draw(); }));
      directions.append(button("PNG", "Save the picture", () => this.canvas.toBlob((png) => window.ringtrueSave(this.div, "png", png))));
      this.canvas = el("canvas", { tabIndex: 0, ariaLabel: "3D view: drag to turn, shift-drag to move, wheel to zoom" });
      this.tip = el("div", { className: "tip" });
      this.info = el("div", { className: "info" });
      this.stage = el("div", { className: "stage" }, this.canvas, this.tip, this.info, directions);
      this.div.append(...(bar.children.length ? [bar] : []), this.stage);
      if (!this.ctx) this.info.textContent = "3D figures need WebGL 2, which this browser does not offer.";
      this.legend(el);
      this.mouse();
    }

    legend(el) {
      const items = [...(this.data.sensors || []), ...(this.data.legend || [])]; // sensors first: hundreds of properties are scrolled
      const swatch = (color, text, note) => el("span", {}, el("i", { style: `background:${color}` }), text, note ? el("b", { textContent: note }) : "");
      const box = el("div", { className: "legend" }, ...items.map((k) => swatch(k.color, k.name + (k.labels ? ` (${k.labels.length})` : ""), k.note)));
      if (this.data.modes) {
        if (this.xyz) box.append(el("span", {}, "displacement, relative: 0", el("i", { className: "ramp" }), "1"));
        if (this.txyz) box.append(swatch("#d55e00", "test"));
      }
      if (box.children.length) this.div.append(box);
    }

    mouse() {
      const c = this.canvas, touches = new Map();
      let apart = 0;
      c.addEventListener("pointerdown", (e) => { touches.set(e.pointerId, [e.clientX, e.clientY]); c.setPointerCapture(e.pointerId); c.focus({ preventScroll: true }); });
      const up = (e) => { touches.delete(e.pointerId); apart = 0; };
      c.addEventListener("pointerup", up);
      c.addEventListener("pointercancel", up);
      c.addEventListener("pointermove", (e) => {
        const old = touches.get(e.pointerId);
        if (!old) return this.hover(e);
        touches.set(e.pointerId, [e.clientX, e.clientY]);
        const dx = e.clientX - old[0], dy = e.clientY - old[1], w = c.clientWidth, h = c.clientHeight;
        if (touches.size > 1) {
          const [a, b] = [...touches.values()], now = Math.hypot(a[0] - b[0], a[1] - b[1]);
          if (apart) this.cam.zoom *= now / apart;
          apart = now;
        } else if (e.shiftKey || e.buttons & 6) { this.pan[0] += 2 * dx / w; this.pan[1] -= 2 * dy / h; }
        else { this.cam.az -= dx * 0.008; this.cam.el = Math.min(1.5708, Math.max(-1.5708, this.cam.el + dy * 0.008)); }
        this.draw();
      });
      c.addEventListener("pointerleave", () => { this.tip.style.display = "none"; });
      c.addEventListener("contextmenu", (e) => e.preventDefault());
      // The wheel scrolls the page until the view was clicked.
      c.addEventListener("wheel", (e) => {
        if (document.activeElement !== c && !e.ctrlKey) return;
        e.preventDefault();
        this.cam.zoom = Math.min(40, Math.max(0.2, this.cam.zoom * Math.exp(-e.deltaY * 0.0012)));
        this.draw();
      }, { passive: false });
      c.addEventListener("keydown", (e) => {
        const turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[e.key];
        const zoom = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 }[e.key];
        if (e.key === " " && this.data.modes) this.play(!this.playing);
        else if (turn) { this.cam.az += turn[0]; this.cam.el = Math.min(1.5708, Math.max(-1.5708, this.cam.el + turn[1])); }
        else if (zoom) this.cam.zoom *= zoom;
        else return;
        e.preventDefault();
        this.draw();
      });
    }

    hover(e) {
      if (!this.txyz || !this.view || !this.show.test) return;
      const r = this.canvas.getBoundingClientRect(), M = this.view.M;
      let best = 12, name = "", at = [0, 0];
      const look = (xyz, names) => {
        for (let k = 0; k < names.length; k++) {
          const p = [0, 1].map((c) => M[c] * xyz[3 * k] + M[4 + c] * xyz[3 * k + 1] + M[8 + c] * xyz[3 * k + 2] + M[12 + c]);
          const x = (p[0] + 1) / 2 * r.width, y = (1 - p[1]) / 2 * r.height, d = Math.hypot(x - (e.clientX - r.left), y - (e.clientY - r.top));
          if (d < best) { best = d; name = names[k]; at = [x, y]; }
        }
      };
      look(this.txyz, this.tnames);
      this.tip.style.display = name ? "block" : "none";
      this.tip.textContent = name && "point " + name;
      Object.assign(this.tip.style, { left: `${at[0] + 12}px`, top: `${at[1] - 26}px` });
    }

    // ---------------------------------------------------------------- modes
    setStage(k) {
      const stage = this.stages[k];
      this.list = this.data.modes.filter((m) => m.stage === stage);
      this.modeBox.replaceChildren(...this.list.map((m) => Object.assign(document.createElement("option"), { textContent: m.label })));
      this.setMode();
    }

    setMode() {
      const mode = this.list[this.modeBox.selectedIndex];
      this.info.textContent = this.ctx ? mode.info : this.info.textContent;
      const decode = (d) => Float32Array.from(new Int16Array(bytes(d.q)), (v) => v * d.peak / 32767);
      const peak = Math.max(...[mode.fe, mode.wire, mode.test].filter(Boolean).map((d) => d.peak));
      const main = (mode.fe || mode.wire || mode.test).peak;
      this.scale = 1 / Math.min(peak, 1.6 * main); // a runaway sensor does not shrink the rest
      const scaled = (d) => d && decode(d).map((v) => v * this.scale);
      this.fe = scaled(mode.fe);
      this.wire = scaled(mode.wire);
      this.tre = this.tim = null;
      if (mode.test) {
        const both = scaled(mode.test), n = both.length / 6;
        this.tre = new Float32Array(3 * n);
        this.tim = new Float32Array(3 * n);
        for (let p = 0; p < n; p++) for (let c = 0; c < 3; c++) { this.tre[3 * p + c] = both[6 * p + c]; this.tim[3 * p + c] = both[6 * p + 3 + c]; }
      }
      else if (this.fe && this.txyz) this.tre = this.withModel();
      this.upload();
      this.draw();
    }

    // Where the test has no such mode its points move as the nearest node of the model.
    withModel() {
      const xyz = this.xyz, nearest = Uint32Array.from({ length: this.txyz.length / 3 }, (_, p) => {
        let least = Infinity, best = 0;
        for (let k = 0; k < xyz.length / 3; k++) {
          const d = Math.hypot(xyz[3 * k] - this.txyz[3 * p], xyz[3 * k + 1] - this.txyz[3 * p + 1], xyz[3 * k + 2] - this.txyz[3 * p + 2]);
          if (d < least) { least = d; best = k; }
        }
        return best;
      });
      return gather(this.fe, nearest, new Float32Array(3 * nearest.length));
    }

    play(on) {
      this.playing = on;
      this.playButton.textContent = on ? "Pause" : "Play";
      this.last = undefined;
      if (on) requestAnimationFrame((t) => this.tick(t));
    }

    tick(t) {
      if (!this.playing || !this.visible) return;
      this.phase += this.last === undefined ? 0 : Math.min(t - this.last, 100) / 1000 * 2 * Math.PI * PACE;
      this.last = t;
      this.draw();
      requestAnimationFrame((u) => this.tick(u));
    }

    record(button) {
      const video = new MediaRecorder(this.canvas.captureStream(30), { mimeType: "video/webm" }), parts = [], playing = this.playing;
      video.ondataavailable = (e) => parts.push(e.data);
      video.onstop = () => {
        window.ringtrueSave(this.div, "webm", new Blob(parts, { type: "video/webm" }));
        button.disabled = false;
        if (!playing) this.play(false);
      };
      button.disabled = true;
      this.phase = 0;
      if (!playing) this.play(true);
      video.start();
      setTimeout(() => video.stop(), 2000 / PACE);
    }

    observe() {
      const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
      if (this.data.modes) this.play(!calm);
      new IntersectionObserver((seen) => {
        this.visible = seen[0].isIntersecting;
        if (this.visible && this.playing) { this.last = undefined; requestAnimationFrame((t) => this.tick(t)); }
      }).observe(this.div);
      new ResizeObserver(() => this.draw()).observe(this.stage);
    }

    // ---------------------------------------------------------------- buffers
    upload() {
      if (!this.ctx) return;
      const { gl } = this.ctx;
      this.parts.forEach((p) => Object.values(p.buffers).forEach((b) => gl.deleteBuffer(b.id)));
      this.parts = [];
      const add = (kind, count, buffers, look) => {
        const ids = Object.fromEntries(Object.entries(buffers).map(([name, array]) => {
          const id = gl.createBuffer();
          gl.bindBuffer(gl.ARRAY_BUFFER, id);
          gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
          return [name, { id, size: array.length / count }];
        }));
        if (count) this.parts.push({ kind, count, buffers: ids, ...look });
      };
      const segments = (xyz, index, re, im, colors, look) => {
        const n = index.length / 2, m = 6 * n, zero = new Float32Array(3 * m), color = colors(n);
        const every = (k) => Math.floor(k / 6), a = Uint32Array.from({ length: m }, (_, k) => index[2 * every(k)]), b = a.map((_, k) => index[2 * every(k) + 1]);
        const pick = (v, i) => (v ? gather(v, i, new Float32Array(3 * m)) : zero);
        const aQ = Float32Array.from({ length: 2 * m }, (_, k) => QUAD[k % 12]), aC = Float32Array.from({ length: 4 * m }, (_, k) => color[4 * every(k >> 2) + k % 4]);
        add("line", m, { aQ, aC, aA: pick(xyz, a), aB: pick(xyz, b), aDA: pick(re, a), aDB: pick(re, b), aIA: pick(im, a), aIB: pick(im, b) }, look);
      };
      const plain = (c, alpha = 1) => (n) => { const out = new Float32Array(4 * n); for (let k = 0; k < n; k++) out.set([...c, alpha], 4 * k); return out; };
      if (this.xyz) this.uploadSkin(add, segments, plain);
      if (this.txyz) this.uploadTest(add, segments, plain);
    }

    uploadSkin(add, segments, plain) {
      const modes = Boolean(this.data.modes), ghost = modes && !this.fe;
      if (modes) segments(this.xyz, this.edges, null, null, plain(INK, 0.28), { wide: 1, when: () => this.show.still || ghost });
      if (ghost) return segments(this.xyz, this.lines, null, null, plain(INK, 0.2), { wide: 1.2 });
      const n = this.tri.length, when = () => this.show.skin, zero = new Float32Array(3 * n);
      for (const solid of [true, false]) {
        const keep = [];
        for (let t = 0; t < n / 3; t++) if ((this.colors[this.tgroup[t]][3] >= 1) === solid) keep.push(t);
        const index = Uint32Array.from(keep.flatMap((t) => [this.tri[3 * t], this.tri[3 * t + 1], this.tri[3 * t + 2]]));
        const m = index.length, color = new Float32Array(4 * m);
        keep.forEach((t, k) => { for (let c = 0; c < 3; c++) color.set(this.colors[this.tgroup[t]], 12 * k + 4 * c); });
        const move = this.fe ? gather(this.fe, index, new Float32Array(3 * m)) : zero.subarray(0, 3 * m);
        add("mesh", m, { aP: gather(this.xyz, index, new Float32Array(3 * m)), aD: move, aC: color }, { ramp: modes, solid, when });
      }
      segments(this.xyz, this.edges, this.fe, null, plain(INK, 0.45), { wide: 1.0, lift: 0.0012, when });
      const beams = (k) => { const out = new Float32Array(4 * k); for (let i = 0; i < k; i++) { const c = this.colors[this.lgroup[i]]; out.set(modes ? [0.2, 0.3, 0.4, 1] : [...c.slice(0, 3).map((v) => v * 0.72), Math.max(c[3], 0.5)], 4 * i); } return out; };
      segments(this.xyz, this.lines, this.fe, null, beams, { wide: 2.2, lift: 0.0014, when });
      if (!modes) this.uploadDots(add);
    }

    // Springs have no skin: a line without length is a dot, seen through the skin where it is coloured.
    uploadDots(add) {
      const seen = this.data.kind === "regions";
      for (const solid of [false, true]) {
        const at = [], color = [];
        for (let k = 0; k < this.lines.length / 2; k++) {
          const a = this.lines[2 * k], c = this.colors[this.lgroup[k]];
          if (a !== this.lines[2 * k + 1] || (c[3] >= 1) !== solid) continue;
          at.push(...this.xyz.slice(3 * a, 3 * a + 3));
          color.push(...c.slice(0, 3).map((v) => v * (seen ? 1 : 0.7)), 1);
        }
        const n = at.length / 3, zero = new Float32Array(3 * n);
        add("point", n, { aP: Float32Array.from(at), aD: zero, aI: zero, aC: Float32Array.from(color) },
          { wide: solid ? 10 : 5, lift: seen && solid ? 0.5 : 0.01, when: () => this.show.skin });
      }
    }

    uploadTest(add, segments, plain) {
      const when = () => this.show.test, n = this.txyz.length / 3, zero = new Float32Array(3 * n);
      if (this.data.sensors) return this.uploadSensors(segments, plain, when);
      if (this.wire) segments(this.txyz, this.tlines, this.wire, null, plain(rgb("#24527a")), { wide: 2, lift: 0.003, when: () => this.show.skin });
      segments(this.txyz, this.tlines, this.tre, this.tim, plain(TEST), { wide: 2.4, lift: 0.004, when });
      add("point", n, { aP: this.txyz, aD: this.tre || zero, aI: this.tim || zero, aC: plain(TEST)(n) }, { wide: 6, lift: 0.004, when });
    }

    uploadSensors(segments, plain, when) {
      const long = 0.055 * this.size;
      for (const kind of this.data.sensors) {
        const xyz = f32(kind.xyz), dir = f32(kind.dir), n = xyz.length / 3, ends = [], index = [];
        for (let k = 0; k < n; k++) {
          const p = [0, 1, 2].map((c) => xyz[3 * k + c]), d = [0, 1, 2].map((c) => dir[3 * k + c]);
          const side = Math.abs(d[2]) > 0.7 ? [1, 0, 0] : [0, 0, 1], tip = p.map((v, c) => v + long * d[c]), base = ends.length / 3;
          ends.push(...p, ...tip);
          for (const s of [1, -1]) ends.push(...tip.map((v, c) => v - 0.32 * long * d[c] + s * 0.16 * long * side[c]));
          index.push(base, base + 1, base + 1, base + 2, base + 1, base + 3);
        }
        segments(Float32Array.from(ends), Uint32Array.from(index), null, null, plain(rgb(kind.color)), { wide: 2, lift: 0.02, when });
      }
    }

    // ---------------------------------------------------------------- drawing
    draw() {
      if (!this.ctx || this.queued) return;
      this.queued = true;
      requestAnimationFrame(() => { this.queued = false; this.paint(); });
    }

    // Without arguments: on screen, as it moves. With a size: still, at the largest deflection.
    paint(width = 0, height = Math.min(this.stage.clientHeight, 420)) {
      const { gl, canvas } = this.ctx, ratio = width ? 2 : Math.min(devicePixelRatio || 1, 2);
      const w = Math.round((width || this.stage.clientWidth) * ratio), h = Math.round((width ? height : this.stage.clientHeight) * ratio);
      if (!w || !h) return;
      if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
      if (canvas.width < w || canvas.height < h) Object.assign(canvas, { width: Math.max(canvas.width, w), height: Math.max(canvas.height, h) });
      gl.viewport(0, 0, w, h);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(0, 0, w, h);
      gl.clearColor(0.984, 0.988, 0.992, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      gl.depthFunc(gl.LEQUAL);
      gl.enable(gl.BLEND);
      gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      const fitted = this.fit(w / h);
      this.view = matrices({ ...this.cam, zoom: this.cam.zoom * fitted }, this.size, w / h, this.pan);
      const phase = width ? 0 : this.phase, amp = 0.09 * this.size * this.amp;
      for (const p of this.parts) if (!p.when || p.when()) this.paintPart(p, w, h, ratio, phase, amp);
      this.canvas.getContext("2d").drawImage(canvas, 0, canvas.height - h, w, h, 0, 0, w, h);
    }

    // All modes of the chosen stage side by side, for paper.
    sheet() {
      if (!this.data.modes || this.data.modes.length === 1) return;
      if (this.thumbs) this.thumbs.remove();
      const at = this.modeBox.selectedIndex, big = this.canvas, box = Object.assign(document.createElement("div"), { className: "sheet" });
      this.list.forEach((mode, k) => {
        this.modeBox.selectedIndex = k;
        this.setMode();
        const small = document.createElement("canvas"), cell = document.createElement("div");
        this.canvas = small;
        this.paint(220, 150);
        cell.append(small, mode.label);
        box.append(cell);
      });
      this.canvas = big;
      this.modeBox.selectedIndex = at;
      this.setMode();
      this.thumbs = box;
      this.div.append(box);
      this.div.closest("figure").classList.add("long");
    }

    // Zoom that fills the canvas whatever its aspect, from the box seen obliquely.
    fit(aspect) {
      const { M } = matrices({ at: this.cam.at, az: -1.05, el: 0.42, zoom: 1 }, this.size, aspect, [0, 0]);
      let most = 0;
      for (let k = 0; k < 8; k++) {
        const p = [0, 1, 2].map((c) => (k >> c & 1 ? this.high[c] : this.low[c]));
        for (const c of [0, 1]) most = Math.max(most, Math.abs(M[c] * p[0] + M[4 + c] * p[1] + M[8 + c] * p[2] + M[12 + c]));
      }
      return 0.66 / (most || 1);
    }

    paintPart(p, w, h, ratio, phase, amp) {
      const { gl } = this.ctx, prog = this.ctx[p.kind], u = prog.u;
      gl.useProgram(prog.p);
      gl.uniformMatrix4fv(u.uM, false, this.view.M);
      if (u.uR) gl.uniformMatrix4fv(u.uR, false, this.view.R);
      gl.uniform1f(u.uCos, Math.cos(phase));
      gl.uniform1f(u.uSin, Math.sin(phase));
      gl.uniform1f(u.uAmp, amp);
      if (u.uColor) gl.uniform1f(u.uColor, p.ramp ? 1 : 0);
      if (u.uSize) gl.uniform2f(u.uSize, w / 2, h / 2);
      if (u.uWide) gl.uniform1f(u.uWide, p.wide * ratio);
      if (u.uLift) gl.uniform1f(u.uLift, p.lift || 0);
      if (u.uRound) gl.uniform1f(u.uRound, p.kind === "point" ? 1 : 0);
      const bound = [];
      for (const [name, { id, size }] of Object.entries(p.buffers)) {
        const at = prog.a[name];
        if (at === undefined) continue;
        gl.bindBuffer(gl.ARRAY_BUFFER, id);
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, size, gl.FLOAT, false, 0, 0);
        bound.push(at);
      }
      gl.depthMask(p.kind !== "mesh" || p.solid);
      gl.drawArrays(p.kind === "point" ? gl.POINTS : gl.TRIANGLES, 0, p.count);
      gl.depthMask(true);
      bound.forEach((at) => gl.disableVertexAttribArray(at));
    }
  }

  window.ringtrueView = (div, data) => { const v = new Viewer(div, data); all.push(v); if (v.ctx) v.paint(); return v; };
  // Redraws every view for paper (at largest deflection), or for the screen again.
  window.ringtrueStill = (width) => all.forEach((v) => {
    if (!v.ctx) return;
    if (width) v.sheet();
    v.paint(width && v.div.closest(".columns") ? (width - 34) / 2 : width);
  });
})();
