// What the diagrams of one vehicle show.

import { fixed } from "./format.js";
import {
  COMPUTE, FORCE, INFORMATION, LATERAL, MISSED, MU, MU_HIGH, MU_LOW, MU_TRUE, QUEUE, RATE, SPEED, SPEED_REFERENCE,
  TOTAL, WEIGHTS,
} from "./samples.js";

const INFORMED = 0.1; // nats; below, the transitions tell nothing about the friction
const COLOURS = ["c1", "c2", "c3", "c4", "c5", "c6"];

const extremes = (rows, columns) => {
  let low = Infinity, high = -Infinity;
  for (const row of rows) for (const column of columns) {
    if (row[column] === null) continue;
    low = Math.min(low, row[column]);
    high = Math.max(high, row[column]);
  }
  return low > high ? [0, 0] : [low, high];
};
const symmetric = (rows, column, least) => {
  const [low, high] = extremes(rows, [column]);
  const reach = Math.max(least, -low, high) * 1.15;
  return [-reach, reach];
};
const line = (name, column, colour, digits, unit, style) => ({
  kind: "line", name, colour, style, value: (row) => row[column], text: (row) => row ? fixed(row[column], digits, unit) : "–",
});
const zero = { kind: "level", at: 0, colour: "soft", style: "solid", width: 1 };

/** The members with the largest weights, and the rest together, as the parts of a stack. */
function weightParts(context) {
  const { members, last } = context;
  const order = members.map((_, i) => i);
  const shown = order.length <= COLOURS.length ? order
    : order.sort((a, b) => (last?.[WEIGHTS][b] ?? 0) - (last?.[WEIGHTS][a] ?? 0)).slice(0, COLOURS.length - 1).sort((a, b) => a - b);
  const names = shown.map((i) => members[i]);
  const rest = members.length > shown.length;
  return {
    kind: "stack", lines: true, digits: 2, names: rest ? [...names, "others"] : names, colours: COLOURS,
    values: (row) => {
      if (!row[WEIGHTS].length) return [];
      const values = shown.map((i) => row[WEIGHTS][i]);
      return rest ? [...values, 1 - values.reduce((sum, value) => sum + value, 0)] : values;
    },
  };
}

const share = (row) => (row[TOTAL] === null ? [] : [row[QUEUE], row[COMPUTE], Math.max(0, row[TOTAL] - row[QUEUE] - row[COMPUTE])]);

export const DIAGRAMS = [
  {
    title: "Grip (pale if uninformed)",
    range: (rows) => [0, Math.max(1.3, extremes(rows, [MU_HIGH, MU_TRUE])[1]) * 1.04],
    layers: () => [
      { kind: "band", name: "90 % interval", colour: "c1", low: (row) => row[MU_LOW], high: (row) => row[MU_HIGH],
        faint: (row) => row[INFORMATION] === null || row[INFORMATION] < INFORMED,
        text: (row) => row && row[MU_LOW] !== null ? `${fixed(row[MU_LOW], 2)}–${fixed(row[MU_HIGH], 2)}` : "–" },
      line("mean", MU, "c1", 2),
      line("true", MU_TRUE, "truth", 2, "", "dash"),
    ],
  },
  { title: "Weights of the members", range: () => [0, 1], layers: (context) => [weightParts(context)] },
  {
    title: "Step time against deadline, ms",
    range: (rows, { deadline }) => [0, Math.max(deadline * 1.15, Math.min(extremes(rows, [TOTAL])[1], deadline * 3))],
    layers: ({ deadline }) => [
      { kind: "stack", digits: 1, names: ["queue", "compute", "network, client"], colours: ["c2", "c1", "c6"], values: share },
      { kind: "level", name: "deadline", at: deadline, colour: "stop", style: "dash", text: () => fixed(deadline, 0) },
      { kind: "marks", name: "", colour: "stop", when: (row) => row[MISSED] },
    ],
  },
  { title: "Lateral error, m", range: (rows) => symmetric(rows, LATERAL, 0.1), layers: () => [zero, line("left positive", LATERAL, "c1", 3)] },
  {
    title: "Speed, m/s",
    range: (rows) => { const [low, high] = extremes(rows, [SPEED, SPEED_REFERENCE]); return [Math.min(0, low), Math.max(5, high * 1.08)]; },
    layers: () => [line("vehicle", SPEED, "c1", 1), line("reference", SPEED_REFERENCE, "truth", 1, "", "dash")],
  },
  { title: "Force command, kN", range: (rows) => symmetric(rows, FORCE, 1000).map((value) => value / 1000),
    layers: () => [zero, { ...line("force", FORCE, "c1", 0), value: (row) => (row[FORCE] === null ? null : row[FORCE] / 1000), text: (row) => row ? fixed(row[FORCE] === null ? null : row[FORCE] / 1000, 2) : "–" }] },
  { title: "Steering rate command, rad/s", range: (rows) => symmetric(rows, RATE, 0.1), layers: () => [zero, line("rate", RATE, "c1", 3)] },
];
