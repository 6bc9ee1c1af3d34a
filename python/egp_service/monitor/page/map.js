// The map of one vehicle: road with zones of friction, driven trajectory, plan and vehicle.

import { fixed } from "./format.js";
import { prepare } from "./plots.js";
import { AT, MODE, X, Y, YAW } from "./samples.js";

const MARGIN = 38, CAR_LENGTH = 4.3, CAR_WIDTH = 1.8, FOLLOWED = 60; // px, m, m, m

export class RoadMap {
  constructor(canvas) {
    this.canvas = canvas;
    this.follow = false;
    this.setRoad(null);
  }

  setRoad(road) {
    this.road = road;
    this.zones = road ? zonesOf(road) : [];
    this.seen = road ? boundsOf([...road.left_x, ...road.right_x], [...road.left_y, ...road.right_y]) : null;
  }

  draw(rows, plan, palette) {
    const surface = prepare(this.canvas);
    const last = rows[rows.length - 1];
    if (!surface || !last) return;
    const { pen, width, height } = surface;
    const view = this.view(rows, last, width, height);
    pen.save();
    pen.setTransform(pen.getTransform().multiply(new DOMMatrix([view.scale, 0, 0, -view.scale, width / 2 - view.scale * view.x, height / 2 + view.scale * view.y])));
    const pixel = 1 / view.scale;
    this.roadway(pen, pixel, palette);
    this.trail(pen, rows, pixel, palette);
    this.plan(pen, plan, pixel, palette);
    this.car(pen, last, pixel, palette);
    pen.restore();
    this.labels(pen, view, width, height, palette);
    const words = `Map: vehicle at x ${fixed(last[X], 0)} m, y ${fixed(last[Y], 0)} m, mode ${last[MODE]}`;
    if (this.canvas.getAttribute("aria-label") !== words) this.canvas.setAttribute("aria-label", words);
  }

  view(rows, last, width, height) {
    if (this.follow) return { x: last[X], y: last[Y], scale: Math.min(width, 2 * height) / (2 * FOLLOWED) };
    const seen = this.seen ?? boundsOf(rows.map((row) => row[X]), rows.map((row) => row[Y]));
    const scale = Math.min((width - 2 * MARGIN) / Math.max(seen.width, 20), (height - 2 * MARGIN) / Math.max(seen.height, 20));
    return { x: seen.x, y: seen.y, scale };
  }

  roadway(pen, pixel, palette) {
    if (!this.road) return;
    const { left_x, left_y, right_x, right_y } = this.road;
    for (const zone of this.zones) {
      pen.fillStyle = palette.friction(zone.friction);
      pen.beginPath();
      for (let i = zone.from; i <= zone.to; i += 1) pen[i === zone.from ? "moveTo" : "lineTo"](left_x[i], left_y[i]);
      for (let i = zone.to; i >= zone.from; i -= 1) pen.lineTo(right_x[i], right_y[i]);
      pen.fill();
    }
    pen.strokeStyle = palette.soft;
    pen.lineWidth = pixel;
    for (const [xs, ys] of [[left_x, left_y], [right_x, right_y]]) {
      pen.beginPath();
      xs.forEach((x, i) => pen[i ? "lineTo" : "moveTo"](x, ys[i]));
      pen.stroke();
    }
  }

