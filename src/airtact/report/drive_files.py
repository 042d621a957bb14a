"""The drive as files: a table for people and other programs, and HDF5 with all that it came from."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from airtact.report.whole_file import whole_file
from airtact.scene.target import Target
from airtact.synthesis.quantise import Frame
from airtact.transducers.layout import PhasedArray
from airtact.transfer import Drive, TransferMatrix

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
    import h5py

    columns = {
        "positions": (array.positions, "m"),
        "normals": (array.normals, ""),
        "amplitude": (np.abs(drive.amplitudes), "share of full scale"),
        "phase": (np.angle(drive.amplitudes), "rad, of Re[u exp(-i omega t)]"),
        "amplitude_level": (frame.amplitude, "255 is full scale"),
        "phase_level": (frame.phase, "256 is a turn"),
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
