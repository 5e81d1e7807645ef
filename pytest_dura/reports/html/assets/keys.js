// The keyboard.

/** What each key does, where there is something to do. */
function help({episode, view, twins}) {
  const all = [["Space K", "play or pause"], ["← →", "a tick back, on (with Shift ten)"],
    ["J L", "a second back, on"], ["V", "the violation, the next", violations(episode).length],
    ["D", "first difference", twins.list.some(({difference}) => difference)],
    ["P N", "previous, next event", episode.events.length], ["Home End", "begin, end"],
    [", .", "slower, faster"], ["+ −", "zoom", view], ["F", "camera follows or stands", view]];
  const shown = all.filter(([, , useful = true]) => useful);
  return make("p", {class: "dura-help"}, "Keys: ", shown.map(([pressing, what], index) => [
    index ? ", " : "", pressing.split(" ").map((key) => make("kbd", {}, key)), ` ${what}`]).flat(2), ".");
}

/** Acts on a key, unless the control that has the focus wants it for itself. */
function pressed(player, event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
  const kind = event.target.tagName;
  const wanted = kind === "SELECT"
    || (kind === "INPUT" && event.target.type === "checkbox" && event.key === " ")
    || ((kind === "BUTTON" || kind === "SUMMARY") && [" ", "Enter"].includes(event.key))
    || (event.target.closest?.(".dura-scroll, .dura-raw") && event.key.startsWith("Arrow"));
  if (wanted) return;
  const act = keys(player).get(event.key.length === 1 ? event.key.toLowerCase() : event.key);
  if (!act) return;
  event.preventDefault();
  act(event.shiftKey ? 10 : 1);
}

function keys(player) {
  const {episode, tick, speed, speeds} = player;
  const faster = (step) => player.setSpeed(
    speeds[clamp(speeds.indexOf(speed) + step, 0, speeds.length - 1)]);
  const ticks = episode.events.map((one) => one[0]);
  const found = violations(episode).sort((one, other) => one - other);
  const next = (to) => to !== undefined && player.jump(to);
  return new Map([
    [" ", () => player.toggle()],
    ["k", () => player.toggle()],
    ["j", () => player.jump(Math.min(tick - 1, episode.tickAt(episode.time[tick] - 1)))],
    ["l", () => player.jump(Math.max(tick + 1, episode.tickAt(episode.time[tick] + 1)))],
    ["d", () => next(player.twins.list.find(({difference}) => difference)?.difference[0])],
    ["ArrowLeft", (steps) => player.jump(tick - steps)],
    ["ArrowRight", (steps) => player.jump(tick + steps)],
    ["Home", () => player.jump(0)],
    ["End", () => player.jump(episode.last)],
    ["+", () => player.zoom(1.25)],
    ["=", () => player.zoom(1.25)],
    ["-", () => player.zoom(1 / 1.25)],
    [",", () => faster(-1)],
    [".", () => faster(1)],
    ["n", () => next(ticks.find((one) => one > tick))],
    ["p", () => next(ticks.filter((one) => one < tick).pop())],
    ["v", () => next(found.includes(tick) ? found.find((one) => one > tick) ?? found[0]
      : found.length ? turningPoint(episode).tick : undefined)],
    ["f", () => player.turnCamera()],
  ]);
}
