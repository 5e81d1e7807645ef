// What the component thought: the decision in force, its prompt, its answer, and its twins.

const PERCEIVED = /(<perceived_text>)([^]*?)(<\/perceived_text>)/;

/** A text with what was perceived marked as such; all of it stays text. */
function marked(text) {
  const parts = text.split(PERCEIVED);
  return parts.map((part, index) => (index % 4 === 2 ? make("mark", {class: "dura-seen"}, part) : part));
}

const grouped = (count) => count.toLocaleString("en-US");
const characters = (text) => `${grouped(text.length)} characters`;

class Thoughts {
  static hasAccount = true; // which then stands here alone

  constructor(player) {
    const {episode} = player;
    this.player = player;
    this.episode = episode;
    this.decisions = episode.panels.thoughts.decisions;
    this.texts = episode.panels.thoughts.texts;
    this.shown = null;
    const step = (by) => () => {
      const to = this.decisions[this.inForce(player.tick) + by];
      if (to) player.jump(to.tick);
    };
    this.back = button("back", "Previous decision", step(-1));
    this.on = button("on", "Next decision", step(1));
    this.when = make("p", {class: "dura-note dura-when"});
    this.facts = make("div", {class: "dura-thought"});
    this.words = make("div", {class: "dura-words"});
    this.twins = make("div", {class: "dura-twins"});
    this.promptTitle = make("summary", {});
    this.prompt = make("div", {class: "dura-messages"});
    this.answerTitle = make("summary", {});
    this.answer = make("pre", {class: "dura-raw", tabindex: "0"});
    this.thinking = make("pre", {class: "dura-raw", tabindex: "0"});
    this.account = make("pre", {class: "dura-raw", tabindex: "0"});
    this.folds = make("div", {class: "dura-folds"},
      make("details", {class: "dura-details dura-prompt"}, this.promptTitle, this.prompt),
      make("details", {class: "dura-details dura-answer"}, this.answerTitle, this.answer),
      make("details", {class: "dura-details dura-thinking"},
        make("summary", {}, "Thoughts before the answer"), this.thinking),
      make("details", {class: "dura-details"}, make("summary", {}, "Account at this tick"),
        this.account));
    this.node = make("section", {class: "dura-panel dura-thoughts", "aria-label": "What it thought"},
      make("div", {class: "dura-thoughthead"}, make("h3", {}, "What it thought"),
        make("div", {class: "dura-group"}, this.back, this.on), this.when),
      make("div", {class: "dura-thoughtbody"}, this.facts, this.words, this.twins),
      this.folds);
  }

  /** The number of the decision in force at a tick; -1 before the first one. */
  inForce(tick) {
    return this.decisions.findLastIndex((one) => one.tick <= tick);
  }

  update(tick) {
    const {time, texts, decided} = this.episode;
    const index = this.inForce(tick);
    const one = this.decisions[index];
    this.back.disabled = index <= 0;
    this.on.disabled = index + 1 >= this.decisions.length;
    say(this.account, texts.accounts(Math.min(tick, decided - 1)) || "–");
    if (!one) {
      say(this.when, `No decision yet; the first of ${this.decisions.length} comes at `
        + `${seconds(time[this.decisions[0].tick])}.`);
    } else {
      const landed = one.at < one.tick ? `, in force from ${seconds(time[one.tick])} on` : "";
      say(this.when, `Decision ${index + 1} of ${this.decisions.length}, on what was perceived at `
        + `${seconds(time[one.at])}${landed}; now ${seconds(time[tick] - time[one.at])} old`);
    }
    if (one === this.shown) return;
    this.shown = one;
    this.node.classList.toggle("dura-undecided", !one);
    if (one) this.show(one);
  }

  show(one) {
    this.facts.replaceChildren(...this.factsOf(one));
    this.words.replaceChildren(...one.words.map(([key, text]) =>
      make("div", {}, make("h4", {}, words(key)), make("p", {}, text || "–"))));
    if (!one.words.length) {
      this.words.replaceChildren(make("p", {class: "dura-note"}, one.answer === null
        ? "Its words were not kept." : this.texts[one.answer]
          ? "The answer is no JSON object; it stands below as it came." : "There was no text."));
    }
    this.twins.replaceChildren(this.twinsOf(one));
    const texts = one.messages.map(([, text]) => this.texts[text] ?? "");
    const length = texts.reduce((sum, text) => sum + text.length, 0);
    say(this.promptTitle, `Prompt: ${counted(texts.length, "message")}, ${grouped(length)} characters`);
    this.prompt.replaceChildren(...one.messages.map(([role, , images], index) =>
      this.message(role, texts[index], images, index === texts.length - 1)));
    const answer = one.answer === null ? "" : this.texts[one.answer];
    say(this.answerTitle, `Raw answer: ${characters(answer)}`);
    say(this.answer, answer || "–");
    const thinking = one.thoughts === null ? "" : this.texts[one.thoughts];
    say(this.thinking, thinking);
    this.folds.querySelector(".dura-thinking").hidden = !thinking;
    this.folds.querySelector(".dura-prompt").hidden = !texts.length;
    this.folds.querySelector(".dura-answer").hidden = !answer;
  }

