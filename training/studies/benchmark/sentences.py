"""What the figures say in a few lines, in sentences that are chosen by the figures."""

import numpy as np

from training.reports.numbers import factor, listed, percentage, ratio, share, times

from . import tables
from .entrants import EntrantFacts
from .polygons import INNER, OUTER
from .problem_sets import MIX
from .rows import micro, percentile
from .run import Benchmark

_EXACT = ("dual_newton", "interior_point", "dual_newton_torch")


def summary(benchmark: Benchmark) -> str:
    """A list of what a hurried reader wants to know."""
    points = [_speed_point(benchmark), _status_point(benchmark), _edge_point(benchmark)]
    points += [_network_point(benchmark), _polygon_point(benchmark)]
    return "\n".join(f"- {point}" for point in points if point)


def best_exact(benchmark: Benchmark) -> tuple[EntrantFacts, float] | None:
    """The fastest exact solver of this project, one thread, and its us a problem of the mix."""
    there = [
        (each, time)
        for each in benchmark.entrants
        if each.key in _EXACT and (time := tables.throughput(benchmark, each.key)) is not None
    ]
    return min(there, key=lambda item: item[1], default=None)


def _speed_point(benchmark: Benchmark) -> str:
    found = [
        (each, time)
        for each in benchmark.entrants
        if each.threads == 1 and not each.feasible_only
        if (time := tables.throughput(benchmark, each.key)) is not None
    ]
    entrant, time = min(found, key=lambda item: item[1])
    size = tables.comparison_size(benchmark)
    batches = f"in batches of {size:,}" if size > 1 else "one by one"
    text = (
        f"Fastest on the mix, {batches}, one core, conversion included: {entrant.title}, "
        f"{times(time)} µs per problem"
    )
    speeds = []
    for key in tables.REFERENCES:
        speed = tables.batch_speed(benchmark, entrant.key, key)
        if speed is not None and key != entrant.key:
            speeds.append(f"{ratio(speed)} as fast as {key.capitalize()}")
    text += f" ({listed(speeds)})." if speeds else "."
    own = best_exact(benchmark)
    if own is None:
        return text + " The structured solvers of this project did not take part."
    if own[0] is not entrant:
        text += f" The fastest structured solver here, {own[0].title}, needs {times(own[1])} µs."
    return text


def _status_point(benchmark: Benchmark) -> str:
    wrong: dict[str, int] = {}
    failed: dict[str, float] = {}
    for each in benchmark.entrants:
        found = [results[each.key] for results in benchmark.results.values() if each.key in results]
        wrong[each.title] = sum(int(measured.wrong.sum()) for measured in found)
        unsettled = ~np.concatenate([measured.settled for measured in found])
        if not each.feasible_only:
            failed[each.title] = float(np.mean(unsettled))
    guilty = [f"{title} ({count})" for title, count in wrong.items() if count]
    text = (
        f"Wrong statuses, all sets: {listed(guilty)}."
        if guilty
        else "No judged status was wrong, on any set: what a solver cannot show, counts as failed."
    )
    complete = [title for title, value in failed.items() if value == 0.0]
    if complete:
        text += f" Every problem of every set was settled by {listed(complete)}."
    else:
        title = min(failed, key=lambda name: failed[name])
        text += f" No solver settled every problem; {title} came closest, {share(failed[title])} "
        text += "were left."
    return text


def _edge_point(benchmark: Benchmark) -> str:
    loads = tables.load_sets(benchmark)
    own = best_exact(benchmark)
    if not loads or own is None:
        return ""
    key = own[0].key
    usual = micro(benchmark.results[MIX][key].converted)
    below = [benchmark.results[name].get(key) for load, name in loads.items() if load < 1]
    slowest = max((micro(m.converted) for m in below if m is not None), default=usual)
    return (
        f"Near the edge of feasibility {own[0].title} slows down to {times(slowest)} µs, "
        f"{factor(slowest / usual)} times its time on the mix."
    )


def _network_point(benchmark: Benchmark) -> str:
    own, polished = best_exact(benchmark), tables.throughput(benchmark, "network_polished")
    if own is None or polished is None:
        return ""
    longer = polished / own[1]
    if longer > 1:
        return (
            f"On a CPU the network does not beat the structured solver: with 2 Newton steps it "
            f"takes {factor(longer)} times as long as {own[0].title}."
        )
    return f"With 2 Newton steps the network takes {factor(longer)} of the time of {own[0].title}."


def _polygon_point(benchmark: Benchmark) -> str:
    by_kind = {(each.kind, each.sides): each for each in benchmark.polygons[MIX]}
    inner, outer = by_kind[INNER, 8], by_kind[OUTER, 8]
    return (
        "Eight-sided friction cones, which many planners use: inside the circle they cost "
        f"{percentage(percentile(inner.extra_effort, 50))} effort (median) and call "
        f"{share(inner.falsely_infeasible)} of feasible grasps infeasible; around it the forces "
        f"slip by up to {percentage(percentile(outer.slip, 100))} of the friction limit."
    )
