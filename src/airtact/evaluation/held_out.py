"""What drives keep where hand, air and transducers are not as expected: samples that no drive was made for."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.conventions import InvalidInput
from airtact.evaluation.headline import pascals
from airtact.printing import in_short
from airtact.sampling.ensemble import TransferEnsemble
from airtact.scene.target import Target
from airtact.transfer import Drive

SAMPLES = 256
"""Number of samples that drives are tried on."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The weakest focus under some drives over samples that none of them was made for.

    Attributes
    ----------
    names : of the D drives.
    pressures : (D, S) peak pressure of the weakest focus in each sample, at the energy of the first drive [Pa].
    expected : (D,) the same with nothing in doubt [Pa].
    left_out : number of samples that cannot be.
    """

    names: tuple[str, ...]
    pressures: Float64[np.ndarray, "drives samples"]
    expected: Float64[np.ndarray, "drives"]
    left_out: int

    __repr__ = in_short

    @property
    def lowest_tenth(self) -> Float64[np.ndarray, "drives"]:
        """(D,) what the weakest focus gets 9 of 10 times [Pa]."""
        return np.quantile(self.pressures, 0.1, axis=1)

    def sentence(self) -> str:
        """Say what the weakest focus gets 9 of 10 times."""
        first, *others = self.lowest_tenth
        beside = ", ".join(f"{name}: {pascals(low)}" for name, low in zip(self.names[1:], others, strict=True))
        left = f"; {self.left_out} samples cannot be" * bool(self.left_out)
        return (
            f"With what is in doubt, 9 of 10 times the weakest focus gets at least {pascals(first)}, of "
            f"{pascals(self.expected[0])} expected" + f" ({beside} at equal energy)" * bool(others) + f"{left}."
        )


def held_out(samples: TransferEnsemble, target: Target, drives: Mapping[str, Drive]) -> HeldOut:
    """Evaluate drives on samples, each at the energy of the first.

    Parameters
    ----------
    samples : of another seed than those that drives were made for.
    target : the foci; those that ask for nothing do not count.
    drives : by name.

    Raises
    ------
    InvalidInput
        "empty": there is no drive; or a drive is for another number of elements.
    """
    if not drives:
        raise InvalidInput("there are 0 drives to try; give one or more by name.", code="empty")
    asked = np.flatnonzero(target.weights > 0.0)
    energies = np.array([np.sum(np.abs(drive.amplitudes) ** 2) for drive in drives.values()])
    scales = np.sqrt(energies[0] / energies)
    found = [np.abs(samples.pressures(drive))[:, asked].min(axis=1) for drive in drives.values()]
    nominal = [np.abs(samples.pressure(drive))[asked].min() for drive in drives.values()]
    return HeldOut(tuple(drives), scales[:, None] * np.stack(found), scales * np.array(nominal), samples.left_out)
