"""The page docs/holding.md: a text with gaps, the numbers that fill them, one picture."""

from pathlib import Path

import numpy as np

from gfo_env.hand import BARRETT_BH8_280
from training.reports import pages
from training.reports.intervals import Interval
from training.reports.numbers import listed, ratio, share
from training.reports.results import Run
from training.reports.tables import table

from .analysis import FITS, GOAL, Analysis, Skill, analyse
from .figure import KIND_LABELS, survival_figure
from .fit import FOLDS
from .measures import JOINTS, MEASURES, WRENCHES
from .methods import LABELS, LEVELS, PASSIVE, QUALITY, ROUNDS, SQUEEZE, TOLERANCE, UNIFORM
from .records import AGAIN, STIFF
from .study import Study


def write_page(run: Run[Study], path: Path) -> str:
    """Write the page, and its picture beside it under the same name; its summary.

    Args:
        run: what it is about.
        path: of the Markdown file.
    """
    analysis = analyse(run.results.records)
    fields = _fields(run.results, analysis) | {"command": run.command}
    pages.write_page(path, __package__, fields, {"": survival_figure(analysis)})
    return str(fields["summary"])


def _fields(study: Study, analysis: Analysis) -> dict[str, object]:
    protocol, records = study.protocol, study.records
    _, first = np.unique(records.attempt, return_index=True)
    return {
        "summary": summary(study, analysis),
        "acquired": study.acquired,
        "object_set": study.object_set,
        "split": study.split,
        "seed": study.seed,
        "grasps": len(first),
        "objects": len(np.unique(records.object_id)),
        "friction_factor": f"{study.friction_factor:g}",
        "levels": listed([f"{level:g}" for level in LEVELS]),
        "level_count": len(LEVELS),
        "tolerance": TOLERANCE,
        "rounds": ROUNDS,
        "phases": protocol.phases,
        "disturbances": protocol.phases - 1,
        "phase_time": protocol.phase_time,
        "force": _sum(protocol.push, protocol.weight_push, "times the weight"),
        "torque": f"{protocol.weight_torque:g} times weight times radius",
        "millimetres": 1e3 * protocol.max_displacement,
        "degrees": np.rad2deg(protocol.max_rotation),
        "joint_friction": study.joint_friction,
        "joints": len(BARRETT_BH8_280.max_torque),
        "contacts_mean": records.measures["contacts"][first].mean(),
        "discordant": analysis.discordant,
        "rates_table": _rates_table(analysis),
        "skills_table": _skills_table(analysis.skills),
        "fits_table": _fits_table(analysis.fits),
        "duels_table": _duels_table(analysis),
        "pairs_text": _pairs_text(analysis),
        "verdict": _verdict(analysis),
        "stiff_friction": STIFF,
        "stiff_text": _stiff_text(study, analysis),
        "shifts_table": _shifts_table(analysis),
        "folds": FOLDS,
        "repeat_text": _repeat_text(analysis),
    }


def summary(study: Study, analysis: Analysis) -> str:
    """The page in a few lines."""
    records = study.records
    skills = {skill.name: skill for skill in (*analysis.skills, *analysis.fits)}
    best = analysis.skills[0]
    quality, weighed = skills["quality"], skills["quality_weight"]
    duel = next(duel for duel in analysis.duels if (duel.first, duel.second) == (QUALITY, UNIFORM))
    lines = [
        f"{len(records):,} shakes of {len(np.unique(records.attempt))} grasps of "
        f"{len(np.unique(records.object_id))} objects, forces for the weight alone, pushes and "
        f"torques unannounced: {share(float(records.held.mean()))} survived.",
        f"The best single measure is the {MEASURES[best.name].label}: ROC area {best.pooled}; "
        f"{best.balanced} where equal squeezes, which do not carry the weight, are left out.",
        f"q_lrw has {quality.pooled}, over the weight {weighed.pooled}; effort over weight has "
        f"{skills['effort_weight'].pooled}.",
        f"At equal effort on the same grasp, of two forces of which one holds, that one has more "
        f"q_lrw in {quality.pairs} of the cases, more passive resistance in "
        f"{skills['passive_least'].pairs}, a smaller mean acceleration in "
        f"{skills['acceleration_mean'].pairs}.",
        f"Forces with {duel.quality_ratio:.2f} times the q_lrw of uniform preload (median) and its "
        f"effort held {_difference(duel.difference)}.",
        f"Combinations, on objects that they were not fitted to: {skills['all'].pooled} with all "
        f"measures, {skills['no_joints'].pooled} without those that know the joints.",
        _goal_text(analysis),
        f"With {1.0 - AGAIN:.0%} less friction the outcome is the same in {analysis.agreement}.",
    ]
    return "\n".join(f"- {line}" for line in lines)


def _goal_text(analysis: Analysis) -> str:
    """Which scores reach the area that was asked for."""
    labels = {name: measure.label for name, measure in MEASURES.items()}
    labels |= {name: f"the fit of {label}" for name, label in FITS.items()}
    scores = (*analysis.skills, *analysis.fits)
    names = [labels[score.name] for score in scores if score.pooled.value >= GOAL]
    return f"An area of {GOAL:.2f} over all shakes is reached by: {listed(names) or 'none'}."


def _rates_table(analysis: Analysis) -> str:
    rows = [
        [
            LABELS[rate.method],
            f"{rate.level:g}",
            f"{rate.effort:.1f}",
            str(rate.held),
            f"{rate.quality:.2f}",
            f"{rate.resistance:.2f}",
        ]
        for rate in analysis.rates
    ]
    heads = ["forces", "level, N", "effort, N", "held", "q_lrw, N", "passive resistance, least"]
    return table(heads, rows)


