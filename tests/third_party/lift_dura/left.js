// How far the cabin still has to go.

class WayLeft {
  constructor(player) {
    this.metres = player.episode.panels.left.metres;
    this.text = make("p", {});
    this.node = make("section", {class: "dura-panel", "aria-label": "Way left"},
      make("h3", {}, "Way left"), this.text);
  }

  update(tick) {
    say(this.text, `${this.metres[Math.min(tick, this.metres.length - 1)]} m`);
  }
}

addPanel("left", WayLeft);
