"""The report of the paper's Table I: which first guesses of the length succeed, with and without estimation."""

import math

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Column, Document, KeyFigure, Level, Section, Table
from pipeline.report.theme import BLUE, GREY, ORANGE, TRUTH, number, percent
from pipeline.trial.table import TableOne

BOX_NOTE = (
    "The paper gives no box. This one was chosen so that the simulation reproduces the paper's table: the rows without "
    "estimation show that such a box exists and are no prediction. The height of its rim is the sensitive number."
)
PAPER_STD = 0.0042
"""Standard deviation [m] of the paper's length estimates."""
SUCCESS_SHARE = 0.5
"""Share of seeds beyond which a guess succeeds."""


def table_report(table: TableOne) -> Document:
    """The report of Table I: success and learnt lengths by first guess."""
    estimates, total = table.estimates, len(table.rows)
    as_paper = sum((row.without > SUCCESS_SHARE) == row.in_paper for row in table.rows)
    learnt = sum(row.with_estimation > SUCCESS_SHARE for row in table.rows)
    with_estimation, without = (
        percent(float(np.mean([getattr(row, name) for row in table.rows]))) for name in ("with_estimation", "without")
    )
    spread = f"std; {number(PAPER_STD, 'm', 2)} in the paper"
    return Document(
        title="Table I: does learning the length help?",
        level=Level.BAD if learnt < total else Level.GOOD if as_paper == total else Level.CAUTION,
        verdict=f"With estimation {learnt} of {total} guesses succeed in most seeds; without it {as_paper} of {total} "
        "end as in the paper, where only 0.368 m and 0.388 m succeed.",
        sections=[_success_section(table), _estimates_section(table)],
        subtitle=f"{table.seeds} seeds per guess",
        key_figures=(
            KeyFigure("With estimation", with_estimation, "of trials succeed"),
            KeyFigure("Without", without, "of trials succeed"),
            KeyFigure("Mean estimate", f"{estimates.mean():.4f} m", f"true length {table.length:.4f} m"),
            KeyFigure("Spread", number(float(estimates.std()), "m", 2), spread),
            KeyFigure("Seeds", str(table.seeds), "per guess"),
            KeyFigure("Truth", percent(table.covered), "of estimates within 3 of their standard deviations"),
        ),
        notes=[BOX_NOTE],
    )


def _success_section(table: TableOne) -> Section:
    figure = go.Figure(layout={"height": 380, "barmode": "group"})
    guesses = [f"{row.length_guess:.3f}" for row in table.rows]
    without, learnt = ([getattr(row, name) for row in table.rows] for name in ("without", "with_estimation"))
    for name, colour, shares in (("without estimation", ORANGE, without), ("with estimation", BLUE, learnt)):
        low, high = 100 * np.transpose([success_interval(share, table.seeds) for share in shares])
        seen = 100 * np.array(shares)
        whiskers = {"array": high - seen, "arrayminus": seen - low, "color": GREY, "thickness": 1.2, "width": 4}
        figure.add_bar(
            x=guesses, y=seen, name=name, marker={"color": colour},
            error_y={"type": "data", "symmetric": False, **whiskers},
        )  # fmt: skip
    figure.update_xaxes(title_text="first guess of the length [m]", type="category")
    figure.update_yaxes(title_text="success [%]", range=[0, 104])
    estimates = [np.array(row.length_estimates) for row in table.rows]
    rows = Table([
        Column("guess [m]", guesses),
        Column("without", list(map(percent, without))),
        Column("with", list(map(percent, learnt))),
        Column("paper, without", ["succeeds" if row.in_paper else "fails" for row in table.rows]),
        Column("paper, with", ["succeeds"] * len(table.rows)),
        Column("mean estimate [m]", [float(e.mean()) if e.size else None for e in estimates], ".4f"),
        Column("std [mm]", [1e3 * float(e.std()) if e.size else None for e in estimates], ".2f"),
    ])  # fmt: skip
    sentence = (
        f"Share of {table.seeds} seeds that put the load into the box, per first guess of the length "
        f"(the true one is {table.length:.3f} m)."
    )
    caption = "Whiskers: 95 % interval of the share for this number of seeds (Wilson 1927)."
    return Section("Success", sentence, [Chart(figure, caption)], [rows])


def _estimates_section(table: TableOne) -> Section:
    estimates = table.estimates
    error = float(estimates.mean() - table.length)
    sentence = (
        f"Over {estimates.size} trials from all guesses the mean error of the length is {number(error, 'm', 2)}, "
        f"with a standard deviation of {number(float(estimates.std()), 'm', 2)}."
    )
    figure = go.Figure(layout={"height": 340, "hovermode": "closest", "showlegend": False, "margin": {"t": 30}})
    rng = np.random.default_rng(0)  # spread points that would cover each other
    for i, row in enumerate(table.rows):
        errors = 1e3 * (np.array(row.length_estimates) - table.length)
        figure.add_scatter(
            x=i + rng.uniform(-0.18, 0.18, errors.size), y=errors, name=f"guess {row.length_guess:.3f} m",
            mode="markers", marker={"color": BLUE, "size": 6, "opacity": 0.65},
        )  # fmt: skip
    figure.add_scatter(x=[-0.5, len(table.rows) - 0.5], y=[0, 0], name="truth", **TRUTH)
    figure.update_xaxes(
        title_text="first guess of the length [m]", tickvals=list(range(len(table.rows))),
        ticktext=[f"{row.length_guess:.3f}" for row in table.rows], showgrid=False, zeroline=False,
    )  # fmt: skip
    figure.update_yaxes(title_text="estimate − truth [mm]")
    return Section("Estimates", sentence, [Chart(figure, "A point per trial; dotted: the truth.")])


def success_interval(share: float, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Confidence interval of a success probability, from the `share` of `trials` that succeeded.

    Args:
        share: observed share of successes.
        trials: number of trials, at least one.
        z: standard deviations, 1.96 for 95 %.

    Returns:
        Lower and upper end of the interval.

    Source: Wilson 1927, J. Am. Stat. Assoc. 22:209, equation 1.
    """
    scale = 1 + z**2 / trials
    middle = (share + z**2 / (2 * trials)) / scale
    half = z / scale * math.sqrt(share * (1 - share) / trials + z**2 / (4 * trials**2))
    return max(0.0, middle - half), min(1.0, middle + half)
