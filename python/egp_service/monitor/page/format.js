// Numbers, icons and elements.

export const STATES = ["stop", "silent", "tail", "waiting", "normal", "ended"];

export const fixed = (value, digits, unit = "") =>
  value === null || value === undefined ? "–" : value.toFixed(digits).replace(/^-(?=0(\.0*)?$)/, "").replace("-", "−") + unit;

export function age(seconds) {
  if (seconds < 0.95) return "now";
  if (seconds < 100) return `${seconds.toFixed(1)} s`;
  return `${Math.round(seconds / 60)} min`;
}

export function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

export function icon(state) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const use = document.createElementNS("http://www.w3.org/2000/svg", "use");
  svg.setAttribute("class", "icon");
  svg.setAttribute("aria-hidden", "true");
  use.setAttribute("href", `#i-${state}`);
  svg.append(use);
  return svg;
}

export const stateLabel = (state, text = state) =>
  element("span", { className: `state ${state}` }, icon(state), text);

/** Sets the text of an element only if it changes, which saves the browser a layout. */
export function say(target, text) {
  if (target.textContent !== text) target.textContent = text;
}
