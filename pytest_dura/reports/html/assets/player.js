// The player: time, its controls, and what follows them.

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];
const LONG = 120; // s: a longer episode begins at the least speed at which it plays no longer

/** Speeds that an episode may be played at, up to one at which it takes a few seconds. */
function speedsOf({start, end}) {
  const speeds = [...SPEEDS];
  while ((end - start) / speeds.at(-1) > LONG / 4) speeds.push(4 * speeds.at(-1));
  return speeds;
}

const LEAD = 3; // s before the violation at which an episode opens
let active = null; // the one player that plays

class Player {
  constructor(episode, options) {
    this.episode = episode;
    this.tick = 0;
    this.clock = episode.start;
    this.speeds = speedsOf(episode);
    this.speed = this.speeds.find((one) => one >= 1 && (episode.end - episode.start) / one <= LONG);
    this.playing = false;
    this.cursors = [];
    this.calm = matchMedia("(prefers-reduced-motion: reduce)");
    this.view = episode.scene && episode.ticks ? new View(episode) : null;
    const kinds = Object.keys(episode.panels).map((name) => panelKinds.get(name));
    this.decision = new Decision(episode, kinds.some((kind) => kind.hasAccount));
    this.events = new Events(this);
    this.panels = kinds.map((kind) => new kind(this));
    this.twins = new Twins(this);
    this.beside = new Beside(this, options.others?.() ?? []);
    this.lanes = new Lanes(this);
    this.plots = new Plots(this);
    this.live = make("p", {class: "dura-hidden", role: "status", "aria-live": "polite"});
    this.node = this.build(options);
    this.node.addEventListener("keydown", (event) => pressed(this, event));
    if (options.page) {
      document.addEventListener("keydown", (event) => {
        if (event.target === document.body && this.node.isConnected) pressed(this, event);
      });
    }
    // A violation of a comparison has no time: what counts there is where the twins part.
    const tick = violations(episode).length ? turningPoint(episode).tick
      : Math.min(...this.twins.list.map(({difference}) => difference?.[0] ?? Infinity));
    this.seek(Number.isFinite(tick) ? episode.tickAt(episode.time[tick] - LEAD) : 0);
  }

  build({level = 2}) {
    const {episode} = this;
    const problem = episode.problem ?? (episode.ticks ? null : "This episode has no tick.");
    return make("section", {class: "dura-player", tabindex: "-1",
      "aria-label": `Episode player: ${shorter(String(episode.about.id ?? ""), 200)}`},
    heading(episode, level),
    problem ? make("p", {class: "dura-failure"}, `No scene: ${problem}`) : null,
    make("div", {class: this.view ? "dura-body" : "dura-body dura-flat"},
      this.view ? this.stage() : null, this.beside.node ? this.beside.area : null,
      make("div", {class: "dura-drive"}, this.transport(), this.scrubRow(), help(this),
        this.beside.node, episode.verdicts.length ? verdictPanel(this) : null),
      make("div", {class: "dura-side"}, this.decision.node, this.events.node),
      make("div", {class: "dura-timeline"}, this.lanes.node, this.plots.node, axis(episode),
        rowLegend(this))),
    this.twins.node, this.plots.chooser, this.lanes.table, this.panels.map((one) => one.node),
    this.live);
  }

  stage() {
    const {view} = this;
    const toggle = (key, label) => make("label", {class: "dura-check"},
      make("input", {type: "checkbox", checked: true, change: (event) => {
        view.show[key] = event.target.checked;
        this.update();
      }}), make("span", {}, label));
    this.follow = make("input", {type: "checkbox", checked: true, change: () => this.camera()});
    const twins = this.twins.list.map((twin) => make("label", {class: "dura-check"},
      make("input", {type: "checkbox", checked: true, change: (event) => {
        twin.hidden = !event.target.checked;
        this.update();
      }}), make("span", {}, twin.label)));
    const legend = [["ego", "ego"], ...(twins.length ? [["shadow", "ego of the same seed"]] : []), ["truth", "truth"], ["percept", "percept"], ["ghost", "ghost"],
      ["missing", "not perceived"], ["route", "route"]].map(([look, label]) =>
      make("li", {}, make("span", {class: `dura-key dura-key-${look}`}), label));
    return make("div", {class: "dura-scene"}, view.box,
      make("div", {class: "dura-tools"},
        make("div", {class: "dura-group"},
          button("out", "Zoom out", () => this.zoom(1 / 1.25)),
          button("in", "Zoom in", () => this.zoom(1.25))),
        make("label", {class: "dura-check"}, this.follow, make("span", {}, "follow ego")),
        toggle("truth", "truth"), toggle("percept", "percept"), toggle("labels", "labels"), twins),
      make("ul", {class: "dura-legend", "aria-label": "Legend"}, legend));
  }

