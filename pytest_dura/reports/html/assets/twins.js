// The twins: the same seed without something, and where they part from this run.

const PARTED = new Map([
  [0, {word: "the same", look: "silent", letter: ""}],
  [1, {word: "differs", look: "parted", letter: "D"}],
  [2, {word: "acts otherwise", look: "acted", letter: "A"}],
  [3, {word: "has ended", look: "ended", letter: ""}],
]);

class Twins {
  constructor(player) {
    this.player = player;
    this.list = player.episode.twins.filter(({id}) => id);
    this.node = player.episode.twins.length ? this.build(player) : null;
  }

  build(player) {
    const {episode} = player;
    return make("section", {class: "dura-panel dura-twinpanel", "aria-label": "Same seed"},
      make("h3", {}, "The same seed"),
      make("ul", {}, episode.twins.map((twin) => make("li", {},
        make("strong", {}, twin.label), `: ${twinInWords(episode, twin)} `,
        twin.difference ? make("button", {type: "button",
          click: () => player.jump(twin.difference[0])},
        `First difference ${twin.label}, at ${seconds(episode.time[twin.difference[0]])}`) : null))));
  }

  /** Rows that say when each twin was still the same. */
  lanes() {
    const {player} = this;
    const {episode} = player;
    return this.list.map((twin) => {
      const [differs, acts] = [twin.difference?.[0] ?? Infinity, twin.acted?.[0] ?? Infinity];
      const values = episode.time.map((_, tick) => {
        if (twin.last !== null && tick > twin.last) return 3;
        return tick >= acts ? 2 : tick >= differs ? 1 : 0;
      });
      const marks = twin.difference ? [mark(episode, twin.difference[0], "difference")] : [];
      const lane = wordLane(player, twin.label, values, PARTED, marks);
      const showAt = lane.showAt;
      return {...lane, showAt: (tick) => showAt(tick, apartInWords(episode, twin, tick))};
    });
  }
}

/** How far its ego is from this one, in m; NaN where either is absent. */
function apart(episode, twin, tick) {
  if (!episode.scene) return NaN;
  const [own, other] = [poseAt(episode.truth.get(episode.scene.ego), tick), poseAt(twin.poses, tick)];
  return own && other ? Math.hypot(own[0] - other[0], own[1] - other[1]) : NaN;
}

function apartInWords(episode, twin, tick) {
  const far = apart(episode, twin, tick);
  return far >= 0.05 ? `, ${number(far)} m apart` : "";
}

function twinInWords(episode, {id, problem, difference, acted, ended}) {
  if (!id) return `not shown: ${problem || "it has no tick"}.`;
  const at = (tick) => seconds(episode.time[tick]);
  return [
    difference ? `differs first at ${at(difference[0])}: ${shorter(difference[1], 160)};`
      : "the same in all that was measured;",
    acted ? `acts otherwise from ${at(acted[0])} on: ${shorter(acted[1], 120)};` : null,
    `ended by ${words(ended)}.`,
  ].filter(Boolean).join(" ");
}
