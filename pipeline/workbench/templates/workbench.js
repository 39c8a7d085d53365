"use strict";
// The browser's side of the workbench: draws what the server sends, and tells it what a person clicks.
const armdynBench = (() => {
  const at = (id) => document.getElementById(id);
  const state = { overlay: null, figures: null, view: null, clicked: 0, knob: null, pending: null, shown: null };
  const latencies = [];

  const panel = (id, html) => { const place = at(id); if (place) place.innerHTML = html; };
  const say = (text, kind = "caution") => {
    const place = at("said");
    place.hidden = !text;
    place.className = `verdict ${kind}`;
    place.replaceChildren(Object.assign(document.createElement("p"), { textContent: text }));
    if (text && kind === "bad") place.scrollIntoView({ block: "nearest" });
  };
  const busy = (text) => { at("busy").textContent = text; at("busy").hidden = !text; };

  // The large libraries come after the page: it is there to be read and clicked before they are compiled.
  const script = (name) => new Promise((done, failed) => {
    const element = Object.assign(document.createElement("script"), { src: `${assets}/${name}`, onload: done, onerror: failed });
    document.head.append(element);
  });
  const assets = document.currentScript.src.replace(/\/[^/]*$/, "");
  const libraries = {};
  const library = (name) => (libraries[name] ??= script(name));
  addEventListener("load", () => setTimeout(() => library("plotly.js"), 50));

  // The curves: one form with the controls of a report.
  const open = async ({ html, data, look }) => {
    await library("plotly.js");
    state.figures ??= armdynFigures(look);
    panel("curves", html);
    const form = at("curves").querySelector("form");
    state.overlay = armdynOverlay(form, data, state.figures.draw);
    const tabs = [...at("curves").querySelectorAll("[data-tab]")];
    const choose = (tab) => {
      tabs.forEach((button) => { button.checked = button.dataset.tab === tab; });
      state.overlay.choose({ channel: tab });
    };
    tabs.forEach((button) => button.addEventListener("change", () => choose(button.dataset.tab)));
    const chart = form.querySelector(".chart");
    state.cursor = Object.assign(document.createElement("i"), { className: "cursor" });
    choose(data.start.channel);
    chart.append(state.cursor);
    chart.on?.("plotly_click", ({ points }) => state.view?.show(points[0].x));
    chart.on?.("plotly_hover", ({ points }) => { if (state.view) { state.view.show(points[0].x); cursor(points[0].x); } });
    document.body.dataset.ready = "yes";
  };
  const update = ({ changed, totals }) => {
    state.overlay?.update(changed, totals);
    if (state.clicked) {
      latencies.push(performance.now() - state.clicked);
      state.clicked = 0;
    }
  };
  // What the model cannot explain, of the joint whose curves are shown.
  const missing = (pictures) => { state.missing = pictures; drawMissing(); };
  const drawMissing = () => {
    const picture = state.missing?.[state.shown?.channel] ?? state.missing?.[""];
    at("missing-force").hidden = !picture;
    if (!picture || !state.figures) return;
    at("law").textContent = picture.caption;
    at("missing").style.height = `${picture.figure.layout.height}px`;
    const drawn = at("missing").dataset.drawn;
    state.figures.draw(at("missing"), picture.figure);
    if (!drawn) at("missing").on("plotly_click", () => emitEvent("discover", {}));
    at("missing").dataset.drawn = "yes";
  };
  // How the joint whose curves are shown moves.
  const motion = (pictures) => { state.motion = pictures; drawMotion(); };
  const drawMotion = () => {
    const picture = state.motion?.[state.shown?.channel];
    at("motion-section").hidden = !picture;
    if (!picture || !state.figures) return;
    at("moved").textContent = picture.caption;
    at("motion").style.height = `${picture.figure.layout.height}px`;
    state.figures.draw(at("motion"), picture.figure);
  };
  const ticks = (labels) => {
    const on = new Set(labels);
    document.querySelectorAll("[data-pick]:not(:disabled)").forEach((box) => { box.checked = on.has(box.dataset.pick); });
  };

  // The 3-D view and the curves share the time.
  const cursor = (time) => {
    const chart = at("curves").querySelector(".chart");
    const axis = chart?._fullLayout?.xaxis;
    if (!axis) return;
    if (!state.cursor.isConnected) chart.append(state.cursor);
    const x = axis.l2p(time);
    state.cursor.hidden = x < 0 || x > axis._length;
    state.cursor.style.left = `${axis._offset + x}px`;
    const { t, h } = chart._fullLayout._size;
    [state.cursor.style.top, state.cursor.style.height] = [`${t}px`, `${h}px`];
  };
  const failing = (curve) => curve.failing.map(([start, end]) => ({ start, end, text: "as given, the residual is far above the noise" }));
  const scene = async (data) => {
    await library("three.js");
    state.view?.end();
    state.view = armdynScene(at("scene"), data, { dark: state.figures.dark });
    at("scene-note").textContent = data.note;
    if (state.shown) state.view.marks(failing(state.shown));
    at("scene").dataset.ready = "yes";
  };
  document.addEventListener("armdyn-time", ({ detail }) => cursor(detail));
  document.addEventListener("armdyn-shown", ({ detail }) => {
    const other = state.shown && state.shown.run !== detail.run;
    const elsewhere = state.shown?.channel !== detail.channel;
    state.shown = detail;
    if (elsewhere) { drawMissing(); drawMotion(); }
    state.view?.marks(failing(detail));
    if (other && state.view) emitEvent("scene", { run: detail.run });
  });

  // One delegated listener for every control: the panels come and go.
  const turn = () => {
    if (state.knob || !state.pending) return;
    [state.knob, state.pending] = [state.pending, null];
    state.clicked ||= performance.now();
    emitEvent("knob", state.knob);
  };
  const turned = () => { state.knob = null; turn(); };
  document.addEventListener("change", ({ target }) => {
    if (target.dataset.pick) {
      state.clicked = performance.now();
      emitEvent("pick", { label: target.dataset.pick, on: target.checked });
    }
  });
  document.addEventListener("input", ({ target }) => {
    if (!target.dataset.knob) return;
    const output = target.parentElement.querySelector("output");
    output.textContent = `${Number(target.value).toPrecision(4)} ${output.dataset.unit}`;
    state.pending = { name: target.dataset.knob, value: Number(target.value) };
    turn();
  });
  document.addEventListener("click", ({ target }) => {
    const button = target.closest("button");
    if (!button) return;
    const { every, role, run } = button.dataset;
    if (every) { state.clicked = performance.now(); emitEvent("every", { effect: every }); }
    if (button.dataset.try) { state.clicked = performance.now(); emitEvent("try", { label: button.dataset.try }); }
    if (role) emitEvent("role", { role, run: Number(run) });
    if (button.dataset.refit !== undefined) emitEvent("refit", {});
    if (button.id === "look") {
      const root = document.documentElement;
      root.dataset.look = state.figures?.dark() ?? matchMedia("(prefers-color-scheme: dark)").matches ? "light" : "dark";
      state.figures?.redraw();
      state.view?.draw();
    }
    if (button.id === "show-scene") emitEvent("scene", { run: state.shown?.run ?? null });
    if (["search", "discover", "stop", "clear", "start-pendulum", "start-arm", "keep", "go-on", "trust"].includes(button.id)) {
      const values = Object.fromEntries([...document.querySelectorAll("[data-field]")].map((field) =>
        [field.dataset.field, field.type === "checkbox" ? field.checked : field.value]));
      emitEvent(button.id, values);
    }
  });
  return { panel, say, busy, open, update, missing, motion, ticks, scene, turned, latencies, show: (id, on) => { at(id).hidden = !on; } };
})();
