"use strict";
// Draws each figure as it comes near, all of them before printing; runs the tabs and the contents.
(() => {
  const PAPER = 686; // px at 96 dpi: the text width of an A4 page
  const figures = [...document.querySelectorAll("[data-plot], [data-view]")];
  const plotData = [...document.querySelectorAll("script.plot-data")];
  const modelData = [...document.querySelectorAll("script.model-data")];
  const viewData = [...document.querySelectorAll("script.view-data")];
  const drawn = new Set(), near = new Set();
  // Diagrams side by side keep 230 px each; a narrow window scrolls over them.
  const abreast = (layout) => new Set(Object.keys(layout).filter((k) => /^xaxis/.test(k)).map((k) => (layout[k].domain || [0])[0])).size;
  const widthOf = (div, layout) => Math.max(div.parentElement.clientWidth, abreast(layout) > 1 ? 230 * abreast(layout) : 200);

  // The library is text until the first diagram is near: the page can be read before.
  function library() {
    if (window.Plotly) return;
    const script = document.createElement("script");
    script.textContent = document.getElementById("plotly").textContent;
    document.head.append(script);
  }

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;

  // Many curves over one abscissa travel packed; one broken line draws them.
  function unfold(trace) {
    const packed = trace.meta && trace.meta.q && trace.meta;
    if (!packed) return;
    const x = new Float32Array(bytes(packed.x)), q = new Int16Array(bytes(packed.q)), k = x.length, n = q.length / k;
    trace.x = new Float32Array(n * (k + 1));
    trace.y = new Float32Array(n * (k + 1)).fill(NaN);
    for (let c = 0; c < n; c++) {
      trace.x.set(x, c * (k + 1));
      trace.x[c * (k + 1) + k] = x[k - 1];
      for (let i = 0; i < k; i++) trace.y[c * (k + 1) + i] = q[c * k + i] * packed.peak / 32767;
    }
    delete trace.meta;
  }

  // The data of a figure: two columns a curve, with its errors where it has any; a matrix as one.
  function columns(div) {
    const named = (id) => div.layout[id.replace(/[xy]/, "$&axis")] || {};
    const title = (trace, axis) => {
      const own = named(trace[`${axis}axis`]);
      return own.title?.text || (own.matches && named(own.matches).title?.text) || axis;
    };
    const out = [];
    for (const t of div._fullData) {
      const x = Array.from(t.x || []), y = Array.from(t.y || []);
      if (t.type === "heatmap") out.push([title(t, "y"), ...y], ...x.map((name, k) => [name, ...Array.from(t.z, (row) => row[k])]));
      else if (x.some((v) => v !== null) || y.length > 1) {
        out.push([`${title(t, "x")} (${t.name})`, ...x], [`${title(t, "y")} (${t.name})`, ...y]);
        for (const axis of ["x", "y"]) if (t[`error_${axis}`]?.array) out.push([`± ${title(t, axis)} (${t.name})`, ...t[`error_${axis}`].array]);
      }
    }
    return out;
  }

  function csv(div) {
    const cell = (v) => (v === undefined || v === null || Number.isNaN(v) ? "" : typeof v === "number" ? String(+v.toPrecision(7)) : /[",\n]/.test(v) ? `"${String(v).replaceAll('"', '""')}"` : String(v));
    const data = columns(div), rows = Math.max(...data.map((c) => c.length));
    return Array.from({ length: rows }, (_, k) => data.map((c) => cell(c[k])).join(",")).join("\r\n") + "\r\n";
  }

  // Buttons with words: what each saves is seen.
  function config() {
    const icon = (text) => ({ svg: `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 30 16"><text x="15" y="13" text-anchor="middle" font-size="14" font-family="sans-serif">${text}</text></svg>` });
    const button = (name, title, click) => ({ name, title, icon: icon(name), click });
    const image = (format) => async (div) => {
      const { width, height } = div._fullLayout, address = await Plotly.toImage(div, { format, width, height, scale: format === "png" ? 3 : 1 });
      ringtrueViewer.save(div, format, await (await fetch(address)).blob());
    };
    return {
      displaylogo: false, responsive: false, displayModeBar: true,
      modeBarButtons: [["zoom2d", "pan2d", "resetScale2d"], [
        button("PNG", "Save as PNG", image("png")), button("SVG", "Save as SVG, to be edited", image("svg")),
        button("CSV", "Save the data", (div) => ringtrueViewer.save(div, "csv", new Blob(["\ufeff", csv(div)], { type: "text/csv" }))),
      ]],
    };
  }

  // Numbers stand in the cells of a heat map where these are wide enough for them: 15 px, beside 130 px of labels and scale.
  const numbered = (trace, width) => (width - 130 >= 15 * trace.x.length ? "%{text}" : "");
  const withNumbers = (data) => data.flatMap((t, i) => (t.type === "heatmap" && t.text ? [i] : []));

  // On paper a figure is flatter (heat maps keep their height), and in two columns it has half the width.
  function sizeOf(div, spec, paper) {
    const height = div.ringtrueHeight, narrow = div.closest(".columns");
    if (!paper) return { width: widthOf(div, spec.layout), height };
    const flat = !narrow && !spec.data.some((t) => t.type === "heatmap");
    return { width: narrow ? (PAPER - 34) / 2 : PAPER, height: Math.round(height * (flat ? 0.82 : 1)) };
  }

  function drawPlot(div, paper) {
    library();
    const spec = JSON.parse(plotData[+div.dataset.plot].textContent);
    spec.data.forEach(unfold);
    div.ringtrueHeight = spec.layout.height;
    const size = sizeOf(div, spec, paper);
    Object.assign(spec.layout, size);
    for (const i of withNumbers(spec.data)) spec.data[i].texttemplate = numbered(spec.data[i], size.width);
    div.style.height = `${size.height}px`;
    Plotly.newPlot(div, spec.data, spec.layout, config());
  }

  function drawView(div) {
    const data = JSON.parse(viewData[+div.dataset.view].textContent);
    const { model } = data.scene;
    if (model) data.scene.model = JSON.parse(modelData[model.at].textContent);
    ringtrueViewer.figure(div, data);
  }

  function draw(div, paper = false) {
    if (drawn.has(div)) return;
    drawn.add(div);
    near.delete(div);
    seen.unobserve(div);
    if (div.dataset.plot !== undefined) drawPlot(div, paper);
    else drawView(div);
    window.ringtrueDrawn = drawn.size;
  }

  // One figure at a time, so that the page stays usable.
  function drawNear() {
    const [div] = near;
    if (!div) return;
    draw(div);
    setTimeout(drawNear, 0);
  }

  const seen = new IntersectionObserver((entries) => {
    const idle = near.size === 0;
    for (const e of entries) {
      if (e.isIntersecting) near.add(e.target);
      else near.delete(e.target);
    }
    if (idle) setTimeout(drawNear, 0);
  }, { rootMargin: "400px 0px" });

  function fit(paper) {
    for (const div of drawn) {
      if (div.dataset.plot === undefined || !(paper || div.parentElement.clientWidth)) continue;
      const { width, height } = sizeOf(div, div, paper);
      if (Math.abs(width - div._fullLayout.width) < 2 && height === div._fullLayout.height) continue;
      div.style.height = `${height}px`;
      const cells = withNumbers(div.data);
      if (cells.length) Plotly.restyle(div, { texttemplate: cells.map((i) => numbered(div.data[i], width)) }, cells);
      Plotly.relayout(div, { width, height });
    }
  }

  for (const tabs of document.querySelectorAll(".tabs")) {
    const buttons = [...tabs.querySelector(".tabbar").children];
    const panels = [...tabs.children].filter((c) => c.classList.contains("panel"));
    const show = (k) => {
      buttons.forEach((b, i) => b.setAttribute("aria-selected", i === k));
      panels.forEach((p, i) => p.classList.toggle("shown", i === k));
    };
    buttons.forEach((b, k) => {
      b.addEventListener("click", () => show(k));
      b.addEventListener("keydown", (e) => {
        const step = { ArrowRight: 1, ArrowLeft: -1 }[e.key];
        if (!step) return;
        const to = (k + step + buttons.length) % buttons.length;
        show(to);
        buttons[to].focus();
      });
    });
  }

  const links = new Map([...document.querySelectorAll("nav li a")].map((a) => [a.hash.slice(1), a]));
  const sections = [...document.querySelectorAll("main > section")];
  function mark() {
    const at = sections.filter((s) => s.getBoundingClientRect().top < 120).pop() || sections[0];
    for (const [id, a] of links) a.classList.toggle("here", at && id === at.id);
  }
  let queued = false;
  addEventListener("scroll", () => {
    if (queued) return;
    queued = true;
    requestAnimationFrame(() => { queued = false; mark(); });
  }, { passive: true });
  mark();

  const fold = document.getElementById("fold"), wholes = [...document.querySelectorAll("details.whole")];
  fold.addEventListener("click", () => {
    const open = fold.ariaPressed === "true";
    wholes.forEach((d) => { d.open = open; });
    fold.ariaPressed = !open;
    fold.textContent = open ? "Fold all sections" : "Unfold all sections";
  });
  // report.html#short opens the short report.
  const short = document.getElementById("short");
  function shorten(on) {
    document.body.classList.toggle("short-report", on);
    short.ariaPressed = on;
    short.textContent = on ? "Full report" : "Short report";
    mark();
  }
  short.addEventListener("click", () => shorten(short.ariaPressed !== "true"));
  shorten(location.hash === "#short");
  for (const [id, a] of links) a.addEventListener("click", () => { document.querySelector(`#${id} > details`).open = true; });
  document.addEventListener("toggle", () => fit(false), true); // what was folded missed a resize

  let timer, folded = [];
  addEventListener("resize", () => {
    clearTimeout(timer);
    timer = setTimeout(() => fit(false), 150);
  });
  // The browser prints when this returns; Plotly and the viewer draw before they do.
  addEventListener("beforeprint", () => {
    folded = [...document.querySelectorAll("details:not([open])")];
    folded.forEach((d) => { d.open = true; });
    fit(true);
    figures.filter((div) => div.getClientRects().length).forEach((div) => draw(div, true));
    ringtrueViewer.still(PAPER);
  });
  addEventListener("afterprint", () => {
    fit(false);
    folded.forEach((d) => { d.open = false; });
    ringtrueViewer.still(0);
  });
  // report.html#pictures leaves, in place of the page, its figures in their order: each as PNG, with what its legend
  // says, and of mode shapes each mode.
  async function pictures() {
    dispatchEvent(new Event("beforeprint"));
    const found = [];
    for (const div of figures) {
      const plot = div._fullLayout, scale = 2, canvas = div.querySelector(".stage > canvas");
      const png = plot ? await Plotly.toImage(div, { format: "png", width: plot.width, height: plot.height, scale }) : canvas.toDataURL();
      const width = plot ? plot.width : div.closest(".columns") ? (PAPER - 34) / 2 : PAPER;
      const legend = [...div.querySelectorAll(".info, .legend > span")].map((e) => [
        [...e.childNodes].map((n) => (n.className === "ramp" ? "to" : n.textContent.trim())).filter(Boolean).join(" "), e.querySelector("i")?.style.backgroundColor || "",
      ]);
      const modes = [...div.querySelectorAll(".sheet > div")].map((e) => [e.textContent, e.firstChild.toDataURL()]);
      found.push({ png, width, legend: legend.filter(([text]) => text), modes });
    }
    document.documentElement.innerHTML = "<pre id=pictures></pre>";
    document.getElementById("pictures").textContent = JSON.stringify(found);
  }
  if (location.hash === "#pictures") pictures();
  window.ringtrueDrawn = 0;
  figures.forEach((div) => seen.observe(div));
})();
