"""The benchmark: adapters, load factors, polygons, means, and the report."""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.progress import Progress

from scripts.benchmark import BenchmarkSettings, main
from solvers import GraspForceProblem, judge, make_solver, solve
from solvers.problem import canonical
from tests.support.grasp_tables import random_table
from tests.support.problems import random_batch
from tests.support.seeds import seeded
from training.measuring import machine, timing
from training.reports.numbers import NONE, listed, percentage, share, small, times
from training.reports.results import Run, load_run
from training.studies.benchmark import (
    accuracy,
    entrants,
    gpu,
    measure,
    network_accuracy,
    polygons,
    run,
)
from training.studies.benchmark.batches import SIZES, batch_times
from training.studies.benchmark.conic import BenchmarkError, conic_batches, scatter
from training.studies.benchmark.entrants import OwnEntrant, PeerEntrant, all_peers, peer_entrants
from training.studies.benchmark.figures import gap_figure
from training.studies.benchmark.load_factor import ACCURACY, load_factors
from training.studies.benchmark.peers import Peer
from training.studies.benchmark.problem_sets import (
    MIX,
    ProblemSet,
    at_factor,
    draw,
    edge_problems,
    judged_set,
    scaled_sets,
    with_contacts,
)
from training.studies.benchmark.report import write_page
from training.studies.benchmark.run import Benchmark, BenchmarkPlan

# cvxpylayers copies tensors in a way that numpy 2 warns about
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

PEERS = [pytest.param(kind, id=kind.title) for kind in all_peers()]


@pytest.fixture(scope="module")
def mixed() -> ProblemSet:
    """Problems with 3 to 8 contacts, some of them infeasible, some limits missing."""
    rng = seeded(0)
    batch = random_batch(rng, 24, friction=0.5)
    weak = np.where(np.arange(24)[:, None] % 3 == 0, 0.02, 1.0)
    without = np.where(np.arange(24)[:, None] % 4 == 0, np.inf, 1.0)
    problems = batch.replace(
        torque_min=weak * without * batch.torque_min, torque_max=weak * without * batch.torque_max
    )
    found = judged_set("mixed", problems)
    assert found.known.all()
    assert 4 <= found.feasible.sum() <= 20
    return found


@pytest.fixture(scope="module")
def edge() -> GraspForceProblem:
    """Problems that are loaded as much as they can bear."""
    problems, tried = edge_problems(random_table(seeded(1), 40), 8, seeded(2))
    assert tried == 16
    assert len(problems) >= 4
    return problems


def made(kind: type[Peer]) -> Peer:
    pytest.importorskip(kind.package)
    return kind()


@pytest.mark.parametrize("kind", PEERS)
def test_peer_agrees_with_the_truth(kind: type[Peer], mixed: ProblemSet) -> None:
    peer = made(kind)
    keep = mixed.feasible if peer.feasible_only else np.full(len(mixed), True)
    if peer.title == "QOCO":  # has no test for infeasibility
        keep = mixed.feasible
    problems = mixed.problems[np.flatnonzero(keep)]
    prepared = peer.prepare(problems)
    candidate = peer.answer(problems, prepared, peer.run(prepared))
    verdict = judge(problems, candidate.forces, candidate.multipliers)
    optimum = mixed.optimum[keep]
    solved = np.isfinite(optimum)
    bound = verdict.dual_bound[solved]
    np.testing.assert_allclose(bound, optimum[solved], rtol=1e-5)
    # the optimum is a bound itself, 1e-9 below the least objective at the most
    assert np.all(bound <= optimum[solved] * (1 + 1e-8))
    value = 0.5 * np.sum(candidate.forces[solved] ** 2, axis=-1)
    np.testing.assert_allclose(value, optimum[solved], rtol=1e-5)
    there = problems[np.flatnonzero(solved)]
    balance, violation = accuracy.relative_residuals(there, candidate.forces[solved])
    assert balance.max() < 1e-6
    assert violation.max() < 1e-6
    # Clarabel with updated data leaves one in 269 of the infeasible problems unproven
    assert np.sum(verdict.farkas_value[~solved] <= 1e-9) <= 1
    # padding contacts carry nothing
    padding = ~np.repeat(problems.contact_mask, 3, axis=-1)
    assert np.all(candidate.forces[padding] == 0.0)


