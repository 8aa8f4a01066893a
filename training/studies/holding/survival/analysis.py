"""How well each measure foretells survival: ROC areas, at equal effort, and fitted combinations."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from solvers.arrays import Array
from training.reports.intervals import Interval

from .areas import ObjectAreas
from .fit import held_out_scores
from .measures import JOINTS, MEASURES, WRENCHES
from .methods import LABELS, LEVELS, MARGIN, PASSIVE, QUALITY, SQUEEZE, UNIFORM
from .records import Records


@dataclass(frozen=True)
class Skill:
    """What a score tells of survival.

    Args:
        name: of the score.
        pooled: ROC area over all shakes.
        balanced: ROC area over methods whose forces carry the weight, that is, without squeezes.
        level: mean over levels of the ROC area among their shakes, squeezes left out.
        pairs: of two balanced methods of one grasp at one level of which one holds, the share in
            which that one has the higher score.
    """

    name: str
    pooled: Interval
    balanced: Interval
    level: Interval
    pairs: Interval


@dataclass(frozen=True)
class Rate:
    """How often a method holds at a level.

    Args:
        method: name.
        level: N.
        effort: N, median sum of normal forces.
        held: share.
        quality: N, median q_lrw.
        resistance: median of the least passive resistance.
    """

    method: str
    level: float
    effort: float
    held: Interval
    quality: float
    resistance: float


@dataclass(frozen=True)
class Duel:
    """Two methods at equal level on the same grasps.

    Args:
        first, second: names.
        quality_ratio: median of the q_lrw of the first over that of the second.
        resistance_ratio: likewise of the least passive resistance.
        difference: of the shares held, first less second.
        pairs: of grasp and level.
    """

    first: str
    second: str
    quality_ratio: float
    resistance_ratio: float
    difference: Interval
    pairs: int


@dataclass(frozen=True)
class Shift:
    """What stiffer joints do to what a measure tells; squeezes are left out.

    Args:
        name: of the measure.
        before: ROC area with joints as they are.
        after: with joints of more dry friction, of the same forces and the same measure.
        difference: after less before.
    """

    name: str
    before: Interval
    after: Interval
    difference: Interval


@dataclass(frozen=True)
class Analysis:
    """Everything that the page says in numbers.

    Args:
        skills: of single measures, best first.
        fits: of combinations, by what they know.
        rates: of methods by level.
        duels: between methods.
        shifts: with stiffer joints, of the measures of wrenches and of joints.
        stiff: share held with stiffer joints, squeezes left out.
        repeat: ROC area of the outcome of a second shake, with slightly less friction, as a
            predictor of the first.
        agreement: share of shakes with the same outcome both times.
        discordant: pairs that the share `pairs` of skills is over.
    """

    skills: list[Skill]
    fits: list[Skill]
    rates: list[Rate]
    duels: list[Duel]
    shifts: list[Shift]
    stiff: Interval
    repeat: Interval
    agreement: Interval
    discordant: int


GOAL = 0.8
"""ROC area that a score should reach."""

DUELS = (
    (SQUEEZE, UNIFORM),
    (MARGIN, UNIFORM),
    (QUALITY, UNIFORM),
    (PASSIVE, UNIFORM),
    (PASSIVE, QUALITY),
)
"""Which methods are compared at equal effort."""

FITS = {
    "all": "all measures",
    "no_joints": "all but those that know the joints",
    "joints": "those that know the joints",
}
"""Combinations that are fitted."""


def analyse(records: Records) -> Analysis:
    """Every figure of the page."""
    judge = _Scorer(records)
    names = list(MEASURES)
    skills = [judge.skill(name, records.score(name)) for name in names]
    skills.sort(key=lambda skill: -np.nan_to_num(skill.pooled.value))
    chosen = {
        "all": names,
        "no_joints": [name for name in names if MEASURES[name].kind != JOINTS],
        "joints": [name for name in names if MEASURES[name].kind == JOINTS],
    }
    fits = []
    for key, columns in chosen.items():
        values = np.stack([records.measures[name] for name in columns], axis=1)
        fits.append(judge.skill(key, held_out_scores(values, records.held, records.object_id)))
    shifted = [s.name for s in skills if MEASURES[s.name].kind in (WRENCHES, JOINTS)]
    fair = records[records.method != SQUEEZE]
    again = records.held_again
    return Analysis(
        skills=skills,
        fits=fits,
        rates=_rates(records),
        duels=[_duel(records, first, second) for first, second in DUELS],
        shifts=[judge.shift(name) for name in shifted],
        stiff=Interval.of(fair.held_stiff.astype(float), fair.object_id),
        repeat=ObjectAreas(records.object_id).area(again.astype(float), records.held),
        agreement=Interval.of((records.held == again).astype(float), records.object_id),
        discordant=len(judge.pairs),
    )


class _Scorer:
    """Judges scores of the same shakes."""

    def __init__(self, records: Records) -> None:
        self.pairs = discordant_pairs(records)
        self._records = records
        self._balanced = records.method != SQUEEZE
        self._fair = records[self._balanced]
        self._all = ObjectAreas(records.object_id)
        self._fair_areas = ObjectAreas(self._fair.object_id)
        self._levels = [self._fair.level == level for level in LEVELS]

    def skill(self, name: str, score: Array) -> Skill:
        """What a score (m,) of all shakes tells."""
        fair, held = score[self._balanced], self._fair.held
        first, second = score[self.pairs[:, 0]], score[self.pairs[:, 1]]
        won = 0.5 + 0.5 * np.sign(first - second)
        return Skill(
            name=name,
            pooled=self._all.area(score, self._records.held),
            balanced=self._fair_areas.area(fair, held),
            level=self._fair_areas.mean_area(fair, held, self._levels),
            pairs=Interval.of(won, self._records.object_id[self.pairs[:, 0]]),
        )

    def shift(self, name: str) -> Shift:
        """What stiffer joints do to what a measure tells."""
        score, held, stiff = self._fair.score(name), self._fair.held, self._fair.held_stiff
        areas = self._fair_areas
        return Shift(
            name,
            areas.area(score, held),
            areas.area(score, stiff),
            areas.difference(score, held, stiff),
        )


def discordant_pairs(records: Records) -> NDArray[np.int64]:
    """(p, 2) rows of one grasp at one level of which the first held and the second did not.

    Squeezes are left out: they do not carry the weight.
    """
    groups: dict[tuple[int, float], list[int]] = {}
    for row in np.flatnonzero(records.method != SQUEEZE):
        groups.setdefault((int(records.attempt[row]), float(records.level[row])), []).append(
            int(row)
        )
    found = []
    for rows in groups.values():
        for one, other in combinations(rows, 2):
            if records.held[one] != records.held[other]:
                found.append((one, other) if records.held[one] else (other, one))
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _rates(records: Records) -> list[Rate]:
    rates = []
    for method in LABELS:
        for level in (0.0, *LEVELS):
            mine = records[(records.method == method) & (records.level == level)]
            if not len(mine):
                continue
            rates.append(
                Rate(
                    method=method,
                    level=level,
                    effort=float(np.median(mine.measures["effort"])),
                    held=Interval.of(mine.held.astype(float), mine.object_id),
                    quality=float(np.median(mine.measures["quality"])),
                    resistance=float(np.median(mine.measures["passive_least"])),
                )
            )
    return rates


def _duel(records: Records, first: str, second: str) -> Duel:
    def rows_of(method: str) -> dict[tuple[int, float], int]:
        rows = np.flatnonzero(records.method == method)
        return {(int(records.attempt[k]), float(records.level[k])): int(k) for k in rows}

    mine, other = rows_of(first), rows_of(second)
    both = np.array([(mine[key], other[key]) for key in mine if key in other], dtype=np.int64)
    both = both.reshape(-1, 2)
    held = records.held.astype(float)
    return Duel(
        first=first,
        second=second,
        quality_ratio=_ratio(records.measures["quality"][both]),
        resistance_ratio=_ratio(records.measures["passive_least"][both]),
        difference=Interval.of(held[both[:, 0]] - held[both[:, 1]], records.object_id[both[:, 0]]),
        pairs=len(both),
    )


def _ratio(values: Array) -> float:
    """Median of the first column over the second, where that is positive."""
    positive = values[values[:, 1] > 0.0]
    return float(np.median(positive[:, 0] / positive[:, 1])) if len(positive) else float("nan")
