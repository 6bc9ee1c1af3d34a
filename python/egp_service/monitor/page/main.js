// The live page: receives the stream of events, and draws the fleet and the selected vehicle.

import { DIAGRAMS } from "./diagrams.js";
import { FleetTable, Replicas, Totals, tellEvents } from "./fleet.js";
import { age, element, fixed, say, stateLabel } from "./format.js";
import { RoadMap } from "./map.js";
import { Plot, hatch } from "./plots.js";
import { LATERAL, MU, MU_HIGH, MU_LOW, SPEED, Samples } from "./samples.js";

const get = (id) => document.getElementById(id);
const LOST_AFTER = 1000; // ms without an event of the stream
const THEMES = ["system", "light", "dark"];

/** The vehicle that the address names, FLEET/NAME; null for other marks, such as that of the list. */
function addressed() {
  try {
    const id = decodeURIComponent(location.hash.slice(1));
    return id.includes("/") ? id : null;
  } catch {
    return null; // a part of an encoded character
  }
}

let selected = addressed();
let stream = null, heard = performance.now(), lost = false, happened = 0;
let detail = null, row = null, now = 0, palette = null, drawn = false, frames = 0;

const samples = new Samples();
const table = new FleetTable(get("rows"), (id) => {
  select(id, true);
  // Below the list on screens that have no place beside it.
  if (matchMedia("(max-width: 1080px)").matches) get("detail").scrollIntoView();
});
const totals = new Totals(get("totals"), (state) => setFilter(table.filter === state ? "" : state));
const replicas = new Replicas(get("replicas"));
const map = new RoadMap(get("map"));
const plots = DIAGRAMS.map((spec) => new Plot(get("plots"), spec));
const figures = ["Speed", "Lateral error", "Grip", "p99 / deadline", "Misses in 60 s", "Tail periods", "Training range"].map((name) => {
  const value = element("dd", { textContent: "–" });
  get("figures").append(element("div", {}, element("dt", { textContent: name }), value));
  return value;
});

function connect() {
  stream?.close();
  stream = new EventSource(`events?vehicle=${encodeURIComponent(selected ?? "")}`);
  stream.onmessage = (event) => receive(JSON.parse(event.data));
}

function receive(message) {
  heard = performance.now();
  if (lost) setLost(false);
  if (message.events) {
    // A new stream begins with all events, and a restarted monitor counts from zero.
    const newest = message.events[message.events.length - 1].number;
    if (newest < happened - 1) { happened = 0; get("events").replaceChildren(); }
    tellEvents(get("events"), message.events.filter((event) => event.number >= happened));
    happened = newest + 1;
  }
  if (message.fleet) showFleet(message.fleet);
  if (message.detail && message.detail.id === selected) keepDetail(message.detail);
  if (!drawn && !document.hidden) {
    drawn = true;
    requestAnimationFrame(draw);
  }
}

function showFleet(fleet) {
  now = fleet.now;
  table.update(fleet.vehicles);
  totals.update(fleet.vehicles);
  replicas.update(fleet.replicas);
  get("empty").hidden = fleet.vehicles.length > 0;
  get("fleet").hidden = fleet.vehicles.length === 0;
  say(get("fleet-title"), fleet.vehicles.length ? `Vehicles (${fleet.vehicles.length})` : "Vehicles");
  say(get("link"), `live ${new Date().toLocaleTimeString("en-GB")}`);
  row = fleet.vehicles.find((vehicle) => vehicle.id === selected) ?? null;
  if (!row && !selected && fleet.vehicles.length) select(table.visible[0] ?? fleet.vehicles[0].id, false);
}

function keepDetail(next) {
  if (next.begin) {
    samples.clear();
    map.setRoad(null);
  }
  if (next.road) map.setRoad(next.road);
  samples.add(next.samples);
  detail = next;
}

