"use strict";
(() => {
  // Without scripts the whole page is there, one view below the other, and no filter.
  const PAGE = 50;  // entries of a list, and rows of an entry or a table, that are drawn at once
  const main = document.getElementById("main");
  const views = [...document.querySelectorAll(".view")];
  const make = (name, text, attributes = {}) => {
    const made = document.createElement(name);
    made.textContent = text;
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  };
  const byId = (id) => (id ? document.getElementById(id) : null);
  // "off" hides on a screen and not on paper.
  const switchOff = (element, off) => element.classList.toggle("off", off);

  // Of very long tables most rows are packed, until their view or one of them is asked for.
  const unpack = async (script) => {
    const bytes = Uint8Array.from(atob(script.textContent), (each) => each.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const made = document.createElement("template");
    made.innerHTML = await new Response(stream).text();
    script.replaceWith(made.content);
  };

  // A table that is wider than its place is set closer, or else as blocks, in which each cell stands
  // behind the heading of its column.
  const textOf = (cell) => cell.innerText.replace(/\s+/g, " ").trim();
  const label = (table) => {
    const headings = [...table.querySelectorAll(":scope > thead > tr:last-child > th")].map(textOf);
    for (const row of table.querySelectorAll(":scope > tbody > tr")) {
      let at = 0;
      for (const cell of row.cells) {
        if (cell.tagName === "TD" && cell.colSpan === 1) {
          cell.dataset.label = headings[at] ?? "";
          cell.classList.toggle("nil", cell.textContent === "–");
        }
        at += cell.colSpan;
      }
    }
  };
  const fit = () => {
    for (const box of document.querySelectorAll(".view.current .scroll")) {
      const table = box.firstElementChild;
      if (table.tagName !== "TABLE" || !box.checkVisibility()) continue;
      const isWide = () => box.scrollWidth > box.clientWidth + 1;
      table.classList.remove("narrow", "blocks");
      if (!isWide()) continue;
      table.classList.add("narrow");
      if (!isWide()) continue;
      label(table);
      table.classList.replace("narrow", "blocks");
    }
  };
  let waiting = 0;
  const fitSoon = () => {
    cancelAnimationFrame(waiting);
    waiting = requestAnimationFrame(fit);
  };
  addEventListener("resize", fitSoon);
  document.addEventListener("toggle", fitSoon, true);

  // A pager below a table: of its parts only some are drawn.
  class Pager {
    constructor(table) {
      this.parts = [];
      this.first = 0;
      this.bar = make("p", "", { class: "pager" });
      this.bar.hidden = true;
      this.back = make("button", "‹ Previous", { type: "button" });
      this.on = make("button", "Next ›", { type: "button" });
      this.where = make("span", "", { "aria-live": "polite" });
      this.back.addEventListener("click", () => this.turn(-PAGE));
      this.on.addEventListener("click", () => this.turn(PAGE));
      this.bar.append(this.back, this.where, this.on);
      table.closest(".scroll").after(this.bar);
      this.top = table.closest(".scroll");
    }

    show(parts, wanted = null) {
      for (const part of this.drawn ?? []) switchOff(part, true);
      this.parts = parts;
      this.first = PAGE * Math.floor(Math.max(0, parts.indexOf(wanted)) / PAGE);
      this.draw();
    }

    turn(by) {
      for (const part of this.drawn) switchOff(part, true);
      this.first += by;
      this.draw();
      this.top.scrollIntoView();
      this.top.focus({ preventScroll: true });
    }

    draw() {
      const { parts, first } = this;
      this.drawn = parts.slice(first, first + PAGE);
      for (const part of this.drawn) switchOff(part, false);
      this.bar.hidden = parts.length <= PAGE;
      this.back.disabled = first === 0;
      this.on.disabled = first + PAGE >= parts.length;
      fitSoon();
      this.where.textContent = `${first + 1} to ${first + this.drawn.length} of ${parts.length}`;
    }
  }

  // A list of entries, of which one may be open: requirements, cases, episodes.
  class List {
    constructor(table) {
      this.table = table;
      this.view = table.closest(".view");
      this.pager = new Pager(table);
      this.entries = [...table.querySelectorAll(":scope > tbody.entry")].map((body) => ({
        body,
        rows: [...body.querySelectorAll(":scope > tr.verdict")],
        fit: body.querySelector(".fit"),
        packed: body.querySelector("script.packed"),
      }));
      this.bodies = new Map(this.entries.map((entry) => [entry.body, entry]));
      this.rest = [...table.querySelectorAll(":scope > tbody:not(.entry)")];
      for (const { body, rows } of this.entries) for (const part of [body, ...rows]) switchOff(part, true);
      this.form = this.view.querySelector(`form.filter[data-table="${table.id}"]`);
      this.bar = make("p", "", { class: "bar" });
      this.bar.hidden = true;
      table.closest(".scroll").before(this.bar);
      if (this.form) {
        this.text = this.form.querySelector("input");
        this.choices = [...this.form.querySelectorAll("select")];
        this.count = this.form.querySelector("output");
        this.form.hidden = this.entries.length === 0;
        this.form.addEventListener("input", () => this.filter());
        this.form.addEventListener("submit", (event) => event.preventDefault());
      }
      this.filter();
    }

    // Takes in the rows of entries that were unpacked.
    refresh() {
      for (const entry of this.entries) {
        if (!entry.packed || entry.packed.isConnected) continue;
        entry.packed = null;
        const known = new Set(entry.rows);
        entry.rows = [...entry.body.querySelectorAll(":scope > tr.verdict")];
        for (const row of entry.rows) if (!known.has(row)) switchOff(row, true);
        entry.fitting = entry.rows;
      }
    }

    // Texts are read when the filter is used for the first time: of a long list that takes a moment.
    read() {
      if (this.isRead) return;
      this.isRead = true;
      for (const entry of this.entries) {
        const rows = entry.rows.length ? entry.rows : [entry.body];
        entry.head = entry.rows.length
          ? [...entry.body.querySelectorAll(":scope > tr:not(.verdict)")].map((row) => row.textContent).join(" ").toLowerCase()
          : "";
        entry.texts = rows.map((row) => row.textContent.toLowerCase());
      }
    }

    filter() {
      const wanted = this.text ? this.text.value.trim().toLowerCase() : "";
      const chosen = (this.choices ?? []).filter((choice) => choice.value !== "");
      const active = wanted !== "" || chosen.length > 0;
      if (active) {
        const packed = this.entries.map((entry) => entry.packed).filter(Boolean);
        if (packed.length) {
          this.count.textContent = "reading all rows …";
          Promise.all(packed.map(unpack)).then(() => {
            this.refresh();
            this.filter();
          });
          return;
        }
        this.read();
      }
      let all = 0;
      let fitting = 0;
      this.fits = [];
      for (const entry of this.entries) {
        const rows = entry.rows.length ? entry.rows : [entry.body];
        const inHead = wanted === "" || (entry.head !== "" && (entry.head ?? "").includes(wanted));
        entry.fitting = active
          ? rows.filter((row, i) => (inHead || entry.texts[i].includes(wanted))
            && chosen.every((choice) => {
              const has = row.dataset[choice.name] ?? entry.body.dataset[choice.name] ?? "";
              return has.split("\n").includes(choice.value);
            }))
          : rows;
        const counted = !entry.body.matches(".requirement, .undeclared") || entry.rows.length > 0;
        const more = Number(entry.packed?.dataset.rows ?? 0);
        all += counted ? rows.length + more : 0;
        fitting += counted ? entry.fitting.length + more : 0;
        if (entry.fitting.length > 0) this.fits.push(entry.body);
        if (entry.fit) {
          entry.fit.textContent = active && counted ? `${entry.fitting.length} of ${rows.length} fit` : "";
        }
      }
      for (const body of this.rest) switchOff(body, active || this.opened);
      if (this.count) this.count.textContent = `${fitting} of ${all} ${this.form.dataset.unit}`;
      this.draw();
    }

    clear() {
      if (!this.form) return;
      this.text.value = "";
      for (const choice of this.choices) choice.value = "";
      this.filter();
    }

    // Draws the entries, or the open one with its rows.
    draw(wanted = null) {
      const { opened } = this;
      this.table.classList.toggle("opened", Boolean(opened));
      if (!opened) {
        this.pager.show(this.fits, wanted);
        return;
      }
      const entry = this.bodies.get(opened);
      if (!entry.rows.length) {
        this.pager.show([opened]);
        return;
      }
      this.pager.show(entry.fitting, wanted);
      switchOff(opened, false);
    }

    open(body, row = null) {
      const before = this.opened ?? null;
      before?.classList.remove("open");
      if (before) switchOff(before, true);
      for (const rest of this.rest) switchOff(rest, body !== null);
      this.opened = body;
      this.bar.hidden = body === null;
      if (body) {
        // What a link leads to is shown, whatever the filter says.
        const { fitting } = this.bodies.get(body);
        if (fitting.length === 0 || (row && !fitting.includes(row))) this.clear();
        body.classList.add("open");
        this.bar.replaceChildren(...this.steps(body));
      }
      this.draw(row ?? before);
    }

    steps(body) {
      const at = this.fits.indexOf(body);
      const step = (text, to) => {
        const link = to && to.id ? make("a", text, { href: `#${to.id}` }) : make("span", text, { class: "none" });
        return link;
      };
      const title = this.view.querySelector("h2").textContent.toLowerCase();
      return [
        make("a", `← All ${title}`, { href: `#${this.view.id}`, class: "all" }),
        step("‹ Previous", this.fits[at - 1]),
        make("span", `${at + 1} of ${this.fits.length}`),
        step("Next ›", this.fits[at + 1]),
      ];
    }

    step(by) {
      if (this.opened) {
        const to = this.fits[this.fits.indexOf(this.opened) + by];
        if (to?.id) location.hash = to.id;
        return;
      }
      const links = this.pager.drawn.map((body) => body.querySelector("a")).filter(Boolean);
      const at = links.indexOf(document.activeElement);
      links[Math.max(0, Math.min(links.length - 1, at + by))]?.focus();
    }
  }

  // Lists are made when their view is seen for the first time.
  const lists = new Map();
  const listsOf = (view) => {
    if (lists.has(view)) return lists.get(view);
    const tables = [...view.querySelectorAll("table")];
    const made = tables.filter((table) => table.matches(".entries")).map((table) => new List(table));
    for (const table of tables) {
      const rows = table.matches(".entries") ? [] : [...table.querySelectorAll(":scope > tbody > tr")];
      if (rows.length > PAGE) {
        for (const row of rows) switchOff(row, true);
        new Pager(table).show(rows);
      }
    }
    lists.set(view, made);
    return made;
  };

  // A player is made when its episode is opened for the first time.
  const mount = (details) => {
    const slot = details.querySelector(".slot");
    if (!slot || typeof DuraPlayer === "undefined") return;
    if (slot.childElementCount) {
      slot.querySelector(".dura-player")?.focus();
      return;
    }
    const packed = slot.nextElementSibling;
    const others = () => [...document.querySelectorAll(".slot[data-label]")].map((other) => (
      { label: other.dataset.label, packed: () => other.nextElementSibling.textContent }));
    DuraPlayer.mount(slot, () => packed.textContent,
      { open: true, focus: true, label: slot.dataset.label, others });
  };
  const players = [...document.querySelectorAll("details.player")];
  for (const details of players) {
    details.addEventListener("toggle", () => details.open && mount(details));
  }

  // The address says what is shown: a view, an entry of its list, or something inside of one.
  const route = (moved) => {
    const overview = views[0];
    const wanted = decodeURIComponent(location.hash.slice(1));
    const target = byId(wanted) ?? overview;
    const view = target.closest(".view") ?? overview;
    const isLost = wanted && !byId(wanted);
    const packed = [...(isLost ? main : view).querySelectorAll("script.packed")].filter((script) => {
      const entry = script.closest("tbody.entry");  // its rows are seen when it is opened
      return isLost || !entry || entry.contains(target);
    });
    if (packed.length) {
      Promise.all(packed.map(unpack)).then(() => {
        for (const list of [...lists.values()].flat()) list.refresh();
        route(moved);
      });
      return;
    }
    for (const each of views) each.classList.toggle("current", each === view);
    for (const link of document.querySelectorAll("nav a")) {
      if (link.hash === `#${view.id}`) link.setAttribute("aria-current", "page");
      else link.removeAttribute("aria-current");
    }
    for (const each of document.querySelectorAll(".target")) each.classList.remove("target");
    const isPlayer = target.matches("details.player");
    const entry = isPlayer ? byId(target.dataset.entry) : target.closest("tbody.entry");
    const row = target.matches("tr.verdict") ? target : null;
    const before = listsOf(view).map((list) => list.opened).find(Boolean);
    for (const list of listsOf(view)) list.open(list.bodies.has(entry) ? entry : null, row);
    const player = isPlayer ? target : entry && players.find((each) => each.dataset.entry === entry.id);
    for (const each of players) each.classList.toggle("current", each === player);
    if (player) {
      player.open = true;
      mount(player);
    }
    fit();
    for (let each = target; each; each = each.parentElement) {
      if (each.tagName === "DETAILS") each.open = true;
    }
    if (target === view) {
      // "/" put the focus on the filter before this address was acted on.
      if (document.activeElement.matches("input") && view.contains(document.activeElement)) return;
      const link = before && !entry ? before.querySelector("a") : null;
      if (link && link.checkVisibility()) {
        link.focus({ preventScroll: true });
        link.scrollIntoView({ block: "center" });
      } else {
        scrollTo(0, 0);
        if (moved) view.querySelector("h2").focus({ preventScroll: true });
      }
      return;
    }
    if (row || !entry) target.classList.add("target");
    const place = isPlayer || row || !entry ? target : entry;
    if (place === entry) scrollTo(0, 0);
    else place.scrollIntoView({ block: row ? "center" : "start" });
    const focused = isPlayer ? target.querySelector("summary") : place.querySelector("a, summary, button");
    (focused ?? main).focus({ preventScroll: true });
  };
  addEventListener("hashchange", () => route(true));
  document.addEventListener("click", (event) => {
    const link = event.target.closest?.('a[href^="#"]');
    if (link && link.hash === location.hash) route(true);
  });
  route(location.hash !== "");

  // Keys: those of a player and of fields are their own.
  document.querySelector(".shortcuts").hidden = false;
  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
    const inField = event.target.closest?.("input, select, textarea");
    const view = document.querySelector(".view.current");
    const list = listsOf(view)[0];
    if (event.key === "Escape" && list) {
      if (inField?.type === "search" && inField.value) return;  // the field is emptied first
      if (list.opened && !event.target.closest?.(".dura-player")) location.hash = view.id;
      return;
    }
    if (inField || event.target.closest?.(".dura-player")) return;
    if (event.key === "/" && list?.text) {
      event.preventDefault();
      if (list.opened) location.hash = view.id;
      list.text.focus();
    }
    if (players.some((each) => each.open && each.checkVisibility())) return;
    if (event.key === "j") list?.step(1);
    if (event.key === "k") list?.step(-1);
  });

  // On paper there is nothing to open.
  const opened = [];
  addEventListener("beforeprint", () => {
    for (const each of document.querySelectorAll(".printed details:not(.player):not([open])")) {
      each.open = true;
      opened.push(each);
    }
  });
  addEventListener("afterprint", () => {
    for (const each of opened.splice(0)) each.open = false;
  });
})();