@pytest.mark.parametrize("kind", PEERS)
def test_peer_gives_the_same_answer_again(kind: type[Peer], mixed: ProblemSet) -> None:
    peer = made(kind)
    problems = mixed.problems[np.flatnonzero(mixed.feasible)]
    first, second = (
        peer.answer(problems, prepared, peer.run(prepared))
        for prepared in (
            peer.prepare(problems),
            peer.prepare(problems[::-1]),
        )
    )
    np.testing.assert_allclose(first.forces, second.forces[::-1], rtol=1e-3, atol=1e-3)


def test_conic_form_holds_exactly_where_the_problem_does(mixed: ProblemSet) -> None:
    problems = mixed.problems
    exact = solve(problems, "clarabel")
    parts = conic_batches(problems)
    assert sum(len(part) for part in parts) == len(problems)
    for part in parts:
        assert np.all((part.matrix != 0.0) <= part.pattern())
        forces = np.asarray(exact.forces)[part.index].reshape(len(part), -1, 3)
        x = np.take_along_axis(forces, part.contacts[..., None], axis=1).reshape(len(part), -1)
        x = x / part.scale[:, None]
        slack = part.bound - np.einsum("bij,bj->bi", part.matrix, x)
        fine = mixed.feasible[part.index]
        assert np.abs(slack[fine, :6]).max(initial=0.0) < 1e-7
        assert slack[fine, 6 : -part.n_variables].min(initial=0.0) > -1e-7
        cones = slack[fine, -part.n_variables :].reshape(-1, 3)
        assert np.all(cones[:, 0] - np.linalg.norm(cones[:, 1:], axis=1) > -1e-7)


def test_scatter_puts_every_answer_in_its_place(mixed: ProblemSet) -> None:
    parts = conic_batches(mixed.problems)
    answers = [
        (
            np.repeat(part.index[:, None] / part.scale[:, None], part.n_variables, axis=1),
            0 * part.bound,
        )
        for part in parts
    ]
    forces, multipliers = scatter(mixed.problems, parts, answers)
    expected = np.arange(len(mixed))[:, None] * np.repeat(mixed.problems.contact_mask, 3, axis=-1)
    np.testing.assert_allclose(forces, expected)
    assert np.all(multipliers.equilibrium == 0.0)


def test_conic_form_refuses_what_it_cannot_say(mixed: ProblemSet) -> None:
    with pytest.raises(BenchmarkError, match="sum_normal"):
        conic_batches(mixed.problems.replace(objective="sum_normal"))
    slippery = mixed.problems.replace(friction=0.0 * mixed.problems.friction)
    with pytest.raises(BenchmarkError, match="friction"):
        conic_batches(slippery)


@pytest.mark.parametrize(
    ("factor", "status"),
    [
        (0.5, "feasible"),
        (0.99, "feasible"),
        (0.9999, "feasible"),
        (1.0001, "infeasible"),
        (2.0, "infeasible"),
    ],
)
def test_largest_load_is_really_the_edge(
    edge: GraspForceProblem, factor: float, status: str
) -> None:
    found = at_factor(edge, factor)
    assert np.all(found.feasible == (status == "feasible"))
    clarabel = OwnEntrant("clarabel", "Clarabel", "", make_solver("clarabel"))
    answer = measure.measure([clarabel], found, 8)["clarabel"]
    # accurate forces below the edge, proofs through `solve` above it; so close to it Clarabel may
    # end without them: of 14 sets of eight problems five had one of those, and one had two. Of 19
    # sets one had one at 0.99, and none elsewhere
    unsettled = ~answer.settled
    distance = abs(factor - 1.0)
    assert np.count_nonzero(unsettled) <= (2 if distance < 1e-3 else 1 if distance < 0.1 else 0)
    found_so = (answer.status == "infeasible") == (status == "infeasible")
    assert np.all(found_so | unsettled)


