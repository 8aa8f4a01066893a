"""The tables of the benchmark's report."""

import numpy as np

from solvers.arrays import Array
from training.measuring.timing import SHIFT, shifted_geometric_mean
from training.reports.numbers import NONE, percentage, ratio, share, times, triple
from training.reports.tables import table

from .batches import LONGEST, SIZES
from .entrants import EntrantFacts
from .measure import Measured
from .polygons import INNER
from .problem_sets import CONTACT_SETS, LOAD_FACTORS, MIX
from .rows import micro, percentile
from .run import Benchmark

_COMPARED = 4096

REFERENCES = ("clarabel", "moreau")
"""Keys of the peers that all others are compared with."""


def main_sets(benchmark: Benchmark) -> list[str]:
    """Names of the contact sets that there are, and of the mix."""
    return [name for name in (*CONTACT_SETS, MIX) if name in benchmark.results]


def load_sets(benchmark: Benchmark) -> dict[float, str]:
    """Names of the sets near the edge, by their load."""
    names = {factor: f"load x{factor:g}" for factor in LOAD_FACTORS}
    return {factor: name for factor, name in names.items() if name in benchmark.results}


def scaled_names(benchmark: Benchmark) -> list[str]:
    """Names of the sets with scaled limits."""
    return [name for name in benchmark.results if name.startswith(("friction", "torque"))]


def ran(benchmark: Benchmark, name: str) -> list[tuple[EntrantFacts, Measured]]:
    """Who has figures on a set."""
    results = benchmark.results[name]
    return [(each, results[each.key]) for each in benchmark.entrants if each.key in results]


def speed(benchmark: Benchmark, name: str, key: str, reference: str) -> float | None:
    """How many times as fast as a reference on a set, conversion included; median of the blocks."""
    results = benchmark.results[name]
    if key not in results or reference not in results:
        return None
    mine, other = results[key].converted, results[reference].converted
    if len(mine) == len(other):
        return float(np.median(other / mine))
    return float(np.median(other) / np.median(mine))


def comparison_size(benchmark: Benchmark) -> int:
    """The batch size at which solvers are compared: 4,096, or the largest that was measured."""
    return max(size for size in benchmark.plan.batch_sizes if size <= _COMPARED)


def throughput(benchmark: Benchmark, key: str) -> float | None:
    """us a problem of the mix, conversion included, in batches of `comparison_size`."""
    found = benchmark.batch(key, comparison_size(benchmark))
    return None if found is None else micro(found.converted)


def batch_speed(benchmark: Benchmark, key: str, reference: str) -> float | None:
    """How many times as fast as a reference in such batches; median of the repeats."""
    size = comparison_size(benchmark)
    mine, other = (benchmark.batch(name, size) for name in (key, reference))
    if mine is None or other is None:
        return None
    if len(mine.converted) == len(other.converted):
        return float(np.median(other.converted / mine.converted))
    return float(np.median(other.converted) / np.median(mine.converted))


def settled(measured: Measured) -> float:
    """Share of problems that were answered accurately, or proven infeasible."""
    return float(np.mean(measured.settled))


def geometric_mean(benchmark: Benchmark, key: str) -> float | None:
    """us, shifted geometric mean over the blocks of all sets, failures penalised."""
    blocks = [results[key].penalised for results in benchmark.results.values() if key in results]
    return 1e6 * shifted_geometric_mean(np.concatenate(blocks), SHIFT) if blocks else None


def sets_table(benchmark: Benchmark) -> str:
    """Sizes and shares of the problem sets."""
    lines = []
    for name in (*main_sets(benchmark), *scaled_names(benchmark), *load_sets(benchmark).values()):
        each = benchmark.sets[name]
        least, most = each.contacts
        contacts = f"{least}-{most}" if least < most else f"{least}"
        count, feasible = f"{len(each.feasible):,}", float(np.mean(each.feasible))
        lines.append((name, count, contacts, share(feasible), share(each.known)))
    return table(("set", "problems", "contacts", "feasible", "truth certain"), lines, "lr")


def solvers_table(benchmark: Benchmark) -> str:
    """Who takes part, with versions and settings."""
    lines = [(each.title, each.version, each.settings) for each in benchmark.entrants]
    return table(("solver", "version", "settings"), lines, "l")


