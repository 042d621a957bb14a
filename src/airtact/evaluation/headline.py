"""The first sentences of a run: pressure at the weakest focus, and requests not reached."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.evaluation.comparison import Comparison


def body_word(bodies: Sequence[str]) -> str:
    """Return the word for bodies of these names: hand or object."""
    parts = ("hand", "finger", "thumb", "palm")
    return "hand" if any(part in name.lower() for name in bodies for part in parts) else "object"


def headline(comparison: Comparison, drive: Drive, word: str = "hand") -> str:
    """State the pressure at the weakest focus, under the first drive and under the second.

    Parameters
    ----------
    comparison : of the drive that considers the bodies, and the one by the same method that ignores
        them, if there is one.
    drive : the first drive as it is emitted. If it is at full scale, so is the second; else the
        second has the same energy.
    word : the word for the bodies.
    """
    # Below full scale the hardware does not limit the peak, so the drives are compared by energy.
    held_equal = "equal peak" if drive.is_full_scale else "equal energy"
    weakest = _weakest(comparison, held_equal)
    # The comparison has every drive at full scale; the drive is emitted at its own peak.
    first = drive.peak * _weakest(comparison, "equal peak")[0]
    amount = _amount(first, comparison.target)
    sentence = f"{_capital(comparison.names[0])}: {amount} at the weakest focus."
    if len(weakest) == 1:
        return sentence
    ratio = weakest[1] / weakest[0]
    amount = _amount(first * ratio, comparison.target)
    sentence += f" {_capital(comparison.names[1])}: {amount}."
    # Differences below 1 % are never claimed, however small the estimated error is.
    error = max(comparison.report.estimated_error, 0.01)
    if abs(1.0 / ratio - 1.0) <= error:
        return (
            f"{sentence} The {word} does not matter here: the solution distinguishes no less than "
            f"{error:.1%}."
        )
    # Typographic minus, and a space before the per cent sign (ISO 80000-1).
    gain = f"{1.0 / ratio - 1.0:+.0%}".replace("%", " %").replace("-", "−")
    same = "hardware" if drive.is_full_scale else "energy"
    return f"{sentence} Same {same}: {gain}."


def shortfalls(
    target: Target, foci: Sequence[str], reached: Float64[np.ndarray, "foci"], drive: Drive
) -> tuple[str, ...]:
    """List the foci that get less than 98 % of the pressure asked of them, in one sentence if any.

    Parameters
    ----------
    target : the pressures asked.
    foci : a name for each focus.
    reached : (F,) peak pressure at the foci [Pa].
    drive : the drive as it is emitted.
    """
    if target.pressures is None:
        return ()
    # Solvers are asked for 1 % by default, so a miss below 2 % is not worth a sentence.
    short = [
        f"{name} {pascals(got)} of {pascals(asked)}"
        for name, got, asked in zip(foci, reached, target.pressures, strict=True)
        if got < 0.98 * asked
    ]
    if not short:
        return ()
    full = ": the transducers are at full scale" if drive.is_full_scale else ""
    return (f"Asked and not reached: {', '.join(short)}{full}.",)


def beyond_linear(reached: Float64[np.ndarray, "foci"]) -> tuple[str, ...]:
    """Warn where the strongest of some foci [Pa] is too strong for the linear model."""
    limit = 5e3  # a Mach number above 3 %
    strongest = float(reached.max())
    if strongest <= limit:
        return ()
    return (
        f"the computation is linear: above some {pascals(limit)} real air steepens the wave, and a "
        f"real focus is weaker than the {pascals(strongest)} computed.",
    )


def pascals(pressure: float) -> str:
    """Write a pressure with three digits, in kPa from 1 kPa on."""
    if pressure < 1e3:
        return f"{pressure:.3g} Pa"
    return f"{pressure / 1e3:.{max(0, 2 - int(np.log10(pressure / 1e3)))}f} kPa"


def _weakest(comparison: Comparison, held_equal: str) -> Float64[np.ndarray, "drives"]:
    """(D,) smallest pressure over weight at the foci that ask for sound."""
    weights = comparison.target.weights
    asked = weights > 0.0
    return (comparison.pressures[held_equal][:, asked] / weights[asked]).min(axis=1)


def _amount(weakest: float, target: Target) -> str:
    """Write a pressure, or its part of the request where the foci ask for different pressures."""
    weights = target.weights[target.weights > 0.0]
    if target.pressures is not None and not np.allclose(weights, weights[0]):
        return f"{weakest:.0%} of what was asked".replace("%", " %")
    return pascals(weakest * weights.max())


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
