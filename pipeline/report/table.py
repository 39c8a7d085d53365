"""The report of the paper's Table I: which first guesses of the length succeed, with and without estimation."""

import math
from collections.abc import Iterable

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Document, KeyFigure, Level, Section, Table
from pipeline.report.theme import BLUE, GREY, ORANGE, TRUTH, number, percent
from pipeline.trial.table import TableOne, TableRow

BOX_NOTE = (
    "The paper gives no box. This one was chosen so that the simulation reproduces the paper's table: the rows without "
    "estimation show that such a box exists and are no prediction. The height of its rim is the sensitive number."
)
PAPER_STD = 0.0042
"""Standard deviation [m] of the paper's length estimates."""


def table_report(table: TableOne, subtitle: str = "") -> Document:
    """The report of the table."""
    estimates = table.estimates
    as_paper = [_succeeds(row.without) == row.in_paper for row in table.rows]
    learnt = [_succeeds(row.with_estimation) for row in table.rows]
    level = Level.GOOD if all(as_paper) and all(learnt) else Level.CAUTION if all(learnt) else Level.BAD
    return Document(
        title="Table I: does learning the length help?",
        level=level,
        verdict=_verdict(table, sum(as_paper), sum(learnt)),
        sections=[success_section(table), estimates_section(table)],
        subtitle=subtitle,
        key_figures=(
            KeyFigure(
                "With estimation", percent(_mean(row.with_estimation for row in table.rows)), "of trials succeed"
            ),
            KeyFigure("Without", percent(_mean(row.without for row in table.rows)), "of trials succeed"),
            KeyFigure("Mean estimate", f"{estimates.mean():.4f} m", f"true length {table.length:.4f} m"),
            KeyFigure(
                "Spread", number(float(estimates.std()), "m", 2), f"std; {number(PAPER_STD, 'm', 2)} in the paper"
            ),
            KeyFigure("Seeds", str(table.seeds), "per guess"),
            KeyFigure("Truth", percent(table.covered), "of estimates within 3 of their standard deviations"),
        ),
        notes=[BOX_NOTE],
    )


def success_section(table: TableOne) -> Section:
    """Success per guess, with and without estimation, as bars and as numbers beside the paper's."""
    figure = go.Figure(layout={"height": 380, "barmode": "group"})
    guesses = [f"{row.length_guess:.3f}" for row in table.rows]
    for name, colour, shares in (
        ("without estimation", ORANGE, [row.without for row in table.rows]),
        ("with estimation", BLUE, [row.with_estimation for row in table.rows]),
    ):
        low, high = zip(*[success_interval(share, table.seeds) for share in shares], strict=True)
        error = {
            "type": "data",
            "symmetric": False,
            "array": 100 * (np.array(high) - shares),
            "arrayminus": 100 * (np.array(shares) - low),
            "color": GREY,
            "thickness": 1.2,
            "width": 4,
        }
        figure.add_bar(x=guesses, y=100 * np.array(shares), name=name, marker={"color": colour}, error_y=error)
    figure.update_layout(
        xaxis={"title": {"text": "first guess of the length [m]"}, "type": "category"},
        yaxis={"title": {"text": "success [%]"}, "range": [0, 104]},
    )
    header = ["guess [m]", "without", "with", "paper, without", "paper, with", "mean estimate [m]", "std [mm]"]
    return Section(
        "Success",
        f"Share of {table.seeds} seeds that put the load into the box, per first guess of the length "
        f"(the true one is {table.length:.3f} m).",
        [Chart(figure, "Whiskers: 95 % interval of the share for this number of seeds (Wilson 1927).")],
        [Table.of(header, [_numbers(row) for row in table.rows])],
    )


def _numbers(row: TableRow) -> list[str]:
    estimates = np.array(row.length_estimates)
    return [
        f"{row.length_guess:.3f}",
        percent(row.without),
        percent(row.with_estimation),
        "succeeds" if row.in_paper else "fails",
        "succeeds",
        f"{estimates.mean():.4f}" if estimates.size else "–",
        f"{1e3 * estimates.std():.2f}" if estimates.size else "–",
    ]


def estimates_section(table: TableOne) -> Section:
    """Every length that was learnt, a point per trial, and mean and spread over all guesses."""
    estimates = table.estimates
    error = float(estimates.mean() - table.length)
    sentence = (
        f"Over {estimates.size} trials from all guesses the mean error of the length is {number(error, 'm', 2)}, "
        f"with a standard deviation of {number(float(estimates.std()), 'm', 2)}."
    )
    figure = go.Figure(layout={"height": 340, "hovermode": "closest", "showlegend": False, "margin": {"t": 30}})
    rng = np.random.default_rng(0)  # spreads points that would cover each other
    for i, row in enumerate(table.rows):
        errors = 1e3 * (np.array(row.length_estimates) - table.length)
        figure.add_scatter(
            x=i + rng.uniform(-0.18, 0.18, errors.size),
            y=errors,
            name=f"guess {row.length_guess:.3f} m",
            mode="markers",
            marker={"color": BLUE, "size": 6, "opacity": 0.65},
        )
    figure.add_scatter(x=[-0.5, len(table.rows) - 0.5], y=[0, 0], name="truth", **TRUTH)
    figure.update_layout(
        xaxis={
            "title": {"text": "first guess of the length [m]"},
            "tickvals": list(range(len(table.rows))),
            "ticktext": [f"{row.length_guess:.3f}" for row in table.rows],
            "showgrid": False,
            "zeroline": False,
        },
        yaxis={"title": {"text": "estimate − truth [mm]"}},
    )
    return Section("Estimates", sentence, [Chart(figure, "A point per trial; dotted: the truth.")])


def success_interval(share: float, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Interval of a success probability of which `share` of `trials` was seen.

    Args:
        share: seen.
        trials: number of them, at least one.
        z: standard deviations, 1.96 for 95 %.

    Returns:
        Lower and upper end.

    Source: Wilson 1927, J. Am. Stat. Assoc. 22:209, equation 1.
    """
    scale = 1 + z**2 / trials
    middle = (share + z**2 / (2 * trials)) / scale
    half = z / scale * math.sqrt(share * (1 - share) / trials + z**2 / (4 * trials**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def _verdict(table: TableOne, as_paper: int, learnt: int) -> str:
    total = len(table.rows)
    return (
        f"With estimation {learnt} of {total} guesses succeed in most seeds; without it {as_paper} of {total} end as "
        "in the paper, where only 0.368 m and 0.388 m succeed."
    )


def _succeeds(share: float) -> bool:
    return share > 0.5


def _mean(shares: Iterable[float]) -> float:
    return float(np.mean(list(shares)))
