"use strict";
(async () => {
  const text = (id) => document.getElementById(id).textContent;
  const unpack = async (id) => {
    const bytes = Uint8Array.from(atob(text(id)), (c) => c.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  };
  const root = document.documentElement;

  if (!window.DecompressionStream) {
    const trouble = document.getElementById("trouble");
    trouble.textContent = "This browser cannot unpack the figures; one of 2023 or later can. Text and tables are complete.";
    trouble.hidden = false;
    return;
  }
  const library = document.createElement("script");
  library.textContent = await unpack("plotly");
  document.head.append(library);
  const { figures, widgets } = JSON.parse(await unpack("data"));
  const { draw, redraw, shown, dark } = armdynFigures(JSON.parse(text("colours")));

  // Figures are drawn when they can be seen: an arm has a hundred, under tabs.
  const overlays = widgets.map((data, i) => armdynOverlay(document.getElementById(`widget-${i}`), data, draw));
  const drawFigures = () => figures.forEach((figure, i) => {
    const place = document.getElementById(`chart-${i}`);
    if (place.offsetParent && !shown.has(place)) draw(place, figure);
  });

  // Tabs: one choice for all sections that know it, kept in the page's address with the step and the run. The missing force of
  // a base of one's own has tabs for its states, which are not channels.
  const choice = new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : "");
  const groups = new Map();
  document.querySelectorAll("[data-tab], [data-of]").forEach((part) => {
    const place = part.closest("section") ?? document.body;
    groups.set(place, [...(groups.get(place) ?? []), part]);
  });
  const tabOf = (part) => part.dataset.tab ?? part.dataset.of;
  const undecided = new Set(groups.keys());
  const choose = (tab) => {
    groups.forEach((parts, place) => {
      if (!parts.some((part) => tabOf(part) === tab)) return;
      undecided.delete(place);
      parts.forEach((part) => {
        if (part.dataset.tab !== undefined) part.checked = tabOf(part) === tab;
        else part.hidden = tabOf(part) !== tab;
      });
    });
    overlays.forEach((overlay) => overlay.choose({ channel: tab }));
    drawFigures();
  };
  document.addEventListener("change", ({ target }) => {
    if (target.dataset.tab !== undefined) choose(target.dataset.tab);
  });
  if (choice.size) overlays.forEach((overlay) => overlay.choose({ step: choice.get("step"), run: choice.get("run") }));
  const tabs = [...document.querySelectorAll("[data-tab]")].map(tabOf);
  const worst = document.querySelector("#the-missing-force [data-tab]")?.dataset.tab;
  const start = widgets[0]?.start.channel;
  const first = tabs.includes(choice.get("tab")) ? choice.get("tab") : worst ?? start ?? tabs[0];
  if (start !== undefined && !(first in widgets[0].channels)) choose(start);
  choose(first);
  groups.forEach((parts, place) => { if (undecided.has(place)) choose(tabOf(parts[0])); });

  document.getElementById("look").addEventListener("click", () => { root.dataset.look = dark() ? "light" : "dark"; redraw(); });
  document.querySelectorAll("details").forEach((part) => part.addEventListener("toggle", drawFigures));

  const links = new Map([...document.querySelectorAll("nav a")].map((link) => [link.hash.slice(1), link]));
  const sections = [...document.querySelectorAll("main, section")].filter((part) => links.has(part.id));
  const mark = () => {
    const here = sections.filter((part) => part.getBoundingClientRect().top < 120).pop() ?? sections[0];
    links.forEach((link, id) => link.classList.toggle("here", id === here.id && id !== "top"));
  };
  addEventListener("scroll", mark, { passive: true });
  mark();
  document.body.dataset.ready = "yes";
})();