def _skills_table(skills: list[Skill]) -> str:
    rows = [
        [MEASURES[s.name].label, KIND_LABELS[MEASURES[s.name].kind], *_cells(s)] for s in skills
    ]
    return table(["measure", "knows", *_HEADS], rows, "llr")


def _fits_table(fits: list[Skill]) -> str:
    return table(["from", *_HEADS], [[FITS[fit.name], *_cells(fit)] for fit in fits])


_HEADS = ["all", "balanced", "equal effort", "pairs"]


def _cells(skill: Skill) -> list[str]:
    return [str(f) for f in (skill.pooled, skill.balanced, skill.level, skill.pairs)]


def _duels_table(analysis: Analysis) -> str:
    rows = [
        [
            LABELS[duel.first],
            LABELS[duel.second],
            str(duel.pairs),
            ratio(duel.quality_ratio),
            ratio(duel.resistance_ratio),
            f"{duel.difference:+.3f}",
        ]
        for duel in analysis.duels
    ]
    heads = [
        "forces",
        "against",
        "pairs",
        "q_lrw",
        "passive resistance",
        "held more often",
    ]
    return table(heads, rows, "llr")


def _pairs_text(analysis: Analysis) -> str:
    """What wins where effort and grasp are the same."""
    lines = []
    for name in ("quality", "sum_quality", "task_quality", "passive_least", "acceleration_mean"):
        skill = next(each for each in analysis.skills if each.name == name)
        lines.append(f"- {MEASURES[name].label}: {skill.pairs}, {_told(skill.pairs)}.")
    return (
        "Pooled areas reward whatever rises with effort, and whatever tells good grasps from bad "
        "ones. Two methods on the same grasp with the same effort differ in neither. Does the one "
        "with more of a measure hold?\n\n" + "\n".join(lines)
    )


def _told(pairs: Interval) -> str:
    if not np.isfinite(pairs.value):
        return "nothing to tell"
    if pairs.low > 0.5:
        return "more often than not"
    if pairs.high < 0.5:
        return "less often than not"
    return "not distinguishable from a coin"


def _verdict(analysis: Analysis) -> str:
    """What the figures say of the explanation."""

    def best(kind: str, column: str) -> Skill:
        mine = [s for s in analysis.skills if MEASURES[s.name].kind == kind]
        return max(mine, key=lambda s: np.nan_to_num(getattr(s, column).value))

    parts = []
    for column, what in (("balanced", "over balanced forces"), ("pairs", "in pairs")):
        one, other = best(WRENCHES, column), best(JOINTS, column)
        parts.append(
            f"{what}, the best of those that know only the wrenches "
            f"({MEASURES[one.name].label}) has {getattr(one, column)}, the best of those that know "
            f"the joints ({MEASURES[other.name].label}) {getattr(other, column)}"
        )
    duel = next(duel for duel in analysis.duels if (duel.first, duel.second) == (PASSIVE, QUALITY))
    return (
        f"The figures: {'; '.join(parts)}. Forces with the most passive resistance, "
        f"{duel.quality_ratio:.2f} times the q_lrw of those with the most, held "
        f"{_difference(duel.difference)}."
    )


def _stiff_text(study: Study, analysis: Analysis) -> str:
    """Whether stiffer joints do what the explanation says."""
    told = {shift.name: shift.difference for shift in analysis.shifts}
    more, less = told["quality_weight"].low > 0.0, told["passive_least"].high < 0.0
    if more and less:
        verdict = "Both happen."
    elif less:
        verdict = (
            "The second happens, the first does not: passive resistance tells less of joints that "
            "give way less, but q_lrw gains nothing by it."
        )
    elif more:
        verdict = "The first happens, the second does not."
    else:
        verdict = "Neither happens, beyond what chance explains: the reason is another."
    balanced = study.records.held[study.records.method != SQUEEZE].mean()
    return (
        f"With it {share(analysis.stiff.value)} of the balanced forces hold instead of "
        f"{share(float(balanced))}. {verdict}"
    )


def _shifts_table(analysis: Analysis) -> str:
    rows = [
        [MEASURES[s.name].label, str(s.before), str(s.after), f"{s.difference:+.3f}"]
        for s in analysis.shifts
    ]
    return table(["measure", "joints as they are", "stiffer joints", "difference"], rows)


def _repeat_text(analysis: Analysis) -> str:
    return (
        f"Every shake was done twice, the second time with {AGAIN:g} of the friction. The outcome "
        f"was the same in {analysis.agreement}; taken as a score, the second outcome has a ROC "
        f"area of {analysis.repeat} against the first. No measure should be expected to do better; "
        "what is missing up to there is not noise of the simulator."
    )


def _difference(difference: Interval) -> str:
    """A difference of shares in words."""
    if not np.isfinite(difference.value):
        return "none"
    more = "more" if difference.value >= 0.0 else "less"
    low, high = 100 * difference.low, 100 * difference.high
    points = f"{100 * abs(difference.value):.1f} percentage points {more}"
    return f"{points} of the grasps [{low:+.1f}, {high:+.1f}]"


def _sum(newtons: float, multiple: float, unit: str) -> str:
    parts = [f"{newtons:g} N"] if newtons else []
    parts += [f"{multiple:g} {unit}"] if multiple else []
    return " and ".join(parts)
