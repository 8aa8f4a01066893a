"""Who takes part: peers and the registry's solvers, each timed in the same three stages.

`alone` is the solver's own work: for a peer, construction and solve of programs that are already
converted; for a solver of this project, `propose`, which takes the problem's arrays as they are.
`converted` adds the conversion from G, J_h, mu and so on, and reading the answer. `judged` adds
what `solve` does for everybody: finishing and the judge's certificate.
"""

import dataclasses
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from solvers import GraspForceProblem, GraspForceSolution, Solver, available_solvers, make_solver
from solvers.solution import Candidate

from .peers import Peer

_WARMED = 64
"""Problems at most in a warm-up."""

_SLOW = 0.1
"""s, of a proposal that is not made a second time."""


@dataclass(frozen=True, eq=False)
class Run:
    """One timed run over a batch.

    Args:
        alone: s, the solver's own work.
        converted: s, with conversion.
        judged: s, with conversion, finishing and judging.
        candidate: what the solver proposed.
        solution: the judged answer.
    """

    alone: float
    converted: float
    judged: float
    candidate: Candidate
    solution: GraspForceSolution


@dataclass(frozen=True)
class EntrantFacts:
    """What a page says of an entrant, see `Entrant`."""

    key: str
    title: str
    version: str
    settings: str
    threads: int
    feasible_only: bool


class Entrant(ABC):
    """A solver with its settings.

    Args:
        key: unique.
        title: for the reader.
        version: of its package.
        settings: in words.
        threads: cores that it is given.
        batched: whether it takes many problems in one call.
        feasible_only: whether an infeasible problem is an error to it.
    """

    def __init__(
        self,
        key: str,
        title: str,
        version: str,
        settings: str,
        *,
        threads: int = 1,
        batched: bool = True,
        feasible_only: bool = False,
    ) -> None:
        self.key, self.title, self.version, self.settings = key, title, version, settings
        self.threads, self.batched, self.feasible_only = threads, batched, feasible_only

    @property
    def facts(self) -> EntrantFacts:
        """For the page."""
        return EntrantFacts(
            self.key, self.title, self.version, self.settings, self.threads, self.feasible_only
        )

    @abstractmethod
    def run(self, problem: GraspForceProblem) -> Run:
        """Solve a batch of numpy problems, timed."""

    @abstractmethod
    def warm(self, problem: GraspForceProblem) -> None:
        """Do once what a first call pays for: imports, compilation, solver objects."""


class PeerEntrant(Entrant):
    """A peer behind its adapter."""

    def __init__(self, peer: Peer, *, threads: int = 1) -> None:
        super().__init__(
            _key(peer) + (f"_{threads}" if threads > 1 else ""),
            peer.title + (f" ({threads} threads)" if threads > 1 else ""),
            peer.version(),
            peer.settings,
            threads=threads,
            batched=peer.batched,
            feasible_only=peer.feasible_only,
        )
        self._peer = peer
        self._cold = True

    def warm(self, problem: GraspForceProblem) -> None:
        """See the base; a batched peer has a solver object for every shape."""
        prepared = self._peer.prepare(problem)
        if self.batched or self._cold:
            self._peer.run(prepared)
        self._cold = False

    def run(self, problem: GraspForceProblem) -> Run:
        """See the base."""
        started = time.perf_counter()
        prepared = self._peer.prepare(problem)
        ready = time.perf_counter()
        raw = self._peer.run(prepared)
        solved = time.perf_counter()
        candidate = self._peer.answer(problem, prepared, raw)
        read = time.perf_counter()
        solution = _Given(candidate).solve(problem)
        done = time.perf_counter()
        return Run(solved - ready, read - started, done - started, candidate, solution)