def test_largest_load_does_not_depend_on_the_load_it_starts_from(edge: GraspForceProblem) -> None:
    again = load_factors(edge)
    np.testing.assert_allclose(again.largest, 1.0, rtol=1e-8)
    np.testing.assert_allclose(again.bound, again.largest, rtol=ACCURACY)
    doubled = load_factors(edge.replace(external_wrench=2.0 * edge.external_wrench))
    np.testing.assert_allclose(doubled.largest, 0.5, rtol=1e-8)
    np.testing.assert_allclose(2.0 * doubled.least, again.least, rtol=1e-5, atol=1e-6)


def test_load_without_a_largest_is_dropped() -> None:
    rng = seeded(4)
    endless = random_batch(rng, 3, normal_max=np.inf, torque_min=-np.inf, torque_max=np.inf)
    factors = load_factors(endless)
    for values in (factors.least, factors.largest, factors.bound):
        assert np.all(np.isnan(values))


def test_polygons_enclose_the_optimum(mixed: ProblemSet) -> None:
    rows_ = np.flatnonzero(np.isfinite(mixed.optimum))
    problems, optimum = mixed.problems[rows_], mixed.optimum[rows_]
    last_inner, last_outer = np.full(len(rows_), np.inf), np.zeros(len(rows_))
    for sides in polygons.SIDES:
        inner = polygons.solve_linear(problems, polygons.INNER, sides)
        outer = polygons.solve_linear(problems, polygons.OUTER, sides)
        assert np.isfinite(outer.objective).all()
        objective = np.where(np.isfinite(inner.objective), inner.objective, np.inf)
        assert np.all(objective >= optimum * (1 - 1e-8))
        assert np.all(outer.objective <= optimum * (1 + 1e-8))
        # polygons of twice as many sides, one side in common, lie between
        assert np.all(outer.objective >= last_outer * (1 - 1e-8))
        last_inner, last_outer = objective, outer.objective
    # more than a few per cent are lost only where the load is close to the largest
    known = np.isfinite(last_inner)
    assert np.median(last_inner[known] / optimum[known]) < 1.02


def test_inner_forces_never_slip_and_outer_ones_only_to_the_corner(
    mixed: ProblemSet,
) -> None:
    for figures in polygons.audit(mixed):
        corner = 1.0 / np.cos(np.pi / figures.sides) - 1.0
        most = 0.0 if figures.kind == polygons.INNER else corner
        assert np.all(figures.slip <= most + 1e-6)
        assert figures.undecided == 0.0
        if figures.kind == polygons.INNER:
            assert figures.falsely_feasible == 0.0
        else:
            assert figures.falsely_infeasible == 0.0


def test_polygons_err_on_their_own_side_of_the_edge(edge: GraspForceProblem) -> None:
    below, above = polygons.audit(at_factor(edge, 0.999)), polygons.audit(at_factor(edge, 1.001))
    for under, over in zip(below, above, strict=True):
        wrong = under.falsely_infeasible if under.kind == polygons.INNER else over.falsely_feasible
        assert wrong > 0.0


@pytest.mark.parametrize("shift", [1e-9, 1e-3, 10.0])
def test_shifted_geometric_mean(shift: float) -> None:
    values = seeded(0).lognormal(size=50)
    mean = timing.shifted_geometric_mean(values, shift)
    assert values.min() < mean < values.mean()
    np.testing.assert_allclose(timing.shifted_geometric_mean(np.full(7, 3.0), shift), 3.0)
    swapped = timing.shifted_geometric_mean(values[::-1], shift)
    np.testing.assert_allclose(mean, swapped)


def test_shifted_geometric_mean_lies_between_the_geometric_and_the_arithmetic_mean() -> None:
    values = np.array([1.0, 4.0])
    np.testing.assert_allclose(timing.shifted_geometric_mean(values, 0.0), 2.0)
    assert abs(timing.shifted_geometric_mean(values, 1e9) - 2.5) < 1e-5


