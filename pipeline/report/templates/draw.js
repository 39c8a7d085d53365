"use strict";
// Draws figures in the colours of the screen, narrow ones on narrow screens; zooming one over time zooms them all.
const armdynFigures = ({ template, dark: darker }) => {
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");
  let printing = false;
  const dark = () => !printing && (root.dataset.look ? root.dataset.look === "dark" : system.matches);

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
  // Axes of measured values follow the bulk of them: a spike leaves its axis, and is said below the figure. The bulk of a
  // curve is where 98 of 100 values are, and half as much on either side; curves that stand aside may widen it to thrice.
  const plain = (values) => (values?.bdata
    ? new { f4: Float32Array, f8: Float64Array }[values.dtype](Uint8Array.from(atob(values.bdata), (c) => c.charCodeAt(0)).buffer)
    : values);
  const bulk = (values) => {
    const sorted = Float64Array.from(values.filter(Number.isFinite)).sort(), last = sorted.length - 1;
    const [low, high] = [0.01, 0.99].map((share) => sorted[Math.round(share * last)]), spare = (high - low) / 2;
    return low < high ? [Math.max(sorted[0], low - spare), Math.min(sorted[last], high + spare)] : [sorted[0], sorted[last]];
  };
  const hull = (ranges) => [Math.min(...ranges.map((r) => r[0])), Math.max(...ranges.map((r) => r[1]))];
  const followed = ({ data, layout }) => {
    const axes = {}, said = [];
    for (const [key, axis] of Object.entries(layout).filter(([name, a]) => /^[xy]axis/.test(name) && !a.range)) {
      const short = key.replace("axis", ""), along = key[0];
      const curves = data.filter((trace) => (trace[`${along}axis`] || along) === short)
        .map((trace) => ({ trace, values: Array.from(plain(trace[along])) })).filter(({ values }) => values.some(Number.isFinite));
      const leading = curves.filter(({ trace }) => !trace.meta?.aside);
      if (!leading.length) continue;
      const [whole, [low, high]] = [curves, leading].map((some) => hull(some.map(({ values }) => bulk(values))));
      const [from, to] = [Math.max(whole[0], low - (high - low)), Math.min(whole[1], high + (high - low))];
      const unit = /\[(.+)\]/.exec(axis.title?.text ?? "")?.[1] ?? "";
      const lost = new Map();
      curves.forEach(({ trace, values }) => {
        const name = `${trace.name ?? trace.legendgroup}${trace.fill ? " (band)" : ""}`;
        const outside = values.filter((v) => v < from || v > to);
        if (outside.length) lost.set(name, [...(lost.get(name) ?? []), ...outside]);
      });
      lost.forEach((outside, name) => {
        const far = outside.reduce((most, v) => (Math.abs(v) > Math.abs(most) ? v : most));
        said.push(`${outside.length} of “${name}”, up to ${far.toPrecision(3).replace("-", "−")} ${unit}`);
        axes[key] = { ...axis, range: [from - 0.05 * (to - from), to + 0.05 * (to - from)] };
      });
    }
    return { axes, said: said.length ? `Points outside the axes: ${said.join("; ")}. A double click shows all.` : "" };
  };
  const config = {
    responsive: true, displaylogo: false, displayModeBar: narrow() ? false : "hover",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  };
  const shown = new Map();
  const settled = new Map();
  const heard = new WeakSet();
  const draw = (place, { data, layout }) => {
    shown.set(place, { data, layout });
    const { axes, said } = layout.meta?.bulk ? followed({ data, layout }) : {};
    tell(place.closest(".wide") ?? place, said ?? "");
    const whole = { uirevision: "kept", ...fitted(painted({ ...layout, ...axes })), template: painted(template), autosize: true };
    const { top, y } = settled.get(place) ?? {};
    if (top) [whole.margin, whole.legend] = [{ ...whole.margin, t: top }, { ...whole.legend, y }];
    const done = Plotly.react(place, painted(data), whole, config);
    if (!heard.has(place)) {  // a figure that was hidden meanwhile still has its listeners
      heard.add(place);
      place.on("plotly_afterplot", () => settle(place));
      settle(place);
      if (layout.meta?.time_axis) place.on("plotly_relayout", (change) => zoomed(place, change));
    }
    return done;
  };
  const tell = (place, text) => {
    const next = place.nextElementSibling;
    const line = next?.matches(".outside") ? next : Object.assign(document.createElement("p"), { className: "outside" });
    if (text && line !== next) place.after(line);
    line.textContent = text;
  };
  // A legend stands above the curves, however many rows it has, and below the tool bar where that is in its way.
  const settle = (place) => {
    const [legend, bar] = [".infolayer .legend", ".modebar"].map((part) => place.querySelector(part)?.getBoundingClientRect());
    if (!legend?.height) return;
    const frame = place.getBoundingClientRect();
    const below = bar?.width && legend.right > bar.left ? bar.bottom - frame.top + 2 : 0;
    const wanted = { top: Math.max(template.layout.margin.t, below + legend.height + 8), y: 1 - below / frame.height };
    const { margin, legend: now } = place._fullLayout;
    if (Math.abs(wanted.top - margin.t) < 2 && Math.abs(wanted.y - now.y) < 0.01) return;
    settled.set(place, wanted);
    Plotly.relayout(place, { "margin.t": wanted.top, "legend.y": wanted.y });
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
  system.addEventListener("change", redraw);

  // Paper is white, and narrower than the screen.
  const resize = (size) => shown.forEach((_, place) => { if (place.offsetParent) Plotly.relayout(place, size); });
  addEventListener("beforeprint", () => { printing = true; redraw(); resize({ width: 690, autosize: false }); });
  addEventListener("afterprint", () => { printing = false; redraw(); resize({ width: null, autosize: true }); });
  return { draw, redraw, shown, dark };
};
