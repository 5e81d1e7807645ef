// Elements, numbers and words. All data enters the page as text nodes.

let counter = 0;

/** Panels of other packages by name: classes that are made with the player. */
const panelKinds = new Map();
const addPanel = (name, kind) => panelKinds.set(name, kind);

/** An element; children that are strings become text. Attribute names are never data. */
function make(tag, attributes, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") node.addEventListener(name, value);
    else node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.flat().filter((one) => one !== null && one !== undefined));
  return node;
}

function svg(tag, attributes) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

/** Sets a text only where it changes, so that playing costs little and says nothing twice. */
function say(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

const ICONS = {
  play: "M6 4l14 8-14 8z",
  pause: "M6 4h4v16h-4zM14 4h4v16h-4z",
  restart: "M5 4h3v16h-3zM20 4v16l-11-8z",
  back: "M16 4v16l-11-8z",
  on: "M8 4l11 8-11 8z",
  out: "M4 10.5h16v3h-16z",
  in: "M4 10.5h6.5v-6.5h3v6.5h6.5v3h-6.5v6.5h-3v-6.5h-6.5z",
};

/** Gives a button its picture and its name. */
function dress(node, icon, name) {
  const picture = svg("svg", {viewBox: "0 0 24 24", class: "dura-icon", "aria-hidden": "true"});
  picture.append(svg("path", {d: ICONS[icon]}));
  node.replaceChildren(picture);
  node.setAttribute("aria-label", name);
  node.title = name;
}

function button(icon, name, act, attributes) {
  const node = make("button", {type: "button", click: act, ...attributes});
  dress(node, icon, name);
  return node;
}

const unique = (name) => `dura-${name}-${(counter += 1)}`;
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const words = (kind) => kind.replaceAll("_", " ");
const shorter = (text, limit) => (text.length > limit ? `${text.slice(0, limit - 1)}…` : text);

function number(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "no value";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  if (size >= 1e6 || (size > 0 && size < 1e-3)) return value.toExponential(2).replace("-", "−");
  const digits = size >= 100 ? 1 : size >= 1 ? 2 : 3;
  return String(Number(value.toFixed(digits))).replace("-", "−");
}

const counted = (count, what) => `${count} ${what}${count === 1 ? "" : "s"}`;
const seconds = (value) => `${value.toFixed(2)} s`;

/** Stretches of equal values: {from, to, value}, both ends included. */
function stretches(values) {
  const found = [];
  values.forEach((value, index) => {
    const last = found[found.length - 1];
    if (last && last.value === value) last.to = index;
    else found.push({from: index, to: index, value});
  });
  return found;
}

/** The JSON that was packed as deflate in base64. */
async function unpack(text) {
  if (typeof DecompressionStream === "undefined") {
    throw new Error("this browser cannot unpack it: it has no DecompressionStream");
  }
  const bytes = Uint8Array.from(atob(text.trim()), (one) => one.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).json();
}
