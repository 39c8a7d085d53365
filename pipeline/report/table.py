"""Report of Table I of the paper: which first guesses of the string's length succeed, with and without estimation."""

import math

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Column, Document, KeyFigure, ResultLevel, Section, Table
from pipeline.report.theme import BLUE, GREY, ORANGE, TRUTH_STYLE, number_text, percent_text
from pipeline.trial.table import STRING_LENGTH_GUESSES, TableOne

BOX_NOTE = (
    "The paper gives no box. This one was chosen so that the simulation reproduces the paper's table: the rows without "
    "estimation show that such a box exists and are not a prediction. The height of its rim is the sensitive number."
)
PAPER_STRING_LENGTH_STD = 0.0042
"""Standard deviation of the string lengths that the paper estimated [m]."""
MIN_SUCCESSFUL_SEED_SHARE = 0.5
"""Share of random seeds above which a first guess of the length counts as successful."""


def table_one_report(table: TableOne) -> Document:
    """Report of Table I of the paper: share of successful trials and estimated lengths, by first guess of length."""
    estimates, total = table.estimates, len(STRING_LENGTH_GUESSES)
    without, with_estimation = (percent_text(float(shares.mean())) for shares in table.success_shares)
    as_paper = np.count_nonzero((table.success_shares[0] > MIN_SUCCESSFUL_SEED_SHARE) == table.succeeded_in_paper)
    learnt = np.count_nonzero(table.success_shares[1] > MIN_SUCCESSFUL_SEED_SHARE)
    spread = f"std; {number_text(PAPER_STRING_LENGTH_STD, 'm', 2)} in the paper"
    return Document(
        title="Table I: does learning the length help?",
        level=ResultLevel.BAD if learnt < total else ResultLevel.GOOD if as_paper == total else ResultLevel.CAUTION,
        verdict=f"With estimation {learnt} of {total} guesses succeed in most seeds; without it {as_paper} of {total} "
        "end as in the paper, where only 0.368 m and 0.388 m succeed.",
        sections=[_success_section(table), _estimates_section(table)],
        subtitle=f"{table.seeds} seeds per guess",
        key_figures=(
            KeyFigure("Length estimated", with_estimation, "of trials succeed"),
            KeyFigure("Length not estimated", without, "of trials succeed"),
            KeyFigure("Mean estimate", f"{estimates.mean():.4f} m", f"true length {table.true_length:.4f} m"),
            KeyFigure("Spread", number_text(float(estimates.std()), "m", 2), spread),
            KeyFigure("Seeds", str(table.seeds), "per guess"),
            KeyFigure("Truth", percent_text(table.covered_share), "of estimates within 3 of their standard deviations"),
        ),
        notes=[BOX_NOTE],
    )


def _success_section(table: TableOne) -> Section:
    figure = go.Figure(layout={"height": 380, "barmode": "group"})
    guesses = [f"{guess:.3f}" for guess in STRING_LENGTH_GUESSES]
    without, learnt = table.success_shares.tolist()
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
    rows = Table([
        Column("guess [m]", guesses),
        Column("without", list(map(percent_text, without))),
        Column("with", list(map(percent_text, learnt))),
        Column("paper, without", ["succeeds" if succeeds else "fails" for succeeds in table.succeeded_in_paper]),
        Column("paper, with", ["succeeds"] * len(STRING_LENGTH_GUESSES)),
        Column("mean estimate [m]", table.estimates.mean(axis=1).tolist(), ".4f"),
        Column("std [mm]", (1e3 * table.estimates.std(axis=1)).tolist(), ".2f"),
    ])  # fmt: skip
    sentence = (
        f"Share of {table.seeds} seeds that put the load into the box, per first guess of the length "
        f"(the true one is {table.true_length:.3f} m)."
    )
    caption = "Whiskers: 95 % interval of the share for this number of seeds (Wilson 1927)."
    return Section("Success", sentence, [Chart(figure, caption)], [rows])


def _estimates_section(table: TableOne) -> Section:
    estimates = table.estimates
    error = float(estimates.mean() - table.true_length)
    sentence = (
        f"Over {estimates.size} trials from all guesses the mean error of the length is {number_text(error, 'm', 2)}, "
        f"with a standard deviation of {number_text(float(estimates.std()), 'm', 2)}."
    )
    figure = go.Figure(layout={"height": 340, "hovermode": "closest", "showlegend": False, "margin": {"t": 30}})
    rng = np.random.default_rng(0)  # spread points that would cover each other
    for i, (guess, errors) in enumerate(zip(STRING_LENGTH_GUESSES, 1e3 * table.errors, strict=True)):
        figure.add_scatter(
            x=i + rng.uniform(-0.18, 0.18, errors.size), y=errors, name=f"guess {guess:.3f} m",
            mode="markers", marker={"color": BLUE, "size": 6, "opacity": 0.65},
        )  # fmt: skip
    figure.add_scatter(x=[-0.5, len(STRING_LENGTH_GUESSES) - 0.5], y=[0, 0], name="truth", **TRUTH_STYLE)
    figure.update_xaxes(
        title_text="first guess of the length [m]", tickvals=list(range(len(STRING_LENGTH_GUESSES))),
        ticktext=[f"{guess:.3f}" for guess in STRING_LENGTH_GUESSES], showgrid=False, zeroline=False,
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
