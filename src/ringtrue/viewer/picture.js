// How a view is drawn: the picture on the screen and on paper, and the picture of ids that is read back.
import { fittingZoom, matrices, rgb, thinned } from "./geometry.js";

export const THEMES = {
  light: { back: [0.984, 0.988, 0.992], ink: [0.16, 0.22, 0.28], beam: [0.2, 0.3, 0.4], plain: "#c3ccd5", select: "#e0007a", hover: "#f2a33a" },
  dark: { back: [0.071, 0.086, 0.106], ink: [0.82, 0.87, 0.91], beam: [0.66, 0.75, 0.83], plain: "#66727e", select: "#ff4fa3", hover: "#ffc078" },
};
const LARGEST = 0.09; // deflection at amplitude 1, of half the diagonal
const SLOW = 45; // ms of a frame in motion, beyond which it is drawn more coarsely
const FEW = 8000; // nodes and edges of what is drawn in coarse motion
const STILL = 160; // ms without motion after which it is drawn finely again
const TEST = "#d55e00";
const OVER_COLOURS = [0.47, 0.53, 0.58, 0.75]; // edges that are seen on pale and on dark colours

// What `View` of viewer.js is drawn by; `body`, `wire`, `rest` and `arrows` are what is there to draw.
export class Picture {
  // ------------------------------------------------------------------ drawing
  draw(moving = this.clock.playing) {
    this.fresh = null; // of the picture of ids: with sensors or without
    if (!this.ctx || this.queued || this.gone) return;
    this.queued = true;
    requestAnimationFrame(() => {
      this.queued = false;
      if (this.gone) return;
      const begin = performance.now(), coarse = moving ? this.coarse : this.heavy && !this.settled ? 1 : 0;
      this.paint({ coarse });
      const took = performance.now() - begin;
      this.pace(took, moving);
      if (!coarse) this.heavy = took > SLOW; // then what is clicked is answered by a coarse picture first
      this.settled = false;
      clearTimeout(this.settling);
      if (coarse) this.settling = setTimeout(() => { this.settled = true; if (!this.clock.playing) this.draw(); }, STILL);
    });
  }

  // Frames that come slowly are drawn more coarsely in motion: 1 without smooth edges, 2 with fewer faces and edges, too.
  pace(took, moving) {
    const since = performance.now() - this.lastFrame;
    this.lastFrame = moving ? performance.now() : undefined;
    const each = since < 1000 ? Math.max(took, since) : took; // a graphics card draws on when a frame is handed over
    this.slow = each > SLOW ? (this.slow || 0) + each / SLOW : 0;
    if (this.slow < 4 || this.coarse > 1) return;
    Object.assign(this, { coarse: this.slow > 20 ? 2 : this.coarse + 1, slow: 0 });
    if (this.coarse > 1 && this.body && this.model.face_element.length > FEW) {
      const { triangles, owner } = thinned(this.model, FEW);
      this.body.strip("few faces", "mesh", triangles, owner);
    }
  }

