"""Static measures against survival: passive resistance, reaches, fits, the page and its command."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gfo_env.holding import SHAKE_PROTOCOLS
from scripts.predict_holding import PredictHoldingSettings, main
from solvers.passive_resistance import most_passive_resistance, passive_resistance
from solvers.quality.friction_discs import support_bounds
from tests.support.commands import assert_one_clear_line, run_command
from tests.support.pushes import LENGTH, palm_only, posed, sides
from tests.support.seeds import seeded
from training.reports.intervals import object_interval
from training.reports.results import Run, load_run, save_run
from training.studies.holding.margins import roc_area
from training.studies.holding.survival.analysis import analyse, discordant_pairs
from training.studies.holding.survival.areas import ObjectAreas
from training.studies.holding.survival.fit import Logistic, held_out_scores, object_folds
from training.studies.holding.survival.measures import (
    MEASURES,
    harmonic_mean,
    palm_contacts,
    structural_stiffness,
)
from training.studies.holding.survival.methods import (
    LABELS,
    LEAST_NORM,
    LEVELS,
    SQUEEZE,
    forces_of_methods,
    most_friction_to_spare,
)
from training.studies.holding.survival.page import write_page
from training.studies.holding.survival.records import COLUMNS, Records
from training.studies.holding.survival.study import Study
from training.studies.holding.survival.support import (
    discs_of,
    least_supports,
    resisted_multiples,
    sum_support,
)

JOINTS = {"joint_friction": 0.01}


@pytest.mark.parametrize("seed", range(3))
def test_methods_carry_the_weight_and_each_is_best_at_what_it_is_for(seed: int) -> None:
    problem, _ = posed(seed)
    found = {
        (method, level): forces
        for method, level, forces in forces_of_methods(problem, sides(), LENGTH, **JOINTS)
    }
    assert set(found) == {(LEAST_NORM, 0.0)} | {
        (method, level) for method in LABELS for level in LEVELS if method != LEAST_NORM
    }
    least = found[LEAST_NORM, 0.0][2::3].sum()
    for (method, level), forces in found.items():
        normal = forces[2::3]
        budget = least + problem.n_contacts * level
        assert normal.sum() <= budget * (1.0 + 1e-6)
        if method != SQUEEZE:
            balance = problem.grasp_map @ forces + problem.external_wrench
            assert np.abs(balance).max() < 1e-5
            spare = problem.friction * normal - np.hypot(forces[0::3], forces[1::3])
            assert spare.min() > -1e-6
            most = most_friction_to_spare(problem, float(budget))
            assert most is not None
            best = problem.friction * most[2::3] - np.hypot(most[0::3], most[1::3])
            assert best.min() >= spare.min() - 1e-5
            held = passive_resistance(problem, forces, sides(), LENGTH, **JOINTS).multiples.min()
            firm = most_passive_resistance(problem, float(budget), sides(), LENGTH, **JOINTS)
            assert firm is not None
            most_held = passive_resistance(problem, firm, sides(), LENGTH, **JOINTS).multiples.min()
            # ties are broken by a thousandth of a multiple
            assert most_held >= held - 2e-3


def test_nothing_comes_of_a_load_that_cannot_be_carried() -> None:
    problem = palm_only([0, 0, 2.0, 0, 0, 0])
    assert palm_contacts(problem).all()
    assert not list(forces_of_methods(problem, sides(), 0.03))
    assert most_friction_to_spare(problem, 10.0) is None


def test_reaches_are_least_and_adding_contacts_reaches_no_less() -> None:
    local = 0
    for seed in range(6):
        rng = seeded([9, seed])
        problem, _ = posed(seed, 4 + seed % 3)
        normal = rng.uniform(0.5, 5.0, problem.n_contacts)
        largest, added = least_supports(problem, normal, LENGTH)
        assert 0.0 < largest <= added
        discs = discs_of(problem, normal, LENGTH)
        ways = rng.normal(size=(20_000, 6))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        hull = support_bounds(discs, 8, lambda lower, upper: upper - lower <= 0.01 * upper)
        assert hull.lower * (1.0 - 1e-6) <= largest <= hull.upper * 1.2
        # a ball inside of the wrenches is resisted along every direction
        alone = resisted_multiples(discs, ways[:30], 1.0, together=False)
        assert alone.min() >= hull.lower * (1.0 - 1e-3)
        together = resisted_multiples(discs, ways[:30], 1.0, together=True)
        assert np.all(together >= alone * (1.0 - 1e-3))
        local += min(sum_support(discs, ways).min(), together.min()) < added * (1.0 - 1e-3)
    # descents end at local minima of the sum at times: of 96 ends two were not the least
    assert local <= 1


def test_reaches_are_proportional_to_forces() -> None:
    problem, forces = posed(2)
    once = least_supports(problem, forces[2::3], LENGTH)
    twice = least_supports(problem, 2.0 * forces[2::3], LENGTH)
    np.testing.assert_allclose(twice, 2.0 * np.array(once), rtol=1e-3)
    assert least_supports(problem, np.zeros(problem.n_contacts), LENGTH) == (0.0, 0.0)


def test_stiffness_of_locked_joints_is_that_of_the_contacts() -> None:
    problem, _ = posed(5)
    scaled = problem.grasp_map / np.repeat([1.0, LENGTH], 3)[:, None]
    smallest = np.linalg.svd(scaled, compute_uv=False)[-1]
    locked = problem.replace(hand_jacobian=np.zeros_like(problem.hand_jacobian))
    assert structural_stiffness(locked, LENGTH) == pytest.approx(smallest**2)
    assert structural_stiffness(problem, LENGTH) <= smallest**2
    # so many joints that every contact force is felt
    felt = problem.replace(
        hand_jacobian=np.eye(15),
        **{f"torque_{end}": np.full(15, s) for end, s in (("min", -1.0), ("max", 1.0))},
        external_torque=None,
    )
    assert structural_stiffness(felt, LENGTH) == 0.0


def test_harmonic_mean_is_ruled_by_the_weakest() -> None:
    assert harmonic_mean(np.array([2.0, 2.0])) == pytest.approx(2.0)
    assert harmonic_mean(np.array([1.0, 3.0])) == pytest.approx(1.5)
    assert harmonic_mean(np.array([0.0, 3.0])) == 0.0


def test_folds_never_share_objects() -> None:
    rng = seeded(0)
    owners = rng.choice([f"{k:03d}" for k in range(23)], 400)
    fold = object_folds(owners)
    assert set(fold) == set(range(5))
    for name in np.unique(owners):
        assert len(set(fold[owners == name])) == 1
    counts = [len(np.unique(owners[fold == k])) for k in range(5)]
    assert max(counts) - min(counts) <= 1


def test_regression_finds_what_there_is_and_nothing_else() -> None:
    rng = seeded(1)
    values = rng.normal(size=(2000, 3)) * [1.0, 10.0, 0.0]
    owners = rng.choice([f"{k:03d}" for k in range(50)], 2000)
    held = rng.random(2000) < 1.0 / (1.0 + np.exp(-2.0 * values[:, 0]))
    model = Logistic.fit(values, held)
    assert model.weights[0] > 10.0 * abs(model.weights[1])
    assert model.weights[2] == 0.0
    score = held_out_scores(values, held, owners)
    assert roc_area(score, held) > 0.8
    coin = rng.random(2000) < 0.5
    luck = roc_area(held_out_scores(values, coin, owners), coin)
    assert abs(luck - 0.5) < 0.06


def test_areas_of_resamples_are_those_of_resampled_rows() -> None:
    rng = seeded(2)
    owners = rng.choice([f"{k:03d}" for k in range(12)], 200)
    score = rng.integers(0, 6, 200).astype(float)
    held = rng.random(200) < 0.2 + 0.1 * score
    found = ObjectAreas(owners).area(score, held)
    rows = np.stack([score, held], axis=1)
    low, high = object_interval(rows, owners, lambda part: roc_area(part[:, 0], part[:, 1] > 0.5))
    assert found.value == pytest.approx(roc_area(score, held))
    assert (found.low, found.high) == pytest.approx((low, high))
    halves = [np.arange(200) < 100, np.arange(200) >= 100]
    mean = ObjectAreas(owners).mean_area(score, held, [*halves, np.zeros(200, dtype=bool)])
    assert mean.value == pytest.approx(np.mean([roc_area(score[h], held[h]) for h in halves]))
    assert ObjectAreas(owners).difference(score, held, held).high == 0.0


def made_up(grasps: int = 24, objects: int = 9, seed: int = 0) -> Study:
    """A study of made-up shakes, which more passive resistance survives."""
    rng = seeded(seed)
    rows: dict[str, list[Any]] = {name: [] for name in (*COLUMNS, *MEASURES)}
    for grasp in range(grasps):
        for method in LABELS:
            for level in (0.0,) if method == LEAST_NORM else LEVELS:
                values = {name: rng.uniform(0.1, 2.0) for name in MEASURES}
                held = values["passive_least"] + 0.3 * rng.normal() > 1.0
                rows["object_id"].append(f"{grasp % objects:03d}")
                rows["attempt"].append(grasp)
                rows["method"].append(method)
                rows["level"].append(level)
                rows["phases_held"].append(13 if held else 4)
                rows["held"].append(held)
                rows["held_again"].append(held)
                rows["held_stiff"].append(values["quality_weight"] > 1.0)
                for name, value in values.items():
                    rows[name].append(value)
    columns: Any = {name: np.array(rows[name], kind) for name, kind in COLUMNS.items()}
    measures = {name: np.array(rows[name]) for name in MEASURES}
    return Study(
        object_set="made up",
        split="test",
        acquired=grasps + 3,
        seed=seed,
        friction_factor=0.8,
        joint_friction=0.01,
        protocol=SHAKE_PROTOCOLS["weight"],
        records=Records(**columns, measures=measures),
    )


def with_scores(records: Records, **scores: np.ndarray) -> Records:
    return replace(records, measures=records.measures | scores)


def test_perfect_and_opposite_scores_have_areas_one_and_zero() -> None:
    records = made_up().records
    perfect = records.held.astype(float)
    found = {
        skill.name: skill
        for skill in analyse(
            # mass counts the other way round: the lighter, the likelier to hold
            with_scores(records, effort=perfect, contacts=-perfect, mass=-perfect, radius=perfect)
        ).skills
    }
    for name, area in (("effort", 1.0), ("contacts", 0.0), ("mass", 1.0), ("radius", 0.0)):
        skill = found[name]
        for figure in (skill.pooled, skill.balanced, skill.level, skill.pairs):
            assert (figure.value, figure.low, figure.high) == (area, area, area)
    best = found["passive_least"]
    assert best.pooled.low <= best.pooled.value <= best.pooled.high
    assert best.pooled.low > 0.7
    assert abs(found["quality"].pooled.value - 0.5) < 0.15


def test_pairs_are_of_one_grasp_and_level_and_leave_squeezes_out() -> None:
    records = made_up().records
    pairs = discordant_pairs(records)
    assert len(pairs) > 20
    assert records.held[pairs[:, 0]].all()
    assert not records.held[pairs[:, 1]].any()
    for name in ("attempt", "level"):
        column = getattr(records, name)
        np.testing.assert_array_equal(column[pairs[:, 0]], column[pairs[:, 1]])
    assert SQUEEZE not in records.method[pairs]


def test_analysis_sees_what_stiffer_joints_change() -> None:
    analysis = analyse(made_up().records)
    shifts = {shift.name: shift for shift in analysis.shifts}
    assert shifts["quality_weight"].after.value == 1.0
    assert shifts["quality_weight"].difference.low > 0.0
    assert shifts["passive_least"].difference.high < 0.0
    assert analysis.agreement.value == 1.0
    assert analysis.repeat.value == 1.0
    assert {fit.name for fit in analysis.fits} == {"all", "no_joints", "joints"}


def test_outcomes_that_are_all_alike_leave_gaps_and_no_errors(tmp_path: Path) -> None:
    study = made_up(grasps=4, objects=4)
    lost = replace(study.records, held=np.zeros(len(study.records), dtype=bool))
    write_page(Run("a command", {}, replace(study, records=lost)), tmp_path / "page.md")
    page = (tmp_path / "page.md").read_text()
    assert "none" in page
    assert not re.search(r"\bnan\b", page)


def test_page_is_drawn_identically_from_its_file(tmp_path: Path) -> None:
    run = Run("a command", {}, made_up())
    save_run(run, tmp_path / "study.json")
    write_page(run, tmp_path / "a" / "page.md")
    write_page(load_run(tmp_path / "study.json", Study), tmp_path / "b" / "page.md")
    for name in ("page.md", "page.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    page = (tmp_path / "a" / "page.md").read_text()
    assert "(page.png)" in page
    assert "{" not in page
    assert not re.search(r"\bnan\b", page)
    picture = tmp_path / "a" / "page.png"
    assert picture.stat().st_size < 200_000
    assert len(np.unique(np.asarray(Image.open(picture).convert("L")))) > 5


@pytest.mark.slow
def test_command_end_to_end(tmp_path: Path) -> None:
    first = PredictHoldingSettings(
        grasps=3, seed=1, workers=1, page=tmp_path / "a.md", json=tmp_path / "a.json"
    )
    main(first)
    records = load_run(tmp_path / "a.json", Study).results.records
    assert len(records) == len(records.measures["passive_least"]) > 0
    assert np.isfinite(list(records.measures.values())).all()
    assert np.all(records.measures["sum_quality"] >= records.measures["quality"])
    main(PredictHoldingSettings(from_json=tmp_path / "a.json", page=tmp_path / "b.md"))
    again = (tmp_path / "b.md").read_text().replace("(b.png)", "(a.png)")
    assert again == (tmp_path / "a.md").read_text()
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--grasps", "0"), "grasps is 0"),
        (("--seed", "-1"), "seed is -1"),
        (("--page", "tests"), "tests is a folder"),
        (("--from-json", "no_such.json"), "no_such.json"),
        (("--from-json", "README.md"), "README.md holds no results of this study"),
    ],
)
def test_bad_input_is_one_clear_line(arguments: tuple[str, str], message: str) -> None:
    assert_one_clear_line(run_command("predict_holding", *arguments), message)
