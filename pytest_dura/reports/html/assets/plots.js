// Signals over time, the percept over the truth, with the cursor of the player.

const HEIGHT = 100;
const FIRST = 3; // plots shown unasked

class Plots {
  constructor(player) {
    this.player = player;
    this.episode = player.episode;
    this.curves = new Map([...this.margins(), ...this.columns()]);
    this.shown = new Map();
    this.area = make("div", {class: "dura-plots"});
    const chosen = new Set(this.proposed());
    const boxes = [...this.curves].map(([key, {label}]) => make("label", {class: "dura-check"},
      make("input", {type: "checkbox", checked: chosen.has(key),
        change: (event) => this.choose(key, event.target.checked)}), make("span", {}, label)));
    this.chooser = make("details", {class: "dura-details"},
      make("summary", {}, `Choose plots (${this.curves.size})`),
      make("fieldset", {class: "dura-choices"}, make("legend", {}, "Margins and signals to plot"),
        boxes));
    this.chosen = chosen;
    this.refresh();
    this.node = make("div", {}, this.area);
  }

  /** The margins of checks over time: below zero the check does not hold. */
  margins() {
    return (this.episode.margins ?? []).map(({formula, requirements, violated, open, values}, index) =>
      [`margin ${index}`, {
        label: `margin of ${requirements.join(", ")}`, formula, violated, open, values: column(values),
      }]);
  }

  /** The signals, each with its percept. */
  columns() {
    const {signals} = this.episode;
    return [...signals].filter(([name]) => !this.base(name)).map(([name, values]) =>
      [`signal ${name}`, {label: name, values, percept: signals.get(`percept.${name}`)}]);
  }

  /** The signal that this one is a percept of, if it is drawn there. */
  base(name) {
    const truth = name.startsWith("percept.") ? name.slice(8) : "";
    return this.episode.signals.has(truth) ? truth : "";
  }

  /** Margins of what was violated, or else the first one; then the signals that they speak of. */
  proposed() {
    const {verdicts} = this.episode;
    const margins = [...this.curves].filter(([, one]) => one.formula !== undefined);
    const violated = margins.filter(([, one]) => one.violated);
    const first = (violated.length ? violated : margins.slice(0, 1)).slice(0, FIRST);
    const ordered = [...verdicts].sort((one, other) =>
      (other.verdict === "violated") - (one.verdict === "violated"));
    const spoken = ordered.flatMap(({check}) => check.match(/[A-Za-z_][\w.]*/g) ?? [])
      .map((one) => `signal ${this.base(one) || one}`);
    const signals = [...this.curves].filter(([, one]) => one.formula === undefined);
    const twofold = signals.filter(([, one]) => one.percept).map(([key]) => key);
    const rest = [...new Set([...spoken, ...twofold, ...signals.map(([key]) => key)])]
      .filter((key) => this.curves.has(key)).slice(0, FIRST);
    return [...first.map(([key]) => key), ...rest];
  }

  choose(key, wanted) {
    if (wanted) this.chosen.add(key);
    else this.chosen.delete(key);
    this.refresh();
    this.update(this.player.tick);
  }

  refresh() {
    const wanted = [...this.chosen]; // in the order of their choice
    this.area.replaceChildren(...wanted.map((key) => {
      if (!this.shown.has(key)) this.shown.set(key, this.plot(this.curves.get(key)));
      return this.shown.get(key).node;
    }));
    if (!wanted.length) this.area.append(make("p", {class: "dura-note"}, "No plot is chosen."));
  }

  plot({label, values, percept, formula, open}) {
    const {episode} = this;
    const margin = formula !== undefined;
    const finite = [...values, ...(percept ?? []), ...(margin ? [0] : [])].filter(Number.isFinite);
    const [least, most] = [reduced(finite, Math.min), reduced(finite, Math.max)];
    const room = most > least ? (most - least) * 0.06 : Math.max(Math.abs(most), 1) * 0.5;
    const [low, high] = [least - room, most + room];
    const y = (value) => HEIGHT - ((value - low) / (high - low)) * HEIGHT;
    const text = this.inWords(label, values, percept);
    const until = typeof open === "number" ? open : -1;
    const lost = until >= 0 ? episode.share(until) * 1000 : 0;
    const pending = until < 0 ? ""
      : `; not lost before ${seconds(episode.time[until])}, and grey until then`;
    const picture = svg("svg", {viewBox: `0 0 1000 ${HEIGHT}`, preserveAspectRatio: "none",
      role: "img", "aria-label": margin ? `${text}; below zero this does not hold: ${formula}${pending}` : text});
    if (low < 0 && high > 0) {
      if (margin) {
        picture.append(svg("rect",
          {x: lost, y: y(0), width: 1000 - lost, height: HEIGHT - y(0), class: "dura-below"}));
      }
      picture.append(svg("line", {x1: 0, x2: 1000, y1: y(0), y2: y(0), class: "dura-zero"}));
    }
    const steps = finite.every((value) => value === 0 || value === 1);
    const line = (one) => this.line(one, y, steps);
    const decided = until < 0 ? values
      : values.map((value, tick) => (tick < until ? NaN : value));
    picture.append(svg("path",
      {d: line(decided), class: margin ? "dura-marginline" : "dura-truthline"}));
    if (until >= 0) {
      const waiting = values.map((value, tick) => (tick <= until ? value : NaN));
      picture.append(svg("path", {d: line(waiting), class: "dura-openline"}));
    }
    if (percept) picture.append(svg("path", {d: line(percept), class: "dura-perceptline"}));
    const readout = make("span", {class: "dura-readout"});
    const scale = make("div", {class: `dura-yscale${most > least ? "" : " dura-level"}`, "aria-hidden": "true"},
      make("span", {}, finite.length ? number(most) : ""),
      make("span", {}, finite.length && most > least ? number(least) : ""));
    const node = row(label, readout,
      strip(this.player, "dura-plot", ...faultBlocks(episode), picture, scale,
        ...violations(episode).map((tick) => mark(episode, tick, "violated"))));
    if (margin) readout.before(make("code", {class: "dura-formula"}, shorter(formula, 80)));
    const showAt = (tick) => say(readout, (tick < until ? "not lost yet, " : "") + number(values[tick])
      + (percept ? `, perceived ${number(percept[tick])}` : ""));
    return {node, showAt};
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
    const inUnits = (values, what) => {
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
    return inUnits(truth, name) + (percept ? `; ${inUnits(percept, "perceived")}` : "");
  }

  update(tick) {
    for (const [key, {showAt}] of this.shown) if (this.chosen.has(key)) showAt(tick);
  }
}

const reduced = (values, choose) => values.reduce((one, other) => choose(one, other), values[0] ?? 0);
