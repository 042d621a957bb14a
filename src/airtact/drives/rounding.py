"""Rounding drives to the levels of a board, and what that costs at the foci."""

import numpy as np
from jaxtyping import Float64

from airtact.checks import of_kind
from airtact.drives.frame import Frame
from airtact.drives.transfer import Drive, TransferMatrix, check_drive
from airtact.errors import InvalidInput
from airtact.transducers.levels import EIGHT_BITS, Levels


def quantise(drive: Drive, levels: Levels = EIGHT_BITS) -> Frame:
    """Round every element to a level of amplitude and one of phase: 256 of each, as the paper has it (section 3.4).

    Amplitude byte round(255 |d|), phase byte round(256 arg(d) / 2π) modulo 256; other levels alike,
    by the nearest. An element whose amplitude level is 0 is off and gets phase level 0, so
    ``quantise(frame.drive(), frame.levels)`` returns the same frame. Where there are only two
    amplitudes every element above a thousandth of full scale is at full scale, as in
    ``drive.phase_only()``.

    Parameters
    ----------
    drive : what every element emits.
    levels : what the board can emit.

    Examples
    --------
    >>> frame = quantise(Drive(np.array([1.0, 0.5j, -1.0, 0.0])))
    >>> frame.amplitude.tolist(), frame.phase.tolist()
    ([255, 128, 255, 0], [0, 64, 128, 0])
    """
    check_drive(drive, "what is quantised")
    of_kind(levels, Levels, "the levels of a frame", "Levels(amplitudes, phases)")
    return Frame(*levels.rounded(drive.amplitudes), levels)


def rounding_error(
    transfer: TransferMatrix, drive: Drive, frame: Frame
) -> Float64[np.ndarray, "foci"]:
    """Return what rounding costs at each focus: the relative change of its pressure.

    Boards with two levels of amplitude raise weak elements to full scale, so there both drives are
    compared at equal energy Σ|d|²; all others as they are.

    Parameters
    ----------
    transfer : pressure at the foci per unit drive.
    drive : what was computed.
    frame : what is emitted.

    Returns
    -------
    (F,) |p emitted| / |p computed| − 1; NaN where the drive gives no pressure.

    Raises
    ------
    InvalidInput
        If one is for another number of elements, or the frame is silent.
    """
    of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
    of_kind(frame, Frame, "what is emitted", "quantise(drive, levels)")
    if frame.silent:
        raise InvalidInput(
            f"all {len(frame)} elements of the frame are off, so nothing can be compared.",
            code="all_zero",
        )
    rounded = frame.drive()
    exact, got = np.abs(transfer.pressure(drive)), np.abs(transfer.pressure(rounded))
    if frame.levels.phase_only:
        got = got * np.linalg.norm(drive.amplitudes) / np.linalg.norm(rounded.amplitudes)
    return np.where(exact > 0.0, got / np.where(exact > 0.0, exact, 1.0) - 1.0, np.nan)
