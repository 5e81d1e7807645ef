// What was decided, what happened, and what was found.

/** An action whose numbers have more than eight decimals at six digits; the record has all. */
const rounded = (text) => text.replace(/\b\d+\.\d{9,}(e[-+]?\d+)?/g,
  (digits) => String(Number(Number(digits).toPrecision(6))));

class Decision {
  constructor(episode, elsewhere) {
    this.episode = episode;
    this.cells = {};
    const pairs = [["proposed", "Proposed"], ["executed", "Executed"], ["source", "In control"],
      ["explanation", "Explanation"], ["reasons", "Doubts"], ["recovery", "Recovery"]];
    if (episode.accounts.at.length && !elsewhere) pairs.push(["account", "Account"]);
    const list = make("dl", {}, pairs.map(([key, label]) => {
      this.cells[key] = make("dd", {class: `dura-statement dura-${key}`});
      return make("div", {}, make("dt", {}, label), this.cells[key]);
    }));
    this.title = make("h3", {});
    this.node = make("section", {class: "dura-panel dura-decision", tabindex: "0",
      "aria-label": "Decision"},
      this.title, list);
  }

  /** The last tick follows the last decision, which is shown there as what it is. */
  update(tick) {
    const {texts, decided, attempts, time} = this.episode;
    const at = Math.min(tick, decided - 1);
    say(this.title, tick < decided ? "Decision"
      : at < 0 ? "No decision" : `The last decision, at ${seconds(time[at])}`);
    const orDash = (text) => text || "–";
    const [proposed, executed, source] = [texts.proposed(at), texts.executed(at), texts.source(at)];
    say(this.cells.proposed, orDash(rounded(proposed)));
    say(this.cells.executed, orDash(rounded(executed)));
    this.cells.executed.classList.toggle("dura-differs", proposed !== executed);
    say(this.cells.source,
      orDash(source) + (attempts[at] ? `, after ${counted(attempts[at], "refusal")}` : ""));
    this.cells.source.dataset.source = source;
    say(this.cells.explanation, orDash(texts.explanations(at)));
    say(this.cells.reasons, orDash(texts.reasons(at)));
    say(this.cells.recovery, orDash(texts.recoveries(at)));
    if (this.cells.account) say(this.cells.account, orDash(texts.accounts(at)));
  }

  /** One sentence, for who cannot see the panel. */
  inWords(tick) {
    const {texts, decided} = this.episode;
    if (tick >= decided) return "The episode has ended.";
    return `Proposed ${rounded(texts.proposed(tick))}, executed ${rounded(texts.executed(tick))}, `
      + `from ${texts.source(tick)}. ${texts.reasons(tick)}`;
  }
}

class Events {
  constructor(player) {
    const {episode} = player;
    this.events = episode.events;
    this.buttons = this.events.map(([tick, kind, subject, detail]) =>
      make("button", {type: "button", class: "dura-event", click: () => player.jump(tick)},
        make("span", {class: "dura-time"}, seconds(episode.time[tick] ?? 0)),
        make("span", {class: `dura-kind dura-kind-${eventLook(kind)}`}, words(kind)),
        make("span", {class: "dura-detail"}, detail ? `${subject}: ${detail}` : subject)));
    this.list = make("ol", {class: "dura-events"},
      this.buttons.map((one) => make("li", {}, one)));
    this.node = make("section", {class: "dura-panel dura-eventpanel", "aria-label": "Events"},
      make("h3", {}, `Events (${this.events.length})`),
      this.events.length ? this.list : make("p", {class: "dura-note"}, "Nothing happened."));
    this.current = -1;
  }

  /** Marks the last event that has happened, and keeps it in sight within the list. */
  update(tick) {
    let current = -1;
    this.events.forEach(([at], index) => {
      if (at <= tick) current = index;
    });
    if (current === this.current) return;
    this.buttons[this.current]?.removeAttribute("aria-current");
    this.buttons.forEach((one, index) => one.classList.toggle("dura-ahead", index > current));
    this.current = current;
    const found = this.buttons[current];
    if (!found) {
      this.list.scrollTop = 0;
      return;
    }
    found.setAttribute("aria-current", "true");
    const [item, list] = [found.parentElement, this.list];
    const top = item.offsetTop; // the list is what it is measured from
    if (top < list.scrollTop || top + item.offsetHeight > list.scrollTop + list.clientHeight) {
      list.scrollTop = top - list.clientHeight / 2;
    }
  }
}

const SIGNS = new Map([["satisfied", "✓"], ["violated", "✕"], ["invalid", "?"]]);

/** Buttons to the violations, and the verdicts folded below them. */
function verdictPanel(player) {
  const {episode} = player;
  const items = episode.verdicts.map(({requirement, verdict, time, margin, check, note}) => {
    const violated = verdict === "violated";
    const known = SIGNS.has(verdict) ? verdict : "other";
    const facts = [margin === null ? null : `margin ${number(Number(margin))}`,
      violated && time === null ? "time unknown" : null, note].filter(Boolean).join(", ");
    return make("li", {class: `dura-verdict dura-is-${known}`},
      make("span", {class: "dura-word"},
        make("span", {"aria-hidden": "true"}, `${SIGNS.get(verdict) ?? "?"} `), verdict),
      make("span", {class: "dura-requirement"}, make("strong", {}, requirement),
        check ? make("code", {}, check) : null,
        facts ? make("span", {class: "dura-note"}, facts) : null));
  });
  const jumps = episode.verdicts
    .filter(({verdict, tick}) => verdict === "violated" && tick !== null)
    .sort((one, other) => one.tick - other.tick)
    .map(({requirement, tick}) => {
      const text = `${shorter(requirement, 40)} at ${seconds(episode.time[tick])}`;
      return make("button", {type: "button", class: "dura-jump", click: () => player.jump(tick),
        "aria-label": `Jump to violation of ${text}`},
      make("span", {"aria-hidden": "true"}, "✕ "), text);
    });
  const counts = new Map();
  for (const {verdict} of episode.verdicts) counts.set(verdict, (counts.get(verdict) ?? 0) + 1);
  return make("section", {class: "dura-panel dura-verdicts", "aria-label": "Verdicts"},
    jumps.length ? make("div", {class: "dura-jumps"}, jumps) : null,
    make("details", {class: "dura-details"},
      make("summary", {}, "Verdicts: ",
        [...counts].map(([verdict, count]) => `${count} ${verdict}`).join(", ")),
      make("ul", {}, items)));
}

function heading(episode, level) {
  const {about} = episode;
  const facts = [["component", about.component], ["seed", about.seed], ["validity", about.validity],
    ["ended by", about.termination]]
    .filter(([, value]) => value !== null && value !== undefined && value !== "");
  return make("header", {class: "dura-head"},
    make(`h${level}`, {class: "dura-title"}, String(about.id ?? "Episode")),
    make("ul", {class: "dura-facts"}, facts.map(([label, value]) =>
      make("li", {}, `${label} `, make("strong", {}, words(String(value)))))),
    about.failure ? make("p", {class: "dura-failure"}, String(about.failure)) : null);
}
