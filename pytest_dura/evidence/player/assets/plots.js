// Signals over time, the percept over the truth, with the cursor of the player.

const HEIGHT = 100;
const FIRST = 3; // plots shown unasked

class Plots {
  constructor(player) {
    this.player = player;
    this.episode = player.episode;
    const {signals} = this.episode;
    this.names = [...signals.keys()].filter((name) => !this.base(name));
    this.shown = new Map();
    this.area = make("div", {class: "dura-plots"});
    const chosen = new Set(this.proposed());
    const boxes = this.names.map((name) => make("label", {class: "dura-check"},
      make("input", {type: "checkbox", checked: chosen.has(name),
        change: (event) => this.choose(name, event.target.checked)}), make("span", {}, name)));
    this.chooser = make("details", {class: "dura-details"},
      make("summary", {}, `Choose signals (${this.names.length})`),
      make("fieldset", {class: "dura-choices"}, make("legend", {}, "Signals to plot"), boxes));
    this.chosen = chosen;
    this.refresh();
    this.node = make("div", {}, this.area);
  }

  /** The signal that this one is a percept of, if it is drawn there. */
  base(name) {
    const truth = name.startsWith("percept.") ? name.slice(8) : "";
    return this.episode.signals.has(truth) ? truth : "";
  }

  /** What a violated requirement speaks of comes first, then what others do, then what differs. */
  proposed() {
    const {verdicts, signals} = this.episode;
    const ordered = [...verdicts].sort((one, other) =>
      (other.verdict === "violated") - (one.verdict === "violated"));
    const spoken = ordered.flatMap(({check}) => check.match(/[A-Za-z_][\w.]*/g) ?? [])
      .map((one) => this.base(one) || one);
    const twofold = this.names.filter((name) => signals.has(`percept.${name}`));
    return [...new Set([...spoken, ...twofold, ...this.names])]
      .filter((name) => this.names.includes(name)).slice(0, FIRST);
  }

  choose(name, wanted) {
    if (wanted) this.chosen.add(name);
    else this.chosen.delete(name);
    this.refresh();
    this.update(this.player.tick);
  }

  refresh() {
    const wanted = [...this.chosen]; // in the order of their choice
    this.area.replaceChildren(...wanted.map((name) => {
      if (!this.shown.has(name)) this.shown.set(name, this.plot(name));
      return this.shown.get(name).node;
    }));
    if (!wanted.length) this.area.append(make("p", {class: "dura-note"}, "No signal is chosen."));
  }

  plot(name) {
    const {episode} = this;
    const truth = episode.signals.get(name);
    const percept = episode.signals.get(`percept.${name}`);
    const finite = [...truth, ...(percept ?? [])].filter(Number.isFinite);
    const [least, most] = [reduced(finite, Math.min), reduced(finite, Math.max)];
    const room = most > least ? (most - least) * 0.06 : Math.max(Math.abs(most), 1) * 0.5;
    const [low, high] = [least - room, most + room];
    const y = (value) => HEIGHT - ((value - low) / (high - low)) * HEIGHT;
    const picture = svg("svg", {viewBox: `0 0 1000 ${HEIGHT}`, preserveAspectRatio: "none",
      role: "img", "aria-label": this.inWords(name, truth, percept)});
    if (low < 0 && high > 0) {
      picture.append(svg("line", {x1: 0, x2: 1000, y1: y(0), y2: y(0), class: "dura-zero"}));
    }
    const steps = finite.every((value) => value === 0 || value === 1);
    const line = (values) => this.line(values, y, steps);
    picture.append(svg("path", {d: line(truth), class: "dura-truthline"}));
    if (percept) picture.append(svg("path", {d: line(percept), class: "dura-perceptline"}));
    const readout = make("span", {class: "dura-readout"});
    const scale = make("div", {class: `dura-yscale${most > least ? "" : " dura-level"}`, "aria-hidden": "true"},
      make("span", {}, finite.length ? number(most) : ""),
      make("span", {}, finite.length && most > least ? number(least) : ""));
    const node = row(name, readout,
      strip(this.player, "dura-plot", ...faultBlocks(episode), picture, scale,
        ...violations(episode).map((tick) => mark(episode, tick, "violated"))));
    const told = (tick) => say(readout, number(truth[tick])
      + (percept ? `, perceived ${number(percept[tick])}` : ""));
    return {node, told};
  }

  line(values, y, steps) {
    const {episode} = this;
    let path = "";
    let before = null;
    values.forEach((value, tick) => {
      if (!Number.isFinite(value)) {
        before = null;
        return;
      }
      const [across, down] = [(episode.share(tick) * 1000).toFixed(1), y(value).toFixed(1)];
      if (before === null) path += `M${across} ${down}h0.01`;
      else path += steps ? `H${across}V${down}` : `L${across} ${down}`;
      before = down;
    });
    return path;
  }

  inWords(name, truth, percept) {
    const told = (values, what) => {
      let [least, most] = [-1, -1];
      values.forEach((value, tick) => {
        if (!Number.isFinite(value)) return;
        if (least < 0 || value < values[least]) least = tick;
        if (most < 0 || value > values[most]) most = tick;
      });
      if (least < 0) return `${what}: no value`;
      const at = (tick) => `${number(values[tick])} at ${seconds(this.episode.time[tick])}`;
      return `${what}: least ${at(least)}, greatest ${at(most)}`;
    };
    return told(truth, name) + (percept ? `; ${told(percept, "perceived")}` : "");
  }

  update(tick) {
    for (const [name, {told}] of this.shown) if (this.chosen.has(name)) told(tick);
  }
}

const reduced = (values, choose) => values.reduce((one, other) => choose(one, other), values[0] ?? 0);
