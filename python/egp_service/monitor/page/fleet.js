// The list of vehicles, the totals, the replicas and the events.

import { STATES, age, element, fixed, icon, say, stateLabel } from "./format.js";

const PROBLEMS = new Set(["stop", "silent", "tail", "waiting"]);
const STAYS = 5000; // ms that a vehicle stays among those to look at
const CELLS = [["seen n", "seen"], ["n", "misses"], ["n", "tail"], ["n", "p99"], ["replica", ""]];

export class FleetTable {
  constructor(body, select) {
    this.body = body;
    this.rows = new Map();
    this.filter = "";
    this.selected = null;
    body.addEventListener("click", (event) => {
      const row = event.target.closest("tr");
      if (row) select(row.dataset.id);
    });
  }

  update(vehicles) {
    const ids = new Set(vehicles.map((vehicle) => vehicle.id));
    for (const [id, row] of this.rows) {
      if (ids.has(id)) continue;
      row.line.remove();
      this.rows.delete(id);
    }
    const added = vehicles.filter((vehicle) => !this.rows.has(vehicle.id));
    for (const vehicle of added) this.rows.set(vehicle.id, this.make(vehicle.id));
    let moved = added.length > 0;
    for (const vehicle of vehicles) {
      const row = this.rows.get(vehicle.id);
      this.fill(row, vehicle);
      moved = this.group(row, vehicle.state) || moved;
    }
    if (moved) this.order();
  }

  /** Puts a row into its group: 0 for vehicles to look at, 2 for ended ones; returns whether that changed. */
  group(row, state) {
    const now = performance.now();
    if (PROBLEMS.has(state)) row.problemAt = now;
    const group = state === "ended" ? 2 : now - row.problemAt < STAYS ? 0 : 1;
    const changed = group !== row.group;
    row.group = group;
    return changed;
  }

  /** Vehicles to look at come first, so that none of them is below the edge; names are in natural order. */
  order() {
    const natural = (a, b) => a[0].localeCompare(b[0], "en", { numeric: true });
    const sorted = [...this.rows].sort((a, b) => a[1].group - b[1].group || natural(a, b));
    const focused = this.body.contains(document.activeElement) ? document.activeElement : null;
    this.rows = new Map(sorted);
    this.body.append(...sorted.map(([, row]) => row.line));
    focused?.focus({ preventScroll: true });
  }

