// Small parts that views and figures share.
export const make = (tag, props = {}, ...inside) => {
  const e = Object.assign(document.createElement(tag), props);
  e.append(...inside);
  return e;
};

// A shape as 16-bit parts of its largest component.
export function quantised(shape) {
  if (shape.peak !== undefined) return shape;
  const { real, imag } = ArrayBuffer.isView(shape) ? { real: shape } : shape;
  let peak = 0;
  for (const part of [real, imag]) if (part) for (const v of part) peak = Math.max(peak, Math.abs(v) || 0);
  const parts = (values) => values && Int16Array.from(values, (v) => Math.round(v / (peak || 1) * 32767));
  return { peak: peak || 1, real: parts(real), imag: parts(imag) };
}

export function extremes(values) {
  let low = Infinity, high = -Infinity;
  for (const v of values) {
    if (v < low) low = v;
    if (v > high) high = v;
  }
  return low <= high ? [low, high] : [0, 1];
}

export function nearestTo(points, p) {
  let least = Infinity, best = 0;
  for (let k = 0; k < points.length; k += 3) {
    const d = (points[k] - p[0]) ** 2 + (points[k + 1] - p[1]) ** 2 + (points[k + 2] - p[2]) ** 2;
    if (d < least) { least = d; best = k / 3; }
  }
  return best;
}

// Saves a file named after the figure: figure-12.png.
export function save(element, ending, blob) {
  const caption = element.closest("figure")?.querySelector("figcaption b"), link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = `${caption ? caption.textContent.toLowerCase().replace(/\s+/g, "-") : "view"}.${ending}`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