def time_table(benchmark: Benchmark) -> str:
    """Time a problem by set, and speeds relative to the references."""
    names = main_sets(benchmark)
    lines = []
    for each, mixed in ran(benchmark, MIX):
        alone = [
            times(micro(benchmark.results[name][each.key].alone))
            if each.key in benchmark.results[name]
            else NONE
            for name in names
        ]
        stages = [times(micro(mixed.converted)), times(micro(mixed.judged))]
        speeds = [ratio(speed(benchmark, MIX, each.key, other)) for other in REFERENCES]
        lines.append((_mark(each), *alone, *stages, *speeds))
    headings = [name if name == MIX else f"{name} contacts" for name in names]
    return table(
        ("solver", *headings, "mix, converted", "mix, judged", "vs. Clarabel", "vs. Moreau"),
        lines,
        "lr",
    )


def batch_table(benchmark: Benchmark) -> str:
    """Time a problem by batch size."""
    sizes = benchmark.plan.batch_sizes
    lines = []
    for each in benchmark.entrants:
        cells = []
        for size in sizes:
            found = benchmark.batch(each.key, size)
            if found is None:
                cells.append(f"over {LONGEST:.0f} s" if size == SIZES[-1] else NONE)
            else:
                star = "*" if found.subset is not None else ""
                cells.append(times(micro(found.converted)) + star)
        speeds = [ratio(batch_speed(benchmark, each.key, other)) for other in REFERENCES]
        call = benchmark.batch(each.key, 1)
        whole = NONE if call is None else times(micro(call.judged))
        lines.append((_mark(each), *cells, *speeds, whole))
    compared = f"{comparison_size(benchmark):,}"
    headings = [*(f"{size:,}" for size in sizes), f"{compared}, vs. Clarabel"]
    headings += [f"{compared}, vs. Moreau", "`solve`, one problem"]
    return table(("solver", *headings), lines, "lr")


def geometric_table(benchmark: Benchmark) -> str:
    """Shifted geometric means, best first."""
    means = {
        each: mean
        for each in benchmark.entrants
        if (mean := geometric_mean(benchmark, each.key)) is not None and not each.feasible_only
    }
    best = min(means.values())
    lines = []
    for each, mean in sorted(means.items(), key=lambda item: item[1]):
        masks = [
            found[each.key].settled for found in benchmark.results.values() if each.key in found
        ]
        done = float(np.mean(np.concatenate(masks)))
        lines.append((_mark(each), times(mean), f"{mean / best:.1f}", share(done)))
    return table(("solver", "µs", "over the best", "settled"), lines, "lr")


def answers_table(benchmark: Benchmark) -> str:
    """Statuses and gaps on the mix, wrong statuses on all sets."""
    lines = []
    for each, mixed in ran(benchmark, MIX):
        wrong = [
            int(found[each.key].wrong.sum())
            for found in benchmark.results.values()
            if each.key in found
        ]
        shares = [
            share(mixed.share(name)) for name in ("optimal", "feasible", "infeasible", "failed")
        ]
        gap, violation, balance = (
            triple(tuple(percentile(np.abs(values), which) for which in (50, 90, 99)))
            for values in (mixed.gap, mixed.violation, mixed.balance)
        )
        handed = share(float(np.mean(mixed.fallen_back)))
        done = share(settled(mixed))
        lines.append((_mark(each), done, *shares, str(sum(wrong)), handed, gap, violation, balance))
    headings = ("optimal", "feasible", "infeasible, proven", "failed", "wrong, all sets")
    sizes = ("handed on", "gap", "violation", "balance")
    return table(("solver", "settled", *headings, *sizes), lines, "lr")


def settled_table(benchmark: Benchmark, names: dict[str, str]) -> str:
    """Share settled by set. `names` maps sets to headings."""
    lines = []
    for each in benchmark.entrants:
        found = [benchmark.results[name].get(each.key) for name in names]
        cells = [NONE if one is None else share(settled(one)) for one in found]
        lines.append((_mark(each), *cells))
    return table(("solver", *names.values()), lines, "lr")


