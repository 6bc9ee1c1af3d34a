// The samples of the selected vehicle for the last minute, in the order that `vehicle.py` writes.

export const AT = 0, MODE = 1, X = 2, Y = 3, YAW = 4, SPEED = 5, SPEED_REFERENCE = 6, LATERAL = 7,
  FORCE = 8, RATE = 9, MU = 10, MU_LOW = 11, MU_HIGH = 12, INFORMATION = 13, MU_TRUE = 14,
  TOTAL = 15, QUEUE = 16, COMPUTE = 17, MISSED = 18, WEIGHTS = 19;

export const WINDOW = 60; // s
const MOST = 620;

export class Samples {
  constructor() { this.clear(); }

  clear() { this.all = []; }

  add(rows) {
    this.all.push(...rows);
    if (this.all.length > MOST) this.all.splice(0, this.all.length - MOST);
  }

  /** Removes what is older than the window at the time `now`. */
  trim(now) {
    const first = this.all.findIndex((row) => row[AT] >= now - WINDOW);
    if (first > 0) this.all.splice(0, first);
  }

  get last() { return this.all[this.all.length - 1]; }
}
