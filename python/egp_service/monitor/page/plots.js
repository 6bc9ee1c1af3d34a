// Curves of the last minute on canvases, without a library.

import { element, fixed, say } from "./format.js";
import { AT, MODE, WINDOW } from "./samples.js";

const LEFT = 44, RIGHT = 10, TOP = 12, BOTTOM = 20;
const DASHES = { solid: [], dash: [6, 4], dot: [2, 3] };

/** Sizes the canvas to its box in device pixels and clears it; returns null while it is hidden. */
export function prepare(canvas) {
  const width = canvas.clientWidth, height = canvas.clientHeight, scale = window.devicePixelRatio || 1;
  if (!width) return null;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

/** Hatching for periods of a mode other than normal: lines for the tail, crossed lines for a stop and what else brakes. */
export function hatch(pen, colour, crossed) {
  const tile = document.createElement("canvas");
  tile.width = tile.height = 6;
  const ink = tile.getContext("2d");
  ink.strokeStyle = colour;
  ink.lineWidth = 1;
  ink.globalAlpha = 0.55;
  ink.beginPath();
  for (const shift of [-6, 0, 6]) {
    ink.moveTo(shift, 6);
    ink.lineTo(shift + 6, 0);
    if (crossed) {
      ink.moveTo(shift, 0);
      ink.lineTo(shift + 6, 6);
    }
  }
  ink.stroke();
  return pen.createPattern(tile, "repeat");
}

function ticks(low, high) {
  const rough = (high - low) / 3, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough);
  const found = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + 1e-9 * step; value += step) found.push(value);
  return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

/**
 * One diagram. `spec` has `title`, `unit`, `range(rows, context)` as [low, high], and `layers(context)`: each layer is
 * `{kind: "line" | "band" | "stack" | "level" | "marks", name, colour, style, ...}` with functions of a row.
 */
export class Plot {
  constructor(parent, spec) {
    this.spec = spec;
    this.canvas = element("canvas");
    this.canvas.setAttribute("role", "img");
    this.legend = element("span");
    this.keys = "";
    parent.append(element("figure", {}, element("figcaption", {}, spec.title, this.legend), this.canvas));
  }