class OwnEntrant(Entrant):
    """A solver of the registry."""

    def __init__(
        self, key: str, title: str, settings: str, solver: Solver, *, threads: int = 1
    ) -> None:
        super().__init__(key, title, _own_version(), settings, threads=threads)
        self._solver = solver
        self._warm: set[tuple[int, ...]] = set()

    def warm(self, problem: GraspForceProblem) -> None:
        """See the base; other sizes and read-only arrays may mean other compiled code."""
        few = problem[:_WARMED]
        arrays = [value for value in vars(few).values() if isinstance(value, np.ndarray)]
        kind = (len(few), *(int(array.flags.writeable) for array in arrays))
        if kind not in self._warm:
            self._solver.solve(few)
            self._solver.propose(few)
        self._warm.add(kind)

    def run(self, problem: GraspForceProblem) -> Run:
        """See the base."""
        started = time.perf_counter()
        candidate = self._solver.propose(problem)
        proposed = time.perf_counter()
        alone = proposed - started
        # `solve` is `propose` and what the base adds: a slow proposal is not made twice
        slow = alone > _SLOW
        solution = (_Given(candidate) if slow else self._solver).solve(problem)
        judged = time.perf_counter() - proposed + (alone if slow else 0.0)
        return Run(alone, alone, judged, candidate, solution)


class _Given(Solver):
    """Hands a finished candidate to what `solve` does for every solver."""

    objectives = ("min_norm",)

    def __init__(self, candidate: Candidate) -> None:
        self._candidate = candidate

    def propose(self, problem: GraspForceProblem) -> Candidate:
        # a copy, because the solver's own forces are measured, too
        return dataclasses.replace(self._candidate, forces=self._candidate.forces.copy())


@dataclass(frozen=True)
class _Own:
    name: str
    key: str
    title: str
    settings: str
    options: dict[str, Any]
    threads: int = 1


_OWN = (
    _Own("dual_newton", "dual_newton", "dual Newton", "defaults", {}),
    _Own("dual_newton", "dual_newton_2", "dual Newton (2 threads)", "threads=2", {"threads": 2}, 2),
    _Own("interior_point", "interior_point", "interior point", "defaults", {}),
    _Own(
        "dual_newton_torch",
        "dual_newton_torch",
        "dual Newton (torch)",
        "on the CPU",
        {"device": "cpu"},
    ),
    _Own(
        "conditioned",
        "network",
        "network (raw)",
        "`conditioned` with polish_steps=0, fallback=None",
        {"polish_steps": 0, "fallback": None},
    ),
    _Own(
        "conditioned",
        "network_polished",
        "network (2 Newton steps)",
        "`conditioned` with polish_steps=2, fallback=None",
        {"polish_steps": 2, "fallback": None},
    ),
    _Own(
        "conditioned",
        "network_fallback",
        "network (fallback)",
        "`conditioned` with its defaults",
        {},
    ),
)


def own_entrants(cores: int) -> list[Entrant]:
    """The solvers of this project that are registered here and fit on so many cores."""
    present = available_solvers()
    return [
        OwnEntrant(
            own.key,
            own.title,
            f"`{own.name}`, {own.settings}" if own.name != "conditioned" else own.settings,
            make_solver(own.name, **own.options),
            threads=own.threads,
        )
        for own in _OWN
        if own.name in present and own.threads <= cores
    ]


def peer_entrants(cores: int) -> list[Entrant]:
    """The peers that are installed; the one that fills two cores by itself takes part twice."""
    entrants: list[Entrant] = []
    for kind in all_peers():
        if not kind.installed():
            continue
        entrants.append(PeerEntrant(kind()))
        if kind.package == "moreau" and cores > 1:
            entrants.append(PeerEntrant(kind(), threads=2))
    return entrants


def absent() -> list[str]:
    """Titles of peers that are not installed, and names of own solvers that are not there."""
    peers = [kind.title for kind in all_peers() if not kind.installed()]
    names = dict.fromkeys(own.name for own in _OWN)
    return peers + [f"`{name}`" for name in names if name not in available_solvers()]


def _key(peer: Peer) -> str:
    return peer.title.lower().replace(" (", "_").replace(")", "").replace(" ", "_")


def all_peers() -> list[type[Peer]]:
    """Every peer that there is an adapter for, installed or not."""
    from .clarabel_peer import ClarabelPeer, ClarabelUpdatePeer
    from .layer_peer import CvxpyLayersPeer
    from .moreau_peer import MoreauPeer
    from .one_by_one import EcosPeer, QocoPeer, ScsPeer

    return [
        ClarabelPeer,
        ClarabelUpdatePeer,
        MoreauPeer,
        EcosPeer,
        QocoPeer,
        ScsPeer,
        CvxpyLayersPeer,
    ]


def _own_version() -> str:
    try:
        return version("graspforce")
    except PackageNotFoundError:
        return "here"
