// Other episodes beside this one, at the same time before their violation.

const MOST_BESIDE = 3;

/** The tick that an episode is about, and its name: the worst violation, or else the end. */
function turningPoint(episode) {
  const worst = episode.verdicts.find(({verdict, tick}) => verdict === "violated" && tick !== null);
  return worst ? {tick: worst.tick, what: `violation of ${shorter(worst.requirement, 40)}`}
    : {tick: episode.last, what: "end"};
}

class Companion {
  constructor(player, episode) {
    [this.player, this.episode] = [player, episode];
    this.view = new View(episode);
    this.anchor = episode.time[turningPoint(episode).tick];
    this.clock = make("span", {class: "dura-clock"});
    this.words = make("p", {class: "dura-note dura-besidewords"});
    const name = shorter(String(episode.about.id ?? "Episode"), 80);
    this.node = make("section", {class: "dura-companion", "aria-label": `Beside: ${name}`},
      make("div", {class: "dura-besidehead"}, make("h3", {}, name),
        make("button", {type: "button", click: () => player.beside.remove(this),
          "aria-label": `Remove ${name}`}, "Remove")),
      this.view.box, make("div", {}, this.clock), this.words);
  }

  /** Shows the moment as long before its violation as the player is before its own. */
  update(clock) {
    const {episode, player} = this;
    const time = this.anchor + clock - player.beside.anchor;
    const tick = episode.tickAt(clamp(time, episode.start, episode.end));
    const step = episode.time[Math.min(tick + 1, episode.last)] - episode.time[tick];
    const part = player.playing && !player.calm.matches && step > 0
      ? clamp((time - episode.time[tick]) / step, 0, 1) : 0;
    this.view.zoom = player.view.zoom;
    this.view.follow = player.view.follow;
    this.view.show = player.view.show;
    if (!player.playing) this.view.colour = null;
    this.view.draw(tick, part);
    this.tick = tick;
    const outside = time < episode.start - 1e-9 ? ", not begun"
      : time > episode.end + 1e-9 ? ", ended" : "";
    say(this.clock, `${toViolation(episode, episode.time[tick])}${outside}`);
    if (player.playing) return;
    const at = Math.min(tick, episode.decided - 1);
    say(this.words, at < 0 ? "" : `${episode.texts.executed(at)}, from ${episode.texts.source(at)}`);
    this.view.canvas.setAttribute("aria-label",
      `Beside, from above at ${seconds(episode.time[tick])}. ${episode.described(tick)}`);
  }
}

/** A time as it stands to the violation, or to the end of what violates nothing. */
function toViolation(episode, time) {
  const {tick, what} = turningPoint(episode);
  const far = time - episode.time[tick];
  if (Math.abs(far) < 1e-9) return `${seconds(time)}, at the ${what}`;
  return `${seconds(time)}, ${Math.abs(far).toFixed(2)} s ${far < 0 ? "before" : "after"} the ${what}`;
}

class Beside {
  constructor(player, others) {
    this.player = player;
    this.companions = [];
    this.anchor = player.episode.time[turningPoint(player.episode).tick] ?? 0;
    this.others = others.filter(({label}) => label !== player.episode.about.id);
    this.area = make("div", {class: "dura-beside"});
    this.node = this.others.length && player.view ? this.build() : null;
  }

  build() {
    const id = unique("beside");
    this.select = make("select", {id}, this.others.map(({label}, index) =>
      make("option", {value: index}, shorter(label, 80))));
    this.add = make("button", {type: "button", click: () => this.show()}, "Show beside");
    return make("div", {class: "dura-tools"},
      make("label", {for: id}, "Beside it"), this.select, this.add);
  }

  async show() {
    const chosen = this.others[Number(this.select.value)];
    if (this.companions.length >= MOST_BESIDE) return;
    try {
      const {packed} = chosen;
      const episode = new Episode(await unpack(typeof packed === "function" ? packed() : packed));
      if (!episode.scene || !episode.ticks) throw new Error("it has no scene");
      const companion = new Companion(this.player, episode);
      this.companions.push(companion);
      this.area.append(companion.node);
      this.changed(`${chosen.label} is beside it.`);
    } catch (error) {
      this.changed(`${chosen.label} cannot be shown: ${error.message}`);
    }
  }

  remove(companion) {
    this.companions.splice(this.companions.indexOf(companion), 1);
    companion.node.remove();
    this.changed("Removed.");
    this.add.focus();
  }

  changed(text) {
    this.add.disabled = this.companions.length >= MOST_BESIDE;
    this.player.update();
    this.player.announce(text);
  }

  update() {
    for (const companion of this.companions) companion.update(this.player.clock);
  }
}
