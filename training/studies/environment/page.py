"""The page docs/environment.md: a text with gaps, the numbers that fill them, one picture."""

from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from gfo_env.simulation import SOLVER_ITERATIONS, TIME_STEP
from training.reports import pages
from training.reports.figures import CYCLE, STYLE, new_figure
from training.reports.numbers import percentage, rate, share
from training.reports.results import Run
from training.reports.tables import table

from .accuracy import WIDTH, Deviation
from .parallel import SQUEEZE
from .peer import PEER
from .recording import SOLVER
from .run import PLAIN, VECTOR, SpeedReport

_MAKE_PEER = """panda-gym was left out of this run. It wants an environment of its own:

```sh
python3.11 -m venv ~/panda
~/panda/bin/pip install panda-gym
python scripts/benchmark_env.py --peer-python ~/panda/bin/python
```"""


def write_page(run: Run[SpeedReport], path: Path) -> str:
    """Write the page, and its picture beside it under the same name; its summary.

    Args:
        run: what it is about.
        path: of the Markdown file.
    """
    fields = _fields(run.results) | {
        "command": run.command,
        "processor": run.machine["processor"],
        "cores": run.machine["cores"],
        "machine_table": table(["", "figure"], list(run.machine.items()), "l"),
    }
    pages.write_page(path, __package__, fields, {"": rates_figure(run.results)})
    return str(fields["summary"])


def _fields(report: SpeedReport) -> dict[str, object]:
    steps = report.steps
    return {
        "repeats": report.plan.repeats,
        "summary": summary(report),
        "substeps": steps.substeps,
        "time_step": 1e3 * TIME_STEP,
        "iterations": SOLVER_ITERATIONS,
        "episodes": f"{steps.episodes:,}",
        "steps": f"{steps.steps:,}",
        "solver": SOLVER,
        "identical": share(steps.identical),
        "steps_table": _steps_table(report),
        "stages_table": _stages_table(report),
        "resets_table": _resets_table(report),
        "attempts": report.resets.attempts,
        "static_text": _static_text(report),
        "squeeze": SQUEEZE,
        "workers_table": _workers_table(report),
        "peer_text": _peer_text(report),
        "width": WIDTH,
        "grasps": f"{report.plan.grasps:,}",
        "accuracy_table": _accuracy_table(report),
        "zero_text": _zero_text(report),
        "memory_text": _memory_text(report),
    }


def summary(report: SpeedReport) -> str:
    """The page in a few lines."""
    steps, memory = report.steps, report.memory
    best = max(report.workers, key=lambda each: each.steps_per_second)
    worst = max(each.estimate.p99 for each in report.accuracy)
    lines = [
        f"{rate(steps.env)} control steps per second on a core, {steps.ratio:.2f} of what the "
        "bare simulator does under the same commands.",
        f"{rate(report.static.episodes_per_second)} one-step episodes per second on a core in "
        "static mode, resets included.",
        f"A reset takes {report.resets.median:.1f} ms, of which {report.resets.reload:.1f} ms are "
        "the simulator's own loading.",
        f"{rate(best.steps_per_second)} steps per second with {best.workers} "
        f"process{'es' if best.workers > 1 else ''} ({best.kind}), resets included.",
        f"q_lrw is at most {percentage(worst)} too large for 99% of held-out grasps.",
        f"{memory.resets:,} resets over {memory.objects:,} objects add "
        f"{memory.growth_mib:.1f} MiB, {memory.files[1] - memory.files[0]} open files and "
        f"{memory.clients[1] - memory.clients[0]} PyBullet clients.",
    ]
    return "\n".join(f"- {line}" for line in lines)


def _steps_table(report: SpeedReport) -> str:
    steps = report.steps
    rows = [
        ["environment", rate(steps.env), _milli(steps.env), "1"],
        ["bare simulator", rate(steps.bare), _milli(steps.bare), f"{steps.ratio:.3f}"],
        [
            "its `stepSimulation` alone",
            rate(steps.physics),
            _milli(steps.physics),
            f"{steps.physics_ratio:.3f}",
        ],
    ]
    return table(["", "steps/s", "ms per step", "environment over it"], rows)


def _stages_table(report: SpeedReport) -> str:
    total = sum(report.stages.values())
    rows = [[name, f"{us:,.0f}", share(us / total)] for name, us in report.stages.items()]
    return table(["part", "µs", "share"], [*rows, ["together", f"{total:,.0f}", "100%"]])


def _resets_table(report: SpeedReport) -> str:
    resets = report.resets
    rows = [
        ["resets per second", rate(resets.per_second)],
        ["a reset, median", f"{resets.median:.2f} ms"],
        ["a reset, 95th percentile", f"{resets.p95:.2f} ms"],
        ["of it, loading hand and object into PyBullet, median", f"{resets.reload:.2f} ms"],
        [
            f"first use of {resets.attempts} attempts that the cache lacks, median",
            f"{resets.chunk:,.0f} ms",
        ],
    ]
    return table(["", "figure"], rows)


def _static_text(report: SpeedReport) -> str:
    static = report.static
    return (
        f"One-step episodes of `GraspForceStatic-v0` under recorded actions of `{SOLVER}`, a step "
        f"and a reset each: {rate(static.episodes_per_second)} per second on a core, "
        f"{static.microseconds:,.0f} µs an episode."
    )