  draw(rows, now, context, palette) {
    const surface = prepare(this.canvas);
    if (!surface) return;
    const { pen, width, height } = surface;
    const [low, high] = this.spec.range(rows, context);
    const right = width - RIGHT, bottom = height - BOTTOM;
    const x = (at) => right - (now - at) / WINDOW * (right - LEFT);
    const y = (value) => bottom - (value - low) / (high - low) * (bottom - TOP);
    this.axes(pen, palette, { low, high, right, bottom, x, y, now });
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, TOP - 8, right - LEFT, bottom - TOP + 8);
    pen.clip();
    const spans = this.modes(pen, rows, x, bottom, palette);
    const layers = this.spec.layers(context);
    for (const layer of layers) this[layer.kind](pen, rows, x, y, layer, palette);
    for (const [mode, start, end] of spans) this.word(pen, mode, start, end, palette);
    pen.restore();
    this.name(layers, rows, palette);
  }

  axes(pen, palette, { low, high, right, bottom, x, y, now }) {
    pen.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    pen.fillStyle = palette.soft;
    pen.strokeStyle = palette.line;
    pen.lineWidth = 1;
    pen.setLineDash([]);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const { found, digits } = ticks(low, high);
    for (const value of found) {
      const level = Math.round(y(value)) + 0.5;
      pen.beginPath();
      pen.moveTo(LEFT, level);
      pen.lineTo(right, level);
      pen.stroke();
      pen.fillText(fixed(value, digits), LEFT - 6, level);
    }
    pen.textBaseline = "alphabetic";
    for (const ago of right - LEFT > 300 ? [60, 45, 30, 15, 0] : [60, 30, 0]) {
      pen.textAlign = ago === 0 ? "right" : ago === 60 ? "left" : "center";
      pen.fillText(ago === 0 ? "now" : `−${ago} s`, x(now - ago), bottom + 15);
    }
  }

  /** Hatches the periods that were not normal, and returns their modes with begin and end in pixels. */
  modes(pen, rows, x, bottom, palette) {
    const spans = [];
    let from = null;
    for (let i = 0; i <= rows.length; i += 1) {
      const mode = i < rows.length ? rows[i][MODE] : null;
      if (from !== null && mode !== rows[from][MODE]) {
        const start = x(rows[from][AT]) - 1, end = i < rows.length ? x(rows[i][AT]) : x(rows[i - 1][AT]) + 2;
        pen.fillStyle = palette.hatches[rows[from][MODE]] ?? palette.hatches.stop;
        pen.fillRect(start, TOP - 8, Math.max(end - start, 2), bottom - TOP + 8);
        spans.push([rows[from][MODE], start, end]);
        from = null;
      }
      if (from === null && mode !== null && mode !== "normal") from = i;
    }
    return spans;
  }

  /** Writes the mode into its time if there is room. */
  word(pen, mode, start, end, palette) {
    pen.font = "600 10.5px system-ui, 'DejaVu Sans', sans-serif";
    const wide = pen.measureText(mode).width + 6, left = Math.max(start, LEFT);
    if (end - left < wide) return;
    pen.fillStyle = palette.card;
    pen.fillRect(left, TOP + 6, wide, 14);
    pen.fillStyle = palette[mode] ?? palette.stop;
    pen.textAlign = "left";
    pen.fillText(mode, left + 3, TOP + 17);
  }

  /** Calls `each(row, begins)` for rows with a value; `begins` is true after a gap. */
  static runs(rows, value, each) {
    let last = null;
    for (const row of rows) {
      if (value(row) === null) { last = null; continue; }
      each(row, last === null || row[AT] - last > 1);
      last = row[AT];
    }
  }

  line(pen, rows, x, y, layer, palette) {
    pen.strokeStyle = palette[layer.colour];
    pen.lineWidth = layer.width ?? 1.8;
    pen.setLineDash(DASHES[layer.style ?? "solid"]);
    pen.beginPath();
    Plot.runs(rows, layer.value, (row, begins) => {
      if (begins) pen.moveTo(x(row[AT]), y(layer.value(row)));
      else pen.lineTo(x(row[AT]), y(layer.value(row)));
    });
    pen.stroke();
    pen.setLineDash([]);
  }

  /** Fills between two values; where `faint(row)` holds, only an outline remains. */
  band(pen, rows, x, y, layer, palette) {
    pen.fillStyle = palette[layer.colour];
    let run = [];
    const fill = () => {
      if (run.length > 1) {
        pen.globalAlpha = layer.faint(run[0]) ? 0.1 : 0.32;
        pen.beginPath();
        run.forEach((row, i) => pen[i ? "lineTo" : "moveTo"](x(row[AT]), y(layer.high(row))));
        for (let i = run.length - 1; i >= 0; i -= 1) pen.lineTo(x(run[i][AT]), y(layer.low(run[i])));
        pen.fill();
        pen.globalAlpha = 1;
      }
    };
    Plot.runs(rows, layer.low, (row, begins) => {
      if (begins) { fill(); run = []; }
      const turns = run.length && layer.faint(row) !== layer.faint(run[0]);
      run.push(row);
      if (turns) { fill(); run = [row]; }
    });
    fill();
  }

  /** Areas on top of one another, from `values(row)`. */
  stack(pen, rows, x, y, layer, palette) {
    const known = rows.filter((row) => layer.values(row).length);
    layer.names.forEach((_, part) => {
      const sum = (row, end) => layer.values(row).slice(0, end).reduce((total, value) => total + (value ?? 0), 0);
      pen.fillStyle = palette[layer.colours[part]];
      pen.beginPath();
      known.forEach((row, i) => pen[i ? "lineTo" : "moveTo"](x(row[AT]), y(sum(row, part + 1))));
      for (let i = known.length - 1; i >= 0; i -= 1) pen.lineTo(x(known[i][AT]), y(sum(known[i], part)));
      pen.globalAlpha = 0.85;
      pen.fill();
      pen.globalAlpha = 1;
      if (!layer.lines) return;
      pen.strokeStyle = palette.card;
      pen.lineWidth = 1;
      pen.stroke();
    });
  }

  level(pen, rows, x, y, layer, palette) {
    if (layer.at === null) return;
    pen.strokeStyle = palette[layer.colour];
    pen.lineWidth = layer.width ?? 1.5;
    pen.setLineDash(DASHES[layer.style ?? "dash"]);
    pen.beginPath();
    pen.moveTo(LEFT, y(layer.at));
    pen.lineTo(4000, y(layer.at));
    pen.stroke();
    pen.setLineDash([]);
  }

  /** Crosses at the top for rows where `when(row)` holds. */
  marks(pen, rows, x, y, layer, palette) {
    pen.strokeStyle = palette[layer.colour];
    pen.lineWidth = 1.6;
    pen.beginPath();
    for (const row of rows) {
      if (!layer.when(row)) continue;
      const at = x(row[AT]);
      pen.moveTo(at - 3, TOP - 5); pen.lineTo(at + 3, TOP + 1);
      pen.moveTo(at - 3, TOP + 1); pen.lineTo(at + 3, TOP - 5);
    }
    pen.stroke();
  }

  /** Shows the legend with the newest values, which is also the text for screen readers. */
  name(layers, rows) {
    const last = rows[rows.length - 1];
    const parts = layers.flatMap((layer) => layer.kind === "stack"
      ? layer.names.map((name, i) => ({ name, colour: layer.colours[i], style: "area", text: fixed(last ? layer.values(last)[i] ?? null : null, layer.digits, layer.unit) }))
      : layer.name ? [{ name: layer.name, colour: layer.colour, style: layer.kind === "band" ? "area" : layer.style ?? (layer.kind === "level" ? "dash" : ""), text: layer.text?.(last) ?? "" }] : []);
    const keys = JSON.stringify(parts.map(({ name, colour, style }) => [name, colour, style]));
    if (keys !== this.keys) {
      this.keys = keys;
      this.values = parts.map(() => element("b"));
      this.legend.replaceChildren(...parts.map((part, i) => {
        const sample = element("i", { className: part.style });
        sample.style.setProperty("--k", `var(--${part.colour})`);
        return element("span", { className: "key" }, sample, part.name, this.values[i]);
      }));
    }
    parts.forEach((part, i) => say(this.values[i], part.text));
    const words = `${this.spec.title}: ${parts.map((part) => `${part.name} ${part.text}`).join(", ")}`;
    if (this.canvas.getAttribute("aria-label") !== words) this.canvas.setAttribute("aria-label", words);
  }
}
