// The scene from above, on a canvas.

const COLOURS = ["ground", "edge", "marking", "stop", "route", "ego", "body", "body-line",
  "percept", "ghost", "missing", "ink", "halo"];
const NEAR = 1; // m within which a shadow has no label of its own

const APART = 2; // m beyond which a percept has a label of its own
const SIGHT = 64; // m that the camera shows at most when it follows

class View {
  constructor(episode) {
    this.episode = episode;
    this.show = {truth: true, percept: true, labels: true};
    this.follow = true;
    this.zoom = 1;
    this.canvas = make("canvas", {role: "img", class: "dura-canvas", tabindex: "0"});
    this.badges = make("div", {class: "dura-badges", "aria-hidden": "true"});
    this.box = make("div", {class: "dura-stage"}, this.canvas, this.badges);
    const whole = this.whole();
    this.sight = Math.min(SIGHT, whole);
    this.frame = this.extent(whole);
    new ResizeObserver(() => this.draw()).observe(this.box);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.colour = null;
      this.draw();
    });
  }

  /** Metres across all that is drawn, with some room around it: a room is smaller than a road. */
  whole() {
    const [xs, ys] = [[], []];
    for (const [, x, y] of this.episode.scene.lines) {
      for (const value of added(x, 0.01)) xs.push(value);
      for (const value of added(y, 0.01)) ys.push(value);
    }
    for (const poses of this.episode.truth.values()) {
      for (let tick = 0; tick < this.episode.ticks; tick += 1) {
        const pose = poseAt(poses, tick);
        if (pose) {
          xs.push(pose[0]);
          ys.push(pose[1]);
        }
      }
    }
    const across = (values) => values.reduce((most, one) => Math.max(most, one), -Infinity)
      - values.reduce((least, one) => Math.min(least, one), Infinity);
    const metres = Math.max(across(xs), across(ys));
    return metres > 0 ? Math.max(2, 1.4 * metres) : Infinity;
  }

  /** What the fixed camera shows: the ego's way, with room around it. */
  extent(whole) {
    const [xs, ys] = [[], []];
    const poses = this.episode.truth.get(this.episode.scene.ego) || [];
    for (let tick = 0; tick < this.episode.ticks; tick += 1) {
      const pose = poseAt(poses, tick);
      if (pose) {
        xs.push(pose[0]);
        ys.push(pose[1]);
      }
    }
    if (!xs.length) return {x: 0, y: 0, size: 80};
    const [left, right] = [Math.min(...xs), Math.max(...xs)];
    const [top, bottom] = [Math.min(...ys), Math.max(...ys)];
    return {
      x: (left + right) / 2, y: (top + bottom) / 2,
      size: Math.min(Math.max(right - left, bottom - top, 20) + 24, whole),
    };
  }

  /** Draws the ticks around a moment: a tick, and how far the next one has come (0 to 1). */
  draw(tick = this.tick ?? 0, part = 0) {
    [this.tick, this.part] = [tick, part];
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [this.box.clientWidth, this.box.clientHeight];
    if (!width || !height) return;
    const [across, down] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (this.canvas.width !== across || this.canvas.height !== down) {
      [this.canvas.width, this.canvas.height] = [across, down];
    }
    this.colour ??= this.colours();
    const pen = this.canvas.getContext("2d");
    this.pen = pen;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = this.colour.ground;
    pen.fillRect(0, 0, width, height);
    const ego = this.pose(this.episode.truth.get(this.episode.scene.ego));
    const least = Math.min(width, height);
    const scale = (least / (this.follow ? this.sight : this.frame.size)) * this.zoom;
    const centre = this.follow && ego ? {x: ego[0], y: ego[1]} : this.frame;
    const ahead = this.follow && ego ? least * 0.18 : 0; // more is shown of what lies ahead
    this.look = {
      scale,
      x: width / 2 - centre.x * scale - (ahead && ahead * Math.cos(ego[2])),
      y: height / 2 - centre.y * scale - (ahead && ahead * Math.sin(ego[2])),
    };
    this.labels = [];
    this.drawLines();
    this.drawShadows(ego);
    this.drawTrail();
    this.drawThings(ego);
    this.drawLabels(width, height);
    this.drawScale(width, height);
  }

  colours() {
    const style = getComputedStyle(this.box);
    return Object.fromEntries(COLOURS.map((name) =>
      [name, style.getPropertyValue(`--dura-${name}`).trim()]));
  }

  /** A pose at the moment that is drawn. Between ticks both must be known. */
  pose(poses) {
    const now = poseAt(poses, this.tick);
    const next = this.part ? poseAt(poses, Math.min(this.tick + 1, this.episode.last)) : null;
    if (!now || !next) return now;
    const mixed = now.map((value, index) => value + (next[index] - value) * this.part);
    const turn = Math.atan2(Math.sin(next[2] - now[2]), Math.cos(next[2] - now[2]));
    mixed[2] = now[2] + turn * this.part;
    return mixed;
  }

  at(x, y) {
    return [this.look.x + x * this.look.scale, this.look.y + y * this.look.scale];
  }

  path(points) {
    this.pen.beginPath();
    points.forEach(([x, y], index) => {
      if (index) this.pen.lineTo(...this.at(x, y));
      else this.pen.moveTo(...this.at(x, y));
    });
  }

  drawLines() {
    const {pen, colour, look} = this;
    const metre = look.scale * (this.sight / SIGHT); // lines of a small place are narrower
    const styles = new Map([
      ["route", [colour.route, 1.4 * metre, []]],
      ["stop_line", [colour.stop, Math.max(2, 0.4 * metre), []]],
      ["marking", [colour.marking, Math.max(1, 0.12 * metre), [2 * metre, 2 * metre]]],
    ]);
    this.lines ??= this.episode.scene.lines.map(([kind, x, y]) => {
      const down = added(y, 0.01);
      return {kind, points: added(x, 0.01).map((one, index) => [one, down[index]])};
    }).sort((one, other) => (other.kind === "route") - (one.kind === "route"));
    pen.lineJoin = "round";
    pen.lineCap = "butt";
    for (const {kind, points} of this.lines) {
      const [stroke, width, dash] = styles.get(kind)
        ?? [colour.edge, Math.max(1.5, 0.2 * metre), []];
      pen.strokeStyle = stroke;
      pen.lineWidth = width;
      pen.setLineDash(dash);
      this.path(points);
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  drawTrail() {
    const poses = this.episode.truth.get(this.episode.scene.ego);
    const points = [];
    for (let tick = 0; tick <= this.tick; tick += 1) {
      const pose = poseAt(poses, tick);
      if (pose) points.push([pose[0], pose[1]]);
    }
    this.pen.strokeStyle = this.colour.ego;
    this.pen.lineWidth = 2;
    this.path(points);
    this.pen.stroke();
  }

  /** The ego as it is at this moment where something was left out. */
  drawShadows(ego) {
    const {pen, colour, episode} = this;
    for (const {poses, label, hidden} of episode.twins) {
      if (hidden) continue;
      const points = [];
      for (let tick = 0; tick <= this.tick; tick += 1) {
        const at = poseAt(poses, tick);
        if (at) points.push([at[0], at[1]]);
      }
      pen.strokeStyle = colour.ego;
      pen.lineWidth = 1.5;
      pen.setLineDash([3, 4]);
      this.path(points);
      pen.stroke();
      pen.setLineDash([]);
      const pose = this.pose(poses);
      if (!pose) continue;
      this.body(pose, "shadow");
      if (!ego || Math.hypot(ego[0] - pose[0], ego[1] - pose[1]) > NEAR) this.label(pose, label, "");
    }
  }

  drawThings(ego) {
    const {episode, show} = this;
    const {ghosts, missing} = episode.seen(this.tick);
    const [ghost, absent] = [new Set(ghosts), new Set(missing)];
    if (show.truth) {
      for (const [id, poses] of episode.truth) {
        const pose = this.pose(poses);
        if (!pose || id === episode.scene.ego) continue;
        this.body(pose, absent.has(id) ? "missing" : "truth");
        this.label(pose, id, absent.has(id) ? "not perceived" : "");
      }
      if (ego) {
        this.body(ego, "ego");
        this.label(ego, episode.scene.ego, "");
      }
    }
    if (!show.percept) return;
    for (const [id, poses] of episode.percept) {
      const pose = this.pose(poses);
      if (!pose) continue;
      if (id === episode.scene.ego) {
        if (show.truth && episode.astray(this.tick) <= ASTRAY) continue;
        this.body(pose, "percept");
        if (show.truth && ego) this.tie(ego, pose);
        this.label(pose, id, "believed");
        continue;
      }
      this.body(pose, ghost.has(id) ? "ghost" : "percept");
      if (ghost.has(id)) this.label(pose, id, "ghost");
      else if (!show.truth) this.label(pose, id, "perceived");
      else if (this.tie(this.pose(episode.truth.get(id)), pose) > APART) {
        this.label(pose, id, "perceived");
      }
    }
  }

  /** Ties a percept to what it is a percept of; how far they are apart, in m. */
  tie(truth, percept) {
    const apart = truth ? Math.hypot(truth[0] - percept[0], truth[1] - percept[1]) : 0;
    if (apart > ASTRAY) {
      this.pen.strokeStyle = this.colour.percept;
      this.pen.lineWidth = 1;
      this.path([truth, percept]);
      this.pen.stroke();
    }
    return apart;
  }

  /** A footprint with an arrow to where it heads. */
  body([x, y, heading, , length, width], kind) {
    const {pen, colour, look} = this;
    const [long, wide] = [Math.max(length * look.scale, 5), Math.max(width * look.scale, 4)];
    pen.save();
    pen.translate(...this.at(x, y));
    pen.rotate(heading);
    const outline = new Path2D();
    outline.roundRect(-long / 2, -wide / 2, long, wide, Math.min(3, wide / 4));
    if (kind === "truth" || kind === "ego") {
      pen.fillStyle = kind === "ego" ? colour.ego : colour.body;
      pen.fill(outline);
      pen.strokeStyle = colour["body-line"];
      pen.lineWidth = 1;
      pen.stroke(outline);
      this.arrow(long, wide, colour.halo);
    } else if (kind === "shadow") {
      pen.globalAlpha = 0.3;
      pen.fillStyle = colour.ego;
      pen.fill(outline);
      pen.globalAlpha = 1;
      pen.strokeStyle = colour.ego;
      pen.lineWidth = 1.5;
      pen.setLineDash([3, 2]);
      pen.stroke(outline);
      pen.setLineDash([]);
    } else if (kind === "missing") {
      pen.strokeStyle = colour.missing;
      pen.lineWidth = 1.5;
      pen.stroke(outline);
      pen.clip(outline);
      pen.beginPath();
      for (let step = -long; step < long + wide; step += 6) {
        pen.moveTo(step - long / 2, -wide / 2);
        pen.lineTo(step - long / 2 - wide, wide / 2);
      }
      pen.stroke();
    } else {
      pen.strokeStyle = kind === "ghost" ? colour.ghost : colour.percept;
      pen.lineWidth = kind === "ghost" ? 2.5 : 2;
      pen.setLineDash(kind === "ghost" ? [6, 4] : []);
      pen.stroke(outline);
      pen.setLineDash([]);
      if (kind === "ghost") this.arrow(long, wide, colour.ghost);
    }
    pen.restore();
  }

  arrow(long, wide, fill) {
    const size = Math.min(long * 0.3, wide * 0.7);
    const tip = long * 0.42;
    this.pen.beginPath();
    this.pen.moveTo(tip, 0);
    this.pen.lineTo(tip - size, -size / 2);
    this.pen.lineTo(tip - size, size / 2);
    this.pen.closePath();
    this.pen.fillStyle = fill;
    this.pen.fill();
  }

  label([x, y, , , length, width], id, remark) {
    if (!this.show.labels) return;
    const text = shorter(id, 24) + (remark ? ` (${remark})` : "");
    const [across, down] = this.at(x, y);
    const reach = (Math.hypot(length, width) / 2) * this.look.scale;
    this.labels.push([text, across, down - Math.min(reach, 40) - 4, remark]);
  }

  /** Labels come last and above all bodies; one that would cover another moves up. */
  drawLabels(width, height) {
    const {pen, colour} = this;
    pen.font = "600 12px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "bottom";
    pen.lineJoin = "round";
    const placed = [];
    for (const [text, x, y, remark] of this.labels) {
      if (x < 0 || x > width || y < -20 || y > height + 40) continue;
      const half = pen.measureText(text).width / 2 + 2;
      const across = clamp(x, half + 2, Math.max(width - half - 2, half + 2));
      let down = Math.max(y, 16);
      const hits = () => placed.some(([left, right, line]) =>
        Math.abs(line - down) < 14 && across + half > left && across - half < right);
      for (let tries = 0; tries < 6 && hits(); tries += 1) down -= 14;
      placed.push([across - half, across + half, down]);
      pen.strokeStyle = colour.halo;
      pen.lineWidth = 4;
      pen.strokeText(text, across, down);
      pen.fillStyle = remark === "ghost" ? colour.ghost : colour.ink;
      pen.fillText(text, across, down);
    }
  }

  drawScale(width, height) {
    const {pen, colour, look} = this;
    const metres = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000]
      .find((one) => one * look.scale >= 50) ?? 1000;
    const [left, down] = [12, height - 14];
    pen.strokeStyle = colour.ink;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(left, down - 5);
    pen.lineTo(left, down);
    pen.lineTo(left + metres * look.scale, down);
    pen.lineTo(left + metres * look.scale, down - 5);
    pen.stroke();
    pen.fillStyle = colour.ink;
    pen.textAlign = "left";
    pen.fillText(`${metres} m`, left + 4, down - 4);
  }
}