def test_pinning_ends_where_it_began() -> None:
    before = timing.usable_cores()
    with timing.pinned(1):
        assert timing.usable_cores() == before[:1]
        with timing.pinned(1):
            pass
        assert timing.usable_cores() == before[:1]
    assert timing.usable_cores() == before


def test_measuring_counts_wrong_statuses_and_failures(mixed: ProblemSet) -> None:
    clarabel = OwnEntrant("clarabel", "Clarabel", "", make_solver("clarabel"))
    squeeze = OwnEntrant("squeeze", "squeeze", "", make_solver("equal_squeeze"))
    found = measure.measure([clarabel, squeeze], mixed, 10)
    exact, crude = found["clarabel"], found["squeeze"]
    assert not exact.wrong.any()
    assert exact.share("optimal") == np.mean(mixed.feasible)
    assert exact.share("optimal", "infeasible") == 1.0
    assert len(exact.converted) == 3
    np.testing.assert_array_equal(np.sort(exact.rows), np.arange(len(mixed)))
    assert exact.settled.all()
    np.testing.assert_array_equal(exact.penalised, exact.converted)
    np.testing.assert_array_equal(np.isnan(exact.violation), ~mixed.feasible)
    assert np.all(exact.alone <= exact.converted)
    assert crude.share("failed") > 0.0
    assert crude.penalised.max() > measure.FAILURE_SECONDS / 24
    lied = replace(mixed, feasible=~mixed.feasible)
    assert measure.measure([clarabel], lied, 24)["clarabel"].wrong.all()


def test_entrant_that_cannot_see_infeasible_problems_sees_none(mixed: ProblemSet) -> None:
    pytest.importorskip("cvxpylayers")
    (entrant,) = [each for each in peer_entrants(1) if each.feasible_only]
    found = measure.measure([entrant], mixed, 12)[entrant.key]
    np.testing.assert_array_equal(found.rows, np.flatnonzero(mixed.feasible))
    assert found.settled.all()
    assert found.share("optimal", "feasible") == 1.0


def test_batches_of_one_by_one_peers_are_subsets(mixed: ProblemSet) -> None:
    (entrant,) = [each for each in peer_entrants(1) if each.key == "clarabel"]
    assert isinstance(entrant, PeerEntrant)
    rng = seeded(0)
    found = batch_times([entrant], mixed, random_table(rng, 30), SIZES[:3], rng)["clarabel"]
    assert found[64].subset is None
    assert found[4096].subset == 64
    assert len(found[1].judged) == len(mixed)
    for each in found.values():
        assert np.all(each.alone <= each.converted)
        assert np.all(each.converted <= each.judged)


def test_newton_steps_are_none_at_the_optimum(mixed: ProblemSet) -> None:
    rows_ = np.flatnonzero(np.isfinite(mixed.optimum))
    form = canonical(mixed.problems[rows_])
    cold = network_accuracy.steps_to_gradient(
        form.problem, network_accuracy.cold_start(form.problem)
    )
    assert np.median(cold) < network_accuracy.MOST_STEPS
    assert np.all(cold >= 1)


def test_torch_solvers_certify_on_a_device(mixed: ProblemSet) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("solvers.exact.dual_newton_torch")
    found = gpu.device_throughput(lambda size: mixed.problems[:size], (24,), device="cpu")
    exact, network = found
    assert exact.certified == 1.0
    assert 0.0 <= network.certified <= np.mean(mixed.feasible)
    for each in found:
        np.testing.assert_allclose(each.per_second, 24 * each.certified / each.seconds)


def test_draws_use_every_grasp_alike() -> None:
    table = random_table(seeded(0), 10)
    problems = draw(table, 25, seeded(1))
    assert len(problems) == 25
    used = Counter(map(bytes, np.ascontiguousarray(problems.grasp_map[:, :, :9])))
    assert sorted(set(used.values())) == [2, 3]
    part = with_contacts(table, "4-5")
    assert part is None or set(part.contact_mask.sum(axis=1)) <= {4, 5}
    assert with_contacts(table, MIX) is table