function draw() {
  drawn = false;
  get("detail").hidden = !(detail && row);
  get("absent").hidden = !selected || Boolean(row) || table.rows.size === 0;
  if (!row) say(get("absent"), `${selected} has not published for ten minutes or at all. Choose a vehicle in the list.`);
  if (!detail || !row) return;
  samples.trim(now);
  const { all, last } = samples;
  palette ??= readPalette();
  const shown = row.state === "silent" ? `silent ${age(row.age)}` : row.state;
  say(get("name"), row.id.replace(/^default\//, ""));
  if (get("badge").textContent !== shown) get("badge").replaceChildren(stateLabel(row.state, shown));
  say(get("reason"), detail.reason || (detail.status === "solved" ? "" : detail.status));
  if (last) {
    const grip = last[MU] === null ? "–" : `${fixed(last[MU_LOW], 2)}–${fixed(last[MU_HIGH], 2)}`;
    const values = [
      fixed(last[SPEED], 1, " m/s"), fixed(last[LATERAL], 2, " m"), grip, `${fixed(row.p99, row.p99 < 10 ? 1 : 0)} / ${fixed(row.deadline, 0)} ms`,
      `${row.misses} of ${row.periods}`, String(row.tails), detail.envelope === null ? "–" : detail.envelope === 0 ? "inside" : `${fixed(detail.envelope, 2)} outside`,
    ];
    values.forEach((value, i) => say(figures[i], value));
  }
  say(get("zones"), map.road ? "road coloured by friction, trajectory, plan" : "trajectory, plan");
  map.draw(all, row.state === "silent" || row.state === "ended" ? [] : detail.plan, palette);
  const context = { members: detail.members, deadline: row.deadline, last };
  // A curve moves by less than a pixel in 0.1 s, so every other frame is enough.
  frames += 1;
  plots.forEach((plot, i) => { if ((frames + i) % 2 === 0) plot.draw(all, now, context, palette); });
}

function select(id, focus) {
  if (id !== selected || !stream) {
    selected = id;
    detail = null;
    samples.clear();
    history.replaceState(null, "", `#${encodeURIComponent(id)}`);
    connect();
  }
  table.mark(id, focus);
}

function setLost(value) {
  lost = value;
  document.body.classList.toggle("frozen", lost);
  get("alarm").hidden = !lost;
  if (!lost) return;
  say(get("alarm"), "Connection to the monitor lost. Everything below is old. Connecting again …");
  say(get("link"), "not live");
}

function readPalette() {
  const style = getComputedStyle(document.documentElement), read = (name) => style.getPropertyValue(`--${name}`).trim();
  const names = ["page", "card", "ink", "soft", "line", "accent", "normal", "tail", "stop", "silent", "waiting", "truth", "c1", "c2", "c3", "c4", "c5", "c6"];
  const colours = Object.fromEntries(names.map((name) => [name, read(name)]));
  const pen = get("map").getContext("2d");
  colours.hatches = Object.fromEntries(["tail", "stop", "waiting"].map((mode) => [mode, hatch(pen, colours[mode], mode !== "tail")]));
  const stops = [[0.1, read("ice")], [0.5, read("wet")], [1.2, read("dry")]].map(([mu, hex]) => [mu, [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16))]);
  colours.friction = (mu) => {
    const upper = Math.max(1, stops.findIndex(([at]) => at >= mu)), [[a, low], [b, high]] = mu >= 1.2 ? [stops[1], stops[2]] : [stops[upper - 1], stops[upper]];
    const part = Math.min(Math.max((mu - a) / (b - a), 0), 1);
    return `rgb(${low.map((value, i) => Math.round(value + part * (high[i] - value))).join(" ")})`;
  };
  return colours;
}

const dark = matchMedia("(prefers-color-scheme: dark)");
let theme = localStorage.getItem("egp-theme") ?? "system";
function showTheme() {
  document.documentElement.dataset.theme = theme === "system" ? (dark.matches ? "dark" : "light") : theme;
  say(get("theme"), `Theme: ${theme}`);
  palette = null;
}
function nextTheme() {
  theme = THEMES[(THEMES.indexOf(theme) + 1) % THEMES.length];
  localStorage.setItem("egp-theme", theme);
  showTheme();
}
function nextMap() {
  map.follow = !map.follow;
  get("follow").setAttribute("aria-pressed", String(map.follow));
}
function move(step) {
  const ids = table.visible, at = ids.indexOf(selected);
  const next = step === "first" ? 0 : step === "last" ? ids.length - 1 : Math.min(Math.max(at + step, 0), ids.length - 1);
  if (ids.length) select(ids[next], true);
}

const KEYS = {
  ArrowDown: () => move(1), ArrowUp: () => move(-1), Home: () => move("first"), End: () => move("last"),
  "/": () => get("filter").focus(), t: nextTheme, m: nextMap, "?": () => get("keys").showModal(),
};
document.addEventListener("keydown", (event) => {
  const typing = event.target === get("filter");
  if (event.key === "Escape" && typing) { setFilter(""); get("filter").blur(); return; }
  const scrolls = event.target === get("events");
  if (event.ctrlKey || event.metaKey || event.altKey || get("keys").open || (typing && event.key !== "ArrowDown" && event.key !== "ArrowUp") || scrolls) return;
  const action = KEYS[event.key];
  if (action) { event.preventDefault(); action(); }
});
get("filter").addEventListener("input", (event) => { table.filter = event.target.value.trim().toLowerCase(); });
function setFilter(text) {
  get("filter").value = text;
  table.filter = text;
}
get("theme").addEventListener("click", nextTheme);
get("follow").addEventListener("click", nextMap);
get("help").addEventListener("click", () => get("keys").showModal());
window.addEventListener("hashchange", () => { const id = addressed(); if (id) select(id, false); });
dark.addEventListener("change", showTheme);
setInterval(() => { if (!lost && performance.now() - heard > LOST_AFTER) setLost(true); }, 200);

showTheme();
table.mark(selected, false);
connect();