  trail(pen, rows, pixel, palette) {
    pen.strokeStyle = palette.truth;
    pen.lineWidth = 1.4 * pixel;
    pen.globalAlpha = 0.75;
    pen.beginPath();
    let before = null;
    for (const row of rows) {
      if (row[X] === null) continue;
      const jumps = !before || row[AT] - before[AT] > 1 || Math.hypot(row[X] - before[X], row[Y] - before[Y]) > 30;
      pen[jumps ? "moveTo" : "lineTo"](row[X], row[Y]);
      before = row;
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }

  plan(pen, plan, pixel, palette) {
    if (!plan.length) return;
    for (const [colour, thick] of [[palette.card, 6], [palette.c2, 3]]) {
      pen.strokeStyle = colour;
      pen.lineWidth = thick * pixel;
      pen.lineCap = "round";
      pen.beginPath();
      for (let i = 0; i < plan.length; i += 2) pen[i ? "lineTo" : "moveTo"](plan[i], plan[i + 1]);
      pen.stroke();
    }
    pen.lineCap = "butt";
  }

  car(pen, last, pixel, palette) {
    if (last[X] === null) return;
    const zoom = Math.max(1, 13 * pixel / CAR_LENGTH);
    pen.save();
    pen.translate(last[X], last[Y]);
    pen.rotate(last[YAW]);
    pen.scale(zoom, zoom);
    pen.beginPath();
    pen.moveTo(CAR_LENGTH / 2, 0);
    pen.lineTo(CAR_LENGTH / 4, CAR_WIDTH / 2);
    pen.lineTo(-CAR_LENGTH / 2, CAR_WIDTH / 2);
    pen.lineTo(-CAR_LENGTH / 2, -CAR_WIDTH / 2);
    pen.lineTo(CAR_LENGTH / 4, -CAR_WIDTH / 2);
    pen.closePath();
    pen.fillStyle = last[MODE] === "normal" ? palette.accent : palette[last[MODE]] ?? palette.stop;
    pen.fill();
    pen.strokeStyle = palette.card;
    pen.lineWidth = 1.5 * pixel / zoom;
    pen.stroke();
    pen.restore();
  }

  labels(pen, view, width, height, palette) {
    pen.font = "600 11px system-ui, 'DejaVu Sans', sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    for (const zone of this.zones) {
      const i = Math.floor((zone.from + zone.to) / 2), road = this.road;
      // Outside of the road, on the right of the direction of travel, so that it does not cover the trajectory.
      const across = [road.right_x[i] - road.left_x[i], road.right_y[i] - road.left_y[i]];
      const size = Math.hypot(...across) || 1, away = 26 / view.scale;
      const x = width / 2 + view.scale * (road.right_x[i] + across[0] / size * away - view.x);
      const y = height / 2 - view.scale * (road.right_y[i] + across[1] / size * away - view.y);
      if (x < 0 || y < 0 || x > width || y > height) continue;
      const text = `μ ${zone.friction.toFixed(2)}`, wide = pen.measureText(text).width + 8;
      pen.fillStyle = palette.card;
      pen.globalAlpha = 0.85;
      pen.fillRect(x - wide / 2, y - 8, wide, 16);
      pen.globalAlpha = 1;
      pen.fillStyle = palette.ink;
      pen.fillText(text, x, y);
    }
    this.ruler(pen, view, height, palette);
  }

  ruler(pen, view, height, palette) {
    const metres = [5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000].find((size) => size * view.scale > 60) ?? 10000;
    const long = metres * view.scale, y = height - 8.5;
    pen.strokeStyle = palette.ink;
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(4, y - 4); pen.lineTo(4, y); pen.lineTo(4 + long, y); pen.lineTo(4 + long, y - 4);
    pen.stroke();
    pen.fillStyle = palette.ink;
    pen.textAlign = "left";
    pen.fillText(`${metres} m`, 10, y - 9);
  }
}

function zonesOf(road) {
  const zones = [];
  road.friction.forEach((friction, i) => {
    const last = zones[zones.length - 1];
    if (last && Math.abs(last.friction - friction) < 1e-6) last.to = i;
    else {
      if (last) last.to = i;
      zones.push({ friction, from: i, to: i });
    }
  });
  // The last row of a closed road is its first one.
  return zones.filter((zone) => zone.to > zone.from);
}

function boundsOf(xs, ys) {
  const low = (values) => values.reduce((a, b) => (b === null ? a : Math.min(a, b)), Infinity);
  const high = (values) => values.reduce((a, b) => (b === null ? a : Math.max(a, b)), -Infinity);
  const [x0, x1, y0, y1] = [low(xs), high(xs), low(ys), high(ys)];
  return { x: (x0 + x1) / 2, y: (y0 + y1) / 2, width: x1 - x0, height: y1 - y0 };
}
