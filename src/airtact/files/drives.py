"""The drive as files: a table for people and other programs, and HDF5 with all that it came from."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex128, Float64, Real

from airtact.atomic import whole_file
from airtact.conventions import InvalidInput, about
from airtact.scene.target import Target
from airtact.synthesis.quantise import Frame
from airtact.synthesis.sequence import Sequence
from airtact.transducers.layout import PhasedArray
from airtact.transfer import FULL_SCALE, Drive, TransferMatrix
from airtact.validation import check_finite, points_of, positive, real_numbers

COLUMNS = ("index", "x", "y", "z", "nx", "ny", "nz", "amplitude", "phase", "amplitude_level", "phase_level")
"""Columns of drive.csv: metres, a share of full scale, radians of Re[u e^{−iωt}], and bytes."""


def write_drive_csv(path: Path, array: PhasedArray, drive: Drive, frame: Frame) -> None:
    """Write one line per transducer, see `COLUMNS`.

    Parameters
    ----------
    path : the file to write; it appears only once it is whole.
    array : the transducers, in the obstacles' frame.
    drive : what each emits.
    frame : the same in 256 levels each of amplitude and phase.
    """
    with whole_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for index in range(len(drive.amplitudes)):
            place = [f"{number:.9g}" for number in (*array.positions[index], *array.normals[index])]
            amplitude = drive.amplitudes[index]
            exact = [f"{np.abs(amplitude):.9g}", f"{np.angle(amplitude):.9g}"]
            writer.writerow([index, *place, *exact, int(frame.amplitude[index]), int(frame.phase[index])])


def write_drive_h5(
    path: Path,
    array: PhasedArray,
    drive: Drive,
    frame: Frame,
    transfer: TransferMatrix,
    target: Target,
    texts: Mapping[str, str],
) -> None:
    """Write the drive with the transfer matrix, the target and how all was made.

    Parameters
    ----------
    path : the file to write; it appears only once it is whole.
    array : the transducers, in the obstacles' frame.
    drive : what each emits.
    frame : the same in 256 levels each of amplitude and phase.
    transfer : pressure at the foci per unit drive.
    target : the foci.
    texts : further datasets of text by name, such as the scene file and the solver's report.
    """
    levels = {
        "amplitude_level": (frame.amplitude, "255 is full scale"),
        "phase_level": (frame.phase, "256 is a turn"),
    }
    _write(path, array, drive.amplitudes, levels, transfer, target, texts)


def write_sequence_h5(
    path: Path,
    array: PhasedArray,
    sequence: Sequence,
    transfer: TransferMatrix,
    target: Target,
    texts: Mapping[str, str],
) -> None:
    """Write a sequence with what it was made from: as a drive, but ``amplitude`` and ``phase`` have a row a frame.

    Parameters
    ----------
    path : the file to write; it appears only once it is whole.
    array : the transducers, in the obstacles' frame.
    sequence : what each emits in each frame, and the rate.
    transfer : pressure at the foci per unit drive.
    target : the foci.
    texts : further datasets of text by name, such as the scene file and the solver's report.
    """
    _write(path, array, sequence.drives, {"rate": (np.float64(sequence.rate), "frames/s")}, transfer, target, texts)


def _write(
    path: Path,
    array: PhasedArray,
    drives: Complex128[np.ndarray, "*frames elements"],
    more: Mapping[str, tuple[Any, str]],
    transfer: TransferMatrix,
    target: Target,
    texts: Mapping[str, str],
) -> None:
    import h5py

    columns = {
        "positions": (array.positions, "m"),
        "normals": (array.normals, ""),
        "amplitude": (np.abs(drives), "share of full scale"),
        "phase": (np.angle(drives), "rad, of Re[u exp(-i omega t)]"),
        **more,
        "transfer_matrix": (transfer.matrix, "Pa per unit drive; first axis hears, second speaks"),
        "foci": (target.points, "m"),
        "sensitivity": (np.float64(array.element.sensitivity), "Pa m, uncalibrated"),
    }
    if target.pressures is not None:
        columns["wanted_pressures"] = (target.pressures, "Pa, peak")
    with whole_file(path) as partial, h5py.File(partial, "w") as file:
        for name, (values, unit) in columns.items():
            file.create_dataset(name, data=values).attrs["unit"] = unit
        for name, text in texts.items():
            file.create_dataset(name, data=text)


@dataclass(frozen=True, eq=False)
class StoredDrive:
    """What a drive.h5 holds of what shall be played, and of what it was made for.

    Attributes
    ----------
    path : the file.
    positions, normals : (E, 3) of the transducers [m], in the obstacles' frame.
    drives : (N, E) what each emits, in each frame of a sequence; one frame for a drive.
    rate : frames a second of a sequence; None for a drive.
    sensitivity : peak pressure of a transducer at full scale, 1 m away on its axis [Pa·m]; None where not told.
    transfer : pressure at the foci per unit drive; None where not told.
    scene : text of the scene file; None where not told.
    """

    path: Path
    positions: Float64[np.ndarray, "elements 3"]
    normals: Float64[np.ndarray, "elements 3"]
    drives: Complex128[np.ndarray, "frames elements"]
    rate: float | None
    sensitivity: float | None
    transfer: TransferMatrix | None
    scene: str | None


def read_drive_h5(path: Path) -> StoredDrive:
    """Read a drive, or a sequence of drives, from an HDF5 file.

    A sequence has ``amplitude`` and ``phase`` of shape (frames, elements) and ``rate`` [frames/s]; else the file is as
    ``write_drive_h5`` writes it. Only ``positions``, ``normals``, ``amplitude`` and ``phase`` must be there.

    Parameters
    ----------
    path : the file.

    Raises
    ------
    InvalidInput
        If the file cannot be read, lacks a dataset, the shapes do not match, a number is not finite, or an amplitude is
        negative or above 1 (which frame and element).
    """
    import h5py

    try:
        file: Any = h5py.File(path)
    except OSError as error:
        why = "there is no such file" if not path.exists() else f"it is no HDF5 file ({error.errno or 0})"
        raise InvalidInput(f"cannot read {path}: {why}.") from None
    with file, about(path.name):
        needed = ("positions", "normals", "amplitude", "phase")
        missing = [name for name in needed if not isinstance(file.get(name), h5py.Dataset)]
        if missing:
            raise InvalidInput(f"{len(missing)} datasets are missing: {', '.join(missing)}; is this a drive.h5?")
        positions, normals = (points_of(file[name][()], name) for name in ("positions", "normals"))
        amplitude, phase = (real_numbers(np.asarray(file[name][()]), name) for name in ("amplitude", "phase"))
        drives = _drives(amplitude, phase, len(positions))
        if normals.shape != positions.shape:
            raise InvalidInput(f"{len(positions)} positions have {len(normals)} normals.")
        rate = positive(file["rate"][()], "the rate", "frames/s") if "rate" in file else None
        if len(drives) > 1 and rate is None:
            raise InvalidInput(f"a sequence of {len(drives)} frames needs rate, in frames/s.")
        told = "sensitivity" in file
        sensitivity = positive(file["sensitivity"][()], "the sensitivity of an element", "Pa·m") if told else None
        transfer = TransferMatrix(file["transfer_matrix"][()], np.nan) if "transfer_matrix" in file else None
        scene = file["scene"].asstr()[()] if "scene" in file else None
    return StoredDrive(path, positions, normals, drives, rate, sensitivity, transfer, scene)


def _drives(
    amplitude: Real[np.ndarray, "*amplitudes"], phase: Real[np.ndarray, "*phases"], elements: int
) -> Complex128[np.ndarray, "frames elements"]:
    """Return complex drives, one row a frame; refuse numbers that cannot be."""
    if amplitude.shape != phase.shape or amplitude.ndim not in (1, 2) or amplitude.shape[-1:] != (elements,):
        raise InvalidInput(
            f"amplitude of shape {amplitude.shape} and phase of shape {phase.shape} do not fit {elements} elements."
        )
    if amplitude.size == 0:
        raise InvalidInput("the sequence has 0 frames.")
    amplitude, phase = np.atleast_2d(amplitude), np.atleast_2d(phase)
    check_finite(amplitude, "amplitude")
    check_finite(phase, "phase")
    bad = np.argwhere((amplitude < 0.0) | (amplitude > FULL_SCALE))
    if len(bad):
        frame, element = (int(index) for index in bad[0])
        raise InvalidInput(
            f"an amplitude must be 0 to 1, but {len(bad)} are not, the first {amplitude[frame, element]:g} of element "
            f"{element} in frame {frame}."
        )
    return amplitude * np.exp(1j * phase)
