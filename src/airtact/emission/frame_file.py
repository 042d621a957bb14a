"""Files of frames, for boards without a link or for inspection, and the reader of drives."""

from pathlib import Path

import numpy as np

from airtact.drives.drive import Drive
from airtact.drives.drive_file import (
    DriveFile,
    checked_ending,
    read_drive_file,
    write_drive_file,
)
from airtact.drives.frame import frame_at, share_under_cap
from airtact.drives.sequence import Sequence
from airtact.emission.codecs import codec_of
from airtact.emission.emission import frames_of_period
from airtact.errors import about, of_kind, positive
from airtact.files.atomic import whole_file
from airtact.transducers.boards import boards_needed
from airtact.transducers.modulation import AmplitudeModulation


def load_drive(path: str | Path, *, rate: float | None = None) -> Drive | Sequence:
    """Read a drive or a sequence from a file.

    It reads the .h5 files of ``Drive.save``, ``Sequence.save`` and ``write_frames``, and .csv
    tables of a drive, in the order of their column ``index``. The saved amplitudes and phases are
    the computed ones, to 1e-15 (1e-9 in tables); those of ``write_frames`` are rounded to the
    levels of the boards.

    Parameters
    ----------
    path : file that ends in .h5 or .csv.
    rate : frames per second, if the file does not contain the rate.

    Returns
    -------
    A ``Sequence`` if there is a rate, else a ``Drive``.

    Raises
    ------
    InvalidInput
        If the file cannot be read, has a later format, contains numbers that are not valid in a
        drive, or contains several frames but no rate.
    """
    path = Path(of_kind(path, str | Path, "the file of a drive", "its path"))
    contents = read_drive_file(path)
    # Errors in the contents name the file.
    with about(path.name):
        rate = contents.frame_rate(rate)
    return Drive(contents.drives[0]) if rate is None else Sequence(contents.drives, rate)


def write_frames(
    path: str | Path,
    sound: Drive | Sequence,
    board: str,
    *,
    modulation: AmplitudeModulation | None = None,
    seconds: float | None = None,
    cap: float = 1.0,
) -> tuple[int, float | None]:
    """Write a drive or a sequence to a file, rounded to the levels of boards.

    Parameters
    ----------
    path : file that ends in .h5 or .bin (the bytes of the boards' messages).
    sound : a drive, which is written once or for one period of its modulation, or a sequence.
    board : name of the kind of board.
    modulation : amplitude modulation of a drive.
    seconds : duration of a sequence or a modulated drive [s]; one round or period by default.
    cap : largest amplitude of an element, as a share of full scale.

    Returns
    -------
    Number of frames, and frames per second; None for a constant drive.

    Raises
    ------
    InvalidInput
        If the drive is not for such boards, the modulation is too fast for them, the cap is not
        above 0 and at most 1, or the file cannot be written.
    """
    path = Path(of_kind(path, str | Path, "the file of frames", "its path"))
    ending = checked_ending(path, (".h5", ".bin"), "frame")
    of_kind(sound, Drive | Sequence, "the sound to write", "Drive(amplitudes)")
    codec = codec_of(board)
    drives = sound.drives if isinstance(sound, Sequence) else sound.amplitudes[None]
    rate = sound.rate if isinstance(sound, Sequence) else None
    boards = boards_needed(codec.board, drives.shape[1])
    factors = np.ones(1)
    if modulation is not None:
        count, rate = frames_of_period(modulation.frequency, codec.fastest_frames(boards))
        factors = modulation.envelope(count)
    share = share_under_cap(drives, codec.levels, cap)
    frames = [
        frame_at(drive, codec.levels, share * factor) for drive in drives for factor in factors
    ]
    if rate is not None and seconds is not None:
        total = max(round(positive(seconds, "the duration", "s") * rate), 1)
        frames = [frames[index % len(frames)] for index in range(total)]
    if ending == ".bin":
        with whole_file(path) as partial:
            partial.write_bytes(b"".join(codec.encode(frame) for frame in frames))
    else:
        rounded = np.stack([frame.drive().amplitudes for frame in frames])
        write_drive_file(path, DriveFile(rounded, rate, codec.levels, board=board))
    return len(frames), rate
