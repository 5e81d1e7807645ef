// Rows over time: faults, who was in control, what each monitor states, and events.

const FLAGS = new Map([
  [0, {word: "safe", look: "safe", letter: ""}],
  [1, {word: "warning", look: "warning", letter: "W"}],
  [2, {word: "unsafe", look: "unsafe", letter: "U"}],
  [-1, {word: "not asked", look: "silent", letter: ""}],
]);
const SOURCES = new Map([
  ["proposal", {word: "proposal", look: "proposal", letter: ""}],
  ["recovery", {word: "recovery", look: "recovery", letter: "R"}],
  ["fallback", {word: "fallback", look: "fallback", letter: "F"}],
]);

/** A strip as long as the episode: a press or a drag on it goes to that time. */
function strip(player, name, ...children) {
  const cursor = make("div", {class: "dura-cursor"});
  const node = make("div", {class: `dura-strip ${name}`}, ...children, cursor);
  player.cursors.push(cursor);
  const go = (event) => {
    const box = node.getBoundingClientRect();
    const share = box.width ? (event.clientX - box.left) / box.width : 0;
    player.jump(player.episode.nearest(clamp(share, 0, 1)));
  };
  node.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    node.setPointerCapture(event.pointerId);
    go(event);
  });
  node.addEventListener("pointermove", (event) => {
    if (node.hasPointerCapture(event.pointerId)) go(event);
  });
  return node;
}

function row(label, readout, track) {
  return make("div", {class: "dura-row"},
    make("div", {class: "dura-label"}, make("span", {class: "dura-name"}, label), readout), track);
}

/** A block on a strip from one tick to another. */
function block(episode, from, to, look, letter) {
  const node = make("div", {class: `dura-block dura-${look}`});
  const [start, end] = [episode.share(from), episode.share(to)];
  node.style.left = `${start * 100}%`;
  node.style.width = `${(end - start) * 100}%`;
  if (letter && end - start > 0.025) node.textContent = letter;
  return node;
}

/** A mark on a strip at a tick. */
function mark(episode, tick, look) {
  const node = make("div", {class: `dura-mark dura-${look}`});
  node.style.left = `${episode.share(tick) * 100}%`;
  return node;
}

const violations = (episode) => episode.verdicts
  .filter(({verdict, tick}) => verdict === "violated" && tick !== null).map(({tick}) => tick);
const faultBlocks = (episode) => episode.faults.map(({from, to}) => block(episode, from, to, "fault"));

/** Rows whose strips show stretches of one word; showAt() says what holds at a tick. */
function wordLane(player, label, values, known, marks = []) {
  const {episode} = player;
  const look = (value) => known.get(value)
    ?? {word: String(value), look: "other", letter: String(value).slice(0, 1)};
  const found = stretches(values).map(({from, to, value}) =>
    ({from, to: Math.min(to + 1, episode.last), ...look(value)}));
  const readout = make("span", {class: "dura-readout"});
  const blocks = found.map((one) => block(episode, one.from, one.to, one.look, one.letter));
  return {
    node: row(label, readout, strip(player, "dura-lane", ...blocks, ...marks)),
    rows: found.map(({from, to, word}) => [label, from, to, word]),
    showAt: (tick, more = "") =>
      say(readout, (tick < values.length ? look(values[tick]).word : "ended") + more),
  };
}

function faultLane(player, id, faults) {
  const {episode} = player;
  const readout = make("span", {class: "dura-readout"});
  const blocks = faults.map(({from, to}) => block(episode, from, to, "fault", "F"));
  blocks.push(...faults.flatMap((one) => one.manifested)
    .map((tick) => mark(episode, tick, "manifested")));
  return {
    node: row(id, readout, strip(player, "dura-lane", ...blocks)),
    rows: faults.flatMap(({from, to, manifested}) => [
      [id, from, to, "fault active"],
      ...manifested.map((tick) => [id, tick, tick, "fault manifested"]),
    ]),
    showAt: (tick) => {
      const here = faults.filter(({from, to}) => tick >= from && tick <= to);
      const shown = here.some(({manifested}) => manifested.some((one) => one <= tick));
      say(readout, here.length ? (shown ? "active, manifested" : "active") : "not active");
    },
  };
}

function eventLane(player) {
  const {episode} = player;
  const marks = [
    ...episode.events.map(([tick, kind]) => mark(episode, tick, eventLook(kind))),
    ...violations(episode).map((tick) => mark(episode, tick, "violation")),
  ];
  const readout = make("span", {class: "dura-readout"});
  return {
    node: row("events", readout, strip(player, "dura-lane dura-eventlane", ...marks)),
    rows: [],
    showAt: (tick) => {
      const here = episode.events.filter((one) => one[0] === tick).length;
      say(readout, here ? `${here} here` : "");
    },
  };
}