  transport() {
    this.playButton = button("play", "Play", () => this.toggle(), {class: "dura-play"});
    const select = make("select", {id: unique("speed"),
      change: (event) => this.setSpeed(Number(event.target.value))},
    this.speeds.map((one) => make("option", {value: one, selected: one === this.speed}, `${one} ×`)));
    this.speedSelect = select;
    this.clockText = make("span", {class: "dura-clock"});
    return make("div", {class: "dura-transport", role: "group", "aria-label": "Playback"},
      make("div", {class: "dura-group"},
        button("restart", "Restart", () => this.jump(0)),
        button("back", "Step back", () => this.jump(this.tick - 1)),
        this.playButton,
        button("on", "Step forward", () => this.jump(this.tick + 1))),
      make("div", {class: "dura-group"},
        make("label", {for: select.id}, "Speed"), select),
      this.clockText);
  }

  scrubRow() {
    const id = unique("scrub");
    this.scrub = make("input", {type: "range", id, min: 0, max: this.episode.last, step: 1,
      value: 0, class: "dura-scrub", input: (event) => this.jump(Number(event.target.value))});
    return make("div", {class: "dura-row dura-scrubrow"},
      make("div", {class: "dura-label"}, make("label", {for: id, class: "dura-name"}, "time")),
      this.scrub);
  }

  // Time

  play() {
    if (this.playing || this.episode.last === 0) return;
    if (active) active.pause();
    if (this.tick >= this.episode.last) this.seek(0);
    active = this;
    this.playing = true;
    this.clock = this.episode.time[this.tick];
    this.showPlaying();
    let before = performance.now();
    const frame = (now) => {
      if (!this.playing) return;
      this.clock += Math.min(Math.max(now - before, 0) / 1000, 0.25) * this.speed;
      before = now;
      if (!this.node.isConnected) this.pause();
      else if (this.clock >= this.episode.end) {
        this.seek(this.episode.last);
        this.pause();
      } else {
        this.advance();
        requestAnimationFrame(frame);
      }
    };
    requestAnimationFrame(frame);
  }

  /** Between ticks bodies move on; texts and signals change with the tick. */
  advance() {
    const {episode} = this;
    const tick = episode.tickAt(this.clock);
    const step = episode.time[Math.min(tick + 1, episode.last)] - episode.time[tick];
    const part = step > 0 && !this.calm.matches ? (this.clock - episode.time[tick]) / step : 0;
    if (tick !== this.tick) {
      this.tick = tick;
      this.update(part);
    } else if (part) {
      this.view?.draw(tick, clamp(part, 0, 1));
      this.beside.update();
    }
  }

