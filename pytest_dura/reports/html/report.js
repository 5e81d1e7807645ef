"use strict";
(() => {
  // The filter of the verdicts. Without scripts the whole table is there, and no filter.
  const form = document.querySelector("form.filter");
  const text = document.getElementById("filter-text");
  const word = document.getElementById("filter-word");
  const count = document.getElementById("filter-count");
  const bodies = [...document.querySelectorAll("#verdicts tbody")];
  const entries = bodies.map((body) => ({
    body,
    about: body.querySelector(".about")?.textContent.toLowerCase() ?? "",
    rows: [...body.querySelectorAll("tr.verdict")].map((row) => ({
      row,
      text: row.textContent.toLowerCase(),
      word: row.querySelector("b.word").textContent,
      waived: row.querySelector("b.waived") !== null,
    })),
  }));
  const filter = () => {
    const wanted = text.value.trim().toLowerCase();
    const chosen = word.value;
    let shown = 0;
    let all = 0;
    for (const entry of entries) {
      let here = 0;
      for (const one of entry.rows) {
        const fits = one.text.includes(wanted) || entry.about.includes(wanted);
        const right = !chosen || (chosen === "waived" ? one.waived : one.word === chosen);
        one.row.hidden = !(fits && right);
        here += one.row.hidden ? 0 : 1;
      }
      const active = wanted !== "" || chosen !== "";
      const bare = entry.rows.length === 0 && !chosen && entry.about.includes(wanted);
      entry.body.hidden = active && here === 0 && !bare;
      shown += here;
      all += entry.rows.length;
    }
    count.textContent = `${shown} of ${all} verdicts`;
  };
  if (form) {
    form.hidden = false;
    form.addEventListener("input", filter);
    form.addEventListener("submit", (event) => event.preventDefault());
    filter();
  }

  // A player is made when its episode is opened for the first time.
  const mount = (details) => {
    const slot = details.querySelector(".slot");
    if (!slot || slot.childElementCount || typeof DuraPlayer === "undefined") return;
    const packed = slot.nextElementSibling;
    DuraPlayer.mount(slot, () => packed.textContent, { open: true, label: slot.dataset.label });
  };
  for (const details of document.querySelectorAll("details.player")) {
    details.addEventListener("toggle", () => details.open && mount(details));
  }

  // A link to something inside of a closed element opens it.
  const reveal = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (let one = target; one; one = one.parentElement) {
      if (one.tagName === "DETAILS") one.open = true;
    }
    for (const one of document.querySelectorAll(".target")) one.classList.remove("target");
    if (target.tagName !== "SECTION") target.classList.add("target");
    if (target.hidden || target.closest("[hidden]")) {
      text.value = "";
      word.value = "";
      filter();
    }
    target.scrollIntoView();
    if (target.tagName === "DETAILS") target.querySelector("summary").focus({ preventScroll: true });
  };
  addEventListener("hashchange", reveal);
  document.addEventListener("click", (event) => {
    const link = event.target.closest?.('a[href^="#"]');
    if (link && link.hash === location.hash) reveal();
  });
  if (location.hash) reveal();

  // On paper there is nothing to open.
  const opened = [];
  addEventListener("beforeprint", () => {
    for (const one of document.querySelectorAll("details:not(.player):not([open])")) {
      one.open = true;
      opened.push(one);
    }
  });
  addEventListener("afterprint", () => {
    for (const one of opened.splice(0)) one.open = false;
  });
})();