function eventLook(kind) {
  if (["collision", "critical", "infrastructure", "component_failure"].includes(kind)) return "grave";
  if (kind.startsWith("fault")) return "faulty";
  if (kind.startsWith("recovery") || kind === "halt") return "recovered";
  return "plain";
}

class Lanes {
  constructor(player) {
    const {episode} = player;
    const ids = [...new Set(episode.faults.map((one) => one.id))];
    this.lanes = ids.map((id) =>
      faultLane(player, id, episode.faults.filter((one) => one.id === id)));
    const at = episode.decisions.source;
    if (at.at.length) {
      this.lanes.push(wordLane(player, "in control", at.at.map((one) => at.words[one]), SOURCES));
    }
    this.lanes.push(...player.panels.flatMap((one) => one.lane?.() ?? []));
    for (const [monitor, flags] of Object.entries(episode.flags)) {
      this.lanes.push(wordLane(player, monitor, flags, FLAGS));
    }
    this.lanes.push(...player.twins.lanes(), eventLane(player));
    this.node = make("div", {class: "dura-lanes"}, this.lanes.map((one) => one.node));
    this.table = this.asTable(episode);
  }

  /** The same in words, made when it is opened. */
  asTable(episode) {
    const body = make("tbody");
    const rows = this.lanes.flatMap((one) => one.rows);
    const fill = () => {
      if (body.childElementCount) return;
      body.append(...rows.map(([label, from, to, word]) => make("tr", {},
        make("th", {scope: "row"}, label), make("td", {}, word),
        make("td", {}, seconds(episode.time[from])), make("td", {}, seconds(episode.time[to])))));
    };
    return make("details", {class: "dura-details", toggle: fill},
      make("summary", {}, "Faults, control and monitors as a table"),
      make("div", {class: "dura-scroll", tabindex: "0", role: "group",
        "aria-label": "Table of faults, control and monitors"},
      make("table", {}, make("thead", {}, make("tr", {},
        ["Row", "Says", "From", "To"].map((one) => make("th", {scope: "col"}, one)))), body)));
  }

  update(tick) {
    for (const one of this.lanes) one.showAt(tick);
  }
}

/** Times under the strips, at round numbers. */
function axis(episode) {
  const length = episode.end - episode.start;
  const step = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 5000]
    .find((one) => length / one <= 8) ?? length;
  const marks = [];
  const first = Math.ceil(episode.start / step);
  for (let at = first; at * step <= episode.end + 1e-9 && marks.length < 10; at += 1) {
    const node = make("span", {}, `${Number((at * step).toFixed(2))}`);
    node.style.left = `${length ? ((at * step - episode.start) / length) * 100 : 0}%`;
    marks.push(node);
  }
  return make("div", {class: "dura-row dura-axis", "aria-hidden": "true"},
    make("div", {class: "dura-label"}, "seconds"), make("div", {class: "dura-strip"}, marks));
}

/** Explains what occurs in this episode, and nothing else. */
function rowLegend({episode, plots, twins}) {
  const {faults, flags, decisions, signals, margins} = episode;
  const flagged = new Set(Object.values(flags).flat());
  const sources = decisions.source.words;
  const entries = [["margin", "margin of a check", margins.length],
    ["below", "margin below zero: it does not hold", margins.length],
    ["openline", "not lost yet", margins.some((one) => typeof one.open === "number")],
    ["line", "signal", signals.size],
    ["dashed", "as perceived", [...signals.keys()].some((name) => plots.base(name))],
    ["fault", "F fault active", faults.length],
    ["manifested", "fault manifested", faults.some((one) => one.manifested.length)],
    ["safe", "safe", flagged.has(0)], ["warning", "W warning", flagged.has(1)],
    ["unsafe", "U unsafe", flagged.has(2)], ["silent", "not asked", flagged.has(-1)],
    ["proposal", "proposal", sources.includes("proposal")],
    ["recovery", "R recovery", sources.includes("recovery")],
    ["fallback", "F fallback", sources.includes("fallback")],
    ["violation", "violation", violations(episode).length],
    ["difference", "first difference of the same seed", twins.list.some((one) => one.difference)],
    ["parted", "D differs", twins.list.some((one) => one.difference)],
    ["acted", "A acts otherwise", twins.list.some((one) => one.acted)]];
  return make("ul", {class: "dura-legend", "aria-label": "Legend of the rows"},
    entries.filter(([, , occurs]) => occurs).map(([look, label]) =>
      make("li", {}, make("span", {class: `dura-key dura-key-${look}`}), label)));
}