  make(id) {
    const line = element("tr", { tabIndex: -1 });
    line.dataset.id = id;
    line.setAttribute("aria-selected", String(id === this.selected));
    const state = element("td");
    const name = element("td", { className: "name", textContent: id.replace(/^default\//, ""), title: id });
    const cells = CELLS.map(([className, label]) => {
      const cell = element("td", { className });
      if (label) cell.dataset.label = label;
      return cell;
    });
    const text = element("b"), fill = element("i");
    cells[3].append(element("span", { className: "p99" }, text, element("span", { className: "bar" }, fill)));
    line.append(state, name, ...cells);
    return { line, state, cells, text, fill, shown: null, text99: null, problemAt: -Infinity, group: null };
  }

  fill(row, vehicle) {
    const { line, cells } = row;
    if (row.shown !== vehicle.state) {
      row.shown = vehicle.state;
      line.className = vehicle.state;
      row.state.replaceChildren(stateLabel(vehicle.state));
    }
    const seen = vehicle.state === "ended" ? "–" : age(vehicle.age);
    cells[0].classList.toggle("old", vehicle.state === "silent");
    say(cells[0], seen);
    say(cells[1], String(vehicle.misses));
    say(cells[2], String(vehicle.tails));
    const text = vehicle.p99 === null ? "–" : `${fixed(vehicle.p99, vehicle.p99 < 10 ? 1 : 0)} ms`;
    if (row.text99 !== text) {
      row.text99 = text;
      row.text.textContent = text;
    }
    const stated = vehicle.deadline > 0;
    const part = stated ? Math.min((vehicle.p99 ?? 0) / vehicle.deadline, 1).toFixed(2) : "0";
    const title = stated ? `deadline ${fixed(vehicle.deadline, 0)} ms` : "";
    const over = stated && vehicle.p99 > vehicle.deadline;
    if (row.bar !== part || row.over !== over || row.title !== title) {
      Object.assign(row, { bar: part, over, title });
      row.fill.style.transform = `scaleX(${part})`;
      cells[3].classList.toggle("over", over);
      cells[3].title = title;
    }
    say(cells[4], vehicle.replica || "–");
    line.hidden = this.filter !== "" && !`${vehicle.id} ${vehicle.state} ${vehicle.replica}`.toLowerCase().includes(this.filter);
  }

  get visible() { return [...this.rows.entries()].filter(([, row]) => !row.line.hidden).map(([id]) => id); }

  mark(id, focus) {
    this.rows.get(this.selected)?.line.setAttribute("aria-selected", "false");
    this.selected = id;
    for (const [other, row] of this.rows) row.line.tabIndex = other === id ? 0 : -1;
    const line = this.rows.get(id)?.line;
    line?.setAttribute("aria-selected", "true");
    if (focus) line?.focus({ preventScroll: false });
  }
}

export class Totals {
  constructor(list, filter) {
    this.items = new Map(STATES.map((state) => {
      const count = element("b", { textContent: "0" });
      const button = element("button", { type: "button", title: `Show vehicles in the state ${state}` }, icon(state), count, ` ${state}`);
      const item = element("li", { className: `state ${state} zero` }, button);
      button.addEventListener("click", () => filter(state));
      list.append(item);
      return [state, { item, count }];
    }));
  }

  update(vehicles) {
    for (const [state, { item, count }] of this.items) {
      const number = vehicles.filter((vehicle) => vehicle.state === state).length;
      say(count, String(number));
      item.classList.toggle("zero", number === 0);
    }
  }
}

export class Replicas {
  constructor(list) { this.list = list; this.cards = new Map(); }

  update(replicas) {
    const names = new Set(replicas.map((replica) => replica.name));
    for (const [name, card] of this.cards) {
      if (names.has(name)) continue;
      card.item.remove();
      this.cards.delete(name);
    }
    for (const replica of replicas) {
      const card = this.cards.get(replica.name) ?? this.make(replica.name);
      const silent = replica.state !== "serving";
      const text = silent ? `${replica.state} ${age(Math.max(replica.age, 1))}` : replica.state;
      if (card.text !== text) {
        card.text = text;
        card.item.className = replica.state;
        card.state.replaceChildren(stateLabel(replica.state, text));
      }
      say(card.facts, replica.workers === undefined ? "no load reported yet"
        : `${replica.vehicles} vehicles · ${replica.busy} of ${replica.workers} workers busy · `
          + `${replica.queued} waiting · step ${fixed(replica.step_ms, 1)} ms`);
    }
    if (!replicas.length && !this.list.firstChild) {
      this.list.append(element("li", { className: "silent", textContent: "No replica announces itself." }));
    } else if (replicas.length && this.list.firstChild?.textContent.startsWith("No replica")) {
      this.list.firstChild.remove();
    }
  }

  make(name) {
    const state = element("span"), facts = element("p", { className: "facts" });
    state.style.marginLeft = "auto";
    const item = element("li", {}, element("div", { className: "top" }, name, state), facts);
    this.list.append(item);
    const card = { item, state, facts, text: null };
    this.cards.set(name, card);
    return card;
  }
}

export function tellEvents(list, events) {
  for (const event of events) {
    const when = new Date(1000 * event.at);
    const time = element("time", { textContent: when.toLocaleTimeString("en-GB"), dateTime: when.toISOString() });
    list.prepend(element("li", {}, time, stateLabel(event.state), element("span", { textContent: `${event.kind} ${event.names}` })));
  }
  while (list.children.length > 100) list.lastChild.remove();
}
