"""The fingerprint of what the project computes changes with every bit, and with nothing else."""

from dataclasses import dataclass

import numpy as np
import pytest

from scripts.fingerprint import arrays_of, digest

NUMBERS = np.arange(6.0)


@dataclass(frozen=True)
class Answer:
    forces: np.ndarray
    status: np.ndarray
    note: str | None = None


@pytest.mark.parametrize(
    "other",
    [
        np.nextafter(NUMBERS, np.inf),
        np.where(NUMBERS == 0.0, -0.0, NUMBERS),
        NUMBERS.reshape(2, 3),
        NUMBERS.astype(np.float32),
        NUMBERS.view(np.int64),
        NUMBERS[::-1],
    ],
    ids=["last bits", "sign of zero", "shape", "precision", "type", "order"],
)
def test_digest_changes_with(other) -> None:
    assert digest([other]) != digest([NUMBERS])


def test_digest_knows_nothing_of_memory() -> None:
    transposed = np.asfortranarray(NUMBERS.reshape(2, 3))
    assert digest([transposed]) == digest([NUMBERS.reshape(2, 3)])


def test_every_part_of_an_answer_counts() -> None:
    one = Answer(NUMBERS, np.array(["optimal"]))
    assert digest(arrays_of(one)) == digest([NUMBERS, np.array(["optimal"])])
    assert digest(arrays_of(one)) != digest(arrays_of(Answer(NUMBERS, np.array(["feasible"]))))
    assert digest(arrays_of(one)) != digest(arrays_of(Answer(NUMBERS, one.status, "why")))
    nested = {"b": [one, (1, 2.0)], "a": one}
    assert digest(arrays_of(nested)) == digest(arrays_of({"a": one, "b": [one, (1, 2.0)]}))
    assert len(list(arrays_of(nested))) == 6
