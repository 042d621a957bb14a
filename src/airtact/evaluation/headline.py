"""First sentences of a result: the pressure at the weakest focus, and unmet requests."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.evaluation.comparison import Comparison
from airtact.evaluation.metrics import pascals


def body_word(bodies: Sequence[str]) -> str:
    """Return the word "hand" or "object", depending on the names of the bodies."""
    parts = ("hand", "finger", "thumb", "palm")
    return "hand" if any(part in name.lower() for name in bodies for part in parts) else "object"


def headline(
    comparison: Comparison, drive: Drive, word: str = "hand", foci: Sequence[str] = ()
) -> str:
    """State the pressure at the weakest focus, and the gain from considering the bodies.

    Parameters
    ----------
    comparison : results of the drive that considers the bodies, optionally followed by those of a
        drive that ignores them (by the same method).
    drive : the emitted drive, which considers the bodies. If it is at full scale, the two drives
        are compared at equal peak, and otherwise at equal energy.
    word : the word for the bodies, such as "hand".
    foci : a name for each focus; the sentence names the focus whose pressure decreases most.
    """
    # Below full scale the hardware does not limit the peak, so compare the drives by energy.
    held_equal = "equal peak" if drive.is_full_scale else "equal energy"
    values = _counted(comparison, held_equal)
    # The comparison holds every drive at full scale, but the drive is emitted at its own peak.
    first = drive.peak * _counted(comparison, "equal peak")[0].min()
    amount = _amount(first, comparison.target)
    sentence = f"{_capital(comparison.names[0])}: {amount} at the weakest focus."
    if len(values) == 1:
        return sentence
    gain = values[0].min() / values[1].min() - 1.0
    amount = _amount(first / (1.0 + gain), comparison.target)
    sentence += f" {_capital(comparison.names[1])}: {amount}."
    error = comparison.report.estimated_error
    # Never claim a difference below 1 %, even if the estimated error is smaller.
    if abs(gain) <= max(error, 0.01):
        if error > 0.03:
            return (
                f"{sentence} The effect of the {word} is unknown, because the estimated error of "
                f"the pressures is {_per_cent(error)}. Set a smaller value of accuracy."
            )
        same = _per_cent(max(error, 0.01))
        return f"{sentence} With and without the {word}, the result is the same to within {same}."
    same = "hardware" if drive.is_full_scale else "energy"
    sentence += f" Same {same}: {_signed(gain)}"
    if values.shape[1] == 1:
        return f"{sentence}."
    mean = values[0].mean() / values[1].mean() - 1.0
    sentence += f" at the weakest focus, {_signed(mean)} on average"
    losses = 1.0 - values[0] / values[1]
    worst = int(losses.argmax())
    if foci and losses[worst] > max(error, 0.02):
        asked = np.flatnonzero(comparison.target.weights > 0.0)
        sentence += f"; {foci[asked[worst]]} loses {_per_cent(losses[worst])}"
    return f"{sentence}."


def shortfalls(
    target: Target, foci: Sequence[str], reached: Float64[np.ndarray, "foci"], drive: Drive
) -> tuple[str, ...]:
    """State in one sentence which foci do not reach 98 % of their requested pressure, if any.

    Parameters
    ----------
    target : the requested pressures.
    foci : a name for each focus.
    reached : (F,) peak pressure at the foci [Pa].
    drive : the emitted drive.
    """
    if target.pressures is None:
        return ()
    # The default accuracy is 1 %, so a deficit below 2 % is not worth a sentence.
    short = [
        f"{name} {pascals(got)} of {pascals(asked)}"
        for name, got, asked in zip(foci, reached, target.pressures, strict=True)
        if got < 0.98 * asked
    ]
    if not short:
        return ()
    full = ": the transducers are at full scale" if drive.is_full_scale else ""
    return (f"Requested but not reached: {', '.join(short)}{full}.",)


def _counted(comparison: Comparison, held_equal: str) -> Float64[np.ndarray, "drives counted"]:
    weights = comparison.target.weights
    asked = weights > 0.0
    return comparison.pressures[held_equal][:, asked] / weights[asked]


def _per_cent(share: float) -> str:
    # Write a share in per cent, with a space before the sign (ISO 80000-1).
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def _signed(share: float) -> str:
    return f"{100 * share:+z.0f} %".replace("-", "\u2212")


def _amount(weakest: float, target: Target) -> str:
    # Write a pressure, or its fraction of the request if the foci request different
    # pressures.
    weights = target.weights[target.weights > 0.0]
    if target.pressures is not None and not np.allclose(weights, weights[0]):
        return f"{weakest:.0%} of the request".replace("%", " %")
    return pascals(weakest * weights.max())


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