def converted_table(benchmark: Benchmark, names: dict[str, str]) -> str:
    """Time with conversion by set. `names` maps sets to headings."""
    lines = []
    for each in benchmark.entrants:
        found = [benchmark.results[name].get(each.key) for name in names]
        cells = [NONE if one is None else times(micro(one.converted)) for one in found]
        lines.append((_mark(each), *cells))
    return table(("solver", *names.values()), lines, "lr")


def network_table(benchmark: Benchmark) -> str:
    """The network's accuracy."""
    network = benchmark.network
    if network is None:
        return "Nothing to report: its packages are not installed, or no problem was feasible."

    def sizes(values: Array, *which: float) -> str:
        return triple(tuple(percentile(values, one) for one in which))

    steps = [
        float(np.mean(each)) if len(each) else 0.0 for each in (network.steps, network.cold_steps)
    ]
    over = network.train_ratio
    lines = [
        (
            "dual gap of its multipliers, nothing repaired: median / p90 / p99",
            sizes(network.dual_gap, 50, 90, 99),
        ),
        ("feasible problems that its own repair answers feasibly", share(network.feasible_share)),
        ("certified gap of these: median / p90", sizes(network.gap, 50, 90)),
        ("the same share with 2 Newton steps", share(network.polished_share)),
        ("the same gap with 2 Newton steps", sizes(network.polished_gap, 50, 90)),
        ("with its fallback: gap within 1e-6 or proven infeasible", share(network.settled)),
        (
            "Newton steps to a gradient of 1e-9, from the network / from cold (mean)",
            f"{steps[0]:.1f} / {steps[1]:.1f}",
        ),
        (
            "median dual gap, held-out over training objects",
            NONE if over is None else f"{over:.2f}",
        ),
    ]
    count = len(network.dual_gap)
    return table((f"on {count:,} feasible problems of the mix", "value"), lines, "lr")


def device_table(benchmark: Benchmark) -> str:
    """Throughput on a GPU."""
    lines = [
        (
            figures.title,
            f"{figures.size:,}",
            times(1e6 * figures.seconds / figures.size),
            share(figures.certified),
            f"{figures.per_second:,.0f}",
        )
        for figures in benchmark.device
    ]
    headings = ("solver", "batch", "µs per problem", "certified or proven", "of these per second")
    return table(headings, lines, "lr")


def polygon_table(benchmark: Benchmark) -> str:
    """The audit of linear cones on the mix."""
    lines = []
    for audit in benchmark.polygons[MIX]:
        far = 90 if audit.kind == INNER else 10
        effort = [percentile(audit.extra_effort, which) for which in (50, far)]
        slip = [percentile(audit.slip, which) for which in (50, 100)]
        wrong = audit.falsely_infeasible if audit.kind == INNER else audit.falsely_feasible
        lines.append(
            (
                f"{audit.kind}, {audit.sides} sides",
                " / ".join(map(percentage, effort)),
                " / ".join(map(percentage, slip)),
                share(wrong),
                share(audit.undecided),
            )
        )
    return table(
        ("polygon", "effort over the optimum", "excess over true friction", "wrong", "undecided"),
        lines,
        "lr",
    )


def polygon_load_table(benchmark: Benchmark) -> str:
    """Wrong answers about feasibility by load."""
    names = polygon_loads(benchmark)
    audits = [benchmark.polygons[name] for name in names.values()]
    lines = []
    for index, first in enumerate(audits[0]):
        inner = first.kind == INNER
        wrong = [
            audit[index].falsely_infeasible if inner else audit[index].falsely_feasible
            for audit in audits
        ]
        # an inner polygon cannot be wrong above the edge, an outer one not below it
        cells = [
            share(value) if inner == (factor < 1.0) else "exact"
            for factor, value in zip(names, wrong, strict=True)
        ]
        lines.append((f"{first.kind}, {first.sides} sides", *cells))
    return table(("polygon", *(f"{factor:g}" for factor in names)), lines, "lr")


def polygon_loads(benchmark: Benchmark) -> dict[float, str]:
    """Names of the audited sets near the edge, by their load."""
    loads = load_sets(benchmark)
    return {factor: name for factor, name in loads.items() if name in benchmark.polygons}


def _mark(entrant: EntrantFacts) -> str:
    return f"{entrant.title} †" if entrant.feasible_only else entrant.title
