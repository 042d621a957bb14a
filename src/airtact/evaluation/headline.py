"""What a run says first, in a sentence each: what the weakest focus gets, and what was asked and not reached."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target import Target
from airtact.evaluation.comparison import Comparison

FULL = 0.99
"""Largest amplitude from which on a drive counts as one at full scale."""

MET = 0.98
"""Share of the pressure asked of a focus above which it counts as reached."""

LEAST_DIFFERENCE = 0.01
"""Smaller differences between two drives are never called one."""

NONLINEAR = 5e3
"""Peak pressure from which a run warns that air is no longer linear [Pa]: a Mach number above 3 %."""

HANDS = ("hand", "finger", "thumb", "palm")
"""Bodies with one of these in their name are a hand; others are objects."""


def body_word(bodies: Sequence[str]) -> str:
    """Return what sentences call the bodies of these names: hand or object."""
    return "hand" if any(word in name.lower() for name in bodies for word in HANDS) else "object"


def headline(comparison: Comparison, peak: float, word: str = "hand") -> str:
    """Say in a sentence what the weakest focus gets, from the first drive and from the second if there is one.

    Parameters
    ----------
    comparison : of the drive that considers the bodies, and the one by the same method that ignores
        them.
    peak : largest amplitude that the first drive is emitted with. At full scale the second is too;
        below, where the target asks for no more, it has the same energy.
    word : what the bodies are called.
    """
    held_equal = "equal peak" if peak >= FULL else "equal energy"
    weakest = _weakest(comparison, held_equal)
    first = peak * _weakest(comparison, "equal peak")[0]
    said = f"{_capital(comparison.names[0])}: {_amount(first, comparison.target)} at the weakest focus."
    if len(weakest) == 1:
        return said
    ratio = weakest[1] / weakest[0]
    said += f" {_capital(comparison.names[1])}: {_amount(first * ratio, comparison.target)}."
    error = max(comparison.report.estimated_error, LEAST_DIFFERENCE)
    if abs(1.0 / ratio - 1.0) <= error:
        return f"{said} The {word} does not matter here: the solution distinguishes no less than {error:.1%}."
    gain = f"{1.0 / ratio - 1.0:+.0%}".replace("%", " %").replace("-", "−")
    return f"{said} {'Same hardware' if peak >= FULL else 'Same energy'}: {gain}."


def shortfalls(
    target: Target, foci: Sequence[str], reached: Float64[np.ndarray, "foci"], peak: float
) -> tuple[str, ...]:
    """Say which foci get less than was asked of them, if any.

    Parameters
    ----------
    target : what was asked.
    foci : a name for each focus.
    reached : (F,) peak pressure at the foci [Pa].
    peak : largest amplitude of the drive.
    """
    if target.pressures is None:
        return ()
    pairs = zip(foci, reached, target.pressures, strict=True)
    short = [
        f"{name} {pascals(got)} of {pascals(asked)}"
        for name, got, asked in pairs
        if got < MET * asked
    ]
    if not short:
        return ()
    full = ": the transducers are at full scale" if peak >= FULL else ""
    return (f"Asked and not reached: {', '.join(short)}{full}.",)


def beyond_linear(reached: Float64[np.ndarray, "foci"]) -> tuple[str, ...]:
    """Warn of the strongest of some foci [Pa] where its sound is too strong for the linear model."""
    most = float(reached.max())
    if most <= NONLINEAR:
        return ()
    return (
        f"the computation is linear: above some {pascals(NONLINEAR)} real air steepens the wave, and a real focus is "
        f"weaker than the {pascals(most)} computed.",
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
    """Write the pressure at the weakest focus; its part of what was asked, where the foci ask for different ones."""
    weights = target.weights[target.weights > 0.0]
    if target.pressures is not None and not np.allclose(weights, weights[0]):
        return f"{weakest:.0%} of what was asked".replace("%", " %")
    return pascals(weakest * weights.max())


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
