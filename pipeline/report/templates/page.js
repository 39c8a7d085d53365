"use strict";
(async () => {
  const text = (id) => document.getElementById(id).textContent;
  const unpack = async (id) => {
    const bytes = Uint8Array.from(atob(text(id)), (c) => c.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  };
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");
  let printing = false;
  const dark = () => !printing && (root.dataset.look ? root.dataset.look === "dark" : system.matches);

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
  const { template, dark: darker } = JSON.parse(text("colours"));

  // Every colour has a role, and each role has a colour for dark screens.
  const painted = (value) => {
    if (typeof value === "string") return (dark() && darker[value]) || value;
    if (Array.isArray(value)) return typeof value[0] === "number" ? value : value.map(painted);
    if (!value || typeof value !== "object" || ArrayBuffer.isView(value) || "bdata" in value) return value;
    return Object.fromEntries(Object.entries(value).map(([key, entry]) => [key, painted(entry)]));
  };
  const narrow = () => Math.min(innerWidth, root.clientWidth) < 620;
  const fitted = (layout) => {
    if (!narrow()) return layout;
    const small = structuredClone(layout);
    small.margin = { ...small.margin, l: 44, r: 6, t: 64, b: 40 };
    small.font = { size: 11 };
    for (const key of Object.keys(small).filter((name) => /^[xy]axis\d*$/.test(name))) {
      small[key].title = { ...small[key].title, standoff: 4, font: { size: 11 } };
      small[key].nticks ??= 6;
    }
    return small;
  };
  const config = {
    responsive: true, displaylogo: false, displayModeBar: narrow() ? false : "hover",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  };
  const shown = new Map();
  const draw = (place, { data, layout }) => {
    const first = !shown.has(place);
    shown.set(place, { data, layout });
    const whole = { uirevision: "kept", ...fitted(painted(layout)), template: painted(template), autosize: true };
    const done = Plotly.react(place, painted(data), whole, config);
    if (first && layout.meta?.time_axis) place.on("plotly_relayout", (change) => zoomed(place, change));
    return done;
  };
  const redraw = () => shown.forEach((figure, place) => { if (place.offsetParent) draw(place, figure); else shown.delete(place); });

  // Zooming one figure over time zooms all of them: what failed at 3.2 s is seen everywhere.
  let zooming = false;
  const zoomed = async (chart, change) => {
    const axis = Object.keys(change).find((key) => /^xaxis\d*\.(range|autorange)/.test(key))?.split(".")[0];
    if (zooming || !axis) return;
    zooming = true;
    const { range, autorange } = chart.layout[axis];
    const all = Object.keys(change).some((key) => key.endsWith(".autorange")) && autorange;
    for (const other of [...shown.keys()].filter((c) => c !== chart && c.offsetParent && c.layout.meta?.time_axis)) {
      const axes = Object.keys(other.layout).filter((key) => /^xaxis\d*$/.test(key));
      await Plotly.relayout(other, Object.fromEntries(
        axes.map((key) => (all ? [`${key}.autorange`, true] : [`${key}.range`, [...range]]))));
    }
    zooming = false;
  };

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
  const first = tabs.includes(choice.get("tab")) ? choice.get("tab") : widgets[0]?.start.channel ?? tabs[0];
  choose(first);

  document.getElementById("look").addEventListener("click", () => { root.dataset.look = dark() ? "light" : "dark"; redraw(); });
  system.addEventListener("change", redraw);
  document.querySelectorAll("details").forEach((part) => part.addEventListener("toggle", drawFigures));

  const links = new Map([...document.querySelectorAll("nav a")].map((link) => [link.hash.slice(1), link]));
  const sections = [...document.querySelectorAll("main, section")].filter((part) => links.has(part.id));
  const mark = () => {
    const here = sections.filter((part) => part.getBoundingClientRect().top < 120).pop() ?? sections[0];
    links.forEach((link, id) => link.classList.toggle("here", id === here.id && id !== "top"));
  };
  addEventListener("scroll", mark, { passive: true });
  mark();

  // Paper is white, and narrower than the screen.
  const resize = (size) => shown.forEach((_, place) => { if (place.offsetParent) Plotly.relayout(place, size); });
  addEventListener("beforeprint", () => { printing = true; redraw(); resize({ width: 690, autosize: false }); });
  addEventListener("afterprint", () => { printing = false; redraw(); resize({ width: null, autosize: true }); });
  document.body.dataset.ready = "yes";
})();
