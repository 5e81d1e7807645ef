// An episode as the player reads it: columns by tick, and what was where.

const POSE = 6; // x, y, heading, speed, length, width

const column = (coded) => coded.map((one) => (one === null ? NaN : Number(
  typeof one === "string" ? one.replace("inf", "Infinity") : one)));

/** A function from a decision's number to its text. */
const lookup = ({words: texts, at}) => (index) => texts[at[index]] ?? "";

function added(differences, scale) {
  let sum = 0;
  return differences.map((one) => (sum += one) * scale);
}

/** Things by id: poses in m, rad and m/s, NaN where a thing is absent. */
function tracks(things, ticks, truth) {
  const found = new Map();
  for (const {id, runs, same} of things) {
    const poses = new Float64Array(ticks * POSE).fill(NaN);
    for (const [start, length, width, ...columns] of runs) {
      const [x, y, heading, speed] = columns.map((one, index) =>
        added(one, index === 2 ? 0.001 : 0.01));
      x.forEach((_, index) => poses.set(
        [x[index], y[index], heading[index], speed[index], length / 100, width / 100],
        (start + index) * POSE));
    }
    for (const [start, count] of same) {
      const [low, high] = [start * POSE, (start + count) * POSE];
      poses.set(truth.get(id).subarray(low, high), low);
    }
    found.set(id, poses);
  }
  return found;
}

const poseAt = (poses, tick) => {
  const at = tick * POSE;
  return poses && !Number.isNaN(poses[at]) ? poses.subarray(at, at + POSE) : null;
};

class Episode {
  constructor(data) {
    Object.assign(this, {twins: [], panels: {}}, data);
    this.ticks = data.time.length;
    this.last = Math.max(this.ticks - 1, 0);
    this.start = data.time[0] ?? 0;
    this.end = data.time[this.last] ?? 0;
    this.marks = data.marks;
    this.signals = new Map(Object.entries(data.signals).map(([name, one]) => [name, column(one)]));
    this.texts = {};
    for (const name of ["proposed", "executed", "source"]) {
      this.texts[name] = lookup(data.decisions[name]);
    }
    for (const name of ["explanations", "reasons", "recoveries", "accounts"]) {
      this.texts[name] = lookup(data[name]);
    }
    this.decided = data.decisions.executed.at.length;
    if (data.scene) {
      this.truth = tracks(data.scene.truth, this.ticks);
      this.percept = tracks(data.scene.percept, this.ticks, this.truth);
    }
    this.twins = this.twins.map((twin) => ({...twin,
      poses: tracks([{id: "", runs: twin.runs, same: []}], this.ticks).get("")}));
  }

  /** The last tick that is not after this time. */
  tickAt(time) {
    let low = 0;
    let high = this.last;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.time[middle] <= time + 1e-9) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** Where a tick stands between begin and end, from 0 to 1. */
  share(tick) {
    return this.end > this.start ? (this.time[tick] - this.start) / (this.end - this.start) : 0;
  }

  nearest(share) {
    const time = this.start + share * (this.end - this.start);
    const tick = this.tickAt(time);
    const next = Math.min(tick + 1, this.last);
    return this.time[next] - time < time - this.time[tick] ? next : tick;
  }

  /** Ids of what is true, perceived, only perceived, and not perceived, the ego apart. */
  seen(tick) {
    const sets = {truth: [], percept: [], ghosts: [], missing: []};
    if (!this.scene) return sets;
    for (const [id, poses] of this.truth) {
      if (id === this.scene.ego || !poseAt(poses, tick)) continue;
      sets.truth.push(id);
      if (!poseAt(this.percept.get(id), tick)) sets.missing.push(id);
    }
    for (const [id, poses] of this.percept) {
      if (id === this.scene.ego || !poseAt(poses, tick)) continue;
      sets.percept.push(id);
      if (!poseAt(this.truth.get(id), tick)) sets.ghosts.push(id);
    }
    return sets;
  }

  /** How far the ego's believed pose is from its true one, in m; 0 where either is unknown. */
  astray(tick) {
    if (!this.scene) return 0;
    const truth = poseAt(this.truth.get(this.scene.ego), tick);
    const believed = poseAt(this.percept.get(this.scene.ego), tick);
    return truth && believed ? Math.hypot(truth[0] - believed[0], truth[1] - believed[1]) : 0;
  }

  /** The scene in words. */
  described(tick) {
    if (!this.scene) return "";
    const {truth, ghosts, missing} = this.seen(tick);
    const ego = poseAt(this.truth.get(this.scene.ego), tick);
    const list = (ids) => ids.slice(0, 12).map((id) => shorter(id, 40)).join(", ")
      + (ids.length > 12 ? ` and ${ids.length - 12} more` : "");
    const parts = [];
    if (ego) {
      parts.push(`${shorter(this.scene.ego, 40)} at (${number(ego[0])}, ${number(ego[1])}) m, `
        + `${number(ego[3])} m/s.`);
      let [closest, least] = [null, Infinity];
      for (const id of truth) {
        const pose = poseAt(this.truth.get(id), tick);
        const far = Math.hypot(pose[0] - ego[0], pose[1] - ego[1]);
        if (far < least) [closest, least] = [id, far];
      }
      parts.push(truth.length ? `${counted(truth.length, "other")}: ${list(truth)}.` : "Nothing else.");
      if (closest) {
        parts.push(`Nearest: ${shorter(closest, 40)}, centre ${number(least)} m away.`);
      }
    }
    if (ghosts.length) parts.push(`Ghosts: ${list(ghosts)}.`);
    if (missing.length) parts.push(`Not perceived: ${list(missing)}.`);
    const astray = this.astray(tick);
    if (astray > ASTRAY) parts.push(`Believes to be ${number(astray)} m away from there.`);
    return parts.join(" ");
  }
}

const ASTRAY = 0.1; // m beyond which the believed pose is worth showing
