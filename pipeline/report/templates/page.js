"use strict";
(() => {
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const template = read("figure-template");
  const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };
  const charts = read("figures").map(({ data, layout }, i) => {
    const chart = document.getElementById(`chart-${i}`);
    Plotly.newPlot(chart, data, { ...layout, template, autosize: true }, config);
    return chart;
  });

  // Zooming one figure over time zooms all of them: what failed at 3.2 s is seen everywhere.
  const overTime = charts.filter((chart) => chart.layout.meta?.time_axis);
  let zooming = false;
  for (const chart of overTime) {
    chart.on("plotly_relayout", async (change) => {
      const axis = Object.keys(change).find((key) => /^xaxis\d*\.(range|autorange)/.test(key))?.split(".")[0];
      if (zooming || !axis) return;
      zooming = true;
      const { range, autorange } = chart.layout[axis];
      const all = Object.keys(change).some((key) => key.endsWith(".autorange")) && autorange;
      for (const other of overTime.filter((c) => c !== chart)) {
        const axes = Object.keys(other.layout).filter((key) => /^xaxis\d*$/.test(key));
        await Plotly.relayout(other, Object.fromEntries(
          axes.map((key) => (all ? [`${key}.autorange`, true] : [`${key}.range`, [...range]]))));
      }
      zooming = false;
    });
  }

  const links = new Map([...document.querySelectorAll("nav a")].map((link) => [link.hash.slice(1), link]));
  const sections = [...document.querySelectorAll("main, section")].filter((part) => links.has(part.id));
  const mark = () => {
    const here = sections.filter((part) => part.getBoundingClientRect().top < 120).pop() ?? sections[0];
    links.forEach((link, id) => link.classList.toggle("here", id === here.id && id !== "top"));
  };
  addEventListener("scroll", mark, { passive: true });
  mark();

  // Paper is narrower than the screen.
  addEventListener("beforeprint", () => charts.forEach((chart) => Plotly.relayout(chart, { width: 690, autosize: false })));
  addEventListener("afterprint", () => charts.forEach((chart) => Plotly.relayout(chart, { width: null, autosize: true })));
})();