  pause() {
    if (active === this) active = null;
    if (!this.playing) return;
    this.playing = false;
    this.showPlaying();
    this.update();
    this.announce(`Paused. ${this.inWords()}`);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  showPlaying() {
    dress(this.playButton, ...(this.playing ? ["pause", "Pause"] : ["play", "Play"]));
    this.node.toggleAttribute("data-playing", this.playing);
  }

  seek(tick) {
    this.tick = clamp(Math.round(tick) || 0, 0, this.episode.last);
    this.clock = this.episode.time[this.tick] ?? 0;
    this.update();
  }

  /** What a user asked for: playing ends, and the new tick is announced once. */
  jump(tick) {
    this.pause();
    this.seek(tick);
    this.announce(this.inWords());
  }

  setSpeed(speed) {
    this.speed = speed;
    this.speedSelect.value = String(speed);
  }

  zoom(factor) {
    if (!this.view) return;
    this.view.zoom = clamp(this.view.zoom * factor, 0.2, 8);
    this.view.draw();
    this.beside.update();
  }

  camera() {
    if (!this.view) return;
    this.view.follow = this.follow.checked;
    this.view.zoom = 1;
    this.view.draw();
    this.beside.update();
  }

  turnCamera() {
    if (!this.view) return;
    this.follow.checked = !this.follow.checked;
    this.camera();
  }

  // What follows

  update(part = 0) {
    const {episode, tick} = this;
    const at = `${episode.share(tick) * 100}%`;
    for (const cursor of this.cursors) cursor.style.left = at;
    this.node.dataset.tick = tick;
    const time = episode.time[tick] ?? 0;
    const far = violations(episode).length ? ` · ${toViolation(episode, time).split(", ")[1]}` : "";
    say(this.clockText, `${seconds(time)} of ${seconds(episode.end)} · tick ${tick}${far}`);
    this.scrub.value = tick;
    this.scrub.setAttribute("aria-valuetext", `${seconds(time)}, tick ${tick} of ${episode.last}`);
    this.decision.update(tick);
    this.events.update(tick);
    for (const one of this.panels) one.update(tick);
    this.lanes.update(tick);
    this.plots.update(tick);
    if (!this.view) return;
    if (!this.playing) this.view.colour = null; // a page may have changed its colours
    this.view.draw(tick, part);
    this.beside.update();
    this.showBadges();
    if (!this.playing) {
      this.view.canvas.setAttribute("aria-label",
        `Seen from above at ${seconds(time)}. ${episode.described(tick)}`);
    }
  }

  /** What a glance at the scene must not miss. */
  showBadges() {
    const {episode, tick, view} = this;
    const {ghosts, missing} = episode.seen(tick);
    const source = tick < episode.decided ? episode.texts.source(tick) : "";
    const found = [
      ...episode.marks.filter(([signal]) => episode.signals.get(signal)?.[tick] > 0.5)
        .map(([, event]) => ["grave", event]),
      source && source !== "proposal" ? ["recovered", `${source} in control`] : null,
      ghosts.length ? ["ghost", counted(ghosts.length, "ghost")] : null,
      missing.length ? ["plain", `${missing.length} not perceived`] : null,
    ].filter(Boolean);
    const key = found.flat().join("|");
    if (key === this.badges) return;
    this.badges = key;
    view.badges.replaceChildren(...found.map(([look, text]) =>
      make("span", {class: `dura-badge dura-badge-${look}`}, text)));
  }

  inWords() {
    const {episode, tick} = this;
    const flags = Object.entries(episode.flags).filter(([, column]) => column[tick] > 0)
      .map(([monitor, column]) => `${monitor} says ${FLAGS.get(column[tick])?.word}.`);
    return [`${seconds(episode.time[tick] ?? 0)}.`, this.decision.inWords(tick), ...flags,
      episode.described(tick)].join(" ");
  }

  /** Announced once a user rests, never while it plays. */
  announce(text) {
    clearTimeout(this.telling);
    this.telling = setTimeout(() => {
      if (!this.playing) say(this.live, shorter(text, 600));
    }, 300);
  }
}

/** Puts a player into an element; nothing is unpacked until it is opened. */
function mount(element, packed, options = {}) {
  let player = null;
  let opening = null;
  const load = async () => {
    try {
      const data = await unpack(typeof packed === "function" ? packed() : packed);
      player = new Player(new Episode(data), options);
      element.replaceChildren(player.node);
      player.view?.draw();
    } catch (error) {
      element.replaceChildren(make("p", {class: "dura-failure", role: "alert"},
        `The episode cannot be shown: ${error.message}`));
      throw error;
    }
  };
  const open = () => (opening ??= load());
  const focus = () => {
    player?.node.scrollIntoView({block: "start"});
    player?.node.focus({preventScroll: true});
  };
  if (options.open) open().then(() => options.focus && focus()).catch(() => {}); // the page says so
  else {
    element.replaceChildren(make("button", {type: "button", class: "dura-open",
      click: async () => {
        await open().catch(() => {}); // the page says so
        focus();
      }}, options.label ?? "Open the episode player"));
  }
  return {
    open,
    play: () => player?.play(),
    pause: () => player?.pause(),
    seek: (tick) => player?.jump(tick),
    focus,
    get state() {
      if (!player) return null;
      const {tick, playing, speed, episode} = player;
      return {tick, time: episode.time[tick], playing, speed, ...episode.seen(tick)};
    },
  };
}
