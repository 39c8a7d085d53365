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

  // Tabs: one choice for the whole page, kept in its address with the step and the run.
  const choice = new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : "");
  const choose = (tab) => {
    document.querySelectorAll("[data-tab]").forEach((button) => { button.checked = button.dataset.tab === tab; });
    document.querySelectorAll("[data-of]").forEach((part) => { part.hidden = part.dataset.of !== tab; });
    overlays.forEach((overlay) => overlay.choose({ channel: tab }));
    drawFigures();
  };
  document.addEventListener("change", ({ target }) => {
    if (target.dataset.tab !== undefined) choose(target.dataset.tab);
  });
  if (choice.size) overlays.forEach((overlay) => overlay.choose({ step: choice.get("step"), run: choice.get("run") }));
  const tabs = [...new Set([...document.querySelectorAll("[data-tab]")].map((button) => button.dataset.tab))];
  const worst = document.querySelector("#the-missing-force [data-tab]")?.dataset.tab;
  const first = tabs.includes(choice.get("tab")) ? choice.get("tab") : worst ?? widgets[0]?.start.channel ?? tabs[0];
  choose(first);

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
