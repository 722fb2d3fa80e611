"use strict";
// The diagram page: draws the figures, fills in the poles that the zoom shows, keeps the choice and moves the shape of what was clicked.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const poles = {
    f: new Float64Array(bytes(data.poles.frequency)), order: new Uint16Array(bytes(data.poles.order)), kind: new Uint8Array(bytes(data.poles.kind)),
    damping: new Float32Array(bytes(data.poles.damping)), std: new Float32Array(bytes(data.poles.std)), shape: new Int8Array(bytes(data.poles.shape)),
  };
  const modeShape = new Float32Array(bytes(data.shape));
  const channels = data.channels.length, modes = data.modes, diagram = byId("figure-0");
  const MOST = 2500, COLUMNS = 600; // marks of one kind in view; columns of the view within which poles of one order are one mark

  // ---------------------------------------------------------------- what is chosen
  const natural = (k) => modes[k].class === "natural";
  const taken = modes.map((_, k) => natural(k)), picked = new Set();
  let shown = null; // ["mode", k] or ["pole", i]
  const isShown = (kind, k) => shown !== null && shown[0] === kind && shown[1] === k;
  const isIn = (kind, k) => (kind === "mode" ? taken[k] : picked.has(k));

  function put(kind, k, on) {
    if (kind === "mode") taken[k] = on;
    else if (on) picked.add(k);
    else picked.delete(k);
    show(kind, k);
  }
  const click = (kind, k) => put(kind, k, !(isIn(kind, k) && isShown(kind, k)));

  const number = (x) => String(Number(x.toPrecision(9)));
  function text() {
    let out = "automatic = true\n";
    const entry = (kind, f, rest) => `\n[[${kind}]]\nfrequency = ${number(f)}\n${rest}`;
    modes.forEach((m, k) => { if (taken[k] && !natural(k)) out += entry("pick", m.f, `note = ${JSON.stringify(`${m.class}: ${m.remark}`)}\n`); });
    for (const i of picked) out += entry("pick", poles.f[i], `order = ${poles.order[i]}\n`);
    modes.forEach((m, k) => { if (!taken[k] && natural(k)) out += entry("reject", m.f, 'reason = "rejected on the diagram"\n'); });
    return out;
  }

  // ---------------------------------------------------------------- figures
  const config = { responsive: true, displaylogo: false, doubleClick: "reset", modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };
  const figure = data.figures[0];
  figure.layout.yaxis.fixedrange = figure.layout.yaxis2.fixedrange = true;
  const traces = (test) => figure.data.flatMap((t, i) => (test(t) ? [i] : []));
  const marks = traces((t) => t.customdata && modes.some((m) => m.class === t.legendgroup));

  // The frequencies in view, once drawn or as the figure begins.
  function view() {
    const { range, type } = (diagram._fullLayout || figure.layout).xaxis;
    return range.map((v) => (type === "log" ? 10 ** v : v));
  }

  // The poles of one kind in view: all of them, or one of those that a mark would hide.
  function inView(kind) {
    const [low, high] = view(), floor = Math.max(low, 1e-9), scale = COLUMNS / Math.log(high / floor), cells = new Set(), every = [], apart = [];
    for (let i = 0; i < poles.f.length; i++) if (poles.kind[i] === kind && poles.f[i] >= low && poles.f[i] <= high) every.push(i);
    if (every.length <= MOST) return every;
    for (const i of every) {
      const cell = Math.floor(Math.log(poles.f[i] / floor) * scale) * 65536 + poles.order[i];
      if (!cells.has(cell)) { cells.add(cell); apart.push(i); }
    }
    const step = Math.ceil(apart.length / MOST);
    return apart.filter((_, k) => k % step === 0);
  }

  // What the traces of poles hold in this view: over order, and over damping.
  function poleTraces() {
    const at = [], change = { x: [], y: [], customdata: [] };
    data.kinds.forEach((name, kind) => {
      const some = inView(kind), x = some.map((i) => poles.f[i]);
      const about = some.map((i) => [i, poles.order[i], 100 * poles.damping[i], Number.isFinite(poles.std[i]) ? poles.std[i].toExponential(1) : "unknown"]);
      for (const i of traces((t) => t.name === name)) {
        const y = about.map((a) => a[figure.data[i].yaxis === "y3" ? 2 : 1]);
        at.push(i);
        change.x.push(x);
        change.y.push(y);
        change.customdata.push(about);
      }
    });
    return [change, at];
  }

  function fillPoles() {
    const [change, at] = poleTraces();
    Plotly.restyle(diagram, change, at);
  }

  // ---------------------------------------------------------------- shape of what was clicked
  const points = data.view ? data.view.scene.test.names.length : 0;
  const shapeOf = (kind, k) => (kind === "mode" ? modeShape.subarray(2 * channels * k, 2 * channels * (k + 1))
    : poles.shape.length >= 2 * channels * (k + 1) ? Float32Array.from(poles.shape.subarray(2 * channels * k, 2 * channels * (k + 1)), (v) => v / 127) : null);

  // Real and imaginary parts (point, xyz), as the 3D viewer takes them.
  function atPoints(shape) {
    const parts = [new Float32Array(3 * points), new Float32Array(3 * points)];
    data.geometry.point.forEach((p, c) => {
      if (p < 0) return;
      for (let d = 0; d < 3; d++) for (let part = 0; part < 2; part++) parts[part][3 * p + d] += shape[2 * c + part] * data.geometry.axes[c][d];
    });
    return { real: parts[0], imag: parts[1] };
  }

  let viewer = null;
  function draw(title, info, shape) {
    const box = byId("shape");
    byId("shown").textContent = title;
    if (!shape || shape.every((v) => v === 0)) {
      if (viewer) viewer.play(false);
      if (box.classList.contains("js-plotly-plot")) Plotly.purge(box);
      viewer = null;
      box.className = "";
      box.textContent = "Its shape is not known here.";
      return;
    }
    if (!data.view) {
      const [y, im] = [0, 1].map((part) => data.channels.map((_, c) => shape[2 * c + part]));
      const bar = (values, name, color) => ({ type: "bar", x: data.channels, y: values, name, marker: { color } });
      if (!box.classList.contains("js-plotly-plot")) box.textContent = "";
      Plotly.react(box, [bar(y, "real part", "#24527a"), bar(im, "imaginary part", "#b4bec8")], data.figures[2].layout, { responsive: true, displayModeBar: false });
      return;
    }
    const mode = { stage: "test", label: title, info, test: atPoints(shape) };
    if (viewer) {
      Object.assign(viewer.list[0], mode);
      viewer.setMode();
      if (!viewer.playing) viewer.play(true);
    } else {
      box.textContent = "";
      box.className = "view";
      box.style.setProperty("--h", "300px");
      viewer = ringtrueViewer.figure(box, { ...data.view, modes: [mode] });
    }
  }

  function show(kind, k) {
    shown = [kind, k];
    const f = kind === "mode" ? modes[k].f : poles.f[k], name = kind === "mode" ? `${modes[k].class} mode` : `pole of order ${poles.order[k]}`;
    draw(`Shape: ${name}, ${Number(f.toPrecision(5))} Hz`, "", shapeOf(kind, k));
    refresh();
  }

  // Where the shown mode or pole lies, and rings around picked poles: shapes are redrawn without the poles.
  function overlay() {
    const f = shown && (shown[0] === "mode" ? modes[shown[1]].f : poles.f[shown[1]]);
    const line = { type: "line", yref: "paper", y0: 0, y1: 1, layer: "below", line: { color: "#24527a", width: 1, dash: "dot" } };
    const ring = { type: "circle", xsizemode: "pixel", ysizemode: "pixel", x0: -6, x1: 6, y0: -6, y1: 6, line: { color: "#d55e00", width: 2 } };
    const rings = [...picked].map((i) => ({ ...ring, xanchor: poles.f[i], yanchor: poles.order[i] }));
    return [...(shown ? [{ ...line, x0: f, x1: f }] : []), ...rings];
  }

  // ---------------------------------------------------------------- table
  const known = (x, digits) => (x === null ? "–" : Number(x.toPrecision(digits)).toString());
  const percent = (x, digits) => known(x === null ? null : 100 * x, digits);
  const SYMBOL = { natural: ["▼", "▽"], doubtful: ["▼", "▽"], harmonic: ["◆", "◇"] };
  const rows = modes.map((m, k) => {
    const row = document.createElement("tr"), box = document.createElement("input");
    Object.assign(box, { type: "checkbox", ariaLabel: `report the mode at ${m.f} Hz` });
    box.onclick = (e) => { e.stopPropagation(); put("mode", k, box.checked); };
    const cell = (value, left) => Object.assign(document.createElement("td"), { textContent: value, className: left ? "l" : "" });
    const first = document.createElement("td"), kind = cell("", true), mark = Object.assign(document.createElement("span"), { className: "mark" });
    mark.style.color = data.colors[m.class];
    first.append(box);
    kind.append(mark, m.class);
    row.append(first, cell(known(m.f, 6)), cell(known(m.std_f, 2)), cell(percent(m.damping, 4)), cell(percent(m.std_damping, 2)),
      cell(m.mpc === null ? "–" : m.mpc.toFixed(2)), cell(m.confidence.toFixed(2)), kind, cell(m.remark, true));
    row.onclick = () => show("mode", k);
    byId("rows").append(row);
    return { row, box, mark };
  });

  let drawnSymbols = JSON.stringify(marks.map((i) => figure.data[i].marker.symbol));
  function refresh() {
    rows.forEach(({ row, box, mark }, k) => {
      box.checked = taken[k];
      mark.textContent = SYMBOL[modes[k].class][taken[k] ? 0 : 1];
      row.className = `${isShown("mode", k) ? "shown" : ""} ${taken[k] ? "" : "out"}`;
    });
    const symbol = (t) => t.customdata.map((k, j) => t.marker.symbol[j].replace("-open", "") + (taken[k] ? "" : "-open"));
    const now = marks.map((i) => symbol(figure.data[i]));
    if (JSON.stringify(now) !== drawnSymbols) Plotly.restyle(diagram, { "marker.symbol": now }, marks);
    drawnSymbols = JSON.stringify(now);
    Plotly.relayout(diagram, { shapes: overlay() });
    const count = (kind) => modes.filter((m, k) => m.class === kind && (kind !== "natural" || taken[k])).length;
    const parts = ["natural", "doubtful", "harmonic"].map((kind) => `${count(kind)} ${kind}`);
    const extra = modes.filter((_, k) => taken[k] && !natural(k)).length + picked.size;
    byId("counts").textContent = `Modes: ${parts.join(", ")}${extra ? `; ${extra} taken up by hand` : ""}. ${data.summary}`;
    byId("choice").textContent = text();
  }

  byId("copy").onclick = () => navigator.clipboard.writeText(text());
  byId("save").onclick = () => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text()], { type: "text/plain" }));
    link.download = "choice.toml";
    link.click();
  };

  // A narrow window has the legend in more lines.
  if (innerWidth < 700) {
    figure.layout.margin.t = 120;
    config.displayModeBar = false;
  }
  const [begin, at] = poleTraces();
  at.forEach((i, k) => Object.assign(figure.data[i], { x: begin.x[k], y: begin.y[k], customdata: begin.customdata[k], hoverinfo: undefined,
    hovertemplate: `%{x:.6g} Hz ± %{customdata[3]}<br>order %{customdata[1]}, damping %{customdata[2]:.3g} %<extra>${figure.data[i].name}</extra>` }));
  Plotly.newPlot(diagram, figure.data, figure.layout, config).then(() => {
    const first = modes.findIndex((_, k) => natural(k));
    if (modes.length) show("mode", Math.max(first, 0));
    else refresh();
    diagram.on("plotly_click", (event) => {
      const about = event.points[0].customdata;
      if (about === undefined) return;
      if (!Array.isArray(about)) click("mode", about);
      else if (poles.kind[about[0]] < data.others) show("pole", about[0]); // of another estimator: shown, not taken
      else click("pole", about[0]);
    });
    diagram.on("plotly_relayout", (change) => { if (Object.keys(change).some((key) => key.startsWith("xaxis"))) fillPoles(); });
    document.documentElement.dataset.drawn = "true";
  });
  if (modes.length > 1) {
    const [map] = data.figures[1].data;
    map.showscale = false;
    if (modes.length > 14) map.texttemplate = ""; // the cells are too narrow for numbers
    Plotly.newPlot("figure-1", data.figures[1].data, data.figures[1].layout, { responsive: true, displayModeBar: false });
    byId("figure-1").on("plotly_click", (event) => show("mode", event.points[0].pointIndex[0]));
  } else byId("mac").remove();
})();
