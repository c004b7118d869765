"""The list of all figures: name, title, what a reader sees in it, and which settings have it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from .braking import parameter_and_diversity
from .canvas import Canvas
from .channel import headway, receptions
from .cost import accuracy_against_latency
from .data import CROWD, CellResults, Results
from .errors import error_over_time, errors_per_run
from .example import example_run
from .metro import speed_profile
from .moving_block import gap_over_time, track, trains_over_time
from .random_access import trace_and_bounds
from .ranks import critical_difference
from .recorded import errors_by_outage, recorded_trip
from .requirements import claim_against_error, error_under_allowance, width_against_misses
from .sections import errors_by_phase, errors_by_section
from .trust import certified_against_measured, nees_over_time, nis_over_time

APART = (f"Of more than {CROWD} entries it shows each family's best by the first quantity; railstate plot --entries "
         "chooses.")


@dataclass(frozen=True)
class Figure:
    """A figure of a cell (`draw`) or of a whole scenario (`draw_all`). Either returns None where there is no data.

    kinds: plant kinds that have it (empty: any)."""

    name: str
    title: str
    caption: str
    draw: Callable[[CellResults], Canvas | None] | None = None
    draw_all: Callable[[Sequence[CellResults]], Canvas | None] | None = None
    kinds: tuple[str, ...] = ()


FIGURES: tuple[Figure, ...] = (
    Figure("error-over-time", "Error over time",
           "Root mean square error at each instant over the runs that finished, as in the table; with up to eight "
           "estimators a band shows its 95 % interval.", error_over_time),
    Figure("errors-per-run", "Error per run",
           "One value per run: box from the first to the third quartile, bar at the median, line from 5 % to 95 %, "
           "dots at the extremes.", errors_per_run),
    Figure("accuracy-latency", "Accuracy against latency",
           "Lower left is better. Marker at the median time of one step of one run, line to its 99th percentile.",
           accuracy_against_latency),
    Figure("nees", "NEES over time",
           "1 is consistent, above is too sure, below too cautious. A consistent estimator stays in the grey band at "
           f"95 % of the steps. {APART}", nees_over_time),
    Figure("nis", "NIS over time",
           "The innovations against what the filter expects of them: no truth is needed. 1 is consistent, above is too "
           f"sure, below too cautious; a consistent filter stays in the grey band at 95 % of the steps. {APART}",
           nis_over_time),
    Figure("certified", "Certified bound against measured mean square",
           "A promise is kept where the measured value lies left of its bar.", certified_against_measured),
    Figure("example", "An example run",
           "The first kept run: the truth of each quantity, and below it the estimators' errors; where some are "
           f"many times larger (off), what of them fits in. {APART}", example_run),
    Figure("allowance", "Error under the allowance",
           "First kept run: error of the distance travelled since the last balise (marks at the foot), and what is "
           "allowed of it, which grows from balise to balise: fewer balises can give a better verdict.",
           error_under_allowance),
    Figure("width-misses", "Width of the claim against its misses",
           "Lower left is better. The dashed line is the share of misses that the requirement admits.",
           width_against_misses),
    Figure("stanford", "Claim against error",
           "First kept run, a point a step. In the grey the claimed interval misses the truth: hazardous where the "
           "interval is relied on.", claim_against_error),
    Figure("critical-difference", "Ranks over all variants",
           "Mean rank (1 is best) with the variants as blocks, and Friedman's p that all are alike. Bars join "
           "estimators whose ranks differ by less than Nemenyi's critical difference.", draw_all=critical_difference),
    Figure("speed-profile", "The trip",
           "First kept run over its position: speeds true and estimated, errors of the estimated speed, the line's "
           "gradients, and the disturbance no estimator knows.",
           speed_profile, kinds=("metro",)),
    Figure("sections", "Errors by section",
           "Root mean square error on each section of the trip, over the runs that finished.", errors_by_section,
           kinds=("metro",)),
    Figure("phases", "Errors by phase of driving",
           "Root mean square error while the train stands (under 0.05 m/s), accelerates (over 0.1 m/s²), coasts or "
           "brakes (under −0.1 m/s²), by its true speed, over the runs that finished; numbers: tables/*-phases.md.",
           errors_by_phase),
    Figure("recorded-trip", "The recorded trip",
           "First kept run. Bands are two claimed standard deviations wide on either side; grey: readings are out.",
           recorded_trip, kinds=("recorded",)),
    Figure("outages", "Errors by outage",
           "One point a run: the error at the end of the outage over where the outage begins.", errors_by_outage,
           kinds=("recorded",)),
    Figure("parameter", "The parameter f and the particles' diversity",
           "Above, f and its estimates averaged over all runs; with up to eight estimators a band shows one standard "
           "deviation of single runs. Below, how many values of f are left among the particles of the first kept run. "
           f"{APART}",
           parameter_and_diversity, kinds=("braking",)),
    Figure("receptions", "What came through the channel",
           "First kept run in windows: share of packets that arrived, and the longest wait for one.", receptions,
           kinds=("coupled-cars",)),
    Figure("headway", "Headway",
           "Time between trains that each estimator's largest position error allows; bands are 95 % intervals.",
           headway, kinds=("coupled-cars",)),
    Figure("trace", "Trace of P and its bounds",
           "First kept run of the filter that the bounds are about. They are those of the smallest and largest "
           "eigenvalue, times the number of states.",
           trace_and_bounds, kinds=("linear",)),
    Figure("track", "The track",
           "From above, with tags, the noses of A and B at some instants of the first kept run, and where each was "
           "believed to be then.", track,
           kinds=("moving-block",)),
    Figure("trains", "Both trains under moving and fixed block",
           "Way of the leader's and the follower's nose in the first kept run; bars mark the gap between the leader's "
           "tail and the follower's nose.", draw_all=trains_over_time,
           kinds=("moving-block",)),
    Figure("gap", "Gap between the trains",
           "True gap in the first kept run; each estimator drives its own loop. Dashed: the least admitted; dotted: "
           "d_min(k), under which the synchronization acts.", gap_over_time,
           kinds=("moving-block",)),
)


def drawn(results: Results, name: str | None = None) -> Iterator[tuple[Figure, str, str, Canvas]]:
    """(figure, scenario, variant or "", canvas) of everything that has data, or of one figure by name."""
    for figure in FIGURES:
        if name is None or figure.name == name:
            for scenario, cells in results.scenarios.items():
                yield from ((figure, scenario, variant, canvas) for variant, canvas in of_scenario(figure, cells))


def of_scenario(figure: Figure, cells: Sequence[CellResults]) -> Iterator[tuple[str, Canvas]]:
    """(variant, canvas) of one figure in a scenario; variant "" for a figure of the whole scenario."""
    if figure.kinds and cells[0].about["kind"] not in figure.kinds:
        return
    if figure.draw_all:
        canvas = figure.draw_all(cells)
        if canvas:
            yield "", canvas
    for cell in cells:
        canvas = figure.draw(cell) if figure.draw else None
        if canvas:
            yield cell.variant, canvas