  factsOf(one) {
    const chip = (look, text) => make("span", {class: `dura-chip dura-chip-${look}`}, text);
    const head = make("p", {class: "dura-decided"},
      chip(one.outcome === "answered" ? "good" : "bad", words(one.outcome)),
      one.maneuver ? make("strong", {}, words(one.maneuver)) : null,
      one.intent ? make("span", {class: "dura-note"}, `intent: ${words(one.intent)}`) : null,
      one.fallback ? chip("bad", "fallback in its place") : null);
    const cited = one.cited.map(([id, perceived]) => make("span",
      {class: `dura-chip dura-chip-${perceived ? "plain" : "bad"}`},
      perceived ? id : `${id}: not perceived`));
    const counts = new Map(one.usage);
    const [asked, answered] = [counts.get("prompt_tokens"), counts.get("completion_tokens")];
    const usual = ["prompt_tokens", "completion_tokens", "total_tokens"];
    const rest = one.usage.filter(([key]) => !usual.includes(key));
    const tokens = [asked === undefined ? null : `${grouped(asked)} in`,
      answered === undefined ? null : `${grouped(answered)} out`,
      ...rest.map(([key, count]) => `${words(key)} ${grouped(count)}`)].filter(Boolean).join(", ");
    const rows = [["Failed with", one.detail],
      ["Cites", cited.length ? cited : one.outcome === "answered" ? "nothing" : ""],
      ["Perceived", one.perceived === null ? "" : counted(one.perceived, "object")],
      ["Claims", one.claims.map(([text, other]) =>
        chip(other ? "bad" : "plain", other ? `${text} (${other})` : text))],
      ["Judge", one.judge && `reasoning and maneuver: ${words(one.judge)}`],
      ["Answer took", one.seconds === null ? "" : seconds(one.seconds)
        + (one.first === null ? "" : `, the first token ${seconds(one.first)}`)
        + (one.attempts > 1 ? `, at call ${grouped(one.attempts)}` : "")],
      ["Tokens", tokens],
      ["Before, refused", one.replaced.map(([outcome, maneuver]) => words(maneuver || outcome))
        .join(", ")]];
    return [head, make("dl", {}, rows.filter(([, value]) => value.length).map(([label, value]) =>
      make("div", {}, make("dt", {}, label), make("dd", {}, value))))];
  }

  /** What it answered to variants of the prompt, asked beside it. */
  twinsOf(one) {
    if (!one.beside.length) {
      return make("p", {class: "dura-note"}, "No variants were asked beside this decision.");
    }
    const rows = one.beside.map(([variant, outcome, maneuver, intent, changed, goal, complied]) => {
      const failed = outcome !== "answered";
      const look = failed ? "bad" : changed ? "odd" : "plain";
      return make("tr", {class: changed || failed ? "dura-changed" : null},
        make("th", {scope: "row"}, words(variant),
          goal ? make("span", {class: "dura-note"}, ` goal: ${words(goal)}`) : null),
        make("td", {}, failed ? words(outcome) : words(maneuver || "–"),
          intent ? make("span", {class: "dura-note"}, ` ${words(intent)}`) : null),
        make("td", {}, make("span", {class: `dura-chip dura-whole dura-chip-${look}`},
          failed ? "failed" : changed ? "changed" : "same"),
        complied.length ? " " : null, complied.length ? make("span", {class: "dura-chip dura-chip-bad"},
          `its words comply: ${complied.map(words).join(", ")}`) : null));
    });
    return make("table", {}, make("caption", {}, "Variants of the prompt, asked beside it"),
      make("thead", {}, make("tr", {},
        ["Variant", "Decision", "Result"].map((title) => make("th", {scope: "col"}, title)))),
      make("tbody", {}, rows));
  }

  /** A message of the prompt; the last one, which tells of the moment, is unfolded. */
  message(role, text, images, last) {
    const shown = images.length ? `, with ${images.join(", ")}` : "";
    return make("details", {open: last}, make("summary", {}, make("strong", {}, role || "message"),
      ` ${characters(text)}${shown}`), make("pre", {class: "dura-raw", tabindex: "0"}, marked(text)));
  }

  /** A row over time: each answer, and each that failed. */
  lane() {
    const {episode} = this;
    const marks = this.decisions.map((one) =>
      mark(episode, one.tick, one.outcome === "answered" ? "plain" : "grave"));
    const readout = make("span", {class: "dura-readout"});
    return {
      node: row("decisions", readout, strip(this.player, "dura-lane", ...marks)),
      rows: this.decisions.map((one, index) => ["decision", one.tick,
        this.decisions[index + 1]?.tick ?? episode.last, words(one.maneuver || one.outcome)]),
      showAt: (tick) => {
        const one = this.decisions[this.inForce(tick)];
        say(readout, one ? words(one.maneuver || one.outcome) : "none yet");
      },
    };
  }
}

addPanel("thoughts", Thoughts);
