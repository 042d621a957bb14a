"""Pressure of drives on held-out samples, in which hand, air and transducers deviate."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.transfer_ensemble import TransferEnsemble
from airtact.errors import in_short
from airtact.evaluation.metrics import pascals


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The pressure at the weakest focus for several drives, on samples not used to compute them.

    Attributes
    ----------
    names : names of the D drives.
    pressures : (D, S) peak pressure at the weakest focus in each sample, with every drive scaled to
        the energy of the first [Pa].
    expected : (D,) pressure at the weakest focus without any deviation [Pa].
    left_out : number of samples skipped because they are impossible.
    """

    names: tuple[str, ...]
    pressures: Float64[np.ndarray, "drives samples"]
    expected: Float64[np.ndarray, "drives"]
    left_out: int

    __repr__ = in_short

    @property
    def lowest_tenth(self) -> Float64[np.ndarray, "drives"]:
        """(D,) pressure [Pa] that the weakest focus exceeds in 9 out of 10 samples."""
        return np.quantile(self.pressures, 0.1, axis=1)

    def sentence(self) -> str:
        """Sentence stating the pressure that the weakest focus exceeds in 9 out of 10 samples."""
        first, *rest = self.lowest_tenth
        words = [f"{name}: {pascals(low)}" for name, low in zip(self.names[1:], rest, strict=True)]
        compared = f" ({', '.join(words)} at equal energy)" if words else ""
        left_out = f"; {self.left_out} samples are impossible" if self.left_out else ""
        return (
            "With the given uncertainty, the pressure at the weakest focus is at least "
            f"{pascals(first)} in 9 of 10 cases, and {pascals(self.expected[0])} without "
            f"deviations{compared}{left_out}."
        )


def held_out(samples: TransferEnsemble, target: Target, drives: Mapping[str, Drive]) -> HeldOut:
    """Evaluate drives on samples, with every drive scaled to the energy of the first.

    Parameters
    ----------
    samples : samples drawn with a different seed from those used to compute the drives.
    target : the foci; those without a request are ignored.
    drives : drives to compare, by name.

    Raises
    ------
    InvalidInput
        If a drive does not have as many elements as the samples.
    """
    # The rows of the foci come first; suppression points follow and are ignored.
    asked = np.flatnonzero(target.weights > 0.0)
    first = next(iter(drives.values()))
    factors = np.array([drive.factor_to_match(first) for drive in drives.values()])
    sampled = [np.abs(samples.pressures(drive)[:, asked]).min(axis=1) for drive in drives.values()]
    nominal = [np.abs(samples.pressure(drive)[asked]).min() for drive in drives.values()]
    return HeldOut(
        names=tuple(drives),
        pressures=factors[:, None] * np.stack(sampled),
        expected=factors * np.array(nominal),
        left_out=samples.left_out,
    )
