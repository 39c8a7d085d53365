"use strict";
// Measured and predicted of one channel, one run and one step, as a reader clicks; the model as given stays in sight.
const armdynOverlay = (place, data, draw) => {
  const chart = place.querySelector(".chart");
  const readout = place.querySelector(".readout");
  const caption = place.querySelector(".caption");
  const runs = [...new Map(data.curves.map((c) => [`${c.run}\n${c.kind}`, { run: c.run, kind: c.kind }])).values()];
  const now = {
    channel: data.start.channel, step: data.steps.length - 1,
    run: runs.findIndex((r) => r.run === data.start.run && r.kind === data.start.kind),
  };

  const unpacked = new WeakMap();
  const values = (packed) => {
    if (!unpacked.has(packed)) {
      const [low, size, text] = packed;
      const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
      const steps = new DataView(bytes.buffer);
      unpacked.set(packed, Float64Array.from({ length: bytes.length / 2 }, (_, i) => low + size * steps.getUint16(2 * i, true)));
    }
    return unpacked.get(packed);
  };

  const digits = (value) => (value === 0 ? "0" : Math.abs(value) >= 1000 ? value.toFixed(0) : value.toPrecision(3));
  const percent = (share) => {
    if (share === null) return "–";
    const tenths = share >= 1 ? 100 : share >= 0.99 ? Math.floor(1000 * share) / 10 : Math.floor(100 * share);
    return `${tenths} %`.replace("-", "−");
  };

  const curveOf = () => data.curves.find((c) =>
    c.channel === now.channel && c.run === runs[now.run].run && c.kind === runs[now.run].kind);

  const span = (name, text) => Object.assign(document.createElement("span"), { className: name, textContent: text });
  const tell = (curve) => {
    const { quantity, name } = data.channels[curve.channel];
    const [error, share] = [curve.rmse[now.step], curve.explained[now.step]];
    const [before, shareBefore] = [curve.rmse[0], curve.explained[0]];
    const later = now.step > 0 && error !== before;
    const change = 100 * (error / before - 1);
    const parts = [
      span("what", name === quantity ? name : `${quantity} of ${name}`),
      span("large", `${percent(share)} explained`), span("before", later ? `as given ${percent(shareBefore)}` : ""),
      span("large", `error ${digits(error)} ${curve.unit}`),
      span("before", later ? `as given ${digits(before)} ${curve.unit}, ${change > 0 ? "+" : "−"}${Math.abs(change).toFixed(0)} %` : ""),
    ];
    readout.replaceChildren(...parts.filter((part) => part.textContent));
    const run = `${curve.run} (${curve.kind}).`;
    caption.textContent = `${run} Error: root mean square of measured minus predicted. Explained: share of the measured `
      + `${quantity}'s variation about its mean. ${curve.note}`;
  };

  const figureOf = (curve) => {
    const { quantity } = data.channels[curve.channel];
    const time = values(curve.time), measured = values(curve.measured);
    const minus = (residual) => measured.map((value, i) => value - residual[i]);
    const [given, chosen] = [values(curve.residuals[0]), values(curve.residuals[now.step])];
    const size = time.length > 400 ? 3 : 5;
    const dots = { mode: "markers", marker: { color: "#7B8794", size } };
    const line = (color, width, dash) => ({ mode: "lines", line: { color, width, dash } });
    const aside = { aside: true }, traces = [];
    if (curve.recorded) {
      const [x, y] = curve.recorded.map(values);
      traces.push({ x, y, name: "as recorded", meta: aside, hoverinfo: "skip", ...line("#CBD2D9", 1) });
    }
    // The band is that of the last step; a model that was changed in the page has none.
    if (curve.band && now.step === data.steps.length - 1) {
      const middle = minus(chosen), half = values(curve.band);
      const [high, low] = [middle.map((value, i) => value + half[i]), middle.map((value, i) => value - half[i])];
      traces.push({
        x: [...time, ...time.toReversed()], y: [...high, ...low.toReversed()], name: "95 % band", mode: "lines",
        line: { width: 0 }, fill: "toself", fillcolor: "rgba(0, 114, 178, 0.18)", hoverinfo: "skip",
      });
    }
    traces.push({ x: time, y: measured, name: "measured", ...dots });
    const after = now.step > 0;
    traces.push({ x: time, y: minus(given), name: after ? "as given" : "predicted", meta: after ? aside : {}, ...(after ? line("#E69F00", 1.5, "4px,2px") : line("#0072B2", 2)) });
    if (after) traces.push({ x: time, y: minus(chosen), name: "predicted", ...line("#0072B2", 2) });
    const ends = [time[0], time[time.length - 1]], bound = 2 * curve.noise;
    traces.push({
      x: [...ends, ...ends.toReversed()], y: [bound, bound, -bound, -bound], yaxis: "y2", name: "noise ± 2 std",
      mode: "lines", line: { width: 0 }, fill: "toself", fillcolor: "rgba(123, 135, 148, 0.25)", hoverinfo: "skip",
    });
    traces.push({ x: time, y: chosen, name: "residual", yaxis: "y2", showlegend: false, ...line("#0072B2", 1.2) });
    const from = curve.recorded ? values(curve.recorded[0]) : time;
    const layout = {
      height: 460, meta: { time_axis: true, bulk: true }, uirevision: `${curve.run} ${curve.kind}`,
      xaxis: { title: { text: "time [s]" }, anchor: "y2", range: [from[0], from[from.length - 1]] },
      yaxis: { title: { text: `${quantity} [${curve.unit}]` }, domain: [0.42, 1], anchor: "x" },
      yaxis2: { title: { text: `residual [${curve.unit}]` }, domain: [0, 0.36], anchor: "x" },
      shapes: curve.failing.map(([x0, x1]) => ({
        type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: "#F4F6F8", line: { width: 0 }, layer: "below",
      })),
    };
    return { data: traces, layout };
  };

  // Beside each tab: what the chosen step explains there, on runs of the chosen kind.
  const labelTabs = () => {
    const { kind } = runs[now.run];
    place.closest("section").querySelectorAll("[data-tab]").forEach((button) => {
      const label = button.nextElementSibling;
      const share = data.totals[kind]?.[button.dataset.tab]?.[now.step]?.[1];
      label.querySelector("small")?.remove();
      if (share !== undefined) label.append(Object.assign(document.createElement("small"), { textContent: ` ${percent(share)}` }));
    });
  };

  const show = () => {
    const curve = curveOf();
    labelTabs();
    if (!curve) {
      readout.textContent = "This run has no such channel.";
      chart.hidden = caption.hidden = true;
      return;
    }
    chart.hidden = caption.hidden = false;
    tell(curve);
    draw(chart, figureOf(curve));
    place.dispatchEvent(new CustomEvent("armdyn-shown", { detail: curve, bubbles: true }));
  };
  place.addEventListener("change", ({ target }) => {
    if (target.dataset.control) { now[target.dataset.control] = Number(target.value); show(); }
  });
  return {
    // Other predictions of the last step, for curves in the order of the data.
    update: (curves, totals) => {
      const last = data.steps.length - 1;
      curves.forEach((changed, i) => {
        if (!changed) return;
        const curve = data.curves[i];
        curve.residuals[last] = changed.residual;
        curve.band = null;
        [curve.rmse[last], curve.explained[last]] = [changed.rmse, changed.explained];
      });
      data.totals = totals;
      show();
    },
    choose: ({ channel: asked, step, run }) => {
      const channel = asked in data.channels ? asked : undefined;
      if (channel) now.channel = channel;
      for (const [name, value, count] of [["step", step, data.steps.length], ["run", run, runs.length]]) {
        if (value === undefined || value === null || !(Number(value) < count)) continue;
        now[name] = Number(value);
        place.querySelector(`[data-control=${name}][value="${now[name]}"]`)?.click();
      }
      if (channel) show();
    },
  };
};