def test_scaled_sets_scale_one_thing_each(mixed: ProblemSet) -> None:
    for each in scaled_sets(mixed.problems[:4]):
        field, factor = each.name.split(" x")
        names = ["friction"] if field == "friction" else ["torque_min", "torque_max"]
        for name in ("friction", "torque_min", "torque_max", "external_wrench"):
            wanted = (float(factor) if name in names else 1.0) * getattr(mixed.problems[:4], name)
            np.testing.assert_allclose(getattr(each.problems, name), wanted)


@pytest.mark.parametrize(
    ("written", "text"),
    [
        (times(None), NONE),
        (times(4.8123), "4.81"),
        (times(48.123), "48.1"),
        (times(12345.6), "12,346"),
        (share(float("nan")), NONE),
        (share(1.0), "100%"),
        (share(0.99999), ">99.9%"),
        (share(1e-6), "<0.1%"),
        (small(0.0), "0"),
        (small(3e-20), "<1e-15"),
        (percentage(0.0397), "4%"),
        (listed(["a"]), "a"),
        (listed(["a", "b", "c"]), "a, b and c"),
    ],
)
def test_numbers_are_written(written: str, text: str) -> None:
    assert written == text


def test_gap_figure_counts_unanswered_problems() -> None:
    figure = gap_figure({"x": np.array([1e-9, np.inf])}, 1e-6)
    (line,) = [line for line in figure.axes[0].lines if line.get_label() == "x"]
    np.testing.assert_allclose(np.asarray(line.get_ydata()), [50.0])


def test_machine_is_described() -> None:
    facts = machine.machine()
    assert facts["processor"]
    assert all(facts.values())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"grasps": 0}, "grasps is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"workers": 0}, "workers is 0"),
    ],
)
def test_senseless_plans_are_refused(changes: dict[str, int], message: str) -> None:
    with pytest.raises(BenchmarkError, match=message):
        BenchmarkPlan(**changes)


@pytest.fixture
def grasps(tmp_path: Path) -> Path:
    path = tmp_path / "grasps.npz"
    random_table(seeded(3), 12).save(path)
    return path


def check_page(path: Path) -> None:
    """No cell is empty, every picture is there and small."""
    text = path.read_text()
    for line in text.splitlines():
        if line.startswith("|"):
            assert all(cell.strip() for cell in line.strip("|").split("|")), line
    for picture in re.findall(r"\((\w+\.png)\)", text):
        assert 1_000 < (path.parent / picture).stat().st_size < 100_000


@pytest.mark.slow
def test_command_measures_and_reports(grasps: Path, tmp_path: Path) -> None:
    page, kept = tmp_path / "benchmark.md", tmp_path / "benchmark.json"
    options = {"grasps": 4, "table": grasps, "train_table": grasps}
    main(BenchmarkSettings(page=page, json=kept, **options))
    check_page(page)
    found = load_run(kept, Benchmark).results
    assert found.network is not None
    assert len(found.batches["dual_newton"]) == len(found.plan.batch_sizes)
    on_mix = found.results[MIX]["clarabel"]
    assert not on_mix.wrong.any()
    assert on_mix.share("optimal", "infeasible") == 1.0


def test_one_grasp_and_clarabel_alone_are_enough(
    grasps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in all_peers():
        if kind.package != "clarabel":
            monkeypatch.setattr(kind, "installed", classmethod(lambda cls: False))
    for module in (run, entrants):
        monkeypatch.setattr(module, "available_solvers", lambda: ("clarabel",))
    result = run.run_benchmark(BenchmarkPlan(1, 0, grasps), Progress(disable=True))
    assert {"Moreau", "ECOS", "QOCO", "SCS", "cvxpylayers", "`conditioned`"} <= set(result.absent)
    assert {each.title for each in result.entrants} == {"Clarabel", "Clarabel (update)"}
    write_page(Run("a command", {}, result), tmp_path / "benchmark.md")
    check_page(tmp_path / "benchmark.md")
    assert "Not installed here" in (tmp_path / "benchmark.md").read_text()