def _workers_table(report: SpeedReport) -> str:
    alone = {each.kind: each for each in report.workers if each.workers == 1}
    rows = []
    for each in report.workers:
        base = alone.get(each.kind)
        times = f"{each.steps_per_second / base.steps_per_second:.2f}x" if base else "none"
        still = f"{each.episodes_per_second / base.episodes_per_second:.2f}x" if base else "none"
        rows.append(
            [
                str(each.workers),
                each.kind,
                rate(each.steps_per_second),
                times,
                rate(each.episodes_per_second),
                still,
            ]
        )
    heads = ["processes", "kind", "steps/s", "of one", "static episodes/s", "of one"]
    return table(heads, rows, "llr")


def _peer_text(report: SpeedReport) -> str:
    peer, steps = report.peer, report.steps
    if peer is None:
        return _MAKE_PEER
    rows = [
        [
            "`GraspForce-v0`",
            rate(steps.env),
            f"{steps.substeps} of {1e3 * TIME_STEP:.2f} ms",
            rate(steps.substeps * steps.env),
            f"{steps.physics_ratio:.2f}",
            f"{report.resets.median:.1f}",
        ],
        [
            f"`{PEER}`",
            rate(peer.steps_per_second),
            f"{peer.substeps} of {1e3 * peer.time_step:.2f} ms",
            rate(peer.substeps * peer.steps_per_second),
            f"{peer.steps_per_second / peer.physics_steps_per_second:.2f}",
            f"{peer.reset_ms:.1f}",
        ],
    ]
    heads = [
        "environment",
        "steps/s",
        "simulation steps",
        "simulation steps/s",
        "over `stepSimulation` alone",
        "reset, ms",
    ]
    return (
        f"panda-gym {peer.version} (numpy {peer.numpy}) in an interpreter of its own, in turns "
        "with the rest, under random actions; resets left out, one core. Its robot moves a box on "
        "a table, with few contacts and the default of 50 solver iterations: what compares is how "
        "much of the simulator's speed each environment leaves.\n\n"
        f"{table(heads, rows)}\n\nTo have this "
        "row: `python3.11 -m venv ~/panda`, `~/panda/bin/pip install panda-gym`, and "
        "`--peer-python ~/panda/bin/python`."
    )


def _accuracy_table(report: SpeedReport) -> str:
    rows = []
    for each in report.accuracy:
        for name, found in (
            ("estimate, above", each.estimate),
            ("pyramids of 4 edges, below", each.four),
            ("pyramids of 8 edges, below", each.eight),
        ):
            rows.append([each.forces, name, *_quantiles(found), f"{found.microseconds:,.0f}"])
        rows.append([each.forces, "refined hull", *[""] * 4, f"{each.refined_microseconds:,.0f}"])
    heads = ["forces", "", "median", "90%", "99%", "largest", "µs"]
    return table(heads, rows, "llr")


def _quantiles(found: Deviation) -> list[str]:
    return [percentage(q) for q in (found.median, found.p90, found.p99, found.largest)]


def _zero_text(report: SpeedReport) -> str:
    parts = []
    for each in report.accuracy:
        decided = each.grasps - each.undecided
        agreed = 1.0 - each.disagreeing / max(1, decided)
        parts.append(
            f"With {each.forces} q_lrw is 0 for {share(each.zero)} of the grasps; whether it is 0, "
            f"estimate and hull agree on {share(agreed)} ({each.undecided} grasps left out, whose "
            "refinement did not end)."
        )
    return " ".join(parts)


def _memory_text(report: SpeedReport) -> str:
    memory = report.memory
    return (
        f"{memory.resets:,} resets with a step each, over {memory.objects:,} objects that were all "
        f"loaded once before: {memory.resident_mib:,.0f} MiB resident before, "
        f"{memory.half_mib:+.1f} MiB after half of the resets, {memory.growth_mib:+.1f} MiB after "
        f"all, {memory.kib_per_reset:.2f} KiB per reset over the later half. Open files: "
        f"{memory.files[0]} before, {memory.files[1]} after. PyBullet clients: "
        f"{memory.clients[0]} before, {memory.clients[1]} after."
    )


@rc_context(STYLE)
def rates_figure(report: SpeedReport) -> Figure:
    """Steps and one-step episodes per second against the number of processes."""
    figure = new_figure(7.6, 3.4)
    panels = (("steps_per_second", "steps/s"), ("episodes_per_second", "static episodes/s"))
    for column, (name, label) in enumerate(panels):
        axes = figure.add_subplot(1, 2, column + 1)
        for kind, colour, marker in zip((PLAIN, VECTOR), CYCLE, "os", strict=False):
            mine = [each for each in report.workers if each.kind == kind]
            counts = [each.workers for each in mine]
            rates = [getattr(each, name) for each in mine]
            axes.plot(counts, rates, color=colour, marker=marker, ms=5, lw=1.6, label=kind)
            axes.set_xticks(counts)
        axes.set_ylim(bottom=0)
        axes.set(xlabel="processes", ylabel=label)
        if column == 0:
            axes.legend()
    return figure


def _milli(per_second: float) -> str:
    """ms for each, to three digits."""
    return f"{1e3 / per_second:.3g}"