  // On screen as it moves; with a width still, at the largest deflection, for paper.
  paint({ width = 0, height = Math.min(this.stage.clientHeight, 420), coarse = 0 } = {}) {
    const { gl, canvas, frame } = this.ctx, ratio = width ? 2 : Math.min(devicePixelRatio || 1, coarse ? 1 : 2);
    const w = Math.round((width || this.stage.clientWidth) * ratio), h = Math.round((width ? height : this.stage.clientHeight) * ratio);
    if (!w || !h) return;
    const theme = THEMES[width ? "light" : this.state.theme];
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    if (canvas.width < w || canvas.height < h) Object.assign(canvas, { width: Math.max(canvas.width, w), height: Math.max(canvas.height, h) });
    const smooth = coarse === 0 ? frame(w, h) : null;
    gl.bindFramebuffer(gl.FRAMEBUFFER, smooth);
    this.begin(w, h, [...theme.back, 1]);
    const phase = width ? 0 : this.clock.phase;
    this.drawn = this.scene(w, h, ratio, phase);
    this.fresh = null;
    this.contents(this.drawn, theme, coarse > 1);
    if (smooth) {
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, smooth);
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
      gl.blitFramebuffer(0, 0, w, h, 0, 0, w, h, gl.COLOR_BUFFER_BIT, gl.NEAREST);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    }
    this.canvas.getContext("2d").drawImage(canvas, 0, canvas.height - h, w, h, 0, 0, w, h);
    if (!width) this.placeMarks();
  }

  begin(w, h, back) {
    const { gl } = this.ctx;
    gl.viewport(0, 0, w, h);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, 0, w, h);
    gl.clearColor(...back);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  scene(width, height, ratio, phase) {
    const fitted = fittingZoom(this.box, this.camera.at, this.size, width / height), { clip } = this.state;
    const found = matrices({ ...this.camera, zoom: this.camera.zoom * fitted }, this.size, width / height);
    const amplitude = LARGEST * this.size * this.state.amplitude;
    return {
      ...found, width, height, ratio, fitted, cos: amplitude * Math.cos(phase), sin: amplitude * Math.sin(phase),
      clip: clip ? [...clip.normal, clip.offset] : [0, 0, 0, 0],
    };
  }

  contents(scene, theme, few = false) {
    const { state, body, wire } = this, { ink, beam } = theme, select = [...rgb(theme.select), 1];
    if (this.look) this.look.dark = theme === THEMES.dark;
    const modes = state.mode !== null || this.kept.model.size > 0;
    if (body && state.still) body.draw("edges", scene, { still: true, tint: [...ink, 0.28], wide: 1 });
    if (body && state.model === "ghost") {
      body.draw("edges", scene, { tint: [...ink, 0.28], wide: 1 });
      body.draw("lines", scene, { tint: [...ink, 0.2], wide: 1.2 });
    } else if (body && state.model) {
      const faces = few && body.strips.has("few faces") ? "few faces" : "faces", edges = body.strips.get("edges");
      body.draw(faces, scene, { ...this.look, pass: 0 });
      if (this.clear) body.draw(faces, scene, { ...this.look, pass: 1 });
      if (!few || (edges && edges.count < FEW)) body.draw("edges", scene, { tint: this.look.shade ? OVER_COLOURS : [...ink, 0.45], wide: 1, lift: 0.0012 });
      const colored = this.look.shade > 1 || !body.strips.has("faces") ? this.look : {};
      body.draw("lines", scene, { ...colored, tint: modes && !colored.shade && body.strips.has("faces") ? [...beam, 1] : null, wide: 2.2, lift: 0.0014 });
      body.draw("points", scene, { ...colored, wide: this.clear ? 5 : 10, lift: 0.01, pass: this.clear ? 1 : 2 });
      if (this.clear) body.draw("points", scene, { wide: 10, lift: 0.5, pass: 0 }); // coloured springs are seen through the skin
      body.draw("chosen", scene, { tint: select, wide: 9, lift: 0.6 });
    }
    if (this.hovered && body && state.model) this.drawHover(scene, theme);
    if (wire && state.test !== false) {
      const tint = [...rgb(TEST), 1];
      if (this.wired && state.model) this.rest.draw("lines", scene, { tint: [...rgb("#24527a"), 1], wide: 2, lift: 0.003 });
      wire.draw("lines", scene, { tint, wide: 2.4, lift: 0.004, whole: true });
      wire.draw("points", scene, { tint, wide: 6, lift: 0.004, whole: true });
    }
    if (this.arrows && state.sensor) this.arrows.draw("lines", scene, { wide: 2, lift: 0.02, whole: true });
  }

  drawHover(scene, theme) {
    const tint = [...rgb(theme.hover), 1];
    for (const kind of ["line", "point"]) this.body.draw(`hover ${kind}`, scene, { tint, wide: kind === "point" ? 11 : 3, lift: 0.02 });
  }

  // Ids of what is in sight, in pixels of the page: read back by `Pointer`.
  paintIds(sensors) {
    const { gl, ids } = this.ctx, w = this.stage.clientWidth, h = this.stage.clientHeight, { state, body, wire } = this;
    if (this.fresh === sensors && this.ctx.idsOf === this) return ids(w, h);
    const frame = ids(w, h), scene = { ...this.scene(w, h, 1, this.clock.phase), pick: true };
    this.begin(w, h, [0, 0, 0, 0]);
    gl.disable(gl.BLEND);
    if (body && state.model) {
      if (state.model !== "ghost") body.draw("faces", scene, { kind: 1 });
      body.draw("lines", scene, { kind: 2, wide: 5, lift: 0.0014 });
      body.draw("points", scene, { kind: 3, wide: 10, lift: 0.01 });
    }
    if (wire && state.test !== false) wire.draw("points", scene, { kind: 4, wide: 10, lift: 0.004, whole: true });
    if (this.arrows && state.sensor && sensors) this.arrows.draw("lines", scene, { kind: 5, wide: 8, lift: 0.02, whole: true });
    gl.enable(gl.BLEND);
    Object.assign(this, { fresh: sensors });
    this.ctx.idsOf = this;
    return frame;
  }

  // Where a node of a body is on the stage, in pixels of the page.
  project(body, k) {
    const { matrix: M, cos, sin } = this.drawn, { points, shape } = body, part = (name, c) => (shape && shape[name] ? shape[name][3 * k + c] * shape.step : 0);
    const p = [0, 1, 2].map((c) => points[3 * k + c] + cos * part("real", c) - sin * part("imag", c));
    const at = [0, 1].map((c) => M[c] * p[0] + M[4 + c] * p[1] + M[8 + c] * p[2] + M[12 + c]);
    return [(at[0] + 1) / 2 * this.stage.clientWidth, (1 - at[1]) / 2 * this.stage.clientHeight];
  }
}
